//! Single pins: one that a rig may have the other way round, and what fails.

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};

/// A pin that could not be driven or read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct PinFailure;

/// A pin as its rig has wired it.
#[derive(Debug)]
pub(crate) struct Line<P> {
    pin: P,
    /// Whether it is inverted; nothing while that is not known.
    inverted: Option<bool>,
}

impl<P> Line<P> {
    /// A pin of which nothing is known yet: an output is left as it is, an input taken as the board's table
    /// has it.
    pub(crate) fn new(pin: P) -> Self {
        Self { pin, inverted: None }
    }

    /// Tells it how it is wired.
    pub(crate) fn wire(&mut self, inverted: bool) {
        self.inverted = Some(inverted);
    }
}

impl<P: ErrorType> ErrorType for Line<P> {
    type Error = P::Error;
}

impl<P: OutputPin> OutputPin for Line<P> {
    fn set_low(&mut self) -> Result<(), P::Error> {
        match self.inverted {
            None => Ok(()),
            Some(false) => self.pin.set_low(),
            Some(true) => self.pin.set_high(),
        }
    }

    fn set_high(&mut self) -> Result<(), P::Error> {
        match self.inverted {
            None => Ok(()),
            Some(false) => self.pin.set_high(),
            Some(true) => self.pin.set_low(),
        }
    }
}

impl<P: InputPin> InputPin for Line<P> {
    fn is_high(&mut self) -> Result<bool, P::Error> {
        Ok(self.pin.is_high()? != (self.inverted == Some(true)))
    }

    fn is_low(&mut self) -> Result<bool, P::Error> {
        self.is_high().map(|high| !high)
    }
}

/// Drives a pin.
pub(crate) fn set(pin: &mut impl OutputPin, high: bool) -> Result<(), PinFailure> {
    if high { pin.set_high() } else { pin.set_low() }.map_err(|_| PinFailure)
}

/// Reads a pin.
pub(crate) fn is_high(pin: &mut impl InputPin) -> Result<bool, PinFailure> {
    pin.is_high().map_err(|_| PinFailure)
}
