//! The material of an object in a scene file.
//!
//! ```toml
//! [object.material]
//! # with its channels mirror.*, a mirror, where its attribute mirror.solid_angle_sr is known
//! map = "weave.exr"
//! mirror = [0.04, 0.04, 0.04]             # a perfect mirror over it, or alone: ρ_m of L_r = ρ_m L_i
//! # radiance of the front; times emission_map = "glow.exr" where that is given
//! emission = [4.0, 3.6, 3.0]
//!
//! # Instead of a map, published, weave, check, or albedo or rho_d and lobes:
//! # reflectances without unit; one lobe
//! phong = { rho_d = [0.4, 0.1, 0.1], rho_s = [0.3, 0.3, 0.3], n = 50 }
//! # along the tangent and across
//! ashikhmin = { rho_d = [0.5, 0.5, 0.5], rho_s = [0.75, 0.75, 0.75], n = [10, 100] }
//! conductor = { n = [0.143, 0.375, 1.442], k = [3.983, 2.386, 1.603] }           # gold
//! # the last two may be left out
//! dielectric = { index = 1.5, absorption = [0.3, 0.05, 0.1], priority = 1 }
//! ```

use std::f32::consts::{FRAC_1_PI, TAU};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{Vec2, Vec3};
use serde::Deserialize;

use super::file::either;
use super::optics::{Dielectric, Optics, Texture};
use super::{Filter, Mask, Material, Reflectance, showcase};
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::mip;
use lobelia_reflectance::{AshikhminShirley, Lobe, LobeBrdf, Rgb, SbrdfMap, materials};

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct MaterialFile {
    map: Option<String>,
    published: Option<String>,
    weave: Option<[String; 2]>,
    check: Option<[String; 2]>,
    albedo: Option<Rgb>,
    rho_d: Option<Rgb>,
    #[serde(default)]
    beta_deg: f32,
    #[serde(default)]
    lobes: Vec<LobeFile>,
    phong: Option<PhongFile>,
    ashikhmin: Option<AshikhminFile>,
    conductor: Option<ConductorFile>,
    dielectric: Option<DielectricFile>,
    mirror: Option<Rgb>,
    emission: Option<Rgb>,
    emission_map: Option<String>,
    tiling: Option<Vec2>,
    filter: Option<Filter>,
    mask: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LobeFile {
    rho_s: Rgb,
    c: Vec3,
    n: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PhongFile {
    rho_d: Rgb,
    rho_s: Rgb,
    n: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AshikhminFile {
    rho_d: Rgb,
    rho_s: Rgb,
    n: [f32; 2],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ConductorFile {
    n: Rgb,
    k: Rgb,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DielectricFile {
    index: f32,
    #[serde(default)]
    absorption: Rgb,
    #[serde(default)]
    priority: i32,
}

/// The MIP levels that lie beside a map, which must be its own: those of an earlier map of that name would
/// show from afar alone.
fn levels_of(
    finest: &Path,
    map: &SbrdfMap,
    levels: Vec<(PathBuf, Arc<SbrdfMap>)>,
) -> Result<Vec<Arc<SbrdfMap>>> {
    let known = || levels.iter().filter_map(|(file, level)| Some((file, level.attributes.get(mip::OF)?)));
    let of = known().next().map(|_| mip::fingerprint(map));
    if let Some((file, _)) = known().find(|(_, whose)| Some(*whose) != of.as_ref()) {
        return Err(Error::input(format!(
            "key map: {}: a MIP level of another map than {}; fit again with --mip, or remove the levels",
            file.display(),
            finest.display()
        )));
    }
    Ok(levels.into_iter().map(|(_, level)| level).collect())
}

impl MaterialFile {
    /// The material: of one kind at most, and of none where it is a mirror or shines.
    ///
    /// # Errors
    /// Input errors that name the key.
    pub(super) fn read(&self, folder: &Path) -> Result<Material> {
        let inline = self.albedo.is_some() || self.rho_d.is_some() || !self.lobes.is_empty();
        let whole = self.ashikhmin.is_some() || self.conductor.is_some() || self.dielectric.is_some();
        let named = [
            self.map.is_some(),
            self.published.is_some(),
            self.weave.is_some(),
            self.check.is_some(),
            inline,
            self.phong.is_some(),
            self.ashikhmin.is_some(),
            self.conductor.is_some(),
            self.dielectric.is_some(),
        ];
        let alone = self.mirror.is_some() || self.emission.is_some() || self.emission_map.is_some();
        match named.iter().filter(|&&named| named).count() {
            1 if self.albedo.is_none() || self.rho_d.is_none() => {}
            0 if alone => {}
            _ => {
                return Err(Error::input(
                    "name exactly one of map, published, weave, check, phong, ashikhmin, conductor, \
                     dielectric, or coefficients (albedo or rho_d, beta_deg, lobes); mirror and emission may \
                     stand alone",
                ));
            }
        }
        if whole && self.mirror.is_some() {
            return Err(Error::input(
                "key mirror: it goes over lobes, not with ashikhmin, conductor or dielectric",
            ));
        }
        let (reflectance, levels) = self.reflectance(folder)?;
        let tiling = self.tiling.unwrap_or(Vec2::ONE);
        let measured = match &reflectance {
            Reflectance::Map(map) => Material::measured_mirror(map),
            Reflectance::Uniform(_) => None,
        };
        let mut material = Material::new(reflectance, tiling, self.filter.unwrap_or_default());
        material.levels = levels;
        material.optics = self.optics().or(measured);
        material.emission = self.emission(folder)?;
        if let Some(file) = &self.mask {
            let mask = Mask::read(&folder.join(file)).map_err(|error| error.at("key mask"))?;
            material.mask = Some(Arc::new(mask));
        }
        Ok(material)
    }

    /// What is of lobes, black where nothing is, and the MIP levels of a map.
    fn reflectance(&self, folder: &Path) -> Result<(Reflectance, Vec<Arc<SbrdfMap>>)> {
        let mut levels = vec![];
        let reflectance = if let Some(file) = &self.map {
            let path = folder.join(file);
            let read = |path: &Path| {
                SbrdfMap::read_exr(path).map(Arc::new).map_err(|error| Error::format(error).at("key map"))
            };
            let map = read(&path)?;
            let files = (1..=mip::last([map.width, map.height])).map(|level| mip::path(&path, level));
            levels = files
                .take_while(|file| file.exists())
                .map(|file| read(&file).map(|level| (file, level)))
                .collect::<Result<Vec<_>>>()
                .and_then(|levels| levels_of(&path, &map, levels))?;
            Reflectance::Map(map)
        } else if let Some(name) = &self.published {
            Reflectance::Uniform(published(name)?)
        } else if let Some([warp, weft]) = &self.weave {
            Reflectance::Map(Arc::new(showcase::weave(&published(warp)?, &published(weft)?, 16)))
        } else if let Some([first, second]) = &self.check {
            Reflectance::Map(Arc::new(showcase::check(&published(first)?, &published(second)?, 2, 32)))
        } else if let Some(PhongFile { rho_d, rho_s, n }) = &self.phong {
            let lobe = Lobe::new(*rho_s * ((n + 2.0) / TAU), Vec3::new(-1.0, -1.0, 1.0), *n);
            Reflectance::Uniform(LobeBrdf {
                rho_d: *rho_d * FRAC_1_PI,
                lobes: vec![lobe],
                ..LobeBrdf::default()
            })
        } else {
            let mut brdf = LobeBrdf::diffuse(self.albedo.unwrap_or(Rgb::ZERO));
            brdf.rho_d = self.rho_d.unwrap_or(brdf.rho_d);
            brdf.lobes = self.lobes.iter().map(|lobe| Lobe::new(lobe.rho_s, lobe.c, lobe.n)).collect();
            Reflectance::Uniform(brdf)
        };
        let reflectance = match reflectance {
            Reflectance::Uniform(brdf) => Reflectance::Uniform(brdf.rotated(self.beta_deg.to_radians())),
            Reflectance::Map(_) if self.beta_deg != 0.0 => {
                return Err(Error::input("key beta_deg: a map has its own direction of anisotropy"));
            }
            map => map,
        };
        Ok((reflectance, levels))
    }

    /// What is not of lobes.
    fn optics(&self) -> Option<Optics> {
        if let Some(AshikhminFile { rho_d, rho_s, n }) = &self.ashikhmin {
            return Some(Optics::AshikhminShirley(AshikhminShirley {
                diffuse: *rho_d,
                specular: *rho_s,
                exponents: Vec2::from_array(*n),
                axis: Vec2::from_angle(self.beta_deg.to_radians()),
            }));
        }
        if let Some(&ConductorFile { n, k }) = self.conductor.as_ref() {
            return Some(Optics::Conductor { n, k });
        }
        if let Some(&DielectricFile { index, absorption, priority }) = self.dielectric.as_ref() {
            return Some(Optics::Dielectric(Dielectric { index, absorption, priority }));
        }
        self.mirror.map(|mirror| Optics::Mirror(Texture::Uniform(mirror)))
    }

    /// Radiance of its own.
    fn emission(&self, folder: &Path) -> Result<Option<Texture>> {
        let factor = self.emission.unwrap_or(Rgb::ONE);
        match &self.emission_map {
            Some(file) => {
                let texture = Texture::read(&folder.join(file), factor);
                texture.map(Some).map_err(|error| error.at("key emission_map"))
            }
            None => Ok(self.emission.map(Texture::Uniform)),
        }
    }
}

/// A published material by name.
fn published(name: &str) -> Result<LobeBrdf> {
    materials::published(name).ok_or_else(|| {
        Error::input(format!("there is no material \"{name}\"; use one of {}", either(&materials::NAMES)))
    })
}

#[cfg(test)]
mod tests {
    use super::super::Scene;
    use super::*;

    fn read(material: &str) -> Result<Scene> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.toml");
        let text = format!(
            "[camera]\nposition = [0, 0, 4]\ntarget = [0, 0, 0]\nfov_deg = 40\nwidth = 8\nheight = 6\n\
             [[object]]\nname = \"thing\"\nmesh = \"sphere\"\n[object.material]\n{material}\n"
        );
        std::fs::write(&path, text).unwrap();
        Scene::read(&path)
    }

    #[test]
    fn every_kind_of_material_is_read() {
        let material = |text: &str| read(text).unwrap().objects.remove(0).material;
        let glass = Dielectric { index: 1.5, absorption: Rgb::new(0.1, 0.2, 0.3), priority: 2 };
        assert_eq!(
            material("dielectric = { index = 1.5, absorption = [0.1, 0.2, 0.3], priority = 2 }").optics,
            Some(Optics::Dielectric(glass))
        );
        let clear = Dielectric { index: 1.33, absorption: Rgb::ZERO, priority: 0 };
        assert_eq!(material("dielectric = { index = 1.33 }").optics, Some(Optics::Dielectric(clear)));
        let (n, k) = (Rgb::new(0.1, 0.4, 1.4), Rgb::new(4.0, 2.4, 1.6));
        assert_eq!(
            material("conductor = { n = [0.1, 0.4, 1.4], k = [4, 2.4, 1.6] }").optics,
            Some(Optics::Conductor { n, k })
        );
        let mirror = Some(Optics::Mirror(Texture::Uniform(Rgb::splat(0.5))));
        assert_eq!(material("mirror = [0.5, 0.5, 0.5]").optics, mirror);
        let over = material("mirror = [0.5, 0.5, 0.5]\nalbedo = [0.3, 0.3, 0.3]");
        assert!(
            over.optics == mirror
                && matches!(over.reflectance, Reflectance::Uniform(brdf) if brdf.rho_d.x > 0.0)
        );
        let brushed = "ashikhmin = { rho_d = [0, 0, 0], rho_s = [1, 1, 1], n = [10, 100] }\nbeta_deg = 90";
        let Some(Optics::AshikhminShirley(brdf)) = material(brushed).optics else { panic!("{brushed}") };
        assert!(brdf.exponents == Vec2::new(10.0, 100.0) && (brdf.axis - Vec2::Y).length() < 1e-6);
        let lamp = material("emission = [3, 2, 1]");
        assert_eq!(lamp.emission, Some(Texture::Uniform(Rgb::new(3.0, 2.0, 1.0))));
    }

    #[test]
    fn a_mirror_measured_with_a_map_is_drawn_where_the_lamps_solid_angle_is_known() {
        let folder = tempfile::tempdir().unwrap();
        let mut map = SbrdfMap::new(2, 1, 1);
        for (name, values) in
            [("mirror.R", [500.0, 0.0]), ("mirror.G", [400.0, 0.0]), ("mirror.B", [300.0, 0.0])]
        {
            map.extra.insert(name.into(), values.to_vec());
        }
        let optics = |map: &SbrdfMap| {
            map.write_exr(&folder.path().join("m.exr")).unwrap();
            let scene = "[camera]\nposition = [0, 0, 4]\ntarget = [0, 0, 0]\nfov_deg = 40\nwidth = 8\nheight \
                 = 6\n[[object]]\nmesh = \"sphere\"\nmaterial.map = \"m.exr\"\n";
            std::fs::write(folder.path().join("s.toml"), scene).unwrap();
            Scene::read(&folder.path().join("s.toml")).unwrap().objects.remove(0).material.optics
        };
        assert_eq!(optics(&map), None);
        map.attributes.insert(lobelia_reflectance::MIRROR_SOLID_ANGLE.into(), "1e-3".into());
        let Some(Optics::Mirror(texture)) = optics(&map) else { panic!("a mirror") };
        assert!((texture.at(Vec2::new(0.25, 0.5)) - Rgb::new(0.5, 0.4, 0.3)).length() < 1e-6);
        assert_eq!(texture.at(Vec2::new(0.75, 0.5)), Rgb::ZERO);
    }

    /// Phong's lobe toward the mirror direction has the albedo ρ_s at normal incidence.
    #[test]
    fn phong_is_a_lobe_of_the_albedo_given() {
        let scene = read("phong = { rho_d = [0, 0, 0], rho_s = [0.4, 0.4, 0.4], n = 50 }").unwrap();
        assert_eq!(scene.beyond_lobes(), None);
        let Reflectance::Uniform(brdf) = &scene.objects[0].material.reflectance else { panic!("a lobe") };
        let rows = 20_000;
        let at = |k: i32| (k as f32 + 0.5) / rows as f32;
        let value = |z: f32| {
            lobelia_reflectance::Brdf::eval(brdf, Vec3::new((1.0 - z * z).sqrt(), 0.0, z), Vec3::Z).x
        };
        let albedo: f32 = (0..rows).map(|k| TAU * value(at(k)) * at(k) / rows as f32).sum();
        assert!((albedo - 0.4).abs() < 1e-3, "{albedo}");
    }

    #[test]
    fn wrong_materials_are_refused_with_the_object_and_the_key() {
        for (text, words) in [
            ("dielectric = { index = 1.5, colour = [1, 1, 1] }", vec!["line 11", "colour"]),
            ("dielectric = { index = 0 }", vec!["thing", "index must be between"]),
            ("dielectric = { index = 1.5 }\nmirror = [1, 1, 1]", vec!["thing", "key mirror"]),
            ("mirror = [1.5, 1, 1]", vec!["thing", "mirror"]),
            ("conductor = { n = [0, 1, 1], k = [1, 1, 1] }", vec!["thing", "n must be positive"]),
            ("emission = [-1, 1, 1]", vec!["thing", "emission"]),
            ("emission_map = \"none.exr\"", vec!["thing", "key emission_map", "none.exr"]),
            (
                "published = \"clay\"\nconductor = { n = [1, 1, 1], k = [1, 1, 1] }",
                vec!["thing", "exactly one"],
            ),
            (
                "ashikhmin = { rho_d = [2, 0, 0], rho_s = [0, 0, 0], n = [1, 1] }",
                vec!["thing", "between 0 and 1"],
            ),
        ] {
            let error = read(text).unwrap_err();
            let sentence = error.to_string();
            assert!(error.exit_code() == 2 && words.iter().all(|word| sentence.contains(word)), "{sentence}");
        }
    }

    #[test]
    fn what_other_methods_cannot_draw_is_refused_with_the_objects_name() {
        for (text, what) in [
            ("mirror = [1, 1, 1]", "a mirror"),
            ("dielectric = { index = 1.5 }", "a dielectric"),
            ("conductor = { n = [1, 1, 1], k = [1, 1, 1] }", "a conductor"),
            ("ashikhmin = { rho_d = [0, 0, 0], rho_s = [1, 1, 1], n = [10, 100] }", "Ashikhmin"),
            ("emission = [1, 1, 1]", "shines"),
        ] {
            let scene = read(text).unwrap();
            use crate::render::{REFERENCE, Renderer, Settings, environment, lights, prepare};
            let refused = [
                ("lights", lights::Settings::default().prepare(&scene).err()),
                ("environment", environment::Settings::default().prepare(&scene).err()),
            ];
            for (method, error) in refused {
                let sentence = error.unwrap().to_string();
                assert!([method, "thing", what].iter().all(|word| sentence.contains(word)), "{sentence}");
            }
            let chosen = prepare(&scene, None, &Settings::default(), None).unwrap();
            assert!(chosen.method == REFERENCE && chosen.note.unwrap().contains("thing"));
        }
    }
}
