//! HTTP: sessions and their calls as a client sees them, problems, downloads, forms.

mod carry;
mod connections;
mod crossings;
mod ledger;
mod map_coordinates;
mod operators;
mod problems;
mod rig;
mod shapes;
mod transfers;

use crate::support::server::*;
use base64::Engine as _;
use reqwest::header;
use serde_json::{Value, json};

async fn get(server: &Server, path: &str) -> reqwest::Response {
    server.get(path).answer().await
}

async fn post(server: &Server, path: &str, body: Value) -> reqwest::Response {
    server.post(path).json(&body).answer().await
}

/// The ids of a list in JSON.
fn ids_in(list: &Value) -> Vec<String> {
    let list = list.as_array().expect("a list");
    list.iter().map(|item| text(&item["id"])).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_lives_from_create_to_delete() {
    let server = Server::start().await;
    let open = server.post("/v1/sessions?label=bar&volumeGraph=OFF");
    let answer = open.body(bar_obj(24)).answer().await;
    assert_eq!(answer.status(), 201);
    let location = header(&answer, header::LOCATION).to_owned();
    let session: Value = answer.json().await.unwrap();
    let id = text(&session["id"]);
    assert_eq!(location, format!("/v1/sessions/{id}"));
    assert_eq!(
        (id.len(), session["label"].as_str(), session["model"]["format"].as_str()),
        (32, Some("bar"), Some("obj"))
    );
    assert!(session["buildMs"]["hierarchy"].is_number(), "{session}");

    let seen = server.document(&location).await;
    assert_eq!((&seen["id"], &seen["model"]), (&session["id"], &session["model"]));
    let list = server.document("/v1/sessions?pageSize=10").await;
    assert_eq!(list["sessions"].as_array().map(Vec::len), Some(1));

    let gone = server.delete(&location).answer().await;
    assert_eq!(gone.status(), 204);
    assert_eq!(gone.text().await.unwrap(), "");
    assert_eq!(get(&server, &location).await.status(), 404);
    assert_eq!(server.delete(&location).status().await, 404);
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_are_listed_in_pages() {
    let server = Server::start().await;
    let mut ids = Vec::new();
    for _ in 0..3 {
        ids.push(text(&server.open(bar_obj(4)).await["id"]));
    }
    let first = server.document("/v1/sessions?pageSize=2").await;
    let token = text(&first["nextPageToken"]);
    let second = server
        .document(&format!("/v1/sessions?pageSize=2&pageToken={token}"))
        .await;
    let names = |page: &Value| ids_in(&page["sessions"]);
    assert_eq!([names(&first), names(&second)].concat(), ids);
    assert_eq!(second["nextPageToken"], "");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_solve_in_three_forms() {
    let (server, id) = Server::start_with_bar().await;
    let path = format!("/v1/sessions/{id}/solve");

    let answer = post(&server, &path, turn_json(0.5)).await;
    assert_eq!(answer.status(), 200);
    let revision = header(&answer, "x-pliant-revision").to_owned();
    let digest = header(&answer, "x-pliant-digest").to_owned();
    let solved: Value = answer.json().await.unwrap();
    assert_eq!(
        (solved["revision"].as_str(), solved["digest"].as_str()),
        (Some(revision.as_str()), Some(digest.as_str()))
    );
    let frames = solved["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 1);
    assert_eq!(
        (frames[0]["final"].as_bool(), frames[0]["encoding"].as_str()),
        (Some(true), Some("F32"))
    );
    let quality = frames[0]["quality"].clone();
    assert!(
        quality["edgeRms"].as_f64().is_some_and(|x| x > 0.0) && quality.get("selfIntersections").is_none(),
        "{quality}"
    );
    let data = base64::engine::general_purpose::STANDARD
        .decode(frames[0]["data"].as_str().unwrap())
        .unwrap();

    let mut counted = turn_json(0.5);
    counted["options"] = json!({"output": {"selfIntersections": true}});
    let call = server.post(&path).json(&counted);
    let binary = call.header("accept", "application/octet-stream").answer().await;
    assert_eq!(binary.headers()[header::CONTENT_TYPE], "application/octet-stream");
    assert_eq!(header(&binary, header::CONTENT_LENGTH), data.len().to_string());
    assert!(header(&binary, "x-pliant-residual").parse::<f64>().unwrap() < 1e-3);
    // What JSON says in a field, headers say for the other forms.
    let said = |name: &str| header(&binary, name).parse::<f64>().unwrap();
    assert!(said("x-pliant-residual") < 1e-3);
    assert_eq!(said("x-pliant-edge-rms"), quality["edgeRms"]);
    assert_eq!(said("x-pliant-flipped-triangles"), 0.0);
    assert_eq!(said("x-pliant-self-intersections"), 0.0);
    assert_eq!(said("x-pliant-new-self-intersections"), 0.0);
    let buffer = binary.bytes().await.unwrap();
    assert_eq!(
        floats(&buffer),
        floats(&data),
        "the same pose gives the same bits in every form"
    );
    let positions = server.content(&format!("/v1/sessions/{id}/positions")).await;
    assert_eq!(positions, buffer);

    let call = server.post(&path).json(&turn_json(0.5));
    let model = call.header("accept", "model/obj").answer().await;
    assert_eq!(model.headers()[header::CONTENT_TYPE], "model/obj");
    let obj = model.text().await.unwrap();
    assert_eq!(obj.lines().filter(|l| l.starts_with("v ")).count(), buffer.len() / 12);

    // The top is where its handle says: turned about the region's centre, which lies on the bar's axis, and lifted.
    let highest = floats(&buffer).chunks(3).map(|p| p[2]).fold(f32::MIN, f32::max);
    assert!((highest - 4.25).abs() < 1e-5, "{highest}");
}

#[tokio::test(flavor = "multi_thread")]
async fn normals_follow_as_a_block_of_their_own() {
    let (server, id) = Server::start_with_bar().await;
    let mut body = turn_json(0.2);
    body["options"] = json!({"output": {"normals": true}});
    let answer = server
        .post(&format!("/v1/sessions/{id}/solve"))
        .json(&body)
        .header("accept", "application/octet-stream");
    let answer = answer.answer().await;
    let vertices: usize = header(&answer, "x-pliant-vertices").parse().unwrap();
    let numbers = floats(&answer.bytes().await.unwrap());
    assert_eq!(numbers.len(), vertices * 6);
    for normal in numbers[vertices * 3..].chunks(3) {
        let length = normal.iter().map(|n| n * n).sum::<f32>().sqrt();
        assert!((length - 1.0).abs() < 1e-3, "{normal:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn undo_and_redo_restore_positions_to_the_bit() {
    let (server, id) = Server::start_with_bar().await;
    let path = |end: &str| format!("/v1/sessions/{id}/{end}");
    let rest = server.content(&path("positions")).await;
    assert_eq!(post(&server, &path("solve"), turn_json(1.0)).await.status(), 200);
    let bent = server.content(&path("positions")).await;
    assert_ne!(rest, bent);
    let undone = server.post(&path("undo")).answer().await;
    assert_eq!(undone.status(), 200);
    assert_eq!(server.content(&path("positions")).await, rest);
    assert_eq!(server.post(&path("redo")).status().await, 200);
    assert_eq!(server.content(&path("positions")).await, bent);
    let history = server.document(&path("history")).await;
    let commits = history["commits"].as_array().unwrap();
    let kinds: Vec<&str> = commits.iter().map(|c| c["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["create", "handles", "pose"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn one_handle_can_be_changed_added_and_removed() {
    let (server, id) = Server::start_with_bar().await;
    let url = |handle: &str| server.url(&format!("/v1/sessions/{id}/handles/{handle}"));
    let names = |session: &Value| ids_in(&session["handles"]);

    let pose = json!({"pose": {"translation": [0, 0, 1]}});
    let changed = http().patch(url("top")).json(&pose).answer().await;
    assert_eq!(changed.status(), 200);
    assert_eq!(names(&changed.json().await.unwrap()), ["base", "top"]);
    let middle = json!({"region": {"sphere": {"center": [0.25, 0.25, 2], "radius": 0.5}}});
    let added = http().patch(url("middle")).json(&middle).answer().await;
    assert_eq!(names(&added.json().await.unwrap()), ["base", "top", "middle"]);
    let removed = http().delete(url("middle")).answer().await;
    assert_eq!(names(&removed.json().await.unwrap()), ["base", "top"]);
    assert_eq!(http().delete(url("middle")).status().await, 404);
    let other = http().patch(url("top")).json(&json!({"id": "base"})).answer().await;
    assert_eq!(other.status(), 422);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idempotency_key_gets_the_first_answer_again() {
    let server = Server::start().await;
    let create = |model: String| {
        server
            .post("/v1/sessions")
            .header("idempotency-key", "one")
            .body(model)
            .send()
    };
    let first = create(bar_obj(8)).await.unwrap();
    assert_eq!(first.status(), 201);
    let first: Value = first.json().await.unwrap();
    let again = create(bar_obj(8)).await.unwrap();
    assert_eq!(again.status(), 200);
    assert_eq!(again.json::<Value>().await.unwrap()["id"], first["id"]);
    let other = create(bar_obj(9)).await.unwrap();
    assert!(
        other.status().is_client_error(),
        "the key of another model: {}",
        other.status()
    );

    let id = server.bar_session().await;
    let solve = || {
        server
            .post(&format!("/v1/sessions/{id}/solve"))
            .header("idempotency-key", "two")
            .json(&turn_json(0.4))
            .send()
    };
    let (one, two) = (solve().await.unwrap(), solve().await.unwrap());
    assert_eq!(one.headers()["x-pliant-revision"], two.headers()["x-pliant-revision"]);
    assert_eq!(one.bytes().await.unwrap(), two.bytes().await.unwrap());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_server_says_when_to_come_back() {
    let server = Server::with(|sessions, _| sessions.sessions = 1).await;
    server.open(bar_obj(4)).await;
    let answer = server.post("/v1/sessions").body(bar_obj(4)).answer().await;
    assert_eq!(answer.status(), 429);
    assert!(header(&answer, header::RETRY_AFTER).parse::<u32>().unwrap() >= 1);
    assert_eq!(answer.json::<Value>().await.unwrap()["code"], "RESOURCE_EXHAUSTED");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_sample_is_a_model_that_can_be_opened() {
    let server = Server::start().await;
    let sample = get(&server, "/v1/sample.glb").await;
    assert_eq!(sample.headers()[header::CONTENT_TYPE], "model/gltf-binary");
    let etag = sample.headers()[header::ETAG].clone();
    assert!(sample.bytes().await.unwrap().starts_with(b"glTF"));
    let again = server
        .get("/v1/sample.glb")
        .header("if-none-match", etag)
        .answer()
        .await;
    assert_eq!(again.status(), 304);
    let opened = server.post("/v1/sessions?sample=creature").answer().await;
    assert_eq!(opened.status(), 201);
    let session: Value = opened.json().await.unwrap();
    assert!(
        session["model"]["vertices"].as_u64().unwrap() > 1000,
        "{}",
        session["model"]
    );
}
