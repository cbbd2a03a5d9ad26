//! This process as tests measure it: its memory, alone.

use std::process::Command;

/// Says that this process runs one test and nothing else.
const ALONE: &str = "PLIANT_TEST_ALONE";

/// Whether nothing else runs in this process. If something may, it runs the test that calls it, whose full name is
/// `test`, in a process of its own, fails if that fails, and says no: the caller returns then.
///
/// What a process measures of itself means something only while no other test uses its memory.
pub fn runs_alone(test: &str) -> bool {
    if std::env::var_os(ALONE).is_some() {
        return true;
    }
    let program = std::env::current_exe().expect("a test has a program");
    let mut command = Command::new(program);
    command.args([test, "--exact", "--nocapture"]).env(ALONE, "1");
    let answer = command.output().expect("a test can be run again");
    let said = [answer.stdout, answer.stderr]
        .map(|text| String::from_utf8_lossy(&text).into_owned())
        .concat();
    print!("{said}");
    assert!(answer.status.success(), "{test} fails in a process of its own");
    assert!(said.contains("1 passed"), "no test is called {test}");
    false
}

/// Peak memory of this process so far, in bytes.
pub fn peak_memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status
        .lines()
        .find_map(|l| l.strip_prefix("VmHWM:"))
        .unwrap_or_default();
    line.trim().trim_end_matches(" kB").trim().parse::<u64>().unwrap_or(0) << 10
}

/// Memory of this process now, in bytes.
pub fn memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status
        .lines()
        .find_map(|l| l.strip_prefix("VmRSS:"))
        .unwrap_or_default();
    line.trim().trim_end_matches(" kB").trim().parse::<u64>().unwrap_or(0) << 10
}
