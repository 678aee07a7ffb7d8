//! The table of methods. A new one is a folder here and a row of [`METHODS`].

use super::{Renderer, environment, incident, lights, reference};
use crate::scene::{Scene, Varies};
use lobelia_base::error::{Error, Result};

/// The settings of every method.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Settings {
    /// The path tracer's.
    pub reference: reference::Settings,
    /// Those of the raster.
    pub lights: lights::Settings,
    /// Those of prefiltered environments.
    pub environment: environment::Settings,
    /// Those of near lights by samples of incident radiance.
    pub incident: incident::Settings,
}

/// One of a method's settings that trade time for error.
pub struct Variant {
    /// What it is drawn as in charts: the method, or one of several families of its settings.
    pub series: &'static str,
    /// The setting.
    pub name: String,
    /// Whether the choice by error weighs it, or charts alone show it.
    pub weighed: bool,
    /// The renderer.
    pub renderer: Box<dyn Renderer>,
}

/// A row of the table: what is known of a method before it is used.
#[derive(Debug)]
pub struct Method {
    /// Its name in files and on the command line.
    pub name: &'static str,
    /// One line.
    pub summary: &'static str,
    /// What it draws, and where.
    pub draws: &'static str,
    /// What it can vary from frame to frame.
    pub varies: Varies,
    /// What of a scene it cannot draw, by name; empty where it draws it.
    pub cannot_draw: fn(&Scene) -> Vec<String>,
    /// Whether it stores what it prepares.
    pub bakes: bool,
    /// The renderer by the settings given.
    pub renderer: fn(&Settings) -> Box<dyn Renderer>,
    /// Its settings that `chart render` shows for a scene, and those that the choice by error weighs.
    pub variants: fn(&Scene, &Settings) -> Vec<Variant>,
}

impl PartialEq for Method {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

/// The method that judges the others.
pub static REFERENCE: &Method = &METHODS[0];

/// All methods.
pub static METHODS: [Method; 4] = [
    Method {
        name: "reference",
        summary: "Path tracer on the CPU",
        draws: "all lights, environment, shadows, interreflection",
        varies: Varies::ALL,
        cannot_draw: |_| Vec::new(),
        bakes: false,
        renderer: |settings| Box::new(settings.reference),
        variants: |_, settings| reference::variants(&settings.reference),
    },
    Method {
        name: "lights",
        summary: "Raster on the GPU",
        draws: "point, directional, rectangular lights (6.9), with shadows",
        varies: Varies::ALL,
        cannot_draw: lights::cannot_draw,
        bakes: false,
        renderer: |settings| Box::new(settings.lights),
        variants: |_, settings| lights::variants(&settings.lights),
    },
    Method {
        name: "environment",
        summary: "Prefiltered environment maps, on the CPU or the GPU",
        draws: "environment by prefiltered maps (6.13)–(6.18), lights as in `lights`, with shadows on the \
             GPU",
        varies: Varies::ALL,
        cannot_draw: |scene| scene.beyond_lobes().into_iter().collect(),
        bakes: true,
        renderer: |settings| Box::new(settings.environment),
        variants: |scene, settings| environment::variants(scene, &settings.environment),
    },
    Method {
        name: "incident",
        summary: "Near lights by samples of incident radiance and baked transfer, on the CPU",
        draws: "diffuse light of rectangular lights beside the objects, or of an environment, with soft \
             shadows",
        varies: Varies { objects: false, ..Varies::ALL },
        cannot_draw: incident::cannot_draw,
        bakes: true,
        renderer: |settings| Box::new(settings.incident),
        variants: |scene, settings| incident::variants(scene, &settings.incident),
    },
];

/// Refuses, for a renderer by the name of its row, a scene that it cannot draw.
pub(super) fn check(renderer: &dyn Renderer, scene: &Scene) -> Result<()> {
    Method::find(renderer.name()).map_or(Ok(()), |method| method.check(scene))
}

impl Method {
    /// The row of a name.
    pub fn find(name: &str) -> Option<&'static Self> {
        METHODS.iter().find(|method| method.name == name)
    }

    /// Refuses a scene that it cannot draw.
    ///
    /// # Errors
    /// An input error that names what it cannot draw, and the methods that can.
    pub fn check(&self, scene: &Scene) -> Result<()> {
        let cannot = (self.cannot_draw)(scene);
        if cannot.is_empty() {
            return Ok(());
        }
        let others = METHODS.iter().filter(|other| (other.cannot_draw)(scene).is_empty());
        let others: Vec<&str> = others.map(|other| other.name).collect();
        Err(Error::input(format!(
            "`{}` does not draw {}; use --method {}",
            self.name,
            cannot.join(", "),
            others.join(" or ")
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_find_their_rows_and_renderers_know_their_names() {
        for method in &METHODS {
            assert_eq!(Method::find(method.name).unwrap(), method);
            assert_eq!((method.renderer)(&Settings::default()).name(), method.name);
        }
        assert_eq!((REFERENCE.name, Method::find("auto")), ("reference", None));
    }

    #[test]
    fn a_scene_that_a_method_cannot_draw_is_refused_by_what_it_is_and_others_are_named() {
        let mut scene = crate::scene::showcase::published(8, 6);
        let others = METHODS.iter().filter(|method| method.name != "incident");
        others.for_each(|method| method.check(&scene).unwrap());
        scene.lights.clear();
        let error = Method::find("lights").unwrap().check(&scene).unwrap_err();
        let expected = "`lights` does not draw a scene that its environment alone lights; use --method \
             reference or environment";
        assert_eq!(error.to_string(), expected);
    }
}
