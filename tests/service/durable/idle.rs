//! Sessions that nobody uses leave memory and come back when they are asked for.

use super::{bar_session, metric, path, seen, turn};
use crate::durable::place::{StorePlace, in_every_store};
use crate::support::server::eventually;

in_every_store!(
    an_idle_session_leaves_memory_and_comes_back_as_it_was,
    a_stream_holds_its_session_and_calls_never_miss_it,
    idle_sessions_make_room_before_a_new_one_is_refused,
);

async fn an_idle_session_leaves_memory_and_comes_back_as_it_was(place: StorePlace) {
    let server = place.start(&["--idle", "200ms"]);
    let id = bar_session(&server).await;
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
    eventually("an empty memory", async || {
        metric(&server, "pliant_sessions ").await == 0.0
    })
    .await;
    server.done("POST", &path(&id, "/redo"), None).await;
    eventually("an empty memory", async || {
        metric(&server, "pliant_sessions ").await == 0.0
    })
    .await;
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
