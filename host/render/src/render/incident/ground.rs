//! What a change of the light works on: receivers, their tree and their transfer.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::emitters::{Emitter, Incident};
use super::harmonics;
use super::polygon::Detail;
use super::transfer::Receivers;
use super::tree::Tree;

/// Receivers with their transfer.
#[derive(Clone, Copy)]
pub(super) struct Ground<'a> {
    pub(super) receivers: &'a Receivers,
    pub(super) tree: &'a Tree,
    /// Coefficients of every receiver's transfer, one after another.
    pub(super) transfers: &'a [f32],
    pub(super) degree: usize,
}

impl Ground<'_> {
    /// Coefficients of a receiver's transfer.
    pub(super) fn transfer(&self, receiver: usize) -> &[f32] {
        let count = harmonics::count(self.degree);
        &self.transfers[receiver * count..(receiver + 1) * count]
    }

    /// Where a receiver is.
    pub(super) fn position(&self, receiver: usize) -> DVec3 {
        self.receivers.positions[receiver].as_dvec3()
    }

    /// t·l.
    pub(super) fn product(&self, receiver: usize, coefficients: impl Fn(usize) -> DVec3) -> DVec3 {
        let terms = self.transfer(receiver).iter().enumerate();
        terms.map(|(i, &t)| coefficients(i) * f64::from(t)).sum()
    }

    /// Irradiance of a receiver by incident radiance at its own place, as it comes: ringing may make it
    /// negative.
    pub(super) fn exact(&self, emitters: &[Emitter], receiver: usize) -> DVec3 {
        let own = Incident::at(emitters, self.position(receiver), self.degree, Detail::Values);
        self.product(receiver, |i| own.values[i])
    }

    /// The same of all receivers: a sample at every vertex.
    pub(super) fn every(&self, emitters: &[Emitter]) -> Vec<Vec3> {
        let receivers = (0..self.receivers.len()).into_par_iter();
        receivers.map(|receiver| self.exact(emitters, receiver).as_vec3()).collect()
    }
}
