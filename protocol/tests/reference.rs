//! `docs/protocol.md` tells of every message, and of this very schema.

mod samples;

use lobelia_protocol::schema;

const REFERENCE: &str = include_str!("../../docs/protocol.md");

/// Names of variants in a debug print: capitalised words.
fn names(debug: &str) -> impl Iterator<Item = &str> {
    let words = debug.split(|letter: char| !letter.is_alphanumeric());
    words.filter(|word| word.len() > 1 && word.starts_with(char::is_uppercase))
}

/// `LOBELIA_RENEW=1` writes it anew.
#[test]
fn the_reference_has_this_schema() {
    let begin = "\n```\nversion ";
    let (before, _) = REFERENCE.split_once(begin).expect("a block with the schema");
    let expected = format!("{before}{begin}{}\n{}```\n", schema::VERSION, schema::TEXT);
    if std::env::var_os("LOBELIA_RENEW").is_some() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/protocol.md");
        std::fs::write(path, expected).expect("the page can be written");
        return;
    }
    assert!(REFERENCE == expected, "renew it with LOBELIA_RENEW=1 cargo test -p lobelia-protocol");
}

#[test]
fn every_message_is_in_the_reference() {
    // Types, and variants of what the schema describes well enough.
    let known = [
        "Hello",
        "HelloReply",
        "Request",
        "Response",
        "Event",
        "Some",
        "None",
        "Negative",
        "Positive",
        "Watchdog",
        "Pan",
        "Tilt",
        "Roll",
        "Light",
        "Settings",
        "AxisParameters",
        "DriverParameters",
        "Exposure",
        "HomingReport",
        "LampStatus",
        "FaultReport",
        "CrashRecord",
        "LogLine",
        "Faults",
        "Accepted",
        "DifferentSchema",
        "Duration",
        "HomingFailed",
        "KeepOut",
    ];
    let mut missing = Vec::new();
    let packets = samples::to_controller().into_iter().map(|packet| format!("{packet:?}"));
    let packets = packets.chain(samples::to_host().into_iter().map(|packet| format!("{packet:?}")));
    for packet in packets {
        let unknown = |name: &&str| !known.contains(name) && !REFERENCE.contains(&format!("`{name}`"));
        missing.extend(names(&packet).filter(unknown).map(str::to_owned));
    }
    assert_eq!(missing, Vec::<String>::new(), "not in docs/protocol.md");
}
