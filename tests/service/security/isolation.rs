//! Another tenant's session is as one that never was: every path, method and rpc answers alike, byte for byte.

use super::{config_file, guarded, token_table};
use crate::support::program::ServedProgram;
use crate::support::server::*;
use base64::Engine as _;
use base64::engine::GeneralPurpose;
use base64::engine::general_purpose::GeneralPurposeConfig;
use pliant::wire::json::descriptors;
use prost::Message as _;
use prost_reflect::{DynamicMessage, Kind, Value as Reflected};
use reqwest::Method;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use tokio_tungstenite::tungstenite;

const UNKNOWN_SESSION: &str = "0123456789abcdef0123456789abcdef";

/// Bodies that calls could have, sensible ones among them.
const BODIES: [(&str, &str); 8] = [
    ("application/json", ""),
    ("application/json", "{"),
    (
        "application/json",
        r#"{"handles": [{"id": "a", "region": {"all": {}}}]}"#,
    ),
    (
        "application/json",
        r#"{"pose": {"handles": [{"id": "top", "pose": {"translation": [0, 0, 1]}}]}}"#,
    ),
    (
        "application/json",
        r#"{"cut": {"plane": {"normal": [0, 0, 1], "offset": 2}}}"#,
    ),
    ("application/json", r#"{"points": [0, 0, 1]}"#),
    ("text/plain", "what is this"),
    ("multipart/form-data; boundary=x", "--x--"),
];

/// An answer without what differs from call to call, and the id that was asked for.
#[derive(Debug, PartialEq)]
struct Reported {
    status: u16,
    headers: BTreeMap<String, String>,
    body: Vec<u8>,
}

fn without_id(bytes: &[u8], id: &str) -> Vec<u8> {
    String::from_utf8_lossy(bytes).replace(id, "ID").into_bytes()
}

async fn reply(request: reqwest::RequestBuilder, id: &str) -> Reported {
    let answer = request.bearer_auth("b").answer().await;
    let passing = ["x-request-id", "date"];
    let headers = answer
        .headers()
        .iter()
        .filter(|(name, _)| !passing.contains(&name.as_str()));
    let headers = headers.map(|(name, value)| {
        let value = String::from_utf8_lossy(value.as_bytes()).into_owned();
        (name.as_str().to_owned(), statuses(&value).replace(id, "ID"))
    });
    Reported {
        status: answer.status().as_u16(),
        headers: headers.filter(|(name, _)| name != "content-length").collect(),
        body: without_id(
            statuses(&String::from_utf8_lossy(&answer.bytes().await.expect("a body"))).as_bytes(),
            id,
        ),
    }
}

/// What a status of gRPC holds in base64, as text, so that an id in it can be seen.
fn statuses(text: &str) -> String {
    let lenient = GeneralPurposeConfig::new().with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent);
    let lenient = GeneralPurpose::new(&base64::alphabet::STANDARD, lenient);
    let mut lines: Vec<String> = text.split("\r\n").map(str::to_owned).collect();
    for line in &mut lines {
        let value = line.strip_prefix("grpc-status-details-bin:").unwrap_or(line).trim();
        if value.len() > 40
            && let Ok(bytes) = lenient.decode(value)
        {
            *line = String::from_utf8_lossy(&bytes).into_owned();
        }
    }
    lines.join("\r\n")
}

/// A session of tenant `a` that has handles, a commit, and keys of calls.
async fn session_of_another(server: &Server) -> String {
    let post = |path: &str| server.post(path).bearer_auth("a");
    let session = post("/v1/sessions").body(bar_obj(8)).document().await;
    let id = text(&session["id"]);
    let handles = server.put(&format!("/v1/sessions/{id}/handles")).bearer_auth("a");
    let set = handles.json(&json!({"handles": ends()})).answer().await;
    assert_eq!(set.status(), 200);
    let solve = post(&format!("/v1/sessions/{id}/solve")).header("idempotency-key", "key");
    let solve = solve.json(&turn_json(0.4)).send();
    assert_eq!(within("a solve", solve).await.expect("an answer").status(), 200);
    id
}

#[tokio::test(flavor = "multi_thread")]
async fn every_path_answers_as_for_a_session_that_never_was() {
    let server = guarded().await;
    let theirs = session_of_another(&server).await;
    let description = within("the description", server.get("/openapi.json").send()).await;
    let description: Value = description.expect("an answer").json().await.expect("JSON");
    let mut asked = 0;
    for (path, methods) in description["paths"].as_object().expect("paths") {
        if !path.contains("{id}") {
            continue;
        }
        for method in methods.as_object().expect("methods").keys() {
            let method: Method = method.to_uppercase().parse().expect("a method");
            for (kind, body) in BODIES {
                for key in [None, Some("key")] {
                    let ask = async |id: &str| {
                        let path = path.replace("{id}", id).replace("{handleId}", "top");
                        let mut request = http()
                            .request(method.clone(), server.url(&path))
                            .header("content-type", kind);
                        if let Some(key) = key {
                            request = request.header("idempotency-key", key);
                        }
                        reply(request.body(body), id).await
                    };
                    let (other, none) = (ask(&theirs).await, ask(UNKNOWN_SESSION).await);
                    assert_eq!(other, none, "{method} {path} {body}");
                    assert_eq!(other.status, 404, "{method} {path} {body}: {other:?}");
                    asked += 1;
                }
            }
        }
    }
    assert!(asked > 200, "{asked} calls");
    // Nothing has happened to it.
    let still = server
        .get(&format!("/v1/sessions/{theirs}"))
        .bearer_auth("a")
        .document()
        .await;
    assert_eq!(still["revision"], "3");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_rpc_answers_as_for_a_session_that_never_was() {
    let server = guarded().await;
    let theirs = session_of_another(&server).await;
    let services = descriptors().expect("descriptors").services();
    let mut asked = Vec::new();
    for method in services.flat_map(|service| service.methods().collect::<Vec<_>>()) {
        // Of a call that sends parts, the options name it.
        let input = method.input();
        let options = input
            .get_field_by_name("options")
            .map(|field| (field.clone(), field.kind()));
        let (holder, inside) = match options {
            Some((field, Kind::Message(inner))) if input.get_field_by_name("session_id").is_none() => {
                (Some(field), inner)
            }
            _ => (None, input.clone()),
        };
        let Some(field) = inside.get_field_by_name("session_id") else {
            continue;
        };
        assert_eq!(field.kind(), Kind::String);
        let path = format!("/{}/{}", method.parent_service().full_name(), method.name());
        let ask = async |id: &str| {
            let mut message = DynamicMessage::new(inside.clone());
            message.set_field(&field, Reflected::String(id.to_owned()));
            if let Some(holder) = &holder {
                let options = std::mem::replace(&mut message, DynamicMessage::new(input.clone()));
                message.set_field(holder, Reflected::Message(options));
            }
            let message = message.encode_to_vec();
            let mut framed = vec![0];
            framed.extend(u32::try_from(message.len()).expect("short").to_be_bytes());
            framed.extend(message);
            let call = server.post(&path).header("content-type", "application/grpc-web+proto");
            reply(call.header("idempotency-key", "key").body(framed), id).await
        };
        let (other, none) = (ask(&theirs).await, ask(UNKNOWN_SESSION).await);
        assert_eq!(other, none, "{path}");
        let reply = format!("{:?} {}", other.headers, String::from_utf8_lossy(&other.body));
        assert!(
            reply.contains("grpc-status\": \"5\"") || reply.contains("grpc-status:5"),
            "{path}: {reply}"
        );
        asked.push(path);
    }
    assert!(asked.len() >= 12, "{asked:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn nor_do_sockets_lists_merges_and_limits_show_it() {
    let server = guarded().await;
    let theirs = session_of_another(&server).await;
    let socket = async |id: &str| {
        let url = format!("ws://{}/v1/sessions/{id}/stream", server.address);
        let Err(tungstenite::Error::Http(answer)) = Socket::connect_with(&url, "authorization", "Bearer b").await
        else {
            panic!("no refusal")
        };
        (
            answer.status(),
            without_id(answer.body().as_deref().unwrap_or_default(), id),
        )
    };
    assert_eq!(socket(&theirs).await, socket(UNKNOWN_SESSION).await);

    let own = server
        .post("/v1/sessions")
        .bearer_auth("b")
        .body(bar_obj(8))
        .document()
        .await;
    let edits = server.url(&format!("/v1/sessions/{}/edits", text(&own["id"])));
    let merge = async |id: &str| {
        let body = json!({"on": "REST", "merge": {"session": id}});
        reply(http().post(&edits).json(&body), id).await
    };
    let (other, none) = (merge(&theirs).await, merge(UNKNOWN_SESSION).await);
    assert_eq!(other, none);
    assert!((400..500).contains(&other.status), "{other:?}");

    let list = async |query: &str| reply(server.get(&format!("/v1/sessions{query}")), &theirs).await;
    let reported_all = String::from_utf8(list("").await.body).expect("UTF-8");
    assert!(
        reported_all.contains(&text(&own["id"])) && !reported_all.contains("ID"),
        "{reported_all}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_of_the_store_are_their_tenants_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let tokens = ["a", "b"].map(|t| token_table(t, t, t));
    let config = config_file(folder.path(), &tokens.concat());
    let server = ServedProgram::start(&data, &["--config", &config]);
    let opened = server.post("/v1/sessions").body(bar_obj(8));
    let opened = within("a session", opened.bearer_auth("a").send()).await;
    let opened: Value = opened.expect("an answer").json().await.expect("JSON");
    let id = text(&opened["id"]);
    server.kill();
    let server = ServedProgram::start(&data, &["--config", &config]);
    let ask = async |method: Method, rest: &str, id: &str| {
        let url = format!("{}/v1/sessions/{id}{rest}", server.url);
        reply(http().request(method, url), id).await
    };
    for (method, rest) in [
        (Method::GET, ""),
        (Method::GET, "/history"),
        (Method::GET, "/positions"),
        (Method::POST, "/undo"),
        (Method::DELETE, ""),
    ] {
        let other = ask(method.clone(), rest, &id).await;
        assert_eq!(other.status, 404, "{other:?}");
        assert_eq!(other, ask(method, rest, UNKNOWN_SESSION).await);
    }
    let list = reply(server.get("/v1/sessions"), &id).await;
    let list: Value = serde_json::from_slice(&list.body).expect("JSON");
    assert_eq!(list["sessions"], json!([]));
    let own = server.get(&format!("/v1/sessions/{id}")).bearer_auth("a");
    assert_eq!(own.status().await, 200);
}
