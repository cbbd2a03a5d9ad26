//! What the process holds, as the system counts it.

/// Bytes of a line of this process's status, 0 where there is none.
fn process_status(key: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix(key));
    let kilobytes = line.and_then(|l| l.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024
}

/// Bytes resident now.
pub(super) fn resident_bytes() -> u64 {
    process_status("VmRSS:")
}

/// Most bytes resident since [`reset_peak`], or since the start where that is not possible.
pub(super) fn peak_bytes() -> u64 {
    process_status("VmHWM:")
}

/// Resets the peak; false where the system does not allow it.
pub(super) fn reset_peak() -> bool {
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_sees_what_is_gone_again() {
        if !std::path::Path::new("/proc/self/status").exists() || !reset_peak() {
            println!("skipped: no /proc/self/status, or no way to reset the peak");
            return;
        }
        let before = peak_bytes();
        drop(std::hint::black_box(vec![1u8; 256 << 20]));
        assert!(peak_bytes() >= before + (128 << 20), "{before} {}", peak_bytes());
    }
}
