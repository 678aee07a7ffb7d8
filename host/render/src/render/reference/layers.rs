//! Layers of a view: what makes up each pixel, by kind of light, by number of reflections and by object, and
//! what it shows.
//!
//! Of radiance, means over a pixel's samples, without the branches of pictures: `R G B A` the picture, which
//! `emission` (with the background), `direct` (reflected once) and `indirect` add up to, as `emission`,
//! `diffuse` and `specular` (by the first surface's term) do, and `bounceN` (reflected or refracted N times,
//! the last with all that follow). `object.NAME`: what pixels show of an object, its coverage in `A`. At the
//! pixel's middle: `depth.Z` along the line of sight's axis, `normal.X Y Z` in the world toward the viewer,
//! `texture.U V` coordinates with repeats, `id.I` the object's index, −1 for none.

use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes,
    LineOrder, SmallVec, Text, WritableImage,
};
use glam::Vec4;
use rayon::prelude::*;

use super::tally::Tally;
use super::trace::{Numbers, PARTS, Shaders, Traced, Tracer};
use super::{Settings, View, hash};
use crate::scene::{Camera, Scene};
use lobelia_base::error::{Error, Result};
use lobelia_base::{files, progress};
use lobelia_reflectance::Rgb;

/// Reflections with a layer of their own; the last takes all that follow.
const BOUNCES: usize = 8;

/// The layers of a view, a plane a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Layers {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Name and values of every channel, row by row from the top.
    pub channels: Vec<(String, Vec<f32>)>,
    /// Rays cast.
    pub rays: u64,
}

/// What is kept of a pixel.
#[derive(Clone)]
struct Parts {
    whole: Vec4,
    bounces: [Rgb; BOUNCES + 1],
    diffuse: Rgb,
    specular: Rgb,
    /// The object of the sample at hand.
    object: Option<u32>,
}

impl Tally for Parts {
    const SPLITS: bool = true;

    fn add(&mut self, reflections: u32, radiance: Rgb, diffuse: Rgb) {
        self.bounces[(reflections as usize).min(BOUNCES)] += radiance;
        if reflections > 0 {
            self.diffuse += radiance * diffuse;
            self.specular += radiance * (Rgb::ONE - diffuse);
        }
    }

    fn first(&mut self, radiance: Rgb, diffuse: Rgb) {
        self.bounces[1] += radiance;
        self.diffuse += diffuse;
        self.specular += radiance - diffuse;
    }

    fn meets(&mut self, object: u32) {
        self.object = Some(object);
    }
}

/// What a pixel's middle shows: depth, normal, texture coordinates, object.
type Shown = [f32; 7];

/// A pixel's means, and by object what it shows of it.
type Pixel = (Parts, Vec<(u32, Vec4)>, Shown);

impl Settings {
    /// Renders the layers of a view with as many samples a pixel as told, whatever the limits of time and
    /// error.
    ///
    /// # Errors
    /// Those of [`super::super::Renderer::open`] and [`super::super::Player::frame`].
    pub fn layers(&self, scene: &Scene, camera: &Camera) -> Result<Layers> {
        scene.check()?;
        self.check()?;
        camera.check()?;
        let tracer = Tracer::new(scene, self.bounces, self.tree);
        let seed = hash(self.seed as u32 ^ hash((self.seed >> 32) as u32 ^ 0x5bd1_e995));
        let (width, height) = (camera.width as usize, camera.height as usize);
        let view = View::new(&tracer, camera, seed, self.samples, vec![]);
        let bar = progress::bar("layers", height as u64, "rows");
        let row = |shaders: &mut Shaders, y: usize| {
            let mut rays = [0; PARTS];
            let pixels: Vec<Pixel> =
                (0..width).map(|x| view.layers_of([x, y], camera, shaders, &mut rays)).collect();
            bar.advance(1);
            (pixels, rays.iter().sum::<u64>())
        };
        let rows: Vec<(Vec<Pixel>, u64)> = (0..height).into_par_iter().map_init(Shaders::new, row).collect();
        let rays = rows.iter().map(|row| row.1).sum();
        let pixels: Vec<Pixel> = rows.into_iter().flat_map(|row| row.0).collect();
        Ok(Layers { width, height, channels: channels(scene, &pixels), rays })
    }
}

impl View<'_> {
    fn layers_of(
        &self,
        [x, y]: [usize; 2],
        camera: &Camera,
        shaders: &mut Shaders,
        rays: &mut [u64; PARTS],
    ) -> Pixel {
        let zero = Rgb::ZERO;
        let mut parts = Parts {
            whole: Vec4::ZERO,
            bounces: [zero; BOUNCES + 1],
            diffuse: zero,
            specular: zero,
            object: None,
        };
        let mut objects: Vec<(u32, Vec4)> = Vec::new();
        let pixel = hash(self.seed ^ hash((y * self.width + x) as u32));
        for index in 0..self.pass {
            parts.object = None;
            let numbers = Numbers { pixel, index };
            let traced = self.sample_into([x, y], &numbers, 1, shaders, &mut parts, rays);
            let Traced { parts: [a, b], coverage } = traced;
            let found = (a + b).extend(coverage);
            parts.whole += found;
            if let Some(object) = parts.object {
                match objects.iter_mut().find(|(other, _)| *other == object) {
                    Some((_, sum)) => *sum += found,
                    None => objects.push((object, found)),
                }
            }
        }
        let scale = 1.0 / self.pass as f32;
        parts.whole *= scale;
        parts.bounces.iter_mut().for_each(|part| *part *= scale);
        (parts.diffuse, parts.specular) = (parts.diffuse * scale, parts.specular * scale);
        objects.iter_mut().for_each(|(_, sum)| *sum *= scale);
        let direction = self.rays.direction(x as f32 + 0.5, y as f32 + 0.5);
        let along = camera.basis()[2].dot(direction);
        let shown = self.tracer.shown(self.rays.origin, direction, self.inside);
        let shown = shown.map_or([f32::INFINITY, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0], |surface| {
            let [.., normal] = surface.frame;
            let depth = surface.position.distance(self.rays.origin) * along;
            [depth, normal.x, normal.y, normal.z, surface.uv.x, surface.uv.y, surface.object as f32]
        });
        (parts, objects, shown)
    }
}

/// The channels of a picture.
fn channels(scene: &Scene, pixels: &[Pixel]) -> Vec<(String, Vec<f32>)> {
    let mut channels = Vec::new();
    let mut colour = |name: &str, of: &dyn Fn(&Pixel) -> Vec4, alpha: bool| {
        let dot = if name.is_empty() { "" } else { "." };
        for (k, letter) in ["R", "G", "B", "A"].into_iter().enumerate().take(3 + usize::from(alpha)) {
            channels.push((format!("{name}{dot}{letter}"), pixels.iter().map(|p| of(p)[k]).collect()));
        }
    };
    let part = |of: Rgb| of.extend(0.0);
    colour("", &|p| p.0.whole, true);
    colour("emission", &|p| part(p.0.bounces[0]), false);
    colour("direct", &|p| part(p.0.bounces[1]), false);
    colour("indirect", &|p| part(p.0.bounces[2..].iter().sum()), false);
    colour("diffuse", &|p| part(p.0.diffuse), false);
    colour("specular", &|p| part(p.0.specular), false);
    for bounce in 0..=BOUNCES {
        colour(&format!("bounce{bounce}"), &|p| part(p.0.bounces[bounce]), false);
    }
    for (index, name) in (0u32..).zip(names(scene)) {
        let of = |p: &Pixel| p.1.iter().find(|object| object.0 == index).map_or(Vec4::ZERO, |found| found.1);
        colour(&format!("object.{name}"), &of, true);
    }
    for (k, name) in
        ["depth.Z", "normal.X", "normal.Y", "normal.Z", "texture.U", "texture.V", "id.I"].iter().enumerate()
    {
        channels.push(((*name).to_owned(), pixels.iter().map(|pixel| pixel.2[k]).collect()));
    }
    channels
}

/// The names of objects, then of rectangular lights, that channels can have; a second one of a name is told
/// by its index.
fn names(scene: &Scene) -> Vec<String> {
    let letter = |c: char| if c.is_ascii_alphanumeric() || "-_ ".contains(c) { c } else { '_' };
    let lights = scene.lights.iter().enumerate();
    let lights = lights.filter(|(_, light)| matches!(light, crate::scene::Light::Rectangle { .. }));
    let objects = scene.objects.iter().map(|object| object.name.chars().map(letter).collect::<String>());
    let mut names: Vec<String> = Vec::new();
    for name in objects.chain(lights.map(|(index, _)| format!("light {index}"))) {
        let taken = name.is_empty() || names.contains(&name);
        names.push(if taken { format!("{name} ({})", names.len()) } else { name });
    }
    names
}

impl Layers {
    /// The values of a channel.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|channel| channel.0 == name).map(|channel| &channel.1[..])
    }

    /// Writes the layers as one OpenEXR file, f32, whole or not at all.
    ///
    /// # Errors
    /// Failures of the disk.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut channels: SmallVec<[AnyChannel<FlatSamples>; 4]> = SmallVec::new();
        for (name, values) in &self.channels {
            let text = Text::new_or_none(name).ok_or_else(|| {
                Error::input(format!("{}: no channel can be named `{name}`", path.display()))
            })?;
            channels.push(AnyChannel::new(text, FlatSamples::F32(values.clone())));
        }
        let encoding = Encoding {
            compression: Compression::ZIP16,
            blocks: Blocks::ScanLines,
            line_order: LineOrder::Increasing,
        };
        let attributes = LayerAttributes::default();
        let channels = AnyChannels::sort(channels);
        let image = Image::from_layer(Layer::new((self.width, self.height), attributes, encoding, channels));
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write().to_buffered(&mut bytes).map_err(|error| Error::writing(path, error))?;
        files::write_bytes(path, bytes.get_ref())
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::Renderer;
    use super::*;
    use glam::Vec3;
    use std::path::Path;

    fn layers(name: &str, samples: u32) -> (Scene, Layers) {
        let mut scene = Scene::open(Path::new(name)).unwrap();
        (scene.camera.width, scene.camera.height) = (24, 20);
        let layers = Settings { samples, ..Settings::default() }.layers(&scene, &scene.camera).unwrap();
        (scene, layers)
    }

    fn sum(layers: &Layers, names: &[&str], k: usize) -> f32 {
        names.iter().map(|name| layers.channel(name).unwrap()[k]).sum()
    }

    #[test]
    fn parts_add_up_to_the_picture_however_it_is_divided() {
        for name in ["glass-mirror", "window", "studio-ball"] {
            let (scene, layers) = layers(name, 16);
            let objects: Vec<String> = names(&scene).iter().map(|name| format!("object.{name}.G")).collect();
            let objects: Vec<&str> = objects.iter().map(String::as_str).collect();
            let bounces: Vec<String> = (0..=BOUNCES).map(|k| format!("bounce{k}.G")).collect();
            let bounces: Vec<&str> = bounces.iter().map(String::as_str).collect();
            for k in 0..24 * 20 {
                let whole = sum(&layers, &["G"], k);
                let ways: [&[&str]; 3] = [
                    &["emission.G", "direct.G", "indirect.G"],
                    &["emission.G", "diffuse.G", "specular.G"],
                    &bounces,
                ];
                for way in ways {
                    assert!(
                        (sum(&layers, way, k) - whole).abs() < 1e-4 * (1.0 + whole),
                        "{name} {k} {way:?}"
                    );
                }
                if sum(&layers, &["A"], k) == 1.0 {
                    assert!((sum(&layers, &objects, k) - whole).abs() < 1e-4 * (1.0 + whole), "{name} {k}");
                }
            }
        }
    }

    #[test]
    fn the_layers_are_of_the_picture() {
        let (scene, layers) = layers("window", 64);
        let settings = Settings { samples: 64, seed: 3, ..Settings::default() };
        let picture = settings.render(&scene, &scene.camera).unwrap().picture;
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let seen: Vec<f32> = picture.pixels.iter().map(|pixel| pixel.y).collect();
        let (a, b) = (mean(layers.channel("G").unwrap()), mean(&seen));
        assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");
    }

    #[test]
    fn a_mirror_has_no_diffuse_part_and_paint_no_other() {
        let (_, layers) = layers("glass-mirror", 16);
        let mirror = layers.channel("object.mirror.A").unwrap();
        let back = layers.channel("object.back.A").unwrap();
        let mut counts = [0; 2];
        for k in 0..mirror.len() {
            if mirror[k] == 1.0 {
                assert!(layers.channel("diffuse.R").unwrap()[k] < 1e-6);
                counts[0] += 1;
            } else if back[k] == 1.0 {
                assert!(layers.channel("specular.R").unwrap()[k].abs() < 1e-5);
                counts[1] += 1;
            }
        }
        assert!(counts.iter().all(|&count| count > 10), "{counts:?}");
    }

    #[test]
    fn depth_normal_texture_and_object_are_those_of_the_pixels_middle() {
        let (scene, layers) = layers("window", 1);
        let name = |k: usize| {
            let index = layers.channel("id.I").unwrap()[k];
            &scene.objects[index as usize].name
        };
        // The middle of the picture looks straight at the back wall.
        let k = 10 * 24 + 12;
        assert_eq!(name(k), "back");
        let at = |channel: &str| layers.channel(channel).unwrap()[k];
        assert!((at("depth.Z") - 5.3).abs() < 5e-3, "{}", at("depth.Z"));
        assert!((Vec3::new(at("normal.X"), at("normal.Y"), at("normal.Z")) - Vec3::Z).length() < 1e-4);
        assert!((0.4..0.6).contains(&at("texture.U")) && (0.4..0.6).contains(&at("texture.V")));
    }

    #[test]
    fn a_file_has_every_channel() {
        let (_, layers) = layers("lamps", 1);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("layers.exr");
        layers.write(&path).unwrap();
        let read = lobelia_reflectance::exr_file::read(&path, "channels", |names| {
            Some(names.iter().map(|name| (*name).to_owned()).collect())
        })
        .unwrap();
        assert_eq!(read.channels.len(), layers.channels.len());
        for (name, values) in &layers.channels {
            assert!(read.channels[name].iter().zip(values).all(|(a, b)| a == b), "{name}");
        }
    }
}
