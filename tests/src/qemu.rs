//! The boards' programs in QEMU: a serial port on a unix socket, and a watcher of pins through QEMU's qtest
//! protocol, which tells each edge from outside the emulated chip.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use lobelia::rig::Port;
use lobelia::rig::trace::Step;
use lobelia_protocol::Axis;
use serde_json::{Value, json};

/// How long QEMU may take to answer before the test gives up.
const PATIENCE: Duration = Duration::from_secs(60);

/// Steps that the trace under emulation holds.
const STEPS_HELD: u32 = lobelia_board_support::trace::STEPS as u32;

/// A board as QEMU knows it.
#[derive(Debug, Clone, Copy)]
pub struct Machine {
    /// The board's folder in firmware/boards.
    pub board: &'static str,
    /// QEMU's name for it.
    pub machine: &'static str,
    /// Serial ports before the one that the firmware uses.
    pub ports_before: usize,
    /// 2 to this power is an instruction's time in ns.
    pub shift: u32,
    /// Where the program's kept memory begins, `KEPT` in the board's `memory.x`.
    pub kept: u32,
}

/// A board running in QEMU, held before its first instruction until [`Qemu::start`].
#[derive(Debug)]
pub struct Qemu {
    child: Child,
    folder: tempfile::TempDir,
    monitor: BufReader<UnixStream>,
    test: UnixStream,
    test_lines: Receiver<String>,
    kept: u32,
    /// Steps of the trace already told, once someone has asked.
    steps_told: Option<u32>,
}

/// The program for QEMU of a board, if it was built and QEMU is there; else prints why not, and panics under
/// CI.
pub fn program(board: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let program = root.join("target/firmware/qemu").join(board);
    let missing = if !program.exists() {
        format!("{} is not there; `cargo xtask test` builds it", program.display())
    } else if Command::new("qemu-system-arm").arg("--version").output().is_err() {
        "qemu-system-arm is not there; `cargo xtask test` tells how to get it".to_owned()
    } else {
        return Some(program);
    };
    assert!(std::env::var_os("CI").is_none_or(|value| value != "true"), "under CI: {missing}");
    eprintln!("skipped: {missing}");
    None
}

impl Qemu {
    /// Loads a program.
    pub fn load(machine: Machine, program: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = |name: &str| folder.path().join(name).display().to_string();
        let mut qemu = Command::new("qemu-system-arm");
        qemu.args(["-M", machine.machine, "-S", "-display", "none", "-monitor", "none"]);
        // With a fixed time an instruction, no timer's interrupt is lost however busy this machine is.
        qemu.args(["-icount", &format!("shift={},sleep=off", machine.shift)]);
        qemu.arg("-kernel").arg(program);
        for _ in 0..machine.ports_before {
            qemu.args(["-serial", "null"]);
        }
        qemu.args(["-chardev", &format!("socket,id=port,path={},server=on,wait=off", socket("port"))]);
        qemu.args(["-serial", "chardev:port"]);
        qemu.args(["-qmp", &format!("unix:{},server=on,wait=off", socket("monitor"))]);
        qemu.args(["-qtest", &format!("unix:{},server=on,wait=off", socket("test"))]);
        qemu.args(["-qtest-log", "/dev/null"]).stdin(Stdio::null());
        let child = qemu.spawn().unwrap();
        let monitor = BufReader::new(connect(&folder.path().join("monitor")));
        let test = connect(&folder.path().join("test"));
        let test_lines = read_lines(test.try_clone().unwrap());
        let mut qemu =
            Self { child, folder, monitor, test, test_lines, kept: machine.kept, steps_told: None };
        qemu.monitor_line();
        qemu.ask_monitor("qmp_capabilities", json!({}));
        qemu
    }

    /// Lets the program run, for the first time or after [`Self::pause`].
    pub fn start(&mut self) {
        self.ask_monitor("cont", json!({}));
    }

    /// Holds the program between two instructions.
    pub fn pause(&mut self) {
        self.ask_monitor("stop", json!({}));
    }

    /// The host's end of the serial port.
    pub fn port(&self) -> SerialSocket {
        SerialSocket(connect(&self.folder.path().join("port")))
    }

    /// The path of a device with a number, counted from 0 in the chip's order of those of type `kind`.
    pub fn device(&mut self, kind: &str, number: usize) -> String {
        let unattached = self.ask_monitor("qom-list", json!({ "path": "/machine/unattached" }));
        let mut devices: Vec<(usize, &str)> = Vec::new();
        for device in unattached.as_array().unwrap() {
            let name = device["name"].as_str().unwrap();
            if device["type"] == format!("child<{kind}>") {
                let index = name.trim_start_matches("device[").trim_end_matches(']').parse().unwrap();
                devices.push((index, name));
            }
        }
        devices.sort_unstable();
        format!("/machine/unattached/{}", devices[number].1)
    }

    /// From now on tells the edges of a GPIO port's outputs.
    pub fn watch_port(&mut self, path: &str) {
        self.ask_test(&format!("irq_intercept_out {path}"), |_, _| {});
    }

    /// Puts a level on a device's input.
    pub fn set_input(&mut self, path: &str, pin: usize, high: bool) {
        self.ask_test(&format!("set_irq_in {path} unnamed-gpio-in {pin} {}", u8::from(high)), |_, _| {});
    }

    /// Has the program crash, as `firmware/boards/shared/emulation.rs` numbers crashes.
    pub fn crash(&mut self, number: u32) {
        let trigger = self.kept + 4 * 3;
        self.ask_test(&format!("writel {trigger:#x} {number}"), |_, _| {});
        // The program looks once a loop.
        let start = Instant::now();
        while self.word(trigger) != 0 {
            assert!(start.elapsed() < PATIENCE, "the program does not crash");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// The program's trace of steps since this was last asked, none the first time; times count from the
    /// first.
    pub fn steps(&mut self) -> Vec<Step> {
        /// The trace's clock wraps at so many bits.
        const CLOCK: u32 = (1 << 29) - 1;
        let trace = self.word(self.kept + 4 * 4);
        let count = self.word(trace);
        let bytes = self.memory(trace + 4, 4 * STEPS_HELD as usize);
        let ring: Vec<u32> =
            bytes.chunks_exact(4).map(|word| u32::from_le_bytes(word.try_into().unwrap())).collect();
        let told = self.steps_told.replace(count).unwrap_or(count);
        assert!(count - told <= STEPS_HELD, "steps were lost");
        let steps: Vec<u32> = (told..count).map(|number| ring[(number % STEPS_HELD) as usize]).collect();
        let first = steps.first().map_or(0, |step| step >> 3);
        let step = |step: u32| Step {
            axis: Axis::ALL[(step & 3) as usize],
            up: step & 4 != 0,
            at_us: (step >> 3).wrapping_sub(first) & CLOCK,
        };
        steps.into_iter().map(step).collect()
    }

    /// How many steps the program has made so far, wrapping.
    pub fn step_count(&mut self) -> u32 {
        let trace = self.word(self.kept + 4 * 4);
        self.word(trace)
    }

    /// Reads a word of memory or a register.
    pub fn word(&mut self, address: u32) -> u32 {
        let answer = self.ask_test(&format!("readl {address:#x}"), |_, _| {});
        u32::from_str_radix(answer.trim().trim_start_matches("0x"), 16).unwrap()
    }

    /// Tells all edges up to now, in order: pin and level.
    pub fn edges(&mut self, tell: impl FnMut(usize, bool)) {
        self.ask_test("readl 0x0", tell);
    }

    /// Reads memory.
    pub fn memory(&mut self, address: u32, bytes: usize) -> Vec<u8> {
        let answer = self.ask_test(&format!("read {address:#x} {bytes:#x}"), |_, _| {});
        let hex = answer.trim().strip_prefix("0x").unwrap();
        (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect()
    }

    fn ask_test(&mut self, request: &str, mut edge: impl FnMut(usize, bool)) -> String {
        writeln!(self.test, "{request}").unwrap();
        loop {
            let line = self.test_lines.recv_timeout(PATIENCE).unwrap();
            let words: Vec<_> = line.split_ascii_whitespace().collect();
            match words[..] {
                ["IRQ", "raise", pin] => edge(pin.parse().unwrap(), true),
                ["IRQ", "lower", pin] => edge(pin.parse().unwrap(), false),
                ["OK", ..] => return line.trim_start_matches("OK").to_owned(),
                _ => panic!("`{request}`: {line}"),
            }
        }
    }

    fn ask_monitor(&mut self, command: &str, arguments: Value) -> Value {
        let request = json!({ "execute": command, "arguments": arguments });
        writeln!(self.monitor.get_mut(), "{request}").unwrap();
        loop {
            let answer = self.monitor_line();
            assert!(answer.get("error").is_none(), "`{command}`: {answer}");
            if let Some(value) = answer.get("return") {
                return value.clone();
            }
        }
    }

    fn monitor_line(&mut self) -> Value {
        let mut line = String::new();
        self.monitor.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap()
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads lines at all times: QEMU stands still when nobody takes what it tells.
fn read_lines(stream: UnixStream) -> Receiver<String> {
    let (sender, receiver) = mpsc::channel();
    stream.set_read_timeout(None).unwrap();
    std::thread::spawn(move || {
        let lines = BufReader::new(stream).lines();
        for line in lines.map_while(Result::ok) {
            if sender.send(line).is_err() {
                return;
            }
        }
    });
    receiver
}

/// Connects to a socket that QEMU is about to make.
fn connect(socket: &Path) -> UnixStream {
    let start = Instant::now();
    loop {
        match UnixStream::connect(socket) {
            Ok(stream) => {
                stream.set_read_timeout(Some(PATIENCE)).unwrap();
                return stream;
            }
            Err(error) if start.elapsed() > PATIENCE => panic!("QEMU's {}: {error}", socket.display()),
            Err(_) => std::thread::sleep(Duration::from_millis(10)),
        }
    }
}

/// An emulated serial port that tells the steps too.
#[derive(Debug)]
pub struct TracedPort {
    port: SerialSocket,
    qemu: Qemu,
}

impl TracedPort {
    /// The port of a program, which it owns from now on.
    pub fn new(qemu: Qemu) -> Self {
        Self { port: qemu.port(), qemu }
    }
}

impl Read for TracedPort {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.port.read(into)
    }
}

impl Write for TracedPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.port.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

impl Port for TracedPort {
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        // A slow emulation must not have requests repeated: they take time from the steps.
        self.port.set_read_timeout(100 * timeout)
    }

    fn steps(&mut self) -> Option<Vec<Step>> {
        Some(self.qemu.steps())
    }
}

/// The host's end of an emulated serial port.
#[derive(Debug)]
pub struct SerialSocket(UnixStream);

impl Read for SerialSocket {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.0.read(into)
    }
}

impl Write for SerialSocket {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Port for SerialSocket {
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.0.set_read_timeout(Some(timeout))
    }
}
