//! Memory and work that are refused before they are taken: handles, edits, and answers that no one reads.

use super::*;
use pliant::session::MemoryUse;
use std::time::Duration;

/// The bytes that sessions and answers hold now.
fn held(server: &Server) -> [i64; 2] {
    [MemoryUse::Sessions, MemoryUse::Answers].map(|what| server.manager.metrics().held_bytes(what).get())
}

#[tokio::test(flavor = "multi_thread")]
async fn soft_handles_that_reach_far_are_counted_before_they_are_held() {
    let (server, id) = Server::bar_with(|sessions, _| sessions.memory_bytes = 24 << 20).await;
    let before = held(&server);
    let soft = |k: usize| {
        json!({
            "id": format!("soft {k}"),
            "region": {"sphere": {"center": [0, 0, 0.004 * k as f64], "radius": 0.8}},
            "stiffness": 1.0,
            "falloff": {"radius": 100.0, "kind": "SMOOTH"}
        })
    };
    let path = format!("/v1/sessions/{id}/handles");
    let put = |count: usize| {
        let mut handles: Vec<Value> = (0..count).map(soft).collect();
        handles.extend(ends().as_array().cloned().unwrap_or_default());
        server.put(&path).json(&json!({ "handles": handles }))
    };
    let reply = put(900).refusal(413).await;
    assert!(
        text(&reply["detail"]).contains("the estimated memory of the session"),
        "{reply}"
    );
    let session = server.document(&format!("/v1/sessions/{id}")).await;
    assert_eq!(
        session["handles"].as_array().map(Vec::len),
        Some(2),
        "the old ones stay"
    );
    let solved = post(&server, &format!("/v1/sessions/{id}/solve"), turn_json(0.5)).await;
    assert_eq!(solved.status(), 200);
    assert!(
        held(&server)[0] < before[0] + (4 << 20),
        "{:?} and {before:?}",
        held(&server)
    );
    assert_eq!(put(20).status().await, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edit_that_would_grow_too_large_is_refused_by_its_estimate() {
    let (server, id) = Server::bar_with(|sessions, _| sessions.memory_bytes = 256 << 20).await;
    let path = format!("/v1/sessions/{id}/edits");
    // Some 4 million triangles.
    let edit = json!({"remesh": {"edgeLength": 0.004}});
    let reply = server.post(&path).json(&edit).refusal(413).await;
    assert!(
        text(&reply["detail"]).contains("the estimated memory of the session"),
        "{reply}"
    );
    let cycles = server.metric("pliant_commits_total").await;
    let fine = post(&server, &path, json!({"remesh": {"edgeLength": 0.2}})).await;
    assert_eq!(fine.status(), 200, "{}", fine.text().await.unwrap_or_default());
    assert_eq!(server.metric("pliant_commits_total").await, cycles + 1.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn answers_that_no_one_reads_are_counted_and_given_up() {
    let server = Server::with(|_, config| config.unread_deadline = Duration::from_millis(300)).await;
    let session = server.open(large_bar()).await;
    let id = text(&session["id"]);
    let lazy = reqwest::Client::builder()
        .http2_prior_knowledge()
        .http2_initial_stream_window_size(1024)
        .http2_initial_connection_window_size(1024)
        .build()
        .expect("a client");
    let path = server.url(&format!("/v1/sessions/{id}/positions"));
    let mut unread = Vec::new();
    for _ in 0..8 {
        unread.push(lazy.get(&path).answer().await);
    }
    let length = unread[0].content_length().expect("its length") as i64;
    let held_before = server.manager.metrics().held_bytes(MemoryUse::Answers).get();
    assert!(
        held_before == 0 || held_before % length == 0,
        "{held_before} of {length}"
    );
    eventually("they are given up", async || held(&server)[1] == 0).await;
    // What the others had been sent of the connection's window goes back with them.
    let first = unread.remove(0);
    drop(unread);
    let late = within("an end", first.bytes()).await;
    assert!(late.is_err(), "{} bytes came", late.map_or(0, |b| b.len()));
    let whole = get(&server, &format!("/v1/sessions/{id}/positions"))
        .await
        .bytes()
        .await;
    assert_eq!(whole.expect("all of it").len() as i64, length);
}

#[tokio::test(flavor = "multi_thread")]
async fn more_answers_than_there_is_memory_for_are_refused() {
    let server = Server::start().await;
    let session = server.open(large_bar()).await;
    let id = text(&session["id"]);
    let path = server.url(&format!("/v1/sessions/{id}/positions"));
    let length = http().head(&path).answer().await.content_length();
    let ledger = server.manager.ledger();
    let rest = ledger.total() - ledger.used();
    let taken = ledger
        .reserve(MemoryUse::Sessions, None, rest, rest)
        .expect("all that is left");
    let refused = http().get(&path).answer().await;
    assert_eq!(
        (
            refused.status().as_u16(),
            refused.headers()["retry-after"].to_str().ok()
        ),
        (429, Some("2"))
    );
    let reply: Value = refused.json().await.expect("a problem");
    assert_eq!(reply["code"], "RESOURCE_EXHAUSTED", "{reply} for {length:?} bytes");
    let mut client = server.grpc().await;
    let request = pliant::wire::pb::SessionRequest { session_id: id.clone() };
    within("a small answer", client.get_session(request))
        .await
        .expect("small answers go on");
    drop(taken);
    assert_eq!(http().get(&path).status().await, 200);
}

/// Handles that each pull at all of a model.
fn far_reaching(count: usize) -> Value {
    let handle = |k: usize| {
        json!({
            "id": format!("h{k}"),
            "region": {"vertices": {"ranges": [{"first": 3 * k, "count": 3}]}},
            "stiffness": 1.0,
            "falloff": {"radius": 100.0, "kind": "SMOOTH"}
        })
    };
    json!({"handles": (0..count).map(handle).collect::<Vec<Value>>()})
}

#[tokio::test(flavor = "multi_thread")]
async fn refused_handles_leave_the_old_ones_and_all_memory_to_others() {
    let server = Server::with(|sessions, _| sessions.memory_bytes = 32 << 20).await;
    let id = server.open(bar([6, 6, 60])).await;
    let id = text(&id["id"]);
    let put = async |count: usize| {
        let path = server.url(&format!("/v1/sessions/{id}/handles"));
        http().put(path).json(&far_reaching(count)).answer().await
    };
    let (mut taken, mut refused) = (0, 0);
    for count in (80..=480).step_by(80) {
        assert_eq!(put(10).await.status(), 200);
        let before = held(&server)[0];
        let answer = put(count).await;
        if answer.status() == 200 {
            taken = count;
            continue;
        }
        refused += 1;
        assert!(matches!(answer.status().as_u16(), 413 | 429), "{}", answer.status());
        assert!(held(&server)[0] <= before, "{count} handles left something behind");
        assert_eq!(get(&server, "/readyz").await.status(), 200);
        let other = server.bar_session().await;
        let gone = server.delete(&format!("/v1/sessions/{other}")).send().await;
        assert_eq!(gone.expect("an answer").status(), 204);
        let pose = json!({"pose": {"handles": [{"id": "h9", "pose": {"translation": [0, 0.1, 0]}}]}});
        let solved = post(&server, &format!("/v1/sessions/{id}/solve"), pose).await;
        assert_eq!(solved.status(), 200, "{}", solved.text().await.unwrap_or_default());
    }
    assert!(taken > 0 && refused > 0, "{taken} were taken, {refused} refused");
    // What fits alone is taken whatever handles are in force: where it does not fit beside them, these are dropped first.
    for _ in 0..2 {
        assert_eq!(put(taken).await.status(), 200);
    }
}
