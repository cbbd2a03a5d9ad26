//! Connections: protocols, their number, and those that do not begin.

use crate::support::server::*;
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

#[tokio::test(flavor = "multi_thread")]
async fn http2_without_upgrade_speaks_the_same() {
    let server = Server::start().await;
    let client = reqwest::Client::builder()
        .no_proxy()
        .http2_prior_knowledge()
        .build()
        .unwrap();
    let answer = client.get(server.url("/v1/limits")).send().await.unwrap();
    assert_eq!(
        (answer.version(), answer.status().as_u16()),
        (reqwest::Version::HTTP_2, 200)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn one_connection_too_many_is_told_so() {
    let server = Server::with(|_, config| config.connections = 2).await;
    let silent = [
        TcpStream::connect(server.address).await.unwrap(),
        TcpStream::connect(server.address).await.unwrap(),
    ];
    let mut third = TcpStream::connect(server.address).await.unwrap();
    third.write_all(b"GET / HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    third.shutdown().await.unwrap();
    let mut told = String::new();
    within("the refusal", third.read_to_string(&mut told)).await.unwrap();
    assert!(
        told.starts_with("HTTP/1.1 503") && told.contains("retry-after: 1") && told.contains("UNAVAILABLE"),
        "{told}"
    );
    drop(silent);
    eventually("a free place", async || {
        http()
            .get(server.url("/healthz"))
            .send()
            .await
            .is_ok_and(|a| a.status() == 200)
    })
    .await;
    assert!(server.metric("pliant_connections_refused_total").await >= 1.0);
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
        // Closed or reset, and at most told that the time is over.
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
