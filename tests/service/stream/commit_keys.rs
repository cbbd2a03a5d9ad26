//! Commits on a stream that are sent again, because their answer was lost.

use crate::support::server::*;
use pliant::wire::pb::{self, deform_request::Message, deform_response};
use serde_json::Value;
use tonic::Code;

fn keyed(seq: u64, angle: f64, key: &str) -> Message {
    Message::Pose(pb::Pose {
        idempotency_key: key.into(),
        ..turned(seq, angle, true)
    })
}

/// What a pose is answered with: the parts of its last frame, or an error.
async fn answer(socket: &mut Socket, seq: u64) -> Result<Vec<pb::Frame>, pb::Error> {
    let mut parts = Vec::new();
    loop {
        let Came::Response(response) = socket.next().await else {
            panic!("closed")
        };
        match response.message {
            Some(deform_response::Message::Error(error)) if error.seq == seq => return Err(error),
            Some(deform_response::Message::Frame(frame)) if frame.seq == seq && frame.r#final => {
                let last = frame.part + 1 == frame.parts;
                parts.push(frame);
                if last {
                    socket.send(Message::Ack(pb::Ack { seq })).await;
                    return Ok(parts);
                }
            }
            _ => {}
        }
    }
}

async fn commits(server: &Server, id: &str) -> usize {
    let history = server.get(&format!("/v1/sessions/{id}/history")).send();
    let history: Value = history.await.unwrap().json().await.unwrap();
    let commits = history["commits"].as_array().expect("commits");
    commits.iter().filter(|commit| commit["kind"] == "pose").count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_commit_that_is_sent_again_is_recorded_once() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let stream = format!("/v1/sessions/{id}/stream");
    let mut socket = server.socket(&stream).await.unwrap();
    socket.send(keyed(1, 0.4, "first")).await;
    let first = answer(&mut socket, 1).await.expect("a frame");
    socket.send(keyed(2, 0.9, "second")).await;
    let second = answer(&mut socket, 2).await.expect("a frame");
    assert_eq!(commits(&server, &id).await, 2);

    // On the same stream, and on a later one, where numbers begin anew.
    socket.send(keyed(3, 0.4, "first")).await;
    let again = answer(&mut socket, 3).await.expect("the frame of the first");
    drop(socket);
    let mut other = server.socket(&stream).await.unwrap();
    other.send(keyed(1, 0.9, "second")).await;
    let latest = answer(&mut other, 1).await.expect("the frame of the second");
    for (was, now) in [(&first, &again), (&second, &latest)] {
        assert_eq!(now[0].revision, was[0].revision);
        assert!(
            now.iter().map(|p| &p.data).eq(was.iter().map(|p| &p.data)),
            "to the bit"
        );
    }
    assert_eq!(commits(&server, &id).await, 2);

    // The poses that were dragged before it belong to the commit: nothing of them is left.
    other.send(Message::Pose(turned(2, 0.1, false))).await;
    other.send(keyed(3, 0.9, "second")).await;
    answer(&mut other, 3).await.expect("the frame of the second");
    other.send(keyed(4, 0.2, "third")).await;
    answer(&mut other, 4).await.expect("a new commit");
    assert_eq!(commits(&server, &id).await, 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_that_is_none_is_refused_and_the_stream_goes_on() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let mut socket = server.socket(&format!("/v1/sessions/{id}/stream")).await.unwrap();
    socket.send(keyed(1, 0.4, "mine")).await;
    answer(&mut socket, 1).await.expect("a frame");
    let on_a_drag = Message::Pose(pb::Pose {
        commit: false,
        idempotency_key: "mine".into(),
        ..turned(2, 0.4, true)
    });
    let long = "k".repeat(256);
    let cases = [
        (on_a_drag, "only a commit has a key"),
        (keyed(3, 0.5, "mine"), "different request"),
        (keyed(4, 0.5, "two words"), "visible ASCII"),
        (keyed(5, 0.5, &long), "visible ASCII"),
    ];
    for (seq, (message, words)) in (2..).zip(cases) {
        socket.send(message).await;
        let refused = answer(&mut socket, seq).await.expect_err(words);
        assert_eq!(refused.code, Code::InvalidArgument as u32, "{refused:?}");
        assert!(refused.message.contains(words), "{refused:?}");
    }
    assert_eq!(commits(&server, &id).await, 1);
    socket.send(keyed(6, 0.5, "another")).await;
    answer(&mut socket, 6).await.expect("the stream is as it was");

    let solve = pb::SolveRequest {
        session_id: id.clone(),
        pose: Some(pb::Pose {
            idempotency_key: "mine".into(),
            ..turned(1, 0.4, false)
        }),
        options: None,
    };
    let refused = server
        .grpc()
        .await
        .solve(solve)
        .await
        .expect_err("its call has a header");
    assert_eq!(refused.code(), Code::InvalidArgument);
    assert!(refused.message().contains("idempotency-key"), "{refused}");
}
