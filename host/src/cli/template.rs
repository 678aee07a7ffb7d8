//! `lobelia template`: example files to start from.

use clap::{Args, ValueEnum};

use crate::error::{Error, Result};
use crate::rig::config::RigConfig;

/// Arguments of `lobelia template`.
#[derive(Debug, Args)]
pub(super) struct TemplateArgs {
    /// Which file
    kind: Kind,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// rig.toml: axes, camera, lamp, carrier
    Rig,
    /// A material recipe for the simulator
    #[cfg(feature = "sim")]
    Material,
    /// A scene to render
    Scene,
}

/// Runs `lobelia template`.
pub(super) fn run(args: &TemplateArgs) -> Result<()> {
    let written = |text: std::result::Result<String, toml::ser::Error>| {
        text.map_err(|error| {
            Error::failure(format!("the example cannot be written: {error}")).caused_by(error)
        })
    };
    match args.kind {
        Kind::Rig => {
            let rig = with_comments(&written(toml::to_string(&RigConfig::default()))?);
            print!("{RIG_HEADING}{rig}{RIG_DRIVER}");
        }
        #[cfg(feature = "sim")]
        Kind::Material => {
            print!("{MATERIAL_HEADING}{}", written(toml::to_string(&crate::demo::sample::recipe()))?);
        }
        Kind::Scene => print!("{}", include_str!("../../../examples/scene.toml")),
    }
    Ok(())
}

const RIG_HEADING: &str = "# A rig. Lengths in mm, angles in degrees, times in s. Keys and tables left out \
     keep the values shown here; the table of an axis, as\n# [axes.pan], is left out as a whole or has all \
     of them.\n";

const RIG_DRIVER: &str = "
# An axis that is homed otherwise than usual may have:
# [axes.pan.homing]
# end = \"lower\"             # of the travel, at which its switch is; with \"upper\" \
home_deg is above max_deg
# speed_deg_s = 20.0        # of the first search: a third of max_speed_deg_s unless it is said
# slow_speed_deg_s = 1.0    # of the measuring: a sixtieth
# back_off_deg = 1.0        # before the measuring
# debounce_ms = 3.0         # the switch counts once it has been closed, or open, for so long
# index_tolerance_steps = 4 # a check of the position passes within so many

# An axis whose TMC2209 is on the controller's wire (its address: 0 pan, 1 tilt, 2 roll, 3 light) may have:
# [axes.pan.driver]
# run_ma = 800              # current of a phase while it turns
# hold_ma = 400             # and at rest
# sense_mohm = 110          # its sense resistors
# microsteps = 16           # a full step; one of them is a step of degrees_per_step
# stall_threshold = 0       # how much load counts as a stall, to be found by trying; 0 for never
# stall_above_deg_s = 5.0   # stalls are looked for above this speed

# Two axes that would touch, as the light's arm and a panned carrier, may have, up to four times:
# [[keep_out]]
# first = \"light\"
# first_deg = [10.0, 40.0]
# second = \"pan\"           # of the two the one that can be homed wherever the other \
stands gets the lower home_order
# second_deg = [60.0, 90.0]
";

#[cfg(feature = "sim")]
const MATERIAL_HEADING: &str = "\
# A sample for the simulator. A material is `published = NAME`, `table = FILE.brdf`, or rho_d and lobes.
# Patterns: stripes (width_mm), checks (size_mm), weave (pitch_mm), image (path).
";

/// What the keys of a rig mean that do not say so themselves.
const COMMENTS: [(&str, &str); 43] = [
    ("home_deg", "angle of the home switch's edge, below min_deg"),
    (
        "home_switch_deg",
        "travel with the switch closed, down to the hard stop; closed for longer means stuck or a broken \
         wire",
    ),
    ("home_order", "axes with a lower number are homed first"),
    ("take_up_deg", "overshoot that takes up the backlash: every position is approached from below"),
    ("settle_s", "rest after a move before the rig counts as still"),
    (
        "repeatability_deg",
        "largest error of a position: how far the motors are trusted against the fiducials",
    ),
    ("full_turn", "whether the axis may take the shorter way round"),
    ("invert", "pins wired otherwise than the board's table says: step, direction, enable, home, alarm"),
    ("alarm", "driver's output: level (ALARM, ERR), edge (TMC's DIAG), none"),
    ("alarm_debounce_us", "it counts once it has lasted for so long"),
    ("most_turns", "that it may be wound up beyond its limits: what its cables bear"),
    ("coordinated", "all axes arrive at once"),
    ("check_every_poses", "a run looks for the home switches so often, and after the last pose; 0 for never"),
    ("pulse_us", "shortest time that a step pin stays high, and low: the longest that a driver wants"),
    ("direction_setup_us", "shortest time from a change of direction to the next step, likewise"),
    ("camera_distance_mm", "from the crossing of pan and tilt to the lens"),
    ("light_radius_mm", "of the light's arc about the same point"),
    ("carrier_offset_mm", "of the sample's surface above the crossing of pan and tilt"),
    ("carrier_slack_mm", "how far the carrier may lie from its place, one standard deviation"),
    ("focal_px", "focal lengths in pixels"),
    ("principal_px", "the centre of the first pixel is (0, 0)"),
    ("distortion", "Brown-Conrady k1, k2, p1, p2, k3"),
    ("black_level", "value of a pixel without light"),
    ("white_level", "value at which it saturates"),
    ("responsivity", "value above black a unit of radiance and second, for R, G, B"),
    ("electrons_per_value", "with the read noise, for the standard deviations of the samples"),
    ("read_noise_e", "electrons RMS"),
    ("aperture_diameter_mm", "of the lamp's disc, which faces the crossing of pan and tilt"),
    ("radiance", "of the warm lamp, for R, G, B"),
    ("reference_reading", "of the photodiode at that radiance"),
    ("warm_up_s", "before the lamp may be used"),
    ("safe_level", "of the lamp, 0 to 1, when the controller no longer hears its host"),
    ("longest_s", "the controller puts the lamp out when it has burnt for this long, whatever it hears"),
    ("fan_run_on_s", "when the lamp has gone out, where the controller has a fan"),
    ("texels_across", "the sample's width; rows follow from its height"),
    ("tag_size_mm", "outer edge of a tag's black border (family 36h11)"),
    (
        "exif",
        "how far a frame's EXIF exposure must be the controller's: \"nominal\" (a third of a stop), \
         \"exact\", \"ignore\"",
    ),
    (
        "ready_wait_s",
        "how long an exposure waits for the camera's ready output, where the controller has an input for it",
    ),
    ("count", "exposures a pose, 1 to 3"),
    ("darkest_reflectance", "1/sr that the longest exposure should still resolve"),
    ("brightest_reflectance", "1/sr that the shortest exposure must not clip"),
    ("highlight_deg", "between half vector and normal, within which the highlight is expected"),
    ("dark_frames", "averaged at the shortest and at the longest exposure each"),
];

/// The rig's file with a comment behind every key that needs one, the first time that it stands there.
fn with_comments(file: &str) -> String {
    let mut told = Vec::new();
    let mut text = String::new();
    for line in file.lines() {
        let key = line.split(" = ").next().unwrap_or_default();
        let comment = COMMENTS.iter().find(|(name, _)| *name == key && !told.contains(name));
        text += line;
        if let Some((name, comment)) = comment {
            told.push(name);
            text += &format!("  # {comment}");
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commented_rig_is_the_default_one_and_every_comment_stands_at_a_key() {
        let file = with_comments(&toml::to_string(&RigConfig::default()).unwrap());
        let read: RigConfig = crate::toml_file::parse(&file, "rig.toml").unwrap();
        assert_eq!(read, RigConfig::default());
        assert_eq!(file.matches("  # ").count(), COMMENTS.len());
    }

    #[test]
    fn the_example_driver_is_the_default_one() {
        let lines = RIG_DRIVER.lines().filter_map(|line| line.strip_prefix("# "));
        let lines = lines.filter(|line| !line.starts_with("An axis") && !line.starts_with("Two axes"));
        let rig = toml::to_string(&RigConfig::default()).unwrap();
        let file = rig + "\n" + &lines.collect::<Vec<_>>().join("\n");
        let read: RigConfig = crate::toml_file::parse(&file, "rig.toml").unwrap();
        assert_eq!(read.axes.pan.driver, Some(crate::rig::config::Driver::default()));
    }

    #[test]
    fn the_example_scene_can_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, include_str!("../../../examples/scene.toml")).unwrap();
        assert_eq!(crate::scene::Scene::read(&path).unwrap().objects.len(), 2);
    }
}
