//! What is damaged is reported and never served; other sessions do not suffer.

use super::place::tamper;
use super::{bar_at, bar_session, path, refused, seen, turn};
use crate::durable::place::{StorePlace, in_every_store};
use crate::support::program::ServedProgram;
use crate::support::server::floats;
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

in_every_store!(
    damaged_rows_are_reported_and_nothing_of_them_is_served,
    damaged_objects_are_reported_and_a_damaged_shape_is_solved_again,
    what_a_later_version_wrote_is_refused,
);

async fn damaged_rows_are_reported_and_nothing_of_them_is_served(place: StorePlace) {
    let server = place.start(&[]);
    let mut ids = Vec::new();
    for _ in 0..6 {
        let id = bar_session(&server).await;
        turn(&server, &id, 0.4).await;
        ids.push(id);
    }
    let healthy = seen(&server, &ids[5]).await;
    server.kill();
    for (id, change) in ids.iter().zip([
        "UPDATE commits SET payload = checksum WHERE sequence = 1 AND session",
        "DELETE FROM commits WHERE sequence = 1 AND session",
        "DELETE FROM commits WHERE sequence = 2 AND session",
        "UPDATE commits SET revision = 7 WHERE sequence = 2 AND session",
        "UPDATE sessions SET model = checksum WHERE id",
    ]) {
        place.tamper(&format!("{change} = '{id}'")).await;
    }
    let server = place.start(&[]);
    for id in &ids[..5] {
        for (method, rest) in [("GET", ""), ("GET", "/positions"), ("GET", "/model"), ("POST", "/undo")] {
            refused(server.call(method, &path(id, rest), None).await, 500, "DATA_LOSS");
        }
    }
    assert_eq!(
        seen(&server, &ids[5]).await,
        healthy,
        "another session is not concerned"
    );
    turn(&server, &ids[5], 0.1).await;
    let listed = server.done("GET", "/v1/sessions?pageSize=1000", None).await;
    let listed = listed["sessions"].to_string();
    assert!(listed.contains(&ids[5]));
    // Who has a damaged session can get rid of it.
    server.done("DELETE", &path(&ids[0], ""), None).await;
    assert_eq!(server.call("GET", &path(&ids[0], ""), None).await.0, 404);
}

async fn damaged_objects_are_reported_and_a_damaged_shape_is_solved_again(place: StorePlace) {
    let (server, id) = bar_at(&place, &[]).await;
    let model = place.objects();
    assert_eq!(model.len(), 1, "the model");
    // So many that the shape is kept.
    for k in 0..17 {
        turn(&server, &id, f64::from(k) * 0.05).await;
    }
    crate::support::server::eventually("a kept shape", async || place.count("snapshots").await == 1).await;
    let before = seen(&server, &id).await;
    server.kill();

    let shape = place.objects().into_iter().find(|o| *o != model[0]).expect("a shape");
    let whole = fs::read(&shape).expect("readable");
    for damage in [&whole[..whole.len() - 5], b"", &vec![7; whole.len()]] {
        fs::write(&shape, damage).expect("writable");
        let server = place.start(&[]);
        assert_eq!(seen(&server, &id).await, before);
        assert!(server.log().contains("a kept shape is not used"), "{}", server.log());
        server.kill();
    }
    fs::write(&shape, whole).expect("writable");
    let server = place.start(&[]);
    assert_eq!(seen(&server, &id).await, before);
    assert!(!server.log().contains("not used"), "{}", server.log());
    server.kill();

    let whole = fs::read(&model[0]).expect("readable");
    for damage in [Some(&whole[..whole.len() / 2]), Some(b""), None] {
        match damage {
            Some(bytes) => fs::write(&model[0], bytes).expect("writable"),
            None => fs::remove_file(&model[0]).expect("there"),
        }
        let server = place.start(&[]);
        refused(server.call("GET", &path(&id, ""), None).await, 500, "DATA_LOSS");
        // A new session on the same model mends the object.
        let other = server.open(String::from_utf8(whole.clone()).expect("OBJ"), "").await;
        assert_eq!(seen(&server, &id).await, before);
        server.done("DELETE", &path(&other, ""), None).await;
        server.kill();
    }
}

async fn what_a_later_version_wrote_is_refused(place: StorePlace) {
    let (server, id) = bar_at(&place, &[]).await;
    server.kill();
    place.tamper("UPDATE commits SET format = 99 WHERE sequence = 1").await;
    let server = place.start(&[]);
    let (status, reply) = server.call("GET", &path(&id, ""), None).await;
    assert_eq!(status, 409, "{reply}");
    assert!(
        reply["detail"].as_str().is_some_and(|d| d.contains("format 99")),
        "{reply}"
    );
    server.kill();
    place.tamper("UPDATE pliant_schema SET version = 99").await;
    place.refuses_to_start(&[], &["version 99"]);
}

const NOTE: &str = "sessions.newest";

/// The files of the database as a killed server left them.
struct Left(Vec<(PathBuf, Vec<u8>)>);

impl Left {
    fn read(place: &StorePlace) -> Self {
        let names = ["sessions.sqlite", "sessions.sqlite-wal", NOTE];
        let files = names.map(|name| place.data().join(name));
        Self(
            files
                .map(|file| (file.clone(), fs::read(&file).expect("a file")))
                .into(),
        )
    }

    fn put_back(&self, place: &StorePlace) {
        let _ = fs::remove_file(place.data().join("sessions.sqlite-shm"));
        for (file, bytes) in &self.0 {
            fs::write(file, bytes).expect("written");
        }
    }

    fn log(&self) -> (&PathBuf, &[u8]) {
        (&self.0[1].0, &self.0[1].1)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn commits_that_a_damaged_log_takes_away_are_reported_until_somebody_deals_with_them() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    // Stopped, so that the log begins with what comes now.
    server.stop().await;
    let server = place.start(&[]);
    for k in 1..6 {
        turn(&server, &id, f64::from(k) * 0.1).await;
    }
    let before = seen(&server, &id).await;
    server.kill();
    let left = Left::read(&place);
    let (log, bytes) = left.log();

    let flips = (0..7).map(|k| Some(k * (bytes.len() - 1) / 6));
    for (k, damage) in flips.chain([None]).enumerate() {
        left.put_back(&place);
        match damage {
            Some(at) => {
                let mut damaged = bytes.to_vec();
                damaged[at] ^= 0x5a;
                fs::write(log, damaged).expect("written");
            }
            None => fs::remove_file(log).expect("there"),
        }
        let check = place.store(&["check", "--replay"]);
        assert_eq!(check.code, 1, "{damage:?}: {}", check.out);
        assert!(check.out.contains("lacks the newest"), "{damage:?}: {}", check.out);
        // Starting takes a while, and says the same of each.
        if k % 3 != 1 {
            continue;
        }
        let server = place.start(&[]);
        assert!(server.log().contains("DATA_LOSS"), "{damage:?}: {}", server.log());
        server.stop().await;
        let server = place.start(&[]);
        assert!(server.log().contains("DATA_LOSS"), "at each start: {}", server.log());
        // What is committed from now on is as safe as ever.
        if server.call("GET", &super::path(&id, ""), None).await.0 == 200 {
            turn(&server, &id, 0.7).await;
        }
        server.stop().await;
        assert_eq!(place.store(&["check"]).code, 1);
        fs::remove_file(place.data().join(NOTE)).expect("a note");
        assert_eq!(place.store(&["check"]).code, 0, "the loss is accepted");
        let server = place.start(&[]);
        assert!(!server.log().contains("DATA_LOSS"), "{}", server.log());
        server.stop().await;
    }

    // As it was left, nothing is missing.
    left.put_back(&place);
    assert_eq!(place.store(&["check", "--replay"]).code, 0);
    assert_eq!(seen(&place.start(&[]), &id).await, before);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_loses_nothing_and_raises_no_alarm() {
    let place = StorePlace::folder().await.expect("a folder");
    let mut server = place.start(&[]);
    let id = bar_session(&server).await;
    for round in 1..4 {
        turn(&server, &id, f64::from(round) * 0.1).await;
        let before = seen(&server, &id).await;
        server.kill();
        // A note that a loss of power tore says nothing.
        if round == 2 {
            fs::write(place.data().join(NOTE), "pliant-newest-1 7").expect("written");
        }
        assert_eq!(place.store(&["check"]).code, 0);
        server = place.start(&[]);
        assert_eq!(seen(&server, &id).await, before);
        assert!(!server.log().contains("DATA_LOSS"), "{}", server.log());
    }
}

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
    for reply in ["id", "revision", "label", "model", "primitives"] {
        assert_eq!(session[reply], was["session"][reply], "{reply}");
    }
    // Handles of that time turn about the middle of their regions, none of them freely, and answers say so now.
    let mut handles = was["session"]["handles"].clone();
    for handle in handles.as_array_mut().expect("handles") {
        handle["pivot"] = handle["centroid"].clone();
        handle["foundTurn"] = json!([]);
        if let Some(pose) = handle.get_mut("pose") {
            pose["freeRotation"] = json!(false);
        }
    }
    assert_eq!(session["handles"], handles);
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
    // It goes on as it began: an edit, and a turn that names no pivot, are there after a restart.
    let finer = json!({"on": "REST", "subdivide": {"scheme": "MIDPOINT"}});
    server.done("POST", &path(id, "/edits"), Some(&finer)).await;
    turn(&server, id, 0.7).await;
    let before = seen_apart_from_memory(&server, id).await;
    server.kill();
    let server = ServedProgram::start(&folder, &["--max-ttl", "366d"]);
    assert_eq!(seen_apart_from_memory(&server, id).await, before);
}

/// What is kept of earlier states takes memory that a session which was just read does not take.
async fn seen_apart_from_memory(server: &ServedProgram, id: &str) -> (Value, Value, Vec<u8>) {
    let mut all = seen(server, id).await;
    all.0["solver"].as_object_mut().expect("facts").remove("bytes");
    all
}
