//! What a server refuses to be started as, and how a token is made.

use super::entry;
use crate::support::certificates::{Authority, Files, Identity, ask, replace_file, shake_hands};
use crate::support::commands::Workplace;
use crate::support::program::ServedProgram;
use crate::support::server::{AnsweredCall as _, *};
use pliant::server::CertificateField;
use pliant::server::grpc::client::DeformerClient;
use pliant::wire::pb;
use serde_json::Value;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio_rustls::rustls::ClientConfig;
use tonic::transport::Endpoint;

/// The status that a server's limits are answered with.
async fn status(server: &ServedProgram, token: Option<&str>) -> u16 {
    let url = server.url.replace("0.0.0.0", "127.0.0.1");
    let request = http().get(format!("{url}/v1/limits"));
    match token {
        Some(token) => request.bearer_auth(token).status().await,
        None => request.status().await,
    }
}

/// What opens a server to others, as a refusal lists it.
const OPENINGS: [&str; 5] = [
    "[[auth.tokens]]",
    "[auth.jwt]",
    "tls_client_ca",
    "--insecure-open",
    "flag --listen",
];

#[tokio::test]
async fn an_address_that_others_reach_needs_to_know_who_calls() {
    let folder = Workplace::empty();
    for listen in ["0.0.0.0:0", "[::]:0", "192.0.2.7:0"] {
        let ran = folder.refused(&["serve", "--listen", listen], &OPENINGS);
        assert_eq!(ran.out, "", "{listen}");
    }
    let open = ServedProgram::start_in_memory(folder.at("log"), &["--listen", "0.0.0.0:0", "--insecure-open"]);
    assert_eq!(status(&open, None).await, 200);
}

#[tokio::test]
async fn a_token_that_the_program_makes_is_known_by_its_lines() {
    let folder = Workplace::empty();
    let made = |arguments: &[&str]| {
        let out = folder.done(arguments).out;
        let made = out
            .split_once("\n\n")
            .map(|(token, lines)| (token.to_owned(), lines.to_owned()));
        made.expect("a token, an empty line and what to configure")
    };
    let (token, lines) = made(&["token", "st\"udio", "--name", "anna", "--expires", "2999-01-31"]);
    assert!(
        !lines.contains(&token) && lines.contains("expires = \"2999-01-31T00:00:00Z\""),
        "{lines}"
    );
    let (other, more) = made(&["token", "other", "--metrics"]);
    assert_ne!(token, other);
    folder.put("pliant.toml", lines + &more);
    let config = folder.at("pliant.toml").display().to_string();
    let arguments = ["--listen", "0.0.0.0:0", "--config", &config];
    let server = ServedProgram::start_in_memory(folder.at("log"), &arguments);
    for known in [&*token, &other] {
        assert_eq!(status(&server, Some(known)).await, 200);
    }
    assert_eq!(status(&server, Some("pliant_")).await, 401);
    assert_eq!(status(&server, None).await, 401);

    let ran = folder.refused("token a --expires 2020-01-01", &["--expires", "has passed"]);
    assert_eq!(ran.out, "");
    folder.refused("token a --expires tomorrow", &["2027-01-31T12:00:00Z"]);
}

#[test]
fn what_is_wrong_with_the_files_is_reported_before_anything_is_served() {
    let folder = Workplace::empty();
    let authority = Authority::new("ours");
    let (one, other) = (authority.server(1), authority.server(2));
    let files = Files::new(&one);
    let path = |name: &str| files.path(name).display().to_string();
    std::fs::write(files.path("other.key"), &other.key).expect("written");
    let (certificate, key, other) = (path("server.pem"), path("server.key"), path("other.key"));
    let cases: [(&[&str], &[&str]); 6] = [
        (&["--tls-certificate", &certificate], &["tls_key"]),
        (&["--tls-key", &key], &["tls_certificate"]),
        (&["--tls-client-ca", &certificate], &["tls_client_ca", "tls_key"]),
        (
            &["--tls-certificate", &certificate, "--tls-key", &other],
            &["server.pem", "other.key"],
        ),
        (
            &["--tls-certificate", &key, "--tls-key", &key],
            &["server.key", "no certificate"],
        ),
        (
            &["--tls-certificate", "none.pem", "--tls-key", &key],
            &["none.pem", "No such file"],
        ),
    ];
    for (flags, words) in cases {
        folder.refused(&[&["serve", "--listen", "127.0.0.1:0"], flags].concat(), words);
    }
    let secret = "pliant_something-secret";
    for (lines, words) in [
        (
            format!("tenant = \"a\"\nsha256 = \"{secret}\""),
            &["auth.tokens[0].sha256", "64 hexadecimal"][..],
        ),
        (
            "tenant = \"\"\nsha256 = \"00\"".into(),
            &["auth.tokens[0].tenant", "1 to 256"],
        ),
        ("tenant = \"a\"".into(), &["sha256", "missing"]),
        (
            "tenant = \"a\"\nsha256 = \"00\"\nexpire = \"x\"".into(),
            &["expire", "expires", "no such key"],
        ),
    ] {
        folder.put("bad.toml", format!("[[auth.tokens]]\n{lines}\n"));
        let ran = folder.refused("serve --listen 127.0.0.1:0 --config bad.toml", words);
        assert!(
            ran.last().contains("bad.toml") && !ran.last().contains(secret),
            "{}",
            ran.last()
        );
    }
}

const HTTP1: &[&str] = &["http/1.1"];

/// The serial number that distinguishes one certificate of the server from another.
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
async fn a_full_server_reports_its_health_over_tls_too() {
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
