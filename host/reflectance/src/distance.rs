//! The bi-angular distance between direction pairs, with reciprocal pairs equal and, for isotropic samples,
//! pairs that differ by a turn about the normal or a mirror; and the polar angles up to which pairs are
//! measured.

use glam::DVec3;

/// Pairs with a polar angle of incidence above this are dropped (3.3.2).
pub const MAX_THETA_I_DEG: f64 = 75.0;

/// Pairs with a polar angle of the view above this are dropped (3.3.2).
pub const MAX_THETA_O_DEG: f64 = 65.0;

/// Unit directions toward light and viewer in the sample's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DirectionPair {
    /// Toward the light.
    pub wi: DVec3,
    /// Toward the viewer.
    pub wo: DVec3,
}

impl DirectionPair {
    fn swapped(self) -> Self {
        Self { wi: self.wo, wo: self.wi }
    }

    fn mirrored(self) -> Self {
        let flip = |v: DVec3| DVec3::new(v.x, -v.y, v.z);
        Self { wi: flip(self.wi), wo: flip(self.wo) }
    }
}

/// Distance in radians: the root of the summed squared chords between the light directions and between the
/// view directions (a chord is the angle to 0.5 % below 20°), least over the pairs that count as equal.
pub fn distance(a: DirectionPair, b: DirectionPair, isotropic: bool) -> f64 {
    let closeness = if isotropic { turned_closeness } else { closeness };
    let mut nearest = closeness(a, b).max(closeness(a, b.swapped()));
    if isotropic {
        let mirror = b.mirrored();
        nearest = nearest.max(closeness(a, mirror)).max(closeness(a, mirror.swapped()));
    }
    // |u − v|² = 2 − 2 u·v for each of the two directions.
    (4.0 - 2.0 * nearest).max(0.0).sqrt()
}

/// Sum of the cosines between light directions and between view directions.
fn closeness(a: DirectionPair, b: DirectionPair) -> f64 {
    a.wi.dot(b.wi) + a.wo.dot(b.wo)
}

/// The greatest [`closeness`] over all turns of `b` about the normal: A + √(B² + C²) of A + B cos α + C sin
/// α.
fn turned_closeness(a: DirectionPair, b: DirectionPair) -> f64 {
    let along = |u: DVec3, v: DVec3| u.x * v.x + u.y * v.y;
    let across = |u: DVec3, v: DVec3| u.y * v.x - u.x * v.y;
    let constant = a.wi.z * b.wi.z + a.wo.z * b.wo.z;
    let cosine = along(a.wi, b.wi) + along(a.wo, b.wo);
    let sine = across(a.wi, b.wi) + across(a.wo, b.wo);
    constant + cosine.hypot(sine)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use proptest::prelude::*;

    fn direction(u: f64, v: f64) -> DVec3 {
        let r = (1.0 - u * u).sqrt();
        DVec3::new(r * v.cos(), r * v.sin(), u)
    }

    proptest! {
        #[test]
        fn equal_pairs_are_at_distance_zero(
            u in 0.2f64..1.0, v in 0f64..6.3, s in 0.2f64..1.0, t in 0f64..6.3, turn in -3f64..3.0,
        ) {
            let pair = DirectionPair { wi: direction(u, v), wo: direction(s, t) };
            prop_assert!(distance(pair, pair.swapped(), false) < 1e-6);
            let rotation = DMat3::from_rotation_z(turn);
            let turned = DirectionPair { wi: rotation * pair.wi, wo: rotation * pair.wo };
            prop_assert!(distance(pair, turned.mirrored().swapped(), true) < 1e-6);
        }

        #[test]
        fn the_closed_form_over_turns_is_the_least_over_many_turns(
            u in 0.2f64..1.0, v in 0f64..6.3, s in 0.2f64..1.0, t in 0f64..6.3,
            a in 0.2f64..1.0, b in 0f64..6.3, c in 0.2f64..1.0, d in 0f64..6.3,
        ) {
            let first = DirectionPair { wi: direction(u, v), wo: direction(s, t) };
            let second = DirectionPair { wi: direction(a, b), wo: direction(c, d) };
            let tried = (0..720).map(|k| {
                let rotation = DMat3::from_rotation_z(f64::from(k) * std::f64::consts::TAU / 720.0);
                closeness(first, DirectionPair { wi: rotation * second.wi, wo: rotation * second.wo })
            }).fold(f64::MIN, f64::max);
            let exact = turned_closeness(first, second);
            prop_assert!(exact >= tried - 1e-12 && exact - tried < 1e-4);
        }
    }
}
