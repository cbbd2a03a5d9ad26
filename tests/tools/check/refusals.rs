//! Suites and arguments that are wrong: exit 2, the reason in the last line, nothing written.

use super::folder::{Suite, check};
use std::fs;
use std::process::Command;

#[test]
fn a_malformed_suite_is_exit_2_with_what_where_and_what_is_allowed() {
    let refused = |break_it: &dyn Fn(&Suite), words: &[&str]| {
        let folder = Suite::new();
        folder.case("bar", "bar.obj");
        break_it(&folder);
        for more in [&[][..], &["--bless"]] {
            let ran = folder.check(&[more, &["--json", "--junit", "r.xml"]].concat());
            assert_eq!(ran.code, Some(2), "{words:?}: {}", ran.err);
            assert!(ran.tells_only_why(true), "{}", ran.out);
            assert!(ran.last().starts_with("pliant: "), "{}", ran.err);
            for word in words {
                assert!(ran.last().contains(word), "{word} in {}", ran.last());
            }
            assert!(!folder.path().join("../r.xml").exists() && !folder.path().join("bar.golden.json").exists());
        }
    };
    refused(&|f| f.remove("bar.case.json"), &["holds no case", ".case.json"]);
    refused(
        &|f| f.remove("bar.obj"),
        &["bar.case.json", "model", "there is no file"],
    );
    let loose = |reason: &str| {
        format!(
            r#"{{"model": "bar.obj", "job": {{}}, "tolerances": [{{"metrics": ["hausdorff"], "most": 1e-3{reason}}}]}}"#
        )
    };
    for (file, content, words) in [
        ("bar.case.json", "{", &["bar.case.json"][..]),
        ("bar.case.json", r#"{"model": "bar.obj"}"#, &["missing field `job`"]),
        (
            "bar.case.json",
            r#"{"model": "bar.obj", "job": {}, "tolerence": []}"#,
            &["tolerence", "tolerances"],
        ),
        (
            "bar.case.json",
            r#"{"model": "bar.obj", "job": {"handels": []}}"#,
            &["job.handels"],
        ),
        (
            "bar.case.json",
            r#"{"model": "../bar.obj", "job": {}}"#,
            &["model", "stays below its folder", "sample:creature"],
        ),
        (
            "bar.case.json",
            r#"{"model": "bar.obj", "job": "job.json"}"#,
            &["bar.case.json", "job.json"],
        ),
        (
            "bar.case.json",
            &loose(""),
            &["bar.case.json: tolerances[0].reason", "why"],
        ),
        ("bar.case.json", &loose(", \"reason\": \"\""), &["tolerances[0].reason"]),
        ("lost.golden.json", "{}", &["lost.golden.json", "without a case"]),
        ("a b.case.json", "{}", &["a b", "letters, digits"]),
        ("soft.CASE.JSON", "{}", &["soft.CASE.JSON", "ends with .case.json"]),
        (
            "bar.case.json",
            r#"{"model": "bar.obj", "job": {"#,
            &["bar.case.json: job: EOF"],
        ),
        (
            "bar.case.json",
            r#"["t", "bar.obj", {}, [], null, null]"#,
            &["bar.case.json: invalid type", "a JSON object"],
        ),
        (
            "bar.case.json",
            "\u{feff}{\"model\": \"bar.obj\", \"job\": {}}",
            &["bar.case.json: begins with a byte order mark"],
        ),
    ] {
        refused(&|f| f.write(file, content), words);
    }
}

#[test]
fn a_bound_that_can_never_fail_is_exit_2_wherever_the_job_is() {
    for bound in [
        r#""volumeChange": "NaN""#,
        r#""volumeChange": -1"#,
        r#""maxDistance": "NaN""#,
        r#""meanDistance": "Infinity""#,
        r#""normalDegrees": "Infinity""#,
    ] {
        let job = format!(r#"{{"expect": {{{bound}}}}}"#);
        for inside in [true, false] {
            let folder = Suite::new();
            folder.case("bar", "bar.obj");
            folder.write("job.json", &job);
            let said = if inside { &job } else { "\"job.json\"" };
            folder.write("bar.case.json", &format!(r#"{{"model": "bar.obj", "job": {said}}}"#));
            let ran = folder.check(&[]);
            assert_eq!(ran.code, Some(2), "{bound}: {}", ran.err);
            let last = ran.last();
            assert!(
                last.contains("bar.case.json: ") && last.contains("at least 0"),
                "{last}"
            );
            assert!(last.contains("expect."), "{last}");
        }
    }
}

#[test]
fn an_expected_digest_that_no_result_can_have_is_exit_2_wherever_the_job_is() {
    for digest in [
        "abc",
        "xxh3:",
        "xxh3:0011",
        "xxh3:00112233445566GG",
        "xxh3:00112233445566AA",
    ] {
        let job = format!(r#"{{"expect": {{"digest": "{digest}"}}}}"#);
        for inside in [true, false] {
            let folder = Suite::new();
            folder.case("bar", "bar.obj");
            folder.write("job.json", &job);
            let said = if inside { &job } else { "\"job.json\"" };
            folder.write("bar.case.json", &format!(r#"{{"model": "bar.obj", "job": {said}}}"#));
            let ran = folder.check(&[]);
            assert_eq!(ran.code, Some(2), "{digest}: {}", ran.err);
            let last = ran.last();
            for word in ["bar.case.json: ", "expect.digest", digest, "16 hexadecimal digits"] {
                assert!(last.contains(word), "{word} in {last}");
            }
        }
    }
}

#[test]
fn what_is_no_file_is_refused_and_never_waited_for() {
    let refused = |put: &dyn Fn(&Suite), arguments: &[&str], words: &[&str]| {
        let folder = Suite::new();
        folder.case("bar", "bar.obj");
        put(&folder);
        let ran = folder.check(arguments);
        assert_eq!(ran.code, Some(2), "{words:?}: {}", ran.err);
        assert!(
            words.iter().all(|w| ran.last().contains(w)),
            "{words:?}: {}",
            ran.last()
        );
        assert!(!ran.err.contains("stored"), "{}", ran.err);
    };
    let pipe = |folder: &Suite, name: &str| {
        let made = Command::new("mkfifo").arg(folder.path().join(name)).status();
        assert!(made.expect("mkfifo runs").success(), "{name}");
    };
    refused(
        &|f| pipe(f, "f.case.json"),
        &[],
        &["f.case.json is not a regular file", "a file is needed"],
    );
    refused(
        &|f| pipe(f, "bar.golden.json"),
        &["--bless"],
        &["bar.golden.json is not a regular file"],
    );
    let folder_there = |f: &Suite| fs::create_dir(f.path().join("bar.golden.json")).expect("a folder");
    for arguments in [&[][..], &["--bless"]] {
        refused(
            &folder_there,
            arguments,
            &["bar.golden.json is a folder, a file is needed"],
        );
    }
    let shared = |f: &Suite| {
        f.write("arm.case.json", r#"{"model": "data:meshes", "job": {}}"#);
        fs::create_dir_all(f.path().join("../data/meshes")).expect("a folder");
    };
    refused(
        &shared,
        &["--data", "data"],
        &["arm.case.json: model: ", "meshes is a folder"],
    );
    refused(
        &shared,
        &["--data", "nowhere"],
        &["arm.case.json: model: ", "nowhere, which is not a folder"],
    );
}

#[test]
fn cases_below_the_suites_folder_are_noted() {
    let folder = Suite::new();
    folder.still("bar", "bar.obj");
    fs::create_dir(folder.path().join("more")).expect("a folder");
    folder.write("more/b.case.json", "{}");
    folder.write("more/a.case.json", "{}");
    let ran = folder.check(&["--bless"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(
        ran.err.contains("note: cases in folders") && ran.err.contains("2 are there, the first is more/a.case.json"),
        "{}",
        ran.err
    );
}

#[test]
fn wrong_arguments_are_exit_2() {
    let folder = Suite::new();
    folder.case("bar", "bar.obj");
    let cases: [(&[&str], &str); 8] = [
        (&["--bless", "--server", "http://127.0.0.1:1"], "--bless"),
        // Nothing listens there.
        (&["--server", "https://127.0.0.1:1"], "the server cannot be used"),
        (&["--server", "https://127.0.0.1:1", "--ca", "none.pem"], "none.pem"),
        (&["--server", "127.0.0.1:1"], "http://"),
        // Nothing listens there.
        (&["--server", "http://127.0.0.1:1"], "the server cannot be used"),
        (&["--server", "http://127.0.0.1:1", "--token", "a b"], "--token"),
        (&["--threads", "5000"], "0 to 1024"),
        (&["--what"], "--what"),
    ];
    for (arguments, reason) in cases {
        let ran = folder.check(arguments);
        assert_eq!(
            (ran.code, ran.out.as_str()),
            (Some(2), ""),
            "{arguments:?}: {}",
            ran.err
        );
        assert!(ran.last().contains(reason), "{arguments:?}: {}", ran.last());
    }
    let ran = check(&folder.path().join("../nowhere"), &[]);
    assert!(
        ran.code == Some(2) && ran.last().contains("cannot read the suite"),
        "{}",
        ran.err
    );
}

#[test]
fn cases_are_run_and_blessed_alone_by_name() {
    let suite = Suite::new();
    for name in ["arm-left", "arm-right", "bar"] {
        suite.case(name, "bar.obj");
    }
    let golden = |name: &str| fs::read(suite.path().join(format!("{name}.golden.json"))).ok();
    let ran = suite.check(&["--bless", "--case", "arm-*"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(golden("arm-left").is_some() && golden("arm-right").is_some() && golden("bar").is_none());
    let before = golden("arm-right");
    suite.job("arm-left", "bar.obj", 0.2);
    suite.job("arm-right", "bar.obj", 0.2);
    assert_eq!(suite.check(&["--bless", "--case", "arm-left"]).code, Some(0));
    assert_eq!(golden("arm-right"), before, "only what was named is blessed");
    // What is wrong with others is not asked, but their files are the suite's.
    suite.write("bar.case.json", "{");
    let ran = suite.check(&["--case", "arm-left", "--json"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let report = ran.json();
    assert_eq!(report["cases"].as_array().map(Vec::len), Some(1));
    assert_eq!(report["notes"][0], "1 of the suite's 3 cases are run");
    for file in ["suite/bar.case.json", "suite/arm-right.golden.json"] {
        let ran = suite.check(&["--case", "arm-left", "--html", file, "--force"]);
        assert!(
            ran.code == Some(2) && ran.last().contains("a file of the suite"),
            "{}",
            ran.err
        );
    }
    let ran = suite.check(&["--case", "arm-left", "--case", "leg"]);
    let there = "--case leg: no case of the suite";
    assert!(ran.code == Some(2) && ran.last().contains(there), "{}", ran.err);
    assert!(ran.last().contains("there are arm-left, arm-right, bar"), "{}", ran.err);
    let ran = suite.check(&["--case", "bar", "--shard", "1/2"]);
    assert!(
        ran.code == Some(2) && ran.last().contains("cannot be used with"),
        "{}",
        ran.err
    );
}
