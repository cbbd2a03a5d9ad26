//! Bearer tokens, on every transport.

use super::{entry, guarded, token_table};
use crate::support::certificates::replace_file;
use crate::support::program::ServedProgram;
use crate::support::server::*;
use pliant::server::config::{ConfigKeys, ServeSettings};
use pliant::wire::pb;
use reqwest::Method;
use serde_json::Value;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::{self, client::IntoClientRequest as _};
use tonic::Code;

/// What callers show, and whether it is known.
const SHOWN: [(Option<&str>, bool); 6] = [
    (None, false),
    (Some("Bearer nobody's"), false),
    (Some("Bearer expired"), false),
    (Some("Basic YTphCg=="), false),
    (Some("Bearer "), false),
    (Some("Bearer a"), true),
];

async fn get(server: &Server, path: &str, authorization: Option<&str>) -> reqwest::Response {
    let mut request = server.get(path);
    if let Some(shown) = authorization {
        request = request.header("authorization", shown);
    }
    request.answer().await
}

/// The status of a handshake, and the sub-protocol that was agreed.
async fn socket(server: &Server, path: &str, header: Option<(&'static str, &str)>) -> (u16, Option<String>) {
    let mut request = format!("ws://{}{path}", server.address)
        .into_client_request()
        .expect("a request");
    if let Some((name, value)) = header {
        request.headers_mut().insert(name, value.parse().expect("a value"));
    }
    let answer = match within("a handshake", tokio_tungstenite::connect_async(request)).await {
        Ok((_, answer)) => answer,
        Err(tungstenite::Error::Http(answer)) => *answer,
        Err(other) => panic!("{other}"),
    };
    let agreed = answer.headers().get("sec-websocket-protocol");
    let agreed = agreed.map(|name| name.to_str().expect("ASCII").to_owned());
    (answer.status().as_u16(), agreed)
}

#[tokio::test(flavor = "multi_thread")]
async fn every_transport_asks_who_is_there() {
    let server = guarded().await;
    let mut grpc = server.grpc().await;
    for (shown, known) in SHOWN {
        let answer = get(&server, "/v1/limits", shown).await;
        assert_eq!(answer.status(), if known { 200 } else { 401 }, "{shown:?}");
        if !known {
            assert_eq!(answer.headers()["www-authenticate"], "Bearer realm=\"pliant\"");
            let reply: Value = answer.json().await.expect("a problem");
            assert_eq!(reply["code"], "UNAUTHENTICATED");
        }
        let mut call = tonic::Request::new(pb::GetLimitsRequest::default());
        if let Some(shown) = shown {
            call.metadata_mut()
                .insert("authorization", shown.parse().expect("ASCII"));
        }
        let answer = within("gRPC", grpc.get_limits(call)).await;
        assert_eq!(
            answer.err().map(|s| s.code()),
            (!known).then_some(Code::Unauthenticated),
            "{shown:?}"
        );

        let mut web = server
            .post("/pliant.v1.Deformer/GetLimits")
            .header("content-type", "application/grpc-web+proto")
            .body(vec![0u8; 5]);
        if let Some(shown) = shown {
            web = web.header("authorization", shown);
        }
        let answer = web.answer().await;
        let status = answer
            .headers()
            .get("grpc-status")
            .map(|s| s.to_str().expect("a number").to_owned());
        assert_eq!(status.as_deref(), (!known).then_some("16"), "{shown:?}");

        // A session that is not there is 404 for who may ask.
        let header = shown.map(|shown| ("authorization", shown));
        let (status, _) = socket(&server, "/v1/sessions/none/stream", header).await;
        assert_eq!(status, if known { 404 } else { 401 }, "{shown:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_gives_its_websocket_the_token_as_a_sub_protocol() {
    let server = guarded().await;
    let opened = server.post("/v1/sessions").bearer_auth("a").body(bar_obj(8)).send();
    let session: Value = within("a session", opened)
        .await
        .expect("an answer")
        .json()
        .await
        .expect("JSON");
    let path = format!("/v1/sessions/{}/stream", text(&session["id"]));
    let named = |protocols| Some(("sec-websocket-protocol", protocols));
    // The token is not what is agreed: it would come back in the answer.
    let agreed = socket(&server, &path, named("pliant.v1, pliant.bearer.a")).await;
    assert_eq!(agreed, (101, Some("pliant.v1".to_owned())));
    assert_eq!(socket(&server, &path, named("pliant.bearer.a, pliant.v1")).await.0, 101);
    for (token, status) in [("nobody's", 401), ("b", 404)] {
        let protocols = format!("pliant.v1, pliant.bearer.{token}");
        let asked = Some(("sec-websocket-protocol", protocols.as_str()));
        assert_eq!(socket(&server, &path, asked).await.0, status, "{token}");
    }
    for query in ["token=a", "access_token=a", "authorization=Bearer%20a"] {
        let (status, _) = socket(&server, &format!("{path}?{query}"), None).await;
        assert_eq!(status, 401, "{query}");
        let answer = get(&server, &format!("/v1/limits?{query}"), None).await;
        assert_eq!(answer.status(), 401, "{query}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_asks_is_looked_at_before_the_session_and_the_body() {
    let server = guarded().await;
    for path in ["/v1/sessions", "/v1/sessions/none/handles", "/nothing/here"] {
        // The body is announced and never sent.
        let mut stream = TcpStream::connect(server.address).await.expect("a connection");
        let head = format!("POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-length: 1000000\r\n\r\n");
        stream.write_all(head.as_bytes()).await.expect("sent");
        let mut answer = [0u8; 12];
        within("an answer", stream.read_exact(&mut answer))
            .await
            .expect("an answer");
        assert_eq!(&answer, b"HTTP/1.1 401", "{path}");
    }
    let mut grpc = server.grpc().await;
    let never = futures::stream::pending();
    let refused = within("a refusal", grpc.create_session(never))
        .await
        .expect_err("nobody");
    assert_eq!(refused.code(), Code::Unauthenticated);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_the_same_for_everybody_needs_no_token() {
    let server = guarded().await;
    for path in ["/healthz", "/readyz", "/", "/docs", "/openapi.json"] {
        assert_eq!(get(&server, path, None).await.status(), 200, "{path}");
    }
    let guarded = "/v1/limits /v1/sessions /v1/sample.glb /metrics /metrics/ /healthz/ /nothing";
    for path in guarded.split(' ') {
        assert_eq!(get(&server, path, None).await.status(), 401, "{path}");
    }
    let channel = server.channel().await;
    let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
    let asked = tonic_health::pb::HealthCheckRequest::default();
    within("health", health.check(asked)).await.expect("healthy");
    // Counts are of all tenants.
    for (token, status) in [("a", 403), ("watcher", 200)] {
        let answer = get(&server, "/metrics", Some(&format!("Bearer {token}"))).await;
        assert_eq!(answer.status(), status, "{token}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_may_ask_whether_it_may_and_reads_that_it_may_not() {
    let server = guarded().await;
    let origin = "http://localhost:5173";
    let preflight = http()
        .request(Method::OPTIONS, server.url("/v1/limits"))
        .header("origin", origin)
        .header("access-control-request-method", "GET")
        .header("access-control-request-headers", "authorization");
    let answer = preflight.answer().await;
    assert_eq!(answer.status(), 200);
    assert_eq!(answer.headers()["access-control-allow-headers"], "authorization");
    let refused = server.get("/v1/limits").header("origin", origin).answer().await;
    assert_eq!(refused.status(), 401);
    assert_eq!(refused.headers()["access-control-allow-origin"], origin);
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_follow_their_file_and_a_broken_one_changes_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("pliant.toml");
    let lines = |token: &str| {
        let digest: String = entry("a", token).sha256.iter().map(|b| format!("{b:02x}")).collect();
        format!("[[auth.tokens]]\ntenant = \"a\"\nsha256 = \"{digest}\"\n")
    };
    replace_file(&file, &lines("first"));
    let settings = ServeSettings::load(Some(&file), &ConfigKeys::default()).expect("a configuration");
    let server = Server::with(|_, config| config.auth = settings.server.auth).await;
    let status = async |token: &str| {
        let shown = format!("Bearer {token}");
        get(&server, "/v1/limits", Some(&shown)).await.status()
    };
    assert_eq!(status("first").await, 200);

    replace_file(&file, &(lines("first") + &lines("second")));
    eventually("a second token", async || status("second").await == 200).await;
    assert_eq!(status("first").await, 200);

    // A token that is taken away shows when the file was read; the broken one before it was read by then.
    replace_file(&file, "[[auth.tokens]]\ntenant = 7\n");
    let is_known = async || status("second").await == 200;
    stays("the second token", std::time::Duration::from_millis(2500), is_known).await;
    replace_file(&file, &lines("second"));
    eventually("the first token gone", async || status("first").await == 401).await;
    assert_eq!(status("second").await, 200);

    // No one is known any more; that opens nothing.
    replace_file(&file, "");
    eventually("no token", async || status("second").await == 401).await;
    assert_eq!(get(&server, "/v1/limits", None).await.status(), 401);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_that_counts_from_the_next_start_on_is_reported_once_when_it_changes() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("pliant.toml");
    let token = token_table("a", "first", "a");
    replace_file(&file, &format!("history = 7\n{token}"));
    let arguments = ["--config", file.to_str().expect("UTF-8")];
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &arguments);
    let reply = || {
        let log = server.log();
        log.lines()
            .filter(|line| line.contains("from the next start on"))
            .count()
    };
    let followed = async |token: &str| {
        let known = async || {
            let asked = server.get("/v1/limits").bearer_auth(token).send();
            within("an answer", asked)
                .await
                .is_ok_and(|answer| answer.status() == 200)
        };
        eventually("another token", known).await;
    };
    // Tokens are followed, and that is not such a change.
    replace_file(
        &file,
        &format!("history = 7\n{token}{}", token_table("a", "second", "a")),
    );
    followed("second").await;
    assert_eq!(reply(), 0, "{}", server.log());
    let tokens = token + &token_table("a", "third", "a");
    replace_file(&file, &format!("history = 8\nsessions = 3\n{tokens}"));
    followed("third").await;
    eventually("the keys", async || reply() > 0).await;
    assert!(server.log().contains("history, sessions"), "{}", server.log());
    replace_file(
        &file,
        &format!("history = 8\nsessions = 3\n{tokens}{}", token_table("a", "fourth", "a")),
    );
    followed("fourth").await;
    assert_eq!(reply(), 1, "{}", server.log());
}
