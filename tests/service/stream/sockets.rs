//! What is particular to WebSockets: how they close, who may open them, and errors on the way.

use super::Books;
use crate::support::server::*;
use bytes::Bytes;
use futures::SinkExt as _;
use pliant::wire::pb::{self, deform_request, deform_response};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio_tungstenite::tungstenite;
use tonic::Code;

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_pose_is_told_and_the_stream_goes_on() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let mut socket = server.socket(&format!("/v1/sessions/{id}/stream")).await.unwrap();
    let mut wrong = turned(1, 0.1, false);
    wrong.handles[0].id = "nose".into();
    socket.send(deform_request::Message::Pose(wrong)).await;
    let Came::Response(pb::DeformResponse {
        message: Some(deform_response::Message::Error(error)),
    }) = socket.next().await
    else {
        panic!("no error")
    };
    assert_eq!((error.seq, error.code), (1, 3));
    assert!(error.message.contains("nose"), "{}", error.message);
    socket.send(deform_request::Message::Pose(turned(2, 0.1, false))).await;
    let mut books = Books::default();
    while books.seqs.last() != Some(&2) {
        let Came::Response(response) = socket.next().await else {
            panic!("closed")
        };
        books.enter(&response);
    }
    socket.send(deform_request::Message::Ping(pb::Ping { nonce: 77 })).await;
    loop {
        let Came::Response(response) = socket.next().await else {
            panic!("closed")
        };
        if response.message == Some(deform_response::Message::Pong(pb::Ping { nonce: 77 })) {
            break;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_of_a_session_are_bounded_and_given_back() {
    let server = Server::with(|sessions, _| sessions.streams = 1).await;
    let id = server.bar_session().await;
    let path = format!("/v1/sessions/{id}/stream");
    let first = server.socket(&path).await.unwrap();
    let tungstenite::Error::Http(refused) = server.socket(&path).await.map(|_| ()).unwrap_err() else {
        panic!("no HTTP answer")
    };
    assert_eq!(refused.status(), 429);
    assert!(refused.headers().contains_key("retry-after"));
    let (_requests, mut responses) = server.stream(&id).await;
    assert_eq!(
        within("a refusal", responses.message()).await.unwrap_err().code(),
        Code::ResourceExhausted
    );
    drop(first);
    eventually("a free place", async || server.socket(&path).await.is_ok()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_sends_far_too_much_hears_why_it_ends() {
    let server = Server::start().await;
    let id = server.bar_session().await;
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
    let server = Server::with(|sessions, _| sessions.message_bytes = 64 << 10).await;
    let id = server.bar_session().await;
    let path = format!("/v1/sessions/{id}/stream");
    let mut socket = server.socket(&path).await.unwrap();
    assert_eq!(
        closed_after(&mut socket, tungstenite::Message::text("{}")).await.0,
        1003
    );
    let mut socket = server.socket(&path).await.unwrap();
    assert_eq!(
        closed_after(
            &mut socket,
            tungstenite::Message::Binary(Bytes::from_static(&[0xff; 9]))
        )
        .await
        .0,
        1007
    );
    let mut socket = server.socket(&path).await.unwrap();
    assert_eq!(
        closed_after(
            &mut socket,
            tungstenite::Message::Binary(Bytes::from(vec![0; 65 << 10]))
        )
        .await
        .0,
        1009
    );

    let mut socket = server.socket(&path).await.unwrap();
    let gone = server.delete(&format!("/v1/sessions/{id}")).answer().await;
    assert_eq!(gone.status(), 204);
    let mut told = None;
    let (code, reason) = loop {
        match socket.next().await {
            Came::Response(response) => told = response.message,
            Came::Closed(frame) => break frame.expect("a close frame"),
        }
    };
    assert!(
        matches!(told, Some(deform_response::Message::Error(ref e)) if e.seq == 0 && e.code == 5),
        "{told:?}"
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
    let mut told = Vec::new();
    while !told.ends_with(b"\r\n\r\n") {
        told.push(within("the handshake", socket.read_u8()).await.unwrap());
    }
    socket.write_all(bytes).await.unwrap();
    let mut frames = Vec::new();
    within("the end", socket.read_to_end(&mut frames)).await.unwrap();
    assert_eq!(frames.first(), Some(&0x88), "a close frame: {frames:?}");
    u16::from_be_bytes([frames[2], frames[3]])
}

#[tokio::test(flavor = "multi_thread")]
async fn broken_rules_of_the_protocol_close_with_1002() {
    let server = Server::start().await;
    let id = server.bar_session().await;
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
    assert_eq!(
        closed_after_bytes(&server, &path, &[0x81, 0x81, 0, 0, 0, 0, 0xff]).await,
        1007
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_foreign_page_gets_no_websocket_and_a_protocol_is_agreed() {
    use tungstenite::client::IntoClientRequest as _;
    let server = Server::start().await;
    let id = server.bar_session().await;
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
