//! Options of near lights by samples of incident radiance.

use clap::Args;

use crate::error::{Error, Result};
use crate::render::Method;
use crate::render::incident::Settings;

/// What only `--method incident` takes.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Options of --method incident")]
pub(super) struct IncidentArgs {
    /// Degree of the spherical harmonics of transfer and of light: higher ones hold sharper shadows [default:
    /// 8]
    #[arg(long, value_name = "L", value_parser = clap::value_parser!(u32).range(1..=8))]
    pub(super) degree: Option<u32>,
    /// Error that samples of incident radiance may make at a vertex, over the root mean square of the
    /// vertices' radiance [default: 0.01]
    #[arg(long, value_name = "E")]
    pub(super) epsilon: Option<f64>,
}

impl IncidentArgs {
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
        let Self { degree, epsilon } = *self;
        let given = degree.is_some() || epsilon.is_some();
        if given && method.is_none_or(|method| method.name != "incident") {
            return Err(Error::input("--degree and --epsilon go with --method incident"));
        }
        let base = Settings::default();
        Ok(Settings {
            degree: degree.unwrap_or(base.degree),
            epsilon: epsilon.unwrap_or(base.epsilon),
            samples: samples.unwrap_or(base.samples),
            seed,
            ..base
        })
    }
}
