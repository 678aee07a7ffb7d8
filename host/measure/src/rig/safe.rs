//! What any controller understands, whichever version its program is of: to stop, to go dark, and to tell its
//! state.

use std::time::Duration;

use lobelia_protocol::{SafeCommand, SafeState, ToController, ToHost};

use crate::rig::client::silent;
use crate::rig::port::Port;
use crate::rig::wire::Wire;
use lobelia_base::error::Result;

const PATIENCE: Duration = Duration::from_millis(300);
const REPETITIONS: u32 = 20;

/// Asks for something until it is answered; asking again does no harm.
///
/// # Errors
/// When the port fails or nothing answers.
pub fn ask(port: Box<dyn Port>, commands: &[SafeCommand]) -> Result<Option<SafeState>> {
    let mut wire = Wire::new(port);
    let mut last = None;
    for &command in commands {
        last = Some(ask_one(&mut wire, command)?);
    }
    Ok(last)
}

fn ask_one(wire: &mut Wire, command: SafeCommand) -> Result<SafeState> {
    for _ in 0..REPETITIONS {
        wire.send(&ToController::Safe(command))?;
        while let Some(packet) = wire.receive(PATIENCE)? {
            match packet {
                ToHost::Safe(state) if state.command == command => return Ok(state),
                _ => {}
            }
        }
    }
    Err(silent())
}

/// The state in a few words.
pub fn text(state: &SafeState) -> String {
    let words = [
        (state.moving, "axes moving"),
        (state.busy && !state.moving, "busy"),
        (!state.moving, "axes at rest"),
        (state.lamp, "lamp burning"),
        (!state.lamp, "lamp off"),
        (state.shutter, "shutter open"),
        (state.emergency_stop, "emergency stop pressed"),
        (state.fault, "a fault is set"),
        (!state.known, "not homed"),
        (!state.configured, "no parameters set"),
    ];
    let said: Vec<_> = words.iter().filter(|(holds, _)| *holds).map(|(_, word)| *word).collect();
    format!("{}, up for {} s", said.join(", "), state.uptime_s)
}

#[cfg(test)]
mod tests {
    use lobelia_hil_sim::{MechanicsConfig, SimulatedRig};

    use super::*;
    use crate::rig::RigClient;

    #[test]
    fn rig_of_any_version_is_stopped_and_darkened_without_a_session() {
        let rig = SimulatedRig::new(&MechanicsConfig::ideal());
        let mut client = RigClient::connect(Box::new(rig.link())).unwrap();
        client.configure(&MechanicsConfig::ideal().configuration()).unwrap();
        client.lamp(true, 1.0).unwrap();
        drop(client);
        let ask = |commands: &[SafeCommand]| ask(Box::new(rig.link()), commands).unwrap().unwrap();
        assert!(ask(&[SafeCommand::Ask]).lamp);
        let dark = ask(&[SafeCommand::Stop, SafeCommand::Darken]);
        assert!(!dark.lamp && !dark.moving && dark.configured);
        assert!(text(&dark).starts_with("axes at rest, lamp off, not homed"), "{}", text(&dark));
    }
}
