//! What is particular to WebSockets: how they close, who may open them, and errors on the way.

use super::{Books, refused_socket};
use crate::support::server::*;
use bytes::Bytes;
use futures::SinkExt as _;
use pliant::wire::pb::deform_request::{self, Message};
use pliant::wire::pb::{self, deform_response};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio_tungstenite::tungstenite;
use tonic::Code;

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_pose_is_reported_and_the_stream_goes_on() {
    let (server, id) = Server::start_with_bar().await;
    let mut socket = server.stream_socket(&id).await;
    let mut wrong = turned(1, 0.1, false);
    wrong.handles[0].id = "nose".into();
    socket.send(deform_request::Message::Pose(wrong)).await;
    let Some(deform_response::Message::Error(error)) = socket.response().await else {
        panic!("no error")
    };
    assert_eq!((error.seq, error.code), (1, 3));
    assert!(error.message.contains("nose"), "{}", error.message);
    socket.send(deform_request::Message::Pose(turned(2, 0.1, false))).await;
    let mut books = Books::default();
    books.read_socket_to(2, &mut socket).await;
    socket.send(deform_request::Message::Ping(pb::Ping { nonce: 77 })).await;
    let pong = deform_response::Message::Pong(pb::Ping { nonce: 77 });
    while socket.response().await.expect("an open socket") != pong {}
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_of_a_session_are_bounded_and_given_back() {
    let (server, id) = Server::bar_with(|sessions, _| sessions.streams = 1).await;
    let path = format!("/v1/sessions/{id}/stream");
    let first = server.socket(&path).await.unwrap();
    let refused = refused_socket(&server, &id).await;
    assert_eq!(refused.status(), 429);
    assert!(refused.headers().contains_key("retry-after"));
    let (_requests, mut responses) = server.stream(&id).await;
    let refused = within("a refusal", responses.message()).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted);
    drop(first);
    eventually("a free place", async || server.socket(&path).await.is_ok()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_sends_far_too_much_hears_why_it_ends() {
    let (server, id) = Server::start_with_bar().await;
    let path = format!("/v1/sessions/{id}/stream");
    for megabytes in [5, 24] {
        let mut socket = server.socket(&path).await.unwrap();
        let large = tungstenite::Message::Binary(Bytes::from(vec![0; megabytes << 20]));
        let (code, why) = closed_after(&mut socket, large).await;
        assert_eq!(code, 1009, "{why}");
        assert!(why.contains("messageBytes"), "{why}");
    }
}

/// The close code and text after a message that breaks the rules.
async fn closed_after(socket: &mut Socket, broken: tungstenite::Message) -> (u16, String) {
    let _ = socket.stream.send(broken).await;
    loop {
        if let Came::Closed(frame) = socket.next().await {
            return frame.expect("a close frame");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_websocket_says_why_it_closes() {
    let (server, id) = Server::bar_with(|sessions, _| sessions.message_bytes = 64 << 10).await;
    let path = format!("/v1/sessions/{id}/stream");
    for (broken, code) in [
        (tungstenite::Message::text("{}"), 1003),
        (tungstenite::Message::Binary(Bytes::from_static(&[0xff; 9])), 1007),
        (tungstenite::Message::Binary(Bytes::from(vec![0; 65 << 10])), 1009),
    ] {
        let mut socket = server.socket(&path).await.unwrap();
        assert_eq!(closed_after(&mut socket, broken).await.0, code);
    }

    let mut socket = server.socket(&path).await.unwrap();
    let gone = server.delete(&format!("/v1/sessions/{id}")).answer().await;
    assert_eq!(gone.status(), 204);
    let mut reply = None;
    let (code, reason) = loop {
        match socket.next().await {
            Came::Response(response) => reply = response.message,
            Came::Closed(frame) => break frame.expect("a close frame"),
        }
    };
    assert!(
        matches!(reply, Some(deform_response::Message::Error(ref e)) if e.seq == 0 && e.code == 5),
        "{reply:?}"
    );
    assert_eq!(code, 4005);
    assert!(reason.contains("deleted"), "{reason}");
}

/// The close frame's code after bytes that are no frame a client may send.
async fn closed_after_bytes(server: &Server, path: &str, bytes: &[u8]) -> u16 {
    let mut socket = tokio::net::TcpStream::connect(server.address).await.unwrap();
    let upgrade = format!(
        "GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: upgrade\r\nupgrade: websocket\r\nsec-websocket-version: 13\r\n\
         sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    socket.write_all(upgrade.as_bytes()).await.unwrap();
    let mut reported = Vec::new();
    while !reported.ends_with(b"\r\n\r\n") {
        reported.push(within("the handshake", socket.read_u8()).await.unwrap());
    }
    socket.write_all(bytes).await.unwrap();
    let mut frames = Vec::new();
    within("the end", socket.read_to_end(&mut frames)).await.unwrap();
    assert_eq!(frames.first(), Some(&0x88), "a close frame: {frames:?}");
    u16::from_be_bytes([frames[2], frames[3]])
}

#[tokio::test(flavor = "multi_thread")]
async fn broken_rules_of_the_protocol_close_with_1002() {
    let (server, id) = Server::start_with_bar().await;
    let path = format!("/v1/sessions/{id}/stream");
    let broken: [(&str, &[u8]); 5] = [
        ("a frame without a mask", &[0x82, 0x01, 0x00]),
        ("a reserved bit", &[0xf2, 0x80, 0, 0, 0, 0]),
        ("a frame of no kind", &[0x83, 0x80, 0, 0, 0, 0]),
        ("a ping in parts", &[0x09, 0x80, 0, 0, 0, 0]),
        ("a part that continues nothing", &[0x80, 0x80, 0, 0, 0, 0]),
    ];
    for (what, bytes) in broken {
        assert_eq!(closed_after_bytes(&server, &path, bytes).await, 1002, "{what}");
    }
    // A text, masked with zeros, whose bytes are no UTF-8.
    let text = &[0x81, 0x81, 0, 0, 0, 0, 0xff];
    assert_eq!(closed_after_bytes(&server, &path, text).await, 1007);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_foreign_page_gets_no_websocket_and_a_protocol_is_agreed() {
    use tungstenite::client::IntoClientRequest as _;
    let (server, id) = Server::start_with_bar().await;
    let url = format!("ws://{}/v1/sessions/{id}/stream", server.address);
    let mut foreign = url.as_str().into_client_request().unwrap();
    foreign
        .headers_mut()
        .insert("origin", "https://evil.example".parse().unwrap());
    let tungstenite::Error::Http(refused) = tokio_tungstenite::connect_async(foreign).await.map(|_| ()).unwrap_err()
    else {
        panic!("no HTTP answer")
    };
    assert_eq!(refused.status(), 403);
    let mut named = url.as_str().into_client_request().unwrap();
    named
        .headers_mut()
        .insert("sec-websocket-protocol", "other, pliant.v1".parse().unwrap());
    let (_, answer) = tokio_tungstenite::connect_async(named).await.unwrap();
    assert_eq!(answer.headers()["sec-websocket-protocol"], "pliant.v1");
}

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
        match socket.response().await.expect("an open socket") {
            deform_response::Message::Error(error) if error.seq == seq => return Err(error),
            deform_response::Message::Frame(frame) if frame.seq == seq && frame.r#final => {
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
    let history = server.document(&path(id, "/history")).await;
    let commits = history["commits"].as_array().expect("commits");
    commits.iter().filter(|commit| commit["kind"] == "pose").count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_commit_that_is_sent_again_is_recorded_once() {
    let (server, id) = Server::start_with_bar().await;
    let stream = format!("/v1/sessions/{id}/stream");
    let mut socket = server.socket(&stream).await.unwrap();
    socket.send(keyed(1, 0.4, "first")).await;
    let first = answer(&mut socket, 1).await.expect("a frame");
    socket.send(keyed(2, 0.9, "second")).await;
    let second = answer(&mut socket, 2).await.expect("a frame");
    assert_eq!(commits(&server, &id).await, 2);

    // On the same stream, and on a later one, where numbers begin again.
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
    let (server, id) = Server::start_with_bar().await;
    let mut socket = server.stream_socket(&id).await;
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
