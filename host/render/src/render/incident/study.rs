//! Ways to sample beside one another on one scene: what charts and tests compare.

use std::time::Instant;

use glam::Vec3;

use super::baking;
use super::emitters::{self, Emitter};
use super::ground::Ground;
use super::published::{self, Oracle};
use super::samples::Samples;
use super::second_order;
use super::transfer::Receivers;
use super::tree::Tree;
use super::{Renderer, Settings};
use crate::render::bake::Baked;
use crate::scene::Scene;
use lobelia_base::error::Result;

/// A way to sample incident radiance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sampling {
    /// The method's own: second derivatives against the transfer, smooth first-order samples; the error
    /// allowed over the root mean square of radiance.
    SecondOrder(f64),
    /// The source's, with its oracle and bound, and whether the samples of nodes that were parted are kept.
    Published {
        /// What foretells errors.
        oracle: Oracle,
        /// The oracle's bound, in its own unit.
        epsilon: f64,
        /// Whether nodes that are parted keep their samples, as published.
        ancestors: bool,
    },
    /// Vector quantisation, every receiver blending all samples by 1/dᵇ.
    Quantised {
        /// b.
        exponent: f32,
    },
    /// One sample in the middle: light from afar.
    One,
    /// A sample at every vertex: what the others are judged by.
    Every,
}

/// What came of one.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Samples taken.
    pub samples: usize,
    /// Of them those that are blended.
    pub kept: usize,
    /// The error that was allowed: of the method's own way as radiance, of a published oracle in its own
    /// unit.
    pub bound: Option<f64>,
    /// Seconds of placing and taking them.
    pub sampling_seconds: f64,
    /// Seconds of bringing them to every vertex.
    pub reconstruction_seconds: f64,
    /// Radiance a receiver before it is clamped at 0, by the largest diffuse reflectance of its object.
    pub radiance: Vec<Vec3>,
}

impl Outcome {
    /// Root mean square over receivers and channels of the difference from another.
    pub fn rmse(&self, truth: &Self) -> f64 {
        let square = |(a, b): (&Vec3, &Vec3)| f64::from((*a - *b).length_squared());
        let squares: f64 = self.radiance.iter().zip(&truth.radiance).map(square).sum();
        (squares / (3 * truth.radiance.len().max(1)) as f64).sqrt()
    }

    /// Root mean square of its own radiance.
    pub fn rms(&self) -> f64 {
        let squares: f64 = self.radiance.iter().map(|one| f64::from(one.length_squared())).sum();
        (squares / (3 * self.radiance.len().max(1)) as f64).sqrt()
    }
}

/// A scene with its transfer and its emitters as they stand.
pub struct Study {
    receivers: Receivers,
    tree: Tree,
    transfers: Vec<f32>,
    emitters: Vec<Emitter>,
    degree: usize,
}

impl Study {
    /// Bakes a scene in memory.
    ///
    /// # Errors
    /// Those of [`Renderer::prepare`].
    pub fn new(scene: &Scene, settings: &Settings) -> Result<Self> {
        let baked = Baked::in_memory(settings as &dyn Renderer, scene)?;
        let now = scene.at(&scene.state())?;
        let receivers = Receivers::new(&now);
        let degree = settings.degree as usize;
        Ok(Self {
            transfers: baking::transfers(&baked, receivers.len(), degree)?,
            tree: Tree::new(&receivers.positions),
            emitters: emitters::of_lights(&now.lights),
            degree,
            receivers,
        })
    }

    /// Vertices, those of open meshes once a side.
    pub fn receivers(&self) -> usize {
        self.receivers.len()
    }

    /// Samples in one way, with `most` samples.
    pub fn sample(&self, sampling: Sampling, most: usize) -> Outcome {
        let (receivers, tree, transfers) = (&self.receivers, &self.tree, &self.transfers[..]);
        let ground = Ground { receivers, tree, transfers, degree: self.degree };
        let start = Instant::now();
        let seconds = || start.elapsed().as_secs_f64();
        let blended = |samples: Samples| {
            let counts = (samples.taken, samples.count(), Some(samples.bound));
            (counts, seconds(), samples.irradiance(&ground))
        };
        let ((samples, kept, bound), sampling_seconds, irradiance) = match sampling {
            Sampling::SecondOrder(epsilon) => {
                blended(second_order::place(&ground, &self.emitters, epsilon, most))
            }
            Sampling::Published { oracle, epsilon, ancestors } => {
                blended(published::place(&ground, &self.emitters, (oracle, ancestors), epsilon, most))
            }
            Sampling::One => {
                blended(published::place(&ground, &self.emitters, (Oracle::Printed, true), f64::MAX, 1))
            }
            Sampling::Quantised { exponent } => {
                let samples = published::Quantised::new(&ground, &self.emitters, most);
                let count = samples.count();
                ((count, count, None), seconds(), samples.irradiance(&ground, exponent))
            }
            Sampling::Every => {
                let irradiance = ground.every(&self.emitters);
                ((irradiance.len(), irradiance.len(), None), seconds(), irradiance)
            }
        };
        let reconstruction_seconds = seconds() - sampling_seconds;
        let brightness = self.receivers.brightness.iter();
        let radiance = irradiance.into_iter().zip(brightness).map(|(one, &rho)| one * rho).collect();
        Outcome { samples, kept, bound, sampling_seconds, reconstruction_seconds, radiance }
    }
}
