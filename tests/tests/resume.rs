//! A run killed anywhere and resumed gives the sampled SBRDF of one that was not, byte for byte.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use lobelia::acquire::journal::{self, ExposureRecord, Record};
use lobelia::acquire::simulated::{self, TRUTH_FILE};
use lobelia_tests::command::{lobelia, run, succeed};
use lobelia_tests::folder;
use lobelia_tests::small::{self, Random};
use rayon::prelude::*;

const POSES: usize = 14;

/// The run that was never killed, developed, and its rig.
struct Reference {
    folder: tempfile::TempDir,
    records: Vec<Record>,
    /// The journal's lines with their ends.
    lines: Vec<Vec<u8>>,
}

impl Reference {
    fn make() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let rig = small::rig(24);
        let run = folder.path().join("run");
        small::acquire(&run, &small::plan(&rig, POSES), &rig, small::layout(&rig));
        let journal = fs::read(run.join(journal::FILE_NAME)).unwrap();
        small::develop(&run);
        let records = journal::read(&run).unwrap();
        let lines: Vec<_> = journal.split_inclusive(|&byte| byte == b'\n').map(<[u8]>::to_vec).collect();
        assert_eq!(lines.len(), records.len());
        Self { folder, records, lines }
    }

    fn run(&self) -> std::path::PathBuf {
        self.folder.path().join("run")
    }

    /// What a kill leaves when `records` whole records are in the journal: their frames, then `torn` bytes of
    /// the next line, and of the next record's frames what `debris` says.
    fn killed(&self, to: &Path, records: usize, torn: usize, debris: Debris) {
        fs::create_dir_all(to.join("frames")).unwrap();
        let copy = |file: &str| {
            fs::copy(self.run().join(file), to.join(file)).unwrap();
        };
        copy("rig.toml");
        copy("plan.toml");
        let (done, rest) = self.records.split_at(records);
        for exposure in done.iter().flat_map(exposures) {
            copy(&exposure.file);
        }
        let next = rest.first().map_or(&[][..], exposures);
        match (debris, next) {
            (Debris::Nothing, _) | (_, []) => {}
            (Debris::HalfAFrame, [first, ..]) => {
                let bytes = fs::read(self.run().join(&first.file)).unwrap();
                fs::write(to.join(&first.file), &bytes[..bytes.len() / 2]).unwrap();
                fs::write(to.join(format!("{}.tmp", first.file)), &bytes[..bytes.len() / 3]).unwrap();
            }
            (Debris::SomeFrames, [first, ..]) => copy(&first.file),
            (Debris::AllFrames, all) => all.iter().for_each(|exposure| copy(&exposure.file)),
        }
        let mut text = self.lines[..records].concat();
        text.extend(self.lines.get(records).map_or(&[][..], |line| &line[..torn.min(line.len() - 1)]));
        fs::write(to.join(journal::FILE_NAME), text).unwrap();
        self.cut_truth(to, done.iter().flat_map(exposures).count(), torn);
    }

    /// The truth file up to the photographs that were taken, with a torn line after them.
    fn cut_truth(&self, to: &Path, photographs: usize, torn: usize) {
        let truth = fs::read(self.run().join(TRUTH_FILE)).unwrap();
        let lines: Vec<&[u8]> = truth.split_inclusive(|&byte| byte == b'\n').collect();
        let mut text = lines[..photographs].concat();
        text.extend(lines.get(photographs).map_or(&[][..], |line| &line[..torn.min(line.len() - 1)]));
        fs::write(to.join(TRUTH_FILE), text).unwrap();
    }

    /// Resumes a killed run as a new process would, develops it and compares all that matters.
    fn check(&self, run: &Path, what: &str) {
        self.check_photographs(run, what);
        folder::assert_same(&small::develop(run), &self.run().join("sampled.zarr"), what);
    }

    /// Resumes a killed run and compares what its reflectance is developed from.
    fn check_photographs(&self, run: &Path, what: &str) {
        small::resume(run, small::layout);
        let measured = |run: &Path| -> Vec<Record> {
            // The controller's health is that of its own session, and a resumed run has another.
            let records = journal::read(run).unwrap();
            records.into_iter().filter(|record| !matches!(record, Record::Health { .. })).collect()
        };
        assert!(measured(run) == measured(&self.run()), "{what}: another journal");
        let truth = simulated::read_truth(run, POSES).unwrap();
        assert_eq!(truth, simulated::read_truth(&self.run(), POSES).unwrap(), "{what}");
        for exposure in self.records.iter().flat_map(exposures) {
            let bytes = |run: &Path| fs::read(run.join(&exposure.file)).unwrap();
            assert!(bytes(run) == bytes(&self.run()), "{what}: {} differs", exposure.file);
        }
    }
}

/// What a kill left of the photographs that no record names.
#[derive(Debug, Clone, Copy)]
enum Debris {
    Nothing,
    HalfAFrame,
    SomeFrames,
    AllFrames,
}

const DEBRIS: [Debris; 4] = [Debris::Nothing, Debris::HalfAFrame, Debris::SomeFrames, Debris::AllFrames];

fn exposures(record: &Record) -> &[ExposureRecord] {
    match record {
        Record::Dark { exposure, .. } => std::slice::from_ref(exposure),
        Record::Pose { exposures, .. } => exposures,
        _ => &[],
    }
}

#[test]
fn a_run_killed_after_any_record_and_resumed_gives_the_same_sampled_sbrdf() {
    let reference = Reference::make();
    let count = reference.records.len();
    assert!(count >= 21, "only {count} places to kill at");
    // Whole records, then torn lines: one byte, half, all but the line's end.
    let whole = (1..=count).map(|records| (records, 0, DEBRIS[records % 4]));
    let torn = [(3, 1), (7, 60), (8, 1), (12, 100), (count - 2, usize::MAX), (count - 1, usize::MAX)];
    let torn = torn.map(|(records, bytes)| (records, bytes, DEBRIS[(records + bytes % 7) % 4]));
    let cuts: Vec<_> = whole.chain(torn).collect();
    cuts.par_iter().for_each(|&(records, bytes, debris)| {
        let folder = tempfile::tempdir().unwrap();
        reference.killed(folder.path(), records, bytes, debris);
        reference.check(folder.path(), &format!("cut after record {records} and {bytes} bytes, {debris:?}"));
    });
}

#[test]
fn a_run_killed_before_its_first_record_is_told_to_start_again_and_can() {
    let folder = tempfile::tempdir().unwrap();
    let rig = small::rig(8);
    small::write_inputs(folder.path(), &rig, &small::plan(&rig, 2));
    for torn in ["", "{\"record\":\"star"] {
        let run_folder = folder.path().join("run");
        fs::create_dir_all(run_folder.join("frames")).unwrap();
        fs::write(run_folder.join(journal::FILE_NAME), torn).unwrap();
        let resume = ["acquire", "--resume", "--port", "sim", "--camera", "sim", "-o", "run"];
        run(folder.path(), &resume).refuses(2, &["run: ", "without --resume"]);
        fs::write(run_folder.join(journal::FILE_NAME), torn).unwrap();
        succeed(folder.path(), &ACQUIRE);
        succeed(folder.path(), &["develop", "run", "-o", "sampled.zarr"]);
        fs::remove_dir_all(&run_folder).unwrap();
    }
}

const ACQUIRE: [&str; 10] =
    ["acquire", "plan.toml", "--rig", "rig.toml", "--port", "sim", "--camera", "sim", "-o", "run"];

/// Runs `lobelia acquire` and kills it again and again until the run is finished; gives the number of kills.
fn acquire_with_kills(folder: &Path, random: &mut Random) -> usize {
    let journal = folder.join("run").join(journal::FILE_NAME);
    let records = || fs::read(&journal).map_or(0, |bytes| bytes.iter().filter(|&&b| b == b'\n').count());
    let mut kills = 0;
    loop {
        let begun = records();
        let mut command = if begun == 0 {
            lobelia(folder, &ACQUIRE)
        } else {
            lobelia(folder, &["acquire", "--resume", "--port", "sim", "--camera", "sim", "-o", "run"])
        };
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let (after, pause) = (begun as u64 + random.below(4), Duration::from_micros(random.below(30_000)));
        while (records() as u64) < after && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(pause);
        // SIGKILL; one that has ended meanwhile is not harmed by it.
        child.kill().unwrap();
        let output = child.wait_with_output().unwrap();
        match output.status.code() {
            Some(0) => return kills,
            None => kills += 1,
            Some(_) => panic!("{}", String::from_utf8_lossy(&output.stderr)),
        }
    }
}

/// Kills processes until at least `wanted` were killed; each run that ends must give the reference's store.
fn kill_processes(wanted: usize, poses: usize, seed: u64) {
    let reference = tempfile::tempdir().unwrap();
    let rig = small::rig(24);
    let plan = small::plan(&rig, poses);
    small::write_inputs(reference.path(), &rig, &plan);
    succeed(reference.path(), &ACQUIRE);
    let develop = ["develop", "run", "-o", "sampled.zarr"];
    succeed(reference.path(), &develop);

    let mut random = Random(seed);
    let mut kills = 0;
    while kills < wanted {
        let folder = tempfile::tempdir().unwrap();
        small::write_inputs(folder.path(), &rig, &plan);
        kills += acquire_with_kills(folder.path(), &mut random);
        succeed(folder.path(), &develop);
        let store = |folder: &Path| folder.join("sampled.zarr");
        folder::assert_same(&store(folder.path()), &store(reference.path()), &format!("after {kills} kills"));
    }
}

#[test]
fn a_process_killed_at_random_instants_and_resumed_gives_the_same_sampled_sbrdf() {
    kill_processes(6, POSES, 7);
}

#[test]
fn a_resumed_run_photographs_the_material_that_it_was_begun_with() {
    let folder = tempfile::tempdir().unwrap();
    let rig = small::rig(12);
    small::write_inputs(folder.path(), &rig, &small::plan(&rig, 4));
    let felt = "[pattern]\nkind = \"checks\"\nsize_mm = 8\n[[material]]\npublished = \"felt\"\n";
    fs::write(folder.path().join("felt.toml"), felt).unwrap();
    succeed(folder.path(), &[&ACQUIRE[..], &["--material", "felt.toml"]].concat());
    let develop = |store: &str| succeed(folder.path(), &["develop", "run", "-o", store]);
    develop("whole.zarr");

    let journal = folder.path().join("run").join(journal::FILE_NAME);
    let text = fs::read_to_string(&journal).unwrap();
    let kept: Vec<&str> = text.split_inclusive('\n').collect();
    fs::write(&journal, kept[..kept.len() - 4].concat()).unwrap();
    let resume = ["acquire", "--resume", "--port", "sim", "--camera", "sim", "-o", "run"];
    run(folder.path(), &[&resume[..], &["--material", "felt.toml"]].concat()).refuses(2, &["--material"]);
    succeed(folder.path(), &resume);
    develop("resumed.zarr");
    let store = |name: &str| folder.path().join(name);
    folder::assert_same(&store("resumed.zarr"), &store("whole.zarr"), "a run of felt");
}

#[test]
#[ignore = "long: cargo xtask long"]
fn a_journal_cut_at_every_byte_of_its_last_three_records_gives_the_same_sampled_sbrdf() {
    let reference = Reference::make();
    let count = reference.records.len();
    let cuts: Vec<(usize, usize)> =
        (count - 3..count).flat_map(|k| (0..reference.lines[k].len()).map(move |byte| (k, byte))).collect();
    cuts.par_iter().for_each(|&(records, bytes)| {
        let folder = tempfile::tempdir().unwrap();
        reference.killed(folder.path(), records, bytes, DEBRIS[bytes % 4]);
        let what = format!("cut after record {records} and {bytes} bytes");
        if bytes % 16 == 0 {
            reference.check(folder.path(), &what);
        } else {
            reference.check_photographs(folder.path(), &what);
        }
    });
}

#[test]
#[ignore = "long: cargo xtask long"]
fn two_hundred_killed_processes_change_nothing() {
    kill_processes(200, 40, 11);
}
