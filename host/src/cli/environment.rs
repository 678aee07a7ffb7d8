//! Options of prefiltered environments, and `lobelia prefilter`.

use std::path::{Path, PathBuf};

use clap::Args;

use super::Context;
use super::methods::options;
use crate::error::{Error, Result};
use crate::files;
use crate::progress;
use crate::render::environment::{Encoding, Settings, prefilter};
use crate::render::{Method, Picture};
use crate::scene::Environment;

/// What only `--method environment` takes.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Options of --method environment")]
pub(super) struct EnvironmentArgs {
    /// How prefiltered maps encode the exponent [default: slices]
    #[arg(long, value_parser = options(&Encoding::ALL, Encoding::option))]
    pub(super) encoding: Option<Encoding>,
    /// Relative error of the prefiltered maps, RMS over directions; their resolution and number follow from
    /// it [default: 0.01]
    #[arg(long, value_name = "E")]
    pub(super) map_error: Option<f32>,
    /// Takes the cosine at a lobe's peak, as published, and lets light from below the horizon in
    #[arg(long)]
    pub(super) no_horizon: bool,
    /// Takes diffuse light from nine spherical harmonics instead of a map
    #[arg(long)]
    pub(super) harmonics: bool,
    /// Prefilters and draws on the GPU
    #[arg(long)]
    pub(super) gpu: bool,
}

impl EnvironmentArgs {
    /// The settings for a method, with the samples a pixel if they are given.
    ///
    /// # Errors
    /// An input error when another method is given any of these.
    pub(super) fn settings(
        &self,
        method: Option<&Method>,
        samples: Option<u32>,
        seed: u64,
    ) -> Result<Settings> {
        let Self { encoding, map_error, no_horizon, harmonics, gpu } = *self;
        let given = encoding.is_some() || map_error.is_some() || no_horizon || harmonics || gpu;
        if given && method.is_none_or(|method| method.name != "environment") {
            return Err(Error::input(
                "--encoding, --map-error, --no-horizon, --harmonics and --gpu go with --method environment",
            ));
        }
        let base = Settings::default();
        Ok(Settings {
            encoding: encoding.unwrap_or(base.encoding),
            map_error: map_error.unwrap_or(base.map_error),
            horizon: !no_horizon,
            harmonics,
            gpu,
            samples: samples.unwrap_or(base.samples),
            seed,
        })
    }
}

/// Arguments of `lobelia prefilter`.
#[derive(Debug, Args)]
pub(super) struct PrefilterArgs {
    /// The environment, an equirectangular .exr or .hdr, or one that is shipped: studio, sky
    environment: PathBuf,
    /// Exponents of the lobes
    #[arg(short = 'n', long = "exponent", value_delimiter = ',', required = true)]
    exponents: Vec<f32>,
    /// Folder for a map an exponent: n-16.exr holds ∫ (ω_p·ω)ⁿ L dω / ∫ (ω_p·ω)ⁿ dω for ω_p at the pixels'
    /// centres
    #[arg(short, long, default_value = "prefiltered")]
    output: PathBuf,
    /// Rows of every map, instead of as many as its exponent needs for --map-error
    #[arg(long, value_parser = clap::value_parser!(u32).range(4..=8192))]
    height: Option<u32>,
    /// Relative error of bilinear lookups in the maps, RMS over directions; rows follow from it
    #[arg(long, value_name = "E", default_value_t = Settings::default().map_error)]
    map_error: f32,
}

/// Runs `lobelia prefilter`.
pub(super) fn run(args: &PrefilterArgs, context: &mut Context) -> Result<()> {
    files::try_folder(&args.output)?;
    let environment = open(&args.environment)?;
    if args.environment.exists() {
        context.report.input(&args.environment);
    }
    if let Some(n) = args.exponents.iter().find(|n| !(0.25..=1e5).contains(*n)) {
        return Err(Error::input(format!("an exponent of {n} cannot be prefiltered; use 0.25 to 100000")));
    }
    let file = |n: f32| args.output.join(format!("n-{n}.exr"));
    if let Some(own) = args.exponents.iter().map(|n| file(*n)).find(|own| files::same(own, &args.environment))
    {
        let message = "the environment, which its own map would be written over; give -o another folder";
        return Err(Error::input(format!("{}: {message}", own.display())));
    }
    files::create_folder(&args.output)?;
    let bar = progress::bar("prefilter", args.exponents.len() as u64, "maps");
    let height = args.height.map(|height| height as usize);
    let mut maps = context
        .report
        .stage("project", || prefilter(&environment, &args.exponents, height, args.map_error))?;
    for n in &args.exponents {
        let Some(map) = context.report.stage("prefilter", || maps.next()) else { break };
        let path = file(*n);
        let pixels = map.pixels.iter().map(|pixel| pixel.extend(1.0)).collect();
        Picture { width: map.width, height: map.height, pixels }.write(&path, 1.0)?;
        bar.advance(1);
        println!("{}: {} × {} pixels", path.display(), map.width, map.height);
    }
    Ok(())
}

/// An environment by the name of a shipped one or of its file.
///
/// # Errors
/// Input errors of the file.
pub(super) fn open(name: &Path) -> Result<Environment> {
    match name.to_str() {
        Some("studio") => Ok(Environment::studio()),
        Some("sky") => Ok(Environment::sky()),
        _ => Environment::read(name),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::Rgb;

    #[test]
    fn options_go_with_no_other_method() {
        let args = EnvironmentArgs { gpu: true, no_horizon: true, ..EnvironmentArgs::default() };
        assert_eq!(args.settings(Method::find("lights"), None, 1).unwrap_err().exit_code(), 2);
        let settings = args.settings(Method::find("environment"), Some(4), 1).unwrap();
        assert_eq!((settings.gpu, settings.horizon, settings.samples), (true, false, 4));
        assert_eq!(
            EnvironmentArgs::default().settings(Method::find("environment"), None, 0).unwrap(),
            Settings::default()
        );
    }

    #[test]
    fn maps_of_even_light_are_even_and_an_exponent_out_of_range_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let even = folder.path().join("even.exr");
        exr::prelude::write_rgb_file(&even, 16, 8, |_, _| (2.0f32, 1.0f32, 0.5f32)).unwrap();
        let mut args = PrefilterArgs {
            environment: even,
            exponents: vec![1.0, 12.0],
            output: folder.path().join("maps"),
            height: Some(8),
            map_error: 0.03,
        };
        let context = || Context {
            seed: 1,
            given_seed: None,
            quiet: true,
            verbose: false,
            report: crate::report::Report::new("prefilter", 1),
        };
        run(&args, &mut context()).unwrap();
        for name in ["n-1.exr", "n-12.exr"] {
            let map = Environment::read(&args.output.join(name)).unwrap();
            assert_eq!((map.width, map.height), (16, 8));
            let error = |p: &Rgb| (*p / Rgb::new(2.0, 1.0, 0.5) - Rgb::ONE).abs().max_element();
            assert!(map.pixels.iter().all(|pixel| error(pixel) < 0.02), "{name}");
        }
        args.exponents = vec![0.0];
        assert_eq!(run(&args, &mut context()).unwrap_err().exit_code(), 2);
    }
}
