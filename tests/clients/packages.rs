//! What `deploy/release` makes, installed where nothing else of pliant is: from a wheel and a tarball to a deformed model.
//!
//! The program of this build stands in for the one that a release links; what this machine lacks (python3, node, a network for
//! packages) is said and skipped.

use crate::node::{is_offline, lacks_node, said, tell};
use std::fs;
use std::path::Path;
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn is_unreachable(said: &str) -> bool {
    let signs = [
        "No matching distribution",
        "Network is unreachable",
        "Temporary failure in name resolution",
        "ensurepip",
    ];
    is_offline(said) || signs.iter().any(|sign| said.contains(sign))
}

/// Makes wheels and tarball; `None` where that cannot be done here.
fn release(out: &Path) -> Option<()> {
    let mut command = Command::new("python3");
    command
        .arg(root().join("deploy/release"))
        .args(["--dirty", "--only", "wheel,npm"]);
    command
        .args(["--program", env!("CARGO_BIN_EXE_pliant")])
        .arg("-o")
        .arg(out);
    let Ok(made) = command.output() else {
        tell("SKIPPED: python3 is not installed");
        return None;
    };
    let said = said(&made);
    if !made.status.success() && is_unreachable(&said) {
        tell("SKIPPED: packages cannot be fetched");
        return None;
    }
    assert!(made.status.success(), "{said}");
    Some(())
}

#[test]
fn packages_work_where_nothing_else_is() {
    let place = tempfile::tempdir().expect("a folder");
    let out = place.path().join("files");
    let _alone = crate::hold_typescript_package();
    if release(&out).is_none() {
        return;
    }
    let sums = fs::read_to_string(out.join("SHA256SUMS")).expect("sums");
    assert!(
        sums.lines().count() >= 5 && sums.contains("THIRD-PARTY-LICENCES.txt") && sums.contains(".cdx.json"),
        "{sums}"
    );
    let licences = fs::read_to_string(out.join("THIRD-PARTY-LICENCES.txt")).expect("licences");
    assert!(
        licences.contains("tokio 1.") && licences.contains("MIT License"),
        "{}",
        &licences[..400]
    );

    let first = Command::new(root().join("tests/clients/first-model.sh"))
        .arg(&out)
        .output();
    let first = first.expect("bash runs");
    let told = said(&first);
    if !first.status.success() && is_unreachable(&told) {
        return tell("SKIPPED: packages cannot be fetched");
    }
    assert!(first.status.success(), "{told}");
    assert!(told.contains("pip: 8628 vertices, b'glTF'"), "{told}");
    match lacks_node() {
        Some(lack) => tell(&format!("SKIPPED: {lack}")),
        None => assert!(told.contains("npm: 8628 vertices, glTF"), "{told}"),
    }
    for line in told.lines().filter(|line| line.ends_with(" s")) {
        tell(line);
    }
}
