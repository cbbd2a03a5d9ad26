//! A suite in shards on several machines: together they are the whole, and joined they say what a run of the whole says.

use super::folder::{Suite, check, run_in, sample_suite};

use crate::support::commands::{Arguments, Ran, words};
use crate::support::data::copied;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Runs `pliant check --merge` in a folder.
fn merge(folder: &Path, arguments: &(impl Arguments + ?Sized)) -> Ran {
    run_in(folder, &[vec!["check", "--merge"], arguments.list()].concat())
}

fn names(report: &Value) -> Vec<String> {
    let cases = report["cases"].as_array().expect("cases");
    cases
        .iter()
        .map(|c| c["name"].as_str().expect("a name").to_owned())
        .collect()
}

/// The sample suite with one golden that stores other positions.
fn broken_sample() -> Suite {
    let suite = Suite::new();
    copied(&sample_suite(), &suite.path());
    let mut golden: Value = serde_json::from_str(&suite.read("twist.golden.json")).expect("a golden");
    golden["digest"] = "xxh3:0011223344556677".into();
    golden["metrics"]["edgeRms"] = 0.25.into();
    suite.write("twist.golden.json", &golden.to_string());
    suite
}

/// Reports of all shards, in files `1.json` and so on beside the suite.
fn run_shards(suite: &Suite, of: usize, more: &[&str]) -> Vec<Ran> {
    let run = |k: usize| {
        let (shard, report) = (format!("{k}/{of}"), format!("shards/{k}.json"));
        let arguments = ["--shard", &shard, "--report", &report, "--force", "--parents"];
        suite.check(&[&arguments[..], more].concat())
    };
    (1..=of).map(run).collect()
}

#[test]
fn shards_are_the_suite_and_joined_they_say_what_one_run_says() {
    let suite = broken_sample();
    let beside = suite.path().join("..");
    let whole = suite.fails("--json --report whole.json --junit whole.xml --html whole.html");
    assert_eq!(suite.read("whole.json"), whole.out);
    let cases = names(&whole.json());
    for of in [1, 3, 8] {
        let ran = run_shards(&suite, of, &["--pictures"]);
        let reports: Vec<Value> = (1..=of)
            .map(|k| serde_json::from_str(&suite.read(&format!("shards/{k}.json"))).expect("a report"))
            .collect();
        let mut dealt: Vec<String> = reports.iter().flat_map(names).collect();
        dealt.sort();
        assert_eq!(dealt, cases, "every case once");
        for (k, (ran, report)) in ran.iter().zip(&reports).enumerate() {
            let fails = names(report).iter().any(|n| n == "twist");
            assert_eq!(ran.code, Some(i32::from(fails)), "{}", ran.err);
            assert_eq!(report["shard"]["number"], k + 1);
            match names(report).len() {
                0 => assert!(
                    of > cases.len() && ran.last().contains("has no case: all 6 cases"),
                    "{}",
                    ran.err
                ),
                n => assert!(
                    ran.err
                        .contains(&format!("shard {}/{of}, {n} of 6 cases in process", k + 1)),
                    "{}",
                    ran.err
                ),
            }
        }
        let outputs = words("--json --junit shards/m.xml --html shards/m.html --force");
        let joined = merge(&beside, &[&["shards"], &outputs[..]].concat());
        assert_eq!(joined.code, Some(1), "{}", joined.err);
        assert_eq!(joined.out, whole.out);
        assert_eq!(joined.err, whole.err);
        assert_eq!(suite.read("shards/m.xml"), suite.read("whole.xml"));
        assert!(
            suite.read("shards/m.html") == suite.read("whole.html"),
            "the pages differ"
        );
        assert!(suite.read("whole.html").contains("data:image/png;base64,"));
        fs::remove_dir_all(beside.join("shards")).expect("removed");
    }
}

#[test]
fn a_suite_that_passes_passes_joined_and_shards_hold_times_and_pictures_on_request() {
    let suite = Suite::new();
    // As files "a-b.case.json" comes before "a.case.json", as names the other way round.
    for name in ["a", "a-b", "b"] {
        suite.still(name, "bar.obj");
    }
    suite.passes("--bless");
    let beside = suite.path().join("..");
    let whole = suite.check("--json --html whole.html");
    run_shards(&suite, 2, &["--times"]);
    let timed: Value = serde_json::from_str(&suite.read("shards/1.json")).expect("a report");
    assert!(
        timed["cases"][0]["milliseconds"].as_f64().is_some_and(|ms| ms > 0.0),
        "{timed}"
    );
    let joined = merge(&beside, "shards/2.json shards/1.json --json");
    assert_eq!((joined.code, &joined.out), (Some(0), &whole.out), "{}", joined.err);
    assert_eq!(joined.err, whole.err);
    // Times are reported where they are asked for, and then those that the shards measured.
    let joined = merge(
        &beside,
        &["shards", "--times", "--report", "merged.json", "--junit", "m.xml"],
    );
    assert_eq!(joined.code, Some(0), "{}", joined.err);
    let merged: Value = serde_json::from_str(&suite.read("merged.json")).expect("a report");
    let cases = merged["cases"].as_array().expect("cases");
    assert!(cases.iter().all(|c| c["milliseconds"].as_f64().is_some()), "{merged}");
    assert!(suite.read("m.xml").contains("name=\"a-b\" time=\""));
    // A page without pictures says so.
    let bare = merge(&beside, "shards --html bare.html");
    assert_eq!(bare.code, Some(0), "{}", bare.err);
    bare.says(&["3 cases have no pictures"]);
    run_shards(&suite, 2, &["--pictures"]);
    let drawn = merge(&beside, "shards --html drawn.html --json --pictures");
    assert_eq!(drawn.err, whole.err);
    assert!(suite.read("drawn.html") == suite.read("whole.html"), "the pages differ");
    assert!(
        drawn.json()["cases"][0]["pictures"][0]["png"]
            .as_str()
            .is_some_and(|png| png.starts_with("iVBO"))
    );
    // Where somebody else judges, failed cases are no failure of the program.
    suite.job("a", "bar.obj", 0.4);
    let failed = suite.check("--shard 0+1/1 --exit-zero");
    assert!(
        failed.code == Some(0) && failed.last().contains("1 of 3 cases failed: a"),
        "{}",
        failed.err
    );
}

#[test]
fn a_split_follows_from_the_suite_or_from_times_alone() {
    let suite = Suite::new();
    for name in ["a", "b", "c", "d"] {
        suite.still(name, "bar.obj");
    }
    suite.passes("--bless");
    let dealt = |suite: &Suite, more: &[&str]| -> Vec<Vec<String>> {
        let run = |k: usize| {
            let shard = format!("{k}/2");
            let ran = suite.passes(&[&["--shard", &shard, "--json"], more].concat());
            names(&ran.json())
        };
        (1..=2).map(run).collect()
    };
    let alike = dealt(&suite, &[]);
    assert_eq!(alike, [["a", "c"], ["b", "d"]], "cases of one cost take turns by name");
    // Another machine, with other names of folders, threads and data.
    let elsewhere = Suite::new();
    copied(&suite.path(), &elsewhere.path());
    assert_eq!(dealt(&elsewhere, &["--threads", "1", "--data", "/nowhere"]), alike);
    // By the times of a run that took longest for "d", and knew no "c": it is as dear as the others' mean.
    suite.passes("--times --report times.json");
    let mut times: Value = serde_json::from_str(&suite.read("times.json")).expect("a report");
    for (k, took) in [(0, 10.0), (1, 20.0), (3, 90.0)] {
        times["cases"][k]["milliseconds"] = took.into();
    }
    times["cases"].as_array_mut().expect("cases").remove(2);
    fs::write(suite.path().join("../costs.json"), times.to_string()).expect("written");
    let costs = ["--costs", "costs.json"];
    assert_eq!(dealt(&suite, &costs), [vec!["d"], vec!["a", "b", "c"]]);
    // Dearer by what its golden counted.
    let mut golden: Value = serde_json::from_str(&suite.read("a.golden.json")).expect("a golden");
    golden["metrics"]["cycles"] = 1e6.into();
    suite.write("a.golden.json", &golden.to_string());
    assert_eq!(dealt(&suite, &[]), [vec!["a"], vec!["b", "c", "d"]]);
}

#[test]
fn shards_that_there_are_not_are_exit_2() {
    let suite = Suite::new();
    suite.still("bar", "bar.obj");
    suite.passes("--bless");
    fs::write(suite.path().join("../none.json"), "{}").expect("written");
    suite.passes("--report untimed.json");
    let cases: [(&str, &str); 10] = [
        ("--shard 0/8", "0/8; allowed are 1/8 to 8/8"),
        ("--shard 9/8", "no shard 9 of 8"),
        ("--shard a/b", "a/b; K/N is needed, such as 3/8"),
        ("--shard 1/0", "1 to 10000 shards"),
        ("--shard 1/2 --bless", "--shard; --bless"),
        ("--costs untimed.json", "--shard"),
        ("--shard 1/2 --costs nowhere.json", "nowhere.json"),
        ("--shard 1/2 --costs none.json", "none.json; missing field `suite`"),
        ("--shard 1/2 --costs untimed.json", "untimed.json; --times"),
        ("--pictures", "--json"),
    ];
    for (arguments, words) in cases {
        let ran = suite.exits(2, arguments);
        assert_eq!(ran.out, "", "{arguments:?}");
        ran.gives(&words.split("; ").collect::<Vec<_>>());
    }
    // One case on eight machines: seven have nothing to do, and say so.
    let empty: BTreeSet<bool> = (1..=8)
        .map(|k| {
            let ran = suite.passes(&format!("--shard {k}/8 --junit r.xml --html r.html --force"));
            let is_empty = ran.last().contains("has no case");
            assert_eq!(is_empty, suite.read("r.xml").contains("tests=\"0\""));
            assert_eq!(
                is_empty,
                suite.read("r.html").contains(&format!("shard {k}/8: 0 of 1 cases"))
            );
            is_empty
        })
        .collect();
    assert_eq!(empty, BTreeSet::from([false, true]));
}

#[test]
fn reports_that_do_not_belong_together_are_exit_2_and_write_nothing() {
    let suite = Suite::new();
    for name in ["a", "b", "c"] {
        suite.still(name, "bar.obj");
    }
    suite.passes("--bless --report whole.json");
    let beside = suite.path().join("..");
    assert!(run_shards(&suite, 3, &[]).iter().all(|ran| ran.code == Some(0)));
    suite.passes("--shard 2/2 --report half.json");
    let text = suite.read("shards/2.json");
    let put = |name: &str, from: &str, to: &str| {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "{from}");
        fs::write(beside.join(name), changed).expect("written");
    };
    put("build.json", "\"build\": \"", "\"build\": \"9.9 ");
    put("edited.json", "\"name\": \"b\"", "\"name\": \"z\"");
    put("cut.json", "\"cases\": [", "\"cases\": [ ]");
    // A golden of the suite that has changed makes another suite.
    let golden = suite.read("c.golden.json");
    suite.write("c.golden.json", &golden.replacen("xxh3:", "xxh3:0", 1));
    suite.check("--shard 2/3 --report changed.json");
    fs::create_dir(beside.join("empty")).expect("a folder");
    let cases: [(&str, &str); 11] = [
        (
            "shards/1.json shards/3.json",
            "shard 2/3 is missing: 2 of 3 cases are there",
        ),
        ("shards/3.json", "shards 1/3, 2/3 are missing"),
        ("shards shards/2.json", "shard 2/3 is there twice; 2.json"),
        (
            "shards/1.json whole.json",
            "whole.json is the report of a whole suite; --shard",
        ),
        ("shards/1.json half.json", "different numbers of shards: 1/3, 2/2"),
        (
            "shards/1.json changed.json shards/3.json",
            "changed.json are of different suites",
        ),
        ("shards/1.json build.json shards/3.json", "different builds; 9.9"),
        ("shards/1.json edited.json shards/3.json", "a report was changed"),
        ("shards/1.json cut.json", "cut.json: ; --report"),
        ("nowhere.json", "cannot read nowhere.json"),
        ("empty", "the folder empty holds no report"),
    ];
    for (reports, words) in cases {
        let ran = merge(&beside, &format!("{reports} --json --junit r.xml")).exits(2);
        assert!(ran.reports_only_why(true), "{}", ran.out);
        ran.gives(&words.split("; ").collect::<Vec<_>>());
        assert!(!beside.join("r.xml").exists());
    }
    for (arguments, word) in [
        ("shards --bless", "--bless"),
        ("shards --shard 1/3", "--shard"),
        ("--json", "--merge"),
    ] {
        merge(&beside, arguments).exits(2).gives(&[word]);
    }
    check(&suite.path(), "--merge shards").exits(2).gives(&["SUITE"]);
    run_in(&beside, "check").exits(2);
}
