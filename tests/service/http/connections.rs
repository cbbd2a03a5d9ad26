//! Connections: protocols, their number, and those that do not begin.

use crate::support::server::*;
use pliant::server::{Hosts, ServerConfig};
use reqwest::Method;
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;

#[tokio::test(flavor = "multi_thread")]
async fn http2_without_upgrade_speaks_the_same() {
    let server = Server::start().await;
    let client = reqwest::Client::builder()
        .no_proxy()
        .http2_prior_knowledge()
        .build()
        .unwrap();
    let answer = client.get(server.url("/v1/limits")).answer().await;
    assert_eq!(
        (answer.version(), answer.status().as_u16()),
        (reqwest::Version::HTTP_2, 200)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn one_connection_too_many_is_reported() {
    let server = Server::with(|_, config| config.connections = 2).await;
    let silent = [
        TcpStream::connect(server.address).await.unwrap(),
        TcpStream::connect(server.address).await.unwrap(),
    ];
    let mut third = TcpStream::connect(server.address).await.unwrap();
    third.write_all(b"GET / HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    third.shutdown().await.unwrap();
    let mut reply = String::new();
    within("the refusal", third.read_to_string(&mut reply)).await.unwrap();
    assert!(
        reply.starts_with("HTTP/1.1 503") && reply.contains("retry-after: 1") && reply.contains("UNAVAILABLE"),
        "{reply}"
    );
    drop(silent);
    eventually("a free place", async || {
        server.get("/healthz").send().await.is_ok_and(|a| a.status() == 200)
    })
    .await;
    assert!(server.metric("pliant_connections_refused_total").await >= 1.0);
}

/// Sends bytes on a connection of their own; all that comes back.
async fn sent_alone(server: &Server, bytes: &str) -> String {
    let mut socket = TcpStream::connect(server.address).await.unwrap();
    socket.write_all(bytes.as_bytes()).await.unwrap();
    let mut reply = String::new();
    within("an answer", socket.read_to_string(&mut reply)).await.unwrap();
    reply
}

/// What a connection of its own is answered to a request for a path.
async fn asked_alone(server: &Server, path: &str) -> String {
    let head = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
    sent_alone(server, &head).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_crowd_does_not_make_the_server_look_ill() {
    let server = Server::with(|_, config| config.connections = 1).await;
    let silent = TcpStream::connect(server.address).await.unwrap();
    for (path, answer) in [
        ("/healthz", "HTTP/1.1 200"),
        ("/readyz", "HTTP/1.1 200"),
        ("/v1/limits", "HTTP/1.1 503"),
    ] {
        let reply = asked_alone(&server, path).await;
        assert!(reply.starts_with(answer), "{path}: {reply}");
    }
    drop(silent);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_has_its_share_of_connections() {
    let server = Server::with(|_, config| config.connections_per_peer = 2).await;
    let first = TcpStream::connect(server.address).await.unwrap();
    let second = TcpStream::connect(server.address).await.unwrap();
    assert!(asked_alone(&server, "/v1/limits").await.starts_with("HTTP/1.1 503"));
    drop(first);
    eventually("a free place", async || {
        asked_alone(&server, "/v1/limits").await.starts_with("HTTP/1.1 200")
    })
    .await;
    drop(second);
}

/// What is answered to an upload whose bytes come one by one.
async fn trickled(server: &Server) -> String {
    let mut socket = TcpStream::connect(server.address).await.unwrap();
    let head = "POST /v1/sessions HTTP/1.1\r\nhost: localhost\r\ncontent-length: 100000\r\n\r\n";
    socket.write_all(head.as_bytes()).await.unwrap();
    let (mut from, mut to) = socket.into_split();
    let sending = tokio::spawn(async move {
        let mut ticks = pace(Duration::from_millis(20));
        while to.write_all(b"#").await.is_ok() {
            ticks.tick().await;
        }
    });
    let mut reply = vec![0; 4096];
    let count = within("an answer", from.read(&mut reply)).await.unwrap();
    sending.abort();
    String::from_utf8_lossy(&reply[..count]).into_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_that_trickles_is_given_up() {
    let hasty = |config: &mut ServerConfig| {
        config.keepalive_interval = Duration::from_millis(300);
        config.keepalive_timeout = Duration::from_millis(200);
    };
    let slow = Server::with(|_, config| hasty(config)).await;
    let reply = trickled(&slow).await;
    assert!(
        reply.starts_with("HTTP/1.1 408") && reply.contains("slower than 4096 bytes"),
        "{reply}"
    );
    let long = Server::with(|_, config| {
        hasty(config);
        config.upload_rate = 1;
        config.upload_deadline = Duration::from_millis(700);
    })
    .await;
    let reply = trickled(&long).await;
    assert!(
        reply.starts_with("HTTP/1.1 408") && reply.contains("longer than 700ms"),
        "{reply}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_that_does_not_begin_is_closed() {
    let server = Server::with(|_, config| config.header_timeout = Duration::from_millis(200)).await;
    for beginning in [
        "",
        "GET / HT",
        "PRI * HTTP/2.0\r\n",
        "GET / HTTP/1.1\r\nhost: example.org\r\nx-slow: ",
    ] {
        let mut socket = TcpStream::connect(server.address).await.unwrap();
        socket.write_all(beginning.as_bytes()).await.unwrap();
        let mut rest = Vec::new();
        // Closed or reset, and at most with an answer that the time is over.
        let _ = within(
            &format!("the end of a connection that said {beginning:?}"),
            socket.read_to_end(&mut rest),
        )
        .await;
        assert!(
            rest.is_empty() || rest.starts_with(b"HTTP/1.1 408"),
            "{beginning:?}: {}",
            String::from_utf8_lossy(&rest)
        );
    }
}

/// Sends what is refused before its body is read, as people do.
#[tokio::test(flavor = "multi_thread")]
async fn curl_shows_each_refusal_over_http2() {
    let version = std::process::Command::new("curl").arg("--version").output();
    let speaks_http2 = version.is_ok_and(|v| String::from_utf8_lossy(&v.stdout).contains("HTTP2"));
    if !speaks_http2 {
        println!("SKIPPED: there is no curl that speaks HTTP/2; refusals over HTTP/2 were not seen by it");
        return;
    }
    let server = Server::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let body = folder.path().join("body");
    for size in [10, 300_000, 3_000_000] {
        std::fs::write(&body, vec![b'x'; size]).expect("written");
        for path in ["/v1/nope", "/v1/sessions?format=none"] {
            for _ in 0..6 {
                let mut curl = std::process::Command::new("curl");
                curl.args([
                    "-s",
                    "--http2-prior-knowledge",
                    "-o",
                    "-",
                    "-w",
                    " %{http_code}",
                    "--data-binary",
                ])
                .arg(format!("@{}", body.display()))
                .arg(server.url(path));
                let ran = tokio::task::spawn_blocking(move || curl.output());
                let ran = within("curl", ran).await.expect("it ends").expect("curl runs");
                let reply = String::from_utf8_lossy(&ran.stdout).into_owned();
                assert!(
                    ran.status.success(),
                    "{size} bytes to {path}: {:?}, {reply}",
                    ran.status
                );
                assert!(
                    reply.contains("urn:pliant:problem") && !reply.ends_with("200"),
                    "{size} bytes to {path}: {reply}"
                );
            }
        }
    }
}

const EVIL: &str = "evil.example:7411";
const ORIGIN: &str = "http://evil.example:7411";

#[tokio::test(flavor = "multi_thread")]
async fn a_name_that_is_not_the_servers_opens_nothing() {
    let (server, id) = Server::start_with_bar().await;
    let session = format!("/v1/sessions/{id}");
    for (method, path) in [
        (Method::POST, "/v1/sessions"),
        (Method::GET, "/v1/sessions"),
        (Method::GET, &*format!("{session}/model")),
        (Method::GET, "/"),
        (Method::GET, "/healthz"),
        (Method::DELETE, &*session),
        (Method::OPTIONS, &*session),
    ] {
        for origin in [Some(ORIGIN), None] {
            let mut request = http().request(method.clone(), server.url(path)).header("host", EVIL);
            if let Some(origin) = origin {
                request = request
                    .header("origin", origin)
                    .header("access-control-request-method", "DELETE");
            }
            let answer = request.body(bar_obj(4)).answer().await;
            assert_eq!(answer.status(), 403, "{method} {path} {origin:?}");
            let allowing = answer
                .headers()
                .keys()
                .find(|name| name.as_str().starts_with("access-control-"));
            assert_eq!(allowing, None, "{method} {path}");
            assert!(answer.headers().contains_key("x-request-id"));
            let reply = answer.text().await.unwrap();
            assert!(
                reply.contains("this server is not \\\"evil.example\\\"") || method == Method::HEAD,
                "{reply}"
            );
        }
    }
    let mut stream = format!("ws://{}{session}/stream", server.address)
        .into_client_request()
        .unwrap();
    stream.headers_mut().insert("host", EVIL.parse().unwrap());
    stream.headers_mut().insert("origin", ORIGIN.parse().unwrap());
    let refused = tokio_tungstenite::connect_async(stream).await.map(|_| ()).unwrap_err();
    assert!(matches!(refused, tungstenite::Error::Http(answer) if answer.status() == 403));
    let call = server
        .post("/pliant.v1.Deformer/DeleteSession")
        .header("host", EVIL)
        .header("content-type", "application/grpc-web+proto")
        .body(vec![0u8; 5]);
    assert_eq!(call.answer().await.headers()["grpc-status"], "7");
    let still_there = server.get(&session).answer().await;
    assert_eq!(still_there.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_foreign_page_may_not_even_look() {
    let server = Server::start().await;
    for (origin, status) in [
        ("https://evil.example", 403),
        ("null", 403),
        ("http://localhost:5173", 200),
    ] {
        let answer = server.get("/v1/limits").header("origin", origin).answer().await;
        assert_eq!(answer.status(), status, "{origin}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn names_are_what_the_operator_lists() {
    let words = ["mesh.example.org".to_owned()];
    let server = Server::with(|_, config| config.hosts = Hosts::parse(&words).unwrap()).await;
    for (host, status) in [
        ("mesh.example.org", 200),
        ("mesh.example.org:443", 200),
        ("localhost", 403),
    ] {
        let answer = server.get("/v1/limits").header("host", host).answer().await;
        assert_eq!(answer.status(), status, "{host}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_names_no_host_or_two_is_malformed() {
    let server = Server::start().await;
    for head in [
        "GET /v1/limits HTTP/1.1\r\n",
        "GET /v1/limits HTTP/1.0\r\n",
        "GET /v1/limits HTTP/1.1\r\nhost: localhost\r\nhost: localhost\r\n",
        "GET /v1/limits HTTP/1.1\r\nhost: a b\r\n",
    ] {
        let reply = sent_alone(&server, &format!("{head}connection: close\r\n\r\n")).await;
        assert!(
            reply.contains(" 400 ") && reply.contains("Host header"),
            "{head}: {reply}"
        );
    }
}
