//! Sessions that no one uses leave memory and come back when they are asked for.

use super::{bar_at, bar_session, metric, out_of_memory, path, seen, turn};
use crate::durable::place::{StorePlace, in_every_store};
use crate::support::program::ServedProgram;
use crate::support::server::{AnsweredCall as _, bar, bar_obj, ends, eventually};
use serde_json::{Value, json};

in_every_store!(
    an_idle_session_leaves_memory_and_comes_back_as_it_was,
    a_stream_holds_its_session_and_calls_never_miss_it,
    idle_sessions_make_room_before_a_new_one_is_refused,
);

async fn an_idle_session_leaves_memory_and_comes_back_as_it_was(place: StorePlace) {
    let (server, id) = bar_at(&place, &["--idle", "200ms"]).await;
    for angle in [0.4, 0.8, 0.2] {
        turn(&server, &id, angle).await;
    }
    server.done("POST", &path(&id, "/undo"), None).await;
    let before = seen(&server, &id).await;
    for _ in 0..3 {
        eventually("an empty memory", async || {
            metric(&server, "pliant_sessions ").await == 0.0 && metric(&server, "pliant_session_bytes ").await == 0.0
        })
        .await;
        let listed = server.done("GET", "/v1/sessions", None).await;
        assert_eq!(listed["sessions"][0]["id"], id.as_str());
        assert_eq!(seen(&server, &id).await, before);
    }
    out_of_memory(&server).await;
    server.done("POST", &path(&id, "/redo"), None).await;
    out_of_memory(&server).await;
    server.done("DELETE", &path(&id, ""), None).await;
    assert_eq!(server.call("GET", &path(&id, ""), None).await.0, 404);
}

async fn a_stream_holds_its_session_and_calls_never_miss_it(place: StorePlace) {
    let server = place.start(&["--idle", "100ms"]);
    let held = bar_session(&server).await;
    let stream = server.socket(&path(&held, "/stream")).await;
    // Calls come just when the session is about to leave.
    let busy = bar_session(&server).await;
    for k in 0..20u64 {
        tokio::time::sleep(std::time::Duration::from_millis(85 + k * 2)).await;
        turn(&server, &busy, k as f64 * 0.02).await;
    }
    eventually("one session in memory", async || {
        metric(&server, "pliant_sessions ").await == 1.0
    })
    .await;
    drop(stream);
    eventually("none", async || metric(&server, "pliant_sessions ").await == 0.0).await;
    let history = server.done("GET", &path(&busy, "/history"), None).await;
    assert_eq!(history["commits"].as_array().map(Vec::len), Some(22));
}

async fn idle_sessions_make_room_before_a_new_one_is_refused(place: StorePlace) {
    let server = place.start(&["--sessions", "2"]);
    let mut known = Vec::new();
    for angle in [0.1, 0.2, 0.3, 0.4] {
        let id = bar_session(&server).await;
        turn(&server, &id, angle).await;
        let now = seen(&server, &id).await;
        known.push((id, now));
    }
    for (id, was) in &known {
        assert_eq!(&seen(&server, id).await, was);
    }
    assert_eq!(metric(&server, "pliant_sessions ").await, 2.0);
    assert_eq!(
        metric(&server, "pliant_refused_total ").await,
        0.0,
        "every call succeeded"
    );
    // Those that streams hold stay: then there is no room.
    let mut streams = Vec::new();
    for (id, _) in &known[..2] {
        streams.push(server.socket(&path(id, "/stream")).await);
    }
    assert_eq!(server.call("GET", &path(&known[3].0, ""), None).await.0, 429);
    assert_eq!(metric(&server, "pliant_refused_total ").await, 1.0);
    drop(streams);
    eventually("room", async || {
        server.call("GET", &path(&known[3].0, ""), None).await.0 == 200
    })
    .await;
}

in_every_store!(
    sessions_that_do_not_fit_together_come_back_in_any_order_and_under_other_limits,
    no_time_passes_for_a_session_while_no_server_runs,
);

/// All that a client can see of a session, but for times and for the limits of the server that is asked.
async fn seen_apart_from_limits(server: &ServedProgram, id: &str) -> (Value, Value, Vec<u8>) {
    let mut reply = super::seen(server, id).await;
    reply.0.as_object_mut().expect("an object").remove("limits");
    reply
}

/// A bar of 3,170 vertices, whose volume graph does not fit whole.
async fn dense_session(server: &ServedProgram) -> Result<String, Value> {
    let reply = server
        .post("/v1/sessions?volumeGraph.kind=PAPER")
        .body(bar([12, 12, 60]))
        .document()
        .await;
    let Some(id) = reply["id"].as_str() else {
        return Err(reply);
    };
    let handles = json!({"handles": ends()});
    server.done("PUT", &path(id, "/handles"), Some(&handles)).await;
    turn(server, id, 0.4).await;
    Ok(id.to_owned())
}

async fn sessions_that_do_not_fit_together_come_back_in_any_order_and_under_other_limits(place: StorePlace) {
    let tight = ["--memory-bytes", "14MiB", "--idle", "300ms"];
    let server = place.start(&tight);
    let mut known = Vec::new();
    for _ in 0..3 {
        let id = dense_session(&server).await.expect("idle ones make room");
        let now = seen_apart_from_limits(&server, &id).await;
        let warnings = now.0["warnings"].to_string();
        assert!(warnings.contains("volume-graph-coarse"), "{warnings}");
        known.push((id, now));
    }
    let digest = |now: &(Value, Value, Vec<u8>)| now.1["commits"][2]["digest"].clone();
    assert!(digest(&known[0].1).is_string(), "{}", known[0].1.1);
    for (_, now) in &known[1..] {
        assert_eq!(
            digest(now),
            digest(&known[0].1),
            "the same model, whatever else is open"
        );
        assert_eq!(now.2, known[0].1.2);
    }
    out_of_memory(&server).await;
    for (id, was) in known.iter().rev() {
        assert_eq!(&seen_apart_from_limits(&server, id).await, was);
        turn(&server, id, 0.4).await;
        let again = server.done("GET", &path(id, "/history"), None).await;
        assert_eq!(again["commits"][3]["digest"], again["commits"][2]["digest"], "{again}");
        server.done("POST", &path(id, "/undo"), None).await;
    }
    let mut after = Vec::new();
    for (id, _) in &known {
        after.push(seen_apart_from_limits(&server, id).await);
    }
    server.kill();
    for limits in [&tight[..], &["--memory-bytes", "1GiB"], &["--memory-bytes", "16MiB"]] {
        let server = place.start(limits);
        for ((id, _), was) in known.iter().zip(&after).rev() {
            assert_eq!(&seen_apart_from_limits(&server, id).await, was, "{limits:?}");
        }
        // What is opened now fits.
        if limits[1] == "1GiB" {
            let id = dense_session(&server).await.expect("there is room");
            let warnings = seen_apart_from_limits(&server, &id).await.0["warnings"].to_string();
            assert!(!warnings.contains("volume-graph-coarse"), "{warnings}");
            server.done("DELETE", &path(&id, ""), None).await;
        }
        server.kill();
    }
    let checked = place.store(&["check", "--replay"]);
    assert_eq!(checked.code, 0, "{} {}", checked.out, checked.err);
    // Less memory than the sessions need is reported as that, not as damage.
    let server = place.start(&["--memory-bytes", "2MiB"]);
    let (status, reply) = server.call("GET", &path(&known[0].0, ""), None).await;
    assert!(matches!(status, 413 | 429), "{status} {reply}");
    server.kill();
    let server = place.start(&tight);
    assert_eq!(&seen_apart_from_limits(&server, &known[0].0).await, &after[0]);
}

async fn no_time_passes_for_a_session_while_no_server_runs(place: StorePlace) {
    let (server, id) = bar_at(&place, &[]).await;
    let before = seen_apart_from_limits(&server, &id).await;
    server.kill();
    // As a backup of the year 2001 would be.
    place.tamper("UPDATE sessions SET used_ms = 1000000000000").await;
    assert!(place.store(&["prune"]).out.contains("0 sessions"));
    let output = place.top().join("old.obj");
    let exported = place.store(&["export", &id, output.to_str().expect("UTF-8")]);
    assert_eq!(exported.code, 0, "{}", exported.err);
    let server = place.start(&[]);
    // One whose time is over shows that the server has looked for such sessions.
    server.open(bar_obj(4), "?ttl=1s").await;
    eventually("an expiry", async || {
        metric(&server, "pliant_sessions_expired_total").await > 0.0
    })
    .await;
    assert_eq!(seen_apart_from_limits(&server, &id).await, before);
    let listed = server.done("GET", "/v1/sessions", None).await;
    assert_eq!(listed["sessions"][0]["id"], id.as_str());
}
