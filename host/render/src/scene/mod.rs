//! Scenes: meshes that wear SBRDF materials, lights, an environment and a camera, built in memory or read
//! from TOML.
//!
//! World axes are right-handed with +y up, as in glTF. Lengths are in any one unit; lights and meshes share
//! it.

pub mod animation;
pub mod bezier;
pub mod environment;
mod environment_file;
pub mod file;
mod frame;
pub mod hash;
mod import;
pub mod mask;
mod material_file;
pub mod mesh;
pub mod optics;
mod shape_file;
pub mod shapes;
pub mod shipped;
pub mod showcase;
pub mod state;
mod varied_file;
mod winding;

use std::sync::Arc;

use glam::{Affine3A, Vec2, Vec3};

pub use animation::Animation;
pub use environment::Environment;
pub use mask::Mask;
pub use mesh::{Mesh, Vertex};
pub use optics::{Dielectric, Optics, Texture};
pub use state::{Parameter, Placement, State, Varies};

use lobelia_base::error::{Error, Result};
use lobelia_reflectance::mip;
use lobelia_reflectance::{LobeBrdf, MIRROR_SOLID_ANGLE, Rgb, SbrdfMap};

/// Everything that a renderer needs to make a picture.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Meshes with their places and materials.
    pub objects: Vec<Object>,
    /// Point, directional and rectangular lights.
    pub lights: Vec<Light>,
    /// Distant radiance from every direction.
    pub environment: Option<Environment>,
    /// What is seen where no object is.
    pub background: Background,
    /// The view.
    pub camera: Camera,
    /// A path through states of the scene.
    pub animation: Option<Animation>,
    /// What has a name to be varied by.
    pub parameters: Vec<Parameter>,
    /// Factor on radiance before a picture is tone-mapped; linear outputs ignore it.
    pub exposure: f32,
}

/// One mesh in the world.
#[derive(Debug, Clone)]
pub struct Object {
    /// The name in error messages.
    pub name: String,
    /// Geometry in its own frame.
    pub mesh: Arc<Mesh>,
    /// From the mesh's frame to the world.
    pub transform: Affine3A,
    /// Reflectance.
    pub material: Material,
}

/// What a surface reflects.
#[derive(Debug, Clone)]
pub struct Material {
    /// Reflectance over the texture.
    pub reflectance: Reflectance,
    /// Repeats of the texture along u and v over texture coordinates 0..1.
    pub tiling: Vec2,
    /// How texels are combined.
    pub filter: Filter,
    /// MIP levels of a map from the first on, each fitted to the reflectance averaged over its texels, sized
    /// as [`lobelia_reflectance::mip::size`] says; empty where there are none.
    pub levels: Vec<Arc<SbrdfMap>>,
    /// Where the material is cut out; it has the texture coordinates and the tiling of the map.
    pub mask: Option<Arc<Mask>>,
    /// What it does beyond the lobes.
    pub optics: Option<Optics>,
    /// Radiance of its front, the side from which its triangles run counter-clockwise.
    pub emission: Option<Texture>,
}

/// Where a material's reflectance comes from.
#[derive(Debug, Clone)]
pub enum Reflectance {
    /// The same everywhere.
    Uniform(LobeBrdf),
    /// A texel map: u = x to the right, v downwards, row 0 at v = 0; it repeats.
    Map(Arc<SbrdfMap>),
}

/// How a texture lookup treats the texels around a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Filter {
    /// The texel that the point lies in.
    Nearest,
    /// The four nearest texels' *evaluated reflectance*, blended: parameters do not interpolate linearly
    /// (chapter 5).
    #[default]
    Bilinear,
}

/// A light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Light {
    /// A light infinitely far away.
    Directional {
        /// Unit vector toward the light.
        toward: Vec3,
        /// Irradiance on a surface that faces the light.
        irradiance: Rgb,
    },
    /// A light at a point, the same in all directions.
    Point {
        /// Where it is.
        position: Vec3,
        /// Radiant intensity: irradiance times the square of the distance in scene units.
        intensity: Rgb,
    },
    /// A rectangle that shines evenly and diffusely to the side that edges\[0\] × edges\[1\] points to. It is
    /// seen, black from behind, and casts shadows.
    Rectangle {
        /// Its middle.
        centre: Vec3,
        /// Two sides, perpendicular to each other.
        edges: [Vec3; 2],
        /// Radiance of its front.
        radiance: Rgb,
    },
}

/// What is seen where no object is; alpha is 0 there in any case.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Background {
    /// The environment, black without one.
    Environment,
    /// One radiance everywhere.
    Colour(Rgb),
}

/// A pinhole camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Centre of projection.
    pub position: Vec3,
    /// The point in the middle of the picture.
    pub target: Vec3,
    /// A direction that is up in the picture.
    pub up: Vec3,
    /// Vertical field of view, radians.
    pub fov: f32,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Camera {
    /// Unit vectors to the right, up and forward.
    pub fn basis(&self) -> [Vec3; 3] {
        let forward = (self.target - self.position).normalize();
        let right = forward.cross(self.up).normalize();
        [right, right.cross(forward), forward]
    }

    /// Refuses an empty picture and a view without direction.
    ///
    /// # Errors
    /// Input errors that name the key.
    pub fn check(&self) -> Result<()> {
        let Self { position, target, up, fov, width, height } = *self;
        if width == 0 || height == 0 || width > 16384 || height > 16384 {
            return Err(Error::input(format!(
                "camera: width and height are {width} × {height}; use 1 to 16384"
            )));
        }
        // NaN and infinity show in the product too.
        let spread = (target - position).cross(up).length();
        if !spread.is_finite() || spread == 0.0 {
            return Err(Error::input(
                "camera: position, target and up must be finite and not lie on one line",
            ));
        }
        if !(fov > 0.0 && fov < std::f32::consts::PI) {
            return Err(Error::input(format!(
                "camera: fov_deg is {}; use more than 0 and less than 180",
                fov.to_degrees()
            )));
        }
        Ok(())
    }
}

/// Coordinates beyond this have no volumes in single precision, by which rays meet triangles.
const FARTHEST: f32 = 1e12;

impl Light {
    /// Refuses numbers that no renderer can work with.
    fn check(&self) -> Result<()> {
        let (places, power): (&[Vec3], Rgb) = match self {
            Self::Directional { toward, irradiance } => (&[*toward], *irradiance),
            Self::Point { position, intensity } => (&[*position], *intensity),
            Self::Rectangle { centre, edges: [u, v], radiance } => (&[*centre, *u, *v], *radiance),
        };
        if places.iter().any(|v| !v.is_finite()) || !power.is_finite() || power.min_element() < 0.0 {
            return Err(Error::input("numbers must be finite, its colour not negative"));
        }
        match self {
            Self::Directional { toward, .. } if (toward.length() - 1.0).abs() > 1e-3 => {
                Err(Error::input("toward must be a unit vector"))
            }
            Self::Rectangle { edges: [u, v], .. }
                if u.cross(*v).length_squared() == 0.0 || u.normalize().dot(v.normalize()).abs() > 1e-3 =>
            {
                Err(Error::input("edges must have a length and be perpendicular to each other"))
            }
            _ => Ok(()),
        }
    }
}

impl Material {
    /// The same BRDF everywhere.
    pub fn uniform(brdf: LobeBrdf) -> Self {
        Self::new(Reflectance::Uniform(brdf), Vec2::ONE, Filter::Nearest)
    }

    /// A map, repeated `tiling` times along u and v, bilinear.
    pub fn map(map: Arc<SbrdfMap>, tiling: Vec2) -> Self {
        Self::new(Reflectance::Map(map), tiling, Filter::Bilinear)
    }

    /// A material without MIP levels, cut out where its map's channel `alpha` is below 0.5.
    pub fn new(reflectance: Reflectance, tiling: Vec2, filter: Filter) -> Self {
        let mask = match &reflectance {
            Reflectance::Uniform(_) => None,
            Reflectance::Map(map) => Mask::of_map(map).map(Arc::new),
        };
        Self { reflectance, tiling, filter, levels: vec![], mask, optics: None, emission: None }
    }

    /// The mirror term that was measured with a map: its channels `mirror.*`, f cosθ_i of the peak, times the
    /// solid angle of the lamp that it was measured with (the attribute [`MIRROR_SOLID_ANGLE`]), without
    /// which they are no reflectance.
    pub fn measured_mirror(map: &SbrdfMap) -> Option<Optics> {
        let solid_angle = map.attributes.get(MIRROR_SOLID_ANGLE)?.parse::<f32>().ok()?;
        Texture::of_map(map, "mirror", solid_angle).map(Optics::Mirror)
    }

    /// The BRDFs of all texels, those of the MIP levels after those of the map.
    pub fn brdfs(&self) -> impl Iterator<Item = LobeBrdf> {
        let (one, map) = match &self.reflectance {
            Reflectance::Uniform(brdf) => (Some(brdf.clone()), None),
            Reflectance::Map(map) => (None, Some(map)),
        };
        let maps = map.into_iter().chain(&self.levels);
        one.into_iter().chain(maps.flat_map(|map| (0..map.width * map.height).map(|k| map.texel(k))))
    }

    /// Refuses coefficients that no renderer can evaluate, and levels of other sizes.
    fn check(&self) -> Result<()> {
        Self::check_map(&self.reflectance)?;
        for (level, map) in (1..).zip(&self.levels) {
            let place = || format!("MIP level {level}");
            let Reflectance::Map(finest) = &self.reflectance else {
                return Err(Error::input("only a map has levels").at(place()));
            };
            let wanted = mip::size([finest.width, finest.height], level);
            if [map.width, map.height] != wanted {
                let ([width, height], map) = (wanted, [map.width, map.height]);
                return Err(Error::input(format!(
                    "it has {} × {} texels; the map's {} × {} make it {width} × {height}",
                    map[0], map[1], finest.width, finest.height
                ))
                .at(place()));
            }
            Self::check_map(&Reflectance::Map(map.clone())).map_err(|error| error.at(place()))?;
        }
        self.optics.as_ref().map_or(Ok(()), Optics::check).map_err(|error| error.at("material"))?;
        let emission = self.emission.as_ref().map_or(Ok(()), optics::check_emission);
        emission.map_err(|error| error.at("material"))?;
        match &self.mask {
            Some(mask) if mask.width * mask.height == 0 => Err(Error::input("the mask has no texels")),
            _ => Ok(()),
        }
    }

    /// Whether lobes, those of its levels included, stand about normals of their own or sharpen toward
    /// grazing.
    pub fn is_extended(&self) -> bool {
        let finest = match &self.reflectance {
            Reflectance::Uniform(brdf) => brdf.extension(),
            Reflectance::Map(map) => map.extension(),
        };
        finest.is_some() || self.levels.iter().any(|level| level.extension().is_some())
    }

    /// Refuses coefficients that no renderer can evaluate.
    fn check_map(reflectance: &Reflectance) -> Result<()> {
        let checked = match reflectance {
            Reflectance::Uniform(brdf) => brdf.check(),
            Reflectance::Map(map) if map.width == 0 || map.height == 0 => {
                return Err(Error::input("material: the SBRDF map has no texels"));
            }
            Reflectance::Map(map) => map.check(),
        };
        checked.map_err(|error| Error::format(error).at("material"))
    }
}

impl Scene {
    /// Refuses what no renderer can make a picture of: an empty picture, a camera without direction, bad
    /// numbers.
    ///
    /// # Errors
    /// Input errors that name the object, the light or the camera's key.
    pub fn check(&self) -> Result<()> {
        self.camera.check()?;
        self.check_parameters()?;
        if let Some(animation) = &self.animation {
            if animation.keys.len() < 2 || animation.frames == 0 {
                return Err(Error::input("animation: there must be two keys and one frame at least"));
            }
            for (index, key) in animation.keys.iter().enumerate() {
                self.check_state(key).map_err(|error| error.at(format!("animation: key {index}")))?;
            }
        }
        if !(self.exposure.is_finite() && self.exposure > 0.0) {
            return Err(Error::input(format!("exposure is {}; use a positive number", self.exposure)));
        }
        for object in &self.objects {
            let place = format!("object \"{}\"", object.name);
            if !object.transform.is_finite() || object.transform.matrix3.determinant() == 0.0 {
                return Err(Error::input("the transform is singular or not finite").at(place));
            }
            let reach = |vertex: &mesh::Vertex| {
                object.transform.transform_point3(vertex.position).abs().max_element()
            };
            let farthest = object.mesh.vertices.iter().map(reach).fold(0.0, f32::max);
            if farthest > FARTHEST {
                let message =
                    format!("it reaches {farthest:.1e} from the middle; use less than {FARTHEST:.0e}");
                return Err(Error::input(message).at(place));
            }
            if !object.material.tiling.is_finite() {
                return Err(Error::input("material: tiling is not finite").at(place));
            }
            object.material.check().map_err(|error| error.at(&place))?;
        }
        for (index, light) in self.lights.iter().enumerate() {
            light.check().map_err(|error| error.at(format!("light {index}")))?;
        }
        Ok(())
    }
}
