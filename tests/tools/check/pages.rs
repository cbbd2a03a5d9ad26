//! What `deploy/ci/` says is so: its example is a case, its tables are complete, its commands and workflows work.

use super::folder::check;
use pliant::check::{Metric, SuiteCase};
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(name: &str) -> String {
    fs::read_to_string(root().join("deploy/ci").join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// A folder with the repository's `deploy/` and a built program where the pages have it.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    symlink(root().join("deploy"), folder.path().join("deploy")).expect("a link");
    fs::create_dir_all(folder.path().join("target/release")).expect("a folder");
    symlink(
        env!("CARGO_BIN_EXE_pliant"),
        folder.path().join("target/release/pliant"),
    )
    .expect("a link");
    folder
}

#[test]
fn the_page_lists_every_metric_and_its_example_is_a_case() {
    let page = read("README.md");
    let blocks: Vec<(&str, &str)> = (page.split("\n```").skip(1).step_by(2))
        .filter_map(|b| b.split_once('\n'))
        .collect();
    let example = blocks
        .iter()
        .find(|(language, _)| *language == "json")
        .expect("an example")
        .1;
    SuiteCase::from_file("example.case.json", example.as_bytes()).expect("the example is a case");
    for metric in Metric::ALL {
        assert!(
            page.contains(&format!("`{}`", metric.name())),
            "{} is not in the table",
            metric.name()
        );
    }
    let help = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .args(["check", "--help"])
        .output()
        .expect("it runs");
    let help = String::from_utf8(help.stdout).expect("text");
    let options = help
        .split_whitespace()
        .filter(|w| w.starts_with("--") && *w != "--help" && *w != "--version");
    for option in options {
        let option = option.trim_end_matches([',', '.']);
        assert!(page.contains(option), "{option} is not on the page");
    }
    for word in page.split_whitespace().filter(|w| w.starts_with("`--")) {
        let option = word.trim_matches(|c: char| "`,;.:|".contains(c));
        assert!(help.contains(option), "{option} is not an option");
    }
}

#[test]
fn the_commands_of_the_page_work() {
    let page = read("README.md");
    let folder = workplace();
    let suite = folder.path().join("copy");
    copy(&root().join("deploy/ci/sample-suite"), &suite);
    let commands = page.lines().filter_map(|line| line.strip_prefix("pliant "));
    let mut ran = 0;
    for command in commands.filter(|c| !c.contains("--server")) {
        let command = command.replace("SUITE", "copy");
        let done = Command::new(env!("CARGO_BIN_EXE_pliant"))
            .args(command.split_whitespace())
            .current_dir(folder.path())
            .output()
            .expect("it runs");
        assert!(
            done.status.success(),
            "pliant {command}: {}",
            String::from_utf8_lossy(&done.stderr)
        );
        ran += 1;
    }
    assert!(ran >= 3);
    assert!(folder.path().join("report.html").exists() && folder.path().join("junit.xml").exists());
    assert_eq!(check(&suite, &[]).code, Some(0), "blessing again changes nothing");
}

/// Copies a folder of files and folders.
fn copy(from: &Path, to: &PathBuf) {
    fs::create_dir_all(to).expect("a folder");
    for entry in fs::read_dir(from).expect("a folder") {
        let path = entry.expect("an entry").path();
        let target = to.join(path.file_name().expect("a name"));
        match path.is_dir() {
            true => copy(&path, &target),
            false => drop(fs::copy(&path, &target).expect("copied")),
        }
    }
}
