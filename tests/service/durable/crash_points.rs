//! The process ends, or the power fails, after each single write and sync of a commit: the session opens to the state before or after
//! that commit, never between, and whatever was acknowledged is there.
//!
//! A server runs once while every change of its files is told, in order. From that the disk is made as it was after each change, in
//! three ways: with all changes (the process ended), with the last one half done (it ended in the middle of a write), and with nothing
//! but what was synced (the power failed). Each of them is opened.

use super::disk_model::{DiskModel, told_changes};
use super::path;
use crate::support::program::ServedProgram;
use crate::support::server::{bar_obj, ends, turn_json};
use pliant::session::store::{DatabaseStore, StoreLocation};
use pliant::session::{Error, ErrorCode, HistoryFacts, Manager, OpenDeformer, SessionConfig, Tenant};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

/// The commits of a session and the current one, as (revision, digest).
#[derive(Debug, Clone, PartialEq, Eq)]
struct SeenLog {
    commits: Vec<(u64, String)>,
    current: u64,
}

impl SeenLog {
    fn told(history: &Value) -> Self {
        let number = |v: &Value| {
            v.as_str()
                .map_or_else(|| v.as_u64(), |t| t.parse().ok())
                .expect("a number")
        };
        let digest = |v: &Value| v.as_str().expect("a digest").to_owned();
        let list = history["commits"].as_array().expect("commits").iter();
        Self {
            commits: list.map(|c| (number(&c["revision"]), digest(&c["digest"]))).collect(),
            current: number(&history["current"]),
        }
    }

    fn of(history: HistoryFacts) -> Self {
        Self {
            commits: history.commits.into_iter().map(|c| (c.revision, c.digest)).collect(),
            current: history.current,
        }
    }
}

/// The library that tells changes, built by the compiler of C.
fn tracer(folder: &Path) -> PathBuf {
    let library = folder.join("disk_trace.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/service/durable/disk_trace.c");
    let mut compiler = Command::new("cc");
    compiler
        .args(["-shared", "-fPIC", "-O1", "-o"])
        .arg(&library)
        .arg(source)
        .arg("-ldl");
    let built = compiler.output().expect("a compiler of C");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    library
}

/// A session's life under a tracer: what it was after each acknowledged call, and how many changes had been told by then.
async fn traced_life(folder: &Path) -> (String, Vec<(usize, Option<SeenLog>)>, PathBuf) {
    let (library, records) = (tracer(folder), folder.join("changes"));
    let disk = folder.join("disk");
    std::fs::create_dir(&disk).expect("a folder");
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let (preload, root, told, data) = (text(&library), text(&disk), text(&records), text(&disk.join("data")));
    let variables = [
        ("LD_PRELOAD", &*preload),
        ("DISK_TRACE_ROOT", &*root),
        ("DISK_TRACE", &*told),
    ];
    let server = ServedProgram::start_anywhere(folder.join("log"), &["--data-dir", &data], &variables);
    let server = server.expect("the server starts");
    let count = || told_changes(&records).len();
    let mut states = vec![(count(), None)];
    let id = server.open(bar_obj(8), "").await;
    let handles = json!({"handles": ends()});
    let merge = json!({"merge": {"model": base64(&bar_obj(6)), "how": "LOOSE",
        "transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, 5,0,0,1]}});
    let cut = json!({"cut": {"plane": {"normal": [0, 0, 1], "offset": 2.01}, "keep": "BOTH", "fill": true}});
    for (method, rest, body) in [
        ("GET", "", None),
        ("PUT", "/handles", Some(handles)),
        ("POST", "/solve", Some(turn_json(0.4))),
        ("POST", "/edits", Some(merge)),
        ("POST", "/solve", Some(turn_json(0.8))),
        ("POST", "/undo", None),
        ("POST", "/redo", None),
        ("POST", "/edits", Some(cut)),
    ] {
        server.done(method, &path(&id, rest), body.as_ref()).await;
        let changes = count();
        let history = server.done("GET", &path(&id, "/history"), None).await;
        states.push((changes, Some(SeenLog::told(&history))));
    }
    server.done("DELETE", &path(&id, ""), None).await;
    states.push((count(), None));
    server.kill();
    (id, states, records)
}

/// What a disk holds of a session.
async fn opened(disk: &Path, id: &str) -> Result<Option<SeenLog>, Error> {
    let store = DatabaseStore::open(&StoreLocation::in_folder(disk)).await?;
    let config = SessionConfig {
        compute_threads: 1,
        ..SessionConfig::default()
    };
    let manager = Manager::with_store(config, OpenDeformer, Arc::new(store)).await?;
    let found = manager.history(&Tenant::default(), id).await;
    manager.abort();
    match found {
        Ok(history) => Ok(Some(SeenLog::of(history))),
        Err(error) if error.code == ErrorCode::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_state_is_the_one_before_or_after_wherever_the_process_ends() {
    let folder = tempfile::tempdir().expect("a folder");
    let (id, states, records) = traced_life(folder.path()).await;
    let changes = told_changes(&records);
    let root = folder.path().join("disk");
    let mut disk = DiskModel::new(&root);
    let mut tried = BTreeSet::new();
    let (mut points, mut opens) = (0, 0);
    let mut found: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    for (at, change) in changes.iter().enumerate() {
        let half = disk.with_half(change);
        disk.apply(change);
        points += 1;
        // The states that it may be in: the newest acknowledged one, or the one that was being made.
        let acknowledged = states.iter().rposition(|(changes, _)| *changes <= at + 1);
        let allowed = acknowledged.map_or(0..=0, |k| k..=(k + 1).min(states.len() - 1));
        let kept = [Some(disk.whole()), half, Some(disk.synced())];
        for (way, tree) in kept.into_iter().enumerate() {
            let Some(tree) = tree else { continue };
            if !tried.insert((tree.digest(), *allowed.start())) {
                continue;
            }
            let place = tempfile::tempdir().expect("a folder");
            tree.write(place.path());
            let told = opened(&place.path().join("data"), &id).await;
            opens += 1;
            let told = told.unwrap_or_else(|error| panic!("change {at} ({change:?}), way {way}: {error}"));
            let is_allowed = states[allowed.clone()].iter().position(|(_, state)| *state == told);
            let which = is_allowed.unwrap_or_else(|| {
                panic!(
                    "change {at} ({change:?}), way {way}: {told:?} is neither of {:?}",
                    &states[allowed.clone()]
                )
            });
            found.entry(*allowed.start()).or_default().insert(which);
        }
    }
    println!("{points} changes of files, {opens} disks opened");
    assert!(points > 100, "{points}");
    // Every commit was seen from both sides.
    for k in 0..states.len() - 1 {
        assert!(
            found.get(&k).is_some_and(|seen| seen.contains(&0)),
            "state {k} was never seen"
        );
    }
    // What was told is what is there.
    assert!(disk.whole().is_same_as(&root), "the model of the disk is not the disk");
}

fn base64(text: &str) -> String {
    use base64::Engine as _;
    base64::engine::general_purpose::STANDARD.encode(text)
}
