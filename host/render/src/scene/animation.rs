//! Animations: Catmull–Rom splines through states that are evenly spaced in time.

use glam::Vec3;

use super::state::{Placement, State};
use super::{Camera, Scene};

/// A path through states of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Animation {
    /// Pictures.
    pub frames: u32,
    /// States that it passes through, two at least.
    pub keys: Vec<State>,
    /// Whether the path goes on from the last state to the first.
    pub closed: bool,
}

impl Animation {
    /// The state of a frame, 0 to `frames` − 1, at the picture's size of the first key. An open path ends in
    /// its last state; a closed one ends a frame before it repeats.
    pub fn state(&self, frame: u32) -> State {
        let count = self.keys.len() as i64;
        let (spans, steps) =
            if self.closed { (count, self.frames) } else { (count - 1, self.frames.saturating_sub(1)) };
        let place = f64::from(frame) / f64::from(steps.max(1)) * spans as f64;
        let span = (place as i64).clamp(0, (spans - 1).max(0));
        let t = (place - span as f64) as f32;
        let key = |offset: i64| {
            let index = span + offset;
            let index = if self.closed { index.rem_euclid(count) } else { index.clamp(0, count - 1) };
            &self.keys[index as usize]
        };
        let around = [key(-1), key(0), key(1), key(2)];
        let vector = |of: &dyn Fn(&State) -> Vec3| spline(around.map(of), t);
        let number = |of: &dyn Fn(&State) -> f32| vector(&|state| Vec3::splat(of(state))).x;
        let placement = |of: &dyn Fn(&State) -> Placement| Placement {
            shift: vector(&|state| of(state).shift),
            turn: vector(&|state| of(state).turn),
            // A spline may swing below.
            dim: number(&|state| of(state).dim).max(0.0),
        };
        let first = &self.keys[0];
        State {
            camera: Camera {
                position: vector(&|state| state.camera.position),
                target: vector(&|state| state.camera.target),
                up: vector(&|state| state.camera.up),
                fov: number(&|state| state.camera.fov),
                ..first.camera
            },
            turn: number(&|state| state.turn),
            lights: (0..first.lights.len()).map(|k| placement(&|state| state.lights[k])).collect(),
            objects: (0..first.objects.len()).map(|k| placement(&|state| state.objects[k])).collect(),
            parameters: (0..first.parameters.len())
                .map(|k| f64::from(number(&|state| state.parameters[k] as f32)))
                .collect(),
        }
    }
}

impl Scene {
    /// The states of the animation's frames; none without one. A parameter that a spline swings beyond its
    /// range stays at its end.
    pub fn frames(&self) -> Vec<State> {
        let Some(animation) = &self.animation else { return Vec::new() };
        let within = |mut state: State| {
            for (value, parameter) in state.parameters.iter_mut().zip(&self.parameters) {
                let [a, b] = parameter.range;
                *value = value.clamp(a.min(b), a.max(b));
            }
            state
        };
        (0..animation.frames).map(|frame| within(animation.state(frame))).collect()
    }
}

/// The uniform Catmull–Rom spline from the second to the third point.
fn spline([a, b, c, d]: [Vec3; 4], t: f32) -> Vec3 {
    let (out, into) = ((c - a) / 2.0, (d - b) / 2.0);
    let (square, cube) = (t * t, t * t * t);
    b * (2.0 * cube - 3.0 * square + 1.0)
        + out * (cube - 2.0 * square + t)
        + c * (3.0 * square - 2.0 * cube)
        + into * (cube - square)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn orbit(closed: bool) -> Animation {
        let camera = |angle: f32| Camera {
            position: Vec3::new(angle.sin(), 0.5, angle.cos()) * 4.0,
            target: Vec3::ZERO,
            up: Vec3::Y,
            fov: 0.5,
            width: 8,
            height: 6,
        };
        let scene = crate::scene::showcase::published(8, 6);
        let key = |k: u8| {
            let mut state = scene.seen_by(&camera(f32::from(k) * std::f32::consts::FRAC_PI_4));
            (state.turn, state.lights[0].dim) = (f32::from(k), f32::from(k % 2));
            state
        };
        let keys = (0..8).map(key).collect();
        Animation { frames: 33, keys, closed }
    }

    #[test]
    fn a_path_passes_through_its_views_and_stays_near_a_circle_between() {
        let open = orbit(false);
        assert_eq!(open.state(0), open.keys[0]);
        assert!((open.state(32).camera.position - open.keys[7].camera.position).length() < 1e-5);
        let closed = Animation { frames: 32, ..orbit(true) };
        assert!((closed.state(12).camera.position - closed.keys[3].camera.position).length() < 1e-5);
        for frame in 0..32 {
            let radius = closed.state(frame).camera.position.length();
            assert!((radius / (4.0 * 1.25f32.sqrt()) - 1.0).abs() < 0.02, "{frame}: {radius}");
        }
    }

    #[test]
    fn the_turn_is_even_between_even_keys_and_a_light_is_never_dimmed_below_nothing() {
        let path = Animation { frames: 57, ..orbit(false) };
        let states: Vec<_> = (0..57).map(|frame| path.state(frame)).collect();
        assert!((16..40).all(|k| (states[k].turn - k as f32 / 8.0).abs() < 1e-5));
        assert_eq!((states[8].lights[0].dim, states[16].lights[0].dim), (1.0, 0.0));
        assert!(states.iter().all(|state| state.lights[0].dim >= 0.0));
    }
}
