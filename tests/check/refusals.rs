//! Suites and arguments that are wrong: exit 2, the reason in the last line, nothing written.

use super::folder::{Suite, check};

#[test]
fn a_malformed_suite_is_exit_2_with_what_where_and_what_is_allowed() {
    let refused = |break_it: &dyn Fn(&Suite), words: &[&str]| {
        let folder = Suite::new();
        folder.case("bar", "bar.obj");
        break_it(&folder);
        for more in [&[][..], &["--bless"]] {
            let ran = folder.check(&[more, &["--json", "--junit", "r.xml"]].concat());
            assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{words:?}: {}", ran.err);
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
    refused(&|f| f.write("bar.case.json", "{"), &["bar.case.json"]);
    refused(
        &|f| f.write("bar.case.json", r#"{"model": "bar.obj"}"#),
        &["missing field `job`"],
    );
    refused(
        &|f| f.write("bar.case.json", r#"{"model": "bar.obj", "job": {}, "tolerence": []}"#),
        &["tolerence", "tolerances"],
    );
    refused(
        &|f| f.write("bar.case.json", r#"{"model": "bar.obj", "job": {"handels": []}}"#),
        &["job.handels"],
    );
    refused(
        &|f| f.write("bar.case.json", r#"{"model": "../bar.obj", "job": {}}"#),
        &["model", "stays below its folder", "sample:creature"],
    );
    refused(
        &|f| f.write("bar.case.json", r#"{"model": "bar.obj", "job": "job.json"}"#),
        &["bar.case.json", "job.json"],
    );
    let loose = |reason: &str| {
        format!(
            r#"{{"model": "bar.obj", "job": {{}}, "tolerances": [{{"metrics": ["hausdorff"], "most": 1e-3{reason}}}]}}"#
        )
    };
    refused(
        &|f| f.write("bar.case.json", &loose("")),
        &["bar.case.json: tolerances[0].reason", "why"],
    );
    refused(
        &|f| f.write("bar.case.json", &loose(", \"reason\": \"\"")),
        &["tolerances[0].reason"],
    );
    refused(
        &|f| f.write("lost.golden.json", "{}"),
        &["lost.golden.json", "without a case"],
    );
    refused(&|f| f.write("a b.case.json", "{}"), &["a b", "letters, digits"]);
}

#[test]
fn wrong_arguments_are_exit_2() {
    let folder = Suite::new();
    folder.case("bar", "bar.obj");
    let cases: [(&[&str], &str); 7] = [
        (&["--bless", "--server", "http://127.0.0.1:1"], "--bless"),
        (&["--server", "https://127.0.0.1:1"], "TLS"),
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
