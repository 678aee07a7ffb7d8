//! Drivers that are set up over a wire.

use lobelia_protocol::{Axis, Configuration, DriverTrouble, Fault, Outcome, Refusal};

use super::{Controller, Task, Trouble};
use crate::board::Board;
use crate::driver::StepperDriver;
use crate::driver::tmc2209::Tmc2209;
use crate::homing::Purpose;

impl<B: Board> Controller<B> {
    /// Sets up each driver that has parameters. It takes 5 ms an axis, in which nothing else is done.
    pub(super) fn set_up_drivers(&mut self, configuration: &Configuration) -> Result<(), Refusal> {
        for (axis, parameters) in Axis::ALL.into_iter().zip(&configuration.axes) {
            let Some(settings) = &parameters.driver else { continue };
            let set_up = match &mut self.options.drivers {
                Some(bus) => Tmc2209 { bus: &mut **bus, node: axis.index() as u8 }.set_up(settings),
                None => Err(DriverTrouble::NoWire),
            };
            set_up.map_err(|trouble| Refusal::Driver { axis, trouble })?;
        }
        Ok(())
    }

    /// Homes, and before it sets up the drivers, which forget when their supply is cut.
    pub(super) fn prepare_homing(
        &mut self,
        now_us: u64,
        configuration: &Configuration,
        purpose: Purpose,
    ) -> Result<Task, Trouble> {
        if configuration.axes.iter().all(|axis| axis.driver.is_none()) {
            return self.begin_homing(now_us, configuration, purpose);
        }
        self.set_up_drivers(configuration)?;
        // That took time, which the next poll will know.
        Ok(Task::BeginHoming(purpose))
    }

    /// Homes once the drivers are set up.
    pub(super) fn home_on(
        &mut self,
        now_us: u64,
        task: &mut Task,
        purpose: Purpose,
    ) -> Result<Option<Outcome>, (Fault, Option<Axis>)> {
        let Some(configuration) = self.configuration else { return Ok(None) };
        match self.begin_homing(now_us, &configuration, purpose) {
            Ok(next) => {
                *task = next;
                Ok(None)
            }
            Err(Trouble::Refusal(refusal)) => Ok(Some(Outcome::Refused(refusal))),
            Err(Trouble::Pin) => Err((Fault::Hardware, None)),
        }
    }
}
