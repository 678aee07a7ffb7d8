//! The demo's sample: a brocade of four materials with two lobes each, which two-lobe fits can meet exactly.

use std::path::Path;

use lobelia_hil_sim::optics::{Pattern, SampleLayout};

use crate::recipe::{LobeRecipe, MaterialRecipe, PatternRecipe, Recipe};
use lobelia_base::error::Result;
use lobelia_measure::rig::config::Carrier;

/// From one flower to the next, mm.
const REPEAT_MM: f64 = 32.0;

/// Steps of the brocade's pattern a millimetre.
const STEPS_PER_MM: f64 = 4.0;

/// The demo's sample on the carrier.
///
/// # Errors
/// None for the recipe that stands here; the signature is that of every recipe.
pub fn layout(carrier: &Carrier) -> Result<SampleLayout> {
    let materials = recipe().build_materials(Path::new("."))?;
    let steps = |length_mm: f64| (length_mm * STEPS_PER_MM).round().max(1.0) as usize;
    let (columns, rows) = (steps(carrier.sample_width_mm), steps(carrier.sample_height_mm));
    let indices = (0..columns * rows)
        .map(|k| brocade((k % columns) as f64 / STEPS_PER_MM, (k / columns) as f64 / STEPS_PER_MM))
        .collect();
    let pattern = Pattern::Image { columns, rows, indices };
    Ok(SampleLayout::new(carrier.sample_width_mm, carrier.sample_height_mm, materials, pattern))
}

/// The material at a place of the brocade: 0 red hearts, 1 gold flowers, 2 blue ground, 3 green leaves; every
/// other column of flowers is shifted by half a repeat.
fn brocade(x_mm: f64, y_mm: f64) -> u8 {
    let (u, v) = (2.0 * x_mm / REPEAT_MM, y_mm / REPEAT_MM);
    let column = u.floor();
    let across = (u - column - 0.5) * 0.5;
    let down = (v + 0.5 * column).rem_euclid(1.0) - 0.5;
    let (radius, angle) = (across.hypot(down), down.atan2(across));
    let petals = 0.16 + 0.05 * (6.0 * angle).cos();
    // A leaf above and below each flower, bounded by two arcs.
    let along = (down.abs() - 0.36) / 0.13;
    let leaf = across.abs() < 0.085 * (1.0 - along * along).max(0.0);
    match () {
        () if radius < 0.075 => 0,
        () if radius < petals => 1,
        () if leaf => 3,
        () => 2,
    }
}

/// The demo's materials as a recipe, laid out as a board: an example for users and what `--port sim` shows by
/// itself.
pub fn recipe() -> Recipe {
    let lobe = |rho_s, c, n| LobeRecipe { rho_s, c, n, n_grazing: None };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brocade_shows_every_material_on_a_fair_part_of_the_sample() {
        let mut counts = [0; 4];
        for k in 0..64 * 64 {
            counts[usize::from(brocade(f64::from(k % 64), f64::from(k / 64)))] += 1;
        }
        assert!(counts.iter().all(|&count| count > 64 * 64 / 40), "{counts:?}");
    }
}
