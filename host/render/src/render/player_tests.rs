//! Frames of a player against the scene made ready anew in each frame's state.

use super::*;
use crate::scene::{Environment, Light, Parameter, Placement, Texture, shapes, showcase, state::Drive};
use lobelia_reflectance::Rgb;

/// A scene with every kind of light, of whose parameter dims one.
fn scene() -> Scene {
    let mut scene = showcase::published(24, 18);
    // As coarse as it may be: a raster in software takes its time for each triangle.
    scene.objects[..2].iter_mut().for_each(|object| object.mesh = shapes::sphere(16, 8).into());
    scene.environment = Some(Environment::from_function(32, 16, |d| {
        Vec3::new(0.5 + 0.4 * d.x, 0.4 + 40.0 * (20.0 * (d.y - 1.0)).exp(), 0.3 + 0.2 * d.z)
    }));
    let edges = [Vec3::new(0.0, 0.0, -0.7), Vec3::new(0.5, -0.6, 0.0)];
    scene.lights.push(Light::Rectangle {
        centre: Vec3::new(2.2, 2.6, 0.6),
        edges,
        radiance: Rgb::splat(4.0),
    });
    let dimmed = Placement { dim: 0.25, ..Placement::default() };
    let drive = Drive { turn: 0.2, lights: vec![(1, dimmed)], objects: vec![] };
    scene.parameters = vec![Parameter { name: "evening".into(), range: [0.0, 1.0], value: 0.5, drive }];
    scene
}

/// States one after another, each with what it asks to be done again.
fn states(scene: &Scene) -> Vec<(State, Vec<&'static str>)> {
    let mut state = scene.state();
    let mut states = vec![(state.clone(), vec![])];
    let mut next = |change: &dyn Fn(&mut State), redone: &[&'static str]| {
        change(&mut state);
        states.push((state.clone(), redone.to_vec()));
    };
    next(&|state| state.camera.position.x += 0.3, &[]);
    next(&|state| state.turn = 0.8, &["turn"]);
    next(&|state| state.lights[0].turn.y = 0.5, &["lights"]);
    next(&|state| state.lights[2].dim = 0.5, &["lights"]);
    next(&|state| state.lights[2].shift.x = -0.4, &["tree", "lights"]);
    next(&|state| state.objects[1].shift.y = 0.2, &["tree"]);
    next(&|state| state.parameters[0] = 1.0, &["lights", "turn"]);
    states
}

/// Plays all states, each against a player that is made for it alone; `same` says whether two pictures agree.
fn play(renderer: &dyn Renderer, same: impl Fn(&Picture, &Picture) -> bool) {
    let scene = scene();
    let Ok(mut player) = renderer.prepare(&scene) else {
        return println!("skipped: no GPU");
    };
    let mut before: Option<Picture> = None;
    for (k, (state, redone)) in states(&scene).into_iter().enumerate() {
        let rendering = player.frame(&state).unwrap();
        assert_eq!(rendering.redone, redone, "frame {k}");
        let mut placed = scene.at(&state).unwrap();
        placed.parameters.clear();
        let anew = renderer.render(&placed, &placed.camera).unwrap();
        assert!(same(&rendering.picture, &anew.picture), "frame {k} of {}", renderer.name());
        // A picture that did not change would agree with one that was forgotten. The raster's background is
        // behind a backdrop here.
        let hidden = renderer.name() == "lights" && redone == ["turn"];
        let last = before.replace(rendering.picture.clone());
        assert!(hidden || last.is_none_or(|last| last != rendering.picture), "frame {k} is that before");
    }
}

#[test]
fn the_path_tracers_frames_are_those_of_the_scene_in_that_state_and_redo_what_changed() {
    let settings = reference::Settings { samples: 4, bounces: 3, ..Default::default() };
    play(&settings, |a, b| a == b);
}

/// A mesh that shines is a light as well: dimmed, it is one of less emission, and moved, its triangles are
/// sampled where they stand now.
#[test]
fn a_mesh_that_shines_is_dimmed_and_moved_as_if_the_scene_had_it_so() {
    let mut scene = scene();
    let bright = Texture::Texels(2, 1, [1.0, 3.0].map(Rgb::splat).into());
    scene.objects[1].material.emission = Some(bright.clone());
    let settings = reference::Settings { samples: 4, bounces: 3, ..Default::default() };
    let mut player = settings.prepare(&scene).unwrap();
    let mut state = scene.state();
    let first = player.frame(&state).unwrap().picture;

    state.objects[1].dim = 0.5;
    let dimmed = player.frame(&state).unwrap();
    let mut placed = Scene { parameters: vec![], ..scene.at(&scene.state()).unwrap() };
    placed.objects[1].material.emission = Some(Texture::Texels(2, 1, [0.5, 1.5].map(Rgb::splat).into()));
    let anew = settings.render(&placed, &placed.camera).unwrap().picture;
    assert_eq!(dimmed.redone, ["lights"]);
    assert!(dimmed.picture == anew && anew != first);

    state.objects[1].shift = Vec3::new(0.1, 0.3, 0.0);
    let moved = player.frame(&state).unwrap();
    placed.objects[1].transform.translation += glam::Vec3A::new(0.1, 0.3, 0.0);
    let anew = settings.render(&placed, &placed.camera).unwrap().picture;
    assert_eq!(moved.redone, ["tree"]);
    assert!(moved.picture == anew && anew != dimmed.picture);

    // What does not shine cannot be dimmed.
    state.objects[0].dim = 0.5;
    let error = player.frame(&state).unwrap_err().to_string();
    assert!(error.contains("does not shine"), "{error}");
}

/// A turn about +y is one of lookups in the maps, whose pixels stand in the image's own frame: nothing is
/// prefiltered again.
#[test]
fn prefiltered_frames_are_those_of_the_scene_in_that_state_and_a_turn_prefilters_nothing() {
    for harmonics in [false, true] {
        let settings = environment::Settings { map_error: 0.1, samples: 4, harmonics, ..Default::default() };
        play(&settings, |a, b| a == b);
    }
    let settings = environment::Settings { map_error: 0.02, samples: 1, ..Default::default() };
    let scene = scene();
    let mut player = settings.prepare(&scene).unwrap();
    let first = player.frame(&scene.state()).unwrap().cost;
    let turned = player.frame(&State { turn: 1.0, ..scene.state() }).unwrap().cost;
    assert_eq!((first.bake_seconds, first.baked_bytes), (turned.bake_seconds, turned.baked_bytes));
}

#[test]
fn the_rasters_frames_are_those_of_the_scene_in_that_state() {
    let same = |a: &Picture, b: &Picture| {
        let largest = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (a - b).abs().max_element());
        largest.fold(0.0, f32::max) < 1e-4
    };
    let lights = lights::Settings { samples: 1, ..Default::default() };
    play(&lights, same);
    play(&environment::Settings { gpu: true, map_error: 0.1, samples: 1, ..Default::default() }, same);
}
