//! Keeps the lease of a host that is busy with something else: developing a frame, or waiting for a camera.
//! Not for ever: a host that hangs must not keep a lamp burning.

use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, TryLockError};
use std::thread::JoinHandle;
use std::time::Duration;

use lobelia_protocol::{Command, Request, ToController};

use crate::rig::wire::Wire;

/// The controller is spoken to this often; its lease is 2 s unless the rig's file says otherwise.
pub(crate) const PERIOD: Duration = Duration::from_millis(500);
/// A host that has not spoken itself for this long is taken for one that hangs.
pub(crate) const LONGEST: Duration = Duration::from_secs(600);
/// How long what the controller says is listened to each time, so that the port's buffer does not fill.
const LISTEN: Duration = Duration::from_millis(20);

/// A thread that speaks to the controller while nobody else does. It ends with this.
pub(crate) struct KeepAlive {
    stop: Option<mpsc::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl KeepAlive {
    /// Speaks each `period`, and falls silent when nobody else has sent anything for `longest`, until
    /// somebody does.
    pub(crate) fn start(wire: Arc<Mutex<Wire>>, session: u32, period: Duration, longest: Duration) -> Self {
        let (stop, stopped) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            // The id 0 is never run: it is refused as stale, but it has been heard.
            let request = Request { session, id: 0, seen: 0, command: Command::Status };
            let (mut sent, mut alone) = (0, Duration::ZERO);
            while stopped.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
                match wire.try_lock() {
                    Ok(mut wire) => {
                        alone = if wire.sent() == sent { alone + period } else { Duration::ZERO };
                        sent = wire.sent();
                        if alone >= longest {
                            continue;
                        }
                        sent += 1;
                        let spoken = wire.send(&ToController::Request(request));
                        if spoken.and_then(|()| wire.collect(LISTEN)).is_err() {
                            // Whoever uses the link next is told.
                            return;
                        }
                    }
                    // Somebody speaks.
                    Err(TryLockError::WouldBlock) => alone = Duration::ZERO,
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
