//! Whoever has lost a session writes nothing of it, whatever it was about to write: the row says who may, and not who believes that he may.

use super::{drag, node, stream, unmoved};
use crate::durable::place::StorePlace;
use crate::durable::{bar_session, metric, path, seen, turn};
use crate::support::server::{AnsweredCall as _, Came, bar_obj, eventually, stays, turn_json, turned, within};
use pliant::wire::pb::{self, deform_request, deform_response};
use serde_json::{Value, json};

/// Rows of all that is written of sessions.
async fn written(place: &StorePlace) -> Vec<i64> {
    let mut counts = Vec::new();
    for table in ["commits", "audit", "call_keys", "snapshots", "object_uses", "sessions"] {
        counts.push(place.count(table).await);
    }
    counts
}

/// Another node takes all sessions, without the one that has them noticing.
async fn take_away(place: &StorePlace) {
    place
        .tamper("UPDATE sessions SET owner = 'another', generation = generation + 1")
        .await;
}

/// What another node has taken is free.
async fn set_free(place: &StorePlace) {
    place
        .tamper("UPDATE sessions SET owner = '', generation = generation + 1")
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_write_of_a_session_lands_that_another_node_has() {
    let Some(place) = StorePlace::remote().await else {
        return;
    };
    let a = node(&place, "a");
    let id = bar_session(&a).await;
    turn(&a, &id, 0.3).await;
    let cut = json!({"cut": {"plane": {"normal": [0, 0, 1], "offset": 1.5}, "fill": true}});
    let writes: [(&str, &str, Option<Value>); 6] = [
        ("POST", "/solve", Some(turn_json(0.9))),
        ("PATCH", "/handles/top", Some(json!({"stiffness": 2.0}))),
        ("POST", "/undo", None),
        ("POST", "/edits", Some(cut)),
        ("DELETE", "/handles/top", None),
        ("DELETE", "", None),
    ];
    for (method, rest, body) in writes {
        let before = (seen(&a, &id).await, written(&place).await);
        take_away(&place).await;
        let address = format!("{}{}", a.url, path(&id, rest));
        let mut call = unmoved().request(method.parse().expect("a method"), address);
        if let Some(body) = &body {
            call = call.json(body);
        }
        let refused = call
            .header("idempotency-key", format!("stale-{method}{rest}"))
            .answer()
            .await;
        assert_eq!(refused.status().as_u16(), 503, "{method} {rest}");
        let told: Value = refused.json().await.expect("a problem");
        assert!(
            told["detail"]
                .as_str()
                .is_some_and(|d| d.contains("nothing has changed")),
            "{told}"
        );
        assert_eq!(written(&place).await, before.1, "{method} {rest}");
        set_free(&place).await;
        assert_eq!(seen(&a, &id).await, before.0, "{method} {rest}");
    }
    // What is noted from time to time is no exception.
    let stamped = place.number("SELECT used_ms FROM sessions").await;
    take_away(&place).await;
    assert_eq!(a.call("GET", &path(&id, ""), None).await.0, 200, "it has not noticed");
    stays("its time of use", std::time::Duration::from_secs(6), async || {
        place.number("SELECT used_ms FROM sessions").await == stamped
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stale_commit_takes_nothing_of_others_along() {
    let Some(place) = StorePlace::remote().await else {
        return;
    };
    let a = node(&place, "a");
    let (lost, kept) = (bar_session(&a).await, bar_session(&a).await);
    let taken = format!("UPDATE sessions SET owner = 'another', generation = generation + 1 WHERE id = '{lost}'");
    place.tamper(&taken).await;
    // Both commits go to the database together, as often as it takes for them to meet in one transaction.
    let (mut stale, mut good) = (stream(&a, &lost).await, stream(&a, &kept).await);
    let commit = |seq: u64| pb::Pose {
        idempotency_key: format!("commit-{seq}"),
        ..turned(seq, 0.1 * seq as f64, true)
    };
    stale.send(deform_request::Message::Pose(commit(1))).await;
    for seq in 1..=10 {
        let pose = pb::Pose {
            idempotency_key: format!("kept-{seq}"),
            ..commit(seq)
        };
        drag(&mut good, pose).await.expect("a commit");
    }
    let ended = within("the end of the stale stream", async {
        loop {
            match stale.next().await {
                Came::Closed(_) => return,
                Came::Response(response) => {
                    let is_frame = matches!(response.message, Some(deform_response::Message::Frame(_)));
                    assert!(!is_frame, "a stale commit was acknowledged");
                }
            }
        }
    });
    ended.await;
    let of = |id: &str| format!("SELECT COUNT(*) FROM commits WHERE session = '{id}'");
    assert_eq!(
        (place.number(&of(&lost)).await, place.number(&of(&kept)).await),
        (2, 12)
    );
    assert_eq!(metric(&a, "pliant_sessions_lost_total").await, 1.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn objects_go_only_when_no_node_has_named_them_for_long() {
    let Some(place) = StorePlace::remote().await else {
        return;
    };
    let (a, b) = (node(&place, "a"), node(&place, "b"));
    let (one, other) = (a.open(bar_obj(12), "").await, b.open(bar_obj(12), "").await);
    assert_eq!(place.objects().len(), 1, "the same model is one object");
    assert_eq!(place.count("loose_objects").await, 0);
    a.done("DELETE", &path(&one, ""), None).await;
    assert_eq!((place.objects().len(), place.count("loose_objects").await), (1, 1));
    // Long ago, and still used: it stays.
    place.tamper("UPDATE loose_objects SET since_ms = 0").await;
    eventually("it is looked at", async || place.count("loose_objects").await == 0).await;
    assert_eq!(place.objects().len(), 1);
    b.done("DELETE", &path(&other, ""), None).await;
    assert_eq!(
        (place.objects().len(), place.count("loose_objects").await),
        (1, 1),
        "not at once"
    );
    place.tamper("UPDATE loose_objects SET since_ms = 0").await;
    eventually("it goes", async || place.objects().is_empty()).await;
    let again = a.open(bar_obj(12), "").await;
    a.stop().await;
    assert_eq!(
        seen(&b, &again).await.2.len(),
        bar_obj(12).lines().filter(|l| l.starts_with("v ")).count() * 12
    );
}
