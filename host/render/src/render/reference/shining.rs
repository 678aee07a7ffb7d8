//! Which surfaces shine: the emitters of a scene, and what a surface that is met emits.

use glam::{Vec2, Vec3};

use super::emitters::{Emitter, Emitters, Shape};
use super::rectangle::Rectangle;
use crate::render::geometry::{Geometry, Surface};
use crate::scene::{Light, Scene, Texture};
use lobelia_reflectance::Rgb;

/// No emitter.
const NONE: u32 = u32::MAX;
/// Places along an edge at which a texture on a triangle is looked at for its mean.
const LOOKS: usize = 6;

/// What shines by object and by triangle.
pub(super) struct Shining {
    /// Emission and repeats of the texture by object; empty where no mesh shines.
    objects: Vec<Option<(Texture, Vec2)>>,
    /// Radiance by rectangle, and its emitter.
    rectangles: Vec<(Rgb, u32)>,
    /// Emitter by triangle; empty where no mesh shines.
    triangles: Vec<u32>,
    /// The index of the first rectangular light among the objects.
    first_rectangle: usize,
}

impl Shining {
    /// The emitters of a scene and where they are.
    pub(super) fn new(scene: &Scene, geometry: &Geometry) -> (Emitters, Self) {
        let first_rectangle = scene.objects.len();
        let mut found = Vec::new();
        let mut shining = Self { objects: vec![], rectangles: vec![], triangles: vec![], first_rectangle };
        for light in &scene.lights {
            if let Light::Rectangle { centre, edges, radiance } = *light {
                shining.rectangles.push((radiance, NONE));
                let [u, v] = edges;
                found.push(Emitter::rectangle(Rectangle::new(centre, edges), [centre, u, v], radiance));
            }
        }
        // Black ones are left out of the tree; what is left keeps its order.
        let lit = |radiance: Rgb| radiance.max_element() > 0.0;
        let mut next = 0;
        for (radiance, emitter) in &mut shining.rectangles {
            if lit(*radiance) {
                (*emitter, next) = (next, next + 1);
            }
        }
        if scene.objects.iter().any(|object| object.material.emission.is_some()) {
            shining.triangles = vec![NONE; geometry.triangles()];
            let emission = |object: &crate::scene::Object| {
                object.material.emission.as_ref().map(|texture| (texture.clone(), object.material.tiling))
            };
            shining.objects = scene.objects.iter().map(emission).collect();
            for (object, emission) in (0u32..).zip(&shining.objects) {
                let Some(emission) = emission else { continue };
                for triangle in geometry.triangles_of(object) {
                    let corners = geometry.corners(triangle);
                    let mean = mean(emission, corners.map(|corner| corner.uv));
                    let emitter = Emitter::triangle(corners.map(|corner| corner.position), triangle, mean);
                    if let Some(emitter) = emitter.filter(|_| lit(mean)) {
                        shining.triangles[triangle as usize] = next;
                        next += 1;
                        found.push(emitter);
                    }
                }
            }
        }
        (Emitters::new(found), shining)
    }

    /// What a surface emits toward who sees it, from its front or from behind; none where it does not shine.
    #[inline]
    pub(super) fn emission(&self, surface: &Surface, front: bool) -> Option<Rgb> {
        let (texture, tiling) = self.objects.get(surface.object as usize)?.as_ref()?;
        front.then(|| texture.at(surface.uv * *tiling))
    }

    /// The radiance of an emitter at a place on it.
    pub(super) fn radiance(&self, shape: &Shape, geometry: &Geometry, place: Vec3) -> Rgb {
        match shape {
            Shape::Rectangle(_, radiance) => *radiance,
            Shape::Triangle(_, triangle) => {
                let object = geometry.object_of(*triangle) as usize;
                match self.objects.get(object) {
                    Some(Some((Texture::Uniform(radiance), _))) => *radiance,
                    Some(Some((texture, tiling))) => texture.at(geometry.uv(*triangle, place) * *tiling),
                    _ => Rgb::ZERO,
                }
            }
        }
    }

    /// The emitter of a rectangular light by its index among the objects.
    pub(super) fn rectangle(&self, object: u32) -> Option<u32> {
        let (_, emitter) = self.rectangles.get(object as usize - self.first_rectangle)?;
        (*emitter != NONE).then_some(*emitter)
    }

    /// The emitter of a triangle.
    pub(super) fn triangle(&self, triangle: u32) -> Option<u32> {
        self.triangles.get(triangle as usize).copied().filter(|&emitter| emitter != NONE)
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.triangles[..])
    }
}

/// About the mean radiance over a triangle.
fn mean((texture, tiling): &(Texture, Vec2), [a, b, c]: [Vec2; 3]) -> Rgb {
    if let Texture::Uniform(radiance) = texture {
        return *radiance;
    }
    let mut sum = Rgb::ZERO;
    let places = (0..LOOKS).flat_map(|i| (0..LOOKS - i).map(move |j| (i, j)));
    let at = |k: usize| (k as f32 + 1.0 / 3.0) / LOOKS as f32;
    for (i, j) in places {
        sum += texture.at((a + (b - a) * at(i) + (c - a) * at(j)) * *tiling);
    }
    sum / (LOOKS * (LOOKS + 1) / 2) as f32
}
