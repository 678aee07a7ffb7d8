//! Hashes of what a scene is made of, by which stored work is known to be of it.

use super::{Environment, Light, Optics, Reflectance, Scene, Texture};
use lobelia_base::hash::{Hasher, sha256};
use lobelia_reflectance::mip;

/// Pixels of an environment, whatever its turn.
pub fn environment(environment: &Environment) -> String {
    let mut hash = Hasher::default();
    for side in [environment.width, environment.height] {
        hash.update(&(side as u64).to_le_bytes());
    }
    hash.update(bytemuck::cast_slice(&environment.pixels));
    hash.finish()
}

/// Meshes and where they stand.
pub fn meshes(scene: &Scene) -> String {
    let mut hash = Hasher::default();
    for object in &scene.objects {
        hash.update(&(object.mesh.vertices.len() as u64).to_le_bytes());
        hash.update(bytemuck::cast_slice(&object.mesh.vertices));
        hash.update(bytemuck::cast_slice(&object.mesh.triangles));
        object.transform.to_cols_array().iter().for_each(|value| hash.update(&value.to_le_bytes()));
    }
    hash.finish()
}

/// Reflectances, with their maps, levels and masks.
pub fn materials(scene: &Scene) -> String {
    let mut hash = Hasher::default();
    for material in scene.objects.iter().map(|object| &object.material) {
        match &material.reflectance {
            Reflectance::Uniform(brdf) => hash.update(format!("{brdf:?}").as_bytes()),
            Reflectance::Map(map) => hash.update(mip::fingerprint(map).as_bytes()),
        }
        material.levels.iter().for_each(|level| hash.update(mip::fingerprint(level).as_bytes()));
        hash.update(format!("{:?} {:?}", material.tiling, material.filter).as_bytes());
        match &material.optics {
            Some(Optics::Mirror(texture)) => add_texture(&mut hash, "mirror", texture),
            // A few numbers.
            optics => hash.update(format!("{optics:?}").as_bytes()),
        }
        if let Some(emission) = &material.emission {
            add_texture(&mut hash, "emission", emission);
        }
        if let Some(mask) = &material.mask {
            hash.update(format!("{} {}", mask.width, mask.height).as_bytes());
            hash.update(bytemuck::cast_slice(&mask.bits));
        }
    }
    hash.finish()
}

/// What is cut out of objects, with the repeats of its texture.
pub fn masks(scene: &Scene) -> String {
    let mut hash = Hasher::default();
    for material in scene.objects.iter().map(|object| &object.material) {
        let Some(mask) = &material.mask else {
            hash.update(b"none");
            continue;
        };
        hash.update(format!("{} {} {:?}", mask.width, mask.height, material.tiling).as_bytes());
        hash.update(bytemuck::cast_slice(&mask.bits));
    }
    hash.finish()
}

fn add_texture(hash: &mut Hasher, name: &str, texture: &Texture) {
    let size = match texture {
        Texture::Uniform(_) => [0, 0],
        Texture::Texels(width, height, _) => [*width, *height],
    };
    hash.update(format!("{name} {size:?}").as_bytes());
    hash.update(bytemuck::cast_slice(texture.colours()));
}

/// Lights as they stand.
pub fn lights(lights: &[Light]) -> String {
    sha256(format!("{lights:?}").as_bytes())
}

/// Parameters, and what they do.
pub fn parameters(scene: &Scene) -> String {
    sha256(format!("{:?}", scene.parameters).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Placement, showcase};
    use lobelia_reflectance::Rgb;

    #[test]
    fn each_hash_tells_what_it_is_of_and_nothing_else() {
        let scene = showcase::published(8, 6);
        let all = |scene: &Scene| {
            let sky = environment(scene.environment.as_ref().unwrap());
            [sky, meshes(scene), materials(scene), lights(&scene.lights)]
        };
        let same = |other: &Scene| -> Vec<bool> {
            all(&scene).iter().zip(all(other)).map(|(a, b)| *a == b).collect()
        };
        let mut other = scene.clone();
        other.camera.width = 9;
        other.environment = other.environment.map(|environment| environment.rotated(1.0));
        assert_eq!(same(&other), [true; 4]);
        other.environment = Some(Environment::sky());
        assert_eq!(same(&other), [false, true, true, true]);
        other = scene.clone();
        let placed = Placement { shift: glam::Vec3::X, ..Placement::default() };
        other.objects[0].transform = placed.of_transform(&other.objects[0].transform);
        assert_eq!(same(&other), [true, false, true, true]);
        other = scene.clone();
        other.objects[0].material.tiling.x *= 2.0;
        assert_eq!(same(&other), [true, true, false, true]);
        let texture = |texel: f32| Texture::Texels(1, 2, [texel, 1.0].map(Rgb::splat).into());
        let lit = |emission: Option<Texture>, optics: Option<Optics>| {
            let mut other = scene.clone();
            (other.objects[0].material.emission, other.objects[0].material.optics) = (emission, optics);
            materials(&other)
        };
        let all = [
            lit(None, None),
            lit(Some(texture(0.5)), None),
            lit(Some(texture(0.25)), None),
            lit(None, Some(Optics::Mirror(texture(0.5)))),
            lit(None, Some(Optics::Conductor { n: Rgb::ONE, k: Rgb::ONE })),
            lit(None, Some(Optics::Conductor { n: Rgb::ONE, k: Rgb::ZERO })),
        ];
        assert!((1..all.len()).all(|k| !all[..k].contains(&all[k])), "{all:?}");
        other = scene.clone();
        other.lights.pop();
        assert_eq!(same(&other), [true, true, true, false]);
    }
}
