//! TLS, and certificates of clients.

use super::entry;
use crate::support::certificates::{Authority, Files, Identity, ask, replace_file, shake_hands};
use crate::support::server::*;
use pliant::server::CertificateField;
use pliant::server::grpc::client::DeformerClient;
use pliant::wire::pb;
use serde_json::Value;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio_rustls::rustls::ClientConfig;
use tonic::transport::Endpoint;

const HTTP1: &[&str] = &["http/1.1"];

/// The serial number that tells one certificate of the server from another.
async fn served_certificate(server: &Server, trusting: &Arc<ClientConfig>) -> Vec<u8> {
    let stream = shake_hands(server.address, Arc::clone(trusting))
        .await
        .expect("a handshake");
    let (_, facts) = stream.get_ref();
    facts.peer_certificates().expect("certificates")[0].to_vec()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_protocol_goes_over_tls_and_none_beside_it() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.server(1));
    let server = Server::with(|_, config| config.tls = Some(files.tls(None, CertificateField::CommonName))).await;
    let trusting = authority.trusting(None, HTTP1);
    let (status, _) = ask(server.address, trusting.clone(), "/v1/limits", None)
        .await
        .expect("an answer");
    assert_eq!(status, 200);

    let (address, over_http2) = (server.address, authority.trusting(None, &["h2"]));
    let connector = tower::service_fn(move |_| {
        let config = Arc::clone(&over_http2);
        async move { Ok::<_, std::io::Error>(hyper_util::rt::TokioIo::new(shake_hands(address, config).await?)) }
    });
    let endpoint = Endpoint::from_static("http://localhost");
    let channel = endpoint.connect_with_connector(connector);
    let mut grpc = DeformerClient::new(within("gRPC", channel).await.expect("a connection"));
    let limits = within("limits", grpc.get_limits(pb::GetLimitsRequest::default())).await;
    assert!(limits.expect("an answer").into_inner().vertices > 0);

    let session = server.manager_session().await;
    let stream = shake_hands(server.address, trusting).await.expect("a handshake");
    let url = format!("ws://localhost/v1/sessions/{session}/stream");
    let opened = within("a WebSocket", tokio_tungstenite::client_async(url, stream)).await;
    assert_eq!(opened.expect("a WebSocket").1.status(), 101);

    // Without it nothing is answered.
    let mut plain = tokio::net::TcpStream::connect(server.address)
        .await
        .expect("a connection");
    let asked = plain
        .write_all(b"GET /v1/limits HTTP/1.1\r\nhost: localhost\r\n\r\n")
        .await;
    asked.expect("sent");
    let mut answer = Vec::new();
    let _ = within("an end", plain.read_to_end(&mut answer)).await;
    assert!(!answer.starts_with(b"HTTP"), "{}", String::from_utf8_lossy(&answer));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_renewed_certificate_is_served_and_a_broken_one_is_not() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.server(1));
    let server = Server::with(|_, config| config.tls = Some(files.tls(None, CertificateField::CommonName))).await;
    let trusting = authority.trusting(None, HTTP1);
    let first = served_certificate(&server, &trusting).await;
    // A connection from before goes on.
    let mut before = shake_hands(server.address, trusting.clone())
        .await
        .expect("a handshake");
    let ask_on = b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n";
    let mut head = [0u8; 12];

    files.replace(&authority.server(2));
    eventually("the second certificate", async || {
        served_certificate(&server, &trusting).await != first
    })
    .await;
    let second = served_certificate(&server, &trusting).await;
    before.write_all(ask_on).await.expect("sent");
    within("an answer", before.read_exact(&mut head))
        .await
        .expect("an answer");
    assert_eq!(&head, b"HTTP/1.1 200");

    // The key of another certificate, and then no certificate at all: what was there stays.
    replace_file(&files.path("server.key"), &authority.server(3).key);
    let as_before = async || served_certificate(&server, &trusting).await == second;
    stays("the second certificate", Duration::from_millis(1500), as_before).await;
    replace_file(&files.path("server.pem"), "no certificate");
    stays("the second certificate", Duration::from_millis(1500), as_before).await;
    files.replace(&authority.server(4));
    eventually("the fourth certificate", async || {
        served_certificate(&server, &trusting).await != second
    })
    .await;
}

/// The tenant whose sessions a caller sees: each has one, labelled with its name. Else the status of the refusal.
async fn seen(server: &Server, trusting: Arc<ClientConfig>, token: Option<&str>) -> Result<String, u16> {
    let answer = ask(server.address, trusting, "/v1/sessions", token).await;
    let (status, body) = answer.map_err(|_| 0u16)?;
    if status != 200 {
        return Err(status);
    }
    let list: Value = serde_json::from_str(&body).expect("JSON");
    let sessions = list["sessions"].as_array().cloned().unwrap_or_default();
    let labels: Vec<String> = sessions.iter().map(|s| text(&s["label"])).collect();
    Ok(labels.join(","))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_is_the_tenant_that_its_certificate_names() {
    let (ours, theirs) = (Authority::new("ours"), Authority::new("theirs"));
    let files = Files::new(&ours.server(1));
    let uri = "spiffe://example.org/studio";
    for (field, named) in [(CertificateField::CommonName, "studio"), (CertificateField::Uri, uri)] {
        let server = Server::with(|_, config| {
            config.tls = Some(files.tls(Some(&ours), field));
            config.auth.tokens = vec![entry("bearer", "token")];
        })
        .await;
        for tenant in [named, "bearer", "default"] {
            server.labelled_session(tenant).await;
        }
        let known = ours.client(&["studio"], &[uri]);
        let ask_as =
            async |identity: Option<&Identity>, token| seen(&server, ours.trusting(identity, HTTP1), token).await;
        assert_eq!(ask_as(Some(&known), None).await.as_deref(), Ok(named));
        // A token counts before the certificate, and one that is wrong is not overlooked.
        assert_eq!(ask_as(Some(&known), Some("token")).await.as_deref(), Ok("bearer"));
        assert_eq!(ask_as(Some(&known), Some("wrong")).await, Err(401));
        assert_eq!(ask_as(None, None).await, Err(401));
        assert_eq!(ask_as(None, Some("token")).await.as_deref(), Ok("bearer"));
        for (what, nameless) in [
            ("no name", ours.client(&[], &[])),
            (
                "two names",
                ours.client(&["studio", "other"], &[uri, "spiffe://example.org/other"]),
            ),
        ] {
            assert_eq!(ask_as(Some(&nameless), None).await, Err(401), "{what}");
        }
        // Another authority's certificate of the same names does not get as far as a request.
        let forged = theirs.client(&["studio"], &[uri]);
        assert_eq!(ask_as(Some(&forged), None).await, Err(0));
        // Health is for everybody who can shake hands.
        let health = ask(server.address, ours.trusting(None, HTTP1), "/healthz", None).await;
        assert_eq!(health.expect("an answer").0, 200);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_authority_that_is_taken_away_opens_nothing_any_more() {
    let (ours, theirs) = (Authority::new("ours"), Authority::new("theirs"));
    let files = Files::new(&ours.server(1));
    let tls = files.tls(Some(&ours), CertificateField::CommonName);
    let server = Server::with(|_, config| config.tls = Some(tls)).await;
    let known = ours.client(&["studio"], &[]);
    // One client all the while, which would resume its session if it could.
    let trusting = ours.trusting(Some(&known), HTTP1);
    assert_eq!(seen(&server, trusting.clone(), None).await.as_deref(), Ok(""));
    replace_file(&files.path("clients.pem"), &theirs.pem);
    eventually("the other authority", async || {
        seen(&server, trusting.clone(), None).await.is_err()
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_server_tells_its_health_over_tls_too() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.server(1));
    let server = Server::with(|_, config| {
        config.tls = Some(files.tls(None, CertificateField::CommonName));
        config.connections = 1;
    })
    .await;
    let trusting = authority.trusting(None, HTTP1);
    let held = shake_hands(server.address, trusting.clone())
        .await
        .expect("a handshake");
    for (path, status) in [("/healthz", 200), ("/v1/limits", 503)] {
        let answer = ask(server.address, trusting.clone(), path, None).await;
        assert_eq!(answer.expect("an answer").0, status, "{path}");
    }
    drop(held);
}
