//! A server that is started again goes on where the one before was.

use super::{bar_session, metric, path, seen, turn};
use crate::durable::place::{StorePlace, in_every_store};
use crate::support::program::ServedProgram;
use crate::support::server::{bar_obj, turn_json};
use serde_json::{Value, json};

fn cut() -> Value {
    json!({"cut": {"plane": {"normal": [0, 1, 1], "offset": 2.01}, "keep": "BOTH", "fill": true}})
}

/// The digests that undo leads to, one after the other, from now on.
async fn digests_back(server: &ServedProgram, id: &str) -> Vec<(Value, Vec<u8>)> {
    let mut found = Vec::new();
    while server.call("POST", &path(id, "/undo"), None).await.0 == 200 {
        let history = server.done("GET", &path(id, "/history"), None).await;
        found.push((history["current"].clone(), server.positions(id).await));
    }
    found
}

in_every_store!(
    everything_is_as_it_was_after_a_crash,
    a_key_is_answered_again_after_a_crash_and_nothing_is_done_twice,
    a_session_that_was_deleted_or_has_expired_does_not_come_back,
    two_servers_do_not_share_a_store,
);

async fn everything_is_as_it_was_after_a_crash(place: StorePlace) {
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    turn(&server, &id, 0.4).await;
    turn(&server, &id, 0.8).await;
    server.done("POST", &path(&id, "/edits"), Some(&cut())).await;
    let merge = json!({"merge": {"model": base64(&bar_obj(6)), "how": "LOOSE",
        "transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, 5,0,0,1]}});
    server.done("POST", &path(&id, "/edits"), Some(&merge)).await;
    turn(&server, &id, 0.3).await;
    let rigid = json!({"rigid": true});
    server.done("PATCH", &path(&id, "/handles/top"), Some(&rigid)).await;
    turn(&server, &id, -0.5).await;
    server.done("POST", &path(&id, "/undo"), None).await;
    server.done("POST", &path(&id, "/undo"), None).await;
    server.done("POST", &path(&id, "/redo"), None).await;
    let before = seen(&server, &id).await;
    server.kill();

    let server = place.start(&[]);
    let listed = server.done("GET", "/v1/sessions", None).await;
    assert_eq!(listed["sessions"][0]["revision"], before.0["revision"]);
    assert_eq!(listed["sessions"][0]["handles"], before.0["handles"]);
    assert_eq!(metric(&server, "pliant_sessions ").await, 0.0, "listing opens nothing");
    let after = seen(&server, &id).await;
    assert_eq!(after.0, before.0);
    assert_eq!(after.1, before.1);
    assert!(after.2 == before.2, "the vertices are the same to the bit");

    // The way back is the same on a server that was never stopped, to the bit, and so is the way on.
    let redone = server.done("POST", &path(&id, "/redo"), None).await;
    let back = digests_back(&server, &id).await;
    assert_eq!(back.len(), 8, "{redone}");
    server.kill();
    let again = place.start(&[]);
    let history = again.done("GET", &path(&id, "/history"), None).await;
    assert_eq!(history["commits"], before.1["commits"], "undone, not gone");
    for _ in 0..8 {
        again.done("POST", &path(&id, "/redo"), None).await;
    }
    assert_eq!(
        again.call("POST", &path(&id, "/redo"), None).await.0,
        409,
        "nothing is left"
    );
    let same = digests_back(&again, &id).await;
    assert_eq!(same.len(), back.len());
    assert!(same.iter().map(|s| &s.1).eq(back.iter().map(|b| &b.1)));
    again.done("POST", &path(&id, "/redo"), None).await;
    turn(&again, &id, 0.2).await;
}

async fn a_key_is_answered_again_after_a_crash_and_nothing_is_done_twice(place: StorePlace) {
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    let calls = [
        ("POST", "/solve", Some(turn_json(0.7)), "pose"),
        ("PATCH", "/handles/top", Some(json!({"stiffness": 3.0})), "handle"),
        ("POST", "/edits", Some(cut()), "edit"),
        ("POST", "/undo", None, "undo"),
        ("POST", "/solve", Some(turn_json(0.1)), "another pose"),
    ];
    let calls = calls.map(|(method, rest, body, key)| (method, rest, body, key.replace(' ', "-")));
    let mut answers = Vec::new();
    for (method, rest, body, key) in &calls {
        let (status, answer) = server
            .call_with_key(method, &path(&id, rest), body.as_ref(), Some(key))
            .await;
        assert_eq!(status, 200, "{key}: {answer}");
        answers.push(answer);
    }
    let before = seen(&server, &id).await;
    server.kill();

    let server = place.start(&[]);
    for ((method, rest, body, key), was) in calls.iter().zip(&answers) {
        let (status, now) = server
            .call_with_key(method, &path(&id, rest), body.as_ref(), Some(key))
            .await;
        assert_eq!(status, 200, "{key}: {now}\n{}", server.log());
        assert_eq!(without_times(&now), without_times(was), "{key}");
    }
    assert_eq!(seen(&server, &id).await, before, "nothing was done again");
    let (status, refused) = server
        .call_with_key("POST", &path(&id, "/solve"), Some(&turn_json(0.9)), Some("pose"))
        .await;
    assert_eq!(status, 422, "another request: {refused}");
}

async fn a_session_that_was_deleted_or_has_expired_does_not_come_back(place: StorePlace) {
    let server = place.start(&[]);
    let deleted = bar_session(&server).await;
    let kept = bar_session(&server).await;
    let expiring = server.open(bar_obj(8), "?ttl=1s").await;
    server.done("DELETE", &path(&deleted, ""), None).await;
    server.kill();
    let server = place.start(&[]);
    crate::support::server::eventually("the expiry", async || {
        let listed = server.done("GET", "/v1/sessions", None).await;
        listed["sessions"]
            .as_array()
            .is_some_and(|l| l.len() == 1 && l[0]["id"] == kept.as_str())
    })
    .await;
    for gone in [&deleted, &expiring] {
        assert_eq!(server.call("GET", &path(gone, ""), None).await.0, 404);
    }
    server.done("DELETE", &path(&kept, ""), None).await;
    assert_eq!(server.call("GET", &path(&kept, ""), None).await.0, 404);
    assert_eq!(
        place.objects(),
        Vec::<std::path::PathBuf>::new(),
        "nobody uses an object any more"
    );
}

async fn two_servers_do_not_share_a_store(place: StorePlace) {
    let _server = place.start(&[]);
    let told = place.try_start(&[]).err().expect("refused");
    let last = told.lines().last().unwrap_or_default();
    assert!(last.contains("in use by another process"), "{told}");
}

/// An answer without what tells how long it took, or when it is over.
fn without_times(value: &Value) -> Value {
    match value {
        Value::Object(fields) => {
            let kept = fields
                .iter()
                .filter(|(name, _)| !matches!(name.as_str(), "ms" | "buildMs" | "solveMs" | "queueMs" | "expiresAt"));
            kept.map(|(name, value)| (name.clone(), without_times(value))).collect()
        }
        Value::Array(list) => list.iter().map(without_times).collect(),
        other => other.clone(),
    }
}

fn base64(text: &str) -> String {
    use base64::Engine as _;
    base64::engine::general_purpose::STANDARD.encode(text)
}
