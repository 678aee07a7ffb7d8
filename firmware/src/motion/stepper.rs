//! When to make each step, so that speed and acceleration stay within their limits and the motion ends exactly on target.
//!
//! A ramp is told by its index n: the number of steps in which the motor can stop. The speed after n steps of constant
//! acceleration a from rest is v(n) = √(2·a·n), and a step between speeds u and v takes exactly 2/(u + v). Each step
//! goes one index up, stays, or goes one down, whichever still lets it stop at the target. Speeds are in 1/256 steps/s,
//! times in 1/256 µs; the only costs are one integer root and one division a step.

/// 1/256 µs in a second, times the 1/256 of a speed.
const SECOND_Q16: u64 = 1_000_000 << 16;

/// One motor's position and its run toward a target.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stepper {
    position: i32,
    target: i32,
    running: bool,
    forward: bool,
    /// Ramp index and speed at the end of the step that is due.
    index: u32,
    speed_q8: u64,
    max_speed_q8: u64,
    acceleration: u64,
    due_q8: u64,
}

impl Stepper {
    /// Position in steps.
    pub(crate) fn position(&self) -> i32 {
        self.position
    }

    /// Calls the present position by another number. Only at rest.
    pub(crate) fn set_position(&mut self, position: i32) {
        self.position = position;
        self.target = position;
    }

    /// Whether a step is due.
    pub(crate) fn running(&self) -> bool {
        self.running
    }

    /// Whether the run goes, or the last one went, toward higher steps.
    pub(crate) fn forward(&self) -> bool {
        self.forward
    }

    /// When the next step is due, in whole µs; never if not running.
    pub(crate) fn due_us(&self) -> u64 {
        if self.running { self.due_q8.div_ceil(256) } else { u64::MAX }
    }

    /// Starts a run from rest. Speed in steps/s and acceleration in steps/s², both above 0.
    pub(crate) fn start(&mut self, now_us: u64, target: i32, max_speed: u32, acceleration: u32) {
        self.target = target;
        self.forward = target > self.position;
        self.max_speed_q8 = u64::from(max_speed) << 8;
        self.acceleration = u64::from(acceleration);
        self.index = 0;
        self.speed_q8 = 0;
        self.running = true;
        self.schedule(now_us << 8);
    }

    /// Counts the step that was just made and plans the next. A step made late delays the next, so that the speed limit
    /// holds whatever the caller does.
    pub(crate) fn stepped(&mut self, now_us: u64) {
        self.position += if self.forward { 1 } else { -1 };
        let now_q8 = now_us << 8;
        let late = now_q8.saturating_sub(self.due_q8) >= 256;
        self.schedule(if late { now_q8 } else { self.due_q8 });
    }

    /// Ends the run after `distance` more steps, or as soon as it can come to rest.
    pub(crate) fn shorten(&mut self, distance: u32) {
        if self.running {
            let distance = distance.max(self.index + 1).min(self.target.abs_diff(self.position));
            self.target = self.ahead(distance);
        }
    }

    /// Ceases at once, without a ramp.
    pub(crate) fn halt(&mut self) {
        self.running = false;
        self.index = 0;
        self.speed_q8 = 0;
    }

    fn ahead(&self, distance: u32) -> i32 {
        if self.forward {
            self.position.saturating_add_unsigned(distance)
        } else {
            self.position.saturating_sub_unsigned(distance)
        }
    }

    /// v(n), limited.
    fn speed_at(&self, index: u32) -> u64 {
        ((2 * self.acceleration * u64::from(index)) << 16).isqrt().min(self.max_speed_q8)
    }

    fn schedule(&mut self, from_q8: u64) {
        let remaining = self.target.abs_diff(self.position);
        if remaining == 0 {
            self.halt();
            return;
        }
        let before = self.speed_q8;
        if self.index >= remaining {
            self.index = remaining - 1;
        } else if self.index + 1 < remaining && before < self.max_speed_q8 {
            self.index += 1;
        }
        self.speed_q8 = self.speed_at(self.index);
        // A single step from rest to rest takes 2/√a, for which 4/v(1) is enough.
        let sum = if before + self.speed_q8 == 0 { self.speed_at(1) / 2 } else { before + self.speed_q8 };
        self.due_q8 = from_q8 + (2 * SECOND_Q16).div_ceil(sum);
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    /// Runs to rest; gives the times of the steps in µs, with the start before them.
    fn run(stepper: &mut Stepper, start_us: u64) -> Vec<u64> {
        let mut times = std::vec![start_us];
        while stepper.running() {
            let due = stepper.due_us();
            times.push(due);
            stepper.stepped(due);
        }
        times
    }

    /// Checks speeds and their changes from step times alone, given that times are whole µs.
    fn assert_within_limits(times: &[u64], max_speed: u32, acceleration: u32) {
        let seconds = |us: u64| us as f64 * 1e-6;
        for pair in times.windows(2) {
            let interval = seconds(pair[1] - pair[0] + 1);
            assert!(1.0 / interval <= f64::from(max_speed) * 1.0001, "{pair:?}");
        }
        for three in times.windows(3) {
            let (first, second) = (three[1] - three[0], three[2] - three[1]);
            // The least change of speed that the two intervals, each ±1 µs, can stand for.
            let fastest_slow = 1.0 / seconds(first.max(second) - 1);
            let slowest_fast = 1.0 / seconds(first.min(second) + 1);
            let change = slowest_fast - fastest_slow;
            let over = seconds(first + second + 2) / 2.0;
            assert!(change / over <= f64::from(acceleration) * 1.01, "{three:?}: {}", change / over);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn run_ends_on_target_within_speed_and_acceleration(
            from in -100_000..100_000i32, distance in -8_000..8_000i32,
            max_speed in 10..100_000u32, acceleration in 10..1_000_000u32,
        ) {
            let mut stepper = Stepper::default();
            stepper.set_position(from);
            stepper.start(5, from + distance, max_speed, acceleration);
            let times = run(&mut stepper, 5);
            prop_assert_eq!(stepper.position(), from + distance);
            prop_assert_eq!(times.len() as u32, distance.unsigned_abs() + 1);
            assert_within_limits(&times, max_speed, acceleration);
        }

        #[test]
        fn shortened_run_stops_within_acceleration_and_never_turns(
            distance in 1..5_000i32, up in any::<bool>(), stop_after in 0..5_000usize,
            max_speed in 10..50_000u32, acceleration in 10..500_000u32,
        ) {
            let mut stepper = Stepper::default();
            stepper.start(0, if up { distance } else { -distance }, max_speed, acceleration);
            let mut times = std::vec![0];
            while stepper.running() {
                if times.len() == stop_after + 1 {
                    stepper.shorten(0);
                }
                let due = stepper.due_us();
                times.push(due);
                stepper.stepped(due);
            }
            let went = if up { stepper.position() } else { -stepper.position() };
            prop_assert!(went <= distance);
            prop_assert_eq!(went as usize, times.len() - 1);
            // Whatever the speed was, it came down to that of a first step.
            let last = (times[times.len() - 1] - times[times.len() - 2] + 1) as f64 * 1e-6;
            prop_assert!(1.0 / last <= f64::from(acceleration).sqrt().min(f64::from(max_speed)) * 1.001);
            assert_within_limits(&times, max_speed, acceleration);
        }

        #[test]
        fn late_polls_only_slow_a_run_down(
            distance in 1..3_000i32, max_speed in 10..50_000u32, acceleration in 10..500_000u32,
            lateness in proptest::collection::vec(0..500u64, 16),
        ) {
            let mut stepper = Stepper::default();
            stepper.start(0, distance, max_speed, acceleration);
            let mut times = std::vec![0];
            while stepper.running() {
                let at = stepper.due_us() + lateness[times.len() % lateness.len()];
                let interval = (at - times[times.len() - 1] + 1) as f64 * 1e-6;
                prop_assert!(1.0 / interval <= f64::from(max_speed) * 1.0001);
                times.push(at);
                stepper.stepped(at);
            }
            prop_assert_eq!(stepper.position(), distance);
        }
    }

    #[test]
    fn long_run_takes_the_time_of_an_ideal_trapezoid() {
        let mut stepper = Stepper::default();
        stepper.start(0, 100_000, 10_000, 20_000);
        let times = run(&mut stepper, 0);
        // d/v + v/a
        let ideal = 100_000.0 / 10_000.0 + 10_000.0 / 20_000.0;
        let took = times[times.len() - 1] as f64 * 1e-6;
        assert!((took - ideal).abs() < 1e-3 * ideal, "{took} s against {ideal} s");
    }
}
