//! The database away for a while: what is in memory goes on, what changes something is refused, and everything recovers on its own.
//!
//! It is away for two leases; with `PLIANT_FAULTS`, as in the long run of the clients' test, for ten seconds.

use super::{LEASE, answered, drag, node_at, stream};
use crate::durable::place::StorePlace;
use crate::durable::{bar_session, path, seen, turn};
use crate::support::bucket::TestBucket;
use crate::support::postgres::PostgresProxy;
use crate::support::postgres::PostgresServer;
use crate::support::process::needed;
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
        // Each is where it was: no one asked for it elsewhere.
        assert_eq!(answered(node, &path(id, "")).await, 200);
        let history = node.done("GET", &path(id, "/history"), None).await;
        let commits = history["commits"].as_array().map(Vec::len);
        assert_eq!(commits, Some(had + 1), "{history}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn nodes_outlive_a_database_that_is_away_for_longer_than_their_leases() {
    let server = needed!(PostgresServer::start());
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
        let (status, reply) = node.call("POST", &path(id, "/solve"), Some(&turn_json(0.9))).await;
        assert_eq!((status, &reply["code"]), (503, &"UNAVAILABLE".into()), "{reply}");
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
    let place = needed!(StorePlace::remote().await);
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
        let (status, reply) = retried("an answer", Duration::from_millis(20), async || {
            let answer = match first.take() {
                Some(answer) => answer,
                None => call().await,
            };
            (answer.0 != 503).then_some(answer)
        })
        .await;
        assert_eq!(status, 200, "after {messages} messages: {reply}");
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
    let server = needed!(PostgresServer::start());
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
    let (_, (status, reply)) = tokio::join!(drag_meanwhile(&mut dragged), async {
        let mut answer = std::pin::pin!(b.call("POST", &asked, Some(&change)));
        if let Ok(answer) = tokio::time::timeout(away(), &mut answer).await {
            return answer;
        }
        proxy.set_silent(false);
        answer.await
    });
    // It waits for the database, and may be just in time.
    assert!(
        status == 200 || (status, &reply["code"]) == (503, &"UNAVAILABLE".into()),
        "{status} {reply}"
    );
    proxy.set_silent(false);
    assert_eq!(seen(&a, &one).await, before, "reading goes on");
    goes_on([(&a, &one), (&b, &other)], [3, 3 + usize::from(status == 200)]).await;
}

/// How often each is done.
const TIMES: u32 = 50;

/// What the database has done since it was asked last: statements, milliseconds in them, bytes of its log.
struct DatabaseLoad {
    statements: usize,
    ms: f64,
    log_bytes: i64,
}

/// Reads what the server of the database noted of its statements.
fn noted(server: &PostgresServer) -> (usize, f64) {
    let log = std::fs::read_to_string(server.socket().join("log")).expect("a log");
    let lines = log
        .lines()
        .filter_map(|line| line.split_once("duration: ").map(|(_, reply)| reply));
    // What the measurement itself asks for is not a node's.
    let lines = lines.filter(|reply| !reply.contains("pg_current_wal_insert_lsn"));
    let ms = |reply: &str| {
        reply
            .split(' ')
            .next()
            .and_then(|ms| ms.parse::<f64>().ok())
            .unwrap_or_default()
    };
    lines.fold((0, 0.0), |(statements, sum), reply| {
        let is_one = reply.contains("execute ") || reply.contains("statement: ");
        (statements + usize::from(is_one), sum + ms(reply))
    })
}

async fn since(place: &StorePlace, server: &PostgresServer, before: &mut (usize, f64, i64)) -> DatabaseLoad {
    // Its log is written a little later than its answers.
    tokio::time::sleep(Duration::from_millis(300)).await;
    let (statements, ms) = noted(server);
    let log = place
        .number("SELECT CAST(pg_current_wal_insert_lsn() - '0/0'::pg_lsn AS BIGINT)")
        .await;
    let asked = DatabaseLoad {
        statements: statements - before.0,
        ms: ms - before.1,
        log_bytes: log - before.2,
    };
    *before = (statements, ms, log);
    asked
}

fn print_load(what: &str, asked: &DatabaseLoad) {
    let each = f64::from(TIMES);
    println!(
        "{what:12} {:6.2} statements {:7.3} ms in the database {:8.0} bytes of its log, each",
        asked.statements as f64 / each,
        asked.ms / each,
        asked.log_bytes as f64 / each
    );
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a measurement: cargo test --release --test service database_share -- --ignored --nocapture"]
async fn what_a_node_asks_of_the_database() {
    let server = needed!(PostgresServer::start());
    let database = server.database().await;
    let notes = format!("ALTER DATABASE {} SET log_min_duration_statement = 0", database.name);
    let place = StorePlace::in_database_and(database, TestBucket::serve().await);
    place.ask(&notes).await;
    let start = |name: &str, times: [&str; 2]| {
        let reply = [
            "--advertise",
            "http://127.0.0.1:0",
            "--node",
            name,
            "--lease",
            times[0],
            "--heartbeat",
            times[1],
        ];
        let url = place.database().map(|d| d.url.as_str());
        place.start_logged(
            &format!("log-{name}"),
            url,
            &[&reply[..], &["--sessions", "200"]].concat(),
        )
    };
    // What it says of being there does not mix with what is measured.
    let node = start("a", ["300s", "100s"]).expect("a node");
    let mut before = (0, 0.0, 0);
    since(&place, &server, &mut before).await;
    let mut ids = Vec::new();
    for _ in 0..TIMES {
        ids.push(bar_session(&node).await);
    }
    print_load("new, handles", &since(&place, &server, &mut before).await);
    let id = &ids[0];
    for k in 0..TIMES {
        turn(&node, id, 0.01 * f64::from(k)).await;
    }
    print_load("commit", &since(&place, &server, &mut before).await);
    let mut socket = node.socket(&path(id, "/stream")).await;
    since(&place, &server, &mut before).await;
    for k in 1..=TIMES {
        drag(&mut socket, turned(u64::from(k), 0.01 * f64::from(k), false))
            .await
            .expect("a frame");
    }
    print_load("drag", &since(&place, &server, &mut before).await);
    drop(socket);
    node.stop().await;
    since(&place, &server, &mut before).await;
    let other = start("b", ["300s", "100s"]).expect("a node");
    since(&place, &server, &mut before).await;
    for id in &ids {
        other.done("GET", &path(id, ""), None).await;
    }
    print_load("taken over", &since(&place, &server, &mut before).await);
    for id in &ids {
        other.done("GET", &path(id, ""), None).await;
    }
    print_load("looked at", &since(&place, &server, &mut before).await);
}
