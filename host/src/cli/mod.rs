//! The `lobelia` command: one file a subcommand, thin over the library.

use std::any::TypeId;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use clap::{ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::acquire::{PLAN_FILE, RIG_FILE, journal};
use crate::error::{Error, Result};
use crate::reflectance::MapEncoding;
use crate::report::Report;
use crate::warning::Warning;
use crate::{files, progress};

mod acquire;
mod apart;
mod bake;
mod chart;
mod compare;
#[cfg(feature = "sim")]
mod demo;
mod develop;
mod edit;
mod environment;
mod fit;
mod incident;
mod methods;
mod paths;
mod plan;
mod render;
mod rig;
mod stability;
mod synth;
mod template;

/// Threads at most: more than any machine has cores, and few enough that every system starts them.
const MOST_THREADS: usize = 1024;

/// Measures how flat materials reflect light at every texel, fits that with a few lobes, and renders it.
#[derive(Debug, Parser)]
#[command(name = "lobelia", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    global: Global,
}

/// Options that every subcommand takes.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Everywhere")]
struct Global {
    /// Seed of every random choice [default: 1; for `acquire` that of rig.toml]
    #[arg(long, global = true)]
    seed: Option<u64>,
    /// Threads to use; all cores when not given
    #[arg(long, global = true, value_name = "N")]
    threads: Option<usize>,
    /// No progress bars, notes and warnings; the report has the warnings all the same
    #[arg(long, short, global = true)]
    quiet: bool,
    /// More notes on what is done
    #[arg(long, short, global = true, conflicts_with = "quiet")]
    verbose: bool,
    /// Writes what was done, how long it took and how wrong it is, as JSON
    #[arg(long, global = true, value_name = "FILE.json")]
    report: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Simulates a measurement and runs the whole chain, from poses to a rendered picture and report.html
    #[cfg(feature = "sim")]
    Demo(demo::DemoArgs),
    /// Chooses poses and exposures for a rig
    Plan(plan::PlanArgs),
    /// Drives a rig and its camera through a plan
    Acquire(acquire::AcquireArgs),
    /// Looks at a rig and drives it by hand, checks a controller, replays a session
    Rig(rig::RigArgs),
    /// Turns a run's photographs into reflectance at every texel
    Develop(develop::DevelopArgs),
    /// Fits lobes to a sampled SBRDF or to a measured table
    Fit(fit::FitArgs),
    /// Makes a sampled SBRDF of a known material, with noise, to test fits on
    Synth(synth::SynthArgs),
    /// Edits SBRDF maps: palettes, means, composites, diffuse photographs, tiles
    ///
    /// BRDFs are compared and blended by their reflectance, never by their coefficients. What was done is
    /// noted in the new map's attributes edit.1, edit.2, …
    Edit(edit::EditArgs),
    /// Renders a scene
    Render(render::RenderArgs),
    /// Bakes what a method prepares of a scene, for `render --baked`; joins and lists what was baked
    Bake(bake::BakeArgs),
    /// Prefilters an environment by lobes, for other renderers
    Prefilter(environment::PrefilterArgs),
    /// Renders a run's poses from the fitted map, beside the photographs
    Compare(compare::CompareArgs),
    /// Plots what a method costs against how right it is
    Chart(chart::ChartArgs),
    /// Shows methods where they break
    Stability(stability::StabilityArgs),
    /// Prints a commented example of a file that Lobelia reads
    Template(template::TemplateArgs),
    /// Prints a completion script for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

impl Command {
    /// The subcommand's name, for the report.
    fn name(&self) -> &'static str {
        match self {
            #[cfg(feature = "sim")]
            Self::Demo(_) => "demo",
            Self::Plan(_) => "plan",
            Self::Acquire(_) => "acquire",
            Self::Develop(_) => "develop",
            Self::Fit(_) => "fit",
            Self::Edit(_) => "edit",
            Self::Render(_) => "render",
            Self::Bake(_) => "bake",
            Self::Prefilter(_) => "prefilter",
            Self::Rig(_) => "rig",
            Self::Synth(_) => "synth",
            Self::Chart(_) => "chart",
            Self::Stability(_) => "stability",
            Self::Compare(_) => "compare",
            Self::Template(_) => "template",
            Self::Completions { .. } => "completions",
        }
    }
}

/// What a subcommand may use besides its own arguments.
struct Context {
    seed: u64,
    /// The seed, if one was given on the command line.
    given_seed: Option<u64>,
    quiet: bool,
    verbose: bool,
    report: Report,
}

impl Context {
    /// A note on stderr for someone who watches; silent with `--quiet`.
    fn note(&self, text: impl AsRef<str>) {
        if !self.quiet {
            eprintln!("{}", text.as_ref());
        }
    }

    /// Tells warnings, one line each, and keeps them for the report.
    fn warn(&mut self, warnings: impl IntoIterator<Item = Warning>) {
        for warning in warnings {
            self.note(format!("warning: {}", warning.text));
            self.report.warnings.push(warning);
        }
    }

    /// Notes a scene or a material as an input, with the files that it is made of.
    fn input_with_parts(&mut self, path: &Path) {
        self.report.input(path);
        apart::made_of(path).iter().for_each(|part| self.report.input(part));
    }

    /// Notes a run as an input: its journal, plan and rig.
    fn run_input(&mut self, run: &Path) {
        [journal::FILE_NAME, PLAN_FILE, RIG_FILE].iter().for_each(|name| self.report.input(&run.join(name)));
    }

    /// A note that only `--verbose` shows.
    fn detail(&self, text: impl AsRef<str>) {
        if self.verbose {
            eprintln!("{}", text.as_ref());
        }
    }
}

/// Runs the command line and gives the process's exit code: 0, 2 for bad input, 1 for a failure.
pub fn main() -> ExitCode {
    let command = negative_numbers(Cli::command());
    let matches = command.clone().get_matches();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let outcome = match not_finite(&command, &matches) {
        Some(refused) => Err(Error::input(refused)),
        None => apart::check(&command, &matches).and_then(|()| run(cli)),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("lobelia: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// How a map's file lies, by the option `--scanlines`.
fn map_encoding(scanlines: bool) -> MapEncoding {
    if scanlines { MapEncoding::Scanlines } else { MapEncoding::Tiles }
}

/// A time of an option, s, of which there may be no fewer than `least` and no more than a process lasts.
fn seconds_of(option: &str, seconds: f64, least: f64) -> Result<Duration> {
    const MOST: f64 = 1e9;
    if (least..=MOST).contains(&seconds) {
        return Ok(Duration::from_secs_f64(seconds));
    }
    Err(Error::input(format!("{option} is {seconds}, must be {least} to {MOST} s")))
}

/// Lets every option that takes a value take a number below 0, so that the option's own check says what is
/// wrong with it, not the grammar.
fn negative_numbers(command: clap::Command) -> clap::Command {
    let command = command.mut_args(|arg| {
        let takes_value = arg.get_action().takes_values();
        if takes_value { arg.allow_negative_numbers(true) } else { arg }
    });
    command.mut_subcommands(negative_numbers)
}

/// What is wrong with a number on the command line that is NaN or infinite: no option has a use for such, and
/// a comparison with NaN may never end.
fn not_finite(command: &clap::Command, matches: &ArgMatches) -> Option<String> {
    let of_command = command.get_arguments().filter(|arg| takes_fraction(arg)).find_map(|arg| {
        let given = matches.try_get_raw(arg.get_id().as_str()).ok()??;
        let wrong = given
            .filter_map(|value| value.to_str())
            .find(|value| value.trim().parse().is_ok_and(|number: f64| !number.is_finite()))?;
        let name = arg.get_long().map_or_else(|| arg.get_id().to_string(), |name| format!("--{name}"));
        Some(format!("{name} is {wrong}, must be a finite number"))
    });
    of_command.or_else(|| {
        let (name, matches) = matches.subcommand()?;
        not_finite(command.find_subcommand(name)?, matches)
    })
}

/// Whether an argument's value is a number that need not be whole.
fn takes_fraction(arg: &clap::Arg) -> bool {
    let kind = arg.get_value_parser().type_id();
    arg.get_action().takes_values() && (kind == TypeId::of::<f64>() || kind == TypeId::of::<f32>())
}

fn run(cli: Cli) -> Result<()> {
    progress::set_quiet(cli.global.quiet);
    if let Some(threads) = cli.global.threads {
        if !(1..=MOST_THREADS).contains(&threads) {
            return Err(Error::input(format!("--threads is {threads}, must be 1 to {MOST_THREADS}")));
        }
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().map_err(|error| {
            Error::failure(format!("{threads} threads cannot be started: {error}")).caused_by(error)
        })?;
    }
    let Global { seed: given_seed, quiet, verbose, report, .. } = cli.global;
    report.iter().try_for_each(|path| files::try_file(path))?;
    let seed = given_seed.unwrap_or(1);
    let report_of_run = Report::new(cli.command.name(), seed);
    let mut context = Context { seed, given_seed, quiet, verbose, report: report_of_run };
    let outcome = match cli.command {
        #[cfg(feature = "sim")]
        Command::Demo(args) => demo::run(&args, &mut context),
        Command::Plan(args) => plan::run(&args, &mut context),
        Command::Acquire(args) => acquire::run(&args, &mut context),
        Command::Rig(args) => rig::run(&args, &mut context),
        Command::Develop(args) => develop::run(&args, &mut context),
        Command::Fit(args) => fit::run(&args, &mut context),
        Command::Synth(args) => synth::run(&args, &mut context),
        Command::Edit(args) => edit::run(&args, &mut context),
        Command::Render(args) => render::run(&args, &mut context),
        Command::Bake(args) => bake::run(&args, &mut context),
        Command::Prefilter(args) => environment::run(&args, &mut context),
        Command::Compare(args) => compare::run(&args, &mut context),
        Command::Stability(args) => stability::run(&args, &mut context),
        Command::Chart(args) => chart::run(&args, &mut context),
        Command::Template(args) => template::run(&args),
        Command::Completions { shell } => {
            clap_complete::generate(shell, &mut Cli::command(), "lobelia", &mut std::io::stdout());
            Ok(())
        }
    };
    if let Some(path) = report {
        context.report.failure = outcome.as_ref().err().map(ToString::to_string);
        context.report.finish(crate::sampled::geometry_sha256);
        let written = context.report.write(&path);
        return outcome.and(written);
    }
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        negative_numbers(Cli::command()).debug_assert();
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused_in_every_command() {
        let command = negative_numbers(Cli::command());
        let refused = |line: &str| {
            let matches = command.clone().try_get_matches_from(line.split(' ')).unwrap();
            not_finite(&command, &matches)
        };
        let wrong = refused("lobelia render scene.toml -o a.png --max-error nan").unwrap();
        assert_eq!(wrong, "--max-error is nan, must be a finite number");
        assert!(refused("lobelia rig move --port sim --pan-deg=-inf").unwrap().contains("--pan-deg is -inf"));
        assert!(refused("lobelia prefilter sky -n 4,NaN").unwrap().contains("--exponent is NaN"));
        assert!(refused("lobelia fit a.brdf --wavelengths-nm 450,inf").is_some());
        assert_eq!(refused("lobelia render nan -o a.png --max-error 0.1"), None);
        // All of them, by the grammar.
        fn fractions(command: &clap::Command) -> usize {
            let own = command.get_arguments().filter(|arg| takes_fraction(arg)).count();
            own + command.get_subcommands().map(fractions).sum::<usize>()
        }
        assert!(fractions(&command) > 15, "{}", fractions(&command));
    }

    #[test]
    fn numbers_below_0_are_values_and_no_options() {
        let parsed = |line: &str| {
            let matches = negative_numbers(Cli::command()).try_get_matches_from(line.split(' ')).unwrap();
            Cli::from_arg_matches(&matches).unwrap().command
        };
        assert!(matches!(parsed("lobelia plan rig.toml --density-deg -5"), Command::Plan(_)));
        assert!(matches!(parsed("lobelia rig move --port sim --pan-deg -30"), Command::Rig(_)));
    }
}
