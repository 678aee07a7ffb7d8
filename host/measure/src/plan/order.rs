//! The order of poses: a short tour of the axes, nearest neighbour first, then improved by exchanging
//! stretches (2-opt).

use crate::rig::config::RigConfig;
use crate::rig::geometry::MotorAngles;

/// Rounds of 2-opt at most; each shortens the tour.
const ROUNDS: usize = 20;

/// Beyond this many poses 2-opt looks only at stretches up to this length, to stay linear in the number of
/// poses.
const LONGEST_STRETCH: usize = 400;

/// Time between two poses, s: the axes move together, so the slowest decides.
pub fn travel_s(config: &RigConfig, a: &MotorAngles, b: &MotorAngles) -> f64 {
    let (a, b) = (a.to_degrees(), b.to_degrees());
    let time = |k: usize| {
        let axis = config.axes.in_order()[k];
        let (way, speed, acceleration) =
            ((a[k] - b[k]).abs(), axis.max_speed_deg_s, axis.acceleration_deg_s2);
        // Trapezoidal profile; a short way never reaches full speed.
        if way * acceleration < speed * speed {
            2.0 * (way / acceleration).sqrt()
        } else {
            way / speed + speed / acceleration
        }
    };
    (0..4).map(time).fold(0.0, f64::max)
}

/// Time of a tour through the poses in order, s.
pub fn tour_s(config: &RigConfig, poses: &[MotorAngles]) -> f64 {
    poses.windows(2).map(|pair| travel_s(config, &pair[0], &pair[1])).fold(0.0, |sum, way| sum + way)
}

/// The poses in an order with little travel.
pub fn shorten(config: &RigConfig, poses: &[MotorAngles]) -> Vec<MotorAngles> {
    let mut tour = nearest_neighbours(config, poses);
    for _ in 0..ROUNDS {
        if !exchange(config, &mut tour) {
            break;
        }
    }
    tour
}

fn nearest_neighbours(config: &RigConfig, poses: &[MotorAngles]) -> Vec<MotorAngles> {
    let mut left: Vec<MotorAngles> = poses.to_vec();
    let mut tour = Vec::with_capacity(poses.len());
    let mut here = MotorAngles::default();
    while !left.is_empty() {
        let next = (0..left.len())
            .min_by(|&a, &b| travel_s(config, &here, &left[a]).total_cmp(&travel_s(config, &here, &left[b])))
            .unwrap_or(0);
        here = left.swap_remove(next);
        tour.push(here);
    }
    tour
}

/// One round of 2-opt over an open tour; true when it shortened anything.
fn exchange(config: &RigConfig, tour: &mut [MotorAngles]) -> bool {
    let mut improved = false;
    let count = tour.len();
    for from in 1..count.saturating_sub(1) {
        for to in from + 1..count.min(from + LONGEST_STRETCH) {
            let way = |a: usize, b: usize| travel_s(config, &tour[a], &tour[b]);
            let tail = |a: usize| if to + 1 < count { way(a, to + 1) } else { 0.0 };
            let gain = way(from - 1, from) + tail(to) - way(from - 1, to) - tail(from);
            if gain > 1e-9 {
                tour[from..=to].reverse();
                improved = true;
            }
        }
    }
    improved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{Extent, choose};

    #[test]
    fn the_tour_keeps_every_pose_and_is_much_shorter_than_the_order_of_choice() {
        let config = RigConfig::default();
        let chosen = choose::poses(&config, Extent::Budget(120), false, 1).unwrap().angles;
        let tour = shorten(&config, &chosen);
        let key = |angles: &MotorAngles| angles.to_degrees().map(|deg| (deg * 1e6) as i64);
        let (mut a, mut b): (Vec<_>, Vec<_>) =
            (chosen.iter().map(key).collect(), tour.iter().map(key).collect());
        a.sort_unstable();
        b.sort_unstable();
        assert_eq!(a, b);
        assert!(tour_s(&config, &tour) < 0.6 * tour_s(&config, &chosen));
    }
}
