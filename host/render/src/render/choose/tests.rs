use super::*;
use crate::render::{bake, environment};
use crate::scene::{Background, Light, Material, Object, shapes};
use lobelia_reflectance::{LobeBrdf, Rgb};
use std::sync::Arc;

/// A grey plane under a lamp: one reflection is all there is.
fn plane() -> Scene {
    Scene {
        objects: vec![Object {
            name: "plane".into(),
            mesh: Arc::new(shapes::plane(1)),
            transform: glam::Affine3A::IDENTITY,
            material: Material::uniform(LobeBrdf::diffuse(Rgb::splat(0.5))),
        }],
        lights: vec![Light::Point { position: glam::Vec3::Y * 2.0, intensity: Rgb::ONE }],
        environment: None,
        background: Background::Colour(Rgb::splat(0.1)),
        camera: Camera {
            position: glam::Vec3::new(0.0, 3.0, 0.5),
            target: glam::Vec3::ZERO,
            up: glam::Vec3::Z,
            fov: 0.8,
            width: 32,
            height: 24,
        },
        animation: None,
        parameters: vec![],
        exposure: 1.0,
    }
}

#[test]
fn a_loose_bound_takes_little_a_tight_one_more_and_both_are_met() {
    let scene = plane();
    let base = reference::Settings { samples: 1 << 20, seed: 5, ..Default::default() };
    let truth = judge(&base, 9, 256).render(&scene, &scene.camera).unwrap().picture;
    for max_error in [0.3, 0.02] {
        let settings = Settings { reference: base, ..Settings::default() };
        let model = Model::measure(&scene, &settings, &Work::ONCE).unwrap();
        let outcome = model.meet(&scene.state(), max_error).unwrap();
        let error = compare::compare(&outcome.rendering.picture, &truth).unwrap().relative_rmse;
        let last = taken(&outcome.tried).unwrap();
        assert!(error < 1.1 * max_error, "{error} for {max_error}: {:?}", outcome.tried);
        assert!(last.method == outcome.chosen.method && last.actual.unwrap()[1] <= max_error);
    }
}

#[test]
fn interreflection_is_left_out_only_where_the_bound_allows_it() {
    // In a white furnace one reflection less shows.
    let mut scene = plane();
    scene.objects.push(scene.objects[0].clone());
    scene.objects[1].transform = glam::Affine3A::from_rotation_x(-1.2);
    let base = reference::Settings { samples: 1 << 20, seed: 5, ..Default::default() };
    let settings = Settings { reference: base, ..Settings::default() };
    let model = Model::measure(&scene, &settings, &Work::ONCE).unwrap();
    let bias = model.candidates[1].bias;
    assert!(bias > 0.02 && model.candidates[0].bias == 0.0, "{bias}");
    let outcome = model.meet(&scene.state(), 0.5 * bias).unwrap();
    assert_eq!(outcome.chosen.method, REFERENCE);
    assert!(outcome.rendering.estimated_error().unwrap() <= 0.5 * bias);
    assert!(outcome.tried.iter().all(|tried| tried.actual.is_none() || !tried.name.starts_with("no inter")));
}

/// Baking for 60 s pays for frames of 1 s instead of 3 from 30 on; with the light changed between them,
/// which costs 1 s and nothing, from 60 on.
#[test]
fn what_is_used_often_may_take_long_to_bake() {
    let candidate = |name: &str, [bake_seconds, light_seconds, seconds]: [f64; 3]| Candidate {
        method: REFERENCE,
        name: name.into(),
        player: Some(Shared(Rc::new(RefCell::new(
            reference::Settings::default().prepare(&plane()).unwrap(),
        )))),
        paths: reference::Settings::default(),
        bake_seconds,
        prepare_seconds: 0.0,
        light_seconds,
        view_seconds: seconds,
        seconds: 0.0,
        bias: 0.01,
        noise: 0.0,
    };
    let candidates = [candidate("bakes", [60.0, 1.0, 1.0]), candidate("does not", [0.0, 0.0, 3.0])];
    let first = |frames: u32, light_changes: u32| {
        let uses = Uses { frames, light_changes };
        let order = order(&candidates, &plane().camera, 0.1, 64, uses);
        let whole = if frames == 40 { order[0].2.predicted[0] } else { 0.0 };
        (order[0].2.name.clone(), whole)
    };
    assert_eq!(first(1, 0).0, "does not");
    assert_eq!((first(29, 0).0.as_str(), first(31, 0).0.as_str()), ("does not", "bakes"));
    assert_eq!((first(40, 0), first(40, 40)), (("bakes".into(), 100.0), ("does not".into(), 120.0)));
    assert_eq!(first(61, 60).0, "bakes");
}

/// An hour of baking for what the path tracer does in less than a second is not begun.
#[test]
fn baking_that_cannot_pay_is_left_out_and_said_to_be() {
    struct Slow;
    impl Renderer for Slow {
        fn name(&self) -> &'static str {
            "lights"
        }
        fn expected_bake_seconds(&self, _: &Scene) -> Option<f64> {
            Some(3600.0)
        }
        fn open(&self, scene: &Scene, _: &Baked) -> Result<Box<dyn Player>> {
            reference::Settings { samples: 1, ..Default::default() }.prepare(scene)
        }
    }
    let scene = plane();
    let lights = Method::find("lights").unwrap();
    let of = |uses: Uses| {
        let variant =
            Variant { series: "lights", name: "slow".into(), weighed: true, renderer: Box::new(Slow) };
        let work = Work { uses, max_error: Some(0.1), ..Work::ONCE };
        let settings = Settings::default();
        Model::measure_of(&scene, &settings, &work, vec![(lights, variant)]).unwrap()
    };
    let model = of(Uses::ONCE);
    let (method, name, error) = model.refused().next().unwrap();
    assert_eq!((method, name, model.ready().count()), (lights, "slow", 0));
    assert!(error.to_string().contains("baking is expected to take"), "{error}");
    let often = of(Uses { frames: 1 << 30, light_changes: 0 });
    assert_eq!((often.refused().count(), often.ready().count()), (0, 1));
}

#[test]
fn what_was_baked_before_costs_nothing_to_bake() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = plane();
    scene.environment = Some(crate::scene::Environment::from_function(64, 32, |d| Rgb::splat(1.5 + d.y)));
    let environment = environment::Settings { map_error: 0.1, samples: 1, ..Default::default() };
    let settings = Settings { environment, ..Settings::default() };
    let task = bake::Task { folder: folder.path(), chunk: None, estimate_only: false };
    bake::bake(&environment, &scene, task, |_| ()).unwrap();
    let work = Work { baked: Some(folder.path()), ..Work::ONCE };
    let variants = environment::variants(&scene, &environment).into_iter().take(4);
    let method = Method::find("environment").unwrap();
    let variants = variants.map(|variant| (method, variant)).collect();
    let model = Model::measure_of(&scene, &settings, &work, variants).unwrap();
    let bake = |name: &str| model.candidates.iter().find(|one| one.name == name).unwrap().bake_seconds;
    assert_eq!((bake("slices"), bake("MIP levels") > 0.0), (0.0, true));
}
