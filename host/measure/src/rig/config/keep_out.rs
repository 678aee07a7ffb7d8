//! `[[keep_out]]`: where two axes must not be together, and ways between poses that keep out of there.

use lobelia_protocol::{self as protocol, AXES, AxisParameters, Configuration, KEEP_OUTS};
use serde::{Deserialize, Serialize};

use super::{AXIS_NAMES, Axes, Axis, RigConfig};
use lobelia_base::error::{Error, Result};

/// An axis by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AxisName {
    /// The sample's pan.
    Pan,
    /// The sample's tilt.
    Tilt,
    /// The sample's roll.
    Roll,
    /// The light.
    Light,
}

impl AxisName {
    fn axis(self) -> protocol::Axis {
        protocol::Axis::ALL[self as usize]
    }

    fn name(self) -> &'static str {
        AXIS_NAMES[self as usize]
    }
}

/// Two axes that must not be in these intervals at once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeepOut {
    /// One axis.
    pub first: AxisName,
    /// Its interval.
    pub first_deg: [f64; 2],
    /// The other axis.
    pub second: AxisName,
    /// Its interval.
    pub second_deg: [f64; 2],
}

impl KeepOut {
    fn parts(&self) -> [(AxisName, [f64; 2]); 2] {
        [(self.first, self.first_deg), (self.second, self.second_deg)]
    }

    fn names(&self) -> String {
        format!("{} and {}", self.first.name(), self.second.name())
    }

    /// Whether both axes are in their intervals.
    fn has(&self, degrees: [f64; 4]) -> bool {
        self.parts().iter().all(|(axis, [from, to])| (*from..=*to).contains(&degrees[*axis as usize]))
    }

    /// What is wrong with it.
    fn check(&self, axes: &Axes) -> std::result::Result<(), String> {
        let names = self.names();
        let of = |axis: AxisName| -> &Axis { axes.in_order()[axis as usize] };
        if self.first == self.second {
            return Err(format!("is of {} twice", self.first.name()));
        }
        for (axis, [from, to]) in self.parts() {
            if !(from < to && from.abs() <= 3600.0 && to.abs() <= 3600.0) {
                return Err(format!("of {names} has the interval {from} to {to} for {}", axis.name()));
            }
            if of(axis).full_turn {
                return Err(format!(
                    "of {names}: {} turns round and round, which this can't be of",
                    axis.name()
                ));
            }
        }
        let [first, second] = [of(self.first), of(self.second)];
        if first.home_order == second.home_order {
            return Err(format!(
                "of {names}: both have home_order {}; give the lower one to that which can be homed wherever \
                 the other stands",
                first.home_order
            ));
        }
        let before = usize::from(second.home_order < first.home_order);
        let (axis, [from, to]) = self.parts()[before];
        let homing = of(axis).homing.clone().unwrap_or_default();
        let home = of(axis).home_deg;
        if home + homing.back_off_deg >= from && home - homing.back_off_deg <= to {
            return Err(format!(
                "of {names}: {} is homed first and would then stand at {home}°, in the other's way",
                axis.name()
            ));
        }
        Ok(())
    }

    /// In steps, as wide as the axes' rounding may make it.
    fn in_steps(&self, axes: &Axes) -> Option<protocol::KeepOut> {
        let steps = |(axis, [from, to]): (AxisName, [f64; 2])| {
            let step = axes.in_order()[axis as usize].degrees_per_step;
            let [from, to] = [(from / step).floor(), (to / step).ceil()];
            (from.abs() < 1e9 && to.abs() < 1e9).then_some([from as i32, to as i32])
        };
        let [first, second] = self.parts();
        Some(protocol::KeepOut {
            first: self.first.axis(),
            first_steps: steps(first)?,
            second: self.second.axis(),
            second_steps: steps(second)?,
        })
    }
}

impl RigConfig {
    /// The two axes that would be together where they must not be, if there are such.
    pub fn kept_out(&self, degrees: [f64; 4]) -> Option<String> {
        self.keep_out.iter().find(|keep_out| keep_out.has(degrees)).map(KeepOut::names)
    }

    /// Refuses keep-outs that make no sense.
    pub(super) fn check_keep_outs(&self) -> std::result::Result<(), String> {
        if self.keep_out.len() > KEEP_OUTS {
            return Err(format!("is there {} times, at most {KEEP_OUTS} are possible", self.keep_out.len()));
        }
        self.keep_out.iter().try_for_each(|keep_out| keep_out.check(&self.axes))
    }

    /// The keep-outs as the controller has them; `None` when a number is out of range.
    pub(super) fn keep_outs(&self) -> Option<[Option<protocol::KeepOut>; KEEP_OUTS]> {
        let mut all = [None; KEEP_OUTS];
        for (place, keep_out) in all.iter_mut().zip(&self.keep_out) {
            *place = Some(keep_out.in_steps(&self.axes)?);
        }
        Some(all)
    }
}

/// The positions that an axis may pass on its way, take-up included.
fn sweep(p: &AxisParameters, from: i32, to: i32) -> [i32; 2] {
    if from == to { [to, to] } else { [from.min(to).saturating_sub_unsigned(p.take_up_steps), from.max(to)] }
}

/// Whether a move of all axes at once passes no keep-out, in any order in which they may be on their way.
fn is_clear(configuration: &Configuration, from: [i32; AXES], to: [i32; AXES]) -> bool {
    let enters = |axis: protocol::Axis, steps: [i32; 2]| {
        let k = axis.index();
        let [low, high] = sweep(&configuration.axes[k], from[k], to[k]);
        low <= steps[1] && steps[0] <= high
    };
    let mut keep_outs = configuration.keep_outs.iter().flatten();
    !keep_outs.any(|k| enters(k.first, k.first_steps) && enters(k.second, k.second_steps))
}

/// The moves, three at most, that lead from one position to another and pass no keep-out: axes that are in
/// each other's way move one after the other.
///
/// # Errors
/// When there is no such way; the sentence names the axes.
pub fn way(configuration: &Configuration, from: [i32; AXES], to: [i32; AXES]) -> Result<Vec<[i32; AXES]>> {
    if is_clear(configuration, from, to) {
        return Ok(vec![to]);
    }
    // For each axis with which of three moves it goes.
    for legs in [2, 3_usize] {
        for choice in 0..legs.pow(AXES as u32) {
            let leg = |k: usize| choice / legs.pow(k as u32) % legs;
            let at = |done: usize| std::array::from_fn(|k| if leg(k) < done { to[k] } else { from[k] });
            if (0..legs).all(|done| is_clear(configuration, at(done), at(done + 1))) {
                return Ok((1..=legs).map(at).filter(|stop| *stop != from).collect());
            }
        }
    }
    let in_the_way = configuration.keep_outs.iter().flatten();
    let names: Vec<_> = in_the_way.map(|k| format!("{} and {}", k.first.name(), k.second.name())).collect();
    Err(Error::input(format!(
        "there is no way from {from:?} to {to:?} steps on which {} keep out of each other's way; see \
         [[keep_out]] in the rig's file",
        names.join(", ")
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> RigConfig {
        let mut rig = RigConfig::default();
        rig.axes.pan.home_order = 1;
        rig.keep_out = vec![KeepOut {
            first: AxisName::Pan,
            first_deg: [50.0, 80.0],
            second: AxisName::Light,
            second_deg: [20.0, 60.0],
        }];
        rig
    }

    #[test]
    fn keep_outs_survive_their_file_and_reach_the_controller() {
        let text = toml::to_string(&rig()).unwrap();
        assert!(text.contains("[[keep_out]]") && text.contains("first = \"pan\""), "{text}");
        let read: RigConfig = toml::from_str(&text).unwrap();
        assert_eq!(read, rig());
        read.validate().unwrap();
        let keep_out = read.configuration().unwrap().keep_outs[0].unwrap();
        assert_eq!((keep_out.first, keep_out.second), (protocol::Axis::Pan, protocol::Axis::Light));
        // 50° and 80° in steps of 0.0129°, 20° and 60° in steps of 0.0016°.
        assert_eq!((keep_out.first_steps, keep_out.second_steps), ([3875, 6202], [12_500, 37_500]));
        assert!(!toml::to_string(&RigConfig::default()).unwrap().contains("keep_out"));
    }

    #[test]
    fn keep_outs_that_make_no_sense_are_refused_with_both_axes() {
        let refused = |change: fn(&mut RigConfig)| {
            let mut rig = rig();
            change(&mut rig);
            rig.validate().unwrap_err().to_string()
        };
        for (message, part) in [
            (refused(|rig| rig.axes.pan.home_order = 0), "both have home_order 0"),
            (refused(|rig| rig.keep_out[0].first_deg = [80.0, 50.0]), "for pan"),
            // Light is homed first, at 5°.
            (refused(|rig| rig.keep_out[0].second_deg = [4.5, 60.0]), "light is homed first"),
        ] {
            assert!(message.contains("pan and light") && message.contains(part), "{message}");
        }
        assert!(refused(|rig| rig.keep_out[0].second = AxisName::Pan).contains("pan twice"));
        assert!(refused(|rig| rig.keep_out = vec![rig.keep_out[0].clone(); 5]).contains("5 times"));
    }

    #[test]
    fn way_leads_round_a_keep_out_and_is_refused_where_there_is_none() {
        let rig = rig();
        let configuration = rig.configuration().unwrap();
        let at = |pan: f64, light: f64| rig.steps([pan, 0.0, 0.0, light]);
        let go = |from, to| way(&configuration, from, to);
        assert_eq!(go(at(0.0, 100.0), at(40.0, 30.0)).unwrap(), [at(40.0, 30.0)]);
        // Each must pass the other's interval: pan goes while light is out of the way.
        assert_eq!(go(at(40.0, 30.0), at(85.0, 70.0)).unwrap(), [at(40.0, 70.0), at(85.0, 70.0)]);
        let round = go(at(40.0, 30.0), at(65.0, 100.0)).unwrap();
        assert_eq!(round, [at(40.0, 100.0), at(65.0, 100.0)]);
        let inside = go(at(0.0, 100.0), at(65.0, 40.0)).unwrap_err().to_string();
        assert!(inside.contains("pan and light"), "{inside}");
        assert_eq!(rig.kept_out([65.0, 0.0, 0.0, 40.0]).unwrap(), "pan and light");
        assert_eq!(rig.kept_out([45.0, 0.0, 0.0, 40.0]), None);
    }
}
