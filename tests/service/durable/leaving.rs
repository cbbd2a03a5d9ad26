//! SIGTERM in the middle of work: streams are notified, commits are stored, the program ends whatever its clients do, and a client that
//! comes back with its token goes on where it was.

use super::{bar_session, path, turn};
use crate::support::program::ServedProgram;
use crate::support::server::{Came, Socket, http, large_bar, pace, turned, within};
use pliant::wire::pb::{self, deform_request::Message, deform_response};
use serde_json::Value;
use std::path::PathBuf;
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;

fn folder() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    (folder, data)
}

async fn stream(server: &ServedProgram, id: &str) -> Socket {
    server.socket(&path(id, "/stream")).await
}

/// A commit of the bar's top, with its own key.
fn commit(seq: u64) -> Message {
    Message::Pose(pb::Pose {
        idempotency_key: format!("commit-{seq}"),
        ..turned(seq, 0.1 * seq as f64, true)
    })
}

/// The first part of the last frame of a pose. Notices on the way go to `tokens`.
async fn frame(socket: &mut Socket, seq: u64, tokens: &mut Vec<String>) -> pb::Frame {
    loop {
        let Came::Response(response) = socket.next().await else {
            panic!("closed before the frame of {seq}")
        };
        match response.message {
            Some(deform_response::Message::Frame(frame)) if frame.seq == seq && frame.r#final => return frame,
            Some(deform_response::Message::Notice(notice)) => {
                assert_eq!(notice.code, "going-away");
                tokens.push(notice.resume_token);
            }
            Some(deform_response::Message::Error(error)) => panic!("{error:?}"),
            _ => {}
        }
    }
}

async fn pose_commits(server: &ServedProgram, id: &str) -> Vec<Value> {
    let history = server.done("GET", &path(id, "/history"), None).await;
    let commits = history["commits"].as_array().expect("commits").clone();
    commits.into_iter().filter(|commit| commit["kind"] == "pose").collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn commits_are_stored_before_the_end_also_those_whose_frames_no_one_takes() {
    let (_kept, folder) = folder();
    let server = ServedProgram::start(&folder, &["--drain-deadline", "3s"]);
    let id = bar_session(&server).await;
    let mut socket = stream(&server, &id).await;
    let options = pb::Options {
        window: 1,
        ..pb::Options::default()
    };
    socket.send(Message::Options(options)).await;
    socket.send(Message::Pose(turned(1, 0.05, false))).await;
    frame(&mut socket, 1, &mut Vec::new()).await;
    // The frame is never acknowledged, so the window stays full and the commits wait.
    for seq in 2..=4 {
        socket.send(commit(seq)).await;
    }
    socket.send(Message::Ping(pb::Ping { nonce: 5 })).await;
    loop {
        let Came::Response(response) = socket.next().await else {
            panic!("closed")
        };
        if matches!(response.message, Some(deform_response::Message::Pong(_))) {
            break;
        }
    }
    assert_eq!(pose_commits(&server, &id).await.len(), 0);
    server.stop().await;

    let server = ServedProgram::start(&folder, &[]);
    let stored = pose_commits(&server, &id).await;
    assert_eq!(stored.len(), 3);
    // Their answers were lost; sent again, they are answered and not recorded again.
    let mut again = stream(&server, &id).await;
    for (seq, stored) in (2..=4).zip(&stored) {
        again.send(commit(seq)).await;
        let frame = frame(&mut again, seq, &mut Vec::new()).await;
        assert_eq!(stored["revision"], frame.revision.to_string());
        again.send(Message::Ack(pb::Ack { seq })).await;
    }
    assert_eq!(pose_commits(&server, &id).await, stored);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_goes_on_with_its_token_where_it_was() {
    let (_kept, folder) = folder();
    let server = ServedProgram::start(&folder, &["--drain-deadline", "50s"]);
    let id = bar_session(&server).await;
    let mut socket = stream(&server, &id).await;
    socket.send(commit(1)).await;
    let before = frame(&mut socket, 1, &mut Vec::new()).await;
    socket.send(Message::Ack(pb::Ack { seq: 1 })).await;
    socket.send(Message::Pose(turned(2, 0.7, false))).await;
    server.ask_to_stop();
    let mut tokens = Vec::new();
    while tokens.is_empty() {
        let Came::Response(response) = socket.next().await else {
            panic!("closed without a word")
        };
        if let Some(deform_response::Message::Notice(notice)) = response.message {
            tokens.push(notice.resume_token);
        }
    }
    // A commit that is made now is still stored, and answered.
    socket.send(commit(3)).await;
    let last = frame(&mut socket, 3, &mut tokens).await;
    drop(socket);
    server.stop().await;

    let server = ServedProgram::start(&folder, &[]);
    let mut socket = stream(&server, &tokens[0]).await;
    for (seq, was) in [(1, before), (3, last)] {
        socket.send(commit(seq)).await;
        let now = frame(&mut socket, seq, &mut Vec::new()).await;
        socket.send(Message::Ack(pb::Ack { seq })).await;
        assert_eq!((now.revision, now.parts), (was.revision, was.parts));
        assert!(now.data == was.data, "the frame of {seq} is the same to the bit");
    }
    // The drag goes on from the commit.
    socket.send(Message::Pose(turned(4, 0.7, false))).await;
    frame(&mut socket, 4, &mut Vec::new()).await;
    assert_eq!(pose_commits(&server, &id).await.len(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_program_ends_whatever_its_clients_do() {
    let (_kept, folder) = folder();
    let server = ServedProgram::start(&folder, &["--drain-deadline", "2s"]);
    let id = bar_session(&server).await;
    turn(&server, &id, 0.4).await;
    let before = pose_commits(&server, &id).await;
    let address = server.url.strip_prefix("http://").expect("a plain address").to_owned();
    let connect = || async { TcpStream::connect(&address).await.expect("a connection") };

    // One says nothing, one half of a request, one half of an upload.
    let _silent = connect().await;
    let mut half = connect().await;
    half.write_all(b"GET /v1/sessions HTT").await.expect("sent");
    let mut upload = connect().await;
    let head = format!("POST /v1/sessions HTTP/1.1\r\nhost: {address}\r\ncontent-length: 100000\r\n\r\nv 0 0 0\n");
    upload.write_all(head.as_bytes()).await.expect("sent");
    // One asks for much and reads nothing.
    let large = server.open(large_bar(), "").await;
    let mut greedy = connect().await;
    let ask = format!(
        "GET {} HTTP/1.1\r\nhost: {address}\r\n\r\n",
        path(&large, "/model?format=obj")
    );
    greedy.write_all(ask.repeat(20).as_bytes()).await.expect("sent");
    // One drags, acknowledges what it never reads, and does not close.
    let handles = serde_json::json!({"handles": crate::support::server::ends()});
    server.done("PUT", &path(&large, "/handles"), Some(&handles)).await;
    let mut deaf = stream(&server, &large).await;
    for seq in 1..=40 {
        deaf.send(Message::Pose(turned(seq, 0.01 * seq as f64, false))).await;
        deaf.send(Message::Ack(pb::Ack { seq })).await;
    }
    // One goes on dragging after the notice, for as long as it is let.
    let mut stubborn = stream(&server, &id).await;
    // One has work of its own under way.
    let url = format!("{}/v1/sessions", server.url);
    let opening = tokio::spawn(async move { http().post(url).body(large_bar()).send().await.map(|_| ()) });

    server.ask_to_stop();
    let mut seq = 0;
    let mut ticks = pace(std::time::Duration::from_millis(20));
    within("the end of the stream", async {
        loop {
            seq += 1;
            let request = pb::DeformRequest {
                session_id: String::new(),
                message: Some(Message::Pose(turned(seq, 0.001 * seq as f64, false))),
            };
            let bytes = prost::Message::encode_to_vec(&request);
            let message = tokio_tungstenite::tungstenite::Message::Binary(bytes.into());
            if futures::SinkExt::send(&mut stubborn.stream, message).await.is_err() {
                break;
            }
            ticks.tick().await;
        }
    })
    .await;
    server.stop().await;
    let _ = opening.await;

    let server = ServedProgram::start(&folder, &[]);
    assert_eq!(
        pose_commits(&server, &id).await,
        before,
        "what was acknowledged, and no more"
    );
}
