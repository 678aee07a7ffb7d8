//! How paths go on from a surface: by a sample of its lobes, or in the one or two directions that mirrors,
//! metal and glass have.

use glam::Vec3;

use super::interface::{self, Aimed};
use super::lobes;
use super::media::Inside;
use super::trace::{Numbers, Tracer, part_of, purpose};
use crate::render::bvh::Hit;
use crate::render::geometry::Surface;
use crate::scene::Optics;
use lobelia_reflectance::Rgb;

/// Throughput below which roulette decides whether a path goes on: light that takes many bounces is where
/// much of the noise is, so that paths are better kept than ended as soon as they carry less than the first.
const ROULETTE_BELOW: f32 = 1.0 / 3.0;
/// Probability at most with which a path goes on after lobes, however much it carries.
const MOST_SURVIVAL: f32 = 0.95;

/// How a ray's direction was drawn.
#[derive(Clone, Copy)]
pub(super) struct Drawn {
    /// Density by the lobes, sr⁻¹; infinite for a direction that had no other beside it.
    pub(super) density: f32,
    /// The point it was drawn at, and the normal there.
    pub(super) from: Vec3,
    pub(super) normal: Vec3,
}

/// A ray on its way from a surface.
#[derive(Clone, Copy)]
pub(super) struct Leg {
    pub(super) origin: Vec3,
    pub(super) direction: Vec3,
    /// Radiance toward the viewer a radiance along the ray.
    pub(super) throughput: Rgb,
    pub(super) drawn: Drawn,
    /// What it starts in.
    pub(super) inside: Inside,
    /// The part of what the first surface reflects that is its diffuse term's.
    pub(super) diffuse: Rgb,
    /// Dielectrics from which both rays may still be followed.
    pub(super) tree: u32,
}

/// Where a ray has come to.
#[derive(Clone, Copy)]
pub(super) struct Start {
    pub(super) hit: Hit,
    pub(super) surface: Surface,
    /// What the ray was in.
    pub(super) inside: Inside,
    pub(super) throughput: Rgb,
    /// As in [`Leg`]; none at the first surface.
    pub(super) diffuse: Option<Rgb>,
    pub(super) tree: u32,
}

impl Tracer {
    /// Makes the reflectance of a surface ready, as the end of a ray sees it.
    pub(super) fn aim(
        &self,
        numbers: &Numbers,
        bounce: u32,
        surface: &Surface,
        direction: Vec3,
        aimed: &mut Aimed,
    ) {
        let wo = surface.to_local(-direction);
        if let Some(Optics::AshikhminShirley(brdf)) = &self.optics[surface.object as usize] {
            aimed.shader.aim_other(brdf, wo);
        } else {
            let texel = self.materials.only(surface.object).unwrap_or_else(|| {
                self.materials.choose(surface.object, surface.uv, numbers.at(bounce, purpose::TEXEL))
            });
            aimed.shader.aim(&self.materials, texel, wo, true);
        }
        (aimed.mirror, aimed.keep, aimed.black) = (Rgb::ZERO, 1.0, false);
        if !self.special {
            return;
        }
        if let Some(Optics::Mirror(texture)) = &self.optics[surface.object as usize] {
            let place = surface.uv * self.scene.objects[surface.object as usize].material.tiling;
            aimed.set_mirror(texture.at(place));
        }
        aimed.black = aimed.shader.is_black();
    }

    /// The rays that go on from a surface; two where both of a dielectric are followed.
    pub(super) fn leave(
        &self,
        numbers: &Numbers,
        bounce: u32,
        start: &Start,
        aimed: &Aimed,
    ) -> [Option<Leg>; 2] {
        let Start { hit, surface, inside, throughput, diffuse, tree } = *start;
        let direct = |direction, throughput, diffuse, inside, through: bool| Leg {
            origin: if through { self.geometry.beyond(&surface) } else { self.geometry.leaving(&surface) },
            direction,
            throughput,
            drawn: Drawn { density: f32::INFINITY, from: surface.position, normal: surface.frame[2] },
            inside,
            diffuse,
            tree: 0,
        };
        let sharp = diffuse.unwrap_or(Rgb::ZERO);
        match self.optics[surface.object as usize].as_ref() {
            Some(Optics::Dielectric(_)) => {
                let before = inside.before(surface.object, self.geometry.front(&hit, -surface.geometric));
                let front = self.geometry.front(&hit, -surface.geometric);
                let after = before.across(surface.object, front);
                let indices = [&before, &after].map(|inside| self.media.index(inside));
                let split = interface::dielectric(&surface, aimed.shader.wo, indices[1] / indices[0]);
                // Radiance grows with the square of the index.
                let scale = (indices[0] / indices[1]).powi(2);
                let reflected = |part: f32| direct(split.reflected, throughput * part, sharp, before, false);
                let refracted =
                    |part: f32| direct(split.refracted, throughput * (part * scale), sharp, after, true);
                let [choice, roulette] = numbers.optics(bounce);
                if split.reflectance >= 1.0 {
                    let leg = Leg { tree, ..reflected(1.0) };
                    return [survives(leg, bounce, roulette), None];
                }
                if tree > 0 && bounce + 1 < self.bounces {
                    let tree = tree - 1;
                    let pair = [reflected(split.reflectance), refracted(1.0 - split.reflectance)];
                    let [number, other] = [roulette, choice];
                    let [first, second] = pair.map(|leg| Leg { tree, ..leg });
                    return [survives(first, bounce, number), survives(second, bounce, other)];
                }
                let leg = if choice < split.reflectance { reflected(1.0) } else { refracted(1.0) };
                [survives(leg, bounce, roulette), None]
            }
            Some(&Optics::Conductor { n, k }) => {
                let index = self.media.index(&inside);
                let (direction, reflectance) =
                    interface::conductor(&surface, aimed.shader.wo, n / index, k / index);
                let leg = Leg { tree, ..direct(direction, throughput * reflectance, sharp, inside, false) };
                [survives(leg, bounce, numbers.optics(bounce)[1]), None]
            }
            _ => {
                if aimed.keep < 1.0 {
                    let [choice, roulette] = numbers.optics(bounce);
                    if choice >= aimed.keep {
                        let direction = interface::mirrored(&surface, aimed.shader.wo);
                        let part = throughput * aimed.mirror / (1.0 - aimed.keep);
                        let leg = Leg { tree, ..direct(direction, part, sharp, inside, false) };
                        return [survives(leg, bounce, roulette), None];
                    }
                }
                if aimed.black {
                    return [None, None];
                }
                [self.leave_by_lobes(numbers, bounce, start, aimed), None]
            }
        }
    }

    /// A ray that goes on by the lobes.
    fn leave_by_lobes(&self, numbers: &Numbers, bounce: u32, start: &Start, aimed: &Aimed) -> Option<Leg> {
        let (surface, shader) = (&start.surface, &aimed.shader);
        // The first bounce of a diffuse surface has nothing to choose.
        let chooses = bounce > 0 || !shader.is_diffuse();
        let [choice, roulette] = if chooses { numbers.at(bounce, purpose::CHOICE) } else { [0.0; 2] };
        let wi = lobes::sample(shader, choice, numbers.at(bounce, purpose::LOBE));
        let direction = surface.to_world(wi);
        if wi.z <= 0.0 || surface.geometric.dot(direction) <= 0.0 {
            return None;
        }
        let (reflectance, density) = shader.eval_and_density(wi);
        let density = density * aimed.keep;
        let mut throughput = start.throughput * (reflectance * (wi.z / density));
        if bounce > 0 {
            let survival = (throughput.max_element() / ROULETTE_BELOW).min(MOST_SURVIVAL);
            if roulette >= survival {
                return None;
            }
            throughput /= survival;
        }
        Some(Leg {
            origin: self.geometry.leaving(surface),
            direction,
            throughput,
            drawn: Drawn { density, from: surface.position, normal: surface.frame[2] },
            inside: start.inside,
            diffuse: start.diffuse.unwrap_or_else(|| part_of(shader.eval_diffuse(wi), reflectance)),
            tree: 0,
        })
    }
}

/// A ray of one direction after roulette: it always goes on while it carries enough.
fn survives(leg: Leg, bounce: u32, number: f32) -> Option<Leg> {
    let carries = leg.throughput.max_element();
    let survival = if bounce > 0 { (carries / ROULETTE_BELOW).min(1.0) } else { 1.0 };
    (carries > 0.0 && number < survival).then(|| Leg { throughput: leg.throughput / survival, ..leg })
}
