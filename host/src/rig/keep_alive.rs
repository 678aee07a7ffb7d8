//! Keeps the lease of a host that is busy with something else: developing a frame, or waiting for a camera.

use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, TryLockError};
use std::thread::JoinHandle;
use std::time::Duration;

use lobelia_protocol::{Command, Request, ToController};

use crate::rig::wire::Wire;

/// The controller is spoken to this often; its lease is 2 s unless the rig's file says otherwise.
pub(crate) const PERIOD: Duration = Duration::from_millis(500);
/// How long what the controller says is listened to each time, so that the port's buffer does not fill.
const LISTEN: Duration = Duration::from_millis(20);

/// A thread that speaks to the controller while nobody else does. It ends with this.
pub(crate) struct KeepAlive {
    stop: Option<mpsc::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl KeepAlive {
    pub(crate) fn start(wire: Arc<Mutex<Wire>>, session: u32, period: Duration) -> Self {
        let (stop, stopped) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            // The id 0 is never run: it is refused as stale, but it has been heard.
            let request = Request { session, id: 0, seen: 0, command: Command::Status };
            while stopped.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
                match wire.try_lock() {
                    Ok(mut wire) => {
                        let spoken = wire.send(&ToController::Request(request));
                        if spoken.and_then(|()| wire.collect(LISTEN)).is_err() {
                            // Whoever uses the link next is told.
                            return;
                        }
                    }
                    // Somebody speaks.
                    Err(TryLockError::WouldBlock) => {}
                    Err(TryLockError::Poisoned(_)) => return,
                }
            }
        });
        Self { stop: Some(stop), thread: Some(thread) }
    }
}

impl Drop for KeepAlive {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
