//! `lobelia render`: a picture of a scene file.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::Context;
use super::environment::EnvironmentArgs;
use super::incident::IncidentArgs;
use super::methods::{self, MethodArg, options};
use super::paths::PathArgs;
use crate::chart::Table;
use crate::error::{Error, Result};
use crate::figures::ErrorFigure;
use crate::files;
use crate::memory;
use crate::progress::counted;
use crate::render::choose::{Tried, taken};
use crate::render::compare::{Errors, compare};
use crate::render::lights::{self, Filtering};
use crate::render::storage::Storage;
use crate::render::{self, Cost, Job, Method, Picture, PictureKind, Rendering, Uses, reference};
use crate::report::Stage;
use crate::scene::{Scene, State};

/// Render a scene of SBRDF materials.
#[derive(Debug, clap::Args)]
pub(super) struct RenderArgs {
    /// The scene: a .toml file, or one that is shipped: studio-ball, sky-drape, lamps, window, metal-row,
    /// gallery, teapot, glass-mirror, lanterns, panels
    pub(super) scene: PathBuf,
    /// Where the picture goes: .exr is linear, .png is tone-mapped. May be given more than once. A name
    /// with # (frame-##.png) takes every frame of the scene's animation
    #[arg(short, long = "output", required = true)]
    pub(super) output: Vec<PathBuf>,
    /// How to render
    #[arg(long, default_value = "auto", value_parser = methods::or_auto())]
    pub(super) method: MethodArg,
    /// A folder of `lobelia bake`, of this scene and of these settings; `auto` without --max-error takes the
    /// method that it is for
    #[arg(long, value_name = "DIR")]
    pub(super) baked: Option<PathBuf>,
    /// Samples a pixel: of the reference [default: 64, or as many as --seconds and --max-error need], of
    /// lights at edges [default: 4, or the most below that the GPU can], of environment and incident
    /// [default: 16]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    pub(super) samples: Option<u32>,
    /// Seconds that the reference may take for a view at most, reading and preparing the scene aside; every
    /// pixel gets a sample at least
    #[arg(long)]
    pub(super) seconds: Option<f64>,
    /// Relative RMSE that the picture may have, 0.01 for 1 %: `auto` measures every method on a small view,
    /// takes the cheapest that meets it and judges its picture by the reference; `reference` stops by its
    /// pixels' variance
    #[arg(long, value_name = "E")]
    pub(super) max_error: Option<f64>,
    /// Frames that what is prepared will be used for: with --max-error `auto` takes the cheapest by the
    /// whole, baking included [default: those of the animation]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) frames: Option<u32>,
    /// Times that the light, or an object, changes between them [default: as in the animation]
    #[arg(long, value_name = "N")]
    pub(super) light_changes: Option<u32>,
    /// Reflections a path of the reference at most; 1 leaves interreflection out [default: 64]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub(super) bounces: Option<u32>,
    /// Writes the variance of every pixel's mean, which the reference estimates
    #[arg(long, value_name = "FILE.exr")]
    pub(super) variance: Option<PathBuf>,
    /// A reference picture of the same view: RMSE, relative RMSE and FLIP against it are told and reported
    #[arg(long, value_name = "FILE.exr")]
    pub(super) against: Option<PathBuf>,
    /// Pixels a row, instead of the scene's; rows follow
    #[arg(long)]
    pub(super) width: Option<u32>,
    /// Rows, instead of the scene's; pixels a row follow when --width is not given
    #[arg(long)]
    pub(super) height: Option<u32>,
    #[command(flatten)]
    pub(super) paths: PathArgs,
    #[command(flatten)]
    pub(super) lights: LightsArgs,
    #[command(flatten)]
    pub(super) environment: EnvironmentArgs,
    #[command(flatten)]
    pub(super) incident: IncidentArgs,
}

/// What only `--method lights` takes.
#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Options of --method lights")]
pub(super) struct LightsArgs {
    /// What a pixel takes of a texture that is smaller than it should be [default: shaded]
    #[arg(long, value_parser = options(&Filtering::ALL, Filtering::option))]
    filter: Option<Filtering>,
    /// Samples of a texture along an axis of the pixel at most; along the longer one with MIP levels
    /// [default: 16]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=256))]
    anisotropy: Option<u32>,
    /// How coefficients are stored on the GPU [default: f32]
    #[arg(long, value_parser = options(&Storage::ALL, Storage::option))]
    storage: Option<Storage>,
    /// Samples of a rectangular light at most, for a pixel that sees it large; fewer from afar [default: 64]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    light_samples: Option<u32>,
    /// Leaves shadows out
    #[arg(long)]
    no_shadows: bool,
}

impl RenderArgs {
    /// What `lights` is to do.
    ///
    /// # Errors
    /// An input error for options of `lights` with another method.
    fn lights(&self) -> Result<lights::Settings> {
        let LightsArgs { filter, anisotropy, storage, light_samples, no_shadows } = self.lights;
        let numbers = anisotropy.is_some() || light_samples.is_some();
        let given = filter.is_some() || numbers || storage.is_some() || no_shadows;
        if given && !self.method.is("lights") {
            return Err(Error::input(
                "--filter, --anisotropy, --storage, --light-samples and --no-shadows go with --method lights",
            ));
        }
        let base = lights::Settings::default();
        Ok(lights::Settings {
            samples: self.samples.unwrap_or(base.samples),
            filtering: filter.unwrap_or(base.filtering),
            anisotropy: anisotropy.unwrap_or(base.anisotropy),
            storage: storage.unwrap_or(base.storage),
            shadows: !no_shadows,
            light_samples: light_samples.unwrap_or(base.light_samples),
        })
    }

    /// What the reference is to do.
    fn settings(&self, seed: u64) -> reference::Settings {
        let budget = self.seconds.is_some() || self.max_error.is_some();
        let mut settings = reference::Settings {
            samples: self.samples.unwrap_or(if budget { 1 << 20 } else { 64 }),
            seconds: self.seconds,
            max_error: self.max_error,
            bounces: self.bounces.unwrap_or(reference::Settings::default().bounces),
            seed,
            ..reference::Settings::default()
        };
        self.paths.apply(&mut settings);
        settings
    }

    /// Refuses what a method that is named would not look at.
    fn check_method(&self) -> Result<()> {
        if (self.frames.is_some() || self.light_changes.is_some())
            && (self.max_error.is_none() || self.method.0.is_some())
        {
            let message =
                "--frames and --light-changes go with --method auto and --max-error, whose choice they weigh";
            return Err(Error::input(message));
        }
        let Some(method) = self.method.0.filter(|method| method.name != "reference") else { return Ok(()) };
        let given = [
            ("--seconds", self.seconds.is_some()),
            ("--max-error", self.max_error.is_some()),
            ("--bounces", self.bounces.is_some()),
            ("--variance", self.variance.is_some()),
        ];
        match given.into_iter().find(|(_, given)| *given) {
            Some((option, _)) => {
                let name = method.name;
                Err(Error::input(format!(
                    "{option} goes with --method reference or auto; --method {name} would not look at it"
                )))
            }
            None => Ok(()),
        }
    }
}

/// What was done, for the report.
#[derive(Debug)]
pub(super) struct RenderOutcome {
    /// Seconds a stage: `load`, `bake`, `prepare`, `light`, `render`, `write`.
    pub(super) stages: Vec<(&'static str, f64)>,
    /// The method that made the picture.
    pub(super) method: &'static Method,
    /// Why `auto` did not take another.
    pub(super) note: Option<String>,
    /// What `auto` tried for an error, by predicted time.
    pub(super) tried: Vec<Tried>,
    /// The picture, the last of an animation, and the cost of all.
    pub(super) rendering: Rendering,
    /// How far it is from the picture given.
    pub(super) errors: Option<Errors>,
    /// The files written.
    pub(super) written: Vec<PathBuf>,
}

/// Runs `lobelia render`.
pub(super) fn run(args: &RenderArgs, context: &mut Context) -> Result<()> {
    if args.scene.exists() {
        context.input_with_parts(&args.scene);
    }
    args.against.iter().chain(&args.baked).for_each(|path| context.report.input(path));
    let outcome = render_scene(args, context.seed)?;
    if let Some(note) = &outcome.note {
        let taken = if outcome.tried.is_empty() { "rendered on the CPU" } else { "a method was left out" };
        context.note(format!("{taken}: {note}"));
    }
    let rendering = &outcome.rendering;
    if let Some(note) = &rendering.note {
        context.note(note);
        context.report.figure("note", note.as_str());
    }
    let (picture, cost) = (&rendering.picture, &rendering.cost);
    let stages = outcome.stages.iter().map(|&(name, seconds)| Stage { name: name.into(), seconds });
    context.report.stages.extend(stages);
    context.report.machine.gpu = rendering.adapter.clone();
    context.report.figure("pixels", vec![picture.width, picture.height]);
    context.report.figure("samples", cost.samples);
    context.report.figure("rays", cost.rays);
    if cost.rays > 0 {
        context.report.figure("rays_per_second", cost.rays as f64 / cost.render_seconds);
    }
    context.report.figure("draws", cost.draws);
    context.report.figure("render_memory_bytes", cost.memory_bytes);
    context.report.figure("method", outcome.method.name);
    let Cost { bake_seconds, light_seconds, view_seconds, .. } = *cost;
    for (name, seconds) in
        [("bake_seconds", bake_seconds), ("light_seconds", light_seconds), ("view_seconds", view_seconds)]
    {
        context.report.figure(name, seconds);
    }
    context.report.figure("bake_rays", cost.bake_rays);
    context.report.figure("baked_bytes", cost.baked_bytes);
    let estimated = rendering.estimated_error();
    if let Some(estimated) = estimated {
        let over = format!("{} pixels × 3 channels", picture.pixels.len());
        context.report.errors.push(ErrorFigure::new("estimated_relative_rmse", estimated, "1", over));
    }
    let errors = outcome.errors.map_or_else(Vec::new, |errors| errors.figures());
    context.report.errors.extend(errors.iter().cloned());

    if !outcome.tried.is_empty() {
        print!("{}", outcomes(&outcome.tried));
    }
    if let Some(Tried { predicted, actual: Some(actual), .. }) = taken(&outcome.tried) {
        for (name, [_, error]) in [("predicted_relative_rmse", predicted), ("verified_relative_rmse", actual)]
        {
            let over = format!("{} pixels × 3 channels", picture.pixels.len());
            context.report.errors.push(ErrorFigure::new(name, *error, "1", over));
        }
    }
    let by = rendering.adapter.as_deref().unwrap_or("the CPU");
    let seconds: f64 = outcome.stages.iter().map(|(_, seconds)| seconds).sum();
    let noise = estimated.map_or_else(String::new, |error| format!(", noise {:.2} %", 100.0 * error));
    let last = outcome.written.last().map_or_else(String::new, |path| path.display().to_string());
    let more = match outcome.written.len() {
        1 => String::new(),
        count => format!(" and {} more", count - 1),
    };
    println!(
        "{last}{more}: {} × {} pixels by {by}, {} a pixel{noise}, {seconds:.1} s",
        picture.width,
        picture.height,
        counted(cost.samples, "sample", "samples")
    );
    for figure in errors {
        println!("{:>14}  {:.5} {} over {}", figure.name, figure.value, figure.unit, figure.over);
    }
    if let (Some(wanted), Some(reached)) = (args.max_error, estimated)
        && reached > wanted
    {
        context.note(format!("--max-error {wanted} was not reached: {reached:.4}"));
    }
    Ok(())
}

/// What was predicted of every setting, and what came out of those that were tried.
pub(super) fn outcomes(tried: &[Tried]) -> Table {
    let mut table = Table::new([
        "method",
        "setting",
        "bake, s",
        "prepare, s",
        "a change of light, s",
        "a frame, s",
        "predicted, s",
        "actual, s",
        "predicted relative RMSE",
        "actual relative RMSE",
        "",
    ]);
    let last = tried.iter().rposition(|one| one.actual.is_some());
    for (index, one) in tried.iter().enumerate() {
        let [seconds, error] = one.actual.unwrap_or([f64::NAN; 2]);
        let verdict = match one.actual {
            Some(_) if Some(index) == last => "chosen",
            Some(_) => "missed",
            None => "",
        };
        table.row([
            one.method.name.into(),
            one.name.as_str().into(),
            one.foreseen.bake.into(),
            one.foreseen.prepare.into(),
            one.foreseen.light.into(),
            one.foreseen.frame.into(),
            one.predicted[0].into(),
            seconds.into(),
            one.predicted[1].into(),
            error.into(),
            verdict.into(),
        ]);
    }
    table
}

/// Reads the scene, renders it, writes every picture.
///
/// # Errors
/// Input errors for the scene and for names of pictures; failures of the GPU (unless `--method auto`) and of
/// the disk.
fn render_scene(args: &RenderArgs, seed: u64) -> Result<RenderOutcome> {
    for path in &args.output {
        if render::picture_kind(path).is_none() {
            return Err(Error::input(format!("{}: a picture's name ends in .exr or .png", path.display())));
        }
    }
    if let Some(path) = &args.variance
        && render::picture_kind(path) != Some(PictureKind::Exr)
    {
        return Err(Error::input(format!("{}: a variance image's name ends in .exr", path.display())));
    }
    args.output.iter().chain(&args.variance).try_for_each(|path| files::try_file(path))?;
    for (name, budget) in [("seconds", args.seconds), ("max-error", args.max_error)] {
        if let Some(value) = budget.filter(|value| value.is_nan() || *value <= 0.0) {
            return Err(Error::input(format!("--{name} is {value}, must be above 0")));
        }
    }
    args.check_method()?;
    let settings = render::Settings {
        reference: args.settings(seed),
        lights: args.lights()?,
        environment: args.environment.settings(args.method.0, args.samples, seed)?,
        incident: args.incident.settings(args.method.0, args.samples, seed)?,
    };
    let start = Instant::now();
    let mut scene = Scene::open(&args.scene)?;
    let keys = scene.animation.iter_mut().flat_map(|animation| &mut animation.keys);
    for camera in std::iter::once(&mut scene.camera).chain(keys.map(|key| &mut key.camera)) {
        let scaled =
            |side: u32, from: u32, to: u32| (side as f32 * to as f32 / from as f32).round().max(1.0) as u32;
        (camera.width, camera.height) = match (args.width, args.height) {
            (Some(width), None) => (width, scaled(camera.height, camera.width, width)),
            (None, Some(height)) => (scaled(camera.width, camera.height, height), height),
            (width, height) => (width.unwrap_or(camera.width), height.unwrap_or(camera.height)),
        };
    }
    let (states, paths): (Vec<State>, Vec<Vec<PathBuf>>) = frames(&scene, args)?.into_iter().unzip();
    args.paths.check(args.method, states.len() > 1)?;
    for State { camera, .. } in &states {
        camera.check()?;
        // Means and variances of a pixel, and the picture in the forms that it is written in.
        let pixels = u128::from(camera.width) * u128::from(camera.height);
        let what = format!("a picture of {} × {} pixels", camera.width, camera.height);
        memory::check(pixels * 64, &what, "give --width less")?;
    }
    let against = args.against.as_deref().map(Picture::read_exr).transpose()?;
    let loaded = start.elapsed().as_secs_f64();

    let own = Uses::of(&states);
    let uses = Uses {
        frames: args.frames.unwrap_or(own.frames),
        light_changes: args.light_changes.unwrap_or(own.light_changes),
    };
    let job = Job {
        method: args.method.0,
        settings,
        // Of a method that is named it is the path tracer's own, which stops by it.
        max_error: args.max_error.filter(|_| args.method.0.is_none()),
        uses: Some(uses),
        baked: args.baked.as_deref(),
    };
    let mut write_seconds = 0.0;
    let drawn = job.run(&scene, &states, |index, rendering| {
        let writing = Instant::now();
        for path in &paths[index] {
            rendering.picture.write(path, scene.exposure)?;
        }
        if let Some(path) = &args.variance {
            // Only the reference takes a budget of time.
            write_variance(rendering, path, args.seconds.filter(|_| rendering.adapter.is_none()))?;
        }
        write_seconds += writing.elapsed().as_secs_f64();
        Ok(())
    })?;
    let cost = drawn.last.cost;
    let errors = against.map(|truth| compare(&drawn.last.picture, &truth)).transpose()?;
    let mut stages = vec![("load", loaded)];
    stages.extend(drawn.choose_seconds.map(|seconds| ("choose", seconds)));
    // What was baked before is no stage of this run.
    let baked_now = cost.bake_seconds > 0.0 && args.baked.is_none();
    stages.extend(baked_now.then_some(("bake", cost.bake_seconds)));
    stages.push(("prepare", cost.prepare_seconds));
    stages.extend((cost.light_seconds > 0.0).then_some(("light", cost.light_seconds)));
    stages.extend([("render", cost.view_seconds + cost.render_seconds), ("write", write_seconds)]);
    let layers = args.paths.write(&scene, &settings.reference)?;
    let written = layers.into_iter().chain(paths.into_iter().flatten()).collect();
    let render::Drawn { method, note, tried, last, .. } = drawn;
    Ok(RenderOutcome { stages, method, note, tried, rendering: last, errors, written })
}

/// The states to render, each with its pictures: the scene's own, or those of the animation when names have a
/// `#`.
///
/// # Errors
/// Input errors for names with `#` beside others, or without an animation.
fn frames(scene: &Scene, args: &RenderArgs) -> Result<Vec<(State, Vec<PathBuf>)>> {
    // Of the name alone: folders may be called as they like.
    let numbered = |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().contains('#'));
    let count = args.output.iter().filter(|path| numbered(path)).count();
    if count == 0 {
        return Ok(vec![(scene.state(), args.output.clone())]);
    }
    if scene.animation.is_none() {
        return Err(Error::input("a picture's name has a #, but the scene has no animation"));
    }
    if count < args.output.len() || args.variance.is_some() || args.against.is_some() {
        return Err(Error::input(
            "an animation goes with names that all have a #, and with neither --variance nor --against",
        ));
    }
    let name = |path: &PathBuf, frame: usize| {
        let text = path.file_name().unwrap_or_default().to_string_lossy();
        let (begin, rest) = text.split_once('#').unwrap_or((&text, ""));
        let end = rest.trim_start_matches('#');
        let digits = 1 + rest.len() - end.len();
        path.with_file_name(format!("{begin}{frame:0digits$}{end}"))
    };
    let named = |(frame, state)| (state, args.output.iter().map(|path| name(path, frame)).collect());
    Ok(scene.frames().into_iter().enumerate().map(named).collect())
}

/// Writes the variance of every pixel's mean; `seconds` is what the reference was given.
fn write_variance(rendering: &Rendering, path: &Path, seconds: Option<f64>) -> Result<()> {
    let variance = rendering.variance.as_ref().ok_or_else(|| {
        let place = path.display();
        let why = match seconds {
            Some(seconds) => {
                format!("--seconds {seconds} and the samples gave one pass, and it takes two; give more")
            }
            None => "use --method reference and 4 samples or more".to_owned(),
        };
        Error::input(format!("{place}: there is no variance: {why}"))
    })?;
    let Picture { width, height, .. } = rendering.picture;
    let pixels = variance.iter().map(|v| v.extend(1.0)).collect();
    Picture { width, height, pixels }.write(path, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(folder: &std::path::Path, method: &str, outputs: &[&str]) -> RenderArgs {
        let scene = folder.join("scene.toml");
        let text = "[camera]\nposition = [0, 1, 4]\ntarget = [0, 0, 0]\nfov_deg = 40\nwidth = 64\nheight = \
             48\n[[object]]\nmesh = \"sphere\"\nmaterial.published = \"clay\"\n[[light]]\nkind = \
             \"directional\"\ntoward = [1, 1, 1]\nirradiance = [3, 3, 3]\n";
        std::fs::write(&scene, text).unwrap();
        RenderArgs {
            scene,
            output: outputs.iter().map(|name| folder.join(name)).collect(),
            method: MethodArg(Method::find(method)),
            baked: None,
            frames: None,
            light_changes: None,
            samples: Some(4),
            seconds: None,
            max_error: None,
            bounces: Some(4),
            variance: None,
            against: None,
            paths: PathArgs::default(),
            lights: LightsArgs::default(),
            environment: EnvironmentArgs::default(),
            incident: IncidentArgs::default(),
            width: Some(32),
            height: None,
        }
    }

    #[test]
    fn both_kinds_of_picture_are_written_with_the_size_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let outcome = render_scene(&args(folder.path(), "reference", &["a.exr", "a.png"]), 1).unwrap();
        let rendering = &outcome.rendering;
        assert_eq!((rendering.picture.width, rendering.picture.height), (32, 24));
        assert_eq!((outcome.method.name, rendering.cost.samples), ("reference", 4));
        assert!(rendering.cost.rays > 32 * 24 * 4 && rendering.cost.memory_bytes > 32 * 24 * 16);
        assert_eq!(image::image_dimensions(folder.path().join("a.png")).unwrap(), (32, 24));
        assert!(folder.path().join("a.exr").exists());
    }

    #[test]
    fn auto_makes_a_picture_with_a_gpu_or_without() {
        let folder = tempfile::tempdir().unwrap();
        let outcome = render_scene(&args(folder.path(), "auto", &["a.png"]), 1).unwrap();
        assert_eq!(outcome.rendering.adapter.is_some(), outcome.method.name == "lights");
        assert_eq!(outcome.note.is_some(), outcome.method.name == "reference");
    }

    #[test]
    fn auto_with_an_error_tells_what_it_predicted_and_what_came_out() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path(), "auto", &["a.png"]);
        (args.samples, args.max_error) = (None, Some(0.1));
        let outcome = render_scene(&args, 1).unwrap();
        let taken = taken(&outcome.tried).unwrap();
        assert!(taken.method == outcome.method && taken.actual.unwrap()[1] <= 0.1, "{:?}", outcome.tried);
        let table = outcomes(&outcome.tried).to_string();
        assert!(table.contains("bake, s") && table.contains("predicted relative RMSE"), "{table}");
        assert!(table.matches("chosen").count() == 1, "{table}");
        assert!(outcome.stages.iter().any(|stage| stage.0 == "choose"));
    }

    #[test]
    fn a_picture_compared_with_itself_has_no_error_and_variance_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path(), "reference", &["a.exr"]);
        args.variance = Some(folder.path().join("v.exr"));
        render_scene(&args, 1).unwrap();
        args.against = Some(folder.path().join("a.exr"));
        let errors = render_scene(&args, 1).unwrap().errors.unwrap();
        assert_eq!((errors.rmse, errors.flip), (0.0, 0.0));
        args.samples = Some(64);
        assert!(render_scene(&args, 1).unwrap().errors.unwrap().rmse > 0.0);
        let variance = Picture::read_exr(&folder.path().join("v.exr")).unwrap();
        assert!(variance.pixels.iter().any(|v| v.x > 0.0));
    }

    #[test]
    fn a_variance_that_the_time_was_too_short_for_is_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path(), "reference", &["a.exr"]);
        args.variance = Some(folder.path().join("v.exr"));
        args.seconds = Some(1e-9);
        let error = render_scene(&args, 1).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("--seconds 0.000000001"), "{error}");
    }

    #[test]
    fn an_animation_writes_a_numbered_picture_a_frame() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path(), "reference", &["f-##.png"]);
        args.samples = Some(1);
        assert!(render_scene(&args, 1).unwrap_err().to_string().contains("no animation"));
        args.scene = "studio-ball".into();
        (args.width, args.height) = (Some(8), Some(6));
        let outcome = render_scene(&args, 1).unwrap();
        assert_eq!((outcome.written.len(), outcome.rendering.picture.height), (24, 6));
        assert!(folder.path().join("f-00.png").exists() && folder.path().join("f-23.png").exists());
    }

    #[test]
    fn a_folder_may_have_a_number_sign_in_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path(), "reference", &["take #2/a.png"]);
        args.samples = Some(1);
        assert_eq!(render_scene(&args, 1).unwrap().written, [folder.path().join("take #2/a.png")]);
        args.scene = "studio-ball".into();
        args.output = vec![folder.path().join("take #2/f-#.png")];
        (args.width, args.height) = (Some(4), Some(3));
        assert_eq!(render_scene(&args, 1).unwrap().written[11], folder.path().join("take #2/f-11.png"));
    }

    #[test]
    fn budgets_that_are_no_numbers_and_pictures_larger_than_memory_are_refused_before_the_work() {
        let folder = tempfile::tempdir().unwrap();
        let args = || args(folder.path(), "auto", &["a.png"]);
        for (max_error, seconds, part) in [
            (Some(f64::NAN), None, "--max-error is NaN"),
            (Some(-0.1), None, "--max-error is -0.1"),
            (None, Some(0.0), "--seconds is 0"),
            (None, Some(f64::NAN), "--seconds is NaN"),
        ] {
            let error = render_scene(&RenderArgs { max_error, seconds, ..args() }, 1).unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains(part), "{error}");
        }
        let error = render_scene(&RenderArgs { width: Some(100_000), ..args() }, 1).unwrap_err();
        assert!(error.exit_code() == 2, "{error}");
    }

    #[test]
    fn options_of_lights_go_with_no_other_method() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path(), "auto", &["a.png"]);
        args.lights.storage = Some(Storage::Bits8);
        assert_eq!(render_scene(&args, 1).unwrap_err().exit_code(), 2);
        args.method = MethodArg(Method::find("lights"));
        let lights = args.lights().unwrap();
        assert_eq!(
            (lights.storage, lights.filtering, lights.shadows),
            (Storage::Bits8, Filtering::Shaded, true)
        );
    }

    /// Each would be taken and change nothing; the variance would be missed after the picture was made.
    #[test]
    fn what_the_reference_alone_looks_at_is_refused_with_a_method_that_does_not() {
        let folder = tempfile::tempdir().unwrap();
        for method in ["lights", "environment"] {
            let args = || RenderArgs { bounces: None, ..args(folder.path(), method, &["a.png"]) };
            for (option, args) in [
                ("--seconds", RenderArgs { seconds: Some(1.0), ..args() }),
                ("--max-error", RenderArgs { max_error: Some(0.1), ..args() }),
                ("--bounces", RenderArgs { bounces: Some(1), ..args() }),
                ("--variance", RenderArgs { variance: Some(folder.path().join("v.exr")), ..args() }),
            ] {
                let error = render_scene(&args, 1).unwrap_err();
                assert!(error.exit_code() == 2 && error.to_string().starts_with(option), "{error}");
            }
        }
        assert!(!folder.path().join("a.png").exists());
    }

    #[test]
    fn a_name_of_no_known_kind_is_refused_before_any_work() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path(), "auto", &["a.bmp"]);
        args.scene = "missing.toml".into();
        let error = render_scene(&args, 1).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("a.bmp"), "{error}");
    }
}
