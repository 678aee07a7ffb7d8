//! What differs from frame to frame: the camera, the turn of the environment, where lights and objects stand,
//! named parameters.
//!
//! A [`State`] says it relative to the [`Scene`], which [`Scene::at`] gives in that state. A method says what
//! it can vary by [`Varies`].

use glam::{Affine3A, EulerRot, Quat, Vec3};

use super::{Camera, Light, Object, Scene};
use lobelia_base::error::{Error, Result};

/// How a light or an object stands and shines, relative to the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// By how much it is moved.
    pub shift: Vec3,
    /// Turns about x, then y, then z, about its own middle, radians.
    pub turn: Vec3,
    /// Factor on what it emits.
    pub dim: f32,
}

impl Default for Placement {
    fn default() -> Self {
        Self { shift: Vec3::ZERO, turn: Vec3::ZERO, dim: 1.0 }
    }
}

impl Placement {
    /// This and a part, 0 to 1, of another.
    #[must_use]
    pub fn and(&self, part: f32, other: &Self) -> Self {
        Self {
            shift: self.shift + part * other.shift,
            turn: self.turn + part * other.turn,
            dim: self.dim * (1.0 + part * (other.dim - 1.0)),
        }
    }

    fn rotation(&self) -> Quat {
        Quat::from_euler(EulerRot::ZYX, self.turn.z, self.turn.y, self.turn.x)
    }

    /// The light so placed.
    pub fn of_light(&self, light: &Light) -> Light {
        if *self == Self::default() {
            return *light;
        }
        let (rotation, shift, dim) = (self.rotation(), self.shift, self.dim);
        match *light {
            Light::Directional { toward, irradiance } => {
                Light::Directional { toward: (rotation * toward).normalize(), irradiance: irradiance * dim }
            }
            Light::Point { position, intensity } => {
                Light::Point { position: position + shift, intensity: intensity * dim }
            }
            Light::Rectangle { centre, edges, radiance } => Light::Rectangle {
                centre: centre + shift,
                edges: edges.map(|edge| rotation * edge),
                radiance: radiance * dim,
            },
        }
    }

    /// The transform of an object so placed.
    pub fn of_transform(&self, transform: &Affine3A) -> Affine3A {
        if *self == Self::default() {
            return *transform;
        }
        let mut placed = Affine3A::from_quat(self.rotation()) * *transform;
        placed.translation = transform.translation + glam::Vec3A::from(self.shift);
        placed
    }

    fn check(&self) -> Result<()> {
        if self.shift.is_finite() && self.turn.is_finite() && self.dim.is_finite() && self.dim >= 0.0 {
            return Ok(());
        }
        Err(Error::input("move, turn_deg and dim must be finite, dim not negative"))
    }
}

/// What a named parameter does at the end of its range; between, in proportion.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Drive {
    /// Turn of the environment about +y, radians.
    pub turn: f32,
    /// Lights by their index.
    pub lights: Vec<(usize, Placement)>,
    /// Objects by their index.
    pub objects: Vec<(usize, Placement)>,
}

/// A named parameter of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Its name in files and on the command line.
    pub name: String,
    /// From where it does nothing to where it does all of `drive`.
    pub range: [f64; 2],
    /// Where it stands when nothing is said.
    pub value: f64,
    /// What it does.
    pub drive: Drive,
}

impl Parameter {
    /// How far along its range a value is, 0 to 1.
    pub fn part(&self, value: f64) -> f64 {
        (value - self.range[0]) / (self.range[1] - self.range[0])
    }
}

/// The state of a scene in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// The view.
    pub camera: Camera,
    /// Turn of the environment about +y beyond the scene's, radians.
    pub turn: f32,
    /// One a light of the scene.
    pub lights: Vec<Placement>,
    /// One an object of the scene.
    pub objects: Vec<Placement>,
    /// One a parameter of the scene.
    pub parameters: Vec<f64>,
}

impl State {
    /// Whether the light and what it falls on are the same: only the view may differ.
    pub fn has_light_of(&self, other: &Self) -> bool {
        let Self { camera: _, turn, lights, objects, parameters } = self;
        (turn, lights, objects, parameters) == (&other.turn, &other.lights, &other.objects, &other.parameters)
    }
}

/// How often the light changes along some frames, the first of which is no change.
pub fn light_changes(frames: &[State]) -> u32 {
    frames.windows(2).filter(|pair| !pair[1].has_light_of(&pair[0])).count() as u32
}

impl Scene {
    /// The state that the scene is in as it stands.
    pub fn state(&self) -> State {
        State {
            camera: self.camera,
            turn: 0.0,
            lights: vec![Placement::default(); self.lights.len()],
            objects: vec![Placement::default(); self.objects.len()],
            parameters: self.parameters.iter().map(|parameter| parameter.value).collect(),
        }
    }

    /// The scene as it stands, seen by another camera.
    pub fn seen_by(&self, camera: &Camera) -> State {
        State { camera: *camera, ..self.state() }
    }

    /// The scene in a state, its parameters done; meshes, maps and pixels are shared.
    ///
    /// # Errors
    /// Input errors for a state that is not one of this scene.
    pub fn at(&self, state: &State) -> Result<Self> {
        self.check_state(state)?;
        let mut scene = self.clone();
        let (mut turn, mut lights, mut objects) = (state.turn, state.lights.clone(), state.objects.clone());
        for (parameter, value) in self.parameters.iter().zip(&state.parameters) {
            let part = parameter.part(*value) as f32;
            if part == 0.0 {
                continue;
            }
            turn += part * parameter.drive.turn;
            for (index, placement) in &parameter.drive.lights {
                lights[*index] = lights[*index].and(part, placement);
            }
            for (index, placement) in &parameter.drive.objects {
                objects[*index] = objects[*index].and(part, placement);
            }
        }
        scene.camera = state.camera;
        scene.environment = scene.environment.map(|environment| environment.rotated(turn));
        for (light, placement) in scene.lights.iter_mut().zip(&lights) {
            *light = placement.of_light(light);
        }
        for (object, placement) in scene.objects.iter_mut().zip(&objects) {
            object.transform = placement.of_transform(&object.transform);
            if placement.dim != 1.0 {
                let emission = object.material.emission.as_ref();
                object.material.emission = emission.map(|emission| emission.scaled(placement.dim));
            }
        }
        Ok(scene)
    }

    /// Refuses a state that is none of this scene.
    pub(super) fn check_state(&self, state: &State) -> Result<()> {
        state.camera.check()?;
        if !state.turn.is_finite() {
            return Err(Error::input("environment_turn_deg is not finite"));
        }
        if state.turn != 0.0 && self.environment.is_none() {
            return Err(Error::input("there is no environment that could be turned"));
        }
        let counts = [state.lights.len(), state.objects.len(), state.parameters.len()];
        if counts != [self.lights.len(), self.objects.len(), self.parameters.len()] {
            return Err(Error::input(
                "a frame needs one placement a light and an object, one value a parameter",
            ));
        }
        for (index, (placement, light)) in state.lights.iter().zip(&self.lights).enumerate() {
            check_light(placement, light).map_err(|error| error.at(format!("light {index}")))?;
        }
        for (placement, object) in state.objects.iter().zip(&self.objects) {
            check_object(placement, object)
                .map_err(|error| error.at(format!("object \"{}\"", object.name)))?;
        }
        for (value, parameter) in state.parameters.iter().zip(&self.parameters) {
            let Parameter { name, range: [low, high], .. } = parameter;
            if !(low.min(*high)..=low.max(*high)).contains(value) {
                return Err(Error::input(format!("parameter {name} is {value}; use {low} to {high}")));
            }
        }
        Ok(())
    }

    /// Refuses parameters that cannot be meant.
    pub(super) fn check_parameters(&self) -> Result<()> {
        for (index, parameter) in self.parameters.iter().enumerate() {
            let place = format!("parameter {}", parameter.name);
            let check = || {
                let [low, high] = parameter.range;
                if self.parameters[..index].iter().any(|other| other.name == parameter.name) {
                    return Err(Error::input("there are two of this name"));
                }
                if !(low.is_finite() && high.is_finite()) || low == high {
                    return Err(Error::input("range must be two different finite numbers"));
                }
                if !parameter.drive.turn.is_finite() {
                    return Err(Error::input("environment_turn_deg is not finite"));
                }
                if parameter.drive.turn != 0.0 && self.environment.is_none() {
                    return Err(Error::input("there is no environment that could be turned"));
                }
                for (light, placement) in &parameter.drive.lights {
                    check_light(placement, &self.lights[*light])
                        .map_err(|error| error.at(format!("light {light}")))?;
                }
                for (object, placement) in &parameter.drive.objects {
                    let object = &self.objects[*object];
                    check_object(placement, object)
                        .map_err(|error| error.at(format!("object \"{}\"", object.name)))?;
                }
                Ok(())
            };
            check().map_err(|error| error.at(place))?;
        }
        self.check_state(&self.state())
    }
}

fn check_light(placement: &Placement, light: &Light) -> Result<()> {
    placement.check()?;
    if placement.shift != Vec3::ZERO && matches!(light, Light::Directional { .. }) {
        return Err(Error::input("a directional light stands nowhere and cannot be moved; turn it"));
    }
    Ok(())
}

fn check_object(placement: &Placement, object: &Object) -> Result<()> {
    placement.check()?;
    if placement.dim != 1.0 && object.material.emission.is_none() {
        return Err(Error::input("it does not shine and cannot be dimmed"));
    }
    Ok(())
}

/// What a method can vary from frame to frame without being prepared, or baked, again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Varies {
    /// The view.
    pub camera: bool,
    /// The turn of the environment.
    pub turn: bool,
    /// Lights, moved, turned and dimmed.
    pub lights: bool,
    /// Objects, moved, turned and, where they shine, dimmed.
    pub objects: bool,
    /// The scene's named parameters.
    pub parameters: bool,
}

impl Varies {
    /// All of it.
    pub const ALL: Self = Self { camera: true, turn: true, lights: true, objects: true, parameters: true };

    /// What of this there is, by name.
    pub fn names(&self) -> Vec<&'static str> {
        let all = [
            (self.camera, "the camera"),
            (self.turn, "the environment's turn"),
            (self.lights, "lights"),
            (self.objects, "objects"),
            (self.parameters, "parameters"),
        ];
        all.into_iter().filter(|(is, _)| *is).map(|(_, name)| name).collect()
    }

    /// What of a scene some frames vary: what is not in all of them as the scene has it.
    pub fn of(scene: &Scene, frames: &[State]) -> Self {
        let own = scene.state();
        let any = |differs: &dyn Fn(&State) -> bool| frames.iter().any(differs);
        Self {
            camera: any(&|frame| frame.camera != own.camera),
            turn: any(&|frame| frame.turn != own.turn),
            lights: any(&|frame| frame.lights != own.lights),
            objects: any(&|frame| frame.objects != own.objects),
            parameters: any(&|frame| frame.parameters != own.parameters),
        }
    }

    /// Refuses frames that vary what a method of this kind cannot.
    ///
    /// # Errors
    /// An input error with what it is.
    pub fn check(&self, method: &str, scene: &Scene, frames: &[State]) -> Result<()> {
        let asked = Self::of(scene, frames);
        let beyond = Self {
            camera: asked.camera && !self.camera,
            turn: asked.turn && !self.turn,
            lights: asked.lights && !self.lights,
            objects: asked.objects && !self.objects,
            parameters: asked.parameters && !self.parameters,
        };
        if beyond.names().is_empty() {
            return Ok(());
        }
        let (beyond, own) = (beyond.names().join(", "), self.names());
        let own = if own.is_empty() { "nothing".into() } else { own.join(", ") };
        Err(Error::input(format!("the frames vary {beyond}; `{method}` can vary {own}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::showcase;
    use lobelia_reflectance::Rgb;
    use std::f32::consts::FRAC_PI_2;

    fn driven() -> Scene {
        let mut scene = showcase::published(8, 6);
        let shift = Placement { shift: Vec3::X * 4.0, dim: 0.0, ..Placement::default() };
        scene.parameters.push(Parameter {
            name: "evening".into(),
            range: [12.0, 20.0],
            value: 12.0,
            drive: Drive { turn: FRAC_PI_2, lights: vec![(1, shift)], objects: vec![] },
        });
        scene
    }

    #[test]
    fn the_scene_as_it_stands_is_itself_and_half_a_parameter_does_half() {
        let scene = driven();
        let same = scene.at(&scene.state()).unwrap();
        assert_eq!((same.environment.clone(), &same.lights), (scene.environment.clone(), &scene.lights));
        let mut state = scene.state();
        state.parameters[0] = 16.0;
        let half = scene.at(&state).unwrap();
        assert_eq!(half.environment.unwrap().rotation, FRAC_PI_2 / 2.0);
        let (Light::Point { position, intensity }, Light::Point { position: now, intensity: left }) =
            (scene.lights[1], half.lights[1])
        else {
            panic!("point lights")
        };
        assert_eq!((now - position, left), (Vec3::X * 2.0, intensity * 0.5));
        state.parameters[0] = 21.0;
        assert!(scene.at(&state).unwrap_err().to_string().contains("evening is 21; use 12 to 20"));
    }

    #[test]
    fn lights_and_objects_turn_about_their_own_middle() {
        let quarter = Placement { turn: Vec3::Y * FRAC_PI_2, ..Placement::default() };
        let light = Light::Rectangle {
            centre: Vec3::new(1.0, 2.0, 3.0),
            edges: [Vec3::X, Vec3::Z],
            radiance: Rgb::ONE,
        };
        let Light::Rectangle { centre, edges: [u, v], .. } = quarter.of_light(&light) else { panic!() };
        assert_eq!(centre, Vec3::new(1.0, 2.0, 3.0));
        assert!((u + Vec3::Z).length() < 1e-6 && (v - Vec3::X).length() < 1e-6, "{u} {v}");
        let placed = quarter.of_transform(&Affine3A::from_translation(centre));
        assert!((placed.transform_point3(Vec3::X) - (centre - Vec3::Z)).length() < 1e-6);
    }

    #[test]
    fn what_a_method_cannot_vary_is_refused_by_name() {
        let scene = driven();
        let still = scene.state();
        let camera = Camera { fov: 0.5, ..scene.camera };
        let moved = scene.seen_by(&camera);
        let turned = State { turn: 0.1, ..still.clone() };
        let views = Varies { turn: false, lights: false, objects: false, parameters: false, ..Varies::ALL };
        views.check("atlas", &scene, &[still.clone(), moved.clone()]).unwrap();
        let error = views.check("atlas", &scene, &[moved.clone(), turned.clone()]).unwrap_err().to_string();
        assert_eq!(error, "the frames vary the environment's turn; `atlas` can vary the camera");
        assert_eq!(light_changes(&[still.clone(), moved, turned, still]), 2);
    }

    #[test]
    fn placements_that_cannot_be_are_refused() {
        let scene = driven();
        let with = |light: usize, placement: Placement| {
            let mut state = scene.state();
            state.lights[light] = placement;
            scene.at(&state).map(|_| ()).unwrap_err().to_string()
        };
        assert!(with(0, Placement { shift: Vec3::X, ..Placement::default() }).contains("directional"));
        assert!(with(1, Placement { dim: -1.0, ..Placement::default() }).contains("not negative"));
        let mut state = scene.state();
        state.objects[0].dim = 0.5;
        assert!(scene.at(&state).unwrap_err().to_string().contains("does not shine"));
    }
}
