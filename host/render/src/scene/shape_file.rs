//! Shapes in scene files: `shape.torus = { radius = 1.0, tube = 0.3, tolerance = 0.001 }`, and so on.

use std::path::Path;

use glam::{DVec3, Vec3};
use serde::Deserialize;

use super::bezier::Patches;
use super::mesh::Mesh;
use super::shapes::height_field::{Heights, height_field};
use super::shapes::{solids, tolerance};
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::picture_file;

/// One shape with its sizes; `tolerance` is how far triangles may be from it, in units of the scene.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ShapeFile {
    Sphere(SphereFile),
    Torus(TorusFile),
    Cylinder(CylinderFile),
    Box(BoxFile),
    Lathe(LatheFile),
    HeightField(HeightFieldFile),
    Teapot(TeapotFile),
    Bezier(BezierFile),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SphereFile {
    #[serde(default = "one")]
    radius: f64,
    tolerance: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TorusFile {
    #[serde(default = "one")]
    radius: f64,
    tube: f64,
    tolerance: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CylinderFile {
    #[serde(default = "one")]
    radius: f64,
    height: f64,
    #[serde(default = "yes")]
    lids: bool,
    tolerance: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BoxFile {
    size: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LatheFile {
    /// Radius and height.
    profile: Vec<[f64; 2]>,
    #[serde(default)]
    smooth: bool,
    tolerance: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HeightFieldFile {
    /// A picture, black low, or rows of heights.
    file: Option<String>,
    heights: Option<Vec<Vec<f64>>>,
    /// Along x and z.
    size: [f64; 2],
    /// What white is worth, or factor on the rows.
    #[serde(default = "one")]
    height: f64,
    tolerance: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TeapotFile {
    #[serde(default = "yes")]
    bottom: bool,
    tolerance: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BezierFile {
    file: String,
    tolerance: Option<f64>,
}

fn one() -> f64 {
    1.0
}

fn yes() -> bool {
    true
}

impl ShapeFile {
    /// The name that an object has without one of its own.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Sphere(_) => "sphere",
            Self::Torus(_) => "torus",
            Self::Cylinder(_) => "cylinder",
            Self::Box(_) => "box",
            Self::Lathe(_) => "lathe",
            Self::HeightField(_) => "height_field",
            Self::Teapot(_) => "teapot",
            Self::Bezier(_) => "bezier",
        }
    }

    /// The triangles of an object that the scene scales, and what their positions are relative to.
    pub(super) fn mesh(&self, folder: &Path, scale: Vec3) -> Result<(Mesh, DVec3)> {
        let scale = f64::from(scale.abs().max_element()).max(f64::MIN_POSITIVE);
        // In the shape's own units, from its longest side where none is named.
        let within = |named: &Option<f64>, longest: f64| match named {
            Some(named) => tolerance::check(*named).map(|()| named / scale),
            // What is wrong with a length is told by its own key.
            None => Ok((longest * tolerance::USUAL).max(f64::MIN_POSITIVE)),
        };
        let mesh = match self {
            Self::Sphere(SphereFile { radius, tolerance }) => {
                solids::ball(*radius, within(tolerance, 2.0 * radius)?)?
            }
            Self::Torus(TorusFile { radius, tube, tolerance }) => {
                solids::torus(*radius, *tube, within(tolerance, 2.0 * (radius + tube))?)?
            }
            Self::Cylinder(CylinderFile { radius, height, lids, tolerance }) => {
                solids::cylinder(*radius, *height, *lids, within(tolerance, height.max(2.0 * radius))?)?
            }
            Self::Box(BoxFile { size }) => solids::cuboid(*size)?,
            Self::Lathe(LatheFile { profile, smooth, tolerance }) => {
                let longest = profile.iter().flatten().fold(0.0, |longest: f64, x| longest.max(x.abs()));
                solids::lathe(profile, *smooth, within(tolerance, 2.0 * longest)?)?
            }
            Self::HeightField(entry) => {
                let (columns, mut samples) = entry.samples(folder)?;
                samples.iter_mut().for_each(|sample| *sample *= entry.height);
                let longest = entry.size[0].max(entry.size[1]);
                height_field(
                    &Heights { columns, samples: &samples },
                    entry.size,
                    within(&entry.tolerance, longest)?,
                )?
            }
            Self::Teapot(TeapotFile { bottom, tolerance }) => {
                let patches = Patches::teapot(*bottom)?;
                return patches.mesh(named_or_usual(tolerance, &patches, scale)?);
            }
            Self::Bezier(BezierFile { file, tolerance }) => {
                let patches = Patches::read(&folder.join(file)).map_err(|error| error.at("key file"))?;
                return patches.mesh(named_or_usual(tolerance, &patches, scale)?);
            }
        };
        Ok((mesh, DVec3::ZERO))
    }
}

/// The tolerance in the patches' own units.
fn named_or_usual(named: &Option<f64>, patches: &Patches, scale: f64) -> Result<f64> {
    let Some(named) = named else { return Ok(patches.usual_tolerance()) };
    tolerance::check(*named).map(|()| named / scale)
}

impl HeightFieldFile {
    /// Samples a row, and the samples.
    fn samples(&self, folder: &Path) -> Result<(usize, Vec<f64>)> {
        match (&self.file, &self.heights) {
            (Some(file), None) => {
                let picture =
                    picture_file::decode(&folder.join(file)).map_err(|error| error.at("key file"))?;
                let samples = picture.to_luma32f().into_raw().into_iter().map(f64::from).collect();
                Ok((picture.width() as usize, samples))
            }
            (None, Some(rows)) => {
                let columns = rows.first().map_or(0, Vec::len);
                if let Some(row) = rows.iter().position(|row| row.len() != columns) {
                    let count = rows[row].len();
                    return Err(Error::input(format!(
                        "key heights: row {row} has {count} numbers, the first {columns}"
                    )));
                }
                Ok((columns, rows.concat()))
            }
            _ => Err(Error::input("a height_field has exactly one of file and heights")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::file::testing::{CAMERA, read};
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn every_shape_is_read_and_wrong_keys_are_refused_with_their_line() {
        let object = |shape: &str| {
            read(&format!(
                "{CAMERA}[[object]]\nscale = [2, 2, 2]\n{shape}\nmaterial.albedo = [0.5, 0.5, 0.5]\n"
            ))
        };
        for (shape, name, high) in [
            ("shape.sphere = { tolerance = 0.01 }", "sphere 0", 2.0),
            ("shape.torus = { radius = 2, tube = 0.5 }", "torus 0", 1.0),
            ("shape.cylinder = { height = 3, lids = false }", "cylinder 0", 3.0),
            ("shape.box = { size = [1, 2, 3] }", "box 0", 2.0),
            ("shape.lathe = { profile = [[0, 1], [1, 0]] }", "lathe 0", 2.0),
            (
                "shape.height_field = { heights = [[0, 1], [0, 1]], size = [1, 1], height = 3 }",
                "height_field 0",
                6.0,
            ),
            ("shape.teapot = { bottom = false, tolerance = 0.05 }", "teapot 0", 6.3),
        ] {
            let scene = object(shape).unwrap();
            let found = &scene.objects[0];
            let top = found.transform.transform_point3(found.mesh.bounds().1).y;
            assert!(found.name == name && (top - high).abs() < 5e-3, "{} {top}", found.name);
        }
        // The tolerance is one of the scene: at twice the scale there are twice the triangles.
        let count = |scale: f32| {
            let text = format!(
                "{CAMERA}[[object]]\nscale = [{scale:?}, 1, 1]\nshape.sphere = {{ tolerance = 0.001 \
                 }}\nmaterial.published = \"clay\"\n"
            );
            read(&text).unwrap().objects[0].mesh.triangles.len() as f32
        };
        assert!((count(2.0) / count(1.0) - 2.0).abs() < 0.1, "{} {}", count(1.0), count(2.0));
        for (shape, words) in [
            ("shape.ball = {}", vec!["line 9", "`ball`", "`sphere`"]),
            ("shape.sphere = { radios = 1 }", vec!["line 9", "unknown key `radios`", "`radius`"]),
            ("shape.torus = { radius = 1 }", vec!["line 9", "`tube`"]),
            ("shape.torus = { tube = 2 }", vec!["torus 0", "key shape.torus", "key tube"]),
            ("shape.sphere = { tolerance = 0 }", vec!["sphere 0", "key tolerance"]),
            ("shape.box = { size = [1, 1] }", vec!["line 9"]),
            ("shape.bezier = { file = \"no.bpt\" }", vec!["key file", "no.bpt"]),
            ("shape.height_field = { size = [1, 1] }", vec!["file and heights"]),
            ("shape.height_field = { size = [1, 1], heights = [[1, 2], [1]] }", vec!["row 1 has 1"]),
            ("shape.sphere = {}\nmesh = \"plane\"", vec!["exactly one of mesh and shape"]),
            ("", vec!["object 0", "exactly one of mesh and shape"]),
        ] {
            let message = object(shape).unwrap_err().to_string();
            for word in words.iter().chain(&["scene.toml"]) {
                assert!(message.contains(word), "\"{word}\" is not in: {message}");
            }
        }
    }

    #[test]
    fn patches_and_heights_are_read_from_files() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        let points: String = (0..16).map(|k| format!("{} {} 0\n", k / 4, k % 4)).collect();
        write("flat.bpt", &format!("1\n3 3\n{points}"));
        let picture =
            image::ImageBuffer::from_fn(3, 2, |x, _| image::Luma([if x == 2 { u16::MAX } else { 0 }]));
        picture.save(folder.path().join("step.png")).unwrap();
        write(
            "scene.toml",
            &format!(
                "{CAMERA}[[object]]\nmesh = \"flat.bpt\"\nmaterial.published = \"clay\"\n\
                 [[object]]\nshape.bezier = {{ file = \"flat.bpt\" }}\nmaterial.published = \"clay\"\n\
                 [[object]]\nshape.height_field = {{ file = \"step.png\", size = [2, 1], height = 0.5 }}\n\
                 material.published = \"clay\"\n"
            ),
        );
        let scene = Scene::read(&folder.path().join("scene.toml")).unwrap();
        for object in &scene.objects[..2] {
            assert_eq!(object.mesh.bounds(), (Vec3::ZERO, Vec3::new(3.0, 3.0, 0.0)));
            assert_eq!(object.mesh.triangles.len(), 2);
        }
        let (low, high) = scene.objects[2].mesh.bounds();
        assert!((high - Vec3::new(1.0, 0.5, 0.5)).length() < 1e-6 && low.y > -0.1, "{low} {high}");
    }
}
