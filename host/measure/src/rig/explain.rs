//! Sentences for what the controller reports: what is wrong and what to do about it.

use lobelia_protocol::{Axis, DriverTrouble, Fault, FaultReport, Faults, Field, HelloReply, Refusal, schema};

use lobelia_base::error::Error;

/// Why a request failed.
pub(crate) fn refusal(refusal: Refusal) -> Error {
    match refusal {
        Refusal::NoSession => Error::failure(
            "the rig's controller was restarted or taken over by another program, so its positions are lost; \
             check its power and cable, then start again (acquire: with --resume)",
        ),
        Refusal::Stale => {
            Error::failure("the rig's controller no longer knows the answer to a request; start again")
        }
        Refusal::NotConfigured => {
            Error::failure("the rig's controller has no configuration; configure it first")
        }
        Refusal::BadParameter { axis, field } => {
            let of = axis.map_or(String::new(), |axis| format!(" of {}", axis.name()));
            Error::input(format!("the rig's controller refuses {}{of}: {}", name(field), range(field)))
        }
        Refusal::Busy => Error::failure(
            "the rig's controller is running what is no move, so it can't be given another target; stop it \
             first",
        ),
        Refusal::PositionUnknown(axis) => {
            Error::failure(format!("the position of {} is unknown; home the rig first", axis.name()))
        }
        Refusal::OutOfLimits(axis) => Error::input(format!(
            "the target of {} is beyond its limits: correct the plan or the limits in the rig's file; or, \
             where it was to be homed, its cables are wound up too far by homings that found no switch: \
             switch the motors off, unwind them by hand, mend the switch, and switch the controller off and \
             on",
            axis.name()
        )),
        Refusal::LampNotWarm { remaining_s: Some(seconds) } => {
            Error::failure(format!("the lamp is not warm yet; wait another {seconds} s"))
        }
        Refusal::LampNotWarm { remaining_s: None } => {
            Error::failure("the lamp is off; switch it on and let it warm up")
        }
        Refusal::Faulted(set) => Error::failure(faults(set)),
        Refusal::EmergencyStopPressed => {
            Error::failure("the emergency stop is still pressed; release it, then clear the faults")
        }
        Refusal::CameraNotReady => Error::failure(
            "the camera did not become ready; check its power, its card and its cable to the controller",
        ),
        Refusal::ShutterLate { late_us } => Error::failure(format!(
            "the shutter closed {late_us} µs late, so the exposure is not what was asked for; repeat it"
        )),
        Refusal::OutOfWindow => {
            Error::failure("too many requests are under way at the rig's controller; start again")
        }
        Refusal::NoStorage => {
            Error::failure("the rig's controller has no memory for parameters, or it can't be written")
        }
        Refusal::Driver { axis, trouble } => driver(axis, trouble),
        Refusal::Skipped { after } => Error::failure(format!(
            "the rig's controller did not begin a request, because request {after} before it was refused"
        )),
        Refusal::NotAtRest => Error::failure(
            "parameters can only be saved while the lamp is off, since writing them holds the controller up; \
             put the lamp out first",
        ),
        Refusal::KeepOut { first, second } => Error::input(format!(
            "{} and {} would come where they must not be together, at the target, on the way there or while \
             one of them is homed; see [[keep_out]] in the rig's file, and move one after the other",
            first.name(),
            second.name()
        )),
        Refusal::Stopped => Error::failure("the rig was stopped before it had finished"),
    }
}

/// Why an axis's driver could not be set up.
fn driver(axis: Axis, trouble: DriverTrouble) -> Error {
    let axis = axis.name();
    match trouble {
        DriverTrouble::NoWire => Error::input(format!(
            "this controller has no wire to motor drivers; take [axes.{axis}.driver] out of the rig's file"
        )),
        DriverTrouble::Current => Error::input(format!(
            "the driver of {axis} cannot make run_ma or hold_ma with its sense resistors, sense_mohm"
        )),
        DriverTrouble::Microsteps => {
            Error::input(format!("the driver of {axis} cannot make so many microsteps"))
        }
        DriverTrouble::Silent => Error::failure(format!(
            "the driver of {axis} does not answer; check the motors' supply, its address pins and the wire \
             to it"
        )),
        DriverTrouble::Garbled | DriverTrouble::WriteLost => Error::failure(format!(
            "the driver of {axis} was not understood or did not take its settings; check the wire to it"
        )),
    }
}

/// A fault as it was reported.
pub(crate) fn fault_report(report: &FaultReport) -> String {
    fault(report.fault, report.axis)
}

/// Why a request failed because of faults, one of which was reported with its axis.
pub(crate) fn faulted(set: Faults, report: &FaultReport) -> Error {
    let others = set.iter().filter(|one| *one != report.fault).map(|one| fault(one, None));
    Error::failure(with_advice(std::iter::once(fault_report(report)).chain(others)))
}

fn faults(set: Faults) -> String {
    with_advice(set.iter().map(|one| fault(one, None)))
}

fn with_advice(sentences: impl Iterator<Item = String>) -> String {
    let mut sentences: Vec<_> = sentences.collect();
    sentences.push("clear the faults and home the rig before it moves again".to_owned());
    sentences.join("; ")
}

fn fault(fault: Fault, axis: Option<Axis>) -> String {
    let of = axis.map_or("an axis".to_owned(), |axis| format!("the {} axis", axis.name()));
    match fault {
        Fault::EmergencyStop => {
            "the emergency stop was pressed: make sure that the rig is clear and release it".to_owned()
        }
        Fault::LimitHit => {
            format!("{of} reached its home switch during a move: it lost steps, so look for what blocks it")
        }
        Fault::HomingFailed => {
            format!("{of} did not find its home switch: check the switch, its cable and home_travel")
        }
        Fault::StepsLost => {
            format!(
                "{of} has lost steps since the last check, as its home switch shows: look for what blocks it"
            )
        }
        Fault::Stall => format!("the motor of {of} stalled: look for what blocks it"),
        Fault::OverTemperature => {
            "lamp or drivers are too hot and the lamp was put out: let them cool, look at the fans".to_owned()
        }
        Fault::LampFailure => {
            "the lamp is switched on, but its photodiode is dark: check the lamp, its supply and the \
             photodiode"
                .to_owned()
        }
        Fault::StepsLate => format!(
            "the controller could not make the steps of {of} in time, so the motor may have lost some: lower \
             max_speed_deg_s, and report it with a recording (--record)"
        ),
        Fault::SwitchStuck => format!(
            "the home switch of {of} stayed closed over home_switch_deg: its wire is broken, or it is stuck, \
             or home_switch_deg is too small"
        ),
        Fault::DriverLost => format!(
            "the motor driver of {of} has lost its settings or no longer answers: check its supply and the \
             wire to it, then `lobelia rig clear`; acquire --resume homes anew and says which poses were not \
             checked for lost steps"
        ),
        Fault::DriverAlarm => format!(
            "the motor driver of {of} tells an alarm: look at its light or its data sheet for which, and at \
             its supply; an input that is wired the other way round has \"alarm\" among `invert` of its axis"
        ),
        Fault::LampTimeout => {
            "the lamp has burnt for longest_s of the rig's file and was put out; positions are kept"
                .to_owned()
        }
        Fault::LeaseExpired => {
            "the controller heard nothing from the host for too long, so it stopped and dimmed the lamp; \
             positions are kept"
                .to_owned()
        }
        Fault::Hardware => "the controller could not drive or read a pin: check its wiring".to_owned(),
    }
}

fn name(field: Field) -> &'static str {
    match field {
        Field::Limits => "the limits",
        Field::MaxSpeed => "the highest speed",
        Field::Acceleration => "the acceleration",
        Field::TakeUp => "the take-up",
        Field::HomePosition => "the home position",
        Field::HomeSpeed => "the homing speeds",
        Field::HomeTravel => "the homing travel or back-off",
        Field::Duration => "the exposure's duration",
        Field::Jerk => "the jerk",
        Field::FullTurn => "the full turn",
        Field::Approaches => "the number of approaches",
        Field::TelemetryPeriod => "the period of telemetry",
        Field::Pulse => "the length of step pulses",
        Field::StepRate => "the sum of all axes' highest speeds",
        Field::Axes => "the choice of axes",
        Field::LampTime => "the lamp's longest time",
        Field::Alarm => "the alarm input",
        Field::Wiring => "the inverted pins",
        Field::KeepOut => "a keep-out",
    }
}

fn range(field: Field) -> &'static str {
    match field {
        Field::Limits => "the lower has to be below the upper, both within ±2^29 steps",
        Field::MaxSpeed => "it has to be 1 to 200000 steps/s",
        Field::Acceleration => {
            "it has to be 1 to 10000000 steps/s², and reach the highest speed within 1000 s"
        }
        Field::Jerk => "it has to be 1 to 1000000000 steps/s³",
        Field::Approaches => "it has to be 1 to 100",
        Field::TelemetryPeriod => "it has to be 20 ms at least",
        Field::FullTurn => "a turn has to hold the limits and be over twice the take-up, in whole steps",
        Field::TakeUp => "it has to be at most 2^20 steps",
        Field::HomePosition => {
            "it has to lie beyond the limits on the switch's side, by more than the take-up below"
        }
        Field::HomeSpeed => "they have to be at least 1 step/s and at most the highest speed",
        Field::HomeTravel => {
            "the back-off has to be within the travel, the switch's width at least one step, all at most \
             2^29 steps"
        }
        Field::Pulse => {
            "it has to be 1 to 100 µs, and two pulses, a µs more each, and 1 µs have to fit between two \
             steps at the highest speed"
        }
        Field::StepRate => {
            "the board cannot make so many steps a second; lower max_speed_deg_s or the microsteps"
        }
        Field::Axes => "at least one has to be chosen",
        Field::LampTime => "it has to be 1 s to a week",
        Field::Alarm => "the board has no such input; say alarm = \"none\" for the axis",
        Field::Wiring => "there are some that it does not have",
        Field::KeepOut => {
            "it has to be of two axes that do not turn round and round, with different home_order, and that \
             which is homed first has to be out of the other's way then"
        }
        Field::Duration => "it has to be within the controller's shortest and longest exposure",
    }
}

/// Two programs that don't understand each other.
pub(crate) fn different_schema(reply: &HelloReply) -> Error {
    Error::input(format!(
        "the rig's controller speaks protocol version {} (schema {:016x}) and this program version {} \
         (schema {:016x}); install matching firmware or the matching lobelia; nothing was moved, and \
         `lobelia rig safe` stops and darkens it all the same",
        reply.hello.version,
        reply.hello.schema,
        schema::VERSION,
        schema::IDENTITY
    ))
}
