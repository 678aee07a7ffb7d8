//! Drivers that are set up over a wire.

use lobelia_protocol::{AXES, Axis, Configuration, DriverParameters, DriverTrouble, Fault, Outcome, Refusal};

use super::{Controller, Task, Trouble};
use crate::board::Board;
use crate::driver::StepperDriver;
use crate::driver::tmc2209::Tmc2209;
use crate::homing::Purpose;

impl<B: Board> Controller<B> {
    /// Sets up each driver that has parameters. It takes 7 ms an axis, in which nothing else is done. The
    /// position of one that did not have just these is unknown from then on: it was reset at rest, so its arm
    /// may have moved, or its steps become others.
    pub(super) fn set_up_drivers(&mut self, configuration: &Configuration) -> Result<(), Refusal> {
        for (axis, parameters) in Axis::ALL.into_iter().zip(&configuration.axes) {
            let Some(settings) = &parameters.driver else { continue };
            if self.axes[axis.index()].known && !self.has_kept(axis, settings) {
                let set = self.configuration.as_ref().map_or(parameters, |set| &set.axes[axis.index()]);
                self.axes[axis.index()].forget(&mut self.pulses, set);
            }
            let set_up = match &mut self.options.drivers {
                Some(bus) => Tmc2209 { bus: &mut **bus, node: axis.index() as u8 }.set_up(settings),
                None => Err(DriverTrouble::NoWire),
            };
            set_up.map_err(|trouble| Refusal::Driver { axis, trouble })?;
        }
        Ok(())
    }

    /// Whether an axis's driver was given these settings before and has them still.
    fn has_kept(&mut self, axis: Axis, settings: &DriverParameters) -> bool {
        let before = self.configuration.as_ref().and_then(|before| before.axes[axis.index()].driver);
        before.as_ref() == Some(settings) && self.keeps(axis, settings)
    }

    /// Whether an axis's driver has these settings. One damaged reply is no lost driver.
    fn keeps(&mut self, axis: Axis, settings: &DriverParameters) -> bool {
        let Some(bus) = &mut self.options.drivers else { return false };
        let mut driver = Tmc2209 { bus: &mut **bus, node: axis.index() as u8 };
        let mut kept = || driver.keeps(settings);
        kept().or_else(|_| kept()) == Ok(true)
    }

    /// The first axis whose driver has lost its settings, or does not answer when it is asked again. It takes
    /// two requests a driver, 2 ms at 115 200 baud.
    pub(super) fn lost_driver(&mut self) -> Option<Axis> {
        let configuration = self.configuration?;
        let lost = |axis: &Axis| {
            configuration.axes[axis.index()].driver.is_some_and(|settings| !self.keeps(*axis, &settings))
        };
        Axis::ALL.into_iter().find(lost)
    }

    /// Homes, and before it sets up the drivers, which forget when their supply is cut.
    pub(super) fn prepare_homing(
        &mut self,
        now_us: u64,
        configuration: &Configuration,
        purpose: Purpose,
        axes: [bool; AXES],
    ) -> Result<Task, Trouble> {
        if configuration.axes.iter().all(|axis| axis.driver.is_none()) {
            return self.begin_homing(now_us, configuration, purpose, axes);
        }
        self.set_up_drivers(configuration)?;
        // That took time, which the next poll will know.
        Ok(Task::BeginHoming(purpose, axes))
    }

    /// Homes once the drivers are set up.
    pub(super) fn home_on(
        &mut self,
        now_us: u64,
        task: &mut Task,
        purpose: Purpose,
        axes: [bool; AXES],
    ) -> Result<Option<Outcome>, (Fault, Option<Axis>)> {
        let Some(configuration) = self.configuration else { return Ok(None) };
        match self.begin_homing(now_us, &configuration, purpose, axes) {
            Ok(next) => {
                *task = next;
                Ok(None)
            }
            Err(Trouble::Refusal(refusal)) => Ok(Some(Outcome::Refused(refusal))),
            Err(Trouble::Pin) => Err((Fault::Hardware, None)),
        }
    }
}
