//! Progress of long work: a bar with rate and time left on a terminal; where nobody watches, as in a batch
//! job's log, a line now and then; silence with `--quiet`.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};

static QUIET: AtomicBool = AtomicBool::new(false);

/// The bar that is shown: of bars within bars the outermost, which has the whole in view.
static SHOWN: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// A line in a log is written so often, s, and not before.
const LINE_EVERY_S: u64 = 60;

/// Turns all progress bars off (`--quiet`).
pub fn set_quiet(quiet: bool) {
    QUIET.store(quiet, Ordering::Relaxed);
}

fn quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// A bar over `total` items called `unit` (poses, texels); it clears itself when dropped. Within the life of
/// another it is not shown.
pub fn bar(label: &str, total: u64, unit: &str) -> Bar {
    let mut shown = SHOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let outermost = shown.is_none();
    let target =
        if quiet() || !outermost { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
    let bar = ProgressBar::with_draw_target(Some(total), target);
    let style = format!("{{msg:>10}} [{{bar:30}}] {{pos}}/{{len}} {unit} ({{rate}}/s, {{eta}} left)");
    if let Ok(style) = ProgressStyle::with_template(&style) {
        let rate = |state: &ProgressState, to: &mut dyn std::fmt::Write| {
            // Writing into a string can't fail.
            let _ = write!(to, "{}", two_digits(state.per_sec()));
        };
        bar.set_style(style.progress_chars("=> ").with_key("rate", rate));
    }
    bar.set_message(label.to_string());
    if outermost {
        *shown = Some(bar.clone());
    }
    let log = (outermost && !quiet() && bar.is_hidden()).then(|| Log {
        label: label.to_string(),
        unit: unit.to_string(),
        total,
        done: AtomicU64::new(0),
        began: Instant::now(),
        told_s: AtomicU64::new(0),
    });
    Bar { bar, outermost, log }
}

/// A line on stderr for someone who watches, above the bar if there is one; silent with `--quiet`.
pub fn note(text: &str) {
    if quiet() {
        return;
    }
    match &*SHOWN.lock().unwrap_or_else(PoisonError::into_inner) {
        Some(bar) => bar.suspend(|| eprintln!("{text}")),
        None => eprintln!("{text}"),
    }
}

/// A progress bar that is removed when the work ends, however it ends.
pub struct Bar {
    bar: ProgressBar,
    outermost: bool,
    log: Option<Log>,
}

impl Bar {
    /// Counts `items` more as done.
    pub fn advance(&self, items: u64) {
        self.bar.inc(items);
        if let Some(line) = self.log.as_ref().and_then(|log| log.advance(items, log.began.elapsed())) {
            eprintln!("{line}");
        }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
        if self.outermost {
            *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
    }
}

/// What is told where no bar can be drawn.
struct Log {
    label: String,
    unit: String,
    total: u64,
    done: AtomicU64,
    began: Instant,
    /// When a line was written last, s after the beginning.
    told_s: AtomicU64,
}

impl Log {
    /// Counts items, and gives the line to write when it is time for one.
    fn advance(&self, items: u64, elapsed: Duration) -> Option<String> {
        let done = self.done.fetch_add(items, Ordering::Relaxed) + items;
        let (now_s, told_s) = (elapsed.as_secs(), self.told_s.load(Ordering::Relaxed));
        let mine = now_s >= told_s + LINE_EVERY_S
            && self.told_s.compare_exchange(told_s, now_s, Ordering::Relaxed, Ordering::Relaxed).is_ok();
        mine.then(|| {
            let rate = done as f64 / elapsed.as_secs_f64();
            let left = self.total.saturating_sub(done) as f64 / rate.max(1e-9);
            format!(
                "{}: {done} of {} {} ({}/s, {} left)",
                self.label,
                self.total,
                self.unit,
                two_digits(rate),
                duration(left)
            )
        })
    }
}

/// A number with two significant digits, and without a decimal point from 10 on.
fn two_digits(value: f64) -> String {
    if !(value.is_finite() && value > 0.0) {
        return "0".into();
    }
    let decimals = (1.0 - value.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.decimals$}")
}

/// A duration, given in seconds, in the unit that suits it.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// `1 pose`, `2 poses`: a number with its noun.
pub fn counted(count: impl Into<u64>, one: &str, more: &str) -> String {
    match count.into() {
        1 => format!("1 {one}"),
        count => format!("{count} {more}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_has_its_own_noun() {
        assert_eq!(
            [0u64, 1, 2].map(|count| counted(count, "pose", "poses")),
            ["0 poses", "1 pose", "2 poses"]
        );
    }

    #[test]
    fn rates_have_two_digits_whatever_their_size() {
        let rates = [0.0333, 0.5, 1.0, 9.87, 12.3, 15_000.4, 0.0, f64::NAN].map(two_digits);
        assert_eq!(rates, ["0.033", "0.50", "1.0", "9.9", "12", "15000", "0", "0"]);
    }

    #[test]
    fn a_log_gets_a_line_a_minute_with_what_is_done_and_left() {
        let log = Log {
            label: "developing".into(),
            unit: "poses".into(),
            total: 400,
            done: AtomicU64::new(0),
            began: Instant::now(),
            told_s: AtomicU64::new(0),
        };
        let at = |seconds: u64, items: u64| log.advance(items, Duration::from_secs(seconds));
        assert_eq!(at(10, 20), None);
        assert_eq!(at(60, 80), Some("developing: 100 of 400 poses (1.7/s, 3 min left)".into()));
        assert_eq!(at(100, 1), None);
        assert_eq!(at(7320, 99), Some("developing: 200 of 400 poses (0.027/s, 2.0 h left)".into()));
    }

    /// Other tests may have bars of their own at the same time, so only what one bar does to the next is
    /// looked at.
    #[test]
    fn a_bar_within_a_bar_is_not_shown() {
        let outer = bar("maps", 3, "maps");
        let inner = bar("rows", 100, "rows");
        assert!(inner.bar.is_hidden() && !inner.outermost);
        inner.advance(1);
        drop(inner);
        outer.advance(1);
        assert_eq!(outer.bar.position(), 1);
    }
}
