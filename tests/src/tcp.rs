//! Rigs on TCP: a simulated one with its camera, a line that spoils bytes or breaks, and a controller of
//! another version.

use std::io::{Cursor, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::small;
use lobelia::acquire::simulated;
use lobelia::rig::config::RigConfig;
use lobelia_hil_sim::optics::OpticalBench;
use lobelia_hil_sim::optics::frame::{FrameNotes, write_tiff};
use lobelia_hil_sim::{ExposureTruth, FaultRates, FaultyLink, SimulatedRig, serve_tcp};
use lobelia_protocol::{FrameDecoder, Hello, HelloReply, ToController, ToHost, Verdict, schema};

/// How many times as fast as real time a served rig's clock runs.
const SPEED: f64 = 300.0;

/// The file that the simulated camera stores of an exposure.
fn photographed(bench: &OpticalBench, truth: &ExposureTruth) -> Vec<u8> {
    let values =
        bench.record(&bench.radiance(truth.axes_rad), truth.lamp_relative, truth.open_s, truth.sequence);
    let notes = FrameNotes { exposure_s: truth.open_s, f_number: 16.0, taken_s: truth.start_us / 1_000_000 };
    let camera = &bench.config().camera;
    let mut file = Cursor::new(Vec::new());
    write_tiff(&mut file, camera.width, camera.height, &values, &notes).expect("memory takes a frame");
    file.into_inner()
}

/// A camera that does as it should: a file of its own for every exposure.
fn dutiful(shot: u64, photograph: Vec<u8>) -> Vec<(String, Vec<u8>)> {
    vec![(format!("shot-{shot:04}.tiff"), photograph)]
}

fn listener() -> (TcpListener, SocketAddr) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port is free");
    let address = listener.local_addr().expect("a listener has an address");
    (listener, address)
}

/// `--port` for an address.
pub fn port(address: SocketAddr) -> String {
    format!("tcp://{address}")
}

/// A simulated rig on TCP whose camera stores a file in a folder for every exposure.
pub struct ServedRig {
    /// Where it listens.
    pub address: SocketAddr,
    /// The rig.
    pub rig: SimulatedRig,
    truths: Arc<Mutex<Vec<ExposureTruth>>>,
}

impl ServedRig {
    /// Serves the rig that `config` describes; its camera writes into `photographs`. Lives as long as the
    /// test's process.
    pub fn start(config: &RigConfig, photographs: &Path) -> Self {
        Self::start_with(config, photographs, dutiful)
    }

    /// The same with a camera of which `store` says what files it stores of the exposure of a number, from 1
    /// on.
    pub fn start_with(
        config: &RigConfig,
        photographs: &Path,
        mut store: impl FnMut(u64, Vec<u8>) -> Vec<(String, Vec<u8>)> + Send + 'static,
    ) -> Self {
        let bench = simulated::bench(config, small::layout(config));
        let rig = SimulatedRig::new(&simulated::mechanics(config));
        let (listener, address) = listener();
        let (served, watched) = (rig.clone(), rig.clone());
        std::thread::spawn(move || serve_tcp(&listener, &served, SPEED));
        let truths = Arc::new(Mutex::new(Vec::new()));
        let (noted, folder) = (Arc::clone(&truths), photographs.to_path_buf());
        std::thread::spawn(move || {
            let mut last = 0;
            loop {
                if let Some(truth) = watched.last_exposure().filter(|truth| truth.sequence > last) {
                    last = truth.sequence;
                    noted.lock().expect("no thread panicked").push(truth);
                    let files = store(last, photographed(&bench, &truth));
                    // The folder goes with the test that is over.
                    if files.iter().any(|(name, bytes)| std::fs::write(folder.join(name), bytes).is_err()) {
                        return;
                    }
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        Self { address, rig, truths }
    }

    /// Waits until the server has noticed that its host is gone, from when on the rig's clock stands still.
    pub fn wait_until_alone(&self) {
        let mut last = None;
        while last.replace(self.rig.now_us()) != Some(self.rig.now_us()) {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The truth of every exposure so far, in order.
    pub fn exposures(&self) -> Vec<ExposureTruth> {
        self.truths.lock().expect("no thread panicked").clone()
    }

    /// Whether so many exposures were made.
    pub fn has_exposed(&self, count: usize) -> impl Fn() -> bool + Send + Sync + use<> {
        let truths = Arc::clone(&self.truths);
        move || truths.lock().expect("no thread panicked").len() >= count
    }
}

/// A line to a rig that loses, flips and doubles bytes in both directions.
pub fn bad_line(to: SocketAddr, rates: FaultRates, seed: u64) -> SocketAddr {
    relay(to, move |stream, way| Box::new(FaultyLink::new(stream, rates, seed + way)), || true)
}

/// A line to a rig that breaks, once, at the first word from the host after `now` says so; hosts that connect
/// later find it mended.
pub fn breaking_line(to: SocketAddr, now: impl Fn() -> bool + Send + Sync + 'static) -> SocketAddr {
    let broke = AtomicBool::new(false);
    relay(to, |stream, _| Box::new(stream), move || !now() || broke.swap(true, Ordering::Relaxed))
}

/// Passes bytes both ways between hosts and a rig. `wrap` sees the reading end of each way, `goes_on` is
/// asked whenever the host has sent something.
fn relay(
    to: SocketAddr,
    wrap: impl Fn(TcpStream, u64) -> Box<dyn Read + Send> + Send + 'static,
    goes_on: impl Fn() -> bool + Send + Sync + 'static,
) -> SocketAddr {
    let (listener, address) = listener();
    let goes_on = Arc::new(goes_on);
    std::thread::spawn(move || {
        for host in listener.incoming() {
            let (Ok(host), Ok(rig)) = (host, TcpStream::connect(to)) else { return };
            let ends = [host.try_clone(), rig.try_clone()].map(|end| end.expect("a socket can be shared"));
            ends.iter().for_each(|end| end.set_nodelay(true).expect("a socket can be hurried"));
            let [to_host, to_rig] = ends;
            let (from_host, from_rig) = (wrap(host, 0), wrap(rig, 1));
            let goes_on = Arc::clone(&goes_on);
            std::thread::spawn(move || pump(from_host, &to_rig, &*goes_on));
            std::thread::spawn(move || pump(from_rig, &to_host, &|| true));
        }
    });
    address
}

fn pump(mut from: Box<dyn Read + Send>, mut to: &TcpStream, goes_on: &dyn Fn() -> bool) {
    let mut buffer = [0; 512];
    while let Ok(count) = from.read(&mut buffer) {
        if count == 0 || !goes_on() || to.write_all(&buffer[..count]).is_err() {
            break;
        }
    }
    // Ends the other way too.
    let _ = to.shutdown(Shutdown::Both);
}

/// A controller of another version: answers hellos only. Gives its address and what it was sent besides
/// hellos.
pub fn other_version() -> (SocketAddr, Arc<AtomicUsize>) {
    let (listener, address) = listener();
    let requests = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&requests);
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { return };
            let mut decoder = FrameDecoder::new();
            let mut byte = [0];
            while matches!(stream.read(&mut byte), Ok(1)) {
                let Some(Ok(payload)) = decoder.push(byte[0]) else { continue };
                let Ok(ToController::Hello(hello)) = ToController::decode(payload) else {
                    counted.fetch_add(1, Ordering::Relaxed);
                    continue;
                };
                let own = Hello { schema: !schema::IDENTITY, version: 99, session: hello.session };
                let reply = ToHost::Hello(HelloReply { hello: own, verdict: Verdict::DifferentSchema });
                if stream.write_all(&reply.encode().expect("a hello fits a frame")).is_err() {
                    break;
                }
            }
        }
    });
    (address, requests)
}
