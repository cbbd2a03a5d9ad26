//! The clients for browsers as their own tests check them, against the real server: the TypeScript package, the viewer's
//! types, and the viewer in Chromium.
//!
//! What this machine lacks (node, npm, a network for packages, Chromium) is said and skipped; everything else must hold.
//! What the browser measured goes to stderr, so that a log has it also when the test passes.

use crate::support::process::{is_npm_offline, said, show};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;

/// The oldest node that the clients run on.
const NODE: (u32, u32) = (20, 19);

fn folder(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Why nothing of node can run here, if so.
pub(super) fn lacks_node() -> Option<String> {
    let asked = Command::new("node").arg("--version").output();
    let Ok(version) = asked.map(|output| said(&output).trim().to_owned()) else {
        return Some("node is not installed".to_owned());
    };
    let mut numbers = version
        .trim_start_matches('v')
        .split('.')
        .map_while(|n| n.parse::<u32>().ok());
    let seen = (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0));
    if seen < NODE {
        return Some(format!("node {version} is older than {}.{}", NODE.0, NODE.1));
    }
    let npm = Command::new("npm").arg("--version").output();
    (!npm.is_ok_and(|output| output.status.success())).then(|| "npm is not installed".to_owned())
}

/// Fetches what a package's lock file names, unless it is there; why it cannot be had, if so.
pub(super) fn install(package: &str) -> Result<(), String> {
    /// Several tests may want the same package at a time.
    static INSTALLING: Mutex<()> = Mutex::new(());
    let _one = INSTALLING.lock().unwrap_or_else(|failed| failed.into_inner());
    if let Some(reason) = lacks_node() {
        return Err(reason);
    }
    let at = folder(package);
    let changed = |name: &str| fs::metadata(at.join(name)).and_then(|facts| facts.modified());
    let locked = changed("package-lock.json").expect("a lock file");
    if changed("node_modules/.package-lock.json").is_ok_and(|installed| installed >= locked) {
        return Ok(());
    }
    let mut npm = Command::new("npm");
    npm.args(["ci", "--no-audit", "--no-fund", "--prefer-offline"])
        .current_dir(&at);
    let done = npm.output().expect("npm runs");
    if done.status.success() {
        return Ok(());
    }
    let reply = said(&done);
    assert!(is_npm_offline(&reply), "npm ci in {package} failed:\n{reply}");
    Err(format!("the packages of {package} cannot be fetched"))
}

/// Installs and builds the TypeScript client, which the caller holds; why it cannot be had, if so.
pub(super) fn build_typescript() -> Result<(), String> {
    let package = "proto/clients/typescript";
    install(package)?;
    npm(package, "build");
    Ok(())
}

/// Runs a script of a package to its end.
fn npm(package: &str, script: &str) -> String {
    let mut npm = Command::new("npm");
    npm.args(["run", "--silent", script])
        .current_dir(folder(package))
        .env("PLIANT_BIN", env!("CARGO_BIN_EXE_pliant"))
        .env_remove("PLIANT_SERVER");
    let done = npm.output().expect("npm runs");
    let reply = said(&done);
    assert!(
        done.status.success(),
        "npm run {script} in {package} ended with {}:\n{reply}",
        done.status
    );
    reply
}

#[test]
#[ignore = "takes minutes; .ci/run runs it"]
fn the_typescript_client_keeps_its_types_and_tests() {
    let package = "proto/clients/typescript";
    let _held = super::hold_typescript_package();
    if let Err(reason) = install(package) {
        return show(&format!("SKIPPED: {package}: {reason}"));
    }
    npm(package, "check");
    let reply = npm(package, "test");
    let figure = |name: &str| {
        let line = reply
            .lines()
            .find_map(|line| line.trim_start_matches(['#', 'ℹ', ' ']).strip_prefix(name));
        line.and_then(|n| n.trim().parse::<u32>().ok())
    };
    assert!(figure("pass").is_some_and(|n| n > 20), "too few tests ran:\n{reply}");
    for line in reply.lines().filter(|line| line.contains("# SKIP")) {
        show(&format!("SKIPPED: {package}: {line}"));
    }
}

#[test]
fn the_viewer_keeps_its_types() {
    let package = "src/server/viewer";
    if let Err(reason) = install(package) {
        return show(&format!("SKIPPED: {package}: {reason}"));
    }
    npm(package, "check");
}

#[test]
#[ignore = "takes minutes; .ci/run runs it"]
fn the_viewer_in_a_browser() {
    let driver = "tests/clients/viewer";
    if let Err(reason) = install(driver) {
        return show(&format!("SKIPPED: the viewer in a browser: {reason}"));
    }
    let mut browser = Command::new(folder(driver).join("run"));
    browser
        .env("PLIANT_BIN", env!("CARGO_BIN_EXE_pliant"))
        .env_remove("PLIANT_VIEWER_PAGE");
    let done = browser.output().expect("bash runs");
    let reply = said(&done);
    assert!(done.status.success(), "{reply}");
    show(reply.trim_end());
}
