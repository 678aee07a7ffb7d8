//! Instructions a step, counted in QEMU, and the step rates that follow.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, bail};

/// Cycles of an instruction, meant over code that loads, stores, multiplies and branches from flash with its
/// accelerator on: the Cortex-M4 needs 1 for most, 2 for a load, 2 to 4 for a taken branch, 2 to 12 for a
/// division. Assumed, not measured.
const CYCLES_PER_INSTRUCTION: f64 = 1.5;
/// Cycles of an interrupt's entry and exit.
const CYCLES_PER_INTERRUPT: f64 = 24.0;

/// How QEMU runs a board's counting program, and the chip whose rate it tells.
struct Machine {
    board: &'static str,
    machine: &'static str,
    /// QEMU's serial ports before the one that is used.
    ports_before: usize,
    chip: &'static str,
    clock_hz: f64,
}

const MACHINES: [Machine; 2] = [
    Machine {
        board: "lm3s6965",
        machine: "lm3s6965evb",
        ports_before: 0,
        chip: "Cortex-M3 at 72 MHz (as STM32F103)",
        clock_hz: 72e6,
    },
    Machine {
        board: "stm32f405",
        machine: "olimex-stm32-h405",
        ports_before: 1,
        chip: "STM32F405 at 168 MHz",
        clock_hz: 168e6,
    },
];

/// Ends QEMU whatever happens.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Counts and prints a board's rates.
pub(crate) fn print(board: &str, programs: &Path) -> Result<()> {
    let machine = MACHINES.iter().find(|machine| machine.board == board).context("no machine for it")?;
    println!("{}: {CYCLES_PER_INSTRUCTION} cycles an instruction assumed", machine.chip);
    println!("  axes     steps  interrupts/step  instructions/step  cycles/step   steps/s at full load");
    for line in count(machine, &programs.join(format!("{board}-rates")))? {
        let value = |name: &str| -> Option<f64> {
            line.split(' ').find_map(|word| word.strip_prefix(name)?.strip_prefix('=')?.parse().ok())
        };
        let (Some(axes), Some(steps), Some(calls), Some(instructions)) =
            (value("axes"), value("steps"), value("calls"), value("instructions"))
        else {
            bail!("the counting program said `{line}`");
        };
        let each = instructions / steps;
        let interrupts = calls / steps;
        let cycles = each * CYCLES_PER_INSTRUCTION + interrupts * CYCLES_PER_INTERRUPT;
        let rate = machine.clock_hz / cycles;
        println!("  {axes:>4} {steps:>9} {interrupts:>16.2} {each:>18.1} {cycles:>12.0} {rate:>13.0}");
    }
    Ok(())
}

/// The lines that the counting program prints before its last.
fn count(machine: &Machine, program: &Path) -> Result<Vec<String>> {
    let mut qemu = Command::new("qemu-system-arm");
    qemu.args(["-M", machine.machine, "-nographic", "-monitor", "none", "-icount", "shift=3,sleep=off"]);
    qemu.arg("-kernel").arg(program);
    for _ in 0..machine.ports_before {
        qemu.args(["-serial", "null"]);
    }
    qemu.args(["-serial", "stdio"]).stdin(Stdio::null()).stdout(Stdio::piped());
    let mut running = Running(qemu.spawn().context("qemu-system-arm")?);
    let output = running.0.stdout.take().context("QEMU has no output")?;
    let mut lines = Vec::new();
    for line in BufReader::new(output).lines() {
        let line = line?;
        match line.as_str() {
            "end" => return Ok(lines),
            "refused" => bail!("the controller refused the counting program's requests"),
            _ => lines.push(line),
        }
    }
    bail!("QEMU ended before the counting program did")
}
