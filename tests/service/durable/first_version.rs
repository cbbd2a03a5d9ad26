//! A folder that the first version wrote, with every kind of commit. It is never written again, and every later version opens it.

use super::path;
use super::place::tamper;
use crate::support::program::ServedProgram;
use crate::support::server::floats;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

#[tokio::test(flavor = "multi_thread")]
async fn what_the_first_version_wrote_opens_for_ever() {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/service/durable/first_version");
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path().join("data");
    let copied = Command::new("cp")
        .arg("-r")
        .arg(sample.join("data"))
        .arg(&folder)
        .status();
    assert!(copied.expect("cp runs").success());
    // Its time is over long since.
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .expect("after 1970")
        .as_millis();
    tamper(&folder, &format!("UPDATE sessions SET used_ms = {now}")).await;
    let server = ServedProgram::start(&folder, &["--max-ttl", "366d"]);
    let was: Value = serde_json::from_slice(&fs::read(sample.join("session.json")).expect("readable")).expect("JSON");
    let id = was["session"]["id"].as_str().expect("an id");
    let session = server.done("GET", &path(id, ""), None).await;
    for told in ["id", "revision", "label", "model", "primitives", "handles"] {
        assert_eq!(session[told], was["session"][told], "{told}");
    }
    let history = server.done("GET", &path(id, "/history"), None).await;
    let commits = |history: &Value| -> Vec<(Value, Value)> {
        let list = history["commits"].as_array().expect("commits");
        list.iter()
            .map(|c| (c["revision"].clone(), c["kind"].clone()))
            .collect()
    };
    assert_eq!(commits(&history), commits(&was["history"]));
    assert_eq!(history["current"], was["history"]["current"]);
    // Another build or processor may differ in late digits; the bar is four long.
    let (now, then) = (
        floats(&server.positions(id).await),
        floats(&fs::read(sample.join("positions.f32")).expect("readable")),
    );
    assert_eq!(now.len(), then.len());
    let farthest = now.iter().zip(&then).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(farthest <= 4e-3, "{farthest}");
    let mut steps = 0;
    while server.call("POST", &path(id, "/undo"), None).await.0 == 200 {
        steps += 1;
    }
    assert_eq!(steps, commits(&history).len() - 2, "{}", server.log());
    for _ in 0..=steps {
        server.done("POST", &path(id, "/redo"), None).await;
    }
}
