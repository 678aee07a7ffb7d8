//! Scene files: TOML that names meshes, materials, lights, the environment and the camera. Paths are relative
//! to the file.
//!
//! ```toml
//! exposure = 1.0
//! background = "environment"            # or "#202428", black when left out
//!
//! [camera]
//! position = [0.0, 1.2, 4.0]
//! target = [0.0, 0.6, 0.0]
//! fov_deg = 35.0
//! width = 640
//! height = 480
//!
//! [environment]
//! builtin = "studio"                    # or "sky", or file = "lobby.exr"
//!
//! [[object]]
//! # sphere, plane, backdrop, drape, swarm, or a .gltf, .glb, .obj, .ply or .bpt (Bézier patches) file
//! mesh = "drape"
//! # or a shape to a tolerance, how far triangles may be from it in units of the scene (1/2000 of its
//! # longest side when left out):
//! # shape.sphere = { radius = 1.0, tolerance = 0.001 }
//! # shape.torus = { radius = 1.0, tube = 0.3 }
//! # shape.cylinder = { radius = 1.0, height = 2.0, lids = true }
//! # shape.box = { size = [1.0, 1.0, 1.0] }
//! # shape.lathe = { profile = [[0.0, 1.0], [1.0, 0.0]], smooth = false }  # radius, height; smooth:
//! # cubic Bézier pieces
//! # shape.height_field = { file = "dunes.png", size = [4.0, 4.0], height = 0.5 }  # or heights =
//! # [[0.0, 0.1], [0.2, 0.0]]
//! # shape.teapot = { bottom = true }
//! # shape.bezier = { file = "patches.bpt" }
//! [object.material]
//! map = "weave.exr"                     # or published = "clay", or weave or check = ["clay", "felt"],
//! # or albedo, rho_d, beta_deg and lobes; weave.mip1.exr and so on are its MIP levels
//! tiling = [4.0, 4.0]
//! # a perfect mirror, over those or alone; other materials: [`super::material_file`]
//! mirror = [0.1, 0.1, 0.1]
//! # radiance of the front; emission_map = "glow.exr" is a texture of it
//! emission = [2.0, 2.0, 2.0]
//! # cut out where alpha, or brightness, is below 0.5; a map may have a channel alpha instead
//! mask = "leaf.png"
//!
//! [[light]]
//! # or "point": position, intensity; or "rectangle": centre, edges, radiance
//! kind = "directional"
//! toward = [0.3, 1.0, 0.5]
//! irradiance = [2.0, 2.0, 2.0]
//!
//! [[parameter]]                         # what has a name to be varied by
//! name = "hour"
//! # from where it does nothing to where it does all of this, in proportion
//! range = [8.0, 20.0]
//! value = 12.0                          # where it stands; the first of range when left out
//! environment_turn_deg = 90.0
//! light.lamp = { dim = 0.2 }            # as in a key of the animation
//!
//! [animation]                           # lobelia render scene.toml -o frame-###.png
//! frames = 48
//! closed = true                         # goes on from the last key to the first
//! [[animation.key]]                     # what is left out is as in the scene
//! position = [0.0, 1.2, 4.0]
//! target = [0.0, 0.6, 0.0]
//! environment_turn_deg = 30.0           # about +y, beyond rotation_deg
//! # by the light's name, or its number from 0
//! light.lamp = { move = [1.0, 0.0, 0.0], turn_deg = [0.0, 90.0, 0.0], dim = 0.5 }
//! object.ball = { move = [0.0, 0.5, 0.0] }
//! parameter.hour = 18.0
//! ```

use std::path::Path;
use std::sync::Arc;

use glam::{Affine3A, DVec3, EulerRot, Quat, Vec3};
use serde::Deserialize;

use super::material_file::MaterialFile;
use super::shape_file::ShapeFile;
use super::varied_file::{AnimationFile, KeyFile, Names, ParameterFile};
use super::{Animation, Background, Camera, Environment, Light, Mesh, Object, Scene, shapes, shipped};
use lobelia_base::error::{Error, Result};
use lobelia_base::{files, toml_file};
use lobelia_reflectance::{Rgb, colour};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneFile {
    #[serde(default = "one")]
    exposure: f32,
    background: Option<String>,
    camera: CameraFile,
    environment: Option<EnvironmentFile>,
    #[serde(default)]
    object: Vec<ObjectFile>,
    #[serde(default)]
    light: Vec<LightFile>,
    animation: Option<AnimationFile>,
    #[serde(default)]
    parameter: Vec<ParameterFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFile {
    position: DVec3,
    target: DVec3,
    #[serde(default = "up")]
    up: Vec3,
    fov_deg: f32,
    width: u32,
    height: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EnvironmentFile {
    file: Option<String>,
    builtin: Option<String>,
    #[serde(default)]
    rotation_deg: f32,
    #[serde(default = "one")]
    scale: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ObjectFile {
    name: Option<String>,
    mesh: Option<String>,
    shape: Option<ShapeFile>,
    #[serde(default)]
    translate: DVec3,
    /// Turns about x, then y, then z.
    #[serde(default)]
    rotate_deg: Vec3,
    #[serde(default = "ones")]
    scale: Vec3,
    #[serde(default)]
    material: MaterialFile,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LightFile {
    name: Option<String>,
    kind: String,
    toward: Option<Vec3>,
    irradiance: Option<Rgb>,
    position: Option<DVec3>,
    intensity: Option<Rgb>,
    centre: Option<DVec3>,
    edges: Option<[Vec3; 2]>,
    radiance: Option<Rgb>,
}

pub(super) fn one() -> f32 {
    1.0
}

fn ones() -> Vec3 {
    Vec3::ONE
}

fn up() -> Vec3 {
    Vec3::Y
}

/// Names as a list in a sentence.
pub(super) fn either(names: &[&str]) -> String {
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ")
}

impl Scene {
    /// Reads a scene file and everything that it names.
    ///
    /// # Errors
    /// Input errors that name the file and the line or the key.
    pub fn read(path: &Path) -> Result<Self> {
        if let Some(what) = files::what_is(path) {
            return Err(Error::input(format!(
                "{}: {what}, not a scene; a scene is a .toml file that names it (lobelia template scene \
                 prints one)",
                path.display()
            )));
        }
        let file: SceneFile = toml_file::read_as(path, toml_file::Kind::Scene)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        build(file, folder).map_err(|error| error.at(path.display()))
    }

    /// Reads a scene file, or a scene of [`shipped`] by its name.
    ///
    /// # Errors
    /// As [`Self::read`]; a name that is neither is refused with the list of names.
    pub fn open(name: &Path) -> Result<Self> {
        if name.extension().is_some() || name.exists() {
            return Self::read(name);
        }
        let text = name.to_str().unwrap_or_default();
        let file = shipped::find(text).ok_or_else(|| {
            Error::input(format!(
                "there is no scene \"{}\"; name a .toml file or one of {}",
                name.display(),
                either(&shipped::SCENES.map(|scene| scene.0))
            ))
        })?;
        build(toml_file::parse(file, text)?, Path::new("")).map_err(|error| error.at(text))
    }
}

/// Turns the parsed file into a checked scene.
fn build(file: SceneFile, folder: &Path) -> Result<Scene> {
    let CameraFile { position, target, up, fov_deg, width, height } = file.camera;
    let origin = origin(position, target);
    let local = |point: DVec3| (point - origin).as_vec3();
    let mut objects = Vec::with_capacity(file.object.len());
    for (index, object) in file.object.iter().enumerate() {
        let kind = object.mesh.as_deref().or(object.shape.as_ref().map(ShapeFile::name));
        let kind = kind.unwrap_or("object");
        let name = object.name.clone().unwrap_or_else(|| format!("{kind} {index}"));
        let place = format!("object \"{name}\"");
        let (mesh, middle) = geometry(object, folder).map_err(|error| error.at(&place))?;
        let material = object.material.read(folder).map_err(|error| error.at("key material").at(&place))?;
        let [x, y, z] = object.rotate_deg.to_array().map(f32::to_radians);
        let rotation = Quat::from_euler(EulerRot::ZYX, z, y, x);
        // Where the mesh's own origin comes to stand, in double precision.
        let middle = rotation.as_dquat() * (object.scale.as_dvec3() * middle);
        let translate = local(object.translate + middle);
        let transform = Affine3A::from_scale_rotation_translation(object.scale, rotation, translate);
        objects.push(Object { name, mesh: Arc::new(mesh), transform, material });
    }
    let mut lights = Vec::with_capacity(file.light.len());
    for (index, entry) in file.light.iter().enumerate() {
        lights.push(light(entry, &local).map_err(|error| error.at(format!("light {index}")))?);
    }
    let (position, target) = (local(position), local(target));
    let camera = Camera { position, target, up, fov: fov_deg.to_radians(), width, height };
    let names = Names {
        lights: file.light.iter().map(|light| light.name.clone()).collect(),
        objects: file.object.iter().map(|object| object.name.clone()).collect(),
    };
    let environment = file.environment.map(|entry| environment(&entry, folder)).transpose();
    let mut scene = Scene {
        objects,
        lights,
        environment: environment.map_err(|error| error.at("environment"))?,
        background: background(file.background.as_deref())?,
        camera,
        animation: None,
        parameters: file.parameter.iter().map(|entry| names.parameter(entry)).collect::<Result<_>>()?,
        exposure: file.exposure,
    };
    if let Some(path) = file.animation {
        let key = |(index, key): (usize, &KeyFile)| {
            names.state(key, &scene, &local).map_err(|error| error.at(format!("animation: key {index}")))
        };
        let keys = path.key.iter().enumerate().map(key).collect::<Result<_>>()?;
        scene.animation = Some(Animation { frames: path.frames, closed: path.closed, keys });
    }
    scene.check()?;
    Ok(scene)
}

/// What the scene's coordinates are made relative to: the camera's target where it lies so far from 0 that
/// single precision would blur what the camera sees, else 0.
fn origin(position: DVec3, target: DVec3) -> DVec3 {
    /// Distance from 0, in distances from camera to target, up to which coordinates stay.
    const FAR: f64 = 64.0;
    if target.length() > FAR * position.distance(target) { target } else { DVec3::ZERO }
}

/// The triangles of an object, and what their positions are relative to.
fn geometry(object: &ObjectFile, folder: &Path) -> Result<(Mesh, DVec3)> {
    match (&object.mesh, &object.shape) {
        (Some(name), None) => mesh(name, folder).map_err(|error| error.at("key mesh")),
        (None, Some(shape)) => {
            shape.mesh(folder, object.scale).map_err(|error| error.at(format!("key shape.{}", shape.name())))
        }
        _ => Err(Error::input("name exactly one of mesh and shape")),
    }
}

/// A procedural shape by name, or a file; and what its positions are relative to.
fn mesh(name: &str, folder: &Path) -> Result<(Mesh, DVec3)> {
    let shape = |mesh| Ok((mesh, DVec3::ZERO));
    match name {
        "sphere" => shape(shapes::sphere(192, 96)),
        "plane" => shape(shapes::plane(16)),
        "backdrop" => shape(shapes::backdrop(64)),
        "drape" => shape(shapes::drape(224)),
        "swarm" => shape(shapes::swarm(50)),
        file if Path::new(file).extension().is_some() => Mesh::read(&folder.join(file)),
        other => Err(Error::input(format!(
            "there is no shape \"{other}\"; use one of {} or a .gltf, .glb, .obj, .ply or .bpt file",
            either(&["sphere", "plane", "backdrop", "drape", "swarm"])
        ))),
    }
}

/// A light of a known kind with the keys of that kind and no others.
fn light(entry: &LightFile, local: &impl Fn(DVec3) -> Vec3) -> Result<Light> {
    let wrong = |needs: &str| Error::input(format!("a {} light has the keys {needs}, no others", entry.kind));
    let vectors = (entry.toward, entry.position, entry.centre, entry.edges);
    let powers = (entry.irradiance, entry.intensity, entry.radiance);
    match (entry.kind.as_str(), vectors, powers) {
        ("directional", (Some(toward), None, None, None), (Some(irradiance), None, None)) => {
            let toward = toward
                .try_normalize()
                .ok_or_else(|| Error::input("key toward: the direction has no length"))?;
            Ok(Light::Directional { toward, irradiance })
        }
        ("point", (None, Some(position), None, None), (None, Some(intensity), None)) => {
            Ok(Light::Point { position: local(position), intensity })
        }
        ("rectangle", (None, None, Some(centre), Some(edges)), (None, None, Some(radiance))) => {
            Ok(Light::Rectangle { centre: local(centre), edges, radiance })
        }
        ("directional", ..) => Err(wrong("toward and irradiance")),
        ("point", ..) => Err(wrong("position and intensity")),
        ("rectangle", ..) => Err(wrong("centre, edges and radiance")),
        (other, ..) => Err(Error::input(format!(
            "key kind: there is no light \"{other}\"; use one of {}",
            either(&["directional", "point", "rectangle"])
        ))),
    }
}

/// A computed environment or a file.
fn environment(entry: &EnvironmentFile, folder: &Path) -> Result<Environment> {
    let environment = match (&entry.file, entry.builtin.as_deref()) {
        (Some(file), None) => Environment::read(&folder.join(file)).map_err(|error| error.at("key file"))?,
        (None, Some("studio")) => Environment::studio(),
        (None, Some("sky")) => Environment::sky(),
        (None, Some(other)) => {
            return Err(Error::input(format!(
                "key builtin: there is no environment \"{other}\"; use one of {}",
                either(&["studio", "sky"])
            )));
        }
        _ => return Err(Error::input("name exactly one of file and builtin")),
    };
    if !(entry.scale.is_finite() && entry.scale >= 0.0 && entry.rotation_deg.is_finite()) {
        return Err(Error::input("scale and rotation_deg must be finite, scale not negative"));
    }
    let mut scaled = environment.rotated(entry.rotation_deg.to_radians());
    if entry.scale != 1.0 {
        scaled.pixels = scaled.pixels.iter().map(|&pixel| pixel * entry.scale).collect();
    }
    Ok(scaled)
}

/// `"environment"` or a colour `"#rrggbb"` in sRGB.
fn background(text: Option<&str>) -> Result<Background> {
    let Some(text) = text else { return Ok(Background::Colour(Rgb::ZERO)) };
    if text == "environment" {
        return Ok(Background::Environment);
    }
    let number = text.strip_prefix('#').filter(|hex| hex.len() == 6 && hex.is_ascii());
    let number = number.and_then(|hex| u32::from_str_radix(hex, 16).ok()).ok_or_else(|| {
        Error::input(format!(
            "key background: \"{text}\" is neither \"environment\" nor a colour \"#rrggbb\""
        ))
    })?;
    let channel = |shift: u32| colour::srgb_decode((number >> shift & 0xff) as f32 / 255.0);
    Ok(Background::Colour(Rgb::new(channel(16), channel(8), channel(0))))
}

/// What the tests of scene files share.
#[cfg(test)]
pub(super) mod testing {
    use super::*;

    pub(in crate::scene) const CAMERA: &str =
        "[camera]\nposition = [0, 0, 4]\ntarget = [0, 0, 0]\nfov_deg = 40\nwidth = 8\nheight = 6\n";

    pub(in crate::scene) fn read(text: &str) -> Result<Scene> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        Scene::read(&path)
    }
}

#[cfg(test)]
mod tests {
    use super::testing::{CAMERA, read};
    use super::*;
    use lobelia_reflectance::{SbrdfMap, mip};

    #[test]
    fn a_scene_of_every_kind_of_entry_is_read() {
        let scene = read(&format!(
            "background = \"#ffffff\"\nexposure = 2\n{CAMERA}[environment]\nbuiltin = \
             \"studio\"\nrotation_deg = 90\n[[object]]\nmesh = \"sphere\"\ntranslate = [1, 0, 0]\nscale = \
             [2, 2, 2]\nmaterial.published = \"clay\"\n[[object]]\nmesh = \
             \"plane\"\n[object.material]\nalbedo = [0.5, 0.5, 0.5]\nlobes = [{{ rho_s = [0.1, 0.1, 0.1], c \
             = [-1, -1, 1], n = 20 }}]\n[[light]]\nkind = \"directional\"\ntoward = [0, 2, 0]\nirradiance = \
             [1, 1, 1]\n[[light]]\nkind = \"point\"\nposition = [0, 2, 0]\nintensity = [1, 1, \
             1]\n[[light]]\nkind = \"rectangle\"\ncentre = [0, 2, 0]\nedges = [[1, 0, 0], [0, 0, \
             1]]\nradiance = [1, 1, 1]\n"
        ))
        .unwrap();
        assert_eq!((scene.objects.len(), scene.lights.len()), (2, 3));
        assert_eq!(scene.background, Background::Colour(Rgb::ONE));
        assert_eq!(scene.lights[0], Light::Directional { toward: Vec3::Y, irradiance: Rgb::ONE });
        assert_eq!(scene.objects[0].transform.transform_point3(Vec3::X), Vec3::new(3.0, 0.0, 0.0));
    }

    #[test]
    fn wrong_entries_are_refused_with_file_and_key() {
        for (text, words) in [
            ("[[object]]\nmesh = \"cube\"\nmaterial.albedo = [1, 1, 1]\n", vec!["key mesh", "cube", "drape"]),
            ("[[object]]\nmesh = \"a.obj\"\nmaterial.albedo = [1, 1, 1]\n", vec!["key mesh", "a.obj"]),
            ("[[object]]\nmesh = \"plane\"\n", vec!["plane 0", "key material", "exactly one"]),
            ("[[object]]\nmesh = \"plane\"\nmaterial.map = \"no.exr\"\n", vec!["key map", "no.exr"]),
            (
                "[[object]]\nmesh = \"plane\"\nmaterial = { published = \"clay\", mask = \"no.png\" }\n",
                vec!["plane 0", "key mask", "no.png"],
            ),
            ("[[object]]\nmesh = \"plane\"\nmaterial.published = \"silk\"\n", vec!["silk", "brushed-metal"]),
            ("[[light]]\nkind = \"spot\"\n", vec!["light 0", "spot", "directional"]),
            ("[[light]]\nkind = \"point\"\ntoward = [0, 1, 0]\n", vec!["light 0", "position and intensity"]),
            (
                "[[light]]\nkind = \"rectangle\"\ncentre = [0, 1, 0]\nedges = [[1, 0, 0], [1, 1, \
                 0]]\nradiance = [1, 1, 1]\n",
                vec!["light 0", "perpendicular"],
            ),
            ("[environment]\nbuiltin = \"cave\"\n", vec!["environment", "cave", "sky"]),
            ("[environment]\nrotation = 3\n", vec!["line 8", "unknown key `rotation`", "`rotation_deg`"]),
            (
                "[[object]]\nmesh = \"plane\"\nmaterial.lobes = [{ rho_s = [1, 1, 1], c = [-1, -1, 1], n = \
                 -2 }]\n",
                vec!["plane 0", "lobe0.n is -2"],
            ),
        ] {
            let error = read(&format!("{CAMERA}{text}")).unwrap_err();
            let message = error.to_string();
            assert_eq!(error.exit_code(), 2, "{message}");
            for word in words.iter().chain(&["scene.toml"]) {
                assert!(message.contains(word), "\"{word}\" is not in: {message}");
            }
        }
    }

    #[test]
    fn a_map_brings_its_mip_levels_and_its_alpha_and_levels_of_other_sizes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, width: usize, height: usize, alpha: bool| {
            let mut map = SbrdfMap::new(width, height, 1);
            if alpha {
                map.extra.insert("alpha".into(), (0..width * height).map(|k| k as f32).collect());
            }
            map.write_exr(&folder.path().join(name)).unwrap();
        };
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, format!("{CAMERA}[[object]]\nmesh = \"plane\"\nmaterial.map = \"m.exr\"\n"))
            .unwrap();
        write("m.exr", 5, 3, true);
        write("m.mip1.exr", 3, 2, false);
        write("m.mip2.exr", 2, 1, false);
        let material = &Scene::read(&path).unwrap().objects[0].material;
        assert_eq!(material.levels.len(), 2);
        assert_eq!(material.mask.as_ref().unwrap().bits, [(1 << 15) - 2]);
        write("m.mip2.exr", 1, 1, false);
        let message = Scene::read(&path).unwrap_err().to_string();
        assert!(message.contains("MIP level 2") && message.contains("2 × 1"), "{message}");

        // A level that knows its map is no other map's, of the same size and one coefficient apart.
        let mut map = SbrdfMap::new(5, 3, 1);
        let mut level = SbrdfMap::new(3, 2, 1);
        level.attributes.insert(mip::OF.into(), mip::fingerprint(&map));
        level.write_exr(&folder.path().join("m.mip1.exr")).unwrap();
        std::fs::remove_file(folder.path().join("m.mip2.exr")).unwrap();
        let read = |map: &SbrdfMap| {
            map.write_exr(&folder.path().join("m.exr")).unwrap();
            Scene::read(&path).map(|scene| scene.objects[0].material.levels.len())
        };
        assert_eq!(read(&map).unwrap(), 1);
        map.lobes[0].n[7] = 1.5;
        let message = read(&map).unwrap_err().to_string();
        assert!(message.contains("m.mip1.exr: a MIP level of another map than"), "{message}");
    }

    #[test]
    fn a_map_or_a_mesh_given_as_a_scene_is_told_what_to_do() {
        for (name, what) in
            [("material.exr", "an SBRDF map"), ("ball.GLB", "a mesh"), ("s.zarr", "a sampled SBRDF")]
        {
            let error = Scene::open(Path::new(name)).unwrap_err();
            let text = error.to_string();
            assert!(error.exit_code() == 2 && text.contains(name) && text.contains(what), "{text}");
            assert!(text.contains("lobelia template scene"), "{text}");
        }
    }

    #[test]
    fn a_scene_far_from_zero_is_the_same_scene_as_at_zero() {
        // A millimetre at the coordinates of a land survey: in single precision steps are half a metre there.
        let folder = tempfile::tempdir().unwrap();
        let scene = |far: [f64; 3]| {
            let at =
                |x: f64, y: f64, z: f64| format!("[{:?}, {:?}, {:?}]", x + far[0], y + far[1], z + far[2]);
            let obj: String = [[0.0, 0.0], [0.002, 0.0], [0.002, 0.001], [0.0, 0.001]]
                .iter()
                .map(|[x, y]| format!("v {:?} {:?} {:?}\n", x + far[0], y + far[1], far[2]))
                .collect();
            std::fs::write(folder.path().join("m.obj"), obj + "f 1 2 3 4\n").unwrap();
            let text = format!(
                "[camera]\nposition = {}\ntarget = {}\nfov_deg = 40\nwidth = 8\nheight = 6\n\
                 [[object]]\nmesh = \"m.obj\"\nmaterial.albedo = [0.5, 0.5, 0.5]\n\
                 [[light]]\nkind = \"point\"\nposition = {}\nintensity = [1, 1, 1]\n",
                at(0.0, 0.0, 0.01),
                at(0.0, 0.0, 0.0),
                at(0.0, 0.005, 0.01)
            );
            let path = folder.path().join("scene.toml");
            std::fs::write(&path, text).unwrap();
            Scene::read(&path).unwrap()
        };
        let (near, far) = (scene([0.0; 3]), scene([4_000_000.25, -700_000.5, 300.125]));
        let seen = |scene: &Scene| -> Vec<Vec3> {
            let object = &scene.objects[0];
            let corners = object.mesh.vertices.iter().map(|v| object.transform.transform_point3(v.position));
            let Light::Point { position, .. } = scene.lights[0] else { panic!("a point light") };
            corners.chain([position]).map(|point| point - scene.camera.position).collect()
        };
        for (a, b) in seen(&near).into_iter().zip(seen(&far)) {
            assert!((a - b).length() < 1e-8, "{a} {b}");
        }
    }

    #[test]
    fn an_animation_varies_all_that_a_state_holds_by_name_or_number() {
        let text = format!(
            "{CAMERA}[environment]\nbuiltin = \"studio\"\n[[object]]\nname = \"ball\"\nmesh = \
             \"sphere\"\nmaterial.published = \"clay\"\n[[light]]\nname = \"lamp\"\nkind = \
             \"point\"\nposition = [0, 2, 0]\nintensity = [1, 1, 1]\n[[light]]\nkind = \
             \"directional\"\ntoward = [0, 1, 0]\nirradiance = [1, 1, 1]\n[[parameter]]\nname = \
             \"hour\"\nrange = [8, 20]\nlight.lamp = {{ dim = 0 }}\n[animation]\nframes = \
             3\n[[animation.key]]\n[[animation.key]]\nenvironment_turn_deg = 90\nlight.lamp = {{ move = [1, \
             0, 0] }}\nlight.1 = {{ turn_deg = [90, 0, 0], dim = 0.5 }}\nobject.ball.move = [0, 3, \
             0]\nparameter.hour = 20\n"
        );
        let scene = read(&text).unwrap();
        let frames = scene.frames();
        assert_eq!((frames.len(), &frames[0]), (3, &scene.state()));
        let last = scene.at(&frames[2]).unwrap();
        assert_eq!(last.environment.unwrap().rotation, 90f32.to_radians());
        let dark = Light::Point { position: Vec3::new(1.0, 2.0, 0.0), intensity: Rgb::ZERO };
        assert_eq!(last.lights[0], dark);
        let Light::Directional { toward, irradiance } = last.lights[1] else { panic!("directional") };
        assert!((toward - Vec3::Z).length() < 1e-6 && irradiance == Rgb::splat(0.5));
        assert_eq!(last.objects[0].transform.translation.y, 3.0);
        for (from, to, words) in [
            ("light.lamp = { move", "light.sun = { move", "key 1: there is no light \"sun\""),
            ("parameter.hour = 20", "parameter.day = 1", "the scene has \"hour\""),
            ("parameter.hour = 20", "parameter.hour = 21", "hour is 21; use 8 to 20"),
            ("range = [8, 20]", "range = [8, 8]", "parameter hour: range"),
        ] {
            let message = read(&text.replace(from, to)).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn a_camera_that_looks_along_its_up_is_refused() {
        let text = CAMERA.replace("[0, 0, 4]", "[0, 4, 0]");
        assert!(read(&text).unwrap_err().to_string().contains("one line"));
    }
}
