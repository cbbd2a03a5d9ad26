//! Inputs that once were trouble, by target: they are run for ever.

use crate::targets::TARGETS;
use std::path::{Path, PathBuf};

/// The stored inputs of a target.
pub fn found_inputs(name: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fuzz/found")
        .join(name);
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("a readable entry").path()).collect();
    files.sort();
    files
}

#[test]
fn what_once_was_trouble_is_none_any_more() {
    for (name, target) in TARGETS {
        for path in found_inputs(name) {
            let input = std::fs::read(&path).expect("a readable file");
            eprintln!("{}", path.display());
            target(&input);
        }
    }
}

#[test]
fn every_folder_of_found_inputs_belongs_to_a_target() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/found");
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let name = entry.expect("a readable entry").file_name();
        assert!(
            TARGETS.iter().any(|(target, _)| name == *target),
            "{} is not a target",
            name.display()
        );
    }
}

#[test]
fn every_target_is_a_target_of_the_coverage_guided_runs() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/coverage");
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).expect("its manifest");
    for (name, _) in TARGETS {
        assert!(
            folder.join(format!("fuzz_targets/{name}.rs")).is_file(),
            "{name} has no file there"
        );
        assert!(
            manifest.contains(&format!("name = \"{name}\"")),
            "{name} is not in its manifest"
        );
    }
}
