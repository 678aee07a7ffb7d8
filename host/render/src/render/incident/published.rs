//! The source's method, and what it was compared with.
//!
//! Breadth first from the root, a sample at the mean of every node that is visited, which is parted where an
//! oracle of its radius r (half the diagonal of its box), of the norm |l| of the sample, the largest of the
//! channels', and of the harmonic mean H of the distances of what is seen there is beyond a bound. All
//! visited nodes keep their samples, or those alone that are not parted. What shines and what hides it both
//! count in H, by solid angle: over a polygon in a plane at height h, ∫ dω/r = n·∫ ω dω / h, which is of
//! degree 1.

use glam::Vec3;
use rayon::prelude::*;

use super::emitters::{Emitter, Incident, harmonic_distance};
use super::ground::Ground;
use super::polygon::Detail;
use super::samples::{Blend, Sample, Samples};

/// What an error is foretold by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Oracle {
    /// r |l| / H² (3.3).
    Printed,
    /// r² |l| / H, what the source's text says.
    Product,
    /// (r / H)² |l|, in which lengths do not matter.
    ScaleFree,
}

/// Places samples until the oracle is within `epsilon` everywhere or `most` are taken.
pub(super) fn place(
    ground: &Ground<'_>,
    emitters: &[Emitter],
    (oracle, ancestors): (Oracle, bool),
    epsilon: f64,
    most: usize,
) -> Samples {
    let nodes = &ground.tree.nodes;
    let mut kept = Vec::new();
    let (mut taken, mut capped) = (0, false);
    let mut waiting = if nodes.is_empty() || emitters.is_empty() { Vec::new() } else { vec![0] };
    while !waiting.is_empty() {
        if waiting.len() > most - taken {
            waiting.truncate(most - taken);
            capped = true;
        }
        taken += waiting.len();
        let sampled: Vec<(Sample, bool)> =
            waiting.par_iter().map(|&node| sampled(ground, emitters, oracle, epsilon, node)).collect();
        let mut next = Vec::new();
        for (node, (sample, within)) in waiting.into_iter().zip(sampled) {
            let children = nodes[node].children.filter(|_| !within);
            next.extend(children.into_iter().flat_map(|first| [first, first + 1]));
            if ancestors || children.is_none() {
                kept.push((node, sample));
            }
        }
        waiting = next;
    }
    Samples::new(ground, Blend::Published, kept).told(taken, capped, epsilon)
}

/// The sample of a node, and whether it is within the bound.
fn sampled(
    ground: &Ground<'_>,
    emitters: &[Emitter],
    oracle: Oracle,
    epsilon: f64,
    node: usize,
) -> (Sample, bool) {
    let node = &ground.tree.nodes[node];
    let mean = node.mean.as_dvec3();
    let incident = Incident::at(emitters, mean, ground.degree, Detail::Values);
    let norm = incident.values.iter().map(|value| *value * *value).sum::<glam::DVec3>().max_element().sqrt();
    let r = f64::from(node.half_diagonal);
    let foretold = harmonic_distance(emitters, mean).map_or(0.0, |h| match oracle {
        Oracle::Printed => r * norm / (h * h),
        Oracle::Product => r * r * norm / h,
        Oracle::ScaleFree => (r / h).powi(2) * norm,
    });
    (Sample::new(ground.degree, node.mean, node.half_diagonal, &incident), foretold <= epsilon)
}

/// Steps of Lloyd's iteration after every split.
const LLOYD_STEPS: usize = 8;

/// Samples by vector quantisation: at the means that splitting finds (LBG), their number a power of 2.
pub(super) struct Quantised {
    samples: Vec<(Vec3, Sample)>,
}

impl Quantised {
    /// The largest power of 2 up to `most` of them.
    pub(super) fn new(ground: &Ground<'_>, emitters: &[Emitter], most: usize) -> Self {
        let sample = |mean: Vec3| {
            let incident = Incident::at(emitters, mean.as_dvec3(), ground.degree, Detail::Values);
            (mean, Sample::new(ground.degree, mean, f32::INFINITY, &incident))
        };
        Self { samples: means(&ground.receivers.positions, most).into_par_iter().map(sample).collect() }
    }

    /// Their number.
    pub(super) fn count(&self) -> usize {
        self.samples.len()
    }

    /// Irradiance of every receiver, which blends all samples by 1/dᵇ (2.13).
    pub(super) fn irradiance(&self, ground: &Ground<'_>, exponent: f32) -> Vec<Vec3> {
        let blended = |receiver: usize| {
            let position = ground.receivers.positions[receiver];
            let distance = |(mean, _): &(Vec3, Sample)| mean.distance(position);
            let nearest = self.samples.iter().map(distance).fold(f32::INFINITY, f32::min);
            let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
            for one in &self.samples {
                // Over the nearest's, so that no power overflows; a sample at the receiver stands alone.
                let weight = match nearest > 0.0 {
                    true => (nearest / distance(one)).powf(exponent),
                    false => f32::from(u8::from(distance(one) == 0.0)),
                };
                sum += one.1.irradiance(ground, receiver) * weight;
                weights += weight;
            }
            sum / weights
        };
        (0..ground.receivers.len()).into_par_iter().map(blended).collect()
    }
}

/// Means of clusters of positions.
fn means(positions: &[Vec3], most: usize) -> Vec<Vec3> {
    let Some(first) = positions.first() else { return Vec::new() };
    let span = positions.iter().map(|position| position.distance(*first)).fold(0.0, f32::max);
    let mut means = vec![positions.iter().sum::<Vec3>() / positions.len() as f32];
    let nearest = |means: &[Vec3], position: Vec3| {
        let distance = |mean: &Vec3| mean.distance_squared(position);
        let best = (0..means.len()).min_by(|&a, &b| distance(&means[a]).total_cmp(&distance(&means[b])));
        best.unwrap_or(0)
    };
    for step in 0.. {
        if step > 0 {
            if 2 * means.len() > most.min(positions.len()) {
                break;
            }
            // Apart along another axis at every split.
            let apart = Vec3::AXES[step % 3] * span * 1e-3;
            means = means.iter().flat_map(|&mean| [mean - apart, mean + apart]).collect();
        }
        for _ in 0..LLOYD_STEPS {
            let owners: Vec<usize> =
                positions.par_iter().map(|&position| nearest(&means, position)).collect();
            let mut sums = vec![(Vec3::ZERO, 0.0f32); means.len()];
            for (owner, position) in owners.into_iter().zip(positions) {
                sums[owner].0 += *position;
                sums[owner].1 += 1.0;
            }
            for (mean, (sum, count)) in means.iter_mut().zip(sums) {
                if count > 0.0 {
                    *mean = sum / count;
                }
            }
        }
    }
    means
}
