//! System packages that some tests need: installed where that is possible without asking, named elsewhere.

use std::path::Path;
use std::process::Command;

/// A software Vulkan driver and its loader.
const VULKAN: [&str; 2] = ["mesa-vulkan-drivers", "libvulkan1"];

/// Sees to a Vulkan driver for the GPU tests, which skip themselves without one.
pub(crate) fn ensure_vulkan_driver() {
    if has_vulkan_driver() {
        return;
    }
    let packages = VULKAN.join(" ");
    let install = format!("apt-get install -y --no-install-recommends {packages}");
    if can_install() {
        println!("xtask: no Vulkan driver; {install}");
        if self::install(&VULKAN, None) && has_vulkan_driver() {
            return;
        }
    }
    println!("xtask: no Vulkan driver, so the GPU tests will be skipped; on Debian: sudo {install}");
}

/// Whether a driver's manifest and the loader are there.
fn has_vulkan_driver() -> bool {
    let manifests = ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d"];
    let driver = manifests
        .iter()
        .any(|folder| std::fs::read_dir(folder).is_ok_and(|mut entries| entries.any(|entry| entry.is_ok())));
    let libraries = ["/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib"];
    driver && libraries.iter().any(|folder| Path::new(folder).join("libvulkan.so.1").exists())
}

/// Whether QEMU 10 or later is there; older ones lose timer interrupts.
pub(crate) fn has_qemu() -> bool {
    let Ok(output) = Command::new("qemu-system-arm").arg("--version").output() else { return false };
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let major = text.split("version ").nth(1).and_then(|rest| rest.split('.').next()?.parse().ok());
    major.is_some_and(|major: u32| major >= 10)
}

/// Sees to QEMU for ARM boards; false, and told how to get it, if there's none.
pub(crate) fn ensure_qemu() -> bool {
    if has_qemu() {
        return true;
    }
    if can_install() {
        println!("xtask: installing qemu-system-arm");
        // Debian 12 has 7.2; its backports have 10.
        let backports = Path::new("/etc/apt/sources.list.d/lobelia-backports.list");
        let source = "deb http://deb.debian.org/debian bookworm-backports main\n";
        let is_bookworm =
            std::fs::read_to_string("/etc/os-release").is_ok_and(|text| text.contains("bookworm"));
        let suite = is_bookworm.then_some("bookworm-backports");
        let has_source = suite.is_none() || std::fs::write(backports, source).is_ok();
        if has_source && install(&["qemu-system-arm"], suite) && has_qemu() {
            return true;
        }
    }
    println!(
        "xtask: no QEMU 10 for ARM; on Debian: sudo apt-get install qemu-system-arm \
         (on Debian 12 with -t bookworm-backports, once that suite is among apt's sources)"
    );
    false
}

/// Whether packages can be installed without asking anyone.
pub(crate) fn can_install() -> bool {
    is_root() && Path::new("/usr/bin/apt-get").exists()
}

/// Installs packages, of a suite if one is named. An old list of packages may name versions that are gone, so
/// it is renewed first.
pub(crate) fn install(packages: &[&str], suite: Option<&str>) -> bool {
    let mut arguments = vec!["install", "-y", "-q", "--no-install-recommends"];
    arguments.extend(suite.iter().flat_map(|suite| ["-t", suite]));
    arguments.extend(packages);
    apt_get(&["update", "-q"]) && apt_get(&arguments)
}

fn is_root() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout.trim_ascii() == b"0")
}

fn apt_get(arguments: &[&str]) -> bool {
    let status = Command::new("apt-get").args(arguments).env("DEBIAN_FRONTEND", "noninteractive").status();
    status.is_ok_and(|status| status.success())
}
