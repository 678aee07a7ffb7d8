//! Small scenes that come with the program: shapes, environments and materials are computed.

/// Name, what it shows, and the scene file.
pub const SCENES: [(&str, &str, &str); 10] = [
    (
        "studio-ball",
        "a ball of blue paint in a studio",
        include_str!("../../../../examples/scenes/studio-ball.toml"),
    ),
    (
        "sky-drape",
        "a woven cloth over a form in the open, under sky and sun",
        include_str!("../../../../examples/scenes/sky-drape.toml"),
    ),
    (
        "lamps",
        "a cloth and a ball under three small lamps",
        include_str!("../../../../examples/scenes/lamps.toml"),
    ),
    (
        "window",
        "balls in a coloured room, lit by a rectangular window and by its walls",
        include_str!("../../../../examples/scenes/window.toml"),
    ),
    (
        "panels",
        "a cloth and a ball between coloured panels close by, some of which hide others",
        include_str!("../../../../examples/scenes/panels.toml"),
    ),
    (
        "metal-row",
        "balls of lobes with n from 1 to 1000 in a studio",
        include_str!("../../../../examples/scenes/metal-row.toml"),
    ),
    (
        "gallery",
        "cloths, balls and panels of twelve materials, 285,000 triangles",
        include_str!("../../../../examples/scenes/gallery.toml"),
    ),
    (
        "teapot",
        "Newell's teapot in Bézier patches on a saucer turned on a lathe",
        include_str!("../../../../examples/scenes/teapot.toml"),
    ),
    (
        "glass-mirror",
        "glass, tinted water, a mirror and gold in a room with a shining panel",
        include_str!("../../../../examples/scenes/glass-mirror.toml"),
    ),
    (
        "lanterns",
        "three hundred shining balls about a cloth on a polished floor",
        include_str!("../../../../examples/scenes/lanterns.toml"),
    ),
];

/// The scene file of a name.
pub fn find(name: &str) -> Option<&'static str> {
    SCENES.iter().find(|scene| scene.0 == name).map(|scene| scene.2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use std::path::Path;

    #[test]
    fn every_shipped_scene_can_be_opened_and_other_names_are_refused_with_the_list() {
        for (name, ..) in SCENES {
            let scene = Scene::open(Path::new(name)).unwrap();
            assert!(!scene.objects.is_empty());
            let shines = scene.objects.iter().any(|object| object.material.emission.is_some());
            assert!(!scene.lights.is_empty() || scene.environment.is_some() || shines);
        }
        let error = Scene::open(Path::new("studio-bal")).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("studio-ball"), "{error}");
    }
}
