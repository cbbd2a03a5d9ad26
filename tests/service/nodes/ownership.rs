//! Nodes that are killed, stopped for a while or drained: what was acknowledged is at another one, once, and streams go on there.

use super::{LEASE, answered, drag, node, node_with, stream, unmoved};
use crate::durable::place::StorePlace;
use crate::durable::{bar_at, bar_session, metric, path, seen, turn};
use crate::support::process::needed;
use crate::support::program::ServedProgram;
use crate::support::server::{
    AnsweredCall as _, Came, bar_obj, eventually, header, stays, text, turn_json, turned, within,
};
use pliant::wire::pb::{self, deform_request, deform_response};
use serde_json::{Value, json};
use std::time::Instant;

/// What a server alone makes of the same commits.
async fn seen_alone(angles: &[f64]) -> (Value, Vec<u8>) {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    for angle in angles {
        turn(&server, &id, *angle).await;
    }
    let (_, history, positions) = seen(&server, &id).await;
    (history, positions)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_killed_node_had_is_at_another_with_the_same_bits() {
    let place = needed!(StorePlace::remote().await);
    let (a, b, c) = (node(&place, "a"), node(&place, "b"), node(&place, "c"));
    let id = bar_session(&a).await;
    for angle in [0.3, 0.6] {
        turn(&a, &id, angle).await;
    }
    let before = seen(&a, &id).await;
    a.kill();
    let since = Instant::now();
    // Until the lease has run out no one may take it: the dead node might be alive.
    assert_eq!(answered(&b, &path(&id, "")).await, 200);
    assert!(since.elapsed() < LEASE * 10, "{:?}", since.elapsed());
    assert_eq!(seen(&b, &id).await, before);
    turn(&b, &id, 0.9).await;
    assert_eq!(
        seen(&c, &id).await,
        seen(&b, &id).await,
        "the third one sends to the second"
    );
    let (_, history, positions) = seen(&c, &id).await;
    assert_eq!((history, positions), seen_alone(&[0.3, 0.6, 0.9]).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_was_stopped_past_its_lease_neither_writes_nor_reports_what_was() {
    let place = needed!(StorePlace::remote().await);
    let (a, b) = (node(&place, "a"), node(&place, "b"));
    let id = bar_session(&a).await;
    turn(&a, &id, 0.3).await;
    let mut dragged = stream(&a, &id).await;
    drag(&mut dragged, turned(1, 0.1, false)).await.expect("a frame");
    a.pause();
    // It may be in the middle of anything; this commit was sent and no one knows what became of it.
    dragged.send(deform_request::Message::Pose(turned(2, 0.7, true))).await;
    assert_eq!(answered(&b, &path(&id, "")).await, 200);
    turn(&b, &id, 0.6).await;
    let taken = seen(&b, &id).await;
    a.signal("-CONT");
    // Asked at once, before it can have noticed on its own.
    assert_eq!(seen(&a, &id).await, taken, "what the other node has");
    turn(&a, &id, 0.9).await;
    let ended = within("the end of the stream", async {
        loop {
            match dragged.next().await {
                Came::Closed(_) => return None,
                Came::Response(response) => match response.message.expect("a message") {
                    deform_response::Message::Error(error) => return Some(error.code),
                    deform_response::Message::Frame(frame) => {
                        assert_eq!(frame.seq, 1, "the stale commit was acknowledged")
                    }
                    _ => {}
                },
            }
        }
    });
    assert!(matches!(ended.await, None | Some(14)), "UNAVAILABLE");
    assert_eq!(metric(&a, "pliant_sessions_lost_total").await, 1.0);
    let (_, history, positions) = seen(&a, &id).await;
    assert_eq!((history, positions), seen_alone(&[0.3, 0.6, 0.9]).await);
    let checked = {
        b.stop().await;
        a.stop().await;
        place.store(&["check", "--replay"])
    };
    assert_eq!(checked.code, 0, "{}{}", checked.out, checked.err);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drained_node_gives_its_sessions_back_one_by_one() {
    let place = needed!(StorePlace::remote().await);
    let (a, b) = (node(&place, "a"), node(&place, "b"));
    let (idle, used) = (bar_session(&a).await, bar_session(&a).await);
    turn(&a, &idle, 0.3).await;
    let before = seen(&a, &idle).await;
    let mut dragged = stream(&a, &used).await;
    drag(&mut dragged, turned(1, 0.1, true)).await.expect("a frame");
    a.ask_to_stop();
    let token = loop {
        match dragged.next().await {
            Came::Response(response) => {
                if let Some(deform_response::Message::Notice(notice)) = response.message {
                    break notice.resume_token;
                }
            }
            Came::Closed(why) => panic!("no notice: {why:?}"),
        }
    };
    // What no one uses is free at once, without the lease having to run out, while the stream goes on.
    let since = Instant::now();
    assert_eq!(answered(&b, &path(&idle, "")).await, 200);
    assert_eq!(seen(&b, &idle).await, before);
    // Who comes to the node that leaves is sent to one that stays, with what is new too.
    for (method, rest) in [
        ("GET", path(&idle, "")),
        ("POST", "/v1/sessions?sample=creature".to_owned()),
    ] {
        let call = unmoved().request(method.parse().expect("a method"), format!("{}{rest}", a.url));
        let sent = call.answer().await;
        assert_eq!(sent.status().as_u16(), 307, "{method} {rest}");
        assert_eq!(header(&sent, "x-pliant-owner"), b.url, "{method} {rest}");
    }
    drag(&mut dragged, turned(2, 0.2, true))
        .await
        .expect("a frame of the node that leaves");
    drop(dragged);
    assert_eq!(answered(&b, &path(&token, "")).await, 200);
    let took = since.elapsed();
    let mut resumed = stream(&b, &token).await;
    drag(&mut resumed, turned(1, 0.1, true)).await.expect("a frame");
    let history = b.done("GET", &path(&used, "/history"), None).await;
    let commits = history["commits"].as_array().expect("commits").len();
    assert_eq!(commits, 5, "created, handles and three poses: {history}");
    assert_eq!(
        metric(&b, "pliant_sessions_reopened_total").await,
        2.0,
        "one reopening each"
    );
    assert!(took.as_secs() < 5, "{took:?}");
    a.stop().await;
    assert_eq!(place.count("nodes").await, 1, "its row is gone");
}

/// Rows of all that is written of sessions.
async fn written(place: &StorePlace) -> Vec<i64> {
    let mut counts = Vec::new();
    for table in ["commits", "audit", "call_keys", "snapshots", "object_uses", "sessions"] {
        counts.push(place.count(table).await);
    }
    counts
}

/// A node whose lease does not run out, however slow the machine is. One that knows that it had run out looks who has its sessions, and
/// takes them back, for [`take_away`] names an owner without a lease.
fn unnoticing(place: &StorePlace) -> ServedProgram {
    node_with(place, "a", &["--lease", "5m"])
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
    let place = needed!(StorePlace::remote().await);
    let a = unnoticing(&place);
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
        let call = call.header("idempotency-key", format!("stale-{method}{rest}"));
        let refused = call.refusal(503).await;
        assert!(text(&refused["detail"]).contains("nothing has changed"), "{refused}");
        assert_eq!(written(&place).await, before.1, "{method} {rest}");
        set_free(&place).await;
        assert_eq!(seen(&a, &id).await, before.0, "{method} {rest}");
    }
    // What is noted from time to time is not an exception.
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
    let place = needed!(StorePlace::remote().await);
    let a = unnoticing(&place);
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
    let place = needed!(StorePlace::remote().await);
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
