//! A scene's materials packed for evaluation: black lobes dropped, β multiplied into C, one layout for CPU
//! and shader.

use std::collections::HashMap;

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

use super::math;
use crate::scene::{Filter, Light, Reflectance, Scene};
use lobelia_reflectance::mip;
use lobelia_reflectance::{AshikhminShirley, Lobe, LobeBrdf, Microfacet, Rgb, colour, lobe::into_lobe_frame};

/// Lobes whose value would fall below 2^−40 of ρ_s are skipped.
const NEGLIGIBLE_LOG2: f32 = -40.0;

/// A lobe with C' = R(−β) C R(β) (4.4) about its normal, a symmetric matrix.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct PackedLobe {
    /// C' xx, xy, yy, zz, and xz and yz, which are 0 about the surface's own normal.
    pub(crate) c: [f32; 6],
    /// ρ_s, sr⁻¹.
    pub(crate) rho_s: [f32; 3],
    /// Exponent.
    pub(crate) n: f32,
    /// Exponent toward grazing (6.19): that of `n` for most.
    pub(crate) n_grazing: f32,
}

/// A texel: its diffuse term and its run of lobes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct PackedTexel {
    /// ρ_d, sr⁻¹.
    pub(crate) rho_d: [f32; 3],
    /// Index of the first lobe.
    pub(crate) first: u32,
    /// Number of lobes.
    pub(crate) count: u32,
    padding: [u32; 3],
}

/// A material: its run of texels and how they are looked up.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct PackedMaterial {
    /// Index of the first texel.
    pub(crate) first: u32,
    /// Texels a row.
    pub(crate) width: u32,
    /// Rows.
    pub(crate) height: u32,
    /// 1 for bilinear, 0 for nearest.
    pub(crate) bilinear: u32,
    /// Repeats along u and v.
    pub(crate) tiling: [f32; 2],
    /// MIP levels beyond the finest; their texels follow.
    pub(crate) levels: u32,
    padding: u32,
    /// Radiance of a rectangular light's front; zero for objects.
    pub(crate) emission: [f32; 3],
    /// 1 for a rectangular light.
    pub(crate) emits: u32,
}

/// All materials of a scene: one an object, then one a rectangular light.
pub(crate) struct Materials {
    pub(crate) materials: Vec<PackedMaterial>,
    pub(crate) texels: Vec<PackedTexel>,
    pub(crate) lobes: Vec<PackedLobe>,
    /// Microfacet terms of the texels that have any.
    pub(crate) microfacets: HashMap<u32, Vec<Microfacet>>,
}

impl Materials {
    /// Packs the materials of a scene's objects, without MIP levels.
    pub(crate) fn new(scene: &Scene) -> Self {
        Self::pack(scene, false)
    }

    /// Packs the materials of a scene's objects with their MIP levels.
    pub(crate) fn with_levels(scene: &Scene) -> Self {
        Self::pack(scene, true)
    }

    fn pack(scene: &Scene, with_levels: bool) -> Self {
        let mut packed =
            Self { materials: vec![], texels: vec![], lobes: vec![], microfacets: HashMap::new() };
        for object in &scene.objects {
            let first = packed.texels.len() as u32;
            let (width, height) = match &object.material.reflectance {
                Reflectance::Uniform(_) => (1, 1),
                Reflectance::Map(map) => (map.width as u32, map.height as u32),
            };
            let levels = if with_levels { object.material.levels.len() as u32 } else { 0 };
            let texels = if with_levels { usize::MAX } else { (width * height) as usize };
            object.material.brdfs().take(texels).for_each(|brdf| packed.push(&brdf));
            packed.materials.push(PackedMaterial {
                first,
                width,
                height,
                bilinear: u32::from(object.material.filter == Filter::Bilinear && (width, height) != (1, 1)),
                tiling: object.material.tiling.to_array(),
                levels,
                padding: 0,
                emission: [0.0; 3],
                emits: 0,
            });
        }
        for light in &scene.lights {
            if let Light::Rectangle { radiance, .. } = light {
                let first = packed.texels.len() as u32;
                packed.push(&LobeBrdf::default());
                packed.materials.push(PackedMaterial {
                    first,
                    width: 1,
                    height: 1,
                    bilinear: 0,
                    tiling: [1.0; 2],
                    levels: 0,
                    padding: 0,
                    emission: radiance.to_array(),
                    emits: 1,
                });
            }
        }
        packed
    }

    /// Takes the radiance of rectangular lights from a scene of the same objects and as many lights.
    pub(crate) fn relight(&mut self, scene: &Scene) {
        let radiances = scene.lights.iter().filter_map(|light| match light {
            Light::Rectangle { radiance, .. } => Some(radiance.to_array()),
            _ => None,
        });
        for (material, radiance) in self.materials[scene.objects.len()..].iter_mut().zip(radiances) {
            material.emission = radiance;
        }
    }

    /// Appends one texel.
    fn push(&mut self, brdf: &LobeBrdf) {
        if !brdf.microfacets.is_empty() {
            self.microfacets.insert(self.texels.len() as u32, brdf.microfacets.clone());
        }
        let first = self.lobes.len() as u32;
        self.lobes
            .extend(brdf.lobes.iter().filter(|lobe| lobe.rho_s != Rgb::ZERO).map(|lobe| pack(lobe, brdf)));
        self.texels.push(PackedTexel {
            rho_d: brdf.rho_d.to_array(),
            first,
            count: self.lobes.len() as u32 - first,
            padding: [0; 3],
        });
    }

    /// The texels around texture coordinates with their weights; four entries, or one of weight 1 and three
    /// of 0.
    #[cfg(test)]
    pub(crate) fn neighbours(&self, object: u32, uv: Vec2) -> [(u32, f32); 4] {
        let material = &self.materials[object as usize];
        let (x, y) = texel_coordinates(material, uv);
        material.around(0, x, y)
    }

    /// The texel of an object that has no other.
    pub(crate) fn only(&self, object: u32) -> Option<u32> {
        let material = &self.materials[object as usize];
        (material.width * material.height == 1).then_some(material.first)
    }

    /// One of the neighbours, chosen with its weight as probability by two numbers in 0..1: the mean of
    /// evaluated reflectance over such choices is the blend of the four.
    pub(crate) fn choose(&self, object: u32, uv: Vec2, [r, s]: [f32; 2]) -> u32 {
        let material = &self.materials[object as usize];
        let (mut x, mut y) = texel_coordinates(material, uv);
        if material.bilinear != 0 {
            (x, y) = (x + r - 0.5, y + s - 0.5);
        }
        material.index(0, x.floor() as i64, y.floor() as i64)
    }

    /// Radiance of a rectangular light's front; `None` for a scene object.
    pub(crate) fn emission(&self, object: u32) -> Option<Rgb> {
        let material = &self.materials[object as usize];
        (material.emits != 0).then(|| Rgb::from_array(material.emission))
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.materials[..]) + size_of_val(&self.texels[..]) + size_of_val(&self.lobes[..])
    }

    /// Diffuse reflectance of a texel, sr⁻¹.
    pub(crate) fn rho_d(&self, texel: u32) -> Rgb {
        Rgb::from_array(self.texels[texel as usize].rho_d)
    }

    /// The lobes of a texel.
    pub(crate) fn lobes_of(&self, texel: u32) -> &[PackedLobe] {
        let texel = &self.texels[texel as usize];
        &self.lobes[texel.first as usize..(texel.first + texel.count) as usize]
    }
}

impl PackedMaterial {
    /// The texels around a place in a level, in texels of that level, with their weights; four entries, or
    /// one of weight 1 and three of 0.
    pub(crate) fn around(&self, level: u32, x: f32, y: f32) -> [(u32, f32); 4] {
        if self.bilinear == 0 {
            let texel = self.index(level, x.floor() as i64, y.floor() as i64);
            return [(texel, 1.0), (texel, 0.0), (texel, 0.0), (texel, 0.0)];
        }
        let (left, top) = ((x - 0.5).floor(), (y - 0.5).floor());
        let (fx, fy) = (x - 0.5 - left, y - 0.5 - top);
        let at = |dx: i64, dy: i64| self.index(level, left as i64 + dx, top as i64 + dy);
        [
            (at(0, 0), (1.0 - fx) * (1.0 - fy)),
            (at(1, 0), fx * (1.0 - fy)),
            (at(0, 1), (1.0 - fx) * fy),
            (at(1, 1), fx * fy),
        ]
    }

    /// Texel index of a column and a row of a level, which wrap around.
    pub(crate) fn index(&self, level: u32, x: i64, y: i64) -> u32 {
        let size = |level| mip::size([self.width as usize, self.height as usize], level);
        let before: usize = (0..level).map(|level| size(level).iter().product::<usize>()).sum();
        let [width, height] = size(level).map(|edge| edge as i64);
        self.first + before as u32 + (y.rem_euclid(height) * width + x.rem_euclid(width)) as u32
    }
}

/// Texture coordinates in texels, within one repeat.
fn texel_coordinates(material: &PackedMaterial, uv: Vec2) -> (f32, f32) {
    let repeat = |x: f32, tiling: f32, size: u32| (x * tiling - (x * tiling).floor()) * size as f32;
    (repeat(uv.x, material.tiling[0], material.width), repeat(uv.y, material.tiling[1], material.height))
}

/// Multiplies β and the normal into C.
fn pack(lobe: &Lobe, brdf: &LobeBrdf) -> PackedLobe {
    let axes = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| into_lobe_frame(axis, brdf.normal, brdf.beta));
    let entry = |i: usize, j: usize| (axes[i] * lobe.c).dot(axes[j]);
    PackedLobe {
        c: [entry(0, 0), entry(0, 1), entry(1, 1), entry(2, 2), entry(0, 2), entry(1, 2)],
        rho_s: lobe.rho_s.to_array(),
        n: lobe.n,
        n_grazing: lobe.n_grazing.unwrap_or(lobe.n),
    }
}

/// One lobe for a fixed exitant direction: its peak C'ω_o, and how it is sampled.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Aimed {
    /// C'ω_o: the base is its dot product with ω_i.
    pub(crate) peak: Vec3,
    /// Exponent, of a lobe that sharpens that at its peak.
    pub(crate) n: f32,
    /// Its exponent for light along the horizon, and by how much it is larger for light along the normal
    /// (6.19).
    exponents: [f32; 2],
    /// ρ_s, sr⁻¹.
    pub(crate) rho_s: Rgb,
    /// The least base that is worth a power.
    least: f32,
    /// Probability of this lobe in the mixture.
    pub(crate) share: f32,
    /// Density of the mixture a unit of base^n: share · (n + 1) / 2π |peak|^n.
    density: f32,
}

/// A microfacet term for a fixed exitant direction.
pub(crate) struct AimedMicrofacet {
    pub(crate) coat: Microfacet,
    /// Probability of this term in the mixture.
    pub(crate) share: f32,
}

/// A texel's BRDF for a fixed exitant direction, ready for many incident ones.
pub(crate) struct Shader {
    /// Diffuse reflectance, sr⁻¹.
    pub(crate) rho_d: Rgb,
    /// The lobes that reach the viewer.
    pub(crate) lobes: Vec<Aimed>,
    /// The microfacet terms.
    pub(crate) microfacets: Vec<AimedMicrofacet>,
    /// A BRDF of another form, and its probability in the mixture.
    pub(crate) other: Option<(AshikhminShirley, f32)>,
    /// The exitant direction.
    pub(crate) wo: Vec3,
    /// Probability of the cosine-weighted sampling of the diffuse term.
    pub(crate) diffuse_share: f32,
    /// About the luminance of its albedo, where sampling was prepared.
    pub(crate) albedo: f32,
}

impl Shader {
    /// An empty one, to be aimed.
    pub(crate) fn new() -> Self {
        Self {
            rho_d: Rgb::ZERO,
            lobes: Vec::new(),
            microfacets: Vec::new(),
            other: None,
            wo: Vec3::Z,
            diffuse_share: 1.0,
            albedo: 0.0,
        }
    }

    /// Takes a texel and an exitant direction (in the sample's frame, above the surface); with `sampling`,
    /// prepares [`Self::density`].
    pub(crate) fn aim(&mut self, materials: &Materials, texel: u32, wo: Vec3, sampling: bool) {
        self.aim_lobes(materials.rho_d(texel), materials.lobes_of(texel), wo);
        self.add_coats(materials, texel);
        if sampling {
            self.share();
        }
    }

    /// Takes a texel's microfacet terms alone and an exitant direction, to be evaluated.
    pub(crate) fn aim_coats(&mut self, materials: &Materials, texel: u32, wo: Vec3) {
        self.aim_lobes(Rgb::ZERO, &[], wo);
        self.add_coats(materials, texel);
    }

    fn add_coats(&mut self, materials: &Materials, texel: u32) {
        if let Some(coats) = materials.microfacets.get(&texel) {
            self.microfacets.extend(coats.iter().map(|&coat| AimedMicrofacet { coat, share: 0.0 }));
        }
    }

    /// Takes a diffuse term and lobes and an exitant direction, to be evaluated.
    pub(crate) fn aim_lobes(&mut self, rho_d: Rgb, lobes: &[PackedLobe], wo: Vec3) {
        self.rho_d = rho_d;
        self.wo = wo;
        self.other = None;
        self.microfacets.clear();
        self.lobes.clear();
        for lobe in lobes {
            let [xx, xy, yy, zz, xz, yz] = lobe.c;
            let peak = Vec3::new(
                xx * wo.x + xy * wo.y + xz * wo.z,
                xy * wo.x + yy * wo.y + yz * wo.z,
                xz * wo.x + yz * wo.y + zz * wo.z,
            );
            let rise = 0.5 * (lobe.n - lobe.n_grazing);
            let exponents = [lobe.n_grazing + rise * wo.z, rise];
            let lowest = if rise == 0.0 { lobe.n } else { exponents[0] + rise.min(0.0) };
            let least = if lowest > 0.0 { math::exp2(NEGLIGIBLE_LOG2 / lowest) } else { 0.0 };
            // The base is at most the peak's length.
            if peak.length_squared() > least * least {
                let rho_s = Rgb::from_array(lobe.rho_s);
                let at_peak = exponents[0] + rise * (peak.z / peak.length()).max(0.0);
                let n = if rise == 0.0 { lobe.n } else { at_peak };
                self.lobes.push(Aimed { peak, n, exponents, rho_s, least, share: 0.0, density: 0.0 });
            }
        }
    }

    /// Splits the samples between the diffuse term and the lobes by estimates of their albedos.
    fn share(&mut self) {
        let diffuse = colour::luminance(self.rho_d.max(Rgb::ZERO)) * std::f32::consts::PI;
        let mut total = diffuse;
        for lobe in &mut self.lobes {
            let length = lobe.peak.length();
            let height = math::powf(length, lobe.n);
            let solid_angle = std::f32::consts::TAU / (lobe.n + 1.0);
            lobe.share = colour::luminance(lobe.rho_s.abs())
                * height
                * solid_angle
                * gathered(lobe.peak.z / length, lobe.n);
            if !lobe.share.is_finite() {
                lobe.share = 0.0;
            }
            lobe.density = 1.0 / (solid_angle * height);
            total += lobe.share;
        }
        let grazing = (1.0 - self.wo.z).powi(5);
        for AimedMicrofacet { coat, share } in &mut self.microfacets {
            *share = colour::luminance(coat.f0 + (coat.f90 - coat.f0) * grazing);
            total += *share;
        }
        self.albedo = total;
        // A tenth of the samples at least go over the whole hemisphere, so that no direction is left out.
        let scale = if total > 0.0 { 0.9 / total } else { 0.0 };
        self.diffuse_share = 1.0;
        for lobe in &mut self.lobes {
            lobe.share *= scale;
            lobe.density = if lobe.share > 0.0 { lobe.share * lobe.density } else { 0.0 };
            self.diffuse_share -= lobe.share;
        }
        for coat in &mut self.microfacets {
            coat.share *= scale;
            self.diffuse_share -= coat.share;
        }
    }

    /// Takes a BRDF of another form alone and an exitant direction.
    pub(crate) fn aim_other(&mut self, brdf: &AshikhminShirley, wo: Vec3) {
        self.aim_lobes(Rgb::ZERO, &[], wo);
        let [diffuse, specular] = [brdf.diffuse, brdf.specular].map(colour::luminance);
        let fresnel = specular + (1.0 - specular) * (1.0 - wo.z).powi(5);
        let share = 0.9 * fresnel / (fresnel + diffuse * (1.0 - specular)).max(f32::MIN_POSITIVE);
        (self.other, self.diffuse_share) = (Some((*brdf, share)), 1.0 - share);
    }

    /// Whether nothing is reflected.
    pub(crate) fn is_black(&self) -> bool {
        self.rho_d == Rgb::ZERO
            && self.lobes.is_empty()
            && self.microfacets.is_empty()
            && self.other.is_none()
    }

    /// Whether there is nothing but a diffuse term.
    pub(crate) fn is_diffuse(&self) -> bool {
        self.lobes.is_empty() && self.microfacets.is_empty() && self.other.is_none()
    }

    /// The part of [`Self::eval`] that is the diffuse term's.
    pub(crate) fn eval_diffuse(&self, wi: Vec3) -> Rgb {
        self.rho_d + self.other.map_or(Rgb::ZERO, |(brdf, _)| brdf.diffuse(wi, self.wo))
    }

    /// Reflectance in sr⁻¹ (4.1) for an incident direction of the sample's frame.
    pub(crate) fn eval(&self, wi: Vec3) -> Rgb {
        self.eval_and_density(wi).0
    }

    /// Reflectance in sr⁻¹ (4.1) and the probability density in sr⁻¹ with which the mixture samples `wi`.
    pub(crate) fn eval_and_density(&self, wi: Vec3) -> (Rgb, f32) {
        let mut reflectance = self.rho_d;
        let mut density = self.diffuse_share * wi.z * std::f32::consts::FRAC_1_PI;
        for lobe in &self.lobes {
            let base = lobe.peak.dot(wi);
            if base > lobe.least {
                let power = math::powf(base, lobe.n);
                density += lobe.density * power;
                let [level, rise] = lobe.exponents;
                let value = if rise == 0.0 { power } else { math::powf(base, level + rise * wi.z.max(0.0)) };
                reflectance += lobe.rho_s * value;
            }
        }
        if wi.z > 0.0 {
            for AimedMicrofacet { coat, share } in &self.microfacets {
                reflectance += coat.eval(wi, self.wo);
                density += share * coat.density(wi, self.wo);
            }
            if let Some((brdf, share)) = &self.other {
                reflectance += brdf.eval(wi, self.wo);
                density += share * brdf.density(wi, self.wo);
            }
        }
        (reflectance, density)
    }
}

/// About the mean cosine over a lobe above the horizon, by the cosine of its peak: that of the peak, or of a
/// half lobe at the horizon, and falling as the lobe does where the peak is below.
fn gathered(cosine: f32, n: f32) -> f32 {
    let half = 0.4 / (n + 1.0).sqrt();
    if cosine >= 0.0 {
        cosine.max(half)
    } else {
        half * math::powf((1.0 - cosine * cosine).max(f32::MIN_POSITIVE), 0.5 * n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, showcase};
    use lobelia_reflectance::{Brdf, materials};
    use std::sync::Arc;

    fn directions() -> Vec<Vec3> {
        (0..64)
            .map(|i| {
                let (z, azimuth) = (0.05 + 0.94 * (i % 8) as f32 / 7.0, i as f32 * 0.77);
                let r = (1.0 - z * z).sqrt();
                Vec3::new(r * azimuth.cos(), r * azimuth.sin(), z)
            })
            .collect()
    }

    #[test]
    fn packed_materials_evaluate_as_the_brdf_does() {
        let mut scene = showcase::published(4, 4);
        scene.objects.truncate(1);
        let mut shader = Shader::new();
        for name in materials::NAMES {
            let mut brdf = materials::published(name).unwrap();
            brdf.microfacets = vec![Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha: 0.3 }];
            brdf.lobes.iter_mut().for_each(|lobe| lobe.c.x *= 0.9);
            let mut brdf = brdf.rotated(0.4);
            if name == "clay" {
                brdf.normal = Vec2::new(-0.1, 0.15);
                brdf.lobes[0].n_grazing = Some(2.0 * brdf.lobes[0].n);
            }
            scene.objects[0].material = Material::uniform(brdf.clone());
            let packed = Materials::new(&scene);
            for wo in directions() {
                shader.aim(&packed, 0, wo, true);
                for wi in directions() {
                    let (expected, got) = (brdf.eval(wi, wo), shader.eval(wi));
                    let error = (expected - got).abs().max_element();
                    assert!(
                        error <= 1e-4 * expected.max_element() + 1e-6,
                        "{name} {wi} {wo} {expected} {got}"
                    );
                }
            }
        }
    }

    #[test]
    fn neighbours_blend_and_choices_have_their_weights_as_probability() {
        let brdfs: Vec<_> = (0..6).map(|i| LobeBrdf::diffuse(Rgb::splat(i as f32))).collect();
        let map = lobelia_reflectance::SbrdfMap::from_texels(3, 2, &brdfs);
        let mut scene = showcase::published(4, 4);
        scene.objects.truncate(1);
        scene.objects[0].material = Material::map(Arc::new(map), Vec2::new(2.0, 1.0));
        let packed = Materials::new(&scene);
        // The centre of texel (1, 0) in the second repeat.
        let centre = Vec2::new(0.5 + 0.25, 0.25);
        assert_eq!(packed.choose(0, centre, [0.5; 2]), 1);
        let uv = Vec2::new(0.93, 0.95);
        let weights = packed.neighbours(0, uv);
        assert!((weights.iter().map(|w| w.1).sum::<f32>() - 1.0).abs() < 1e-6);
        let mut counts = [0.0; 6];
        for i in 0..100 {
            for j in 0..100 {
                let chosen = packed.choose(0, uv, [(i as f32 + 0.5) / 100.0, (j as f32 + 0.5) / 100.0]);
                counts[chosen as usize] += 1e-4;
            }
        }
        for (texel, weight) in weights {
            assert!((counts[texel as usize] - weight).abs() < 0.02, "{texel} {weight} {counts:?}");
        }
    }
}
