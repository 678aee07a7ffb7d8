//! Samples of incident radiance, and what they are between.
//!
//! A sample stands for the receivers within its radius. Smooth samples are extended by their gradients and
//! blended with the weights of Franke and Little, ((R − d)₊ / R d)²: they end smoothly and interpolate.
//! Published ones are constant and blended by 1/d (2.13), which jumps where one ends.

use glam::Vec3;
use rayon::prelude::*;

use super::emitters::Incident;
use super::ground::Ground;
use super::harmonics;

/// How samples are blended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Blend {
    /// First order, with weights that end smoothly.
    Smooth,
    /// Constant, with weights 1/d.
    Published,
}

/// A sample that is kept.
pub(super) struct Sample {
    mean: Vec3,
    radius: f32,
    /// Coefficients, then their slopes along x, y and z.
    light: Vec<[Vec3; 4]>,
}

impl Sample {
    /// Of incident radiance at a point; constant where gradients were not asked for.
    pub(super) fn new(degree: usize, mean: Vec3, radius: f32, incident: &Incident) -> Self {
        let light = |i: usize| {
            let [x, y, z] = incident.gradients.get(i).copied().unwrap_or_default();
            [incident.values[i], x, y, z].map(|value| value.as_vec3())
        };
        Self { mean, radius, light: (0..harmonics::count(degree)).map(light).collect() }
    }

    /// Irradiance that it foretells for a receiver.
    pub(super) fn irradiance(&self, ground: &Ground<'_>, receiver: usize) -> Vec3 {
        let mut sums = [Vec3::ZERO; 4];
        for (&t, light) in ground.transfer(receiver).iter().zip(&self.light) {
            sums.iter_mut().zip(light).for_each(|(sum, light)| *sum += *light * t);
        }
        let [value, x, y, z] = sums;
        let to = ground.receivers.positions[receiver] - self.mean;
        value + x * to.x + y * to.y + z * to.z
    }
}

/// The sample of a node of the tree, if it is kept, and the box of all those at it and below.
#[derive(Clone, Copy)]
struct Place {
    low: Vec3,
    high: Vec3,
    sample: Option<u32>,
}

/// Samples that are kept, by the nodes of the tree that they are of.
pub(super) struct Samples {
    kept: Vec<Sample>,
    nodes: Vec<Option<Place>>,
    blend: Blend,
    /// Samples taken, those that are not kept among them.
    pub(super) taken: usize,
    /// Whether a cap ended it.
    pub(super) capped: bool,
    /// The error that was allowed: radiance, of the published oracle its own measure.
    pub(super) bound: f64,
}

impl Samples {
    /// Of nodes with their samples.
    pub(super) fn new(ground: &Ground<'_>, blend: Blend, kept: Vec<(usize, Sample)>) -> Self {
        let nodes = &ground.tree.nodes;
        let mut places = vec![None; nodes.len()];
        let mut samples = Vec::with_capacity(kept.len());
        for (node, sample) in kept {
            let (low, high) = (sample.mean - sample.radius, sample.mean + sample.radius);
            places[node] = Some(Place { low, high, sample: Some(samples.len() as u32) });
            samples.push(sample);
        }
        // Children come after their parents.
        for index in (0..nodes.len()).rev() {
            let below =
                nodes[index].children.into_iter().flat_map(|first| [places[first], places[first + 1]]);
            let all = below.flatten().fold(places[index], |all: Option<Place>, one| {
                let Some(all) = all else { return Some(Place { sample: None, ..one }) };
                Some(Place { low: all.low.min(one.low), high: all.high.max(one.high), ..all })
            });
            places[index] = all;
        }
        let taken = samples.len();
        Self { kept: samples, nodes: places, blend, taken, capped: false, bound: 0.0 }
    }

    /// The same with what is known of how they came about.
    pub(super) fn told(self, taken: usize, capped: bool, bound: f64) -> Self {
        Self { taken, capped, bound, ..self }
    }

    /// Irradiance of every receiver.
    pub(super) fn irradiance(&self, ground: &Ground<'_>) -> Vec<Vec3> {
        let receivers = 0..ground.receivers.len();
        if self.kept.is_empty() {
            return vec![Vec3::ZERO; receivers.len()];
        }
        receivers.into_par_iter().map(|receiver| self.at(ground, receiver)).collect()
    }

    fn at(&self, ground: &Ground<'_>, receiver: usize) -> Vec3 {
        let position = ground.receivers.positions[receiver];
        let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
        // What a sample at the receiver itself says stands alone; there may be several, of sides of one
        // place.
        let (mut own, mut owners) = (Vec3::ZERO, 0.0);
        let mut waiting = vec![0];
        while let Some(index) = waiting.pop() {
            let Some(Place { low, high, sample }) = self.nodes[index] else { continue };
            if position.cmplt(low).any() || position.cmpgt(high).any() {
                continue;
            }
            waiting
                .extend(ground.tree.nodes[index].children.into_iter().flat_map(|first| [first, first + 1]));
            let Some(sample) = sample.map(|sample| &self.kept[sample as usize]) else { continue };
            let distance = position.distance(sample.mean);
            if distance <= 1e-6 * sample.radius {
                own += sample.irradiance(ground, receiver);
                owners += 1.0;
            } else if distance <= sample.radius {
                let inverse = distance.recip();
                let weight = match self.blend {
                    Blend::Smooth => (inverse - sample.radius.recip()).powi(2),
                    Blend::Published => inverse,
                };
                sum += sample.irradiance(ground, receiver) * weight;
                weights += weight;
            }
        }
        match (owners > 0.0, weights > 0.0) {
            (true, _) => own / owners,
            (false, true) => sum / weights,
            // Published domains leave some receivers bare.
            (false, false) => {
                self.nearest(position).map_or(Vec3::ZERO, |one| one.irradiance(ground, receiver))
            }
        }
    }

    fn nearest(&self, position: Vec3) -> Option<&Sample> {
        let distance = |sample: &&Sample| sample.mean.distance_squared(position);
        self.kept.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// Samples that are kept.
    pub(super) fn count(&self) -> usize {
        self.kept.len()
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        let lights: usize = self.kept.iter().map(|sample| size_of_val(&sample.light[..])).sum();
        lights + size_of_val(&self.nodes[..])
    }
}
