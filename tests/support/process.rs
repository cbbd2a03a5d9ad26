//! Processes of tests: this one as they measure it, its memory, alone; and the program as somebody who may not do everything.

use std::io::Write as _;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Command, Output};

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
    let said = said(&answer);
    print!("{said}");
    assert!(answer.status.success(), "{test} fails in a process of its own");
    assert!(said.contains("1 passed"), "no test is called {test}");
    false
}

/// The folder of the repository.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A file of the repository.
pub fn file_of_repository(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// What a program wrote, stdout first.
pub fn said(output: &Output) -> String {
    [&output.stdout[..], &output.stderr[..]]
        .map(|text| String::from_utf8_lossy(text).into_owned())
        .concat()
}

/// Writes a line that is seen also when the test passes.
pub fn show(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Peak memory of this process so far, in bytes.
pub fn peak_memory() -> u64 {
    status_bytes("VmHWM:")
}

/// Memory of this process now, in bytes.
pub fn memory() -> u64 {
    status_bytes("VmRSS:")
}

fn status_bytes(key: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix(key))
        .unwrap_or_default();
    line.trim().trim_end_matches(" kB").trim().parse::<u64>().unwrap_or(0) << 10
}

/// Whom permissions bind: who runs the tests, or, where that is root, a user without any rights.
pub struct NoOne {
    /// The program, where that user can start it.
    place: Option<tempfile::TempDir>,
}

impl NoOne {
    /// `None`, and a word, where there is no such user.
    pub fn new() -> Option<Self> {
        let is_root = std::fs::metadata("/proc/self").is_ok_and(|facts| facts.uid() == 0);
        if !is_root {
            return Some(Self { place: None });
        }
        let place = tempfile::tempdir().expect("a folder");
        std::fs::set_permissions(place.path(), std::fs::Permissions::from_mode(0o755)).expect("changed");
        let (from, to) = (env!("CARGO_BIN_EXE_pliant"), place.path().join("pliant"));
        std::fs::hard_link(from, &to)
            .or_else(|_| std::fs::copy(from, &to).map(drop))
            .expect("the program");
        let no_one = Self { place: Some(place) };
        let started = no_one.program().arg("--version").output();
        if started.is_ok_and(|done| done.status.success()) {
            return Some(no_one);
        }
        println!("SKIPPED: root cannot become another user here");
        None
    }

    /// The program, to be run as that user.
    pub fn program(&self) -> Command {
        match &self.place {
            None => Command::new(env!("CARGO_BIN_EXE_pliant")),
            Some(place) => {
                let mut program = Command::new(place.path().join("pliant"));
                program.uid(65534).gid(65534);
                program
            }
        }
    }
}

/// What a test needs and the machine may lack; the test returns without it.
macro_rules! needed {
    ($thing:expr) => {
        match $thing {
            Some(thing) => thing,
            None => return,
        }
    };
}
pub(crate) use needed;

/// Whether pip failed because it reached no package index.
pub fn is_pip_offline(said: &str) -> bool {
    let signs = [
        "NewConnectionError",
        "ConnectTimeout",
        "ReadTimeout",
        "ProxyError",
        "NameResolutionError",
        "Temporary failure",
    ];
    signs.iter().any(|sign| said.contains(sign))
}

/// Whether npm failed because it reached no registry.
pub fn is_npm_offline(said: &str) -> bool {
    let signs = [
        "ENOTFOUND",
        "EAI_AGAIN",
        "ECONNREFUSED",
        "ECONNRESET",
        "ETIMEDOUT",
        "ENOTCACHED",
    ];
    signs.iter().any(|sign| said.contains(sign))
}
