//! What a ray is in: transparent bodies that may be nested and overlap, told apart by their priority (Schmidt
//! and Budge 2002, "Simple nested dielectrics in ray traced images").

use crate::scene::{Dielectric, Optics, Scene};
use lobelia_reflectance::Rgb;

/// Bodies that a ray can be in at once; those beyond are not kept.
const MOST: usize = 8;

/// The bodies that a ray is in, by object, in the order in which it came into them. One that is come into
/// twice counts twice.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Inside {
    objects: [u32; MOST],
    count: usize,
}

/// The transparent bodies of a scene, by object.
pub(super) struct Media {
    dielectrics: Vec<Option<Dielectric>>,
    /// Whether there is any.
    pub(super) any: bool,
}

impl Inside {
    fn objects(&self) -> &[u32] {
        &self.objects[..self.count]
    }

    /// The bodies after a surface of `object`, met from its front or from behind.
    pub(super) fn across(mut self, object: u32, front: bool) -> Self {
        if front {
            if self.count < MOST {
                self.objects[self.count] = object;
                self.count += 1;
            }
        } else if let Some(place) = self.objects().iter().rposition(|&other| other == object) {
            self.objects.copy_within(place + 1..self.count, place);
            self.count -= 1;
        }
        self
    }

    /// As it must have been before the surface of `object`: who meets it from behind has been in it.
    pub(super) fn before(self, object: u32, front: bool) -> Self {
        if front || self.objects().contains(&object) { self } else { self.across(object, true) }
    }
}

impl Media {
    pub(super) fn new(scene: &Scene) -> Self {
        let dielectric = |optics: &Option<Optics>| match optics {
            Some(Optics::Dielectric(dielectric)) => Some(*dielectric),
            _ => None,
        };
        let dielectrics: Vec<_> =
            scene.objects.iter().map(|object| dielectric(&object.material.optics)).collect();
        Self { any: dielectrics.iter().any(Option::is_some), dielectrics }
    }

    /// The body of an object; rectangular lights, which come after the objects, have none.
    pub(super) fn of(&self, object: u32) -> Option<&Dielectric> {
        self.dielectrics.get(object as usize)?.as_ref()
    }

    /// The body that is there: of the highest priority, of equal ones the first.
    fn there(&self, inside: &Inside) -> Option<&Dielectric> {
        let bodies = inside.objects().iter().filter_map(|&object| self.of(object));
        bodies.reduce(|best, next| if next.priority > best.priority { next } else { best })
    }

    /// Whether the surface of an object lies within a body of higher priority, and is not there.
    pub(super) fn hidden(&self, inside: &Inside, object: u32) -> bool {
        let Some(own) = self.of(object) else { return false };
        let others = inside.objects().iter().filter(|&&other| other != object);
        others.filter_map(|&other| self.of(other)).any(|other| other.priority > own.priority)
    }

    /// Index of refraction of what is there.
    pub(super) fn index(&self, inside: &Inside) -> f32 {
        self.there(inside).map_or(1.0, |body| body.index)
    }

    /// Part of the radiance that is left after a length, which may be infinite.
    pub(super) fn transmittance(&self, inside: &Inside, length: f32) -> Rgb {
        let Some(body) = self.there(inside) else { return Rgb::ONE };
        let channel = |a: f32| if a > 0.0 { (-a * length).exp() } else { 1.0 };
        Rgb::from_array(body.absorption.to_array().map(channel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn media(bodies: [(f32, i32); 3]) -> Media {
        let body = |(index, priority)| Some(Dielectric { index, absorption: Rgb::ONE, priority });
        Media { dielectrics: bodies.map(body).to_vec(), any: true }
    }

    #[test]
    fn a_body_of_higher_priority_goes_before_and_hides_the_surfaces_within() {
        // Glass over water, with a bubble of air over both.
        let media = media([(1.5, 1), (1.33, 0), (1.0, 2)]);
        let glass = Inside::default().across(0, true);
        let both = glass.across(1, true);
        assert_eq!((media.index(&glass), media.index(&both)), (1.5, 1.5));
        assert!(media.hidden(&glass, 1) && !media.hidden(&both, 0));
        let water = both.across(0, false);
        assert_eq!(media.index(&water), 1.33);
        assert!(!media.hidden(&water, 1));
        assert_eq!(media.index(&both.across(2, true)), 1.0);
        assert_eq!(water.across(1, false), Inside { count: 0, ..water.across(1, false) });
    }

    #[test]
    fn equal_priorities_are_joined_and_absorption_is_by_length() {
        let media = media([(1.5, 0), (1.5, 0), (1.0, 0)]);
        let both = Inside::default().across(0, true).across(1, true);
        assert!(!media.hidden(&both, 0) && !media.hidden(&both, 1));
        assert_eq!(media.index(&both.across(0, false)), 1.5);
        assert!((media.transmittance(&both, 2.0).x - (-2.0f32).exp()).abs() < 1e-6);
        assert_eq!(media.transmittance(&both, f32::INFINITY), Rgb::ZERO);
        assert_eq!(media.transmittance(&Inside::default(), f32::INFINITY), Rgb::ONE);
        // Met from behind without having been in it.
        assert_eq!(media.index(&Inside::default().before(1, false)), 1.5);
    }
}
