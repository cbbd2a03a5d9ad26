//! `pliant check` as a CI job sees it: the sample suite in process and on a server, what each kind of damage does, and
//! what is refused.

mod damage;
mod folder;
mod pages;
mod refusals;
mod reports;
mod shards;

use crate::support::commands::Ran;
use crate::support::server::Server;
use folder::{Suite, check, sample_suite};
use serde_json::Value;
use std::fs;

/// Names, digests and statuses of a report.
fn digests(report: &Value) -> Vec<(String, String, String)> {
    let cases = report["cases"].as_array().expect("cases");
    let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
    cases
        .iter()
        .map(|c| (text(&c["name"]), text(&c["digest"]), text(&c["status"])))
        .collect()
}

#[test]
fn the_sample_suite_passes_on_one_and_two_threads_with_the_same_digests() {
    let suite = sample_suite();
    let run = |threads: &str| check(&suite, &["--json", "--threads", threads]);
    let [one, two] = ["1", "2"].map(run);
    for ran in [&one, &two] {
        assert_eq!(ran.code, Some(0), "{}", ran.err);
    }
    assert_eq!(one.out, two.out, "the report says nothing of threads");
    assert_eq!(one.err, two.err);
    let report = one.json();
    let found = digests(&report);
    assert!(found.len() >= 5, "{found:?}");
    assert!(
        found
            .iter()
            .all(|(_, digest, status)| digest.starts_with("xxh3:") && status == "passed")
    );
    assert!(
        report["cases"]
            .as_array()
            .expect("cases")
            .iter()
            .all(|c| c["identical"] == true),
        "{}",
        one.err
    );
    // One line a case and one for all.
    assert_eq!(one.err.lines().count(), found.len() + 1, "{}", one.err);
    let total: u64 = (fs::read_dir(&suite).expect("a folder"))
        .map(|e| e.expect("an entry").path())
        .filter(|p| p.to_string_lossy().ends_with(".golden.json"))
        .map(|p| fs::metadata(p).expect("a file").len())
        .sum();
    assert!(total < 120_000, "goldens of {total} bytes are too large for git");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_sample_suite_passes_on_a_server_with_the_digests_of_the_process() {
    let server = Server::start().await;
    let url = format!("http://{}", server.address);
    let ran = tokio::task::spawn_blocking(move || {
        let suite = sample_suite();
        let local = check(&suite, "--json");
        let remote = [
            check(&suite, &["--json", "--threads", "1", "--server", &url]),
            check(
                &suite,
                &["--json", "--threads", "2", "--server", &url, "--token", "secret"],
            ),
        ];
        (local, remote)
    });
    let (local, remote): (Ran, [Ran; 2]) = ran.await.expect("it ran");
    for ran in &remote {
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        assert_eq!(digests(&ran.json()), digests(&local.json()));
        assert_eq!(ran.json()["how"], "on a server");
    }
    assert_eq!(remote[0].out, remote[1].out);
    assert_eq!(server.metric("pliant_sessions").await, 0.0, "no session is left behind");
}

#[test]
fn a_case_without_its_data_is_skipped_by_name_or_fails_on_request() {
    let folder = Suite::new();
    folder.write("arm.case.json", r#"{"model": "data:models/arm.off", "job": {}}"#);
    folder.case("bar", "bar.obj");
    folder.passes("--bless");
    let empty = tempfile::tempdir().expect("a folder");
    let data = empty.path().to_string_lossy().into_owned();
    let ran = folder.passes(&["--json", "--data", &data, "--junit", "r.xml", "--html", "r.html"]);
    ran.says(&["skipped  arm", "1 passed, 1 skipped"]);
    assert_eq!(ran.json()["cases"][0]["status"], "skipped");
    assert!(
        folder
            .read("r.xml")
            .contains("<skipped message=\"data:models/arm.off is absent")
    );
    assert!(folder.read("r.html").contains("data:models/arm.off is absent"));
    let ran = folder.fails(&["--no-skip", "--data", &data, "--junit", "r.xml", "--force"]);
    ran.says(&["FAILED   arm"]);
    ran.gives(&["1 of 2 cases failed: arm"]);
    assert!(folder.read("r.xml").contains("<failure message=\"data:models/arm.off"));
    // With the data there it is a case like any other.
    fs::create_dir(empty.path().join("models")).expect("a folder");
    fs::write(
        empty.path().join("models/arm.off"),
        "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    )
    .expect("written");
    let ran = folder.fails(&["--data", &data]);
    ran.says(&["missing-golden"]);
    folder.passes(&["--data", &data, "--bless"]);
    folder.passes(&["--data", &data, "--no-skip"]);
}

#[test]
fn blessing_says_what_it_changes_and_leaves_what_is_the_same() {
    let folder = Suite::of_bar();
    let first = folder.passes("--bless");
    first.says(&["blessed  bar", "new: "]);
    first.says(&["volumeChange ", "cycles "]);
    let golden = folder.read("bar.golden.json");
    let again = folder.check("--bless");
    assert_eq!(again.err.lines().count(), 2, "nothing changes: {}", again.err);
    assert_eq!(folder.read("bar.golden.json"), golden);
    // Another pose: every number that moves is reported.
    folder.job("bar", "bar.obj", 0.9);
    let ran = folder.fails(&[]);
    ran.says(&["stale"]);
    let third = folder.passes("--bless");
    for word in [
        "job ",
        "digest xxh3:",
        "maxDisplacement from the old golden 0.",
        "edgeRms 0.",
    ] {
        assert!(third.err.contains(word), "{word} in {}", third.err);
    }
    folder.passes(&[]);
    // What a job expects is not asserted, but reported.
    let text =
        folder
            .read("bar.case.json")
            .replacen("\"job\": {", "\"job\": {\"expect\": {\"volumeChange\": 1e-9},", 1);
    folder.write("bar.case.json", &text);
    let reply = folder.passes("--bless");
    reply.says(&["volumeChange is"]);
    let unmet = folder.fails(&[]);
    unmet.says(&["expectation: volumeChange"]);
    // Crossings are counted where they are expected to be few, and compared with those of the golden.
    let text = text.replacen("\"volumeChange\": 1e-9", "\"newSelfIntersections\": 0", 1);
    folder.write("bar.case.json", &text);
    let counted = folder.passes("--bless");
    counted.says(&["newSelfIntersections n/a -> 0"]);
    folder.passes(&[]);
}

#[test]
fn another_digest_is_reported_before_the_numbers_and_a_huge_number_in_few_digits() {
    let folder = Suite::of_bar();
    folder.passes("--bless");
    let mut golden: Value = serde_json::from_str(&folder.read("bar.golden.json")).expect("a golden");
    golden["digest"] = "xxh3:0011223344556677".into();
    golden["metrics"]["bytes"] = 1.into();
    folder.write("bar.golden.json", &golden.to_string());
    let ran = folder.fails("--html r.html --junit r.xml");
    let line = ran.err.lines().next().unwrap_or_default();
    assert!(
        line.starts_with("FAILED   bar  digest: the digest is xxh3:") && line.contains("; bytes "),
        "{line}"
    );
    assert!(folder.read("r.html").contains("<td>digest: the digest is xxh3:"));
    assert!(folder.read("r.xml").contains("<failure message=\"the digest is xxh3:"));
    // Any number is a tolerance; its digits do not fill the screen.
    let loose = r#""tolerances": [{"metrics": ["bytes"], "most": 1e300, "reason": "a test"}], "job": {"#;
    let text = folder.read("bar.case.json").replacen("\"job\": {", loose, 1);
    folder.write("bar.case.json", &text);
    let ran = folder.passes("--junit r.xml --force");
    ran.says(&[", limit 1.00e300"]);
    assert!(folder.read("r.xml").contains("name=\"bytes.allowed\" value=\"1e300\""));
}

#[test]
fn a_small_difference_passes_within_a_tolerance_that_has_a_reason() {
    let folder = Suite::of_bar();
    folder.passes("--bless");
    // The stored result is that of a slightly looser solve.
    let exact = folder.read("bar.case.json");
    let loose = exact.replace("1e-8", "1e-5");
    assert_ne!(loose, exact);
    folder.write("bar.case.json", &loose);
    let ran = folder.check("--bless");
    assert!(
        ran.err.contains("digest"),
        "the looser solve ends elsewhere: {}",
        ran.err
    );
    folder.pretend_job("bar", &exact);
    folder.write("bar.case.json", &exact);
    let ran = folder.check("--json");
    // "limit 0", and not "limit 0.1".
    let zero = ran.err.split(", limit 0").nth(1);
    assert!(
        ran.code == Some(1)
            && (ran.err.contains("no tolerance allows") || zero.is_some_and(|rest| !rest.starts_with('.'))),
        "{}",
        ran.err
    );
    let metrics: Vec<String> = ran.json()["cases"][0]["metrics"]
        .as_array()
        .expect("metrics")
        .iter()
        .map(|m| format!("\"{}\"", m["name"].as_str().expect("a name")))
        .collect();
    let tolerances = format!(
        r#""tolerances": [{{"metrics": [{}], "most": 1e9, "reason": "the solve is looser"}}], "job": {{"#,
        metrics.join(", ")
    );
    folder.write("bar.case.json", &exact.replacen("\"job\": {", &tolerances, 1));
    let ran = folder.passes("--json --junit r.xml");
    ran.says(&["within tolerance"]);
    assert_eq!(ran.json()["cases"][0]["identical"], false);
    assert!(folder.read("r.xml").contains("value=\"the solve is looser\""));
}

#[test]
fn an_open_surface_has_no_volume_and_a_golden_that_stores_one_still_passes() {
    let folder = Suite::new();
    let bar = crate::support::server::bar_obj(20);
    let (open, _) = bar.trim_end().rsplit_once('\n').expect("triangles");
    folder.write("open.obj", open);
    folder.job("open", "open.obj", 0.8);
    let blessed = folder.check("--bless");
    assert!(
        blessed.code == Some(0) && !blessed.err.contains("volumeChange") && blessed.err.contains("areaChange "),
        "{}",
        blessed.err
    );
    let golden = folder.read("open.golden.json");
    assert!(!golden.contains("volumeChange") && golden.contains("areaChange"));
    let volume = |ran: &Ran| {
        let metrics = ran.json()["cases"][0]["metrics"].as_array().expect("metrics").clone();
        metrics.into_iter().find(|m| m["name"] == "volumeChange").expect("it")
    };
    // As goldens were stored before: with a volume that stood for none, which cannot fail and is shown nowhere.
    let old = golden.replacen("\"metrics\": {", "\"metrics\": {\n    \"volumeChange\": 0.0,", 1);
    for text in [&golden, &old] {
        folder.write("open.golden.json", text);
        let ran = folder.passes("--json --html r.html --junit r.xml --force");
        let reply = volume(&ran);
        assert!(
            reply.get("value").is_none() && reply.get("stored").is_none() && reply["holds"] == true,
            "{reply}"
        );
        let row = "<td>volumeChange</td><td>ratio</td><td class=\"number\">n/a</td><td class=\"number\">0</td>\
                   <td class=\"number\">n/a</td><td class=\"number\">n/a</td>";
        assert!(folder.read("r.html").contains(row));
        assert!(folder.read("r.xml").contains("name=\"volumeChange\" value=\"n/a\""));
    }
    let again = folder.passes("--bless");
    again.says(&["volumeChange 0 -> n/a"]);
    assert_eq!(folder.read("open.golden.json"), golden);
    // What has a volume keeps it.
    folder.case("open", "open.obj");
    let closed = folder.check("--bless");
    closed.says(&["volumeChange n/a -> "]);
}
