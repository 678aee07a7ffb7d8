//! Where samples are taken so that colours err by no more than a bound.
//!
//! A sample at the mean of a node's receivers stands for them. Its error in colour, for a receiver at D from
//! it with transfer t, is foretold by the second derivatives, ½ |Dᵀ (t·∇∇l) D| times the reflectance, over
//! some of the node's receivers; and known at the checks, receivers spread over all whose own incident
//! radiance is computed first. Nodes beyond the bound are parted, those of largest error times receivers
//! first where a cap decides. The nodes that are left have samples of half as far again as their farthest
//! receiver: none is bare.

use glam::DVec3;
use rayon::prelude::*;

use super::emitters::{Emitter, Incident};
use super::ground::Ground;
use super::polygon::Detail;
use super::samples::{Blend, Sample, Samples};

/// Receivers of a node whose error is foretold.
const JUDGED: usize = 32;
/// Receivers whose incident radiance is computed to check samples by.
const CHECKS: usize = 64;
/// What is foretold is taken for that much more: higher orders, and receivers between those that are judged.
const MARGIN: f64 = 2.0;
/// The radius of a sample over that of its node.
const REACH: f32 = 1.5;

/// A node with its sample and the error that it is foretold to have.
struct Judged {
    node: usize,
    incident: Incident,
    error: f64,
}

/// A receiver whose irradiance is known.
struct Check {
    /// Its place in the tree's order.
    place: usize,
    irradiance: DVec3,
}

/// Places samples for an error of `epsilon` times the root mean square of the radiance over the receivers,
/// with `most` samples, the checks aside.
pub(super) fn place(ground: &Ground<'_>, emitters: &[Emitter], epsilon: f64, most: usize) -> Samples {
    let nodes = &ground.tree.nodes;
    if nodes.is_empty() || emitters.is_empty() {
        return Samples::new(ground, Blend::Smooth, Vec::new());
    }
    let checks = checks(ground, emitters);
    let square = |check: &Check| {
        let receiver = ground.tree.order[check.place] as usize;
        (check.irradiance * f64::from(ground.receivers.brightness[receiver])).length_squared() / 3.0
    };
    let bound = epsilon * (checks.iter().map(square).sum::<f64>() / checks.len() as f64).sqrt();
    let mut waiting = vec![judged(ground, emitters, &checks, 0)];
    let (mut taken, mut capped, mut left) = (1, false, Vec::new());
    while !waiting.is_empty() {
        let parts = |one: &Judged| one.error > bound && nodes[one.node].children.is_some();
        let (mut beyond, within): (Vec<_>, Vec<_>) = waiting.into_iter().partition(parts);
        left.extend(within);
        let room = most.saturating_sub(taken) / 2;
        if beyond.len() > room {
            let weight = |one: &Judged| one.error * nodes[one.node].run.len() as f64;
            beyond.sort_by(|a, b| weight(b).total_cmp(&weight(a)));
            left.extend(beyond.split_off(room));
            capped = true;
        }
        let children: Vec<usize> = beyond
            .iter()
            .filter_map(|one| nodes[one.node].children)
            .flat_map(|first| [first, first + 1])
            .collect();
        taken += children.len();
        waiting = children.into_par_iter().map(|node| judged(ground, emitters, &checks, node)).collect();
    }
    let sample = |Judged { node, incident, .. }: Judged| {
        (node, Sample::new(ground.degree, nodes[node].mean, REACH * nodes[node].radius, &incident))
    };
    let kept = left.into_iter().map(sample).collect();
    Samples::new(ground, Blend::Smooth, kept).told(taken, capped, bound)
}

/// The irradiance of receivers spread over the tree.
fn checks(ground: &Ground<'_>, emitters: &[Emitter]) -> Vec<Check> {
    let count = ground.tree.order.len().min(CHECKS);
    let check = |k: usize| {
        let place = (2 * k + 1) * ground.tree.order.len() / (2 * count);
        Check { place, irradiance: ground.exact(emitters, ground.tree.order[place] as usize) }
    };
    (0..count).into_par_iter().map(check).collect()
}

/// Samples at a node and foretells its error.
fn judged(ground: &Ground<'_>, emitters: &[Emitter], checks: &[Check], index: usize) -> Judged {
    let node = &ground.tree.nodes[index];
    let mean = node.mean.as_dvec3();
    let incident = Incident::at(emitters, mean, ground.degree, Detail::Seconds);
    let colour = |receiver: usize, error: DVec3| {
        error.abs().max_element() * f64::from(ground.receivers.brightness[receiver])
    };
    let mut error = 0.0f64;
    let step = node.run.len().div_ceil(JUDGED);
    for place in node.run.clone().step_by(step) {
        let receiver = ground.tree.order[place] as usize;
        let DVec3 { x, y, z } = ground.position(receiver) - mean;
        // Half of the square's coefficients, those of the mixed terms whole.
        let half = [x * x / 2.0, y * y / 2.0, z * z / 2.0, x * y, x * z, y * z];
        let second =
            |i: usize| incident.seconds[i].iter().zip(half).map(|(&second, part)| second * part).sum();
        error = error.max(MARGIN * colour(receiver, ground.product(receiver, second)));
    }
    for check in checks.iter().filter(|check| node.run.contains(&check.place)) {
        let receiver = ground.tree.order[check.place] as usize;
        let to = ground.position(receiver) - mean;
        let linear = |i: usize| {
            let [x, y, z]: [DVec3; 3] = incident.gradients[i];
            incident.values[i] + x * to.x + y * to.y + z * to.z
        };
        error = error.max(colour(receiver, ground.product(receiver, linear) - check.irradiance));
    }
    Judged { node: index, incident, error }
}
