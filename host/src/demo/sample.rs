//! The demo's sample: a board of four materials with two lobes each, which two-lobe fits can meet exactly.

use crate::acquire::recipe::{LobeRecipe, MaterialRecipe, PatternRecipe, Recipe};

/// The recipe of the demo's sample.
pub fn recipe() -> Recipe {
    let lobe = |rho_s, c, n| LobeRecipe { rho_s, c, n };
    let material = |rho_d, lobes: [LobeRecipe; 2]| MaterialRecipe {
        rho_d: Some(rho_d),
        lobes: lobes.to_vec(),
        ..MaterialRecipe::default()
    };
    let materials = vec![
        // Red lacquer: a clear coat over a broad red sheen.
        material(
            [0.110, 0.012, 0.010],
            [
                lobe([0.45, 0.45, 0.45], [-1.0, -1.0, 1.0], 60.0),
                lobe([0.16, 0.03, 0.03], [-0.9, -0.9, 1.0], 7.0),
            ],
        ),
        // Gold paper: metallic, off-specular.
        material(
            [0.040, 0.028, 0.008],
            [
                lobe([0.95, 0.66, 0.22], [-1.0, -1.0, 0.9], 40.0),
                lobe([0.20, 0.13, 0.04], [-1.0, -1.0, 0.8], 6.0),
            ],
        ),
        // Blue satin: a soft highlight and some light sent back to where it came from.
        material(
            [0.012, 0.030, 0.090],
            [
                lobe([0.22, 0.26, 0.36], [-1.0, -1.0, 0.95], 18.0),
                lobe([0.06, 0.08, 0.16], [0.9, 0.9, 0.8], 8.0),
            ],
        ),
        // Green felt: almost no highlight, but bright at grazing angles and backward.
        material(
            [0.020, 0.070, 0.026],
            [
                lobe([0.05, 0.10, 0.05], [-1.0, -1.0, 0.4], 5.0),
                lobe([0.05, 0.12, 0.05], [1.0, 1.0, 0.3], 12.0),
            ],
        ),
    ];
    Recipe { pattern: PatternRecipe::Checks { size_mm: 8.0 }, materials }
}
