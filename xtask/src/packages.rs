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
    if is_root() && Path::new("/usr/bin/apt-get").exists() {
        println!("xtask: no Vulkan driver; {install}");
        // An old list of packages may name versions that are gone, so it is renewed first.
        let done = apt_get(&["update", "-q"])
            && apt_get(&[&["install", "-y", "-q", "--no-install-recommends"], &VULKAN[..]].concat());
        if done && has_vulkan_driver() {
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

fn is_root() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout.trim_ascii() == b"0")
}

fn apt_get(arguments: &[&str]) -> bool {
    let status = Command::new("apt-get").args(arguments).env("DEBIAN_FRONTEND", "noninteractive").status();
    status.is_ok_and(|status| status.success())
}
