//! A scene that is played: as it was given, and in the state of the last frame.

use std::time::Instant;

use crate::scene::{Light, Scene, State};
use lobelia_base::error::Result;

/// A scene and its state.
pub(crate) struct Stage {
    given: Scene,
    /// In the state of the last frame.
    pub(crate) now: Scene,
}

/// What differs between two frames, but for the view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Changes {
    /// Places of objects or of lights that are seen: the triangles.
    pub(crate) triangles: bool,
    /// Lights, in place or power, and what shines.
    pub(crate) lights: bool,
    /// The turn of the environment.
    pub(crate) turn: bool,
}

impl Changes {
    /// Seconds that they took; none where there are none.
    pub(crate) fn seconds_since(self, start: Instant) -> f64 {
        if self == Self::default() { 0.0 } else { start.elapsed().as_secs_f64() }
    }

    /// Names of the steps that they ask for.
    pub(crate) fn redone(self) -> Vec<&'static str> {
        let steps = [(self.triangles, "tree"), (self.lights, "lights"), (self.turn, "turn")];
        steps.into_iter().filter(|(is, _)| *is).map(|(_, step)| step).collect()
    }
}

impl Stage {
    /// A scene with its parameters where they stand.
    ///
    /// # Errors
    /// Those of [`Scene::at`].
    pub(crate) fn new(scene: &Scene) -> Result<Self> {
        Ok(Self { now: scene.at(&scene.state())?, given: scene.clone() })
    }

    /// Goes to another state.
    ///
    /// # Errors
    /// Those of [`Scene::at`].
    pub(crate) fn go(&mut self, state: &State) -> Result<Changes> {
        let next = self.given.at(state)?;
        let shape = |light: &Light| match *light {
            Light::Rectangle { centre, edges, .. } => Some((centre, edges)),
            _ => None,
        };
        let shapes = |scene: &Scene| scene.lights.iter().map(shape).collect::<Vec<_>>();
        let emissions = |scene: &Scene| {
            scene.objects.iter().map(|object| object.material.emission.clone()).collect::<Vec<_>>()
        };
        let objects = self.now.objects.iter().zip(&next.objects);
        let rotation = |scene: &Scene| scene.environment.as_ref().map(|environment| environment.rotation);
        let changes = Changes {
            triangles: objects.into_iter().any(|(a, b)| a.transform != b.transform)
                || shapes(&self.now) != shapes(&next),
            lights: self.now.lights != next.lights || emissions(&self.now) != emissions(&next),
            turn: rotation(&self.now) != rotation(&next),
        };
        self.now = next;
        Ok(changes)
    }
}
