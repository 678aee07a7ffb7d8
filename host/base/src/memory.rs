//! Whether the machine has the memory that a command is asked for, told before the work: the system would end
//! the process in its midst.

use crate::error::{Error, Result};

/// Memory of a machine that does not tell, bytes.
const UNTOLD: u64 = 1 << 40;

/// Refuses work that needs more memory than the machine has; `what` names it, and `instead` says what to ask
/// for.
///
/// # Errors
/// An input error with both amounts.
pub fn check(bytes: u128, what: &str, instead: &str) -> Result<()> {
    let most = of_machine();
    if bytes <= u128::from(most) {
        return Ok(());
    }
    let (needed, most) = (gib(bytes as f64), gib(most as f64));
    Err(Error::input(format!(
        "{what} needs {needed} GiB of memory, and this process may have {most}; {instead}"
    )))
}

/// An amount in GiB; of what nobody has, its order alone.
fn gib(bytes: f64) -> String {
    match bytes / f64::from(1 << 30) {
        gib if gib < 1e6 => format!("{gib:.1}"),
        gib => format!("{gib:.0e}"),
    }
}

/// Where Linux tells how much the group of processes may have, as in a container: of version 2 and 1.
const GROUP_LIMITS: [&str; 2] = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];

/// Bytes that the machine has, or fewer where this process may have no more, as Linux tells them.
fn of_machine() -> u64 {
    let text = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let total = least(&text("/proc/meminfo"), GROUP_LIMITS.map(text));
    // What the process has of its addresses already, its program and its threads, it cannot have again.
    let taken = addresses_taken(&text("/proc/self/status"));
    address_limit(&text("/proc/self/limits")).map_or(total, |limit| total.min(limit.saturating_sub(taken)))
}

/// Bytes of addresses that a process may have, by the text of its limits; batch systems set that. None where
/// it is unlimited.
fn address_limit(limits: &str) -> Option<u64> {
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// Bytes of addresses that a process has, by the text of its status.
fn addresses_taken(status: &str) -> u64 {
    let line = status.lines().find_map(|line| line.strip_prefix("VmSize:"));
    let kib = line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kib.unwrap_or(0).saturating_mul(1024)
}

/// The least of the memory in the text of meminfo and of the limits; what is no number, as `max`, is none.
fn least(meminfo: &str, limits: [String; 2]) -> u64 {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"));
    let kib = line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    let total = kib.map_or(UNTOLD, |kib| kib.saturating_mul(1024));
    limits.iter().filter_map(|limit| limit.trim().parse().ok()).fold(total, u64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_container_s_limit_counts_where_it_is_below_the_machine_s_memory() {
        let meminfo = "MemTotal:        4096 kB\nMemFree: 1 kB\n";
        let of = |v2: &str, v1: &str| least(meminfo, [v2.to_owned(), v1.to_owned()]);
        assert_eq!(of("", ""), 4096 * 1024);
        assert_eq!(of("max\n", "9223372036854771712\n"), 4096 * 1024);
        assert_eq!([of("1048576\n", ""), of("max", "2097152\n")], [1 << 20, 1 << 21]);
        assert_eq!(least("", [String::new(), String::new()]), UNTOLD);
    }

    #[test]
    fn a_batch_system_s_limit_is_read_and_none_where_there_is_none() {
        let head = "Limit                     Soft Limit           Hard Limit           Units     \n";
        let of = |soft: &str| {
            address_limit(&format!("{head}Max address space         {soft}  unlimited  bytes\n"))
        };
        assert_eq!(of("4096000000"), Some(4_096_000_000));
        assert_eq!((of("unlimited"), address_limit("")), (None, None));
        assert_eq!(addresses_taken("VmPeak:  9 kB\nVmSize:\t    2048 kB\n"), 2 << 20);
    }

    #[test]
    fn amounts_are_plain_numbers_as_long_as_anyone_has_so_much() {
        let of = |gibibytes: f64| gib(gibibytes * f64::from(1 << 30));
        assert_eq!([16.04, 0.26, 76_438.0, 6.9e7].map(of), ["16.0", "0.3", "76438.0", "7e7"]);
    }

    #[test]
    fn what_no_machine_has_is_refused_and_what_any_has_is_not() {
        check(1 << 20, "a picture", "ask for less").unwrap();
        let error = check(1 << 80, "a sample of 7 texels", "give --size fewer").unwrap_err();
        let text = error.to_string();
        assert!(error.exit_code() == 2 && text.contains("a sample of 7 texels needs 1e15 GiB"), "{text}");
        assert!(text.ends_with("; give --size fewer"), "{text}");
    }
}
