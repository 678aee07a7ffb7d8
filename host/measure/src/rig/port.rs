//! Ports to a controller: a serial port or TCP.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::Duration;

use serialport::SerialPort;

use crate::rig::trace::Step;
use lobelia_base::error::{Error, Result};

/// Bits a second of a serial line; a USB serial port takes no notice.
const BAUD: u32 = 115_200;

/// Carries bytes to and from a controller. A read that gets none in time fails with `TimedOut` or
/// `WouldBlock`.
pub trait Port: Read + Write + Send {
    /// How long a read waits for a byte.
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()>;

    /// The steps that motors were given since this was last asked, for a port that can tell; it may begin to
    /// look when it is first asked.
    fn steps(&mut self) -> Option<Vec<Step>> {
        None
    }

    /// Whether the controller's clock goes on while nobody reads; not so on a virtual clock.
    fn is_real_time(&self) -> bool {
        true
    }
}

impl Port for Box<dyn SerialPort> {
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        Ok(self.set_timeout(timeout)?)
    }
}

impl Port for TcpStream {
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        Self::set_read_timeout(self, Some(timeout))
    }
}

/// Opens a port by its name: `/dev/ttyACM0`, `COM3` or `tcp://host:port`.
pub fn open_port(name: &str) -> Result<Box<dyn Port>> {
    match name.strip_prefix("tcp://") {
        Some(address) => open_tcp(name, address),
        None => open_serial(name),
    }
}

fn open_tcp(name: &str, address: &str) -> Result<Box<dyn Port>> {
    let stream = TcpStream::connect(address).map_err(|error| {
        let what = format!("port {name} cannot be opened: {error}; is the rig's server running there?");
        let address = error.kind() == io::ErrorKind::InvalidInput;
        if address { Error::input(what) } else { Error::failure(what) }.caused_by(error)
    })?;
    // Requests are small and each waits for its answer.
    stream
        .set_nodelay(true)
        .map_err(|error| Error::failure(format!("port {name}: {error}")).caused_by(error))?;
    Ok(Box::new(stream))
}

fn open_serial(name: &str) -> Result<Box<dyn Port>> {
    // The errors of what is there and no serial port tell nobody anything.
    if is_something_else(Path::new(name)) {
        let message = "no serial port; name one as /dev/ttyACM0, or tcp://host:port, or sim";
        return Err(Error::input(format!("port {name} is {message}")));
    }
    if name.is_empty() {
        return Err(Error::input("--port is empty; name one as /dev/ttyACM0, or tcp://host:port, or sim"));
    }
    match serialport::new(name, BAUD).open() {
        Ok(port) => Ok(Box::new(port)),
        Err(error) => {
            let found = port_names();
            let list = if found.is_empty() { "none".to_owned() } else { found.join(", ") };
            let what = format!("port {name} cannot be opened: {error}; serial ports found: {list}");
            // A port that exists but can't be had is the machine's fault, another name the user's.
            let there = found.iter().any(|port| port == name);
            Err(if there { Error::failure(what) } else { Error::input(what) }.caused_by(error))
        }
    }
}

/// Whether a name is that of a file, a folder, or of a device like `/dev/null`. Looked at without opening it,
/// which would reset some controllers.
#[cfg(unix)]
fn is_something_else(path: &Path) -> bool {
    use std::os::unix::fs::{FileTypeExt, MetadataExt};
    // Linux's devices of memory, /dev/null among them, have the major number 1.
    const MEMORY: u64 = 1;
    let Ok(meta) = path.metadata() else { return false };
    !meta.file_type().is_char_device() || (cfg!(target_os = "linux") && meta.rdev() >> 8 == MEMORY)
}

/// Ports are no files here.
#[cfg(not(unix))]
fn is_something_else(_: &Path) -> bool {
    false
}

/// Names of the serial ports that this machine has, sorted.
pub fn port_names() -> Vec<String> {
    let mut names: Vec<_> =
        serialport::available_ports().unwrap_or_default().into_iter().map(|port| port.port_name).collect();
    names.sort();
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_base::error::Kind;

    #[test]
    fn port_that_does_not_exist_is_bad_input_and_named() {
        let error = open_port("/dev/no-such-port").err().expect("opened");
        assert_eq!(error.kind(), Kind::Input);
        assert!(error.to_string().contains("/dev/no-such-port"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_serial_port_is_said_to_be_none() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["/dev/null", &folder.path().display().to_string()] {
            let error = open_port(name).err().expect("opened");
            assert_eq!(error.kind(), Kind::Input);
            assert!(error.to_string().contains(&format!("port {name} is no serial port")), "{error}");
        }
    }

    #[test]
    fn address_without_a_port_number_is_bad_input() {
        let error = open_port("tcp://localhost").err().expect("opened");
        assert_eq!(error.kind(), Kind::Input, "{error}");
    }
}
