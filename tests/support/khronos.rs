//! Asks the Khronos glTF validator, where it can be had.

use super::data::report_skipped;
use pliant::asset::WrittenFiles;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Error and warning codes that the validator finds in each file.
pub type Findings = BTreeMap<PathBuf, BTreeSet<String>>;

/// Runs the validator; `None`, and a line that says why, where it cannot be had.
pub fn validate(files: &[PathBuf]) -> Option<Findings> {
    use std::io::Write as _;
    use std::process::{Command, Stdio};
    // One test installs it; the others wait.
    static INSTALLING: Mutex<()> = Mutex::new(());
    let installing = INSTALLING.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("gltf-validator");
    if !folder.join("node_modules/gltf-validator").is_dir() {
        std::fs::create_dir_all(&folder).expect("a writable target folder");
        std::fs::write(folder.join("package.json"), "{}").expect("a writable target folder");
        let install = ["install", "--no-audit", "--no-fund", "gltf-validator@2.0.0-dev.3.10"];
        let done = Command::new("npm")
            .args(install)
            .current_dir(&folder)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        if !done.is_ok_and(|status| status.success()) {
            report_skipped("the Khronos validator", "npm is missing or cannot reach its registry");
            return None;
        }
    }
    drop(installing);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/validate_gltf.mjs");
    let mut node = Command::new("node");
    let node = node
        .arg(script)
        .arg(&folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let Ok(mut node) = node else {
        report_skipped("the Khronos validator", "node is missing");
        return None;
    };
    let names: Vec<String> = files.iter().map(|f| f.display().to_string()).collect();
    let mut input = node.stdin.take().expect("a pipe");
    // In the background: the validator answers while it is still being asked.
    let asking = std::thread::spawn(move || input.write_all(names.join("\n").as_bytes()));
    let output = node.wait_with_output().expect("the validator ends");
    asking.join().expect("no panic").expect("the validator reads its input");
    assert!(output.status.success(), "the validator failed");
    let text = String::from_utf8(output.stdout).expect("text");
    let line = |line: &str| {
        let report: Value = serde_json::from_str(line).expect("a JSON line");
        let codes = ["errors", "warnings"]
            .into_iter()
            .filter_map(|k| report[k].as_object())
            .flat_map(|m| m.keys().cloned());
        (PathBuf::from(report["file"].as_str().expect("a name")), codes.collect())
    };
    Some(text.lines().map(line).collect())
}

/// Checks that the validator finds nothing in files, where it can be had.
pub fn assert_valid(what: &str, files: &[PathBuf]) {
    let Some(findings) = validate(files) else {
        return report_skipped(what, "the validator cannot be had");
    };
    for file in files {
        assert!(findings[file].is_empty(), "{}: {:?}", file.display(), findings[file]);
    }
}

/// Checks that the validator finds nothing in files that it does not find in what each was made from, where it can be had.
pub fn assert_nothing_new(what: &str, made: &[(PathBuf, PathBuf)]) {
    if made.is_empty() {
        return;
    }
    let asked: BTreeSet<&PathBuf> = made.iter().flat_map(|(file, source)| [file, source]).collect();
    let Some(findings) = validate(&asked.into_iter().cloned().collect::<Vec<_>>()) else {
        return report_skipped(what, "the validator cannot be had");
    };
    let new = made
        .iter()
        .map(|(file, source)| (file, findings[file].difference(&findings[source]).collect::<Vec<_>>()));
    let wrong: Vec<_> = new.filter(|(_, found)| !found.is_empty()).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Writes a model and its companions beside it.
pub fn store(written: &WrittenFiles, at: &Path) {
    std::fs::create_dir_all(at.parent().expect("a folder")).expect("a writable folder");
    std::fs::write(at, &written.main).expect("a writable folder");
    for (name, bytes) in &written.companions {
        let at = at.parent().expect("a folder").join(name);
        std::fs::create_dir_all(at.parent().expect("a folder")).expect("a writable folder");
        std::fs::write(at, bytes).expect("a writable folder");
    }
}
