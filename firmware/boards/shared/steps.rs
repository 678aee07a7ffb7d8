//! The steps, between the interrupt that makes them and the controller that plans them.

use core::cell::RefCell;

use cortex_m::interrupt::{Mutex, free};
use lobelia_firmware::{Pulses, PulsesCell};

use crate::ThisBoard;

static STEPS: Mutex<RefCell<Option<Pulses<ThisBoard>>>> = Mutex::new(RefCell::new(None));

/// The controller's way to the steps.
#[derive(Debug)]
pub struct Steps(());

fn with<R>(does: impl FnOnce(&mut Option<Pulses<ThisBoard>>) -> R) -> R {
    free(|section| does(&mut STEPS.borrow(section).borrow_mut()))
}

impl PulsesCell<ThisBoard> for Steps {
    fn keep(pulses: Pulses<ThisBoard>) -> Self {
        with(|kept| *kept = Some(pulses));
        Self(())
    }

    fn with<R>(&mut self, does: impl FnOnce(&mut Pulses<ThisBoard>) -> R) -> R {
        with(|kept| match kept {
            Some(pulses) => does(pulses),
            None => panic!("there are no steps"),
        })
    }
}

/// Makes the steps that are due, by a clock that tells the time in µs; gives when to make the next.
pub(crate) fn make(clock: impl Fn() -> u32) -> Option<u32> {
    with(|kept| kept.as_mut()?.step(clock))
}
