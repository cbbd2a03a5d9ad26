//! What one node asks of the database: for a commit, a drag, an opening, a taking over, and for being there.

use super::drag;
use crate::durable::place::StorePlace;
use crate::durable::{bar_session, path, turn};
use crate::support::bucket::TestBucket;
use crate::support::postgres::PostgresServer;
use crate::support::server::turned;
use std::time::Duration;

/// How often each is done.
const TIMES: u32 = 50;

/// What the database has done since it was asked last: statements, milliseconds in them, bytes of its log.
struct Asked {
    statements: usize,
    ms: f64,
    log_bytes: i64,
}

/// Reads what the server of the database noted of its statements.
fn noted(server: &PostgresServer) -> (usize, f64) {
    let log = std::fs::read_to_string(server.socket().join("log")).expect("a log");
    let lines = log
        .lines()
        .filter_map(|line| line.split_once("duration: ").map(|(_, told)| told));
    // What the measurement itself asks for is no node's.
    let lines = lines.filter(|told| !told.contains("pg_current_wal_insert_lsn"));
    let ms = |told: &str| {
        told.split(' ')
            .next()
            .and_then(|ms| ms.parse::<f64>().ok())
            .unwrap_or_default()
    };
    lines.fold((0, 0.0), |(statements, sum), told| {
        let is_one = told.contains("execute ") || told.contains("statement: ");
        (statements + usize::from(is_one), sum + ms(told))
    })
}

async fn since(place: &StorePlace, server: &PostgresServer, before: &mut (usize, f64, i64)) -> Asked {
    // Its log is written a little later than its answers.
    tokio::time::sleep(Duration::from_millis(300)).await;
    let (statements, ms) = noted(server);
    let log = place
        .number("SELECT CAST(pg_current_wal_insert_lsn() - '0/0'::pg_lsn AS BIGINT)")
        .await;
    let asked = Asked {
        statements: statements - before.0,
        ms: ms - before.1,
        log_bytes: log - before.2,
    };
    *before = (statements, ms, log);
    asked
}

fn tell(what: &str, asked: &Asked) {
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
    let Some(server) = PostgresServer::start() else {
        return;
    };
    let database = server.database().await;
    let notes = format!("ALTER DATABASE {} SET log_min_duration_statement = 0", database.name);
    let place = StorePlace::in_database_and(database, TestBucket::serve().await);
    place.ask(&notes).await;
    let start = |name: &str, times: [&str; 2]| {
        let told = [
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
            &[&told[..], &["--sessions", "200"]].concat(),
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
    tell("new, handles", &since(&place, &server, &mut before).await);
    let id = &ids[0];
    for k in 0..TIMES {
        turn(&node, id, 0.01 * f64::from(k)).await;
    }
    tell("commit", &since(&place, &server, &mut before).await);
    let mut socket = node.socket(&path(id, "/stream")).await;
    since(&place, &server, &mut before).await;
    for k in 1..=TIMES {
        drag(&mut socket, turned(u64::from(k), 0.01 * f64::from(k), false))
            .await
            .expect("a frame");
    }
    tell("drag", &since(&place, &server, &mut before).await);
    drop(socket);
    node.stop().await;
    since(&place, &server, &mut before).await;
    let other = start("b", ["300s", "100s"]).expect("a node");
    since(&place, &server, &mut before).await;
    for id in &ids {
        other.done("GET", &path(id, ""), None).await;
    }
    tell("taken over", &since(&place, &server, &mut before).await);
    for id in &ids {
        other.done("GET", &path(id, ""), None).await;
    }
    tell("looked at", &since(&place, &server, &mut before).await);
}
