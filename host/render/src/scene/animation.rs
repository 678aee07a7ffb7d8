//! Camera paths: Catmull–Rom splines through views that are evenly spaced in time.

use glam::Vec3;

use super::Camera;

/// A path of the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Animation {
    /// Pictures.
    pub frames: u32,
    /// Views that the camera passes through, two at least.
    pub keys: Vec<Camera>,
    /// Whether the path goes on from the last view to the first.
    pub closed: bool,
}

impl Animation {
    /// The view of a frame, 0 to `frames` − 1, at the picture's size of the first key. An open path ends in its last view; a
    /// closed one ends a frame before it repeats.
    pub fn view(&self, frame: u32) -> Camera {
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
        let vector = |of: fn(&Camera) -> Vec3| spline(around.map(of), t);
        let fov = spline(around.map(|camera| Vec3::splat(camera.fov)), t).x;
        Camera {
            position: vector(|camera| camera.position),
            target: vector(|camera| camera.target),
            up: vector(|camera| camera.up),
            fov,
            ..self.keys[0]
        }
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
        let keys = (0..8).map(|k| camera(k as f32 * std::f32::consts::FRAC_PI_4)).collect();
        Animation { frames: 33, keys, closed }
    }

    #[test]
    fn a_path_passes_through_its_views_and_stays_near_a_circle_between() {
        let open = orbit(false);
        assert_eq!(open.view(0), open.keys[0]);
        assert!((open.view(32).position - open.keys[7].position).length() < 1e-5);
        let closed = Animation { frames: 32, ..orbit(true) };
        assert!((closed.view(12).position - closed.keys[3].position).length() < 1e-5);
        for frame in 0..32 {
            let radius = closed.view(frame).position.length();
            assert!((radius / (4.0 * 1.25f32.sqrt()) - 1.0).abs() < 0.02, "{frame}: {radius}");
        }
    }
}
