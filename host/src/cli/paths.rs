//! What of `lobelia render` is the path tracer's alone: rays of glass, and layers.

use std::path::PathBuf;

use super::methods::MethodArg;
use crate::error::{Error, Result};
use crate::files;
use crate::memory;
use crate::render::{PictureKind, picture_kind, reference};
use crate::scene::Scene;

/// What only the reference takes.
#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Options of --method reference")]
pub(super) struct PathArgs {
    /// Surfaces of glass in a row, from the first on, at which both the reflected and the refracted ray are
    /// followed; beyond these one by chance [default: 2]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=16))]
    tree: Option<u32>,
    /// Writes what makes up each pixel: direct, indirect, diffuse, specular, by bounce, by object with its
    /// mask, and depth, normal, texture coordinates and object of its middle; with --samples, 64 if not given
    #[arg(long, value_name = "FILE.exr")]
    layers: Option<PathBuf>,
}

impl PathArgs {
    /// Refuses another method and a name that is no OpenEXR file's.
    ///
    /// # Errors
    /// Input errors that name the option.
    pub(super) fn check(&self, method: MethodArg, animated: bool) -> Result<()> {
        if method.0.is_some() && !method.is("reference") {
            for (option, given) in [("--tree", self.tree.is_some()), ("--layers", self.layers.is_some())] {
                if given {
                    return Err(Error::input(format!("{option} goes with --method reference or auto")));
                }
            }
        }
        let Some(path) = &self.layers else { return Ok(()) };
        if animated {
            return Err(Error::input("--layers goes with one view, not with an animation"));
        }
        if picture_kind(path) != Some(PictureKind::Exr) {
            return Err(Error::input(format!("{}: a file of layers ends in .exr", path.display())));
        }
        files::try_file(path)
    }

    /// Adds what is given to settings.
    pub(super) fn apply(&self, settings: &mut reference::Settings) {
        settings.tree = self.tree.unwrap_or(settings.tree);
    }

    /// Renders and writes the layers of the scene's view, where they are asked for.
    ///
    /// # Errors
    /// Those of the scene and of the disk, and an input error where memory does not hold them.
    pub(super) fn write(&self, scene: &Scene, settings: &reference::Settings) -> Result<Option<PathBuf>> {
        let Some(path) = &self.layers else { return Ok(None) };
        let samples = if settings.samples == 1 << 20 { 64 } else { settings.samples };
        let pixels = u128::from(scene.camera.width) * u128::from(scene.camera.height);
        let each = 16 * (scene.objects.len() + scene.lights.len() + 16) as u128;
        memory::check(2 * pixels * each, "a picture with its layers", "give --width less")?;
        let layers = reference::Settings { samples, ..*settings }.layers(scene, &scene.camera)?;
        layers.write(path)?;
        Ok(Some(path.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::Method;

    #[test]
    fn layers_are_written_and_other_methods_names_and_animations_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("layers.exr");
        let mut scene = Scene::open(std::path::Path::new("lamps")).unwrap();
        (scene.camera.width, scene.camera.height) = (8, 6);
        let args = PathArgs { tree: None, layers: Some(path.clone()) };
        let settings = reference::Settings { samples: 1, ..reference::Settings::default() };
        assert_eq!(args.write(&scene, &settings).unwrap(), Some(path.clone()));
        assert!(path.exists());
        let named = |name| MethodArg(Method::find(name));
        args.check(MethodArg(None), false).unwrap();
        for (args, method, animated, what) in [
            (&args, named("lights"), false, "--layers"),
            (&args, named("reference"), true, "animation"),
            (&PathArgs { tree: Some(1), layers: None }, named("environment"), false, "--tree"),
            (&PathArgs { tree: None, layers: Some("layers.png".into()) }, MethodArg(None), false, ".exr"),
        ] {
            let error = args.check(method, animated).unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains(what), "{error}");
        }
    }
}
