//! `lobelia synth`: a known material as a sampled SBRDF with noise.

use std::path::{Path, PathBuf};

use clap::Args;

use super::Context;
use crate::error::{Error, Result};
use crate::progress::counted;
use crate::reflectance::{Brdf, SbrdfMap, materials};
use crate::sampled::{SampledSbrdf, attributes_of};
use crate::synth::{self, Options};
use crate::{files, memory};

/// Arguments of `lobelia synth`.
#[derive(Debug, Clone, Args)]
pub(super) struct SynthArgs {
    /// A published material (`felt`), an SBRDF map (FILE.exr) or a recipe (FILE.toml)
    material: String,
    /// Zarr store to write
    #[arg(short, long, default_value = "sampled.zarr")]
    output: PathBuf,
    /// Texels across and down; a map keeps its own size
    #[arg(long, default_value = "64x64", value_name = "WIDTHxHEIGHT", value_parser = parse_size)]
    size: (usize, usize),
    /// Edge of a texel, mm
    #[arg(long, default_value_t = 0.5, value_name = "MM")]
    texel_mm: f64,
    /// Random pairs of light and camera directions
    #[arg(long, default_value_t = 456, value_name = "N")]
    poses: usize,
    /// Standard deviation of the noise on every value, 1/sr
    #[arg(long, default_value_t = 0.0, value_name = "SIGMA")]
    noise: f64,
    /// Standard deviation of the noise that is a share of the value
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    relative_noise: f64,
}

/// `256x128` as numbers above 0.
fn parse_size(text: &str) -> std::result::Result<(usize, usize), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match sides {
        Some((width, height)) if width > 0 && height > 0 => Ok((width, height)),
        _ => Err("must be WIDTHxHEIGHT, such as 256x256".into()),
    }
}

/// Runs `lobelia synth`.
///
/// # Errors
/// Input errors for a material that cannot be read and numbers that make no sense; failures of the disk.
pub(super) fn run(args: &SynthArgs, context: &mut Context) -> Result<()> {
    SampledSbrdf::may_write_zarr(&args.output)?;
    let options = args.options(context.seed)?;
    let file = Path::new(&args.material);
    if file.is_file() {
        context.input_with_parts(file);
    }
    let sampled = context.report.stage("sample", || sampled(&args.material, options))?;
    let texts = context.report.provenance();
    context.report.stage("write", || sampled.write_zarr_with(&args.output, &attributes_of(texts)))?;
    context.report.figure("texels", sampled.texels());
    context.report.figure("poses", sampled.poses.len());
    println!(
        "{}: {} × {} texels × {}",
        args.output.display(),
        sampled.width,
        sampled.height,
        counted(sampled.poses.len() as u64, "pose", "poses")
    );
    Ok(())
}

impl SynthArgs {
    fn options(&self, seed: u64) -> Result<Options> {
        for (name, value, least) in [
            ("--texel-mm", self.texel_mm, f64::MIN_POSITIVE),
            ("--noise", self.noise, 0.0),
            ("--relative-noise", self.relative_noise, 0.0),
        ] {
            if !value.is_finite() || value < least {
                let bound = if least > 0.0 { "above 0" } else { "0 or more" };
                return Err(Error::input(format!("{name} is {value}, must be {bound}")));
            }
        }
        if self.poses == 0 {
            return Err(Error::input("--poses is 0, must be 1 or more"));
        }
        let (width, height) = self.size;
        fits(width, height, self.poses)?;
        Ok(Options {
            width: self.size.0,
            height: self.size.1,
            texel_mm: self.texel_mm,
            poses: self.poses,
            noise: self.noise,
            relative_noise: self.relative_noise,
            seed,
        })
    }
}

/// Refuses a sample that is larger than memory: a value and its standard deviation a channel.
fn fits(width: usize, height: usize, poses: usize) -> Result<()> {
    let bytes = (width as u128 * height as u128).saturating_mul(poses as u128).saturating_mul(3 * (4 + 2));
    let what = format!("a sample of {width} × {height} texels × {poses} poses");
    memory::check(bytes, &what, "give --size or --poses less")
}

/// The samples of what `material` names.
fn sampled(material: &str, options: Options) -> Result<SampledSbrdf> {
    let path = Path::new(material);
    match files::ending(path).as_str() {
        "exr" => {
            let map = SbrdfMap::read_exr(path).map_err(Error::format)?;
            let options = Options { width: map.width, height: map.height, ..options };
            fits(map.width, map.height, options.poses)?;
            Ok(synth::sample(&options, |index, _, wi, wo| map.eval(index, wi, wo)))
        }
        #[cfg(feature = "sim")]
        "toml" => {
            let carrier = crate::rig::config::Carrier {
                sample_width_mm: options.width as f64 * options.texel_mm,
                sample_height_mm: options.height as f64 * options.texel_mm,
                ..crate::rig::config::RigConfig::default().carrier
            };
            let layout = crate::acquire::recipe::Recipe::read(path, &carrier)?;
            Ok(synth::sample(&options, |_, place, wi, wo| layout.at(place.x, place.y).eval(wi, wo)))
        }
        _ => {
            let brdf = materials::published(material).ok_or_else(|| {
                let known = materials::NAMES.join(", ");
                Error::input(format!(
                    "`{material}` is neither a published material ({known}), nor the name of an SBRDF map \
                     (.exr) or a recipe (.toml)"
                ))
            })?;
            Ok(synth::sample(&options, |_, _, wi, wo| brdf.eval(wi, wo)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> Options {
        Options { width: 4, height: 3, texel_mm: 2.0, poses: 5, noise: 0.0, relative_noise: 0.0, seed: 1 }
    }

    #[test]
    fn a_recipe_is_laid_out_over_the_sample_and_a_map_keeps_its_size() {
        let folder = tempfile::tempdir().unwrap();
        let recipe = folder.path().join("two.toml");
        let text = "pattern = { kind = \"stripes\", width_mm = 4.0 }\n\
            [[material]]\nrho_d = [0.1, 0.1, 0.1]\n[[material]]\nrho_d = [0.2, 0.2, 0.2]\n";
        std::fs::write(&recipe, text).unwrap();
        let striped = sampled(recipe.to_str().unwrap(), options()).unwrap();
        let first: Vec<f32> = (0..4).map(|index| striped.values(index)[0]).collect();
        assert!(first[0] == first[1] && first[2] == first[3] && first[1] != first[2], "{first:?}");
        let map = folder.path().join("map.exr");
        SbrdfMap::new(2, 5, 1).write_exr(&map).unwrap();
        let black = sampled(map.to_str().unwrap(), options()).unwrap();
        assert_eq!((black.width, black.height), (2, 5));
        let unknown = sampled("velvet", options()).unwrap_err();
        assert!(unknown.exit_code() == 2 && unknown.to_string().contains("brushed-metal"));
    }

    #[test]
    fn sizes_are_two_numbers_above_0() {
        assert_eq!(parse_size("256x128"), Ok((256, 128)));
        for wrong in ["256", "0x4", "4x", "-1x3"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
    }
}
