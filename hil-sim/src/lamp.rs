//! The lamp: warms up exponentially, drifts slowly, and is watched by a photodiode with noise and a 12-bit
//! converter.

use crate::config::LampConfig;
use crate::noise;

/// Shares and periods, relative to the slowest, of the sines whose sum is the drift.
const DRIFT: [(f64, f64); 3] = [(0.6, 1.0), (0.3, 1.0 / 2.7), (0.1, 1.0 / 7.3)];
/// Highest reading of the converter.
const FULL_SCALE: f64 = 4095.0;
/// Points at which radiance is taken to mean it over an exposure.
const MEAN_POINTS: u32 = 16;

/// A lamp.
#[derive(Debug)]
pub(crate) struct Lamp {
    config: LampConfig,
    seed: u64,
    burning: bool,
    level: f64,
    /// Warmth, 0 to 1, when it was last switched.
    warmth: f64,
    switched_us: u64,
}

impl Lamp {
    pub(crate) fn new(config: &LampConfig, seed: u64) -> Self {
        Self { config: config.clone(), seed, burning: false, level: 0.0, warmth: 0.0, switched_us: 0 }
    }

    /// Switches it on or off.
    pub(crate) fn switch(&mut self, now_us: u64, burning: bool) {
        if burning != self.burning {
            self.warmth = self.warmth_at(now_us as f64);
            self.switched_us = now_us;
            self.burning = burning;
        }
    }

    /// Sets its level, 0 to 1.
    pub(crate) fn dim(&mut self, level: f64) {
        self.level = level;
    }

    /// The level that it burns at, 0 to 1.
    pub(crate) fn level(&self) -> f64 {
        if self.burning { self.level } else { 0.0 }
    }

    fn warmth_at(&self, us: f64) -> f64 {
        let seconds = (us - self.switched_us as f64) * 1e-6;
        let rest = (-seconds / self.config.warm_up_time_constant_s.max(1e-9)).exp();
        if self.burning { 1.0 - (1.0 - self.warmth) * rest } else { self.warmth * rest }
    }

    fn drift_at(&self, us: f64) -> f64 {
        let turns = us * 1e-6 / self.config.drift_period_s.max(1e-9);
        let wave = |(k, (share, period)): (u64, (f64, f64))| {
            let phase = noise::unit(&[self.seed, 0xd21f, k]);
            share * (std::f64::consts::TAU * (turns / period + phase)).sin()
        };
        1.0 + self.config.drift_amplitude * (0..).zip(DRIFT).map(wave).sum::<f64>()
    }

    /// Radiance relative to the warm lamp at full level without drift.
    fn relative_at(&self, us: f64) -> f64 {
        if self.burning { self.level * self.warmth_at(us) * self.drift_at(us) } else { 0.0 }
    }

    /// Mean relative radiance over a time.
    pub(crate) fn mean_relative(&self, start_us: u64, end_us: u64) -> f64 {
        let part = (end_us - start_us) as f64 / f64::from(MEAN_POINTS);
        let at = |k: u32| self.relative_at(start_us as f64 + part * (f64::from(k) + 0.5));
        (0..MEAN_POINTS).map(at).sum::<f64>() / f64::from(MEAN_POINTS)
    }

    /// What the photodiode's converter reads.
    pub(crate) fn reading(&self, now_us: u64) -> u16 {
        self.read_at(now_us as f64, now_us)
    }

    /// The same between two µs.
    pub(crate) fn reading_ns(&self, now_ns: u64) -> u16 {
        self.read_at(now_ns as f64 * 1e-3, now_ns)
    }

    fn read_at(&self, us: f64, key: u64) -> u16 {
        let noise = self.config.photodiode_noise * noise::normal(&[self.seed, 0xad0c, key]);
        let bright = (us * 1e-6 * self.config.ripple_hz).fract() < 0.5;
        let ripple = if bright { self.config.ripple } else { -self.config.ripple };
        let counts = self.relative_at(us) * self.config.photodiode_counts * (1.0 + ripple) * (1.0 + noise);
        counts.round().clamp(0.0, FULL_SCALE) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    fn burning(config: &LampConfig) -> Lamp {
        let mut lamp = Lamp::new(config, 3);
        lamp.switch(0, true);
        lamp.dim(1.0);
        lamp
    }

    #[test]
    fn lamp_comes_up_by_its_time_constant() {
        let config = LampConfig { drift_amplitude: 0.0, ..LampConfig::default() };
        let lamp = burning(&config);
        let after_one = lamp.mean_relative(180 * S, 180 * S + 2);
        assert!((after_one - (1.0 - (-1.0f64).exp())).abs() < 1e-6);
        assert!((lamp.mean_relative(4000 * S, 4001 * S) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn drift_stays_within_its_amplitude_and_uses_most_of_it() {
        let config =
            LampConfig { drift_amplitude: 0.05, warm_up_time_constant_s: 1e-6, ..LampConfig::default() };
        let lamp = burning(&config);
        let off = (1..100_000u64).map(|s| (lamp.relative_at((s * S) as f64) - 1.0).abs()).fold(0.0, f64::max);
        assert!(off <= 0.05 && off > 0.04, "{off}");
    }

    #[test]
    fn readings_follow_radiance_within_noise() {
        let lamp = burning(&LampConfig::default());
        let count = 1000;
        let mean =
            (0..count).map(|k| f64::from(lamp.reading(5000 * S + k * 100))).sum::<f64>() / count as f64;
        let truth = lamp.mean_relative(5000 * S, 5000 * S + count * 100) * 3000.0;
        // Five standard errors: noise of 3 counts and rounding of 0.3.
        assert!((mean - truth).abs() < 5.0 * 3.1 / (count as f64).sqrt(), "{mean} against {truth}");
    }

    #[test]
    fn lamp_switched_off_is_dark_and_cools() {
        let mut lamp = burning(&LampConfig::default());
        lamp.switch(3000 * S, false);
        assert_eq!(lamp.mean_relative(3000 * S, 3001 * S), 0.0);
        lamp.switch(3180 * S, true);
        let again = lamp.mean_relative(3180 * S, 3180 * S + 10);
        assert!(again > 0.3 && again < 0.4, "{again}");
    }
}
