//! `lobelia template`: example files to start from.

use clap::{Args, ValueEnum};

use crate::error::{Error, Result};
use crate::rig::config::RigConfig;

/// Arguments of `lobelia template`.
#[derive(Debug, Args)]
pub(super) struct TemplateArgs {
    /// Which file
    kind: Kind,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// rig.toml: axes, camera, lamp, carrier
    Rig,
    /// A material recipe for the simulator
    #[cfg(feature = "sim")]
    Material,
}

/// Runs `lobelia template`.
pub(super) fn run(args: &TemplateArgs) -> Result<()> {
    let text = match args.kind {
        Kind::Rig => toml::to_string(&RigConfig::default()),
        #[cfg(feature = "sim")]
        Kind::Material => toml::to_string(&crate::demo::sample::recipe()),
    };
    let text = text.map_err(|error| Error::failure(format!("the example cannot be written: {error}")))?;
    let heading = match args.kind {
        Kind::Rig => {
            "# A rig. Lengths in mm, angles in degrees, times in s; keys left out keep the values shown here.\n"
        }
        #[cfg(feature = "sim")]
        Kind::Material => {
            "# A sample for the simulator. A material is `published = NAME`, `table = FILE.brdf`, or rho_d and lobes.\n\
             # Patterns: stripes (width_mm), checks (size_mm), weave (pitch_mm), image (path).\n"
        }
    };
    print!("{heading}{text}");
    Ok(())
}
