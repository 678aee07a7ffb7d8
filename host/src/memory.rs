//! Whether the machine has the memory that a command is asked for, told before the work: the system would end the process in its midst.

use crate::error::{Error, Result};

/// Memory of a machine that does not tell, bytes.
const UNTOLD: u64 = 1 << 40;

/// Refuses work that needs more memory than the machine has; `what` names it, and `instead` says what to ask for.
///
/// # Errors
/// An input error with both amounts.
pub fn check(bytes: u128, what: &str, instead: &str) -> Result<()> {
    let most = of_machine();
    if bytes <= u128::from(most) {
        return Ok(());
    }
    let gib = |bytes: f64| bytes / f64::from(1 << 30);
    Err(Error::input(format!(
        "{what} needs {:.3e} GiB of memory, this machine has {:.1}; {instead}",
        gib(bytes as f64),
        gib(most as f64)
    )))
}

/// Bytes that the machine has, as Linux tells them.
fn of_machine() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"));
    let kib = line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kib.map_or(UNTOLD, |kib| kib.saturating_mul(1024))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_machine_has_is_refused_and_what_any_has_is_not() {
        check(1 << 20, "a picture", "ask for less").unwrap();
        let error = check(1 << 80, "a sample of 7 texels", "give --size fewer").unwrap_err();
        let text = error.to_string();
        assert!(error.exit_code() == 2 && text.contains("a sample of 7 texels needs 1.126e15 GiB"), "{text}");
        assert!(text.ends_with("; give --size fewer"), "{text}");
    }
}
