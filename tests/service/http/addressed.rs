//! A web page whose name points at this machine (DNS rebinding) gets nothing, by whatever protocol it comes.

use crate::support::server::*;
use pliant::server::Hosts;
use reqwest::Method;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::{self, client::IntoClientRequest as _};

const EVIL: &str = "evil.example:7411";
const ORIGIN: &str = "http://evil.example:7411";

#[tokio::test(flavor = "multi_thread")]
async fn a_name_that_is_not_the_servers_opens_nothing() {
    let server = Server::start().await;
    let id = server.bar_session().await;
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
            let told = answer.text().await.unwrap();
            assert!(
                told.contains("this server is not \\\"evil.example\\\"") || method == Method::HEAD,
                "{told}"
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
        let mut socket = TcpStream::connect(server.address).await.unwrap();
        let request = format!("{head}connection: close\r\n\r\n");
        socket.write_all(request.as_bytes()).await.unwrap();
        let mut told = String::new();
        within("an answer", socket.read_to_string(&mut told)).await.unwrap();
        assert!(told.contains(" 400 ") && told.contains("Host header"), "{head}: {told}");
    }
}
