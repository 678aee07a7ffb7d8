//! The chip's registers, by their addresses in the LM3S6965 data sheet. All access to memory by address is
//! here.

/// A 32-bit register.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Register(usize);

impl Register {
    pub(crate) fn read(self) -> u32 {
        // SAFETY: `Register`s are made only in this module, of addresses of device registers; none has memory
        // behind it.
        unsafe { core::ptr::with_exposed_provenance::<u32>(self.0).read_volatile() }
    }

    pub(crate) fn write(self, value: u32) {
        // SAFETY: as in `read`; no register here makes the chip touch memory on its own.
        unsafe { core::ptr::with_exposed_provenance_mut::<u32>(self.0).write_volatile(value) }
    }

    pub(crate) fn set_bits(self, bits: u32) {
        self.write(self.read() | bits);
    }
}

/// A word of the flash.
#[cfg(not(feature = "qemu"))]
pub(crate) fn flash_word(address: u32) -> u32 {
    const FLASH_BYTES: u32 = 256 * 1024;
    if address >= FLASH_BYTES || !address.is_multiple_of(4) {
        return u32::MAX;
    }
    // SAFETY: an aligned address in the flash, whose bits are a number; it may change only while the
    // controller writes.
    unsafe { core::ptr::with_exposed_provenance::<u32>(address as usize).read_volatile() }
}

/// The watchdog.
pub(crate) mod watchdog {
    use super::Register;

    pub(crate) const LOAD: Register = Register(0x4000_0000);
    pub(crate) const CTL: Register = Register(0x4000_0008);
}

/// The flash's controller.
#[cfg(not(feature = "qemu"))]
pub(crate) mod flash {
    use super::Register;

    pub(crate) const FMA: Register = Register(0x400F_D000);
    pub(crate) const FMD: Register = Register(0x400F_D004);
    pub(crate) const FMC: Register = Register(0x400F_D008);
    pub(crate) const FCRIS: Register = Register(0x400F_D00C);
    pub(crate) const FCMISC: Register = Register(0x400F_D014);
    /// Counts of the system clock a µs, less 1.
    pub(crate) const USECRL: Register = Register(0x400F_E140);

    /// In `FMC`: without it nothing happens.
    pub(crate) const KEY: u32 = 0xA442 << 16;
    pub(crate) const WRITE: u32 = 1 << 0;
    pub(crate) const ERASE: u32 = 1 << 1;
    /// In `FCRIS` and `FCMISC`: the page is protected.
    pub(crate) const REFUSED: u32 = 1 << 0;
}

/// System control: clocks and resets.
pub(crate) mod system {
    use super::Register;

    /// What the last resets were caused by.
    pub(crate) const RESC: Register = Register(0x400F_E05C);
    /// In `RESC`.
    pub(crate) const RESET_BY_WATCHDOG: u32 = 1 << 3;

    /// Raw interrupt status; bit 6: PLL locked.
    pub(crate) const RIS: Register = Register(0x400F_E050);
    /// Run-mode clock configuration.
    pub(crate) const RCC: Register = Register(0x400F_E060);
    /// Clock gates: watchdog, ADC, PWM.
    pub(crate) const RCGC0: Register = Register(0x400F_E100);
    /// Clock gates: UART, timers.
    pub(crate) const RCGC1: Register = Register(0x400F_E104);
    /// Clock gates: GPIO ports.
    pub(crate) const RCGC2: Register = Register(0x400F_E108);
}

/// UART 0.
pub(crate) mod uart {
    use super::Register;

    pub(crate) const DR: Register = Register(0x4000_C000);
    pub(crate) const FR: Register = Register(0x4000_C018);
    pub(crate) const IBRD: Register = Register(0x4000_C024);
    pub(crate) const FBRD: Register = Register(0x4000_C028);
    pub(crate) const LCRH: Register = Register(0x4000_C02C);
    pub(crate) const CTL: Register = Register(0x4000_C030);
    pub(crate) const IM: Register = Register(0x4000_C038);
    pub(crate) const ICR: Register = Register(0x4000_C044);

    /// In `DR`: bytes were lost before this one.
    pub(crate) const OVERRUN: u32 = 1 << 11;
    /// In `FR`: nothing received.
    pub(crate) const RECEIVE_EMPTY: u32 = 1 << 4;
    /// In `FR`: no room to send.
    pub(crate) const SEND_FULL: u32 = 1 << 5;
}

/// Timers.
pub(crate) mod timer {
    use super::Register;

    /// A timer, by its first register.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Timer(usize);

    /// Ends the main loop's sleep.
    pub(crate) const SLEEP: Timer = Timer(0x4003_0000);
    /// Makes the steps.
    pub(crate) const STEPS: Timer = Timer(0x4003_1000);

    impl Timer {
        pub(crate) const fn configuration(self) -> Register {
            Register(self.0)
        }

        pub(crate) const fn mode(self) -> Register {
            Register(self.0 + 0x04)
        }

        pub(crate) const fn control(self) -> Register {
            Register(self.0 + 0x0C)
        }

        /// Which interrupts are let through.
        pub(crate) const fn interrupts(self) -> Register {
            Register(self.0 + 0x18)
        }

        /// Forgets interrupts.
        pub(crate) const fn clear(self) -> Register {
            Register(self.0 + 0x24)
        }

        /// What it counts down from.
        pub(crate) const fn load(self) -> Register {
            Register(self.0 + 0x28)
        }
    }
}

/// The converter; sequencer 3 makes one sample.
#[cfg(not(feature = "qemu"))]
pub(crate) mod adc {
    use super::Register;

    pub(crate) const ACTSS: Register = Register(0x4003_8000);
    pub(crate) const RIS: Register = Register(0x4003_8004);
    pub(crate) const ISC: Register = Register(0x4003_800C);
    pub(crate) const PSSI: Register = Register(0x4003_8028);
    pub(crate) const SSMUX3: Register = Register(0x4003_80A0);
    pub(crate) const SSCTL3: Register = Register(0x4003_80A4);
    pub(crate) const SSFIFO3: Register = Register(0x4003_80A8);
}

/// The pulse-width modulator's generator 0.
pub(crate) mod pwm {
    use super::Register;

    pub(crate) const ENABLE: Register = Register(0x4002_8008);
    pub(crate) const CTL: Register = Register(0x4002_8040);
    pub(crate) const LOAD: Register = Register(0x4002_8050);
    pub(crate) const CMPA: Register = Register(0x4002_8058);
    pub(crate) const GENA: Register = Register(0x4002_8060);
}

/// A GPIO port.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Port(usize);

pub(crate) const PORT_A: Port = Port(0x4000_4000);
pub(crate) const PORT_B: Port = Port(0x4000_5000);
pub(crate) const PORT_D: Port = Port(0x4000_7000);
pub(crate) const PORT_E: Port = Port(0x4002_4000);
pub(crate) const PORT_F: Port = Port(0x4002_5000);

impl Port {
    /// The data register seen through a mask: only the pins in it are read or written.
    pub(crate) const fn data(self, pins: u8) -> Register {
        Register(self.0 + ((pins as usize) << 2))
    }

    /// Which pins are outputs.
    pub(crate) const fn direction(self) -> Register {
        Register(self.0 + 0x400)
    }

    /// Which pins belong to another unit.
    pub(crate) const fn alternate(self) -> Register {
        Register(self.0 + 0x420)
    }

    /// Which pins interrupt, at a rising edge with `rising`.
    pub(crate) const fn interrupts(self) -> Register {
        Register(self.0 + 0x410)
    }

    /// Which pins' interrupts come at the rising edge.
    pub(crate) const fn rising(self) -> Register {
        Register(self.0 + 0x40C)
    }

    /// Forgets pins' interrupts.
    pub(crate) const fn clear(self) -> Register {
        Register(self.0 + 0x41C)
    }

    /// Which pins are pulled down.
    pub(crate) const fn pull_down(self) -> Register {
        Register(self.0 + 0x514)
    }

    /// Which pins are digital.
    pub(crate) const fn digital(self) -> Register {
        Register(self.0 + 0x51C)
    }
}
