//! `lobelia render`: a picture of a scene file.

use std::path::PathBuf;
use std::time::Instant;

use super::Context;
use crate::error::{Error, Result};
use crate::render::{self, Method, reference};
use crate::report::Stage;
use crate::scene::Scene;

/// Render a scene of SBRDF materials.
#[derive(Debug, clap::Args)]
pub(super) struct RenderArgs {
    /// The scene (TOML).
    pub(super) scene: PathBuf,
    /// Where the picture goes: .exr is linear, .png is tone-mapped. May be given more than once.
    #[arg(short, long = "output", required = true)]
    pub(super) output: Vec<PathBuf>,
    /// How to render.
    #[arg(long, value_enum, default_value_t = Method::Auto)]
    pub(super) method: Method,
    /// Samples a pixel of the reference.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    pub(super) samples: u32,
    /// Pixels a row, instead of the scene's.
    #[arg(long)]
    pub(super) width: Option<u32>,
    /// Rows, instead of the scene's.
    #[arg(long)]
    pub(super) height: Option<u32>,
}

/// What was done, for the report.
#[derive(Debug)]
pub(super) struct RenderOutcome {
    /// Seconds a stage: `load`, `prepare`, `render`, `write`.
    pub(super) stages: Vec<(&'static str, f64)>,
    /// The method that made the picture; never [`Method::Auto`].
    pub(super) method: Method,
    /// The GPU that drew it; `None` for the CPU.
    pub(super) adapter: Option<String>,
    /// Why `auto` did not use the GPU.
    pub(super) note: Option<String>,
    /// Size of the picture in pixels.
    pub(super) size: (usize, usize),
    /// Rays cast by the reference.
    pub(super) rays: u64,
    /// The files written.
    pub(super) written: Vec<PathBuf>,
}

/// Runs `lobelia render`.
pub(super) fn run(args: &RenderArgs, context: &mut Context) -> Result<()> {
    context.report.input(&args.scene);
    let outcome = render_scene(args, context.seed)?;
    if let Some(note) = &outcome.note {
        context.note(format!("rendered on the CPU: {note}"));
    }
    let stages = outcome.stages.iter().map(|&(name, seconds)| Stage { name: name.into(), seconds });
    context.report.stages.extend(stages);
    context.report.machine.gpu = outcome.adapter.clone();
    context.report.figure("pixels", vec![outcome.size.0, outcome.size.1]);
    context.report.figure("rays", outcome.rays);
    context.report.figure("method", format!("{:?}", outcome.method).to_lowercase());
    let by = outcome.adapter.as_deref().unwrap_or("the CPU");
    let seconds: f64 = outcome.stages.iter().map(|(_, seconds)| seconds).sum();
    for path in &outcome.written {
        println!(
            "{}: {} × {} pixels by {by}, {seconds:.1} s",
            path.display(),
            outcome.size.0,
            outcome.size.1
        );
    }
    Ok(())
}

/// Reads the scene, renders it, writes every picture.
///
/// # Errors
/// Input errors for the scene and for names of pictures; failures of the GPU (unless `--method auto`) and of the disk.
fn render_scene(args: &RenderArgs, seed: u64) -> Result<RenderOutcome> {
    for path in &args.output {
        if render::picture_kind(path).is_none() {
            return Err(Error::input(format!("{}: a picture's name ends in .exr or .png", path.display())));
        }
    }
    let start = Instant::now();
    let mut scene = Scene::read(&args.scene)?;
    scene.camera.width = args.width.unwrap_or(scene.camera.width);
    scene.camera.height = args.height.unwrap_or(scene.camera.height);
    let loaded = start.elapsed().as_secs_f64();

    let settings = reference::Settings { samples: args.samples, seed };
    let chosen = render::render(&scene, args.method, &settings)?;
    let writing = Instant::now();
    let rendering = chosen.rendering;
    for path in &args.output {
        rendering.picture.write(path, scene.exposure)?;
    }
    let stages = vec![
        ("load", loaded),
        ("prepare", rendering.cost.prepare_seconds),
        ("render", rendering.cost.render_seconds),
        ("write", writing.elapsed().as_secs_f64()),
    ];
    Ok(RenderOutcome {
        stages,
        method: chosen.method,
        adapter: rendering.adapter,
        note: chosen.note,
        size: (rendering.picture.width, rendering.picture.height),
        rays: rendering.cost.rays,
        written: args.output.clone(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(folder: &std::path::Path, method: Method, outputs: &[&str]) -> RenderArgs {
        let scene = folder.join("scene.toml");
        let text = "[camera]\nposition = [0, 1, 4]\ntarget = [0, 0, 0]\nfov_deg = 40\nwidth = 64\nheight = 48\n\
            [[object]]\nmesh = \"sphere\"\nmaterial.published = \"clay\"\n\
            [[light]]\nkind = \"directional\"\ntoward = [1, 1, 1]\nirradiance = [3, 3, 3]\n";
        std::fs::write(&scene, text).unwrap();
        RenderArgs {
            scene,
            output: outputs.iter().map(|name| folder.join(name)).collect(),
            method,
            samples: 4,
            width: Some(32),
            height: None,
        }
    }

    #[test]
    fn both_kinds_of_picture_are_written_with_the_size_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let outcome = render_scene(&args(folder.path(), Method::Reference, &["a.exr", "a.png"]), 1).unwrap();
        assert_eq!((outcome.size, outcome.method), ((32, 48), Method::Reference));
        assert!(outcome.rays > 32 * 48 * 4);
        assert_eq!(image::image_dimensions(folder.path().join("a.png")).unwrap(), (32, 48));
        assert!(folder.path().join("a.exr").exists());
    }

    #[test]
    fn auto_makes_a_picture_with_a_gpu_or_without() {
        let folder = tempfile::tempdir().unwrap();
        let outcome = render_scene(&args(folder.path(), Method::Auto, &["a.png"]), 1).unwrap();
        assert_eq!(outcome.adapter.is_some(), outcome.method == Method::Lights);
        assert_eq!(outcome.note.is_some(), outcome.method == Method::Reference);
    }

    #[test]
    fn a_name_of_no_known_kind_is_refused_before_any_work() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path(), Method::Auto, &["a.bmp"]);
        args.scene = "missing.toml".into();
        let error = render_scene(&args, 1).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("a.bmp"), "{error}");
    }
}
