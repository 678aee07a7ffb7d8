//! Levenberg–Marquardt over the shapes alone (variable projection): at every step the amplitudes of all
//! channels follow in closed form.
//!
//! The Jacobian is Kaufman's approximation (1975); damping is Marquardt's with Nielsen's rule, as in
//! [`lm`](super::super::lm).

use pulp::{Arch, WithSimd};

use super::super::coat::WIDTHS;
use super::super::linear::solve_spd;
use super::super::lm::{Descent, Limits};
use super::super::model::{EXPONENTS, Model};
use super::super::samples::MOST_OVER_SEEN;
use super::bound::{self, Albedos, Bound, Caps};
use super::columns::{Columns, Gram};
use super::data::Data;
use super::extended;
use super::form::Form;
use super::layout::{Family, Layout, MOST_LOBES, UNKNOWNS, WIDTH};
use super::normal::{self, Amplitudes, Most, Normal, Pressing};
use super::shape;

/// Limits of lobes above the surface, over the largest value that was measured.
pub type Tame = [f64; MOST_LOBES];
/// No limits.
pub const WILD: Tame = [f64::INFINITY; MOST_LOBES];
/// Limit of a lobe that only fits noise.
pub const UNTOLD: f64 = 1.0;

/// The solver with its buffers; one a thread.
#[derive(Debug, Clone)]
pub struct Solver {
    /// Samples of the texel at hand.
    pub data: Data,
    /// Columns of the model that was evaluated last.
    pub columns: Columns,
    /// Their products.
    pub gram: Box<Gram>,
    /// What the vector code is compiled for.
    pub arch: Arch,
    /// Largest directional albedo that amplitudes may come to, and that of a ρ_d a channel that is no
    /// unknown; none where they are free.
    bound: Option<Bound>,
    albedos: Albedos,
    tamed: Tame,
    trial: Model,
    /// What was evaluated last, and its amplitudes.
    last: Option<(Family, bool, Amplitudes)>,
    last_model: Model,
}

impl Default for Solver {
    fn default() -> Self {
        Self {
            data: Data::default(),
            columns: Columns::default(),
            gram: Box::new([0.0; WIDTH * WIDTH]),
            arch: Arch::new(),
            bound: None,
            albedos: Albedos::default(),
            tamed: WILD,
            trial: Model::default(),
            last: None,
            last_model: Model::default(),
        }
    }
}

/// Columns of the data alone, as vector code.
struct Begin<'a>(&'a mut Columns, &'a Data, &'a mut Gram);

impl WithSimd for Begin<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.0.begin(self.1, self.2);
    }
}

/// Columns of a model, as vector code.
struct Fill<'a>(&'a mut Columns, &'a Data, &'a mut Gram, &'a Model, Layout);

impl WithSimd for Fill<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self(columns, data, gram, model, layout) = self;
        let family = layout.family;
        if !layout.extension.is_none() {
            let forms: Vec<extended::Form> =
                (0..layout.lobes).map(|index| extended::form(model, index, family, data.cone)).collect();
            return columns.fill_extended(&forms, model.coat.map(|coat| coat.alpha), data, layout, gram);
        }
        let products = &data.products;
        let all: [&[f64]; 4] = [&products.xx, &products.yy, &products.zz, &products.xy];
        let (lobes, beta) = (&model.lobes, model.beta);
        let count = lobes.len().min(MOST_LOBES);
        // A form for every place, so that nothing is allocated; the places beyond the lobes are not read.
        match family {
            Family::Isotropic => {
                let blank = Form { base: [0.0; 2], tangents: [[0.0; 2]; 1], n: 1.0 };
                let mut forms = [blank; MOST_LOBES];
                for (form, lobe) in forms.iter_mut().zip(lobes) {
                    *form = shape::isotropic_form(lobe);
                }
                columns.fill(&forms[..count], [&products.plane, &products.zz], gram);
            }
            Family::Anisotropic | Family::Split => {
                let blank = Form { base: [0.0; 4], tangents: [[0.0; 4]; 3], n: 1.0 };
                let mut forms = [blank; MOST_LOBES];
                for (form, lobe) in forms.iter_mut().zip(lobes) {
                    *form = match family {
                        Family::Split => shape::split_form(lobe),
                        _ => shape::anisotropic_form(lobe, beta),
                    };
                }
                columns.fill(&forms[..count], all, gram);
            }
        }
    }
}

impl Solver {
    /// Takes over the data as it is aimed; to be called whenever that has changed.
    pub fn begin(&mut self) {
        self.last = None;
        self.arch.dispatch(Begin(&mut self.columns, &self.data, &mut self.gram));
    }

    /// The best amplitudes for a model's shapes; leaves columns and their products in the buffers.
    pub fn evaluate(&mut self, family: Family, diffuse: bool, model: &Model) -> Amplitudes {
        if let Some((last, with, at)) = self.last
            && (last, with) == (family, diffuse)
            && self.last_model == *model
        {
            return at;
        }
        let layout = self.layout(family, diffuse, model);
        self.arch.dispatch(Fill(&mut self.columns, &self.data, &mut self.gram, model, layout));
        let most = self.most(model);
        let mut at = normal::amplitudes(&self.gram, layout, &most);
        if let Some(bound) = self.bound {
            let caps = Caps { bound, most, scale: self.data.scale };
            bound::hold(&mut self.albedos, &mut at, &self.gram, layout, model, &caps);
        }
        self.last = Some((family, diffuse, at));
        self.last_model.clone_from(model);
        at
    }

    fn most(&self, model: &Model) -> Most {
        let mut shares = [1.0; MOST_LOBES];
        for ((share, lobe), limit) in shares.iter_mut().zip(&model.lobes).zip(self.tamed) {
            if limit.is_finite() {
                *share = (limit / (MOST_OVER_SEEN * lobe.growth())).min(1.0);
            }
        }
        Most { lobes: self.data.most, coats: self.data.scale, shares }
    }

    /// From here on no lobe exceeds its limit, times the largest value that was measured, anywhere above the
    /// surface.
    pub fn tame(&mut self, limits: Tame) {
        if self.tamed != limits {
            (self.tamed, self.last) = (limits, None);
        }
    }

    /// Holds all amplitudes from here on to a bound, or frees them.
    pub fn hold(&mut self, bound: Option<Bound>) {
        if self.bound != bound {
            (self.bound, self.last) = (bound, None);
        }
    }

    /// The largest directional albedo of a model over what a bound allows; above 1 where it is broken.
    pub fn excess(&mut self, task: (Family, bool), model: &Model, at: &Amplitudes, bound: Bound) -> f64 {
        let layout = self.layout(task.0, task.1, model);
        let caps = Caps { bound, most: self.most(model), scale: self.data.scale };
        bound::excess(&mut self.albedos, layout, model, at, &caps)
    }

    /// The normal equations of the shapes' unknowns at a model that was evaluated last.
    pub fn normal(&self, layout: Layout, model: &Model, at: &Amplitudes) -> Normal {
        if at.pressing.iter().all(Pressing::is_empty) {
            return normal::normal(&self.gram, layout, at);
        }
        bound::normal(&self.gram, layout, model, at, &self.data)
    }

    /// Which columns are what for a model.
    pub fn layout(&self, family: Family, diffuse: bool, model: &Model) -> Layout {
        Layout { channels: self.data.channels, diffuse, ..Layout::of(family, model) }
    }

    /// Lowers the cost from the shapes of `model` as far as the limits allow; never worse than the start.
    pub fn minimise(
        &mut self,
        family: Family,
        diffuse: bool,
        limits: Limits,
        model: &mut Model,
    ) -> (Amplitudes, Descent) {
        let layout = self.layout(family, diffuse, model);
        self.refer(model);
        let mut at = self.evaluate(family, diffuse, model);
        let outcome =
            |at: &Amplitudes, iterations, converged| Descent { cost: at.cost, iterations, converged };
        if layout.size() == 0 {
            return (at, outcome(&at, 0, true));
        }
        let mut normal = self.normal(layout, model, &at);
        let (mut damping, mut growth) = (1e-3, 4.0);
        let floor = 1e-15 * (1..=layout.channels).map(|c| self.gram[c * WIDTH + c]).sum::<f64>();
        for iteration in 0..limits.iterations {
            if at.cost <= floor {
                return (at, outcome(&at, iteration, true));
            }
            let mut improved = false;
            if let Some(step) = solve(&normal, layout, model, damping) {
                let predicted = predicted_gain(&normal, &step);
                if predicted <= limits.tolerance * at.cost && damping <= 1.0 {
                    return (at, outcome(&at, iteration, true));
                }
                let mut trial = std::mem::take(&mut self.trial);
                trial.clone_from(model);
                shape::advance(family, &mut trial, &step);
                self.refer(&mut trial);
                let next = self.evaluate(family, diffuse, &trial);
                if next.cost < at.cost {
                    let gain = (at.cost - next.cost) / predicted.max(1e-300);
                    damping = (damping * (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(0.1, 1.0)).max(1e-12);
                    (growth, improved, at) = (4.0, true, next);
                    std::mem::swap(model, &mut trial);
                }
                self.trial = trial;
            }
            if improved {
                normal = self.normal(layout, model, &at);
            } else {
                damping *= growth;
                growth *= 4.0;
                if damping > 1e9 {
                    return (at, outcome(&at, iteration, true));
                }
            }
        }
        (at, outcome(&at, limits.iterations, false))
    }

    /// Refers every lobe to the largest base within the cone of the samples.
    pub fn refer(&self, model: &mut Model) {
        for lobe in &mut model.lobes {
            *lobe = lobe.within(self.data.cone);
        }
    }
}

/// The damped step; none where the equations are singular. Exponents at a bound that they would pass, and
/// shapes of lobes without amplitude, stay.
pub(super) fn solve(normal: &Normal, layout: Layout, model: &Model, damping: f64) -> Option<[f64; UNKNOWNS]> {
    let size = normal.size;
    let mut fixed = [false; UNKNOWNS];
    let mut bound = |at: usize, value: f64, [low, high]: [f64; 2]| {
        let downhill = -normal.gradient[at];
        fixed[at] = (value <= low && downhill < 0.0) || (value >= high && downhill > 0.0);
    };
    for (index, lobe) in model.lobes.iter().enumerate() {
        bound(layout.unknown(index, 0), lobe.n, EXPONENTS);
        if let Some(grazing) = lobe.n_grazing {
            bound(layout.unknown(index, layout.derivatives(index) - 1), grazing, EXPONENTS);
        }
    }
    if let Some(coat) = model.coat {
        bound(layout.unknown(layout.lobes, 0), coat.alpha, WIDTHS);
    }
    let largest = (0..size).map(|i| normal.matrix[i * size + i]).fold(0.0, f64::max);
    let mut damped = vec![0.0; size * size];
    let mut step = [0.0; UNKNOWNS];
    for i in 0..size {
        let diagonal = normal.matrix[i * size + i];
        if fixed[i] || diagonal <= 1e-13 * largest {
            damped[i * size + i] = 1.0;
            continue;
        }
        step[i] = -normal.gradient[i];
        for j in 0..size {
            let dead = fixed[j] || normal.matrix[j * size + j] <= 1e-13 * largest;
            damped[i * size + j] = if dead { 0.0 } else { normal.matrix[i * size + j] };
        }
        damped[i * size + i] = diagonal * (1.0 + damping);
    }
    solve_spd(&mut damped, &mut step[..size]).then_some(step)
}

/// The fall in cost that the linear model promises for a step.
pub(super) fn predicted_gain(normal: &Normal, step: &[f64; UNKNOWNS]) -> f64 {
    let size = normal.size;
    let mut gain = 0.0;
    for i in 0..size {
        let product: f64 = (0..size).map(|j| normal.matrix[i * size + j] * step[j]).sum();
        gain -= step[i] * (2.0 * normal.gradient[i] + product);
    }
    gain
}
