//! Parameters survive a power cut at any byte.
#![allow(clippy::unwrap_used)]

mod bench;

use std::sync::{Arc, Mutex};

use bench::{Rig, SESSION, configuration};
use lobelia_firmware::storage::{SLOT_BYTES, Storage, load, load_any, save};
use lobelia_protocol::{
    Alarm, Answer, Axis, AxisParameters, Command, Configuration, DriverParameters, Event, Hello, Outcome,
    Pin, Pins, Refusal, Settings, ToController, ToHost,
};

/// Flash that loses its power after so many bytes erased or written.
struct Flash {
    slots: [[u8; SLOT_BYTES]; 2],
    bytes_left: usize,
}

impl Flash {
    fn new() -> Self {
        Self { slots: [[0xff; SLOT_BYTES]; 2], bytes_left: usize::MAX }
    }

    fn change(&mut self, slot: usize, bytes: impl Iterator<Item = u8>) -> bool {
        for (place, byte) in self.slots[slot].iter_mut().zip(bytes) {
            if self.bytes_left == 0 {
                return false;
            }
            self.bytes_left -= 1;
            *place = byte;
        }
        true
    }
}

impl Storage for Flash {
    fn read(&mut self, slot: usize, into: &mut [u8]) -> bool {
        into.copy_from_slice(&self.slots[slot][..into.len()]);
        true
    }
    fn erase(&mut self, slot: usize) -> bool {
        self.change(slot, std::iter::repeat_n(0xff, SLOT_BYTES))
    }
    fn write(&mut self, slot: usize, bytes: &[u8]) -> bool {
        self.change(slot, bytes.iter().copied())
    }
}

/// The same flash, before and after a power cut.
struct Shared(Arc<Mutex<Flash>>);

impl Storage for Shared {
    fn read(&mut self, slot: usize, into: &mut [u8]) -> bool {
        self.0.lock().unwrap().read(slot, into)
    }
    fn erase(&mut self, slot: usize) -> bool {
        self.0.lock().unwrap().erase(slot)
    }
    fn write(&mut self, slot: usize, bytes: &[u8]) -> bool {
        self.0.lock().unwrap().write(slot, bytes)
    }
}

fn with_warm_up(lamp_warm_up_s: u16) -> Configuration {
    let configuration = configuration();
    Configuration { settings: Settings { lamp_warm_up_s, ..configuration.settings }, ..configuration }
}

#[test]
fn power_cut_at_any_byte_of_a_save_leaves_the_old_or_the_new() {
    let mut flash = Flash::new();
    assert_eq!(load(&mut flash), None);
    for save_number in 1..4 {
        let (old, new) = (with_warm_up(save_number), with_warm_up(save_number + 1));
        assert!(save(&mut flash, &old));
        let mut outcomes = [0; 2];
        for cut in 0..=2 * SLOT_BYTES {
            let mut copy = Flash { slots: flash.slots, bytes_left: cut };
            let saved = save(&mut copy, &new);
            copy.bytes_left = usize::MAX;
            let found = load(&mut copy).unwrap();
            assert!(found == old || found == new, "cut at byte {cut}");
            assert!(!saved || found == new);
            outcomes[usize::from(found == new)] += 1;
            // And it can be saved again afterwards.
            assert!(save(&mut copy, &with_warm_up(99)));
            assert_eq!(load(&mut copy), Some(with_warm_up(99)));
        }
        assert!(outcomes.iter().all(|&count| count > 0));
    }
}

#[test]
fn any_byte_that_rots_in_the_newer_slot_gives_the_older_parameters() {
    let mut flash = Flash::new();
    assert!(save(&mut flash, &with_warm_up(1)) && save(&mut flash, &with_warm_up(2)));
    let mut found_old = 0;
    for byte in 0..SLOT_BYTES {
        let mut copy = Flash { slots: flash.slots, bytes_left: usize::MAX };
        copy.slots[1][byte] ^= 0x10;
        match load(&mut copy).unwrap().settings.lamp_warm_up_s {
            1 => found_old += 1,
            // Behind the record.
            other => assert!(other == 2 && byte > 100),
        }
    }
    assert!(found_old > 100);
}

/// A slot as the program of schema version 4 wrote it. These bytes may never change: they are in controllers.
const OF_VERSION_4: &str = "\
    8b01244f000000009000870e904ed00fa01f80f10400281400cf0fe807323cf40300a01fd00f0200870e904ee807a09c0180\
    b51800281400cf0ff403323cf40300a01fd00f0201a006ac026e10c8a01f870e904eac0264d00f00281400cf0f9601323cf4\
    03c8a01fd00f0200870e904ea09c01d08603c0843d00281400cf0f904e323cf40300a01fd00f02000aac0200000080c60a00\
    320102052929e632";

/// One of version 5, with inverted pins and an alarm. Nor may these.
const OF_VERSION_5: &str = "\
    742eadec000000009f00870e904ed00fa01f80f10400281400cf0fe807323cf40300a01fd00f02000c0014870e904ee807a0\
    9c0180b51800281400cf0ff403323cf40300a01fd00f0201a006ac026e10c8a01f000014870e904eac0264d00f00281400cf\
    0f9601323cf403c8a01fd00f0200000014870e904ea09c01d08603c0843d00281400cf0f904e323cf40300a01fd00f020000\
    0184070aac0200000080c60a0032010205e00734c62186";

fn written(hexadecimal: &str) -> Flash {
    let mut flash = Flash::new();
    for (byte, hex) in flash.slots[0].iter_mut().zip(hexadecimal.as_bytes().chunks(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(hex).unwrap(), 16).unwrap();
    }
    flash
}

/// What both of them have in common, with the defaults of what is new to the older.
fn saved_before() -> Configuration {
    let mut saved = configuration();
    for axis in &mut saved.axes {
        (axis.alarm, axis.alarm_debounce_us) = (Alarm::None, 50);
    }
    saved.axes[1].driver = Some(DriverParameters {
        run_ma: 800,
        hold_ma: 300,
        sense_mohm: 110,
        microsteps: 16,
        stall_threshold: 200,
        stall_above_speed: 4000,
    });
    saved.axes[2].home_order = 200;
    let new = |axis: &AxisParameters| axis.most_turns == 1 && axis.inverted == Pins::NONE;
    assert!(saved.axes.iter().all(new) && saved.settings.inverted == Pins::NONE);
    assert!(saved.keep_outs == [None; 4]);
    saved
}

#[test]
fn pins_and_alarms_saved_before_there_were_keep_outs_stay_as_they_are() {
    let mut expected = saved_before();
    for axis in &mut expected.axes {
        axis.alarm_debounce_us = 20;
    }
    expected.axes[0].inverted = [Pin::Home, Pin::Enable].into_iter().collect();
    (expected.axes[3].alarm, expected.axes[3].alarm_debounce_us) = (Alarm::Level, 900);
    expected.settings.inverted = Pins::OF_RIG;
    assert_eq!(load_any(&mut written(OF_VERSION_5)), Some((expected, Some(0xecad_2e74))));
}

#[test]
fn parameters_saved_by_an_older_program_are_read_with_defaults_for_what_is_new_and_that_is_told_once() {
    let expected = saved_before();
    let mut flash = written(OF_VERSION_4);
    assert_eq!(load_any(&mut flash), Some((expected, Some(0x4f24_018b))));
    for cut in 0..OF_VERSION_4.len() / 2 {
        let mut damaged = written(OF_VERSION_4);
        damaged.slots[0][cut] ^= 1;
        assert_eq!(load_any(&mut damaged), None, "byte {cut}");
    }

    let flash = Arc::new(Mutex::new(flash));
    let mut rig = Rig::with_storage(Box::leak(Box::new(Shared(Arc::clone(&flash)))));
    let told = |rig: &mut Rig| {
        rig.send(&ToController::Hello(Hello::new(SESSION)));
        let events = rig.received();
        events.contains(&ToHost::Event(Event::Migrated { from: 0x4f24_018b }))
    };
    assert!(told(&mut rig));
    assert!(!told(&mut rig));
    assert_eq!(rig.ask(Command::ReadAxis(Axis::Roll)), Outcome::Done(Answer::Axis(expected.axes[2])));
    // Saved anew they are of this program.
    assert!(save(&mut *flash.lock().unwrap(), &expected));
    assert_eq!(load_any(&mut *flash.lock().unwrap()), Some((expected, None)));
}

#[test]
fn controller_wakes_up_with_what_was_saved() {
    let flash = Arc::new(Mutex::new(Flash::new()));
    let mut rig = Rig::with_storage(Box::leak(Box::new(Shared(Arc::clone(&flash)))));
    rig.send(&ToController::Hello(Hello::new(SESSION)));
    assert_eq!(rig.ask(Command::SaveParameters), Outcome::Refused(Refusal::NotConfigured));
    rig.configure(with_warm_up(7));
    // Writing holds the controller up: nobody could put the lamp out.
    rig.ask(Command::Lamp { on: true, level: 1000 });
    assert_eq!(rig.ask(Command::SaveParameters), Outcome::Refused(Refusal::NotAtRest));
    rig.ask(Command::Lamp { on: false, level: 0 });
    assert!(matches!(rig.ask(Command::SaveParameters), Outcome::Done(_)));
    drop(rig);
    let mut again = Rig::with_storage(Box::leak(Box::new(Shared(Arc::clone(&flash)))));
    again.send(&ToController::Hello(Hello::new(SESSION)));
    assert!(matches!(again.ask(Command::Home), Outcome::Done(_)));
    let mut without = Rig::greeted(configuration());
    assert_eq!(without.ask(Command::SaveParameters), Outcome::Refused(Refusal::NoStorage));
}
