use std::io::Cursor;
use std::thread::sleep;

use lobelia_hil_sim::optics::frame::{FrameNotes, write_tiff};

use super::*;

/// A frame of a few pixels that all have one value.
fn frame(value: u16) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let notes = FrameNotes { exposure_s: 0.1, f_number: 16.0, taken_s: 5 };
    write_tiff(&mut bytes, 8, 6, &[value; 48], &notes).unwrap();
    bytes.into_inner()
}

/// A watched folder of its own, where photographs go, and where those go that are put aside.
struct Place {
    root: tempfile::TempDir,
    watched: WatchedFolder,
}

impl Place {
    fn new(timeout_ms: u64) -> Self {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir(root.path().join("photos")).unwrap();
        let watched =
            WatchedFolder::new(&root.path().join("photos"), Duration::from_millis(timeout_ms)).unwrap();
        Self { root, watched }
    }

    fn photo(&self, name: &str) -> PathBuf {
        self.root.path().join("photos").join(name)
    }

    fn photos(&self) -> Vec<String> {
        let entries = fs::read_dir(self.root.path().join("photos")).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    fn drain(&mut self) {
        let aside = self.root.path().join("aside");
        self.watched.drain(&aside, Duration::ZERO).unwrap();
    }

    /// Waits for a photograph that `judge` finds right.
    fn collect(&mut self, judge: &dyn Fn(&Photograph) -> std::result::Result<(), Fault>) -> Arrival {
        let (file, aside) = (self.root.path().join("taken.tiff"), self.root.path().join("aside"));
        self.watched.collect(SystemTime::now(), judge, &file, &aside).unwrap()
    }

    fn taken(&self) -> Option<Vec<u8>> {
        fs::read(self.root.path().join("taken.tiff")).ok()
    }

    fn reasons(&self) -> String {
        fs::read_to_string(self.root.path().join("aside").join(REASONS)).unwrap_or_default()
    }
}

fn anything(_: &Photograph) -> std::result::Result<(), Fault> {
    Ok(())
}

/// Runs `write` beside `collect`.
fn with_camera(place: &mut Place, write: impl FnOnce(&dyn Fn(&str) -> PathBuf) + Send) -> Arrival {
    place.drain();
    let folder = place.root.path().join("photos");
    std::thread::scope(|scope| {
        scope.spawn(move || write(&|name| folder.join(name)));
        place.collect(&anything)
    })
}

#[test]
fn a_frame_is_taken_once_it_is_whole_and_all_else_is_left() {
    let mut place = Place::new(20_000);
    fs::write(place.photo("old.tiff"), frame(1)).unwrap();
    let bytes = frame(7);
    let arrival = with_camera(&mut place, |at| {
        fs::write(at("new.log"), b"stored").unwrap();
        fs::write(at("new.tiff"), &bytes[..bytes.len() / 2]).unwrap();
        sleep(STILL + 3 * LOOK_AGAIN);
        fs::write(at("new.tiff"), &bytes).unwrap();
    });
    assert_eq!((arrival, place.taken()), (Arrival::Taken, Some(bytes)));
    assert_eq!(place.photos(), ["new.log", "old.tiff"]);
}

/// A file that has its size from the start, and its content a moment later.
#[test]
fn a_preallocated_file_is_taken_when_it_is_filled() {
    let mut place = Place::new(20_000);
    let (bytes, empty) = (frame(900), frame(0));
    assert_eq!(bytes.len(), empty.len());
    let filled = bytes.clone();
    let arrival = with_camera(&mut place, move |at| {
        // The header and half of the pixels, 0 for the rest, as a camera that writes rows one by one.
        let first = filled.iter().zip(&empty).position(|(a, b)| a != b).unwrap();
        let half = [&filled[..first + 20], &empty[first + 20..]].concat();
        fs::write(at("new.tiff"), half).unwrap();
        sleep(Duration::from_millis(200));
        fs::write(at("new.tiff"), &filled).unwrap();
    });
    assert_eq!((arrival, place.taken()), (Arrival::Taken, Some(bytes)));
}

/// Software that writes under one name and renames at any moment while the file is looked at, read or
/// removed.
#[test]
fn a_file_that_is_renamed_at_any_moment_is_taken_once_and_fails_nothing() {
    std::thread::scope(|scope| {
        for step in 0..12 {
            scope.spawn(move || {
                let mut place = Place::new(20_000);
                let bytes = frame(step);
                let arrival = with_camera(&mut place, |at| {
                    fs::write(at("writing"), &bytes).unwrap();
                    sleep(Duration::from_millis(440 + 10 * u64::from(step)));
                    // It may have been taken by then.
                    let _ = fs::rename(at("writing"), at("new.tiff"));
                });
                assert_eq!((arrival, place.taken()), (Arrival::Taken, Some(bytes)));
                place.drain();
                assert_eq!((place.photos(), place.reasons()), (vec![], String::new()));
            });
        }
    });
}

#[test]
fn a_name_that_existed_and_is_overwritten_is_new() {
    let mut place = Place::new(20_000);
    fs::write(place.photo("capt0000.tiff"), frame(1)).unwrap();
    sleep(Duration::from_millis(20));
    let bytes = frame(2);
    let arrival = with_camera(&mut place, |at| fs::write(at("capt0000.tiff"), &bytes).unwrap());
    assert_eq!((arrival, place.taken()), (Arrival::Taken, Some(bytes)));
}

#[test]
fn a_jpeg_beside_the_frame_is_passed_over_and_one_instead_of_it_is_named() {
    const JPEG: &[u8] = b"\xff\xd8\xff\xe0\x00\x10JFIF";
    let mut place = Place::new(20_000);
    let bytes = frame(3);
    let arrival = with_camera(&mut place, |at| {
        fs::write(at("a.jpg"), JPEG).unwrap();
        sleep(STILL + 3 * LOOK_AGAIN);
        fs::write(at("a.tiff"), &bytes).unwrap();
    });
    assert_eq!((arrival, place.taken()), (Arrival::Taken, Some(bytes)));
    assert_eq!(place.photos(), ["a.jpg"]);

    let mut place = Place::new(800);
    let arrival = with_camera(&mut place, |at| fs::write(at("b.jpg"), JPEG).unwrap());
    let Arrival::Missing { why, again: false } = arrival else { panic!("{arrival:?}") };
    assert!(why.contains("b.jpg") && why.contains("not linear"), "{why}");
}

#[test]
fn a_late_photograph_is_put_aside_before_the_next_shot_and_a_wrong_one_while_the_right_one_may_come() {
    let mut place = Place::new(100);
    let arrival = with_camera(&mut place, |_| ());
    assert!(
        matches!(&arrival, Arrival::Missing { why, again: true } if why.contains("storing here?")),
        "{arrival:?}"
    );
    fs::write(place.photo("shot-1.tiff"), frame(1)).unwrap();
    place.drain();
    assert_eq!(place.photos(), Vec::<String>::new());
    assert_eq!(place.reasons(), format!("shot-1.tiff: {LATE}\n"));
    assert_eq!(fs::read(place.root.path().join("aside/shot-1.tiff")).unwrap(), frame(1));

    place.watched.timeout = Duration::from_secs(20);
    fs::write(place.photo("shot-2.tiff"), frame(2)).unwrap();
    fs::write(place.photo("shot-3.tiff"), frame(3)).unwrap();
    let judge = |photograph: &Photograph| match photograph.values[0] {
        3 => Ok(()),
        _ => Err(Fault::Wrong("it is of another pose".into())),
    };
    assert_eq!(place.collect(&judge), Arrival::Taken);
    assert_eq!(place.taken(), Some(frame(3)));
    assert!(place.reasons().ends_with("shot-2.tiff: it is of another pose\n"), "{}", place.reasons());

    // What was taken comes again under another name, as if it were the next shot's.
    fs::write(place.photo("shot-4.tiff"), frame(3)).unwrap();
    place.watched.timeout = Duration::from_millis(900);
    let again = place.collect(&anything);
    assert!(
        matches!(&again, Arrival::Missing { why, again: true } if why.contains("delivered before")),
        "{again:?}"
    );
}

/// A frame whose Orientation is 3.
fn turned() -> Vec<u8> {
    use tiff::encoder::{TiffEncoder, colortype::Gray16};
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let mut image = encoder.new_image::<Gray16>(8, 6).unwrap();
    image.encoder().write_tag(tiff::tags::Tag::Orientation, 3u16).unwrap();
    image.write_data(&[9; 48]).unwrap();
    bytes.into_inner()
}

#[test]
fn a_turned_photograph_is_put_aside_with_its_reason_as_every_wrong_one_is() {
    let mut place = Place::new(900);
    let arrival = with_camera(&mut place, |photo| fs::write(photo("shot.tiff"), turned()).unwrap());
    let told = |why: &str| why.contains("its Orientation is 3");
    assert!(matches!(&arrival, Arrival::Missing { why, again: true } if told(why)), "{arrival:?}");
    assert_eq!(place.photos(), Vec::<String>::new());
    assert!(place.reasons().starts_with("shot.tiff: its Orientation is 3"), "{}", place.reasons());
}

#[test]
fn a_file_that_stays_unfinished_is_never_taken_and_said_so() {
    let mut place = Place::new(700);
    let arrival = with_camera(&mut place, |at| fs::write(at("half.tiff"), &frame(1)[..60]).unwrap());
    assert!(
        matches!(&arrival, Arrival::Missing { why, again: true } if why.contains("half.tiff: the frame is \
             truncated")),
        "{arrival:?}"
    );
    let unfinished = |_: &Photograph| Err(Fault::Unfinished("14 % of its values are 0".into()));
    fs::write(place.photo("zeros.tiff"), frame(1)).unwrap();
    let arrival = place.collect(&unfinished);
    assert!(
        matches!(&arrival, Arrival::Missing { why, .. } if why.contains("zeros.tiff: 14 %")),
        "{arrival:?}"
    );
    assert_eq!((place.taken(), place.reasons()), (None, String::new()));
    assert!(WatchedFolder::new(&place.photo("gone"), Duration::ZERO).is_err());
}

/// A camera in another time zone, whose clock tells whole seconds and lags the shot by some tenths.
#[test]
fn a_photograph_that_was_taken_before_its_shot_is_known_by_the_cameras_clock_once_that_runs() {
    let zone = 7_200.0 + 17.3;
    let by_camera = |host_s: f64| ((host_s + zone + 0.3).floor(), 1.0);
    let mut clock = CameraClock::default();
    assert_eq!(clock.too_early(100.0, by_camera(20.0)), None, "nothing is known of the clock yet");
    for shot in 0..20 {
        let began = 100.0 + 3.7 * f64::from(shot);
        assert_eq!(clock.too_early(began, by_camera(began)), None, "shot {shot}");
        clock.note(began, by_camera(began).0);
    }
    let early = clock.too_early(400.0, by_camera(390.0)).unwrap();
    assert!((7.0..=10.0).contains(&early), "{early}");
    assert_eq!(clock.too_early(400.0, by_camera(400.0)), None);
    // A clock that stands still is not believed.
    let mut still = CameraClock::default();
    (0..20).for_each(|shot| still.note(100.0 + 3.7 * f64::from(shot), 5.0));
    assert_eq!(still.too_early(400.0, (5.0, 1.0)), None);
}
