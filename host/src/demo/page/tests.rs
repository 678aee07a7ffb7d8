//! The whole page of a tiny demo.

use std::sync::OnceLock;

use super::*;
use crate::acquire::{self, RunFolder, simulated};
use crate::demo::{Size, sample};
use crate::develop;
use crate::fit::figures::ErrorFigure;
use crate::fit::{self, FitOptions};
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
        let options = FitOptions::default();
        let map = fit::fit_sbrdf(&developed.sampled, &options).unwrap();
        let errors = truth::reflectance_errors(&rig, &bench, &map, &truth::unposed_pairs(1)[..20]);
        let fits = vec![FitOutcome {
            method: options.method,
            lobes: 1,
            separate_channels: false,
            map,
            seconds: 0.5,
            errors,
        }];
        let outcome = DemoOutcome { run, developed, bench, fits, registration_texels: vec![0.01, 0.02] };
        let mut report = Report::new("demo", 1);
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
    for id in ["head", "rendered", "frame", "texture", "texels", "maps", "errors", "timing"] {
        assert_eq!(page.matches(&format!("id=\"{id}\"")).count(), 1, "{id}");
    }
    assert_eq!(page.matches("<img ").count(), page.matches(" alt=\"").count());
    assert_eq!(page.matches("<figure>").count(), page.matches("</figure>").count());
    assert!(page.contains("A &amp; B") && page.contains("&lt;angles&gt;") && page.contains("0.0123"));
}

#[test]
fn no_number_is_written_as_nan_or_infinite() {
    let text = tiny_page().split("base64,").map(|part| part.split_once('"').map_or(part, |(_, rest)| rest));
    for part in text {
        assert!(!part.contains("NaN") && !part.contains("inf\"") && !part.contains("inf "), "{part}");
    }
}
