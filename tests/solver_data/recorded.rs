//! Digests of the other build profile, kept in the build folder.

use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Records digests for this profile. If the other one has recorded some for the same sources, they must be equal.
pub fn compare_with_other_profile(lines: &[String]) {
    let (here, other) = match cfg!(debug_assertions) {
        true => ("debug", "release"),
        false => ("release", "debug"),
    };
    let path = |profile: &str| Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("solver-digests-{profile}.txt"));
    let record = format!("sources {}\n{}\n", fingerprint(), lines.join("\n"));
    match std::fs::read_to_string(path(other)) {
        Ok(theirs) if theirs.lines().next() == record.lines().next() => {
            let (ours, theirs): (Vec<_>, Vec<_>) = (record.lines().collect(), theirs.lines().collect());
            let shared: Vec<_> = ours
                .iter()
                .filter(|l| theirs.iter().any(|t| name(t) == name(l)))
                .collect();
            assert!(
                shared.iter().all(|l| theirs.contains(*l)),
                "{here} gives other bits than {other}:\n{record}\n{}",
                theirs.join("\n")
            );
            println!("the same bits as {other} on {} systems", shared.len() - 1);
        }
        _ => println!("not compared: {other} has not run on these sources"),
    }
    std::fs::write(path(here), record).unwrap();
}

/// A record's system, without its digests.
fn name(line: &str) -> &str {
    line.split(':').next().unwrap_or(line)
}

/// Digest of everything that decides the bits: sources, jobs, this test, dependencies.
fn fingerprint() -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = ["Cargo.lock", "tests/solver_data.rs", "tests/support/shapes.rs"]
        .map(|file| root.join(file))
        .to_vec();
    for folder in ["src", "loadtest/jobs", "tests/solver_data"] {
        collect(&root.join(folder), &mut files);
    }
    files.sort();
    let mut sha = Sha256::new();
    for file in files {
        sha.update(std::fs::read(file).unwrap());
    }
    sha.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(&path, files);
        } else {
            files.push(path);
        }
    }
}
