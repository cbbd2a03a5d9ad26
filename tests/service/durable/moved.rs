//! A data folder that is taken away under a server, or locked by somebody else: no change is acknowledged that nobody would find again.

use super::{bar_session, path, seen, turn};
use crate::durable::place::StorePlace;
use crate::support::program::ServedProgram;
use crate::support::server::{AnsweredCall as _, bar_obj, eventually, turn_json};
use serde_json::Value;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;

async fn ready(server: &ServedProgram) -> (u16, Value) {
    server.call("GET", "/readyz", None).await
}

/// What would change something is refused with words that any client may read.
async fn refuses_changes(server: &ServedProgram, id: &str, place: &StorePlace) {
    let soft = serde_json::json!({"stiffness": 2.0});
    for (method, rest, body) in [
        ("POST", "/solve", Some(turn_json(0.9))),
        ("POST", "/undo", None),
        ("PATCH", "/handles/top", Some(soft)),
        ("DELETE", "", None),
    ] {
        let (status, told) = server.call(method, &path(id, rest), body.as_ref()).await;
        let told_text = told.to_string();
        assert_eq!(
            (status, &told["code"]),
            (503, &"UNAVAILABLE".into()),
            "{method} {rest}: {told}"
        );
        let folder = place.top().display().to_string();
        for secret in [&*folder, "sqlite", "os error", "data"] {
            assert!(!told_text.contains(secret), "{told}");
        }
    }
    let created = server.post("/v1/sessions").body(bar_obj(7)).answer().await;
    assert_eq!(created.status(), 503);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_that_was_moved_away_takes_no_changes_until_it_is_back() {
    let place = StorePlace::folder().await.expect("a folder");
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    turn(&server, &id, 0.4).await;
    let before = seen(&server, &id).await;
    assert_eq!(ready(&server).await.0, 200);
    let away = place.top().join("away");
    for replaced in [false, true] {
        fs::rename(place.data(), &away).expect("moved");
        if replaced {
            fs::create_dir(place.data()).expect("another folder");
        }
        eventually("not ready", async || ready(&server).await.0 == 503).await;
        refuses_changes(&server, &id, &place).await;
        let text = ready(&server).await.1["detail"].to_string();
        assert!(text.contains("cannot be written"), "{text}");
        assert!(
            server.log().contains(&place.data().display().to_string()),
            "the log tells which"
        );
        if replaced {
            assert_eq!(
                fs::read_dir(place.data()).expect("a folder").count(),
                0,
                "nothing is written there"
            );
            fs::remove_dir(place.data()).expect("empty");
        }
        fs::rename(&away, place.data()).expect("moved back");
        eventually("ready", async || ready(&server).await.0 == 200).await;
        assert_eq!(seen(&server, &id).await, before);
    }
    turn(&server, &id, 0.9).await;
    let after = seen(&server, &id).await;
    server.kill();
    assert_eq!(seen(&place.start(&[]), &id).await, after);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_left_memory_is_not_damaged_because_its_folder_is_away() {
    let place = StorePlace::folder().await.expect("a folder");
    let server = place.start(&["--idle", "200ms"]);
    let id = bar_session(&server).await;
    turn(&server, &id, 0.4).await;
    let before = seen(&server, &id).await;
    eventually("out of memory", async || {
        super::metric(&server, "pliant_sessions ").await == 0.0
    })
    .await;
    let away = place.top().join("away");
    fs::rename(place.data(), &away).expect("moved");
    for (method, rest) in [("GET", "/positions"), ("GET", ""), ("POST", "/undo")] {
        let (status, told) = server.call(method, &path(&id, rest), None).await;
        assert_eq!((status, &told["code"]), (503, &"UNAVAILABLE".into()), "{rest}: {told}");
    }
    assert_eq!(ready(&server).await.0, 503);
    fs::rename(&away, place.data()).expect("moved back");
    assert_eq!(seen(&server, &id).await, before);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_stays_with_its_server_when_the_lock_file_is_gone() {
    let place = StorePlace::folder().await.expect("a folder");
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    fs::remove_file(place.data().join("lock")).expect("a lock file");
    let refused = place.try_start(&[]).err().expect("refused");
    let last = refused.lines().last().unwrap_or_default();
    assert!(last.contains("in use by another process"), "{refused}");
    assert_eq!(place.store(&["prune"]).code, 2);
    turn(&server, &id, 0.4).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_kept_is_for_its_owner_alone() {
    let place = StorePlace::folder().await.expect("a folder");
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    for k in 0..17 {
        turn(&server, &id, f64::from(k) * 0.05).await;
    }
    let mut waiting = vec![place.data()];
    let mut files = 0;
    while let Some(path) = waiting.pop() {
        let Ok(facts) = fs::metadata(&path) else { continue };
        let mode = facts.permissions().mode() & 0o777;
        let private = if facts.is_dir() { 0o700 } else { 0o600 };
        assert_eq!(mode, private, "{} {mode:o}", path.display());
        files += 1;
        if facts.is_dir() {
            waiting.extend(fs::read_dir(&path).expect("readable").flatten().map(|e| e.path()));
        }
    }
    assert!(files > 8, "{files}");
}
