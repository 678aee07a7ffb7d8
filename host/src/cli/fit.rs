//! `lobelia fit`: a sampled SBRDF into an SBRDF map, at once or in parts, or one measured table into lobes a
//! wavelength.

mod args;
mod held_out;
mod parts;
mod pool;
mod table;
mod words;

use std::path::Path;
use std::time::Instant;

use crate::error::{Error, Result};
use crate::files;
use crate::findings::{Findings, Summary};
use crate::fit::chunks;
use crate::fit::held_out::{HeldOut, left_out};
use crate::fit::{Device, FitOptions, gpu};
use crate::mip;
use crate::progress::counted;
use crate::provenance::Texts;
use crate::reflectance::{MapEncoding, SbrdfMap};
use crate::report::Report;
use crate::sampled::SampledStore;
use crate::warning::samples::Tally;
use crate::warning::texels::unexplained_in_words;

pub(super) use args::FitArgs;

/// Runs `lobelia fit` and notes errors, figures and time.
///
/// # Errors
/// As [`fit_input`].
pub(super) fn run(args: &FitArgs, context: &mut super::Context) -> Result<()> {
    let asked_to_merge = !args.merge.is_empty();
    let mut args = args.with_store_named_last();
    if asked_to_merge && args.merge.is_empty() {
        return Err(Error::input("--merge names no shard: give it those that --chunks wrote"));
    }
    args.input.iter().chain(&args.merge).chain(&args.pool).for_each(|path| context.report.input(path));
    args.made = made(&args, &context.report);
    let seed = context.seed;
    let outcome = context.report.stage("fit", || fit_input(&args, seed))?;
    context.report.errors.extend(outcome.errors);
    context.report.figures.extend(outcome.figures);
    context.warn(outcome.warnings);
    Ok(())
}

/// What maps say of how they were made, and which poses of their samples weigh nothing. Of a sampled SBRDF
/// the hash is that of its size and poses: for one of the samples each part of a fit would have to read them
/// all.
fn made(args: &FitArgs, report: &Report) -> Texts {
    let mut of_map = Report { inputs: Vec::new(), ..report.clone() };
    let mut weightless = None;
    if let Some(input) = &args.input {
        match SampledStore::open(input) {
            Ok(store) => {
                of_map.input_by(input, store.geometry_sha256());
                weightless = left_out(&store.poses);
            }
            Err(_) => of_map.input(input),
        }
    }
    args.pool.iter().for_each(|index| of_map.input(index));
    of_map.provenance().into_iter().chain(weightless).collect()
}

/// Prints what was found to stdout and writes the map where one is asked for. `seed` is that of the random
/// starts.
///
/// # Errors
/// Input errors for files and options that make no sense; failures of the disk.
fn fit_input(args: &FitArgs, seed: u64) -> Result<Findings> {
    args.output.iter().try_for_each(|output| files::try_file(output))?;
    if let Some(output) = &args.output
        && files::ending(output) != "exr"
    {
        return Err(Error::input(format!("{}: an SBRDF map's name ends in .exr", output.display())));
    }
    if !args.merge.is_empty() {
        return parts::merge(args, seed);
    }
    let Some(input) = &args.input else {
        return Err(Error::input("there is nothing to fit: name a sampled SBRDF or a measured table"));
    };
    match files::ending(input).as_str() {
        "zarr" => fit_sampled(args, input, seed),
        "brdf" | "dat" | "txt" | "alta" | "binary" => table::fit(args, input, seed),
        _ if files::what_is(input) == Some("a run") => {
            let run = input.display();
            Err(Error::input(format!(
                "{run}: a run; develop it first: lobelia develop {run} -o sampled.zarr"
            )))
        }
        _ => Err(Error::input(format!(
            "{}{}: `fit` reads a sampled SBRDF (.zarr) or a measured table (.brdf, .dat, .txt, .alta, \
             .binary); the name's ending must say which",
            input.display(),
            files::what_is(input).map_or_else(String::new, |what| format!(": {what}"))
        ))),
    }
}

/// The map to write, which a sampled SBRDF needs.
fn output(args: &FitArgs) -> Result<&Path> {
    let message = "a sampled SBRDF needs -o FILE.exr, the SBRDF map to write";
    args.output.as_deref().ok_or_else(|| Error::input(message))
}

/// On Ctrl-C says what is kept and how to go on, and ends. Writing is atomic, so nothing half-written is left
/// in a map's place.
fn say_when_interrupted(part: bool) {
    let hint = if part {
        "this part is not written; the same command does it again, and parts that are done are kept"
    } else {
        "nothing is written; the same command begins again, and one in parts (--chunks 1/8 to 8/8, then \
         --merge) keeps those that are done"
    };
    // A second handler in one process is refused; the first one serves.
    let _ = ctrlc::set_handler(move || {
        eprintln!("lobelia: the fit was interrupted: {hint}");
        std::process::exit(1);
    });
}

fn fit_sampled(args: &FitArgs, input: &Path, seed: u64) -> Result<Findings> {
    let output = output(args)?;
    texel_options(args, None)?;
    if args.chunks.is_some() && args.mip {
        return Err(Error::input(
            "a part has the finest level alone; give --mip to --merge, which fits the others",
        ));
    }
    let mut store = SampledStore::open(input)?;
    let held = held_out::hold_out(args, &mut store, seed)?;
    say_when_interrupted(args.chunks.is_some());
    let mut options = texel_options(args, Some(&store))?;
    if let Some(part) = args.chunks {
        return parts::fit(&store, &options, part, held.as_ref(), output, &args.made);
    }
    if let Some(index) = &args.pool {
        let tally = Tally::default();
        let mut outcome = pool::fit(args, &store, &options, index, held.as_ref(), seed, &tally)?;
        outcome.add_samples(&store, tally);
        return Ok(outcome);
    }
    options.device = args.request().device(&store, &options)?;
    let start = Instant::now();
    let tally = Tally::default();
    let mut map = chunks::fit_store_counted(&store, &options, &tally)?;
    let seconds = start.elapsed().as_secs_f64();
    map.attributes.extend(args.made.clone());
    held.iter().for_each(|held| held.note(&mut map));
    write_map(&map, output, args.encoding())?;
    if args.mip {
        write_levels(&store, &options, (output, &map, args.encoding()), (&args.made, held.as_ref()))?;
    }
    let summary = Summary::new(&map);
    let mut outcome = Findings::of_map(&map, &summary);
    rate(&mut outcome, summary.texels, seconds);
    let held_out = held_out::judge(held.as_ref(), &store, &map, &mut outcome)?;
    outcome.add_samples(&store, tally);
    outcome.add_fit(&store, &map, &options)?;
    let (texels, poses) = (store.width * store.height, store.poses.len());
    let device = match options.device {
        Device::Cpu => String::new(),
        Device::Gpu => format!(" on {}", gpu::name()?),
    };
    print(&format!(
        "{texels} texels × {}, {} by {}{device}: {seconds:.1} s\n{}",
        counted(poses as u64, "pose", "poses"),
        words::lobes(&map, &options),
        options.method.name(),
        words::residuals(&summary)
            + &held_out
            + &words::albedos(&summary)
            + &words::mirrors(&summary)
            + &words::ties(&summary)
            + &unexplained_in_words(&map)
    ))?;
    Ok(outcome)
}

/// How texels are fitted; on the CPU unless the GPU was named.
fn texel_options(args: &FitArgs, store: Option<&SampledStore>) -> Result<FitOptions> {
    if !args.hold_out_theta_deg.is_empty() || args.random_starts > 0 || args.hold_out_each_pair {
        return Err(Error::input(
            "--hold-out-theta-deg, --hold-out-each-pair and --random-starts are for measured tables (.brdf)",
        ));
    }
    if !args.wavelengths_nm.is_empty() {
        return Err(Error::input(
            "--wavelengths-nm is for measured tables (.brdf); a sampled SBRDF has red, green and blue",
        ));
    }
    args.request().of_texels(store)
}

/// Notes how fast texels were fitted.
fn rate(outcome: &mut Findings, texels: usize, seconds: f64) {
    outcome.figure("texels_per_second", texels as f64 / seconds.max(1e-9));
}

/// Fits all MIP levels but the finest and writes each beside it, with how it was made and which poses were
/// held out.
fn write_levels(
    store: &SampledStore,
    options: &FitOptions,
    (finest, map, encoding): (&Path, &SbrdfMap, MapEncoding),
    (made, held): (&Texts, Option<&HeldOut>),
) -> Result<()> {
    for level in chunks::fit_levels(store, options, map) {
        let (level, mut map) = level?;
        map.attributes.extend(made.clone());
        held.iter().for_each(|held| held.note(&mut map));
        write_map(&map, &mip::path(finest, level), encoding)?;
    }
    Ok(())
}

fn write_map(map: &SbrdfMap, path: &Path, encoding: MapEncoding) -> Result<()> {
    map.write_exr_as(path, encoding).map_err(|error| Error::writing(path, error))
}

fn print(text: &str) -> Result<()> {
    use std::io::Write as _;
    match std::io::stdout().write_all(text.as_bytes()) {
        // Whoever read the output has seen enough.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        written => written.map_err(|error| Error::failure(format!("stdout: {error}")).caused_by(error)),
    }
}

#[cfg(test)]
mod tests;
