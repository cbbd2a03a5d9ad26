//! Tokens that an issuer signs.

use crate::support::certificates::replace_file;
use crate::support::certificates::{Signer, in_seconds, key_set, token_without_key};
use crate::support::server::*;
use axum::Router;
use axum::routing::get;
use jsonwebtoken::Algorithm;
use pliant::server::auth::{JwtConfig, KeySource};
use pliant::server::config::{ConfigKeys, ServeSettings};
use pliant::wire::pb;
use serde_json::{Value, json};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::TcpListener;

fn believing(keys: KeySource) -> JwtConfig {
    JwtConfig {
        keys,
        issuer: "https://issuer.example".into(),
        audiences: vec!["pliant".into(), "other".into()],
        algorithms: vec![Algorithm::EdDSA, Algorithm::ES256, Algorithm::RS256, Algorithm::PS256],
        tenant_claim: "studio".into(),
        leeway: Duration::from_secs(60),
        refresh: Duration::from_secs(3600),
        unknown_key_pause: Duration::from_secs(3600),
    }
}

/// Claims that hold.
fn claims() -> Value {
    json!({"iss": "https://issuer.example", "aud": "pliant", "exp": in_seconds(300), "sub": "anna", "studio": "north"})
}

/// The same with one of them changed, or taken away.
fn with(name: &str, value: Value) -> Value {
    let mut claims = claims();
    match value {
        Value::Null => {
            claims.as_object_mut().expect("an object").remove(name);
        }
        value => claims[name] = value,
    }
    claims
}

/// Status and detail of a call, or the labels of the sessions that it sees.
async fn seen(server: &Server, token: &str) -> (u16, String) {
    let answer = server.get("/v1/sessions").bearer_auth(token).answer().await;
    let status = answer.status().as_u16();
    let body: Value = answer.json().await.expect("JSON");
    let labels = body["sessions"]
        .as_array()
        .map(|all| all.iter().map(|s| text(&s["label"])).collect());
    (status, labels.unwrap_or_else(|| text(&body["detail"])))
}

async fn server_with_file(signers: &[&Signer]) -> (Server, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("keys.json");
    std::fs::write(&path, key_set(signers)).expect("written");
    let config = believing(KeySource::File(path));
    let server = Server::with(|_, server| server.auth.jwt = Some(config)).await;
    for tenant in ["north", "default"] {
        server.labelled_session(tenant).await;
    }
    (server, folder)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_holds_is_the_tenant_that_it_names() {
    let (ed, ec, rsa) = (Signer::ed25519("ed"), Signer::p256("ec"), Signer::rsa("rsa"));
    let (server, _folder) = server_with_file(&[&ed, &ec, &rsa]).await;
    let north = (200, "north".to_owned());
    for (signer, algorithm) in [(&ed, "EdDSA"), (&ec, "ES256"), (&rsa, "RS256"), (&rsa, "PS256")] {
        assert_eq!(
            seen(&server, &signer.token(algorithm, &claims())).await,
            north,
            "{algorithm}"
        );
    }
    for (name, value) in [
        ("aud", json!(["elsewhere", "other"])),
        // Clocks differ by less than the leeway.
        ("exp", json!(in_seconds(-30))),
        ("nbf", json!(in_seconds(30))),
        ("sub", Value::Null),
    ] {
        assert_eq!(
            seen(&server, &ed.token("EdDSA", &with(name, value.clone()))).await,
            north,
            "{name}: {value}"
        );
    }
    // One key fits: it need not be named.
    let nameless = ed.signed(&json!({"alg": "EdDSA"}), &claims());
    assert_eq!(seen(&server, &nameless).await, north);

    let call = with_token(pb::ListSessionsRequest::default(), &ed.token("EdDSA", &claims()));
    let listed = within("gRPC", server.grpc().await.list_sessions(call))
        .await
        .expect("an answer");
    assert_eq!(listed.into_inner().sessions.len(), 1);
}

/// What is wrong | the claim | its value, null where it is taken away | words of the refusal.
const WRONG_CLAIMS: &str = r#"
another issuer                 | iss    | "https://evil.example" | another issuer
no issuer                      | iss    | null        | lacks the claim "iss"
another audience               | aud    | "elsewhere" | another audience
no audience                    | aud    | null        | lacks the claim "aud"
no end                         | exp    | null        | lacks the claim "exp"
an end that is not a time      | exp    | "tomorrow"  | lacks the claim "exp"
no tenant                      | studio | null        | does not name a tenant
a tenant that is not a text    | studio | 7           | does not name a tenant
a tenant without a name        | studio | ""          | does not name a tenant
"#;

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_does_not_hold_names_no_tenant() {
    let (ed, ec, rsa) = (Signer::ed25519("ed"), Signer::p256("ec"), Signer::rsa("rsa"));
    let (server, _folder) = server_with_file(&[&ed, &rsa]).await;
    let good = ed.token("EdDSA", &claims());
    let parts: Vec<&str> = good.split('.').collect();
    let others: Vec<String> = ed
        .token("EdDSA", &with("studio", json!("default")))
        .split('.')
        .map(str::to_owned)
        .collect();
    let secret = rsa.published().to_string();
    let changed = |name: &str, value: Value| ed.token("EdDSA", &with(name, value));
    let cases = [
        (
            "no algorithm",
            token_without_key(&json!({"alg": "none", "kid": "ed"}), &claims(), None),
            "cannot be read",
        ),
        (
            "a published key as a secret",
            token_without_key(
                &json!({"alg": "HS256", "kid": "rsa"}),
                &claims(),
                Some(secret.as_bytes()),
            ),
            "HS256, which is not allowed",
        ),
        (
            "an algorithm that is not allowed",
            rsa.token("RS512", &claims()),
            "RS512, which is not allowed",
        ),
        (
            "another kind of key",
            rsa.signed(&json!({"alg": "RS256", "kid": "ed"}), &claims()),
            "key that this server does not know",
        ),
        (
            "a key that is not published",
            ec.token("ES256", &claims()),
            "key that this server does not know",
        ),
        (
            "a key of that name that is another",
            Signer::ed25519("ed").token("EdDSA", &claims()),
            "signature does not hold",
        ),
        (
            "other claims",
            format!("{}.{}.{}", parts[0], others[1], parts[2]),
            "signature does not hold",
        ),
        (
            "no signature",
            format!("{}.{}.", parts[0], parts[1]),
            "signature does not hold",
        ),
        (
            "an end that is past",
            changed("exp", json!(in_seconds(-120))),
            "expired",
        ),
        (
            "a beginning that is to come",
            changed("nbf", json!(in_seconds(120))),
            "not valid yet",
        ),
        (
            "a header that asks for more",
            ed.signed(&json!({"alg": "EdDSA", "kid": "ed", "crit": ["exp"]}), &claims()),
            "crit",
        ),
        ("points alone", "..".to_owned(), "cannot be read"),
        ("no such token", "pliant_abc".to_owned(), "not known"),
    ];
    let of_claims = rows(WRONG_CLAIMS).map(|[what, claim, value, words]| {
        let value = serde_json::from_str(value).expect("JSON");
        (what, changed(claim, value), words)
    });
    for (what, token, words) in cases.into_iter().chain(of_claims) {
        let (status, reply) = seen(&server, &token).await;
        assert_eq!(status, 401, "{what}: {reply}");
        assert!(reply.contains(words), "{what}: {reply}");
    }
    assert_eq!(seen(&server, &good).await.0, 200);
}

/// Publishes what its text says, and counts how often it was asked; an empty text is a failure.
struct Publisher {
    text: Arc<Mutex<String>>,
    asked: Arc<AtomicUsize>,
    url: String,
}

impl Publisher {
    async fn start(text: String) -> Self {
        let (text, asked) = (Arc::new(Mutex::new(text)), Arc::new(AtomicUsize::new(0)));
        let shared = (Arc::clone(&text), Arc::clone(&asked));
        let answer = async move || {
            shared.1.fetch_add(1, Ordering::Relaxed);
            let text = shared.0.lock().expect("no panic").clone();
            let status = if text.is_empty() { 500 } else { 200 };
            (http::StatusCode::from_u16(status).expect("a status"), text)
        };
        let router = Router::new().route("/keys", get(answer));
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let url = format!("http://{}/keys", listener.local_addr().expect("an address"));
        tokio::spawn(async move { axum::serve(listener, router).await });
        Self { text, asked, url }
    }

    fn publish(&self, text: String) {
        *self.text.lock().expect("no panic") = text;
    }

    fn asked(&self) -> usize {
        self.asked.load(Ordering::Relaxed)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_key_is_fetched_when_it_is_first_used_but_not_for_everybody() {
    let (old, new) = (Signer::ed25519("old"), Signer::ed25519("new"));
    let publisher = Publisher::start(key_set(&[&old])).await;
    let mut config = believing(KeySource::Url(publisher.url.clone(), None));
    config.unknown_key_pause = Duration::from_secs(3);
    let server = Server::with(|_, server| server.auth.jwt = Some(config)).await;
    eventually("the first keys", async || {
        seen(&server, &old.token("EdDSA", &claims())).await.0 == 200
    })
    .await;
    let first = publisher.asked();

    publisher.publish(key_set(&[&old, &new]));
    // Names that are made up, many at a time, cost one fetch a while at most.
    let begun = std::time::Instant::now();
    let made_up = Signer::ed25519("made up");
    let token = made_up.token("EdDSA", &claims());
    let flood = (0..50).map(|_| seen(&server, &token));
    for (status, reply) in futures::future::join_all(flood).await {
        assert_eq!(status, 401, "{reply}");
    }
    let most = begun.elapsed().as_secs() as usize / 3 + 1;
    assert!(
        publisher.asked() - first <= most,
        "{} fetches",
        publisher.asked() - first
    );
    eventually("the new key", async || {
        seen(&server, &new.token("EdDSA", &claims())).await.0 == 200
    })
    .await;

    // An issuer that is down, or publishes something else, takes nothing away.
    for text in ["", "no keys", r#"{"keys": []}"#] {
        publisher.publish(text.to_owned());
        let before = publisher.asked();
        eventually("another fetch", async || {
            assert_eq!(seen(&server, &token).await.0, 401);
            publisher.asked() > before
        })
        .await;
        assert_eq!(seen(&server, &old.token("EdDSA", &claims())).await.0, 200, "{text:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_any_keys_every_caller_is_asked_to_come_back() {
    let signer = Signer::ed25519("key");
    let publisher = Publisher::start(String::new()).await;
    let mut config = believing(KeySource::Url(publisher.url.clone(), None));
    config.unknown_key_pause = Duration::from_secs(1);
    let server = Server::with(|_, server| server.auth.jwt = Some(config)).await;
    let token = signer.token("EdDSA", &claims());
    let answer = server.get("/v1/limits").bearer_auth(&token).answer().await;
    assert_eq!(answer.status(), 503);
    assert_eq!(answer.headers()["retry-after"], "1");
    publisher.publish(key_set(&[&signer]));
    eventually("keys", async || seen(&server, &token).await.0 == 200).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn keys_follow_their_file() {
    let (old, new) = (Signer::ed25519("old"), Signer::p256("new"));
    let (server, folder) = server_with_file(&[&old]).await;
    assert_eq!(seen(&server, &old.token("EdDSA", &claims())).await.0, 200);
    replace_file(&folder.path().join("keys.json"), &key_set(&[&new]));
    eventually("the old key gone", async || {
        seen(&server, &old.token("EdDSA", &claims())).await.0 == 401
    })
    .await;
    assert_eq!(seen(&server, &new.token("ES256", &claims())).await.0, 200);
}

#[test]
fn what_is_wrong_with_the_table_is_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, keys) = (folder.path().join("pliant.toml"), folder.path().join("keys.json"));
    std::fs::write(&keys, key_set(&[&Signer::ed25519("key")])).expect("written");
    std::fs::write(
        folder.path().join("empty.json"),
        r#"{"keys": [{"kty": "oct", "k": "AAAA"}]}"#,
    )
    .expect("written");
    let load = |lines: &str| {
        let keys = keys.display().to_string();
        let text = format!("[auth.jwt]\n{}\n", lines.replace("KEYS", &keys));
        std::fs::write(&file, text).expect("written");
        ServeSettings::load(Some(&file), &ConfigKeys::default())
    };
    let whole = "jwks = \"KEYS\"\nissuer = \"i\"\naudience = \"pliant\"\n";
    let settings = load(whole).expect("a table with what it needs");
    let jwt = settings.server.auth.jwt.expect("it is there");
    assert_eq!(jwt.algorithms, [Algorithm::RS256, Algorithm::ES256, Algorithm::EdDSA]);
    assert_eq!(
        (jwt.tenant_claim.as_str(), jwt.leeway),
        ("tenant", Duration::from_secs(60))
    );
    let more = |line: &str| format!("{whole}{line}\n");
    let instead = |keys: &str| whole.replace("KEYS", keys);
    let none = folder.path().join("none.json").display().to_string();
    let empty = folder.path().join("empty.json").display().to_string();
    for (lines, words) in [
        ("jwks = \"KEYS\"\nissuer = \"i\"".to_owned(), &["audience"][..]),
        (whole.replace("\"i\"", "\"\""), &["auth.jwt.issuer", "empty"]),
        (
            more("algorithms = [\"HS256\"]"),
            &["auth.jwt.algorithms", "HS256", "RS256"],
        ),
        (more("algorithms = [\"none\"]"), &["none", "EdDSA"]),
        (more("algorithms = []"), &["auth.jwt.algorithms", "empty"]),
        (more("leeway = \"1h\""), &["auth.jwt.leeway", "300s"]),
        (more("refresh = \"1s\""), &["auth.jwt.refresh", "10s"]),
        (more("audiences = \"a\""), &["audiences", "no such key", "audience"]),
        (instead("http://issuer.example/keys"), &["auth.jwt.jwks", "https://"]),
        (instead(&none), &["auth.jwt.jwks", "none.json"]),
        (instead(&empty), &["empty.json", "none of them"]),
    ] {
        let reply = load(&lines).expect_err(&lines).to_string();
        for word in words {
            assert!(reply.contains(word), "{lines}: {reply} lacks {word}");
        }
    }
}
