//! Errors of prediction by angle, inside and outside the measured cone.
//!
//! A pair of directions lies in the measured cone of a plan when a pose is nearer to it, in the plan's own
//! bi-angular distance, than the plan's spacing θ_d (3.3.2). A whole plan leaves no pair within its polar
//! cuts farther from its poses than that; what lies outside is the model's own guess. Inside and outside,
//! errors are told by the larger of θ_i and θ_o as well ([`BANDS_DEG`]).
//!
//! The error of a texel is ‖f̂ − f‖ / ‖f‖ over the pairs of a zone and the channels; percentiles are over the
//! texels.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::chart::{Cell, Table};
use crate::distance::{DirectionPair, distance};
use crate::figures::ErrorFigure;
use crate::page::scale::quantile;
use crate::plan::Plan;
use crate::random::Random;
use crate::reflectance::Rgb;
use crate::rig::config::RigConfig;
use crate::rig::geometry::directions;
use crate::sampled::PoseGeometry;

/// Bounds of the larger of θ_i and θ_o by which errors are told, degrees.
pub const BANDS_DEG: [f64; 5] = [0.0, 30.0, 60.0, 75.0, 90.0];

/// Percentiles over the texels that are told; the last is the worst.
pub const PERCENTILES: [u8; 4] = [50, 95, 99, 100];

/// Direction pairs a band on which a known material is judged.
pub const PAIRS: usize = 128;

const BANDS: usize = BANDS_DEG.len() - 1;
const SIDES: [Side; 3] = [Side::Inside, Side::Outside, Side::Unknown];
const ZONES: usize = SIDES.len() * BANDS;

/// On which side of the measured cone's rim a pair lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// A pose is nearer than θ_d.
    Inside,
    /// No pose is.
    Outside,
    /// The poses are not known.
    Unknown,
}

impl Side {
    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Inside => "inside",
            Self::Outside => "outside",
            Self::Unknown => "unknown",
        }
    }
}

/// A side of the cone's rim and a band of the larger polar angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Zone {
    /// The side.
    pub side: Side,
    /// The band, an index into [`BANDS_DEG`].
    pub band: usize,
}

impl Zone {
    fn index(self) -> usize {
        self.side as usize * BANDS + self.band
    }
}

/// The band in which the larger polar angle of a pair lies.
fn band(wi: Vec3, wo: Vec3) -> usize {
    let larger_deg = f64::from(wi.z.min(wo.z).clamp(-1.0, 1.0)).acos().to_degrees();
    BANDS_DEG[1..BANDS].iter().filter(|&&bound| larger_deg >= bound).count()
}

/// The poses of a plan and how far each of them speaks.
#[derive(Debug, Clone)]
pub struct Cone {
    poses: Vec<DirectionPair>,
    spacing_rad: f64,
    isotropic: bool,
}

impl Cone {
    /// The cone of poses as they were registered, directions at the sample's centre; those that were rejected
    /// are left out.
    pub fn of_poses(poses: &[PoseGeometry], plan: &Plan) -> Self {
        let kept = poses.iter().filter(|pose| pose.weight > 0.0);
        let pairs =
            kept.map(|pose| DirectionPair { wi: pose.light_mm.normalize(), wo: pose.camera_mm.normalize() });
        Self::new(pairs.collect(), plan.spacing_deg, plan.isotropic)
    }

    /// The cone of a plan's poses as they were meant.
    pub fn of_plan(plan: &Plan, rig: &RigConfig) -> Self {
        let pair = |pose: usize| {
            let (wi, wo) = directions(rig, &plan.angles(pose));
            DirectionPair { wi, wo }
        };
        Self::new((0..plan.poses.len()).map(pair).collect(), plan.spacing_deg, plan.isotropic)
    }

    /// The cone of pairs `spacing_deg` apart; for isotropic ones turned and mirrored pairs count as equal.
    pub fn new(poses: Vec<DirectionPair>, spacing_deg: f64, isotropic: bool) -> Self {
        Self { poses, spacing_rad: spacing_deg.to_radians(), isotropic }
    }

    /// The cone without some of its poses, counted from 0.
    #[must_use]
    pub fn without(mut self, left_out: &[usize]) -> Self {
        let poses = self.poses.into_iter().enumerate().filter(|(pose, _)| !left_out.contains(pose));
        self.poses = poses.map(|(_, pair)| pair).collect();
        self
    }

    /// θ_d, degrees.
    pub fn spacing_deg(&self) -> f64 {
        self.spacing_rad.to_degrees()
    }

    /// The zone of a pair. `last` is the pose that was near the pair asked for before, which is tried first:
    /// pairs that follow each other mostly lie near the same one.
    pub fn zone(&self, wi: Vec3, wo: Vec3, last: &mut usize) -> Zone {
        let pair = DirectionPair { wi: wi.as_dvec3(), wo: wo.as_dvec3() };
        let near = |pose: &DirectionPair| distance(*pose, pair, self.isotropic) <= self.spacing_rad;
        let found = if self.poses.get(*last).is_some_and(near) {
            Some(*last)
        } else {
            self.poses.iter().position(near)
        };
        *last = found.unwrap_or(*last);
        let side = if found.is_some() { Side::Inside } else { Side::Outside };
        Zone { side, band: band(wi, wo) }
    }
}

/// The zone of a pair when the cone may not be known.
pub fn zone(cone: Option<&Cone>, wi: Vec3, wo: Vec3, last: &mut usize) -> Zone {
    cone.map_or(Zone { side: Side::Unknown, band: band(wi, wo) }, |cone| cone.zone(wi, wo, last))
}

/// A pair on which known materials are judged.
struct Probe {
    wi: Vec3,
    wo: Vec3,
    zone: Zone,
    /// Its share of all pairs of directions.
    weight: f64,
}

/// Pairs over the whole hemispheres, [`PAIRS`] a band, weighted as if they were uniform in solid angle.
pub struct Probes(Vec<Probe>);

impl Probes {
    /// Random pairs with their zones.
    pub fn new(cone: &Cone, seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0x616e_676c);
        let below = |deg: f64| 1.0 - deg.to_radians().cos();
        let probes = (0..BANDS * PAIRS).map(|k| {
            let [low, high] = [0, 1].map(|end| below(BANDS_DEG[k / PAIRS + end]).powi(2));
            // Of two uniform numbers the larger has a uniform square.
            let larger = random.uniform(low, high).sqrt();
            let heights = [larger, random.uniform(0.0, larger)];
            let [a, b] = heights.map(|height| {
                let (z, turn) = (1.0 - height, random.uniform(0.0, TAU));
                let r = (1.0 - z * z).max(0.0).sqrt();
                DVec3::new(r * turn.cos(), r * turn.sin(), z).as_vec3()
            });
            let (wi, wo) = if random.uniform(0.0, 1.0) < 0.5 { (a, b) } else { (b, a) };
            let zone = Zone { band: k / PAIRS, ..cone.zone(wi, wo, &mut 0) };
            Probe { wi, wo, zone, weight: (high - low) / PAIRS as f64 }
        });
        Self(probes.collect())
    }

    /// Values of a BRDF at all pairs.
    pub fn values(&self, brdf: impl Fn(Vec3, Vec3) -> Rgb) -> Vec<Rgb> {
        self.0.iter().map(|probe| brdf(probe.wi, probe.wo)).collect()
    }

    /// Errors of what is fitted to `texels` texels; `truth` gives the true values of a texel at all pairs.
    pub fn errors<'a>(
        &self,
        texels: usize,
        fitted: impl Fn(usize, Vec3, Vec3) -> Rgb + Sync,
        truth: impl Fn(usize) -> &'a [Rgb] + Sync,
    ) -> ByAngle {
        let texel = |texel: usize| {
            let mut squares = Squares::default();
            for (probe, &f) in self.0.iter().zip(truth(texel)) {
                let off = (fitted(texel, probe.wi, probe.wo) - f).length_squared();
                squares.add(
                    probe.zone,
                    probe.weight * f64::from(off),
                    probe.weight * f64::from(f.length_squared()),
                );
            }
            squares
        };
        ByAngle((0..texels).into_par_iter().map(texel).collect())
    }
}

/// Squared errors and squared values of one texel, a zone.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Squares([[f64; 2]; ZONES]);

impl Squares {
    fn add(&mut self, zone: Zone, off: f64, all: f64) {
        let sum = &mut self.0[zone.index()];
        (sum[0], sum[1]) = (sum[0] + off, sum[1] + all);
    }

    /// ‖f̂ − f‖ / ‖f‖ over some zones; NaN without a value there.
    fn relative(&self, zones: &[Zone]) -> f32 {
        let sums = zones.iter().map(|zone| self.0[zone.index()]);
        let [off, all] = sums.fold([0.0, 0.0], |sum, zone| [sum[0] + zone[0], sum[1] + zone[1]]);
        relative(off, all)
    }
}

/// The root of a ratio of squares; NaN of nothing. What overflows stays finite, so that percentiles count it.
pub(crate) fn relative(off: f64, all: f64) -> f32 {
    let error = (off / all).sqrt() as f32;
    if error.is_infinite() { f32::MAX } else { error }
}

/// Errors of every texel by zone.
#[derive(Debug, Clone, PartialEq)]
pub struct ByAngle(Vec<Squares>);

/// Percentiles over the texels, on one side of the cone's rim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// The side.
    pub side: Side,
    /// The band; none for all of them.
    pub band: Option<usize>,
    /// Texels with a value there.
    pub texels: usize,
    /// Errors by [`PERCENTILES`].
    pub errors: [f64; PERCENTILES.len()],
}

impl Row {
    /// The band's angles, such as `60-75`; degrees.
    pub fn theta_deg(&self) -> String {
        let [low, high] = match self.band {
            Some(band) => [BANDS_DEG[band], BANDS_DEG[band + 1]],
            None => [BANDS_DEG[0], BANDS_DEG[BANDS]],
        };
        format!("{low}-{high}")
    }
}

impl ByAngle {
    /// No error yet of any of so many texels.
    pub fn empty(texels: usize) -> Self {
        Self(vec![Squares::default(); texels])
    }

    /// Adds a texel's squared error and squared value in a zone.
    pub fn add(&mut self, texel: usize, zone: Zone, off: f64, all: f64) {
        self.0[texel].add(zone, off, all);
    }

    /// Of some of the texels alone.
    pub fn of(&self, texels: impl IntoIterator<Item = usize>) -> Self {
        Self(texels.into_iter().map(|texel| self.0[texel]).collect())
    }

    /// Percentiles on one side, of one band or of all.
    fn row(&self, side: Side, band: Option<usize>) -> Row {
        let bands = band.map_or(0..BANDS, |band| band..band + 1);
        let zones: Vec<Zone> = bands.map(|band| Zone { side, band }).collect();
        let errors: Vec<f32> = self.0.iter().map(|squares| squares.relative(&zones)).collect();
        Row {
            side,
            band,
            texels: errors.iter().filter(|error| error.is_finite()).count(),
            errors: PERCENTILES.map(|percentile| quantile(&errors, f64::from(percentile) / 100.0)),
        }
    }

    /// All bands of one side taken together; none without any value there.
    pub fn side(&self, side: Side) -> Option<Row> {
        Some(self.row(side, None)).filter(|row| row.texels > 0)
    }

    /// Each side as a whole, then its bands; what no texel has a value for is left out.
    pub fn rows(&self) -> Vec<Row> {
        let bands = || std::iter::once(None).chain((0..BANDS).map(Some));
        let rows = SIDES.iter().flat_map(|&side| bands().map(move |band| self.row(side, band)));
        rows.filter(|row| row.texels > 0).collect()
    }

    /// The report's figures, `relative_rms_by_angle`, which depend on `cone`, `theta_deg` and `percentile`.
    pub fn figures(&self, over: &str) -> Vec<ErrorFigure> {
        let of = |row: &Row| {
            let over = format!("{} texels, {over}", row.texels);
            let figure = |(percentile, error): (u8, f64)| {
                ErrorFigure::new("relative_rms_by_angle", error, "1", over.clone())
                    .with("cone", row.side.name())
                    .with("theta_deg", row.theta_deg())
                    .with("percentile", percentile)
            };
            PERCENTILES.into_iter().zip(row.errors).map(figure).collect::<Vec<_>>()
        };
        self.rows().iter().flat_map(of).collect()
    }

    /// The rows as a table, errors in percent.
    pub fn table(&self) -> Table {
        let mut table = Table::new([
            "measured cone",
            "larger of θ_i and θ_o, °",
            "texels",
            "median, %",
            "95 %",
            "99 %",
            "worst, %",
        ]);
        for row in self.rows() {
            let angles = row.theta_deg().replace('-', "–");
            let mut cells: Vec<Cell> = vec![row.side.name().into(), angles.into(), row.texels.into()];
            cells.extend(row.errors.map(|error| Cell::from(100.0 * error)));
            table.rows.push(cells);
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{self, Extent};

    fn cone() -> (Cone, Plan) {
        let rig = RigConfig::default();
        let plan = plan::make(&rig, Extent::Density(15.0), true, 1).unwrap();
        (Cone::of_plan(&plan, &rig), plan)
    }

    #[test]
    fn an_offset_beyond_75_degrees_is_found_there_and_nowhere_else() {
        let (cone, _) = cone();
        let probes = Probes::new(&cone, 1);
        let truth = probes.values(|wi, wo| Rgb::splat(0.1 + wi.z * wo.z));
        // Texel k is off by k percent where an angle is beyond 75°.
        let rim = 75f32.to_radians().cos();
        let fitted = |texel: usize, wi: Vec3, wo: Vec3| {
            let beyond = if wi.z.min(wo.z) < rim { 0.01 * texel as f32 } else { 0.0 };
            Rgb::splat((0.1 + wi.z * wo.z) * (1.0 + beyond))
        };
        let found = probes.errors(101, fitted, |_| &truth);
        for row in found.rows() {
            if row.band == Some(BANDS - 1) {
                for (percentile, error) in PERCENTILES.into_iter().zip(row.errors) {
                    assert!((error - 0.01 * f64::from(percentile)).abs() < 1e-5, "{row:?}");
                }
            } else if row.band.is_some() {
                assert_eq!(row.errors, [0.0; 4], "{row:?}");
            }
        }
        // All of what lies outside: the far band's share of the squares, which weights of solid angle give.
        let share = |zone: &dyn Fn(&Probe) -> bool| -> f64 {
            let chosen = probes.0.iter().zip(&truth).filter(|(probe, _)| zone(probe));
            chosen.map(|(probe, f)| probe.weight * f64::from(f.length_squared())).sum()
        };
        let outside = |probe: &Probe| probe.zone.side == Side::Outside;
        let far = share(&|probe| outside(probe) && probe.zone.band == BANDS - 1) / share(&outside);
        let whole = found.side(Side::Outside).unwrap();
        assert!((whole.errors[3] - far.sqrt()).abs() < 1e-5, "{whole:?} {far}");
    }

    #[test]
    fn pairs_of_a_whole_plan_lie_inside_its_cone_up_to_its_cuts_and_outside_far_beyond() {
        let (cone, plan) = cone();
        let probes = Probes::new(&cone, 2);
        let side = |band: usize, side: Side| {
            probes.0.iter().filter(|probe| probe.zone == Zone { side, band }).count()
        };
        // The light stays 10° away from the camera, which leaves a little outside even there.
        assert!(side(0, Side::Inside) + side(1, Side::Inside) > 2 * PAIRS - 12);
        let outside = [0, 1, 2, 3].map(|band| side(band, Side::Outside));
        assert!(outside[3] > PAIRS / 5 && outside[3] > outside[2], "{outside:?}");
        // Both directions at 89° are 24° and 14° beyond the cuts, more than the 15° of the plan's spacing.
        let grazing = |turn: f32| Vec3::new(turn.cos(), turn.sin(), 89f32.to_radians().cos()).normalize();
        assert_eq!(cone.zone(grazing(0.0), grazing(2.0), &mut 0), Zone { side: Side::Outside, band: 3 });
        for probe in &probes.0 {
            assert_eq!(band(probe.wi, probe.wo), probe.zone.band);
        }
        // Each pose is in its own cone; without poses everything is outside, without a plan unknown.
        let rig = RigConfig::default();
        let (wi, wo) = directions(&rig, &plan.angles(3));
        assert_eq!(cone.zone(wi.as_vec3(), wo.as_vec3(), &mut 0).side, Side::Inside);
        let none = Cone::of_poses(&[], &plan);
        assert_eq!(cone.clone().without(&[0, 5]).poses.len(), cone.poses.len() - 2);
        assert_eq!(none.zone(wi.as_vec3(), wo.as_vec3(), &mut 0).side, Side::Outside);
        assert_eq!(zone(None, wi.as_vec3(), wo.as_vec3(), &mut 0).side, Side::Unknown);
    }

    #[test]
    fn weights_are_those_of_uniform_directions() {
        let (cone, _) = cone();
        let probes = Probes::new(&cone, 3);
        let mean = |value: &dyn Fn(&Probe) -> f64| -> f64 {
            probes.0.iter().map(|probe| probe.weight * value(probe)).sum()
        };
        assert!((mean(&|_| 1.0) - 1.0).abs() < 1e-12);
        // E[z] is a half for each direction.
        assert!((mean(&|probe| f64::from(probe.wi.z)) - 0.5).abs() < 0.03);
    }

    #[test]
    fn texels_without_a_value_do_not_count_and_zones_without_any_are_left_out() {
        let mut found = ByAngle::empty(3);
        let zone = Zone { side: Side::Inside, band: 1 };
        found.add(0, zone, 0.04, 1.0);
        found.add(2, zone, 0.16, 1.0);
        let rows = found.rows();
        assert_eq!(rows.len(), 2);
        assert!(rows.iter().all(|row| row.texels == 2 && (row.errors[3] - 0.4).abs() < 1e-6));
        assert_eq!((rows[0].theta_deg(), rows[1].theta_deg()), ("0-90".into(), "30-60".into()));
        let figures = found.figures("measured samples");
        assert_eq!((figures.len(), figures[0].depends["cone"].as_str()), (8, Some("inside")));
        assert_eq!(found.of([0]).side(Side::Inside).map(|row| row.texels), Some(1));
        assert!(found.side(Side::Outside).is_none());
        assert_eq!(found.table().rows.len(), 2);
    }
}
