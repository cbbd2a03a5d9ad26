//! Every call of every protocol, with what no one should send: the answer is a refusal that says why, and the server goes on.

use crate::support::server::*;
use pliant::wire::{json, pb};
use prost_reflect::{DynamicMessage, Kind, MessageDescriptor, Value as FieldValue};
use serde_json::Value;
use std::collections::BTreeMap;

/// Bodies that are no message of JSON, or one that means nothing.
fn hostile_json() -> Vec<(&'static str, Vec<u8>)> {
    let deep = |open: &str, close: &str| [open.repeat(50_000), close.repeat(50_000)].concat().into_bytes();
    vec![
        ("nothing", Vec::new()),
        ("half a message", b"{\"handles\": [".to_vec()),
        ("no text", vec![0xff, 0xfe, 0, 0x80]),
        ("a list", b"[1, 2, 3]".to_vec()),
        ("a number", b"1e999".to_vec()),
        (
            "NaN",
            b"{\"pose\": {\"handles\": [{\"id\": \"top\", \"pose\": {\"translation\": [NaN, 0, 0]}}]}}".to_vec(),
        ),
        (
            "NaN as text",
            br#"{"pose": {"handles": [{"id": "top", "pose": {"translation": ["NaN", "Infinity", "-Infinity"]}}]}}"#
                .to_vec(),
        ),
        ("deep lists", deep("[", "]")),
        ("deep objects", deep("{\"a\":", "}")),
        (
            "deep in a field",
            [b"{\"handles\":".to_vec(), deep("[", "]"), b"}".to_vec()].concat(),
        ),
        ("an unknown field", b"{\"nobody\": 1}".to_vec()),
        (
            "a number that is too large",
            b"{\"weld\": {\"tolerance\": 1e400}}".to_vec(),
        ),
        (
            "a long text",
            format!("{{\"label\": \"{}\"}}", "x".repeat(2 << 20)).into_bytes(),
        ),
        (
            "many items",
            format!("{{\"handles\": [{}{{}}]}}", "{},".repeat(200_000)).into_bytes(),
        ),
        (
            "a region of every vertex there could be",
            br#"{"handles": [{"id": "a", "region": {"vertices": {"ranges": [{"first": 0, "count": 4294967295}]}}}]}"#
                .to_vec(),
        ),
    ]
}

/// Names of sessions that are none.
const NAMES: [&str; 10] = [
    "..",
    "..%2f..%2fetc%2fpasswd",
    "%2e%2e%5c%2e%2e",
    "%00",
    "a%00b",
    "%ff%fe",
    "%F0%9F%A6%96",
    "'%20or%201%3D1--",
    "{id}",
    "00000000000000000000000000000000",
];

fn is_refusal(status: u16, answer: &Value) -> bool {
    let says = |key: &str| answer[key].as_str().is_some_and(|text| !text.is_empty());
    (400..500).contains(&status) && says("detail") && says("code") && says("title") && answer["status"] == status
}

/// The paths of the server's own description, with the methods of each.
async fn described(server: &Server) -> Vec<(String, String, bool)> {
    let document = server.get("/openapi.json").document().await;
    let mut calls = Vec::new();
    for (path, methods) in document["paths"].as_object().expect("paths") {
        for (method, operation) in methods.as_object().expect("methods") {
            let takes_json = operation["requestBody"]["content"].get("application/json").is_some();
            calls.push((method.to_uppercase(), path.clone(), takes_json));
        }
    }
    assert!(calls.len() > 15, "{calls:?}");
    calls
}

#[tokio::test(flavor = "multi_thread")]
async fn every_body_of_json_that_is_none_is_refused() {
    let (server, id) = Server::start_with_bar().await;
    let mut seen = 0;
    for (method, path, takes_json) in described(&server).await {
        if !takes_json {
            continue;
        }
        let url = server.url(&path.replace("{id}", &id).replace("{handleId}", "top"));
        for (what, body) in hostile_json() {
            let request = http()
                .request(method.parse().unwrap(), &url)
                .header("content-type", "application/json")
                .body(body);
            let answer = request.answer().await;
            let status = answer.status().as_u16();
            let reply: Value = answer.json().await.unwrap_or_default();
            // Nothing at all is a message with nothing in it, which some calls take.
            let is_fine = status < 300 && ["nothing", "a long text"].contains(&what);
            assert!(
                is_fine || is_refusal(status, &reply),
                "{method} {path}, {what}: {status} {reply}"
            );
            seen += 1;
        }
    }
    assert!(seen >= 60, "{seen} calls");
    let after = server.get(&format!("/v1/sessions/{id}")).answer().await;
    assert_eq!(after.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn every_name_that_is_no_session_is_not_found() {
    let server = Server::start().await;
    let long = "a".repeat(4000);
    for (method, path, _) in described(&server).await {
        if !path.contains("{id}") {
            continue;
        }
        for name in NAMES.into_iter().chain([long.as_str()]) {
            let path = path.replace("{id}", name).replace("{handleId}", name);
            let mut request = http().request(method.parse().unwrap(), server.url(&path));
            if method != "GET" {
                request = request.header("content-type", "application/json").body("{}");
            }
            let answer = request.answer().await;
            let status = answer.status().as_u16();
            let reply: Value = answer.json().await.unwrap_or_default();
            // `..` leads to another path before it is sent.
            let elsewhere = name == ".." && [200, 405].contains(&status);
            assert!(
                elsewhere || is_refusal(status, &reply),
                "{method} {path}: {status} {reply}"
            );
        }
    }
}

/// The gRPC status of an answer in the form for browsers, whose trailers are in its body.
fn grpc_web_status(headers: &reqwest::header::HeaderMap, body: &[u8]) -> Option<i32> {
    if let Some(status) = headers.get("grpc-status") {
        return status.to_str().ok()?.parse().ok();
    }
    let mut rest = body;
    while rest.len() >= 5 {
        let length = u32::from_be_bytes([rest[1], rest[2], rest[3], rest[4]]) as usize;
        let frame = rest.get(5..5 + length)?;
        if rest[0] & 0x80 != 0 {
            let text = String::from_utf8_lossy(frame).to_lowercase();
            let line = text.lines().find_map(|line| line.strip_prefix("grpc-status:"))?;
            return line.trim().parse().ok();
        }
        rest = &rest[5 + length..];
    }
    None
}

/// A message with every number in it `number`, to a depth.
fn filled_with(descriptor: &MessageDescriptor, number: f64, depth: usize) -> DynamicMessage {
    let mut message = DynamicMessage::new(descriptor.clone());
    let mut choices = BTreeMap::new();
    for field in descriptor.fields() {
        // Of fields that exclude each other the first.
        if let Some(one) = field.containing_oneof()
            && choices.insert(one.name().to_owned(), ()).is_some()
        {
            continue;
        }
        let value = match field.kind() {
            Kind::Double => FieldValue::F64(number),
            Kind::Float => FieldValue::F32(number as f32),
            Kind::Uint32 | Kind::Fixed32 => FieldValue::U32(u32::MAX),
            Kind::Uint64 | Kind::Fixed64 => FieldValue::U64(u64::MAX),
            Kind::Int32 | Kind::Sint32 | Kind::Sfixed32 => FieldValue::I32(i32::MIN),
            Kind::Int64 | Kind::Sint64 | Kind::Sfixed64 => FieldValue::I64(i64::MIN),
            Kind::Enum(_) => FieldValue::EnumNumber(77),
            Kind::String => FieldValue::String("../x\u{0}".into()),
            Kind::Bytes => FieldValue::Bytes(vec![0xff; 9].into()),
            Kind::Message(inner) if depth > 0 && !field.is_map() => {
                FieldValue::Message(filled_with(&inner, number, depth - 1))
            }
            Kind::Bool => FieldValue::Bool(true),
            Kind::Message(_) => continue,
        };
        if field.is_map() {
            continue;
        }
        let value = if field.is_list() {
            FieldValue::List(vec![value; 3])
        } else {
            value
        };
        message.set_field(&field, value);
    }
    message
}

/// What is sent as a message: bytes, and the length that they are said to have.
fn hostile_messages(descriptor: &MessageDescriptor, id: &str) -> Vec<(String, Vec<u8>)> {
    use prost::Message as _;
    let framed = |flag: u8, length: usize, bytes: &[u8]| [&[flag], &(length as u32).to_be_bytes()[..], bytes].concat();
    let whole = |bytes: &[u8]| framed(0, bytes.len(), bytes);
    let mut sent = vec![
        ("nothing at all".to_owned(), Vec::new()),
        ("half a length".into(), vec![0, 0]),
        ("a length beyond its bytes".into(), framed(0, 100, &[8, 1])),
        (
            "a length of four gigabytes".into(),
            framed(0, u32::MAX as usize, &[8, 1]),
        ),
        ("compressed, without a word of how".into(), framed(1, 2, &[8, 1])),
        ("an unknown flag".into(), framed(0x7e, 2, &[8, 1])),
        ("a field that never ends".into(), whole(&[0xff; 12])),
        (
            "a length inside beyond the message".into(),
            whole(&[0x0a, 0xff, 0xff, 0xff, 0x0f, 1]),
        ),
        ("groups within groups".into(), whole(&[0x0b; 20_000])),
        ("messages within messages".into(), whole(&nested(300))),
    ];
    for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, 1e308, 0.0] {
        let mut message = filled_with(descriptor, number, 6);
        if let Some(field) = descriptor.get_field_by_name("session_id") {
            message.set_field(&field, FieldValue::String(id.to_owned()));
        }
        sent.push((format!("every number {number}"), whole(&message.encode_to_vec())));
    }
    sent
}

/// Field 2 within field 2, so often.
fn nested(depth: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    for _ in 0..depth {
        let mut outer = vec![0x12];
        prost::encoding::encode_varint(bytes.len() as u64, &mut outer);
        outer.extend(&bytes);
        bytes = outer;
    }
    bytes
}

#[tokio::test(flavor = "multi_thread")]
async fn every_message_that_is_none_is_refused_by_every_rpc() {
    let (server, id) = Server::start_with_bar().await;
    let service = json::descriptors()
        .expect("the schema")
        .get_service_by_name("pliant.v1.Deformer");
    for method in service.expect("the service").methods() {
        let url = server.url(&format!("/pliant.v1.Deformer/{}", method.name()));
        for (what, body) in hostile_messages(&method.input(), &id) {
            let request = http()
                .post(&url)
                .header("content-type", "application/grpc-web+proto")
                .body(body);
            let answer = request.answer().await;
            assert_eq!(answer.status(), 200, "{} {what}", method.name());
            let headers = answer.headers().clone();
            let body = within(&what, answer.bytes()).await.expect("a body");
            let status = grpc_web_status(&headers, &body);
            // Neither UNKNOWN nor INTERNAL: what is wrong is reported, and it is not the server.
            let is_reported = status.is_some_and(|status| ![2, 13].contains(&status));
            assert!(is_reported, "{} {what}: {status:?} {headers:?}", method.name());
        }
    }
    // Some of it may have closed the session in good form; the server is there.
    assert_eq!(server.get("/healthz").status().await, 200);
    server.bar_session().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_calls_that_no_one_waits_for_leaves_nothing_behind() {
    let (server, id) = Server::start_with_bar().await;
    let mut client = server.grpc().await;
    for round in 0..300u64 {
        let request = turn_request(&id, round, 0.01 * round as f64);
        let mut caller = client.clone();
        let call = tokio::spawn(async move { caller.solve(request).await.map(drop) });
        if round % 3 == 0 {
            tokio::task::yield_now().await;
        }
        call.abort();
    }
    eventually("all work given up or done", async || {
        server.metric("pliant_pool_busy").await == 0.0
            && server.metric("pliant_pool_waiting").await == 0.0
            && server.metric("pliant_streams").await == 0.0
    })
    .await;
    // It solves as before.
    let solve = pb::SolveRequest {
        session_id: id,
        pose: Some(turned(1000, 0.5, false)),
        ..Default::default()
    };
    let mut frames = client.solve(solve).await.expect("a solve").into_inner();
    assert!(within("a frame", frames.message()).await.expect("a frame").is_some());
}
