//! The method against the path tracer, against a sample at every vertex, and against itself made ready anew.

use std::path::Path;

use glam::Affine3A;

use super::emitters::{of_lights, tests::rectangle};
use super::*;
use crate::render::bake::tests::files;
use crate::render::bake::{Task, bake};
use crate::render::{Method, compare, reference};
use crate::scene::{Material, Mesh, Object, Varies, shapes, showcase};
use lobelia_reflectance::LobeBrdf;

/// A ball on a sheet between two coloured panels, of which one hides a part of the other, and a distant one.
fn scene() -> Scene {
    let mut scene = showcase::published(64, 48);
    let given = scene.objects[0].clone();
    let object = |mesh: Mesh, transform: Affine3A, albedo: Vec3| Object {
        mesh: mesh.into(),
        transform,
        material: Material::uniform(LobeBrdf::diffuse(albedo)),
        ..given.clone()
    };
    scene.environment = None;
    scene.objects = vec![
        object(shapes::sphere(64, 32), Affine3A::IDENTITY, Vec3::new(0.7, 0.6, 0.5)),
        object(
            shapes::plane(40),
            Affine3A::from_scale_rotation_translation(
                Vec3::splat(1.6),
                glam::Quat::IDENTITY,
                Vec3::new(0.0, -1.02, 0.0),
            ),
            Vec3::splat(0.6),
        ),
    ];
    scene.lights = vec![
        rectangle(Vec3::new(-2.0, 0.6, 0.3), [1.5, 0.2], [1.2, 1.2], Vec3::new(6.0, 2.0, 1.0)),
        rectangle(Vec3::new(-1.75, 1.0, 0.5), [1.3, 0.1], [0.5, 0.5], Vec3::new(0.5, 1.0, 5.0)),
        rectangle(Vec3::new(4.0, 5.0, 6.0), [3.73, 0.6], [3.0, 3.0], Vec3::new(2.0, 3.0, 3.0)),
    ];
    scene.camera.position = Vec3::new(-1.5, 1.2, 6.0);
    scene.camera.target = Vec3::ZERO;
    scene.camera.fov = 0.6;
    scene
}

/// Bakes fast.
fn settings() -> Settings {
    Settings { rays: 1024, samples: 4, ..Settings::default() }
}

/// What a light change of a scene works on.
struct Made {
    receivers: Receivers,
    tree: Tree,
    transfers: Vec<f32>,
    emitters: Vec<Emitter>,
}

impl Made {
    fn new(scene: &Scene, settings: &Settings) -> Self {
        let baked = Baked::in_memory(settings, scene).unwrap();
        let receivers = Receivers::new(scene);
        let transfers = baking::transfers(&baked, receivers.len(), settings.degree as usize).unwrap();
        let (tree, emitters) = (Tree::new(&receivers.positions), of_lights(&scene.lights));
        Self { receivers, tree, transfers, emitters }
    }

    fn ground(&self) -> Ground<'_> {
        let degree = settings().degree as usize;
        Ground { receivers: &self.receivers, tree: &self.tree, transfers: &self.transfers, degree }
    }

    fn placed(&self, epsilon: f64, most: usize) -> samples::Samples {
        second_order::place(&self.ground(), &self.emitters, epsilon, most)
    }

    /// Errors of radiance of every `step`-th receiver over the bound, ascending.
    fn errors(&self, samples: &samples::Samples, step: usize) -> Vec<f64> {
        let (ground, irradiance) = (self.ground(), samples.irradiance(&self.ground()));
        let receivers: Vec<usize> = (0..self.receivers.len()).step_by(step).collect();
        let error = |receiver: usize| {
            let difference = irradiance[receiver].as_dvec3() - ground.exact(&self.emitters, receiver);
            difference.abs().max_element() * f64::from(self.receivers.brightness[receiver]) / samples.bound
        };
        let mut errors: Vec<f64> = receivers.into_par_iter().map(error).collect();
        errors.sort_by(f64::total_cmp);
        errors
    }
}

#[test]
fn a_picture_is_that_of_the_path_tracer_without_interreflection() {
    let scene = scene();
    let rendering = Settings { rays: 4096, samples: 16, ..settings() }.render(&scene, &scene.camera).unwrap();
    assert_eq!(rendering.note, None);
    let paths = reference::Settings { samples: 256, bounces: 1, ..Default::default() };
    let truth = paths.render(&scene, &scene.camera).unwrap();
    let error = compare::compare(&rendering.picture, &truth.picture).unwrap().relative_rmse;
    println!("relative RMSE {error}");
    assert!(error < 0.09, "{error}");
    // The shadow of the ball is what a degree holds least of.
    let low = Settings { degree: 2, ..settings() }.render(&scene, &scene.camera).unwrap();
    let coarse = compare::compare(&low.picture, &truth.picture).unwrap().relative_rmse;
    println!("degree 2: {coarse}");
    assert!(coarse > 1.2 * error, "{coarse}");
}

#[test]
fn errors_keep_to_epsilon_and_an_exhausted_tree_is_a_sample_at_every_vertex() {
    let made = Made::new(&scene(), &Settings { rays: 64, ..settings() });
    let mut before = 0;
    for epsilon in [0.05, 0.01] {
        let samples = made.placed(epsilon, usize::MAX);
        let errors = made.errors(&samples, 3);
        let (most, ninety_nine) = (errors[errors.len() - 1], errors[errors.len() * 99 / 100]);
        println!(
            "ε {epsilon}: {} taken, {} kept, 99 % {ninety_nine}, most {most}",
            samples.taken,
            samples.count()
        );
        assert!(samples.taken > 2 * before && samples.taken < made.receivers.len() / 2 && !samples.capped);
        assert!((0.1..1.0).contains(&ninety_nine) && most < 2.0, "{ninety_nine} {most}");
        before = samples.taken;
    }
    let small = Made::new(
        &Scene { objects: vec![scene().objects[0].clone()], ..scene() },
        &Settings { rays: 64, ..settings() },
    );
    let mut samples = small.placed(1e-12, usize::MAX);
    // Vertices of one place, at the poles and the seam, have one sample.
    assert!(samples.taken > 2 * small.receivers.len() - 300 && samples.taken % 2 == 1, "{}", samples.taken);
    samples.bound = 1.0;
    let errors = small.errors(&samples, 1);
    assert!(errors[errors.len() - 1] < 1e-5, "{}", errors[errors.len() - 1]);
    let capped = made.placed(0.01, 50);
    assert!(capped.capped && capped.taken <= 50);
}

/// The source's table 4.1, by our own scene: what a sample costs is another's, where they are is what counts.
#[test]
fn by_as_many_samples_the_sources_method_and_quantisation_err_by_more() {
    let study = Study::new(&scene(), &Settings { rays: 64, ..settings() }).unwrap();
    let truth = study.sample(Sampling::Every, usize::MAX);
    let ours = study.sample(Sampling::SecondOrder(0.05), usize::MAX);
    let error = |outcome: &Outcome| outcome.rmse(&truth) / truth.rms();
    println!("ours: {} samples, {}", ours.samples, error(&ours));
    let mut others = vec![("one", study.sample(Sampling::One, 1))];
    for (name, ancestors) in [("published", true), ("leaves alone", false)] {
        for oracle in [Oracle::Printed, Oracle::Product, Oracle::ScaleFree] {
            // The largest bound, of those halved, that takes as many samples.
            let at = |epsilon: f64| {
                study.sample(Sampling::Published { oracle, epsilon, ancestors }, 2 * ours.samples)
            };
            let outcomes = (0..30).map(|k| at(8.0 * 0.5f64.powi(k)));
            let enough = outcomes.into_iter().find(|outcome| outcome.samples >= ours.samples).unwrap();
            others.push((name, enough));
        }
    }
    for exponent in [1.0, 2.0, 4.0, 8.0] {
        others.push((
            "quantised",
            study.sample(Sampling::Quantised { exponent }, ours.samples.next_power_of_two()),
        ));
    }
    for (name, outcome) in &others {
        println!("{name}: {} samples, {}", outcome.samples, error(outcome));
        assert!(error(outcome) > 3.0 * error(&ours), "{name}");
    }
    assert_eq!(others[0].1.samples, 1);
    // To the end of the tree leaves alone are what every vertex has.
    let whole = Sampling::Published { oracle: Oracle::Printed, epsilon: 0.0, ancestors: false };
    assert!(error(&study.sample(whole, usize::MAX)) < 1e-6);
}

#[test]
fn far_lights_and_black_objects_take_one_sample_and_the_size_of_a_scene_is_nothing_to_it() {
    let fast = Settings { rays: 64, ..settings() };
    let with = |change: &dyn Fn(&mut Scene)| {
        let mut changed = scene();
        change(&mut changed);
        Made::new(&changed, &fast).placed(0.01, usize::MAX).taken
    };
    let far = |scene: &mut Scene| {
        scene.lights = vec![rectangle(Vec3::new(3000.0, 0.0, 0.0), [-1.57, 0.0], [900.0, 900.0], Vec3::ONE)];
    };
    assert_eq!(with(&far), 1);
    let black = |scene: &mut Scene| {
        for object in &mut scene.objects {
            object.material = Material::uniform(LobeBrdf::diffuse(Rgb::ZERO));
        }
    };
    assert_eq!(with(&black), 1);
    let as_it_is = with(&|_| ());
    for size in [0.1f32, 10.0] {
        let scaled = |scene: &mut Scene| {
            for object in &mut scene.objects {
                object.transform = Affine3A::from_scale(Vec3::splat(size)) * object.transform;
            }
            for light in &mut scene.lights {
                if let Light::Rectangle { centre, edges, .. } = light {
                    *centre *= size;
                    edges.iter_mut().for_each(|edge| *edge *= size);
                }
            }
        };
        let taken = with(&scaled);
        // Rounding of positions parts receivers at the median otherwise.
        assert!(taken.abs_diff(as_it_is) <= as_it_is / 30, "{size}: {taken} for {as_it_is}");
    }
}

#[test]
fn an_environment_alone_is_that_of_the_path_tracer_and_turns() {
    let mut scene = scene();
    scene.lights.clear();
    let sky = |d: Vec3| Vec3::new(1.0 + d.x, 0.6 + 3.0 * (8.0 * (d.y - 1.0)).exp(), 1.0 - 0.7 * d.z);
    scene.environment = Some(crate::scene::Environment::from_function(64, 32, sky).rotated(0.4));
    let mut player = settings().prepare(&scene).unwrap();
    let turned = State { turn: 1.3, ..scene.state() };
    let paths = reference::Settings { samples: 256, bounces: 1, ..Default::default() };
    for (state, redone) in [(scene.state(), vec![]), (turned, vec!["turn"])] {
        let rendering = player.frame(&state).unwrap();
        assert_eq!(rendering.redone, redone);
        let placed = scene.at(&state).unwrap();
        let truth = paths.render(&placed, &placed.camera).unwrap();
        let error = compare::compare(&rendering.picture, &truth.picture).unwrap().relative_rmse;
        println!("relative RMSE {error}");
        assert!(error < 0.03, "{error}");
    }
}

/// A change of the state, and what it asks to be done again.
type Change<'a> = (&'a dyn Fn(&mut State), &'a [&'static str]);

#[test]
fn frames_are_those_of_the_scene_in_that_state_and_views_take_no_samples() {
    let scene = scene();
    let coarse = Settings { rays: 64, samples: 1, degree: 4, epsilon: 0.1, ..settings() };
    let mut player = coarse.prepare(&scene).unwrap();
    let mut state = scene.state();
    let mut before: Option<Picture> = None;
    let changes: [Change<'_>; 5] = [
        (&|_| (), &[]),
        (&|state| state.camera.position.x += 0.4, &[]),
        (&|state| state.lights[1].shift.x = -0.1, &["lights"]),
        (&|state| state.lights[0].turn.y = 0.3, &["lights"]),
        (&|state| state.lights[2].dim = 0.2, &["lights"]),
    ];
    for (k, (change, redone)) in changes.into_iter().enumerate() {
        change(&mut state);
        let rendering = player.frame(&state).unwrap();
        let anew = coarse.render(&scene.at(&state).unwrap(), &state.camera).unwrap();
        assert!(rendering.picture == anew.picture, "frame {k}");
        assert_eq!(
            (rendering.redone, rendering.cost.light_seconds > 0.0),
            (redone.to_vec(), k != 1),
            "frame {k}"
        );
        assert!(before.replace(rendering.picture.clone()).is_none_or(|last| last != rendering.picture));
    }
    state.objects[1].shift.x = 0.1;
    let error = player.frame(&state).unwrap_err().to_string();
    assert!(error.contains("moved") && error.contains("object \""), "{error}");
}

#[test]
fn a_picture_of_a_folder_is_that_of_one_baked_in_memory_and_lights_may_change_without_baking_again() {
    let (temporary, mut scene) = (tempfile::tempdir().unwrap(), scene());
    let coarse = Settings { rays: 64, samples: 1, degree: 3, epsilon: 0.1, ..settings() };
    let made = |folder: &Path| {
        bake(&coarse, &scene, Task { folder, chunk: None, estimate_only: false }, |_| ()).unwrap();
        files(folder)
    };
    let folder = temporary.path().join("a");
    assert!(made(&folder) == made(&temporary.path().join("b")));
    scene.lights.pop();
    scene.objects[0].material = Material::uniform(LobeBrdf::diffuse(Rgb::splat(0.2)));
    let baked = Baked::open(&folder, &coarse, &scene).unwrap();
    let from_folder = coarse.open(&scene, &baked).unwrap().frame(&scene.state()).unwrap();
    assert!(from_folder.picture == coarse.render(&scene, &scene.camera).unwrap().picture);
    scene.objects[0].transform = Affine3A::from_scale(Vec3::splat(0.9));
    assert!(Baked::open(&folder, &coarse, &scene).unwrap_err().to_string().contains("the meshes"));
}

#[test]
fn lights_among_the_objects_are_told_of() {
    let mut scene = scene();
    let shift = Affine3A::from_translation(Vec3::new(0.0, 1.1, 0.0));
    scene.objects.push(Object {
        transform: shift * Affine3A::from_scale(Vec3::splat(20.0)),
        mesh: shapes::plane(2).into(),
        ..scene.objects[1].clone()
    });
    scene.lights.truncate(1);
    // Under a ceiling just above it, turned down.
    let Light::Rectangle { centre, edges, .. } = &mut scene.lights[0] else { panic!() };
    (*centre, *edges) = (Vec3::new(-1.2, 1.0, 0.0), [Vec3::X, Vec3::Z]);
    let coarse = Settings { rays: 64, samples: 1, degree: 2, epsilon: 0.5, ..settings() };
    let note = coarse.render(&scene, &scene.camera).unwrap().note.unwrap();
    assert!(note.contains("stand among the objects") && note.contains("--method reference"), "{note}");
}

#[test]
fn what_it_cannot_draw_or_vary_is_refused_by_name() {
    let method = Method::find("incident").unwrap();
    let published = showcase::published(8, 6);
    let error = method.check(&published).unwrap_err().to_string();
    for what in ["directional lights", "point lights", "materials that are not diffuse alone"] {
        assert!(error.contains(what), "{error}");
    }
    method.check(&scene()).unwrap();
    let both = Scene { environment: published.environment.clone(), ..scene() };
    assert!(
        method.check(&both).unwrap_err().to_string().contains("an environment beside rectangular lights")
    );
    assert_eq!(Varies { objects: false, ..Varies::ALL }, method.varies);
    for wrong in [
        Settings { degree: 9, ..settings() },
        Settings { epsilon: 0.0, ..settings() },
        Settings { rays: 1, ..settings() },
    ] {
        assert!(wrong.render(&scene(), &scene().camera).is_err());
    }
}
