//! What it costs to interpolate coefficients instead of reflectance (stability case G14, chapter 5): between
//! two unlike texels, and in MIP levels.

use glam::Vec3;
use rayon::prelude::*;

use super::{Axis, Chart, Plot, Section, Series, Table, filtering};
use crate::edit::blend::blend;
use crate::edit::levels;
use crate::edit::pairs::Pairs;
use crate::error::Result;
use crate::fit::texel::Workspace;
use crate::mip;
use crate::progress;
use crate::reflectance::{Lobe, LobeBrdf, Rgb, SbrdfMap, materials};
use crate::scene::showcase;

/// Steps from one texel to the other.
const STEPS: usize = 10;
/// Pairs of directions that an error is taken over; others than a blend is fitted to.
const PAIRS: usize = 1000;
/// Most texels of a level that its error is taken over.
const TEXELS: usize = 64;

/// Two texels between which is interpolated.
struct Couple {
    name: &'static str,
    texels: [LobeBrdf; 2],
}

fn one_lobe(rho_d: f32, c: [f32; 3], n: f32) -> LobeBrdf {
    let lobe = Lobe::new(Rgb::new(0.5, 0.4, 0.3), Vec3::from_array(c), n);
    LobeBrdf { rho_d: Rgb::splat(rho_d), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() }
}

/// Brushed metal, turned by an angle.
fn brushed(turn: f32) -> LobeBrdf {
    one_lobe(0.05, [-1.0, -0.6, 0.9], 20.0).rotated(turn)
}

fn couples() -> Vec<Couple> {
    let two = LobeBrdf {
        lobes: [one_lobe(0.0, [-1.0, -1.0, 1.0], 80.0), one_lobe(0.0, [1.0, 1.0, 0.9], 8.0)]
            .map(|b| b.lobes[0])
            .to_vec(),
        ..one_lobe(0.1, [0.0; 3], 1.0)
    };
    let swapped = LobeBrdf { lobes: two.lobes.iter().rev().copied().collect(), ..two.clone() };
    let published = |name: &str| materials::published(name).unwrap_or_default();
    let couple = |name, first, second| Couple { name, texels: [first, second] };
    vec![
        couple(
            "gloss and satin",
            one_lobe(0.05, [-1.0, -1.0, 1.0], 100.0),
            one_lobe(0.2, [-1.0, -1.0, 0.8], 8.0),
        ),
        couple(
            "forward and retro",
            one_lobe(0.1, [-1.0, -1.0, 1.0], 20.0),
            one_lobe(0.1, [1.0, 1.0, 1.0], 20.0),
        ),
        couple("brushed, 40° apart", brushed(-0.35), brushed(0.35)),
        couple("clay and blue paint", published("clay"), published("blue-paint")),
        couple("one BRDF, its lobes swapped", two, swapped),
    ]
}

/// ‖f̂ − Σ w f‖² and ‖Σ w f‖² over all pairs of directions, weighted by cosθ_i cosθ_o.
fn squares(found: &LobeBrdf, parts: &[(f32, &LobeBrdf)]) -> [f64; 2] {
    let pairs = Pairs::over(parts.iter().map(|(_, brdf)| *brdf), PAIRS);
    let mut truth = vec![Rgb::ZERO; pairs.directions.len()];
    for (weight, brdf) in parts {
        truth.iter_mut().zip(pairs.reflectance(brdf)).for_each(|(sum, f)| *sum += *weight * f);
    }
    let error = pairs.rms(pairs.reflectance(found).iter().zip(&truth).map(|(found, truth)| found - truth));
    [error.powi(2), pairs.rms(truth.iter().copied()).powi(2)]
}

fn relative(squares: impl IntoIterator<Item = [f64; 2]>) -> f64 {
    let [error, whole] = squares.into_iter().fold([0.0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
    if whole > 0.0 { (error / whole).sqrt() } else { 0.0 }
}

/// The chart.
///
/// # Errors
/// Those of the renderers.
pub fn chart() -> Result<Chart> {
    let maps = maps();
    Ok(Chart {
        name: "interpolation".into(),
        title: "Interpolation of BRDFs".into(),
        lead: "Coefficients do not interpolate, reflectance does. What it costs to interpolate coefficients \
             all the same, and what a fit to the blended reflectance leaves."
            .into(),
        sections: vec![between(), by_level(&maps), filtering::section(&maps)?],
    })
}

/// Between two texels.
fn between() -> Section {
    let couples = couples();
    let bar = progress::bar("blending", (couples.len() * (STEPS - 1)) as u64, "blends");
    let mut table =
        Table::new(["texels", "lobes each", "coefficients, worst", "fit with as many lobes, worst"]);
    let (mut coefficients, mut fits) = (Vec::new(), Vec::new());
    for Couple { name, texels: [first, second] } in &couples {
        let lobes = first.lobes.len().max(second.lobes.len());
        let errors: Vec<[f64; 3]> = (0..=STEPS)
            .into_par_iter()
            .map_init(Workspace::default, |workspace, step| {
                let t = step as f32 / STEPS as f32;
                let parts = [(1.0 - t, first), (t, second)];
                let fitted = blend(&parts, lobes, workspace).brdf;
                bar.advance(1);
                let of = |brdf: &LobeBrdf| relative([squares(brdf, &parts)]);
                [f64::from(t), of(&levels::average(&parts)), of(&fitted)]
            })
            .collect();
        let worst = |column: usize| errors.iter().map(|error| error[column]).fold(0.0, f64::max);
        table.row([(*name).into(), lobes.into(), worst(1).into(), worst(2).into()]);
        let series = |column: usize| {
            Series::new(*name, errors.iter().map(|error| [error[0], error[column]]).collect())
        };
        coefficients.push(series(1));
        fits.push(series(2));
    }
    let plot = |title: &str, series| Plot {
        title: title.into(),
        x: Axis::linear("share of the second texel"),
        y: Axis::linear("relative L2 error"),
        series,
    };
    Section {
        title: "Between two texels".into(),
        text: "Relative L2 error against the blended reflectance over all pairs of directions, weighted by \
             cosθ_i cosθ_o. Two lobes that are one BRDF's in another order show that the error is not one of \
             unlike texels alone. A fit keeps the number of lobes; where that many lobes can be the blend it \
             is exact."
            .into(),
        plots: vec![
            plot("Coefficients interpolated", coefficients),
            plot("Fitted to the blended reflectance", fits),
        ],
        tables: vec![table],
        ..Section::default()
    }
}

/// Checks of gloss and satin, and of metal brushed in two directions.
fn maps() -> [(&'static str, SbrdfMap); 2] {
    let (gloss, satin) = (one_lobe(0.05, [-1.0, -1.0, 1.0], 100.0), one_lobe(0.2, [-1.0, -1.0, 0.8], 8.0));
    [
        ("gloss, satin", showcase::check(&gloss, &satin, 11, 3)),
        ("brushed ±20°", showcase::check(&brushed(-0.35), &brushed(0.35), 11, 3)),
    ]
}

/// MIP levels of two maps.
fn by_level(maps: &[(&str, SbrdfMap)]) -> Section {
    let mut table =
        Table::new(["map", "level", "texels", "coefficients averaged", "fit to the averaged reflectance"]);
    let mut series = Vec::new();
    for (name, map) in maps {
        let size = [map.width, map.height];
        let mut errors = Vec::new();
        for level in 1..=mip::last(size) {
            let [averaged, fitted] = level_errors(map, level);
            let count = mip::size(size, level).iter().product::<usize>();
            table.row([
                (*name).into(),
                (level as usize).into(),
                count.into(),
                averaged.into(),
                fitted.into(),
            ]);
            errors.push([f64::from(level), averaged, fitted]);
        }
        for (column, what) in [(1, "averaged"), (2, "fitted")] {
            series.push(Series::new(
                format!("{name}: {what}"),
                errors.iter().map(|e| [e[0], e[column]]).collect(),
            ));
        }
    }
    Section {
        title: "MIP levels".into(),
        text: format!(
            "Error against shading the finest level and filtering the result, over at most {TEXELS} texels \
             of each level of maps of 33 × 33 texels: checks of two materials in cells of 3 × 3. One lobe a \
             texel throughout."
        ),
        plots: vec![Plot {
            title: "Error by level".into(),
            x: Axis::linear("level"),
            y: Axis::linear("relative L2 error"),
            series,
        }],
        tables: vec![table],
        ..Section::default()
    }
}

/// Errors of a level: coefficients averaged, and the fit to the averaged reflectance.
fn level_errors(map: &SbrdfMap, level: u32) -> [f64; 2] {
    let [columns, rows] = mip::size([map.width, map.height], level);
    let step = (columns * rows).div_ceil(TEXELS);
    let errors: Vec<[[f64; 2]; 2]> = (0..columns * rows)
        .into_par_iter()
        .step_by(step)
        .map_init(Workspace::default, |workspace, texel| {
            let texels = levels::beneath(map, level, texel);
            let parts = levels::evenly(&texels);
            let fitted = blend(&parts, map.lobes.len(), workspace).brdf;
            [squares(&levels::average(&parts), &parts), squares(&fitted, &parts)]
        })
        .collect();
    [0, 1].map(|method| relative(errors.iter().map(|error| error[method])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interpolated_coefficients_are_the_means_one_by_one() {
        let (a, b) = (one_lobe(0.1, [-1.0, -1.0, 1.0], 10.0), one_lobe(0.3, [-1.0, -1.0, 0.8], 30.0));
        let mean = levels::average(&[(0.25, &a), (0.75, &b)]);
        assert!((mean.rho_d.x - 0.25).abs() < 1e-6 && (mean.lobes[0].n - 25.0).abs() < 1e-5);
        assert!((mean.lobes[0].c.z - 0.85).abs() < 1e-6);
        let diffuse = LobeBrdf::diffuse(Rgb::ONE);
        let half = levels::average(&[(0.5, &diffuse), (0.5, &b)]);
        assert_eq!((half.lobes[0].n, half.lobes[0].rho_s), (30.0, 0.5 * b.lobes[0].rho_s));
        assert!(relative([squares(&half, &[(0.5, &diffuse), (0.5, &b)])]) < 1e-6);
    }

    #[test]
    fn a_fit_meets_the_blend_better_than_interpolated_coefficients_do() {
        let section = between();
        let [coefficients, fits] = section.plots.as_slice() else { panic!("two plots") };
        for (interpolated, fitted) in coefficients.series.iter().zip(&fits.series) {
            let worst = |series: &Series| series.points.iter().map(|point| point[1]).fold(0.0, f64::max);
            assert!(worst(fitted) < worst(interpolated), "{}", fitted.name);
            for ends in [0, STEPS] {
                assert!(interpolated.points[ends][1] < 1e-6 && fitted.points[ends][1] < 1e-6);
            }
        }
        let swapped = &fits.series[4];
        assert!(swapped.points.iter().all(|point| point[1] < 1e-6), "{swapped:?}");
    }

    #[test]
    fn a_level_of_equal_texels_has_no_error() {
        let brdf = one_lobe(0.1, [-1.0, -1.0, 0.9], 12.0);
        let errors = level_errors(&SbrdfMap::from_texels(5, 4, &vec![brdf; 20]), 2);
        assert!(errors.iter().all(|&error| error < 1e-6), "{errors:?}");
    }
}
