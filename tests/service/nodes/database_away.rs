//! The database away for a while: what is in memory goes on, what changes something is refused, and everything recovers by itself.

use super::{LEASE, answered, drag, node_at, stream};
use crate::durable::place::StorePlace;
use crate::durable::{bar_session, path, seen, turn};
use crate::support::bucket::TestBucket;
use crate::support::postgres::PostgresServer;
use crate::support::server::{eventually, turn_json, turned};

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
    tokio::time::sleep(LEASE * 2).await;
    for seq in 1..=20 {
        let pose = turned(seq, 0.01 * seq as f64, false);
        drag(&mut dragged, pose).await.expect("a frame");
    }
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
    for (node, id) in [(&a, &one), (&b, &other)] {
        eventually("a commit is taken again", async || {
            node.call("POST", &path(id, "/solve"), Some(&turn_json(0.5))).await.0 == 200
        })
        .await;
        // Each is where it was: nobody asked for it elsewhere.
        assert_eq!(answered(node, &path(id, "")).await, 200);
        let history = node.done("GET", &path(id, "/history"), None).await;
        assert_eq!(history["commits"].as_array().map(Vec::len), Some(4), "{history}");
    }
}
