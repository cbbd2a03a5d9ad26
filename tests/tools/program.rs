//! The program as a script runs it.

use pliant::asset::sample;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Runs the program in a folder, with nothing said of a store by the surroundings.
fn run(folder: &Path, arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_pliant"));
    program
        .args(arguments)
        .current_dir(folder)
        .env_remove("PLIANT_DATA_DIR");
    program.output().expect("it runs")
}

/// Runs the program; returns (exit code, stdout, last line of stderr).
pub fn pliant(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let done = run(folder, arguments);
    let err = String::from_utf8_lossy(&done.stderr).into_owned();
    let last = err.trim_end().lines().last().unwrap_or_default().to_owned();
    (done.status.code(), String::from_utf8(done.stdout).expect("text"), last)
}

/// Runs the program; its exit code and all of stderr.
pub fn told(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let done = run(folder, arguments);
    (done.status.code(), String::from_utf8_lossy(&done.stderr).into_owned())
}

/// A folder with a model in it, creature.glb.
pub fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("creature.glb"), sample::creature_glb()).expect("written");
    folder
}
