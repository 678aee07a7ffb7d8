//! The whole page of a tiny demo.

use std::sync::OnceLock;

use super::*;
use crate::acquire::{self, RunFolder, simulated};
use crate::by_angle::Cone;
use crate::chart::compared::{COMPARED, Compared};
use crate::demo::fits::Fits;
use crate::demo::{Settings, Size, sample};
use crate::develop;
use crate::figures::ErrorFigure;
use crate::plan::{self, Extent};

/// A demo of few texels and poses, and its page with one rendered picture.
fn tiny_page() -> &'static str {
    static PAGE: OnceLock<String> = OnceLock::new();
    PAGE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut rig = Size::Small.rig(1);
        rig.carrier.texels_across = 16;
        let layout = || sample::recipe().layout(Path::new("."), &rig.carrier).unwrap();
        let plan = plan::make(&rig, Extent::Budget(6), true, 1).unwrap();
        let (run, mut journal) = RunFolder::create(folder.path(), &plan, &rig).unwrap();
        acquire::run(&run, &mut journal, &mut simulated::station(&rig, layout()).unwrap()).unwrap();
        let run = RunFolder::open(folder.path()).unwrap();
        let developed = develop::run(folder.path()).unwrap();
        let bench = simulated::bench(&rig, layout());
        let cone = Cone::of_poses(&developed.sampled.poses, &plan);
        let mut report = Report::new("demo", 1);
        let settings = Settings::new(Size::Small, 1);
        let fits = Fits::make(&developed.sampled, &settings, (&bench, &cone), &mut report).unwrap();
        let outcome =
            DemoOutcome { run, developed, bench, fits, cone, registration_texels: vec![0.01, 0.02] };
        report.stage("a stage with <angles>", || ());
        report.errors.push(ErrorFigure::new("registration_rms", 0.0123, "texel", "6 poses"));
        let png = html::Raster::opaque(2, 2, |_| [1, 2, 3]).png().unwrap();
        let rendered = Rendered { title: "A & B".into(), caption: "by hand".into(), png };
        page(&outcome, &report, &[rendered]).unwrap()
    })
}

#[test]
fn the_page_needs_no_other_file_and_no_network() {
    let page = tiny_page();
    assert!(!page.contains("http:") && !page.contains("https:") && !page.contains("url("));
    for address in page.split("src=\"").skip(1).chain(page.split("href=\"").skip(1)) {
        assert!(address.starts_with("data:image/png;base64,"), "{}", &address[..40]);
    }
    assert!(!page.contains("<script") && !page.contains("<link"));
}

#[test]
fn all_sections_are_there_and_every_picture_is_described() {
    let page = tiny_page();
    for id in [
        "head",
        "rendered",
        "frame",
        "texture",
        "texels",
        "maps",
        "errors",
        "angles",
        "registration",
        "timing",
    ] {
        assert_eq!(page.matches(&format!("id=\"{id}\"")).count(), 1, "{id}");
    }
    assert_eq!(page.matches("<img ").count(), page.matches(" alt=\"").count());
    assert_eq!(page.matches("<figure>").count(), page.matches("</figure>").count());
    assert!(page.contains("A &amp; B") && page.contains("&lt;angles&gt;") && page.contains("0.0123"));
}

#[test]
fn methods_stand_beside_each_other_with_the_same_numbers_of_lobes_and_maps_tell_what_the_fit_doubts() {
    let page = tiny_page();
    let part = |id: &str| {
        page.split(&format!("<section id=\"{id}\"")).nth(1).unwrap().split("</section>").next().unwrap()
    };
    let errors = part("errors");
    let (one, two) = errors.split_once("Two lobes and more").unwrap();
    assert_eq!((one.matches("<svg").count(), two.matches("<svg").count()), (4, 3));
    for Compared { name, .. } in COMPARED {
        assert!(errors.contains(&format!("<td>{name}</td>")) && part("angles").contains(name), "{name}");
    }
    for map in ["σ of ρ<sub>d</sub>", "σ of n", "tied", "bounded", "number of lobes", "lobes.doubtful"] {
        assert!(part("maps").contains(map), "{map}");
    }
    assert!(part("angles").contains("inside") && part("angles").contains("outside"));
}

#[test]
fn poses_have_the_numbers_of_their_files() {
    let frame = tiny_page().split("id=\"frame\"").nth(1).unwrap();
    let number = |after: &str| -> usize {
        let digits: String =
            frame.split(after).nth(1).unwrap().chars().take_while(char::is_ascii_digit).collect();
        digits.parse().unwrap()
    };
    assert_eq!(number("Pose "), number("frames/pose-"));
}

#[test]
fn no_number_is_written_as_nan_or_infinite() {
    let text = tiny_page().split("base64,").map(|part| part.split_once('"').map_or(part, |(_, rest)| rest));
    for part in text {
        assert!(!part.contains("NaN") && !part.contains("inf\"") && !part.contains("inf "), "{part}");
    }
}
