//! Where reports may go: looked at before any case is run.

use super::folder::{Suite, sample_suite};
use crate::support::commands::Ran;
use crate::support::process::NoOne;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::Path;

/// Every file of the suite with its bytes.
fn contents(suite: &Suite) -> BTreeMap<String, Vec<u8>> {
    let files = fs::read_dir(suite.path()).expect("a folder").flatten();
    let named = files.map(|f| {
        (
            f.file_name().to_string_lossy().into_owned(),
            fs::read(f.path()).expect("a file"),
        )
    });
    named.collect()
}

/// Nothing was run: a case that was has a line of its own.
fn assert_refused(ran: &Ran, words: &[&str]) {
    assert_eq!((ran.code, &*ran.out), (Some(2), ""), "{}", ran.err);
    assert_eq!(ran.err.trim_end().lines().count(), 1, "{}", ran.err);
    for word in words {
        assert!(ran.last().contains(word), "{word} in {}", ran.last());
    }
}

#[test]
fn a_report_never_replaces_a_file_of_the_suite() {
    let suite = Suite::of_bar();
    suite.write("job.json", "{}");
    suite.write("other.case.json", r#"{"model": "bar.obj", "job": "job.json"}"#);
    suite.passes("--bless");
    suite.remove("other.golden.json");
    symlink(suite.path().join("bar.case.json"), suite.path().join("../link")).expect("a link");
    let before = contents(&suite);
    for option in ["--junit", "--html"] {
        for file in [
            "suite/bar.case.json",
            "suite/bar.golden.json",
            // One that is not there yet.
            "suite/other.golden.json",
            "suite/bar.obj",
            "suite/job.json",
            "suite/../suite/job.json",
            "link",
        ] {
            let ran = suite.check(&[option, file, "--force"]);
            assert_refused(&ran, &[option, file, "a file of the suite"]);
            assert_eq!(contents(&suite), before, "{option} {file}");
        }
    }
    // Beside them there is room.
    let ran = suite.check("--html suite/report.html");
    assert!(
        ran.err.contains("bar") && suite.path().join("report.html").exists(),
        "{}",
        ran.err
    );
}

#[test]
fn a_report_never_replaces_a_file_that_a_model_names_beside_itself() {
    let suite = Suite::new();
    suite.still("bar", "plain.obj");
    let bar = suite.read("plain.obj");
    suite.write("bar.obj", &format!("mtllib bar.mtl\nusemtl skin\n{bar}"));
    suite.write("bar.mtl", "newmtl skin\nmap_Kd skin.png\n");
    suite.write("skin.png", "a picture");
    let case = suite.read("bar.case.json").replace("plain.obj", "bar.obj");
    suite.write("bar.case.json", &case);
    suite.remove("plain.obj");
    let before = contents(&suite);
    for (option, file) in [("--junit", "bar.mtl"), ("--html", "skin.png"), ("--report", "bar.mtl")] {
        let path = format!("suite/{file}");
        let ran = suite.check(&[option, &path, "--force"]);
        assert_refused(&ran, &[option, file, "bar.obj is made of it"]);
        assert_eq!(contents(&suite), before, "{option} {file}");
    }
    // What only lies beside it is not a part of it.
    suite.write("old.html", "a page");
    let ran = suite.check("--html suite/old.html --force");
    assert!(
        ran.err.contains("bar") && suite.read("old.html").contains("<html"),
        "{}",
        ran.err
    );
}

#[test]
fn two_reports_are_two_files() {
    let suite = Suite::of_bar();
    let ways: [(&str, &[&str]); 3] = [("r", &[]), ("./r", &["--force"]), ("suite/../r", &[])];
    for (junit, more) in ways {
        let ran = suite.check(&[&["--html", "r", "--junit", junit], more].concat());
        assert_refused(&ran, &["--html", "--junit", "a file of its own"]);
    }
    let ran = suite.check("--html t/a --junit t/a --parents");
    assert_refused(&ran, &["t/a", "a file of its own"]);
    assert!(!suite.path().join("../t").exists() && !suite.path().join("../r").exists());
}

#[test]
fn a_place_where_nothing_can_be_written_is_reported_before_any_case_is_run() {
    if !Path::new("/proc/self").exists() {
        println!("SKIPPED: there is no /proc, where nobody can make a file");
        return;
    }
    let suite = Suite::of_bar();
    for (option, path) in [
        ("--junit", "/proc/report"),
        ("--html", "/proc/report"),
        ("--html", "/proc/new/report"),
    ] {
        let ran = suite.check(&[option, path, "--parents"]);
        assert_refused(&ran, &[&format!("cannot write {path}: ")]);
        assert!(!ran.err.contains(".part"), "{}", ran.err);
    }
}

#[test]
fn a_suite_that_cannot_be_written_is_not_blessed() {
    let suite = Suite::of_bar();
    let Some(no_one) = NoOne::new() else { return };
    let mode = |of: &Path, mode| fs::set_permissions(of, fs::Permissions::from_mode(mode)).expect("changed");
    mode(&suite.path().join(".."), 0o755);
    mode(&suite.path(), 0o555);
    let ran = Ran::of(no_one.program().args(["check", "--bless"]).arg(suite.path()));
    mode(&suite.path(), 0o755);
    assert_refused(&ran, &["bar.golden.json: permission denied"]);
    assert!(!ran.err.contains(".part"), "{}", ran.err);
}

/// The sample suite's animation in a folder of its own.
fn wave() -> Suite {
    let suite = Suite::new();
    for folder in ["models", "clips"] {
        fs::create_dir(suite.path().join(folder)).expect("a folder");
    }
    for name in ["wave.case.json", "wave.golden.json", "models/bar.obj", "clips/wave.bvh"] {
        fs::copy(sample_suite().join(name), suite.path().join(name)).expect("copied");
    }
    suite
}

#[test]
fn a_frame_that_differs_is_reported_by_its_number() {
    let suite = wave();
    suite.passes(&[]);
    let golden: serde_json::Value = serde_json::from_str(&suite.read("wave.golden.json")).expect("JSON");
    let frames: Vec<&str> = golden["frames"]
        .as_array()
        .expect("a digest a frame")
        .iter()
        .filter_map(|digest| digest.as_str())
        .collect();
    assert_eq!(frames.len(), 68);
    assert_eq!(golden["digest"], frames[67], "the shape is that of the last frame");
    let other = suite
        .read("wave.golden.json")
        .replacen(frames[5], "xxh3:0000000000000000", 1);
    suite.write("wave.golden.json", &other);
    let failed = suite.fails(&[]);
    let reply = "1 of 68 frames differ; the digest of the first of them, number 5, is";
    failed.says(&[reply]);
    suite.passes("--bless");
    suite.passes(&[]);
}

#[test]
fn another_clip_makes_the_golden_stale_and_a_damaged_one_is_reported() {
    let suite = wave();
    let clip = suite.read("clips/wave.bvh");
    suite.write("clips/wave.bvh", &clip.replacen("0 0 0 0.5 0 0", "0 0 0 1.5 0 0", 1));
    let stale = suite.fails(&[]);
    stale.says(&["the golden is stale: the case's job has changed"]);
    suite.write("clips/wave.bvh", &clip.replacen("Frame Time: 0.05", "Frame Time: 0", 1));
    let damaged = suite.fails(&[]);
    damaged.says(&["clip: line "]);
    suite.remove("clips/wave.bvh");
    let missing = suite.exits(2, &[]);
    missing.gives(&["wave.bvh"]);
}
