//! The TMC2209 by its one-wire UART: datagrams with a CRC-8, and the few registers that set current,
//! microsteps and stall threshold (its datasheet, sections 4 and 5).

use lobelia_protocol::{DriverParameters, DriverTrouble};

use crate::driver::{DriverBus, StepperDriver};

const SYNC: u8 = 5;
const WRITE: u8 = 0x80;
/// Replies are addressed to the master.
const MASTER: u8 = 0xff;

/// Registers.
mod register {
    pub(super) const GCONF: u8 = 0x00;
    pub(super) const IFCNT: u8 = 0x02;
    pub(super) const NODECONF: u8 = 0x03;
    pub(super) const IHOLD_IRUN: u8 = 0x10;
    pub(super) const TCOOLTHRS: u8 = 0x14;
    pub(super) const SGTHRS: u8 = 0x40;
    pub(super) const CHOPCONF: u8 = 0x6C;
}

/// `pdn_disable` and `mstep_reg_select`, over the defaults: the UART and its microsteps instead of pins,
/// current not by the analog input.
const GCONF: u32 = 1 << 6 | 1 << 7;
/// As after power-up, interpolating to 256 microsteps, but for the microsteps taken in.
const CHOPCONF: u32 = 0x1000_0053;
/// A driver waits so long, 3 × 8 bit times, before it replies: with several on one wire another could take a
/// reply that comes at once for a request.
const NODECONF: u32 = 2 << 8;
/// Steps of the current's slow fall to the hold current, each 2¹⁸ clocks.
const HOLD_DELAY: u32 = 8;
/// The driver's own clock, Hz.
const CLOCK: u64 = 12_000_000;
/// A driver counts time in 1/256 steps.
const FINE_STEPS: u64 = 256;
/// Full-scale voltage over the sense resistor, µV, and the resistance in series with it, mΩ.
const FULL_SCALE_UV: u64 = 325_000;
const SERIES_MOHM: u64 = 20;
/// √2, times 10⁶.
const ROOT_2_PPM: u64 = 1_414_214;

/// CRC-8 with the polynomial x⁸ + x² + x + 1, each byte's low bit first.
pub const fn crc8(bytes: &[u8]) -> u8 {
    let mut crc = 0u8;
    let mut i = 0;
    while i < bytes.len() {
        let mut byte = bytes[i];
        let mut bit = 0;
        while bit < 8 {
            let carry = (crc >> 7) ^ (byte & 1);
            crc <<= 1;
            if carry != 0 {
                crc ^= 0x07;
            }
            byte >>= 1;
            bit += 1;
        }
        i += 1;
    }
    crc
}

/// The datagram that writes a register.
pub fn write_datagram(node: u8, register: u8, value: u32) -> [u8; 8] {
    let [a, b, c, d] = value.to_be_bytes();
    let mut datagram = [SYNC, node, register | WRITE, a, b, c, d, 0];
    datagram[7] = crc8(&datagram[..7]);
    datagram
}

/// The datagram that asks for a register.
pub fn read_datagram(node: u8, register: u8) -> [u8; 4] {
    let mut datagram = [SYNC, node, register, 0];
    datagram[3] = crc8(&datagram[..3]);
    datagram
}

/// The value in a driver's reply about a register.
pub fn read_reply(register: u8, reply: &[u8; 8]) -> Option<u32> {
    let [SYNC, MASTER, of, a, b, c, d, crc] = *reply else { return None };
    (of == register && crc == crc8(&reply[..7])).then_some(u32::from_be_bytes([a, b, c, d]))
}

/// The current setting, 0 to 31, for a current in mA RMS: (setting + 1)/32 of the full scale, rounded down.
pub fn current_setting(ma: u16, sense_mohm: u16) -> Option<u8> {
    let full_scale_ua = FULL_SCALE_UV * 1_000_000_000 / (u64::from(sense_mohm) + SERIES_MOHM) / ROOT_2_PPM;
    let setting = (u64::from(ma) * 1000 * 32 / full_scale_ua.max(1)).checked_sub(1)?;
    u8::try_from(setting).ok().filter(|setting| *setting < 32)
}

/// The threshold in clocks a 1/256 step, for a speed in microsteps/s at `microsteps` a full step.
fn clocks_per_fine_step(speed: u32, microsteps: u16) -> u32 {
    let fine = u64::from(speed) * FINE_STEPS / u64::from(microsteps.max(1));
    CLOCK.checked_div(fine).map_or((1 << 20) - 1, |clocks| clocks.min((1 << 20) - 1) as u32)
}

/// The code of microsteps a full step, 0 for 256 to 8 for 1.
fn microstep_code(microsteps: u16) -> Option<u32> {
    (microsteps.is_power_of_two() && microsteps <= 256).then(|| 8 - microsteps.trailing_zeros())
}

/// One TMC2209 on a bus.
pub struct Tmc2209<'a> {
    /// The wire.
    pub bus: &'a mut dyn DriverBus,
    /// Its address, 0 to 3, by its pins.
    pub node: u8,
}

impl Tmc2209<'_> {
    fn read(&mut self, register: u8) -> Result<u32, DriverTrouble> {
        let mut reply = [0; 8];
        if !self.bus.send(&read_datagram(self.node, register)) || !self.bus.receive(&mut reply) {
            return Err(DriverTrouble::Silent);
        }
        read_reply(register, &reply).ok_or(DriverTrouble::Garbled)
    }
}

impl StepperDriver for Tmc2209<'_> {
    fn set_up(&mut self, settings: &DriverParameters) -> Result<(), DriverTrouble> {
        let current =
            |ma| current_setting(ma, settings.sense_mohm).map(u32::from).ok_or(DriverTrouble::Current);
        let (run, hold) = (current(settings.run_ma)?, current(settings.hold_ma)?);
        let microsteps = microstep_code(settings.microsteps).ok_or(DriverTrouble::Microsteps)?;
        let stall_above = clocks_per_fine_step(settings.stall_above_speed, settings.microsteps);
        let writes = [
            (register::NODECONF, NODECONF),
            (register::GCONF, GCONF),
            (register::CHOPCONF, CHOPCONF | microsteps << 24),
            (register::IHOLD_IRUN, hold | run << 8 | HOLD_DELAY << 16),
            (register::TCOOLTHRS, stall_above),
            (register::SGTHRS, u32::from(settings.stall_threshold)),
        ];
        // Before anything is asked: until it is told to wait, a driver's reply may be lost among several.
        if !self.bus.send(&write_datagram(self.node, register::NODECONF, NODECONF)) {
            return Err(DriverTrouble::Silent);
        }
        let before = self.read(register::IFCNT)? as u8;
        for (register, value) in writes {
            if !self.bus.send(&write_datagram(self.node, register, value)) {
                return Err(DriverTrouble::Silent);
            }
        }
        let after = self.read(register::IFCNT)? as u8;
        if after.wrapping_sub(before) == writes.len() as u8 { Ok(()) } else { Err(DriverTrouble::WriteLost) }
    }

    fn keeps(&mut self, settings: &DriverParameters) -> Result<bool, DriverTrouble> {
        let microsteps = microstep_code(settings.microsteps).ok_or(DriverTrouble::Microsteps)?;
        // After a reset the pins choose the microsteps, and the code is 0.
        let chosen = self.read(register::GCONF)? & GCONF == GCONF;
        Ok(chosen && self.read(register::CHOPCONF)? >> 24 & 0xF == microsteps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn read_requests_are_those_that_drivers_answer() {
        // Requests to node 0 as programs for the chip send them, register and checksum.
        let known = [
            (0, 0x48),
            (1, 0xc1),
            (2, 0x8f),
            (5, 0x21),
            (6, 0x6f),
            (7, 0xe6),
            (0x12, 0xb7),
            (0x6a, 0xed),
            (0x6f, 0x84),
            (0x71, 0xeb),
        ];
        for (register, crc) in known {
            assert_eq!(read_datagram(0, register), [5, 0, register, crc]);
        }
    }

    #[test]
    fn reply_with_any_bit_flipped_is_refused() {
        let mut reply = [5, 0xff, 2, 0x12, 0x34, 0x56, 0x78, 0];
        reply[7] = crc8(&reply[..7]);
        assert_eq!(read_reply(2, &reply), Some(0x1234_5678));
        assert_eq!(read_reply(3, &reply), None);
        for bit in 0..64 {
            let mut bad = reply;
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(read_reply(2, &bad), None);
        }
    }

    #[test]
    fn current_settings_are_those_of_the_datasheet() {
        // Its table for 0.11 Ω: the full scale is 1.77 A RMS; half of it is setting 15.
        assert_eq!(current_setting(1768, 110), Some(31));
        assert_eq!(current_setting(884, 110), Some(15));
        assert_eq!((current_setting(1900, 110), current_setting(20, 110)), (None, None));
    }

    /// A driver that keeps its registers and may lose a write.
    struct Chip {
        registers: [u32; 128],
        writes: u32,
        asked: u8,
        loses: Option<u32>,
        silent: bool,
    }

    impl Default for Chip {
        fn default() -> Self {
            Self { registers: [0; 128], writes: 0, asked: 0, loses: None, silent: false }
        }
    }

    impl DriverBus for Chip {
        fn send(&mut self, bytes: &[u8]) -> bool {
            match *bytes {
                [SYNC, 1, register, a, b, c, d, _] if register & WRITE != 0 => {
                    if self.loses != Some(self.writes) {
                        self.registers[usize::from(register & !WRITE)] = u32::from_be_bytes([a, b, c, d]);
                        self.registers[2] += 1;
                    }
                    self.writes += 1;
                }
                [SYNC, 1, register, _] => self.asked = register,
                _ => return false,
            }
            true
        }

        fn receive(&mut self, into: &mut [u8]) -> bool {
            let [a, b, c, d] = self.registers[usize::from(self.asked)].to_be_bytes();
            let mut reply = [SYNC, MASTER, self.asked, a, b, c, d, 0];
            reply[7] = crc8(&reply[..7]);
            into.copy_from_slice(&reply);
            !self.silent
        }
    }

    const SETTINGS: DriverParameters = DriverParameters {
        run_ma: 884,
        hold_ma: 442,
        sense_mohm: 110,
        microsteps: 16,
        stall_threshold: 60,
        stall_above_speed: 4000,
    };

    fn set_up(chip: &mut Chip, settings: &DriverParameters) -> Result<(), DriverTrouble> {
        Tmc2209 { bus: chip, node: 1 }.set_up(settings)
    }

    #[test]
    fn set_up_writes_current_microsteps_and_stall_threshold() {
        let mut chip = Chip::default();
        chip.registers[2] = 254;
        assert_eq!(set_up(&mut chip, &SETTINGS), Ok(()));
        assert_eq!(chip.registers[0x10], 7 | 15 << 8 | 8 << 16);
        // 16 microsteps are code 4.
        assert_eq!(chip.registers[0x6c], 0x1400_0053);
        // 4000 microsteps/s are 64 000 fine steps: 187 clocks each.
        assert_eq!((chip.registers[0x14], chip.registers[0x40]), (187, 60));
    }

    #[test]
    fn driver_that_was_reset_or_steps_otherwise_does_not_keep_its_settings() {
        let mut chip = Chip::default();
        let keeps = |chip: &mut Chip| Tmc2209 { bus: chip, node: 1 }.keeps(&SETTINGS);
        assert_eq!(keeps(&mut chip), Ok(false));
        set_up(&mut chip, &SETTINGS).unwrap();
        assert_eq!((keeps(&mut chip), chip.registers[3]), (Ok(true), 2 << 8));
        chip.registers[0x6c] &= 0x00ff_ffff;
        assert_eq!(keeps(&mut chip), Ok(false));
        set_up(&mut chip, &SETTINGS).unwrap();
        chip.silent = true;
        assert_eq!(keeps(&mut chip), Err(DriverTrouble::Silent));
    }

    #[test]
    fn lost_write_silence_and_bad_settings_are_told() {
        let mut chip = Chip { loses: Some(2), ..Chip::default() };
        assert_eq!(set_up(&mut chip, &SETTINGS), Err(DriverTrouble::WriteLost));
        let mut chip = Chip { silent: true, ..Chip::default() };
        assert_eq!(set_up(&mut chip, &SETTINGS), Err(DriverTrouble::Silent));
        let settings = DriverParameters { run_ma: 3000, ..SETTINGS };
        assert_eq!(set_up(&mut Chip::default(), &settings), Err(DriverTrouble::Current));
        let settings = DriverParameters { microsteps: 20, ..SETTINGS };
        assert_eq!(set_up(&mut Chip::default(), &settings), Err(DriverTrouble::Microsteps));
    }
}
