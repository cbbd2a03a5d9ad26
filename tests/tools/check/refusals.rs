//! Suites and arguments that are wrong: exit 2, the reason in the last line, nothing written.

use super::folder::{Suite, check};
use crate::support::commands::Ran;
use serde_json::Value;
use std::fs;
use std::process::Command;

#[test]
fn a_malformed_suite_is_exit_2_with_what_where_and_what_is_allowed() {
    let refused = |break_it: &dyn Fn(&Suite), words: &str| {
        let folder = Suite::of_bar();
        break_it(&folder);
        for more in ["", "--bless"] {
            let ran = folder.exits(2, &format!("{more} --json --junit r.xml"));
            assert!(ran.reports_only_why(true), "{}", ran.out);
            ran.gives(&words.split("; ").collect::<Vec<_>>());
            assert!(!folder.path().join("../r.xml").exists() && !folder.path().join("bar.golden.json").exists());
        }
    };
    refused(&|f| f.remove("bar.case.json"), "holds no case; .case.json");
    refused(&|f| f.remove("bar.obj"), "bar.case.json; model; there is no file");
    let loose = |reason: &str| {
        format!(
            r#"{{"model": "bar.obj", "job": {{}}, "tolerances": [{{"metrics": ["hausdorff"], "most": 1e-3{reason}}}]}}"#
        )
    };
    for (file, content, words) in [
        ("bar.case.json", "{", "bar.case.json"),
        ("bar.case.json", r#"{"model": "bar.obj"}"#, "missing field `job`"),
        (
            "bar.case.json",
            r#"{"model": "bar.obj", "job": {}, "tolerence": []}"#,
            "tolerence; tolerances",
        ),
        (
            "bar.case.json",
            r#"{"model": "bar.obj", "job": {"handels": []}}"#,
            "job.handels",
        ),
        (
            "bar.case.json",
            r#"{"model": "../bar.obj", "job": {}}"#,
            "model; stays below its folder; sample:creature",
        ),
        (
            "bar.case.json",
            r#"{"model": "bar.obj", "job": "job.json"}"#,
            "bar.case.json; job.json",
        ),
        ("bar.case.json", &loose(""), "bar.case.json: tolerances[0].reason; why"),
        ("bar.case.json", &loose(", \"reason\": \"\""), "tolerances[0].reason"),
        ("lost.golden.json", "{}", "lost.golden.json; without a case"),
        ("a b.case.json", "{}", "a b; letters, digits"),
        ("soft.CASE.JSON", "{}", "soft.CASE.JSON; ends with .case.json"),
        (
            "bar.case.json",
            r#"{"model": "bar.obj", "job": {"#,
            "bar.case.json: job: EOF",
        ),
        (
            "bar.case.json",
            r#"["t", "bar.obj", {}, [], null, null]"#,
            "bar.case.json: invalid type; a JSON object",
        ),
        (
            "bar.case.json",
            "\u{feff}{\"model\": \"bar.obj\", \"job\": {}}",
            "bar.case.json: begins with a byte order mark",
        ),
    ] {
        refused(&|f| f.write(file, content), words);
    }
}

/// Asserts that a job is refused, in the case and in a file of its own.
fn refused_wherever(job: &str, words: &[&str]) {
    for said in [job, "\"job.json\""] {
        let folder = Suite::of_bar();
        folder.write("job.json", job);
        folder.write("bar.case.json", &format!(r#"{{"model": "bar.obj", "job": {said}}}"#));
        folder.exits(2, "").gives(words);
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
        refused_wherever(&job, &["bar.case.json: ", "at least 0", "expect."]);
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
        refused_wherever(
            &job,
            &["bar.case.json: ", "expect.digest", digest, "16 hexadecimal digits"],
        );
    }
}

#[test]
fn what_is_no_file_is_refused_and_never_waited_for() {
    let refused = |put: &dyn Fn(&Suite), arguments: &str, words: &[&str]| {
        let folder = Suite::of_bar();
        put(&folder);
        let ran = folder.exits(2, arguments);
        ran.gives(words);
        assert!(!ran.err.contains("stored"), "{}", ran.err);
    };
    let pipe = |folder: &Suite, name: &str| {
        let made = Command::new("mkfifo").arg(folder.path().join(name)).status();
        assert!(made.expect("mkfifo runs").success(), "{name}");
    };
    refused(
        &|f| pipe(f, "f.case.json"),
        "",
        &["f.case.json is not a regular file", "a file is needed"],
    );
    refused(
        &|f| pipe(f, "bar.golden.json"),
        "--bless",
        &["bar.golden.json is not a regular file"],
    );
    let folder_there = |f: &Suite| fs::create_dir(f.path().join("bar.golden.json")).expect("a folder");
    for arguments in ["", "--bless"] {
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
        "--data data",
        &["arm.case.json: model: ", "meshes is a folder"],
    );
    refused(
        &shared,
        "--data nowhere",
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
    let ran = folder.passes("--bless");
    ran.says(&["note: cases in folders", "2 are there, the first is more/a.case.json"]);
}

#[test]
fn wrong_arguments_are_exit_2() {
    let folder = Suite::of_bar();
    let cases: [(&str, &str); 7] = [
        ("--bless --server http://127.0.0.1:1", "--bless"),
        // Nothing listens there.
        ("--server https://127.0.0.1:1", "the server cannot be used"),
        ("--server https://127.0.0.1:1 --ca none.pem", "none.pem"),
        ("--server 127.0.0.1:1", "http://"),
        // Nothing listens there.
        ("--server http://127.0.0.1:1", "the server cannot be used"),
        ("--threads 5000", "0 to 1024"),
        ("--what", "--what"),
    ];
    let refused = |ran: Ran, reason: &str| {
        assert_eq!(ran.out, "");
        ran.exits(2).gives(&[reason]);
    };
    for (arguments, reason) in cases {
        refused(folder.check(arguments), reason);
    }
    refused(
        folder.check(&["--server", "http://127.0.0.1:1", "--token", "a b"]),
        "--token",
    );
    check(&folder.path().join("../nowhere"), "")
        .exits(2)
        .gives(&["cannot read the suite"]);
}

#[test]
fn cases_are_run_and_blessed_alone_by_name() {
    let suite = Suite::new();
    for name in ["arm-left", "arm-right", "bar"] {
        suite.case(name, "bar.obj");
    }
    let golden = |name: &str| fs::read(suite.path().join(format!("{name}.golden.json"))).ok();
    suite.passes("--bless --case arm-*");
    assert!(golden("arm-left").is_some() && golden("arm-right").is_some() && golden("bar").is_none());
    let before = golden("arm-right");
    suite.job("arm-left", "bar.obj", 0.2);
    suite.job("arm-right", "bar.obj", 0.2);
    suite.passes("--bless --case arm-left");
    assert_eq!(golden("arm-right"), before, "only what was named is blessed");
    // What is wrong with others is not asked, but their files are the suite's.
    suite.write("bar.case.json", "{");
    let ran = suite.passes("--case arm-left --json");
    let report = ran.json();
    assert_eq!(report["cases"].as_array().map(Vec::len), Some(1));
    assert_eq!(report["notes"][0], "1 of the suite's 3 cases are run");
    for file in ["suite/bar.case.json", "suite/arm-right.golden.json"] {
        let ran = suite.exits(2, &["--case", "arm-left", "--html", file, "--force"]);
        ran.gives(&["a file of the suite"]);
    }
    let ran = suite.check("--case arm-left --case leg");
    let there = "--case leg: no case of the suite";
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    ran.gives(&[there]);
    ran.gives(&["there are arm-left, arm-right, bar"]);
    let ran = suite.exits(2, "--case bar --shard 1/2");
    ran.gives(&["cannot be used with"]);
}

#[test]
fn a_case_is_started_from_a_model_and_a_job() {
    let suite = Suite::of_bar();
    let case: Value = serde_json::from_str(&suite.read("bar.case.json")).expect("JSON");
    suite.write("bend.json", &case["job"].to_string());
    let files = || {
        let entries = fs::read_dir(suite.path()).expect("a folder");
        let mut names: Vec<_> = entries.map(|entry| entry.expect("an entry").file_name()).collect();
        names.sort();
        names
    };
    let before = files();
    for (arguments, reason) in [
        ("--new bend", "--model"),
        (
            "--new bend --model bar.obj --job none.json",
            "--job: none.json is neither below",
        ),
        ("--new bend --model ../bar.obj --job bend.json", "--model: ../bar.obj"),
        ("--new bend --model /etc/passwd --job bend.json", "is not below"),
        ("--new b/d --model bar.obj --job bend.json", "is not the name of a case"),
        (
            "--new bar --model bar.obj --job bend.json",
            "the case \"bar\" is there already",
        ),
        ("--new bend --model sample:cow --job bend.json", "is not built in"),
        (
            "--new bend --model bar.obj --job bend.json --bless",
            "cannot be used with",
        ),
    ] {
        suite.exits(2, arguments).gives(&[reason]);
        assert_eq!(files(), before, "{arguments}: nothing is left behind");
    }
    suite
        .fails("--new bend --model bend.json --job bend.json")
        .gives(&["1 of 1 cases failed: bend"]);
    assert_eq!(files(), before, "a case that cannot be run is not left behind");
    // By its path from the working folder as well, which is the one that holds the suite.
    suite.passes("--new bend --model bar.obj --job suite/bend.json --html report.html");
    let made: Value = serde_json::from_str(&suite.read("bend.case.json")).expect("JSON");
    assert_eq!(
        (made["model"].as_str(), made["job"].as_str()),
        (Some("bar.obj"), Some("bend.json"))
    );
    assert!(suite.read("report.html").contains("bend"));
    assert!(
        !suite.path().join("bar.golden.json").exists(),
        "other cases are not blessed"
    );
    suite.passes("--case bend");
    let feet = r#"{"handles": [{"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}}]}"#;
    suite.write("stand.json", feet);
    suite.passes("--new stand --model sample:creature --job stand.json");
}
