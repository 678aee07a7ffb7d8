//! Step times as they are emitted, against the analytic profile and against the limits by finite differences.

extern crate std;
use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::motion::trains::Trains;

/// A stepper and the trains that it feeds, called at just the times that they ask for.
struct Motor {
    stepper: Stepper,
    trains: Trains,
    now_us: u64,
    late: u64,
}

impl Motor {
    fn new(now_us: u64) -> Self {
        Self { stepper: Stepper::default(), trains: Trains::default(), now_us, late: 0 }
    }

    fn start(&mut self, target: i32, limits: Limits, times: Times) {
        let position = self.position();
        let forward = target > position;
        self.trains.begin(0, forward);
        self.late = 0;
        self.stepper.start(self.now_us << TICK_SHIFT, forward, target.abs_diff(position), limits, times);
    }

    fn go(&mut self, target: i32, limits: Limits) {
        self.start(target, limits, Times::shortest(target.abs_diff(self.position()), limits));
    }

    fn position(&self) -> i32 {
        self.trains.position(0)
    }

    fn on_time(&self) -> u64 {
        (self.now_us << TICK_SHIFT) - self.late
    }

    fn brake(&mut self) {
        self.stepper.brake();
    }

    fn redirect(&mut self, target: i32) -> bool {
        let ahead = i64::from(target) - i64::from(self.trains.planned_position(0));
        self.stepper.redirect(self.on_time(), if self.stepper.forward() { ahead } else { -ahead })
    }

    /// When something is due.
    fn next_us(&mut self) -> u64 {
        self.late += u64::from(self.trains.late(0).wrapping_sub(self.late as u32));
        let before = self.on_time() + (2000 << TICK_SHIFT);
        while self.trains.has_room(0)
            && let Some(burst) = self.stepper.next_burst(before)
        {
            self.trains.push(0, self.now_us as u32, burst);
        }
        if let Some(next) = self.trains.next_us() {
            return self.now_us + u64::from(next.wrapping_sub(self.now_us as u32));
        }
        let wait_until = match (self.stepper.end(), &self.stepper.next) {
            (Some(end), _) => end + self.late,
            (_, Some(next)) => self.stepper.origin + next.time + self.late - (1000 << TICK_SHIFT),
            _ => u64::MAX,
        };
        wait_until.div_ceil(1 << TICK_SHIFT).max(self.now_us)
    }

    /// Does what is due, so much later than that; gives the time of the step if one was made.
    fn pass(&mut self, late_us: u64) -> Option<u64> {
        self.now_us = self.next_us() + late_us;
        let before = self.position();
        self.trains.step(self.now_us as u32);
        if self.stepper.end().is_some_and(|end| self.on_time() >= end) && self.trains.resting(0) {
            self.stepper.halt();
        }
        (self.position() != before).then_some(self.now_us)
    }

    fn running(&self) -> bool {
        self.stepper.running()
    }

    /// Runs until the end, or while `go_on` of the time of what is due; gives the times of the steps in µs.
    fn run_while(&mut self, go_on: impl Fn(u64) -> bool) -> Vec<u64> {
        let mut times = Vec::new();
        while self.running() && go_on(self.next_us()) {
            times.extend(self.pass(0));
        }
        times
    }

    fn run(&mut self) -> Vec<u64> {
        self.run_while(|_| true)
    }
}

/// Times of steps are uncertain by so many µs: rounded up to whole ones, and off by the error of a burst.
const UNCERTAIN_US: f64 = 1.2;

/// Speed, acceleration and jerk from emitted step times alone. The n-th divided difference of positions over
/// times, times n!, is a mean of the n-th derivative between the first and the last of the steps, whatever
/// lies between; so it keeps the limit of that derivative, but for what times of whole µs make uncertain.
/// Steps are compared over strides of 2, 8, 32 … so that this uncertainty doesn't hide the limits.
fn assert_within_limits(times: &[u64], limits: Limits) {
    let seconds = |us: u64| us as f64 * 1e-6;
    for pair in times.windows(2) {
        let interval = ((pair[1] - pair[0]) as f64 + UNCERTAIN_US) * 1e-6;
        assert!(1.0 / interval <= f64::from(limits.speed) * 1.000_01, "{pair:?}");
    }
    let mut stride = 1;
    while 3 * stride < times.len() {
        for first in (0..times.len() - 3 * stride).step_by(stride.div_ceil(2)) {
            let at: [f64; 4] = std::array::from_fn(|k| seconds(times[first + k * stride]));
            let fastest = limits_speed(&times[first..=first + 3 * stride], stride);
            for (order, limit) in [(2, limits.acceleration), (3, limits.jerk)] {
                let (difference, uncertainty) = derivative(&at[..=order], stride as f64, fastest);
                let most = f64::from(limit) * 1.000_1 + uncertainty;
                assert!(
                    difference.abs() <= most,
                    "order {order}: {difference} > {most} at {at:?} for {limits:?}"
                );
            }
        }
        stride *= 2;
    }
}

/// The fastest mean speed over a few steps among these times.
fn limits_speed(times: &[u64], stride: usize) -> f64 {
    let part = (stride / 8).max(1);
    let fastest = times.windows(part + 1).step_by(part).map(|few| few[part] - few[0] - 1).min();
    part as f64 / (fastest.unwrap_or(1).max(1) as f64 * 1e-6)
}

/// The n-th derivative's mean over n + 1 steps `stride` apart, and how far the uncertainty of each time can
/// shift it.
fn derivative(at: &[f64], stride: f64, speed: f64) -> (f64, f64) {
    let order = at.len() - 1;
    let factorial = if order == 3 { 6.0 } else { 2.0 };
    let mut sum = 0.0;
    let mut uncertainty = 0.0;
    for (k, &time) in at.iter().enumerate() {
        let product: f64 =
            at.iter().enumerate().filter(|&(m, _)| m != k).map(|(_, &other)| time - other).product();
        sum += k as f64 * stride / product;
        uncertainty += speed * UNCERTAIN_US * 1e-6 / product.abs();
    }
    (sum * factorial, uncertainty * factorial)
}

/// The analytic profile of the shortest run over `d` in floating point: ideal times in s, not rounded.
fn ideal(d: f64, limits: Limits) -> [f64; 3] {
    let [v, a, j] = [limits.speed, limits.acceleration, limits.jerk].map(f64::from);
    let (jerk, hold) = if v * j >= a * a { (a / j, v / a - a / j) } else { ((v / j).sqrt(), 0.0) };
    if d >= v * (2.0 * jerk + hold) {
        return [jerk, hold, d / v - 2.0 * jerk - hold];
    }
    let x = (-jerk + (jerk * jerk + 4.0 * d / a).sqrt()) / 2.0;
    if v * j >= a * a && x >= jerk { [jerk, x - jerk, 0.0] } else { [(d / (2.0 * j)).cbrt(), 0.0, 0.0] }
}

/// Position on an analytic profile that ends at `d`.
fn ideal_position(d: f64, [jerk, hold, cruise]: [f64; 3], t: f64) -> f64 {
    let (x, y) = (jerk + hold, 2.0 * jerk + hold + cruise);
    let (v, a, j) = (d / y, d / (x * y), d / (x * y * jerk));
    let (ramp, total) = (x + jerk, 4.0 * jerk + 2.0 * hold + cruise);
    if t > total / 2.0 {
        d - ideal_position(d, [jerk, hold, cruise], total - t)
    } else if t < jerk {
        j * t.max(0.0).powi(3) / 6.0
    } else if t < x {
        j * jerk.powi(3) / 6.0 + a * jerk / 2.0 * (t - jerk) + a * (t - jerk).powi(2) / 2.0
    } else if t < ramp {
        // What is missing to the cruising speed, backwards from the end of the ramp.
        v * ramp / 2.0 - v * (ramp - t) + j * (ramp - t).powi(3) / 6.0
    } else {
        v * ramp / 2.0 + v * (t - ramp)
    }
}

/// Distances from one step to long ones, limits from creeping to the fastest allowed.
fn limits() -> impl Strategy<Value = Limits> {
    (0.0..5.3f64, 1.0..7.0f64, 0.0..9.0f64).prop_map(|(v, a, j)| Limits {
        speed: 10f64.powf(v) as u32,
        acceleration: (10f64.powf(a) as u32).max(10f64.powf(v - 2.5) as u32),
        jerk: 10f64.powf(j.max(a - 1.0)) as u32,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(160))]

    #[test]
    fn step_times_follow_the_analytic_profile_within_a_microsecond_and_half_a_tick(
        distance in prop_oneof![1..40i32, 40..6_000], up in any::<bool>(), limits in limits(),
            start in 0..1u64 << 40,
    ) {
        let mut motor = Motor::new(start);
        motor.go(if up { distance } else { -distance }, limits);
        let d = f64::from(distance);
        let ideal = ideal(d, limits);
        let times = motor.run();
        prop_assert_eq!(times.len() as i32, distance);
        for (step, time) in times.into_iter().enumerate() {
            let half_way = step as f64 + 0.5;
            let since = |us: f64| ((time - start) as f64 + us) * 1e-6;
            // Floating point is off by some ns, the profile's times in ticks by up to 4 ns each.
            prop_assert!(ideal_position(d, ideal, since(0.03)) >= half_way - 1e-9, "step {} is early", step);
            prop_assert!(ideal_position(d, ideal, since(-1.5)) <= half_way + 1e-9, "step {} is late", step);
        }
    }

    #[test]
    fn run_ends_on_target_within_speed_acceleration_and_jerk(
        from in -100_000..100_000i32, distance in -8_000..8_000i32, limits in limits(), slower in 1.0..9.0f64,
    ) {
        let mut motor = Motor::new(5);
        motor.trains.set_position(0, from);
        let times = Times::shortest(distance.unsigned_abs(), limits);
        let total = (times.total() as f64 * slower) as u64;
        motor.start(from + distance, limits, times.stretched(total.max(times.total())));
        let times = motor.run();
        prop_assert_eq!(motor.position(), from + distance);
        prop_assert_eq!(times.len() as u32, distance.unsigned_abs());
        assert_within_limits(&times, limits);
    }

    #[test]
    fn stretched_run_takes_the_time_asked_for(distance in 1..1u32 << 30, limits in limits(),
        more in 0..1u64 << 40) {
        let times = Times::shortest(distance, limits);
        prop_assert_eq!(times.stretched(times.total() + more).total(), times.total() + more);
    }

    #[test]
    fn stopped_run_keeps_limits_and_never_turns(
        distance in 1..6_000i32, up in any::<bool>(), part in 0.0..1.0f64, limits in limits(),
    ) {
        let mut motor = Motor::new(0);
        motor.go(if up { distance } else { -distance }, limits);
        let total_us = Times::shortest(distance.unsigned_abs(), limits).total() as f64 / 256.0;
        let stop_us = (total_us * part) as u64;
        let mut times = motor.run_while(|due| due <= stop_us);
        motor.now_us = stop_us;
        motor.brake();
        times.extend(motor.run());
        let went = if up { motor.position() } else { -motor.position() };
        prop_assert!((0..=distance).contains(&went), "{} of {}", went, distance);
        prop_assert_eq!(went as usize, times.len());
        assert_within_limits(&times, limits);
    }

    #[test]
    fn redirected_run_keeps_limits_and_ends_on_the_new_target(
        distance in 500..6_000i32, ahead in 1..9_000i32, part in 0.0..1.0f64, limits in limits(),
    ) {
        let mut motor = Motor::new(0);
        motor.go(distance, limits);
        let redirect_us = (Times::shortest(distance.unsigned_abs(),
            limits).total() as f64 / 256.0 * part) as u64;
        let mut times = motor.run_while(|due| due <= redirect_us);
        motor.now_us = redirect_us;
        let target = motor.position() + ahead;
        let redirected = motor.redirect(target);
        times.extend(motor.run());
        prop_assert_eq!(motor.position(), if redirected { target } else { distance });
        assert_within_limits(&times, limits);
    }

    #[test]
    fn late_polls_only_slow_a_run_down(
        distance in 1..3_000i32, limits in limits(), lateness in proptest::collection::vec(0..500u64, 16),
    ) {
        let mut motor = Motor::new(0);
        motor.go(distance, limits);
        let mut last = None;
        let mut passes = 0;
        while motor.running() {
            let made = motor.pass(lateness[passes % lateness.len()]);
            passes += 1;
            if let (Some(last), Some(at)) = (last, made) {
                let interval = ((at - last) as f64 + UNCERTAIN_US) * 1e-6;
                prop_assert!(1.0 / interval <= f64::from(limits.speed) * 1.000_01);
            }
            last = made.or(last);
        }
        prop_assert_eq!(motor.position(), distance);
    }
}

/// Random moves, some of them stopped or redirected, from wherever the last one ended. Each ends exactly on
/// its target, or where its steps were counted to.
fn sweep(steps_in_all: u64) {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut random = |below: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((u128::from(state) * u128::from(below)) >> 64) as u64
    };
    let mut motor = Motor::new(0);
    let (mut made, mut net, mut on_target) = (0u64, 0i64, 0u32);
    while made < steps_in_all {
        let reach = [200, 5_000, 50_000, 500_000][random(4) as usize];
        let mut target = random(2 * reach) as i32 - reach as i32;
        let (a, j) = (random(15), random(20));
        let limits = Limits {
            speed: 1 + random(200_000) as u32,
            acceleration: 200 + random(256 << a) as u32,
            jerk: 200 + random(256 << j) as u32,
        };
        let times = Times::shortest(target.abs_diff(motor.position()), limits);
        motor.start(target, limits, times);
        let change_us = motor.now_us + random(2 + times.total() / 200);
        let change = random(4);
        let mut changed = false;
        let mut stopped = false;
        while motor.running() {
            if !changed && motor.next_us() > change_us {
                changed = true;
                let ahead = random(reach) as i32;
                let forward = motor.stepper.forward();
                let other = motor.position() + if forward { ahead } else { -ahead };
                motor.now_us = motor.now_us.max(change_us);
                match change {
                    0 => {
                        motor.brake();
                        stopped = true;
                    }
                    1 if motor.redirect(other) => target = other,
                    _ => {}
                }
                continue;
            }
            if motor.pass(0).is_some() {
                made += 1;
                net += if motor.stepper.forward() { 1 } else { -1 };
            }
        }
        assert_eq!(net, i64::from(motor.position()));
        assert!(stopped || motor.position() == target, "{} is not {target}", motor.position());
        on_target += u32::from(!stopped);
    }
    assert!(on_target > 0);
}

#[test]
fn three_million_steps_of_random_moves_end_on_their_targets() {
    sweep(3_000_000);
}

#[test]
#[ignore = "long: cargo xtask long"]
fn thousand_million_steps_of_random_moves_end_on_their_targets() {
    sweep(1_000_000_000);
}

#[test]
fn long_run_takes_the_time_of_the_ideal_profile() {
    let mut motor = Motor::new(0);
    motor.go(100_000, Limits { speed: 10_000, acceleration: 20_000, jerk: 100_000 });
    motor.run();
    // d/v + v/a + a/j
    assert!(motor.now_us.abs_diff(10_700_000) <= 1, "{} µs", motor.now_us);
}
