//! Scales of axes and colour maps: linear or logarithmic, with ticks at round values.

/// A range of values, laid out linearly or by their logarithm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Lowest value.
    pub low: f64,
    /// Highest value.
    pub high: f64,
    /// Whether by the logarithm; then both ends are above 0.
    pub log: bool,
}

impl Scale {
    /// A linear scale; an empty range is widened.
    pub fn linear(low: f64, high: f64) -> Self {
        let widen = if high > low { 0.0 } else { (0.05 * low.abs()).max(0.01) };
        Self { low: low - widen, high: high + widen, log: false }
    }

    /// A logarithmic scale; an empty range is widened, and values at or below 0 give way to a small one.
    pub fn log(low: f64, high: f64) -> Self {
        let high = if high > 0.0 { high } else { 1.0 };
        let low = if low > 0.0 { low.min(high) } else { high * 1e-3 };
        let widen = if high / low > 1.02 { 1.0 } else { 1.25 };
        Self { low: low / widen, high: high * widen, log: true }
    }

    /// The scale that holds all `values` from one percentile to another, leaving out what is not finite.
    pub fn of(values: &[f32], low: f64, high: f64, log: bool) -> Self {
        let (low, high) = (quantile(values, low), quantile(values, high));
        if log { Self::log(low, high) } else { Self::linear(low, high) }
    }

    /// Widened to values 1, 2 or 5 times a power of ten.
    pub fn rounded(self) -> Self {
        let round = |value: f64, up: bool| {
            let decade = 10f64.powf(value.log10().floor());
            let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * decade);
            let fits = |step: &f64| if up { *step >= value * 0.999 } else { *step <= value * 1.001 };
            if up { steps.into_iter().find(fits) } else { steps.into_iter().rev().find(fits) }
                .unwrap_or(value)
        };
        Self { low: round(self.low, false), high: round(self.high, true), ..self }
    }

    /// Where a value lies, 0 at the low end and 1 at the high one; beyond outside.
    pub fn place(&self, value: f64) -> f64 {
        if self.log {
            (value.max(f64::MIN_POSITIVE) / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    /// Round values in the range, at most about `most`.
    pub fn ticks(&self, most: usize) -> Vec<f64> {
        if !self.log {
            return linear_ticks(self.low, self.high, most);
        }
        let decades: &[&[f64]] = &[&[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0], &[1.0, 2.0, 5.0], &[1.0]];
        for steps in decades {
            let ticks = self.log_ticks(steps);
            if ticks.len() <= most.max(2) {
                return if ticks.len() >= 2 { ticks } else { linear_ticks(self.low, self.high, most) };
            }
        }
        self.log_ticks(&[1.0])
    }

    fn log_ticks(&self, steps: &[f64]) -> Vec<f64> {
        let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        let all = (first..=last).flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)));
        all.filter(|value| *value >= self.low * 0.999 && *value <= self.high * 1.001).collect()
    }
}

/// Multiples of 1, 2 or 5 times a power of ten from `low` to `high`.
fn linear_ticks(low: f64, high: f64, most: usize) -> Vec<f64> {
    let rough = (high - low) / most.max(1) as f64;
    if !(rough > 0.0 && rough.is_finite()) {
        return vec![low];
    }
    let decade = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0]
        .map(|s| s * decade)
        .into_iter()
        .find(|s| *s >= rough * 0.999)
        .unwrap_or(10.0 * decade);
    let slack = 1e-6 * step;
    let first = ((low - slack) / step).ceil() as i64;
    let last = ((high + slack) / step).floor() as i64;
    (first..=last).map(|k| k as f64 * step).collect()
}

/// The value below which this share (0..1) of the finite `values` lies; NaN without any.
pub fn quantile(values: &[f32], share: f64) -> f64 {
    let mut sorted: Vec<f32> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    let index = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(index).copied().map_or(f64::NAN, f64::from)
}

/// How many values fall into each of equal bins of a scale.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Histogram {
    /// Number of values a bin; those outside of the scale count in the end bins, NaN nowhere.
    pub counts: Vec<usize>,
}

impl Histogram {
    /// Counts `values` in `bins` equal parts of the scale.
    pub fn new(values: impl IntoIterator<Item = f64>, scale: &Scale, bins: usize) -> Self {
        let mut counts = vec![0; bins];
        for value in values.into_iter().filter(|value| value.is_finite()) {
            let bin = (scale.place(value) * bins as f64).max(0.0) as usize;
            counts[bin.min(bins - 1)] += 1;
        }
        Self { counts }
    }

    /// The fullest bin.
    pub fn most(&self) -> usize {
        self.counts.iter().copied().max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finite_value_is_counted_once_wherever_it_lies() {
        let scale = Scale::log(1e-3, 1.0);
        let values = (0..1000).map(|k| 1e-4 * 1.01f64.powi(k)).chain([f64::NAN, 0.0, -1.0, f64::INFINITY]);
        let histogram = Histogram::new(values, &scale, 24);
        assert_eq!(histogram.counts.iter().sum::<usize>(), 1002);
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(Scale::log(0.009, 0.6).ticks(6), [0.01, 0.02, 0.05, 0.1, 0.2, 0.5]);
        assert_eq!(Scale::linear(0.0, 0.93).ticks(5), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8]);
        assert_eq!(Scale::log(0.012, 0.33).rounded(), Scale { low: 0.01, high: 0.5, log: true });
    }

    #[test]
    fn the_ends_of_a_scale_lie_at_0_and_1_and_empty_ranges_are_widened() {
        for scale in
            [Scale::log(0.01, 5.0), Scale::linear(-2.0, 3.0), Scale::linear(1.0, 1.0), Scale::log(0.0, 0.0)]
        {
            assert_eq!((scale.place(scale.low), scale.place(scale.high)), (0.0, 1.0));
        }
        assert!((Scale::log(0.01, 1.0).place(0.1) - 0.5).abs() < 1e-12);
    }
}
