//! What each tenant may use, and what the server reports of it.

use super::{ConfiguredPlace, config_file, entry};
use crate::support::program::ServedProgram;
use crate::support::server::*;
use pliant::session::TenantQuota;
use pliant::wire::pb;
use serde_json::{Value, json};
use std::time::Duration;
use tokio_tungstenite::tungstenite;

/// A server where tenant `a` has a quota and `b` none.
async fn limited(limit: impl FnOnce(&mut TenantQuota)) -> Server {
    let mut quota = TenantQuota::default();
    limit(&mut quota);
    Server::with(|sessions, config| {
        sessions.quotas.named.insert("a".into(), quota);
        config.auth.tokens = vec![entry("a", "a"), entry("b", "b")];
    })
    .await
}

/// Status, seconds of `Retry-After`, and the document.
async fn answer(request: reqwest::RequestBuilder, token: &str) -> (u16, Option<u64>, Value) {
    let answer = request.bearer_auth(token).answer().await;
    let wait = answer
        .headers()
        .get("retry-after")
        .map(|v| v.to_str().expect("ASCII").parse().expect("seconds"));
    let status = answer.status().as_u16();
    let body = answer.bytes().await.expect("a body");
    (status, wait, serde_json::from_slice(&body).unwrap_or_default())
}

async fn open(server: &Server, token: &str, along: usize) -> (u16, Option<u64>, Value) {
    answer(server.post("/v1/sessions").body(bar_obj(along)), token).await
}

async fn quotas(server: &Server, token: &str) -> Value {
    answer(server.get("/v1/limits"), token).await.2["quotas"].clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_are_counted_by_tenant_and_come_free_when_the_server_said() {
    let server = limited(|quota| quota.sessions = Some(1)).await;
    assert_eq!(
        quotas(&server, "a").await,
        json!({"sessions": {"allowed": 1.0, "left": 1.0}})
    );
    assert_eq!(quotas(&server, "b").await, Value::Null);
    let limits = with_token(pb::GetLimitsRequest::default(), "a");
    let limits = within("limits", server.grpc().await.get_limits(limits)).await;
    let reply = limits.expect("limits").into_inner().quotas.expect("quotas");
    assert_eq!(reply.sessions.map(|s| (s.allowed, s.left)), Some((1.0, 1.0)));
    let short = server.post("/v1/sessions?ttl=2s").body(bar_obj(4));
    let (status, _, _) = answer(short, "a").await;
    assert_eq!(status, 201);
    assert_eq!(quotas(&server, "a").await["sessions"]["left"], 0.0);
    let (status, wait, reply) = open(&server, "a", 4).await;
    assert_eq!(status, 429);
    assert!(text(&reply["detail"]).contains("your quota"), "{reply}");
    assert_eq!(open(&server, "b", 4).await.0, 201);
    let wait = wait.expect("a time");
    assert!((1..=3).contains(&wait), "{wait} s");
    eventually("its place", async || open(&server, "a", 4).await.0 == 201).await;
    assert_eq!(open(&server, "a", 4).await.0, 429);
}

#[tokio::test(flavor = "multi_thread")]
async fn memory_is_counted_by_tenant() {
    let server = limited(|quota| quota.memory_bytes = Some(3 << 20)).await;
    let mut opened = Vec::new();
    let refused = loop {
        match open(&server, "a", 24).await {
            (201, _, session) => opened.push(text(&session["id"])),
            refused => break refused,
        }
        assert!(opened.len() < 100);
    };
    assert!(!opened.is_empty());
    assert_eq!(refused.0, 429, "{}", refused.2);
    assert!(refused.1.is_some());
    let reply = quotas(&server, "a").await["memoryBytes"].clone();
    assert!(
        reply["allowed"] == f64::from(3 << 20) && reply["left"].as_f64() < Some(f64::from(3 << 20)),
        "{reply}"
    );
    // A file is refused while it is read, where there is no memory for it.
    let (status, _, reply) = open(&server, "a", 4000).await;
    assert!(
        status == 429 && text(&reply["detail"]).contains("your quota of memory is full"),
        "{reply}"
    );
    for id in opened {
        let gone = server.delete(&format!("/v1/sessions/{id}"));
        assert_eq!(answer(gone, "a").await.0, 204);
    }
    // A model that alone is too large will not fit later either.
    eventually("an empty quota", async || {
        let memory = quotas(&server, "a").await["memoryBytes"].clone();
        memory["left"] == memory["allowed"]
    })
    .await;
    let (status, wait, reply) = open(&server, "a", 4000).await;
    assert_eq!((status, wait), (413, None), "{reply}");
    assert_eq!(open(&server, "b", 24).await.0, 201);
}

#[tokio::test(flavor = "multi_thread")]
async fn uploads_are_counted_by_the_minute() {
    let bytes = bar_obj(8).len() as u64;
    // Two fit, and of a third what comes in some seconds.
    let server = limited(|quota| quota.upload_bytes_per_minute = Some(bytes * 2 + bytes / 2)).await;
    assert_eq!(open(&server, "a", 8).await.0, 201);
    assert_eq!(open(&server, "a", 8).await.0, 201);
    assert_eq!(server.manager.metrics().refused.get(), 0);
    let (status, wait, reply) = open(&server, "a", 8).await;
    assert_eq!(status, 429, "{reply}");
    assert_eq!(server.manager.metrics().refused.get(), 1, "whoever watches is told");
    assert!((1..=60).contains(&wait.expect("a time")), "{wait:?}");
    let left = quotas(&server, "a").await["uploadBytesPerMinute"]["left"]
        .as_f64()
        .expect("a number");
    assert!(left < bytes as f64, "{left} of {bytes}");
    // Larger than what a minute brings.
    assert_eq!(open(&server, "a", 200).await.0, 413);
    assert_eq!(open(&server, "b", 8).await.0, 201);
    let chunks = futures::stream::iter(
        bar_obj(8)
            .into_bytes()
            .chunks(1000)
            .map(|c| Ok::<_, std::io::Error>(c.to_vec()))
            .collect::<Vec<_>>(),
    );
    let unannounced = server
        .post("/v1/sessions?format=obj")
        .body(reqwest::Body::wrap_stream(chunks));
    assert_eq!(answer(unannounced, "a").await.0, 429);
    assert_eq!(
        server.manager.metrics().refused.get(),
        2,
        "too large is not a lack of capacity"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn computing_is_counted_by_the_minute() {
    let server = limited(|quota| quota.solve_seconds_per_minute = Some(1e-6)).await;
    // The first piece of work begins: no one knows before how long it takes.
    let (status, _, session) = open(&server, "a", 8).await;
    assert_eq!(status, 201);
    let handles = format!("/v1/sessions/{}/handles", text(&session["id"]));
    let set = || server.put(&handles).json(&json!({"handles": ends()}));
    let (status, wait, reply) = answer(set(), "a").await;
    assert_eq!(status, 429, "{reply}");
    assert!(text(&reply["detail"]).contains("seconds of computing"), "{reply}");
    assert_eq!(server.manager.metrics().refused.get(), 1, "whoever watches is told");
    assert!(wait > Some(60), "{wait:?}");
    assert_eq!(quotas(&server, "a").await["solveSecondsPerMinute"]["left"], 0.0);
    // What computes nothing goes on.
    let (status, ..) = answer(server.get("/v1/sessions"), "a").await;
    assert_eq!(status, 200);
    assert_eq!(open(&server, "b", 8).await.0, 201);
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_are_counted_by_tenant() {
    let server = limited(|quota| quota.streams = Some(1)).await;
    let ids = [open(&server, "a", 8).await.2, open(&server, "a", 8).await.2].map(|s| text(&s["id"]));
    let connect = async |id: &str| {
        let url = format!("ws://{}/v1/sessions/{id}/stream", server.address);
        match Socket::connect_with(&url, "authorization", "Bearer a").await {
            Ok(socket) => Ok(socket),
            Err(tungstenite::Error::Http(refused)) => Err(refused.status().as_u16()),
            Err(other) => panic!("{other}"),
        }
    };
    let first = connect(&ids[0]).await.expect("a stream");
    assert_eq!(connect(&ids[1]).await.err(), Some(429));
    assert_eq!(
        quotas(&server, "a").await["streams"],
        json!({"allowed": 1.0, "left": 0.0})
    );
    drop(first);
    eventually("its place", async || connect(&ids[1]).await.is_ok()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_stored_is_counted_and_given_back() {
    let bytes = bar_obj(8).len() as u64;
    let place = ConfiguredPlace::new(&format!("[quotas]\nstored_bytes = {}\n", bytes * 3));
    let server = place.start();
    let left = async || {
        let quotas = server.done("GET", "/v1/limits", None).await["quotas"]["storedBytes"].clone();
        quotas["left"].as_f64().expect("a number")
    };
    assert_eq!(left().await, (bytes * 3) as f64);
    let first = server.open(bar_obj(8), "").await;
    let after_one = left().await;
    assert!(after_one < (bytes * 2) as f64, "{after_one} of {bytes}");
    // A commit costs something too.
    let path = |id: &str, rest: &str| format!("/v1/sessions/{id}{rest}");
    let handles = json!({"handles": ends()});
    server.done("PUT", &path(&first, "/handles"), Some(&handles)).await;
    let after_handles = left().await;
    assert!(after_handles < after_one);
    let second = server.open(bar_obj(8), "").await;
    let refused = server.post("/v1/sessions").body(bar_obj(8));
    let (status, wait, reply) = answer(refused, "").await;
    assert_eq!(status, 429, "{reply}");
    assert!(text(&reply["detail"]).contains("in the store"), "{reply}");
    assert!(wait.is_some());
    let refused = server.post("/v1/sessions").body(bar_obj(80));
    assert_eq!(answer(refused, "").await.0, 413);
    // As it was, after another start too.
    let before = left().await;
    server.kill();
    let server = place.start();
    let left = async || {
        let quotas = server.done("GET", "/v1/limits", None).await["quotas"]["storedBytes"].clone();
        quotas["left"].as_f64().expect("a number")
    };
    assert_eq!(left().await, before);
    for id in [&first, &second] {
        server.done("DELETE", &path(id, ""), None).await;
    }
    assert_eq!(left().await, (bytes * 3) as f64);
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_that_are_opened_at_once_pass_no_quota_of_the_store() {
    let bytes = bar_obj(8).len() as u64;
    let most = bytes * 7 / 2;
    let place = ConfiguredPlace::new(&format!("[quotas]\nstored_bytes = {most}\n"));
    let server = place.start();
    let mut opened = 0;
    for _ in 0..3 {
        let calls = (0..12).map(|_| {
            let call = server.post("/v1/sessions").body(bar_obj(8));
            async move { answer(call, "").await.0 }
        });
        let reply = futures::future::join_all(calls).await;
        assert!(reply.iter().all(|status| [201, 429].contains(status)), "{reply:?}");
        opened += reply.iter().filter(|status| **status == 201).count();
    }
    // Each is its model and some words; what was refused takes no room for good.
    assert_eq!(opened, 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn commits_are_refused_where_no_more_may_be_stored_and_reading_goes_on() {
    let bytes = bar_obj(8).len() as u64;
    let place = ConfiguredPlace::new(&format!("[quotas]\nstored_bytes = {}\n", bytes + 20_000));
    let server = place.start();
    let id = server.open(bar_obj(8), "").await;
    let path = |rest: &str| format!("/v1/sessions/{id}{rest}");
    let handles = json!({"handles": ends()});
    let mut set = 0;
    let reply = loop {
        match server.call("PUT", &path("/handles"), Some(&handles)).await {
            (200, _) => set += 1,
            (429, reply) => break reply,
            other => panic!("{other:?}"),
        }
        assert!(set < 10_000);
    };
    assert!(
        set >= 1 && text(&reply["detail"]).contains("in the store"),
        "{set} {reply}"
    );
    let session = server.done("GET", &path(""), None).await;
    assert_eq!(session["revision"], (set + 1).to_string());
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_that_left_memory_are_counted_and_come_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let config = config_file(folder.path(), "[quotas]\nsessions = 2\n");
    let arguments = ["--config", &config, "--idle", "100ms"];
    let server = ServedProgram::start(&data, &arguments);
    let ids = [server.open(bar_obj(8), "").await, server.open(bar_obj(8), "").await];
    let none_in_memory = async |server: &ServedProgram| {
        eventually("an empty memory", async || {
            let text = server.get("/metrics").answer().await;
            text.text().await.expect("a text").contains("\npliant_sessions 0\n")
        })
        .await;
    };
    none_in_memory(&server).await;
    let open = async |server: &ServedProgram| answer(server.post("/v1/sessions").body(bar_obj(8)), "").await.0;
    assert_eq!(open(&server).await, 429);
    // Both are the tenant's already: its quota does not keep them away.
    for id in &ids {
        server.done("GET", &format!("/v1/sessions/{id}"), None).await;
    }
    server.kill();
    let server = ServedProgram::start(&data, &arguments);
    assert_eq!(open(&server).await, 429);
    // Deleted while it is in the store alone, and while it is in memory.
    server.done("DELETE", &format!("/v1/sessions/{}", ids[0]), None).await;
    server.done("GET", &format!("/v1/sessions/{}", ids[1]), None).await;
    assert_eq!(open(&server).await, 201);
    assert_eq!(open(&server).await, 429);
    server.done("DELETE", &format!("/v1/sessions/{}", ids[1]), None).await;
    assert_eq!(open(&server).await, 201);
    assert_eq!(open(&server).await, 429);
    // Time ends for one in the store alone.
    none_in_memory(&server).await;
    let left = async || server.done("GET", "/v1/limits", None).await["quotas"]["sessions"]["left"].clone();
    assert_eq!(left().await, 0.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_tenants_own_idle_sessions_make_room_in_its_quota_of_memory() {
    let place = ConfiguredPlace::new("[quotas]\nmemory_bytes = \"3MiB\"\n");
    let server = place.start();
    let mut ids = Vec::new();
    let in_memory = async || {
        let metrics = server.get("/metrics").send().await;
        let metrics = metrics.expect("an answer").text().await.expect("a text");
        let sessions = metrics.lines().find_map(|l| l.strip_prefix("pliant_sessions "));
        sessions.expect("a count").parse::<usize>().expect("a number")
    };
    while in_memory().await == ids.len() {
        ids.push(server.open(bar_obj(24), "").await);
        assert!(ids.len() < 100);
    }
    for _ in 0..ids.len() {
        ids.push(server.open(bar_obj(24), "").await);
    }
    for id in &ids {
        server.done("GET", &format!("/v1/sessions/{id}"), None).await;
        let limits = server.done("GET", "/v1/limits", None).await;
        let memory = &limits["quotas"]["memoryBytes"];
        let left = memory["left"].as_f64().expect("a number");
        assert!((0.0..3e6).contains(&left), "{memory}");
    }
    assert!((1..ids.len()).contains(&in_memory().await));
}

#[tokio::test(flavor = "multi_thread")]
async fn times_to_live_are_the_tenants_own() {
    let server = limited(|quota| {
        quota.ttl = Some(Duration::from_secs(1));
        quota.max_ttl = Some(Duration::from_secs(5));
    })
    .await;
    let limits = async |token| answer(server.get("/v1/limits"), token).await.2;
    assert_eq!(limits("a").await["ttlSeconds"], 5.0);
    assert_eq!(limits("a").await["quotas"], Value::Null);
    assert!(limits("b").await["ttlSeconds"].as_f64() > Some(5.0));
    let open = async |token, query| answer(server.post(&format!("/v1/sessions{query}")).body(bar_obj(4)), token).await;
    let (status, _, reply) = open("a", "?ttl=6s").await;
    assert_eq!(status, 422, "{reply}");
    assert_eq!(open("b", "?ttl=6s").await.0, 201);
    assert_eq!(open("a", "?ttl=5s").await.0, 201);
    let short = text(&open("a", "").await.2["id"]);
    let gone = server.url(&format!("/v1/sessions/{short}"));
    // Asking for it would renew it.
    eventually("its end", async || server.manager.metrics().sessions_expired.get() > 0).await;
    assert_eq!(answer(http().get(&gone), "a").await.0, 404);
}

/// Answers that one tenant asks for and does not read fill its own quota.
#[tokio::test(flavor = "multi_thread")]
async fn unread_answers_are_charged_to_who_asked() {
    let server = Server::with(|sessions, config| {
        sessions.memory_bytes = 400 << 20;
        let quota = TenantQuota {
            memory_bytes: Some(256 << 20),
            ..TenantQuota::default()
        };
        sessions.quotas.named.insert("a".into(), quota);
        config.auth.tokens = vec![entry("a", "a"), entry("b", "b")];
    })
    .await;
    let (status, _, session) = answer(server.post("/v1/sessions").body(large_bar()), "a").await;
    assert_eq!(status, 201, "{session}");
    let path = server.url(&format!("/v1/sessions/{}/positions", text(&session["id"])));
    let lazy = || {
        reqwest::Client::builder()
            .http2_prior_knowledge()
            .http2_initial_stream_window_size(1024)
            .http2_initial_connection_window_size(1024)
            .build()
            .expect("a client")
    };
    let (mut client, mut unread) = (lazy(), Vec::new());
    let refused = loop {
        // A connection has so many calls at a time.
        if unread.len() % 60 == 59 {
            client = lazy();
        }
        let answer = client.get(&path).bearer_auth("a").answer().await;
        if answer.status() != 200 {
            break answer;
        }
        unread.push(answer);
        assert!(unread.len() < 2000, "they are never too many");
    };
    assert_eq!(refused.status(), 429);
    let left = quotas(&server, "a").await["memoryBytes"]["left"].as_f64();
    assert!(left < Some(2e6), "{left:?}");
    assert_eq!(open(&server, "b", 24).await.0, 201);
    let ready = within("ready", server.get("/readyz").send()).await;
    assert_eq!(ready.expect("an answer").status(), 200);
    drop(unread);
}
