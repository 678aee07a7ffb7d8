//! The search for the best set of shapes, as in [`start`](super::super::separable::start), for all texels of
//! a batch at once.

use glam::Vec3;

use super::super::model::Model;
use super::super::separable::layout::Family;
use super::super::separable::task::Effort;
use super::kernels::{self, DIRECTIONS, EXPONENTS, Kernels, Uploaded};
use lobelia_base::error::Result;
use lobelia_gpu::fit::Fit;

/// The sets of shapes that go on, texel by texel.
pub(super) struct Beam<'a> {
    kernels: &'a Kernels,
    samples: &'a Uploaded,
    family: Family,
    effort: Effort,
    /// A texel's sets, the best first.
    sets: Vec<Vec<Fit>>,
    /// How many lobes they have.
    lobes: Vec<usize>,
}

impl<'a> Beam<'a> {
    /// Starts from sets without lobes, one a texel.
    pub(super) fn new(
        kernels: &'a Kernels,
        samples: &'a Uploaded,
        family: Family,
        effort: Effort,
        starts: &[Fit],
    ) -> Self {
        let sets = starts.iter().map(|&start| vec![start]).collect();
        Self { kernels, samples, family, effort, sets, lobes: vec![0; starts.len()] }
    }

    /// Adds a lobe to the sets of `texels`, which have `lobes` of them; texels where no shape explains more
    /// keep theirs.
    ///
    /// # Errors
    /// A failure when the driver refuses.
    pub(super) fn grow(&mut self, texels: &[usize], lobes: usize) -> Result<()> {
        let texels: Vec<usize> = texels.iter().copied().filter(|&texel| self.lobes[texel] == lobes).collect();
        let sets: Vec<Fit> = texels.iter().flat_map(|&texel| self.sets[texel].iter().copied()).collect();
        if sets.is_empty() {
            return Ok(());
        }
        let scores = self.kernels.scores(self.samples, lobes, &sets)?;
        let mut tried = Vec::with_capacity(sets.len() * self.effort.tries);
        for (set, scores) in sets.iter().zip(scores.chunks_exact(DIRECTIONS * EXPONENTS)) {
            let maxima = best_maxima(scores, self.effort.tries);
            tried.extend(maxima.into_iter().map(|(c, n)| set.with_lobe(lobes, c, n)));
        }
        if tried.is_empty() {
            return Ok(());
        }
        let few = super::super::lm::Limits { iterations: self.effort.steps, ..self.effort.limits };
        self.kernels.minimise(self.samples, self.family, lobes + 1, few, &mut tried, lobes == 0)?;
        // The sets of a texel stand together.
        for of_texel in tried.chunk_by(|a, b| a.texel == b.texel) {
            let mut of_texel = of_texel.to_vec();
            of_texel.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            of_texel.dedup_by(|b, a| (b.cost - a.cost).abs() <= 1e-5 * a.cost);
            of_texel.truncate(self.effort.beam);
            let texel = of_texel[0].texel as usize;
            (self.sets[texel], self.lobes[texel]) = (of_texel, lobes + 1);
        }
        Ok(())
    }

    /// The best sets of `texels`, each optimised to convergence.
    ///
    /// # Errors
    /// A failure when the driver refuses.
    pub(super) fn converged(&self, texels: &[usize]) -> Result<Vec<Model>> {
        let mut models = vec![Model::default(); texels.len()];
        for lobes in 1..=super::super::MOST_LOBES {
            let places: Vec<usize> =
                (0..texels.len()).filter(|&place| self.lobes[texels[place]] == lobes).collect();
            let mut best: Vec<Fit> = places.iter().map(|&place| self.sets[texels[place]][0]).collect();
            if best.is_empty() {
                continue;
            }
            let limits = self.effort.limits;
            self.kernels.minimise(self.samples, self.family, lobes, limits, &mut best, false)?;
            for (place, fit) in places.into_iter().zip(best) {
                models[place] = kernels::model(&fit, lobes);
            }
        }
        Ok(models)
    }
}

/// Direction and exponent of the best local maxima of a set's scores, at most `count`.
fn best_maxima(scores: &[f32], count: usize) -> Vec<(Vec3, f32)> {
    let at = |direction: usize, exponent: usize| scores[direction % DIRECTIONS * EXPONENTS + exponent];
    let is_maximum = |&index: &usize| {
        let (direction, exponent, score) = (index / EXPONENTS, index % EXPONENTS, scores[index]);
        score > 0.0
            && (exponent == 0 || score >= at(direction, exponent - 1))
            && (exponent + 1 == EXPONENTS || score > at(direction, exponent + 1))
            && score >= at(direction + DIRECTIONS - 1, exponent)
            && score > at(direction + 1, exponent)
    };
    let mut maxima: Vec<usize> = (0..scores.len()).filter(is_maximum).collect();
    maxima.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
    let shape = |index: usize| {
        let angle = ((index / EXPONENTS) as f64 + 0.5) / DIRECTIONS as f64 * std::f64::consts::TAU;
        let c = super::super::model::isotropic_c(angle).as_vec3();
        (c, (1u32 << (index % EXPONENTS)) as f32)
    };
    maxima.into_iter().take(count).map(shape).collect()
}
