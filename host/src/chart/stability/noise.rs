//! G1: noise from 0 to 0.1 sr⁻¹ on the samples of a known lobe, every fitter.

use std::time::Instant;

use glam::Vec3;

use super::bound::{EXPONENT, bound};
use super::{NEAR, NEAR_DEG, POSES, off_deg, percent, quantile, recovered, repeats, warned};
use crate::chart::{Axis, Cell, Plot, Section, Series, Table};
use crate::error::{Error, Result};
use crate::fit::{self, AlbedoBound, FitOptions, Method, Residual};
use crate::progress;
use crate::reflectance::{Lobe, LobeBrdf, Rgb};
use crate::synth;

/// Noise, sr⁻¹.
const NOISES: [f64; 6] = [0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1];
/// Exponents.
const EXPONENTS: [f64; 6] = [2.0, 4.0, 10.0, 20.0, 64.0, 200.0];
/// Sets of random poses: whether a line search holds depends on them.
const SETS: u64 = 6;
/// Edge of a sample, texels: so many repeats with new noise are fitted at each set.
const SIDE: usize = 5;
/// Share of the repeats that must be recovered for a method to count as holding.
const HOLDS: f64 = 90.0;

/// All of them.
const METHODS: [Method; 5] =
    [Method::LineSearch, Method::LineSearchScaled, Method::Lm, Method::Ratio, Method::Separable];

/// What the lobe stands on, and how bright it is.
#[derive(Debug, Clone, Copy)]
struct Case {
    title: &'static str,
    rho_d: f32,
    rho_s: f32,
}

const CASES: [Case; 3] = [
    Case { title: "Noise on a lobe (G1)", rho_d: 0.0, rho_s: 0.6 },
    Case { title: "Noise on a lobe above a diffuse term (G1)", rho_d: 0.1, rho_s: 0.6 },
    Case { title: "Noise on a lobe five times as bright (G1)", rho_d: 0.1, rho_s: 3.0 },
];

/// What a method makes of the repeats at one noise and exponent.
#[derive(Debug, Clone, Copy)]
struct Found {
    /// Percent of the repeats recovered.
    recovered: f64,
    /// Percent of those with n near the truth, wherever C points.
    near: f64,
    /// Median angle between C and the truth, degrees.
    off_deg: f64,
    /// Median exponent.
    median: f64,
    /// Mean square error of n over the Cramér–Rao bound, NaN without noise.
    over_bound: f64,
    /// µs a texel on one thread.
    time_us: f64,
    /// Repeats that were not recovered, and those of them that the fit itself gave away.
    missed: [usize; 2],
}

/// The fits of one case: [method][noise][exponent].
type Grid = Vec<Vec<Vec<Found>>>;

/// A section a case.
///
/// # Errors
/// When no thread can be started.
pub(super) fn sections(seed: u64) -> Result<Vec<Section>> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(|error| Error::failure(format!("a thread cannot be started: {error}")).caused_by(error))?;
    let all = CASES.len() * METHODS.len() * NOISES.len() * EXPONENTS.len();
    let bar = progress::bar("noise", all as u64, "fits");
    CASES
        .iter()
        .map(|case| Ok(section(case, &pool.install(|| grid(case, seed, || bar.advance(1)))?)))
        .collect()
}

fn truth(case: &Case, n: f64) -> LobeBrdf {
    let lobe = Lobe::new(Rgb::splat(case.rho_s), Vec3::new(-1.0, -1.0, 1.0), n as f32);
    LobeBrdf { rho_d: Rgb::splat(case.rho_d), lobes: vec![lobe], ..LobeBrdf::default() }
}

fn grid(case: &Case, seed: u64, done: impl Fn()) -> Result<Grid> {
    let found = |method: Method, noise: f64, n: f64| {
        let found = judged(case, method, noise, n, seed);
        done();
        found
    };
    let by_noise = |method| {
        let row = |&noise: &f64| EXPONENTS.iter().map(|&n| found(method, noise, n)).collect();
        NOISES.iter().map(row).collect()
    };
    METHODS.iter().map(|&method| by_noise(method)).collect()
}

fn judged(case: &Case, method: Method, noise: f64, n: f64, seed: u64) -> Result<Found> {
    let truth = truth(case, n);
    let options =
        FitOptions { method, residual: Residual::Linear, bound: AlbedoBound::Free, ..FitOptions::default() };
    let (mut right, mut near, mut exponents, mut off) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut over_bound, mut seconds, mut missed) = (0.0, 0.0, [0; 2]);
    for set in 0..SETS {
        let poses = synth::poses(POSES, seed + 1000 * set);
        let sampled = repeats(poses, SIDE, &truth, noise, seed + set);
        let start = Instant::now();
        let map = fit::fit_sbrdf(&sampled, &options)?;
        seconds += start.elapsed().as_secs_f64();
        let mut square = 0.0;
        for texel in 0..sampled.texels() {
            let brdf = map.texel(texel);
            let found = brdf.lobes.first().map_or(0.0, |lobe| f64::from(lobe.n));
            let is_right = recovered(&brdf, &truth.lobes[0]);
            if !is_right {
                missed[0] += 1;
                missed[1] += usize::from(warned(&map, texel));
            }
            square += (found - n).powi(2) / sampled.texels() as f64;
            right.push(is_right);
            near.push(super::near(&brdf, &truth.lobes[0]));
            off.push(off_deg(&brdf, &truth.lobes[0]));
            exponents.push(found);
        }
        let bound = if noise > 0.0 { bound(&sampled, &truth, noise)?[EXPONENT] } else { f64::NAN };
        over_bound += square / bound / SETS as f64;
    }
    Ok(Found {
        time_us: 1e6 * seconds / right.len() as f64,
        recovered: percent(right),
        near: percent(near),
        off_deg: quantile(&off, 0.5),
        median: quantile(&exponents, 0.5),
        over_bound,
        missed,
    })
}

/// A row's name and its value for a cell of the grid.
type Quantity = (&'static str, fn(&Found) -> Cell);

fn section(case: &Case, grid: &Grid) -> Section {
    let mut table =
        Table::new(["", "method", "noise, 1/sr", "n = 2", "n = 4", "n = 10", "n = 20", "n = 64", "n = 200"]);
    let quantities: [Quantity; 6] = [
        ("recovered, %", |found| found.recovered.into()),
        ("n near, %", |found| found.near.into()),
        ("C off, °", |found| found.off_deg.into()),
        ("median n", |found| found.median.into()),
        ("mean square of n / bound", |found| found.over_bound.into()),
        ("µs a texel", |found| found.time_us.into()),
    ];
    for (name, of) in quantities {
        for (method, by_noise) in METHODS.iter().zip(grid) {
            for (noise, found) in NOISES.iter().zip(by_noise) {
                let mut row: Vec<Cell> = vec![name.into(), method.name().into(), (*noise).into()];
                row.extend(found.iter().map(of));
                table.rows.push(row);
            }
        }
    }
    let plots = METHODS.iter().zip(grid).map(|(method, by_noise)| Plot {
        title: format!("Share recovered by noise: {}", method.name()),
        x: Axis::log("noise, 1/sr"),
        y: Axis::linear("recovered, %"),
        series: (EXPONENTS.iter().enumerate())
            .map(|(k, n)| {
                let points = NOISES.iter().zip(by_noise).map(|(noise, found)| [*noise, found[k].recovered]);
                Series::new(format!("n = {n}"), points.collect())
            })
            .collect(),
    });
    Section {
        title: case.title.into(),
        text: format!(
            "ρ_d = {}, ρ_s = {} sr⁻¹, C = (−1, −1, 1); {SETS} sets of {POSES} random poses, at each {} \
             repeats of one texel with new normal noise, one lobe fitted on one thread, residual: linear, \
             albedos free (wide lobes of this brightness make light). The line searches take ρ_d from the \
             10th percentile; ratio divides by the lobe (4.10), and where its colour comes out negative for \
             that the lobe is black, and lost. Recovered: n within {} %, C within {NEAR_DEG}°. The first \
             table has the noise, sr⁻¹, up to which {HOLDS} % or more are recovered; the second what was \
             not, over all noises and exponents, and for how much of that the fit itself says so, by a \
             stated deviation of n above {} % or by tying n.",
            case.rho_d,
            case.rho_s,
            SIDE * SIDE,
            100.0 * NEAR,
            100.0 * NEAR
        ),
        plots: plots.collect(),
        tables: vec![limits(grid), warnings(grid), table],
        ..Section::default()
    }
}

/// Up to which noise each method recovers each exponent; by n alone in a row of its own where that is
/// farther.
fn limits(grid: &Grid) -> Table {
    let mut table =
        Table::new(["method", "found", "n = 2", "n = 4", "n = 10", "n = 20", "n = 64", "n = 200"]);
    for (method, by_noise) in METHODS.iter().zip(grid) {
        let both = limit(by_noise, |found| found.recovered);
        let near = limit(by_noise, |found| found.near);
        let rows = [("n and C", &both), ("n alone", &near)];
        for (what, limits) in rows.into_iter().take(if near == both { 1 } else { 2 }) {
            let names = [method.name(), what].map(Cell::from).into_iter();
            table.rows.push(names.chain(limits.iter().map(|limit| limit.as_str().into())).collect());
        }
    }
    table
}

/// Up to which noise each exponent holds.
fn limit(by_noise: &[Vec<Found>], share: fn(&Found) -> f64) -> Vec<String> {
    let of = |k: usize| match by_noise.iter().take_while(|found| share(&found[k]) >= HOLDS).count() {
        0 => "never".to_string(),
        1 => "without noise".to_string(),
        holds => format!("to {:e}", NOISES[holds - 1]),
    };
    (0..EXPONENTS.len()).map(of).collect()
}

/// Which method gave away how much of what it had not recovered.
fn warnings(grid: &Grid) -> Table {
    let mut table = Table::new(["method", "not recovered", "of them given away by the fit"]);
    for (method, by_noise) in METHODS.iter().zip(grid) {
        let sum = |which: usize| by_noise.iter().flatten().map(|found| found.missed[which]).sum::<usize>();
        table.row([method.name().into(), sum(0).into(), sum(1).into()]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(method: Method, noise: f64, n: f64) -> Found {
        judged(&CASES[1], method, noise, n, 1).unwrap()
    }

    #[test]
    fn the_summary_tells_up_to_which_noise_each_exponent_is_found_and_what_a_fit_gave_away() {
        let found = |recovered: f64, near: f64| Found {
            recovered,
            near,
            off_deg: 0.0,
            median: 0.0,
            over_bound: 1.0,
            time_us: 1.0,
            missed: [3, 2],
        };
        // The last exponent is found without noise alone, n = 2 never; of the others n farther than C.
        let at = |noise: usize| -> Vec<Found> {
            let share = |held: usize| if noise < held { HOLDS } else { 0.0 };
            let of = |k: usize| match k {
                0 => found(share(0), share(0)),
                5 => found(share(1), share(1)),
                _ => found(share(3), share(4)),
            };
            (0..EXPONENTS.len()).map(of).collect()
        };
        let grid: Grid = METHODS.iter().map(|_| (0..NOISES.len()).map(at).collect()).collect();
        let table = limits(&grid);
        let row = |k: usize| table.rows[k].clone();
        let cells = |texts: [&str; 8]| texts.map(Cell::from).to_vec();
        let never = ["never", "to 1e-4", "to 1e-4", "to 1e-4", "to 1e-4", "without noise"];
        let name = METHODS[0].name();
        assert_eq!(
            row(0),
            cells([name, "n and C", never[0], never[1], never[2], never[3], never[4], never[5]])
        );
        assert_eq!(row(1)[1..5], cells(["", "n alone", "never", "to 1e-3", "to 1e-3", "", "", ""])[1..5]);
        assert_eq!(table.rows.len(), 2 * METHODS.len());
        assert_eq!(warnings(&grid).rows[0][1..], [Cell::Count(3 * 36), Cell::Count(2 * 36)]);
    }

    #[test]
    fn without_noise_every_method_recovers_lobes_and_their_exponent_to_a_thousandth() {
        // Mean ratios (4.10) divide by the lobe where it is nothing, and may lose its albedo for that.
        for case in &CASES {
            for method in METHODS.into_iter().filter(|&method| method != Method::Ratio) {
                for n in [2.0, 20.0] {
                    let found = judged(case, method, 0.0, n, 1).unwrap();
                    let exact = (found.median / n - 1.0).abs() < 1e-3;
                    assert!(exact && found.recovered == 100.0, "{case:?} {method:?} {n}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn least_squares_stand_noise_that_the_line_searches_do_not() {
        for method in [Method::Lm, Method::Separable] {
            for n in [2.0, 20.0, 64.0] {
                assert_eq!(of(method, 1e-2, n).recovered, 100.0, "{method:?} {n}");
            }
        }
        assert!(of(Method::LineSearch, 1e-4, 2.0).near >= 60.0);
        assert!(of(Method::LineSearch, 1e-4, 10.0).near <= 10.0);
        assert!(of(Method::LineSearch, 1e-2, 4.0).near <= 10.0);
        // The scaled error finds n, not where the lobe points.
        let scaled = of(Method::LineSearchScaled, 1e-2, 4.0);
        assert!(scaled.near >= 80.0 && scaled.off_deg > 5.0, "{scaled:?}");
        assert!(of(Method::LineSearchScaled, 1e-2, 64.0).near <= 60.0);
    }
}
