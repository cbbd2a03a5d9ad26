//! The database away for a while: what is in memory goes on, what changes something is refused, and everything recovers by itself.
//!
//! It is away for two leases; with `PLIANT_FAULTS`, as in the long run of the clients' test, for ten seconds.

use super::{LEASE, answered, drag, node_at, stream};
use crate::durable::place::StorePlace;
use crate::durable::{bar_session, path, seen, turn};
use crate::support::bucket::TestBucket;
use crate::support::postgres::PostgresServer;
use crate::support::postgres_proxy::PostgresProxy;
use crate::support::program::ServedProgram;
use crate::support::server::{Socket, eventually, pace, retried, turn_json, turned};
use std::time::{Duration, Instant};

/// How long the database is away.
fn away() -> Duration {
    match std::env::var_os("PLIANT_FAULTS") {
        Some(_) => Duration::from_secs(10),
        None => LEASE * 2,
    }
}

/// Drags for as long as the database is away, and at least twenty poses.
async fn drag_meanwhile(dragged: &mut Socket) {
    let since = Instant::now();
    let mut seq = 0;
    let mut ticks = pace(Duration::from_millis(20));
    while since.elapsed() < away() || seq < 20 {
        seq += 1;
        let pose = turned(seq, 0.01 * (seq % 50) as f64, false);
        drag(dragged, pose).await.expect("a frame");
        ticks.tick().await;
    }
}

/// Each session takes commits again where it was, and has this many.
async fn goes_on(nodes: [(&ServedProgram, &str); 2], commits: [usize; 2]) {
    for ((node, id), had) in nodes.into_iter().zip(commits) {
        eventually("a commit is taken again", async || {
            node.call("POST", &path(id, "/solve"), Some(&turn_json(0.5))).await.0 == 200
        })
        .await;
        // Each is where it was: nobody asked for it elsewhere.
        assert_eq!(answered(node, &path(id, "")).await, 200);
        let history = node.done("GET", &path(id, "/history"), None).await;
        let commits = history["commits"].as_array().map(Vec::len);
        assert_eq!(commits, Some(had + 1), "{history}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn nodes_outlive_a_database_that_is_away_for_longer_than_their_leases() {
    let Some(server) = PostgresServer::start() else { return };
    let place = StorePlace::in_database_and(server.database().await, TestBucket::serve().await);
    let url = place.database().map(|d| d.url.clone());
    let (a, b) = (node_at(&place, "a", url.clone()), node_at(&place, "b", url));
    let (one, other) = (bar_session(&a).await, bar_session(&b).await);
    turn(&a, &one, 0.3).await;
    turn(&b, &other, 0.4).await;
    let before = (seen(&a, &one).await, seen(&b, &other).await);
    let mut dragged = stream(&a, &one).await;
    server.crash();
    drag_meanwhile(&mut dragged).await;
    for (node, id) in [(&a, &one), (&b, &other)] {
        let (status, told) = node.call("POST", &path(id, "/solve"), Some(&turn_json(0.9))).await;
        assert_eq!((status, &told["code"]), (503, &"UNAVAILABLE".into()), "{told}");
    }
    assert_eq!(
        (seen(&a, &one).await, seen(&b, &other).await),
        before,
        "reading goes on"
    );
    server.go_on();
    goes_on([(&a, &one), (&b, &other)], [3, 3]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_call_that_breaks_off_after_any_message_is_done_once_when_it_is_repeated() {
    let Some(place) = StorePlace::remote().await else {
        return;
    };
    let database = place.database().expect("a database");
    let proxy = PostgresProxy::serve(database);
    let a = node_at(&place, "a", Some(database.through(proxy.socket())));
    let id = bar_session(&a).await;
    let (mut messages, mut refused) = (0, 0);
    loop {
        messages += 1;
        let (key, body) = (format!("turn-{messages}"), turn_json(0.01 * f64::from(messages)));
        proxy.cut_after(messages, None);
        let asked = path(&id, "/solve");
        let call = async || a.call_with_key("POST", &asked, Some(&body), Some(&key)).await;
        let mut first = Some(call().await);
        let was_cut = !proxy.take_back();
        refused += u32::from(first.as_ref().is_some_and(|(status, _)| *status != 200));
        // It may be on disk, and is taken back, with its key, before the key is looked for.
        let (status, told) = retried("an answer", Duration::from_millis(20), async || {
            let answer = match first.take() {
                Some(answer) => answer,
                None => call().await,
            };
            (answer.0 != 503).then_some(answer)
        })
        .await;
        assert_eq!(status, 200, "after {messages} messages: {told}");
        let history = a.done("GET", &path(&id, "/history"), None).await;
        let commits = history["commits"].as_array().map(Vec::len);
        assert_eq!(commits, Some(2 + messages as usize), "{history}");
        if !was_cut {
            break;
        }
    }
    assert!(messages > 4 && refused > 4, "{messages} messages, {refused} refused");
}

#[tokio::test(flavor = "multi_thread")]
async fn nodes_outlive_a_database_that_says_nothing_for_longer_than_their_leases() {
    let Some(server) = PostgresServer::start() else { return };
    let database = server.database().await;
    let proxy = PostgresProxy::serve(&database);
    let url = Some(database.through(proxy.socket()));
    let place = StorePlace::in_database_and(database, TestBucket::serve().await);
    let (a, b) = (node_at(&place, "a", url.clone()), node_at(&place, "b", url));
    let (one, other) = (bar_session(&a).await, bar_session(&b).await);
    turn(&a, &one, 0.3).await;
    turn(&b, &other, 0.4).await;
    let before = seen(&a, &one).await;
    let mut dragged = stream(&a, &one).await;
    proxy.set_silent(true);
    let change = turn_json(0.9);
    let asked = path(&other, "/solve");
    let (_, (status, told)) = tokio::join!(drag_meanwhile(&mut dragged), async {
        let mut answer = std::pin::pin!(b.call("POST", &asked, Some(&change)));
        if let Ok(answer) = tokio::time::timeout(away(), &mut answer).await {
            return answer;
        }
        proxy.set_silent(false);
        answer.await
    });
    // It waits for the database, and may be just in time.
    assert!(
        status == 200 || (status, &told["code"]) == (503, &"UNAVAILABLE".into()),
        "{status} {told}"
    );
    proxy.set_silent(false);
    assert_eq!(seen(&a, &one).await, before, "reading goes on");
    goes_on([(&a, &one), (&b, &other)], [3, 3 + usize::from(status == 200)]).await;
}
