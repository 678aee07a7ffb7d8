//! `lobelia rig` on the simulated rig, from its command line on.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::path::Path;

use clap::Parser;

use super::*;
use crate::cli::{Cli, Command};
use crate::report::Report;

fn rig(line: &str) -> Result<Report> {
    let words = ["lobelia", "rig"].into_iter().chain(line.split_whitespace());
    let cli = Cli::try_parse_from(words).map_err(Error::format)?;
    let Command::Rig(args) = cli.command else { unreachable!("the words begin with `rig`") };
    let mut context =
        Context { seed: 1, given_seed: None, quiet: true, verbose: false, report: Report::new("rig", 1) };
    run(&args, &mut context)?;
    Ok(context.report)
}

/// A session with moves and exposures, recorded.
fn recorded(folder: &Path) -> PathBuf {
    let path = folder.join("session.jsonl");
    let line = format!("move --pan-deg -30 --light-deg 90 --home --port sim --record {}", path.display());
    rig(&line).unwrap();
    path
}

#[test]
fn a_move_ends_within_half_a_step_of_the_angles_asked_for() {
    let report = rig("move --port sim --home --pan-deg -30 --light-deg 100").unwrap();
    let angle = |name: &str| report.figures[name].as_f64().unwrap();
    assert!((angle("pan_deg") + 30.0).abs() < 0.0065, "{:?}", report.figures);
    assert!((angle("light_deg") - 100.0).abs() < 0.0008, "{:?}", report.figures);
    // Those not named stay at the limit next to their switches.
    assert!((angle("tilt_deg") + 90.0).abs() < 0.0065, "{:?}", report.figures);
}

#[test]
fn axes_that_are_not_named_stay_where_they_are() {
    let config = RigConfig::default();
    let now = [11, -12, 13, 40_000];
    let steps = drive::targets(&config, [None, Some(0.0), None, None], now).unwrap();
    assert_eq!(steps, [11, 0, 13, 40_000]);
}

#[test]
fn bad_input_exits_with_two_and_a_rig_that_is_not_ready_with_one() {
    let code = |line: &str| rig(line).unwrap_err().exit_code();
    assert_eq!(code("move --port sim --home --pan-deg 91"), 2);
    assert_eq!(code("move --port sim"), 2);
    assert_eq!(code("move --port sim --pan-deg 10"), 1);
    assert_eq!(code("expose 61 --port sim"), 2);
    assert_eq!(code("expose 0.1 --home --port sim"), 1);
    assert_eq!(code("lamp on --level 1.5 --port sim"), 2);
    assert_eq!(code("status --port /dev/no-such-port"), 2);
    assert_eq!(code("status --port sim --rig no-such-rig.toml"), 2);
    assert_eq!(code("replay no-such-trace --port sim"), 2);
    let unknown = rig("move --port sim --pan-deg 10").unwrap_err().to_string();
    assert!(unknown.contains("home the rig first"), "{unknown}");
}

#[test]
fn every_look_and_drive_succeeds_on_a_fresh_simulated_rig() {
    for line in [
        "status --port sim",
        "status --port sim --watch --for-s 3",
        "home --port sim --approaches 2",
        "lamp on --port sim --level 0.5",
        "lamp off --port sim",
        "clear --port sim",
        "monitor --port sim --for-s 2",
        "monitor --port sim --for-s 2 --telemetry-s 0.1",
        "params --port sim",
        "params",
    ] {
        rig(line).unwrap_or_else(|error| panic!("{line}: {error}"));
    }
}

#[test]
fn the_lamp_is_waited_for_and_a_dark_exposure_lasts_as_asked() {
    assert_eq!(rig("lamp on --port sim").unwrap().figures["warm"], true);
    assert_eq!(rig("lamp on --port sim --no-wait").unwrap().figures["warm"], false);
    let report = rig("expose 0.25 --dark --home --port sim").unwrap();
    assert_eq!(report.figures["open_us"], 250_000);
}

#[test]
fn conformance_of_the_simulated_rig_has_no_failure() {
    let report = rig("conformance --port sim").unwrap();
    assert_eq!(report.figures["failed"], 0);
}

#[test]
fn a_replayed_session_is_the_same_even_in_its_times() {
    let folder = tempfile::tempdir().unwrap();
    let trace = recorded(folder.path());
    let report = rig(&format!("replay {} --exact --port sim", trace.display())).unwrap();
    assert!(report.figures["requests"].as_u64().unwrap() >= 4);
}

#[test]
fn an_altered_answer_is_found_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let trace = recorded(folder.path());
    let text = std::fs::read_to_string(&trace).unwrap();
    let moved = text.lines().last().unwrap();
    assert!(moved.contains("MoveTo"), "{moved}");
    // The answer only: the request stays as it was.
    let place = moved.rfind("\"At\":[").unwrap() + 6;
    let altered = format!("{}1{}", &moved[..place], &moved[place..].trim_start_matches('-'));
    std::fs::write(&trace, text.replace(moved, &altered)).unwrap();
    let error = rig(&format!("replay {} --port sim", trace.display())).unwrap_err();
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().ends_with(": 1"), "{error}");
}

#[test]
fn a_trace_that_is_torn_or_of_another_protocol_is_bad_input_that_names_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let trace = recorded(folder.path());
    let text = std::fs::read_to_string(&trace).unwrap();
    std::fs::write(&trace, &text[..text.len() - 9]).unwrap();
    let error = rig(&format!("replay {} --port sim", trace.display())).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains(&format!("line {}", text.lines().count())), "{error}");
    std::fs::write(&trace, text.replacen("\"version\":", "\"version\":9", 1)).unwrap();
    let error = rig(&format!("replay {} --port sim", trace.display())).unwrap_err();
    assert!(error.to_string().contains("record it again"), "{error}");
}

#[test]
fn parameters_are_a_table_with_a_column_an_axis() {
    let table = crate::rig::parameters::table(&RigConfig::default().configuration().unwrap());
    let row = table.lines().find(|line| line.starts_with("max_speed")).unwrap();
    let cells: Vec<_> = row.split_whitespace().collect();
    assert_eq!(cells, ["max_speed", "steps/s", "4651", "4651", "4651", "12500"]);
}

#[test]
fn rig_is_made_safe_whatever_its_version() {
    let report = rig("safe --port sim --stop --darken").unwrap();
    assert_eq!((&report.figures["moving"], &report.figures["lamp"]), (&false.into(), &false.into()));
}
