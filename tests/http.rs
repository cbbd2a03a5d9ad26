//! HTTP: sessions and their calls as a client sees them, problems, downloads, forms.

mod support;

use base64::Engine as _;
use reqwest::header;
use serde_json::{Value, json};
use std::time::Duration;
use support::*;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

async fn get(server: &Server, path: &str) -> reqwest::Response {
    within(path, http().get(server.url(path)).send()).await.expect("an answer")
}

async fn post(server: &Server, path: &str, body: Value) -> reqwest::Response {
    within(path, http().post(server.url(path)).json(&body).send()).await.expect("an answer")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_lives_from_create_to_delete() {
    let server = Server::start().await;
    let answer = http().post(server.url("/v1/sessions?label=bar&volumeGraph=OFF")).body(bar_obj(24)).send().await.unwrap();
    assert_eq!(answer.status(), 201);
    let location = answer.headers()[header::LOCATION].to_str().unwrap().to_owned();
    let session: Value = answer.json().await.unwrap();
    let id = text(&session["id"]);
    assert_eq!(location, format!("/v1/sessions/{id}"));
    assert_eq!((id.len(), session["label"].as_str(), session["model"]["format"].as_str()), (32, Some("bar"), Some("obj")));
    assert!(session["buildMs"]["hierarchy"].is_number(), "{session}");

    let seen: Value = get(&server, &location).await.json().await.unwrap();
    assert_eq!((&seen["id"], &seen["model"]), (&session["id"], &session["model"]));
    let list: Value = get(&server, "/v1/sessions?pageSize=10").await.json().await.unwrap();
    assert_eq!(list["sessions"].as_array().map(Vec::len), Some(1));

    let gone = http().delete(server.url(&location)).send().await.unwrap();
    assert_eq!(gone.status(), 204);
    assert_eq!(gone.text().await.unwrap(), "");
    assert_eq!(get(&server, &location).await.status(), 404);
    assert_eq!(http().delete(server.url(&location)).send().await.unwrap().status(), 404);
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_are_listed_in_pages() {
    let server = Server::start().await;
    let mut ids = Vec::new();
    for _ in 0..3 {
        ids.push(text(&server.open(bar_obj(4)).await["id"]));
    }
    let first: Value = get(&server, "/v1/sessions?pageSize=2").await.json().await.unwrap();
    let token = text(&first["nextPageToken"]);
    let second: Value = get(&server, &format!("/v1/sessions?pageSize=2&pageToken={token}")).await.json().await.unwrap();
    let names = |page: &Value| page["sessions"].as_array().unwrap().iter().map(|s| text(&s["id"])).collect::<Vec<_>>();
    assert_eq!([names(&first), names(&second)].concat(), ids);
    assert_eq!(second["nextPageToken"], "");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_solve_in_three_forms() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let path = format!("/v1/sessions/{id}/solve");

    let answer = post(&server, &path, turn_json(0.5)).await;
    assert_eq!(answer.status(), 200);
    let revision = answer.headers()["x-pliant-revision"].to_str().unwrap().to_owned();
    let digest = answer.headers()["x-pliant-digest"].to_str().unwrap().to_owned();
    let solved: Value = answer.json().await.unwrap();
    assert_eq!((solved["revision"].as_str(), solved["digest"].as_str()), (Some(revision.as_str()), Some(digest.as_str())));
    let frames = solved["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 1);
    assert_eq!((frames[0]["final"].as_bool(), frames[0]["encoding"].as_str()), (Some(true), Some("F32")));
    let data = base64::engine::general_purpose::STANDARD.decode(frames[0]["data"].as_str().unwrap()).unwrap();

    let binary = http().post(server.url(&path)).json(&turn_json(0.5)).header("accept", "application/octet-stream").send();
    let binary = binary.await.unwrap();
    assert_eq!(binary.headers()[header::CONTENT_TYPE], "application/octet-stream");
    assert_eq!(binary.headers()[header::CONTENT_LENGTH].to_str().unwrap(), data.len().to_string());
    assert!(binary.headers()["x-pliant-residual"].to_str().unwrap().parse::<f64>().unwrap() < 1e-3);
    let buffer = binary.bytes().await.unwrap();
    assert_eq!(floats(&buffer), floats(&data), "the same pose gives the same bits in every form");
    let positions = get(&server, &format!("/v1/sessions/{id}/positions")).await.bytes().await.unwrap();
    assert_eq!(positions, buffer);

    let model = http().post(server.url(&path)).json(&turn_json(0.5)).header("accept", "model/obj").send().await.unwrap();
    assert_eq!(model.headers()[header::CONTENT_TYPE], "model/obj");
    let obj = model.text().await.unwrap();
    assert_eq!(obj.lines().filter(|l| l.starts_with("v ")).count(), buffer.len() / 12);

    // The top is where its handle says: turned about the region's centre, which lies on the bar's axis, and lifted.
    let highest = floats(&buffer).chunks(3).map(|p| p[2]).fold(f32::MIN, f32::max);
    assert!((highest - 4.25).abs() < 1e-5, "{highest}");
}

#[tokio::test(flavor = "multi_thread")]
async fn normals_follow_as_a_block_of_their_own() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let mut body = turn_json(0.2);
    body["options"] = json!({"output": {"normals": true}});
    let answer = http().post(server.url(&format!("/v1/sessions/{id}/solve"))).json(&body).header("accept", "application/octet-stream");
    let answer = answer.send().await.unwrap();
    let vertices: usize = answer.headers()["x-pliant-vertices"].to_str().unwrap().parse().unwrap();
    let numbers = floats(&answer.bytes().await.unwrap());
    assert_eq!(numbers.len(), vertices * 6);
    for normal in numbers[vertices * 3..].chunks(3) {
        let length = normal.iter().map(|n| n * n).sum::<f32>().sqrt();
        assert!((length - 1.0).abs() < 1e-3, "{normal:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn undo_and_redo_restore_positions_to_the_bit() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let path = |end: &str| format!("/v1/sessions/{id}/{end}");
    let rest = get(&server, &path("positions")).await.bytes().await.unwrap();
    assert_eq!(post(&server, &path("solve"), turn_json(1.0)).await.status(), 200);
    let bent = get(&server, &path("positions")).await.bytes().await.unwrap();
    assert_ne!(rest, bent);
    let undone = http().post(server.url(&path("undo"))).send().await.unwrap();
    assert_eq!(undone.status(), 200);
    assert_eq!(get(&server, &path("positions")).await.bytes().await.unwrap(), rest);
    assert_eq!(http().post(server.url(&path("redo"))).send().await.unwrap().status(), 200);
    assert_eq!(get(&server, &path("positions")).await.bytes().await.unwrap(), bent);
    let history: Value = get(&server, &path("history")).await.json().await.unwrap();
    let kinds: Vec<&str> = history["commits"].as_array().unwrap().iter().map(|c| c["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["create", "handles", "pose"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn one_handle_can_be_changed_added_and_removed() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let url = |handle: &str| server.url(&format!("/v1/sessions/{id}/handles/{handle}"));
    let names = |session: &Value| session["handles"].as_array().unwrap().iter().map(|h| text(&h["id"])).collect::<Vec<_>>();

    let pose = json!({"pose": {"translation": [0, 0, 1]}});
    let changed = http().patch(url("top")).json(&pose).send().await.unwrap();
    assert_eq!(changed.status(), 200);
    assert_eq!(names(&changed.json().await.unwrap()), ["base", "top"]);
    let middle = json!({"region": {"sphere": {"center": [0.25, 0.25, 2], "radius": 0.5}}});
    let added = http().patch(url("middle")).json(&middle).send().await.unwrap();
    assert_eq!(names(&added.json().await.unwrap()), ["base", "top", "middle"]);
    let removed = http().delete(url("middle")).send().await.unwrap();
    assert_eq!(names(&removed.json().await.unwrap()), ["base", "top"]);
    assert_eq!(http().delete(url("middle")).send().await.unwrap().status(), 404);
    let other = http().patch(url("top")).json(&json!({"id": "base"})).send().await.unwrap();
    assert_eq!(other.status(), 422);
}

/// Every class of failure, with the document that tells it.
#[tokio::test(flavor = "multi_thread")]
async fn problems_say_what_where_and_what_is_allowed() {
    let server = Server::with(|sessions, _| {
        sessions.upload_bytes = 1 << 20;
        sessions.message_bytes = 64 << 10;
    })
    .await;
    let bare = text(&server.open(bar_obj(8)).await["id"]);
    let id = server.bar_session().await;
    let at = |end: &str| format!("/v1/sessions/{id}/{end}");
    let nobody = "/v1/sessions/00000000000000000000000000000000";
    let json_type = Some("application/json");
    let deep = format!("{{\"pose\": {}1{}}}", "[".repeat(2000), "]".repeat(2000));
    let large = " ".repeat(65 << 10);
    // method, path, content type, body, status, code, field, words of the detail
    type Case<'a> = (&'a str, String, Option<&'a str>, &'a str, u16, &'a str, Option<&'a str>, &'a [&'a str]);
    let cases: Vec<Case<'_>> = vec![
        ("GET", "/v2/nothing".into(), None, "", 404, "NOT_FOUND", None, &["/v2/nothing"]),
        ("GET", nobody.into(), None, "", 404, "NOT_FOUND", None, &["no session"]),
        ("POST", format!("{nobody}/solve"), Some("image/png"), "x", 404, "NOT_FOUND", None, &["no session"]),
        ("POST", format!("{nobody}/edits"), json_type, "{", 404, "NOT_FOUND", None, &["no session"]),
        ("PUT", "/v1/sessions".into(), None, "", 405, "UNIMPLEMENTED", None, &["PUT"]),
        ("POST", at("model"), None, "", 405, "UNIMPLEMENTED", None, &["POST"]),
        ("POST", at("solve"), Some("text/plain"), "{}", 415, "INVALID_ARGUMENT", None, &["text/plain", "application/json"]),
        ("POST", "/v1/sessions".into(), Some("image/png"), "x", 415, "INVALID_ARGUMENT", None, &["image/png", "model/obj"]),
        ("POST", at("solve"), json_type, "{\"pose\"", 400, "INVALID_ARGUMENT", Some(""), &[]),
        ("POST", at("solve"), json_type, &deep, 400, "INVALID_ARGUMENT", Some(""), &[]),
        ("POST", at("solve"), json_type, "{\"pse\": {}}", 400, "INVALID_ARGUMENT", Some(""), &["pse"]),
        ("PUT", at("handles"), json_type, r#"{"handles": [{"id": "a"}, {"id": "b", "region": {"sphere": {"center": "x"}}}]}"#, 400,
            "INVALID_ARGUMENT", Some("handles[1].region.sphere.center"), &[]),
        ("PUT", at("handles"), json_type, r#"{"handles": [{"id": "a", "region": {"sphere": {"center": [0, 0, 0], "radius": -1}}}]}"#, 422,
            "INVALID_ARGUMENT", Some("handles[0].region.sphere.radius"), &["-1", "0"]),
        ("PUT", at("handles"), json_type, r#"{"sessionId": "another", "handles": []}"#, 422, "INVALID_ARGUMENT", Some("sessionId"), &["differs"]),
        ("POST", at("solve"), json_type, r#"{"pose": {"handles": [{"id": "nose"}]}}"#, 422, "INVALID_ARGUMENT", Some("pose.handles[0].id"), &["nose"]),
        ("POST", at("solve"), json_type, r#"{"pose": {"handles": [{"id": "top", "pose": {"translation": ["NaN", 0, 0]}}]}}"#, 422,
            "INVALID_ARGUMENT", Some("pose.handles[0].pose.translation[0]"), &["finite"]),
        ("POST", at("solve"), json_type, &large, 413, "RESOURCE_EXHAUSTED", None, &["65536"]),
        ("POST", format!("/v1/sessions/{bare}/solve"), json_type, "{}", 409, "FAILED_PRECONDITION", None, &["handles"]),
        ("POST", at("redo"), None, "", 409, "FAILED_PRECONDITION", None, &["redo"]),
        ("POST", at("edits"), json_type, r#"{"cut": {"plane": {"normal": [0, 0, 1], "offset": 1}}}"#, 501, "UNIMPLEMENTED", None, &["cut"]),
        ("POST", at("edits"), json_type, "{}", 422, "INVALID_ARGUMENT", Some("operation"), &["cut"]),
        ("POST", at("animations"), None, "", 501, "UNIMPLEMENTED", None, &["animations"]),
        ("POST", at("solve"), json_type, r#"{"options": {"method": "SPATIAL_RBF"}}"#, 501, "UNIMPLEMENTED", None, &["SPATIAL_RBF"]),
        ("POST", "/v1/sessions?colour=red".into(), None, "x", 400, "INVALID_ARGUMENT", Some("colour"), &["volumeGraph"]),
        ("POST", "/v1/sessions?format=doc".into(), None, "x", 422, "INVALID_ARGUMENT", Some("format"), &["doc", "glb"]),
        ("POST", "/v1/sessions?ttl=soon".into(), None, "v 0 0 0", 422, "INVALID_ARGUMENT", Some("ttl"), &["soon"]),
        ("POST", "/v1/sessions?sample=dragon".into(), None, "", 422, "INVALID_ARGUMENT", Some("sample"), &["dragon", "creature"]),
        ("POST", "/v1/sessions".into(), None, "", 400, "INVALID_ARGUMENT", None, &["empty"]),
        ("POST", "/v1/sessions".into(), None, "what is this", 400, "INVALID_ARGUMENT", None, &["glb, gltf, obj"]),
        ("POST", "/v1/sessions?format=obj".into(), None, "v 0 0 zero", 400, "INVALID_ARGUMENT", None, &["line 1", "zero"]),
        ("GET", "/v1/sessions?pageSize=many".into(), None, "", 422, "INVALID_ARGUMENT", Some("pageSize"), &["many"]),
        ("GET", "/v1/sessions?pageSize=1001".into(), None, "", 422, "INVALID_ARGUMENT", Some("pageSize"), &["1001", "1000"]),
        ("GET", at("model?format=doc"), None, "", 422, "INVALID_ARGUMENT", Some("format"), &["doc", "glb"]),
        ("GET", at("model?uri=a.bin"), None, "", 422, "INVALID_ARGUMENT", Some("uri"), &["a.bin"]),
        ("GET", at("positions?x=1"), None, "", 400, "INVALID_ARGUMENT", Some("x"), &["none here"]),
        ("GET", at("stream"), None, "", 426, "INVALID_ARGUMENT", None, &["WebSocket"]),
    ];
    for (method, path, kind, body, status, code, field, words) in cases {
        let shown: String = format!("{method} {path} {}", body.chars().take(80).collect::<String>());
        let mut request = http().request(method.parse().unwrap(), server.url(&path)).body(body.to_owned());
        if let Some(kind) = kind {
            request = request.header("content-type", kind);
        }
        let answer = within(&shown, request.send()).await.expect("an answer");
        assert_eq!(answer.status().as_u16(), status, "{shown}: {}", answer.text().await.unwrap());
        assert_eq!(answer.headers()[header::CONTENT_TYPE], "application/problem+json", "{shown}");
        assert!(answer.headers().contains_key("x-request-id"), "{shown}");
        let problem: Value = answer.json().await.unwrap();
        assert_eq!(problem["code"], code, "{shown}: {problem}");
        assert_eq!(problem["status"], status, "{shown}");
        assert_eq!(problem["instance"], path.split('?').next().unwrap(), "{shown}");
        assert!(text(&problem["type"]).starts_with("urn:pliant:problem:"), "{shown}: {problem}");
        let detail = text(&problem["detail"]);
        for word in words {
            assert!(detail.contains(word), "{shown}: {detail:?} lacks {word:?}");
        }
        match field {
            Some("") => assert!(problem["errors"][0]["field"].is_string(), "{shown}: {problem}"),
            Some(field) => assert_eq!(problem["errors"][0]["field"], field, "{shown}: {problem}"),
            None => assert!(problem.get("errors").is_none(), "{shown}: {problem}"),
        }
    }
    let whole: Value = get(&server, nobody).await.json().await.unwrap();
    assert_eq!(
        whole,
        json!({
            "type": "urn:pliant:problem:not-found", "title": "not found", "status": 404, "code": "NOT_FOUND",
            "detail": "no session \"00000000000000000000000000000000\"; it may have expired or been deleted",
            "instance": nobody,
        })
    );
    // Nothing that was refused left a trace.
    let history: Value = get(&server, &at("history")).await.json().await.unwrap();
    assert_eq!(history["commits"].as_array().map(Vec::len), Some(2));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_method_names_the_right_ones() {
    let server = Server::start().await;
    let answer = http().put(server.url("/v1/sessions")).send().await.unwrap();
    let allow = answer.headers()[header::ALLOW].to_str().unwrap();
    assert!(allow.contains("GET") && allow.contains("POST"), "{allow}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_accepted_is_refused_before_work_is_done() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let url = server.url(&format!("/v1/sessions/{id}/solve"));
    let answer = http().post(&url).header("accept", "image/png").json(&turn_json(0.1)).send().await.unwrap();
    assert_eq!(answer.status(), 406);
    let mut packed = turn_json(0.1);
    packed["options"] = json!({"output": {"encoding": "U16"}});
    let answer = http().post(&url).header("accept", "application/octet-stream").json(&packed).send().await.unwrap();
    assert_eq!(answer.status(), 422);
    let history: Value = get(&server, &format!("/v1/sessions/{id}/history")).await.json().await.unwrap();
    assert_eq!(history["commits"].as_array().map(Vec::len), Some(2));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idempotency_key_gets_the_first_answer_again() {
    let server = Server::start().await;
    let create = |model: String| http().post(server.url("/v1/sessions")).header("idempotency-key", "one").body(model).send();
    let first = create(bar_obj(8)).await.unwrap();
    assert_eq!(first.status(), 201);
    let first: Value = first.json().await.unwrap();
    let again = create(bar_obj(8)).await.unwrap();
    assert_eq!(again.status(), 200);
    assert_eq!(again.json::<Value>().await.unwrap()["id"], first["id"]);
    let other = create(bar_obj(9)).await.unwrap();
    assert!(other.status().is_client_error(), "the key of another model: {}", other.status());

    let id = server.bar_session().await;
    let solve = || http().post(server.url(&format!("/v1/sessions/{id}/solve"))).header("idempotency-key", "two").json(&turn_json(0.4)).send();
    let (one, two) = (solve().await.unwrap(), solve().await.unwrap());
    assert_eq!(one.headers()["x-pliant-revision"], two.headers()["x-pliant-revision"]);
    assert_eq!(one.bytes().await.unwrap(), two.bytes().await.unwrap());
}

#[tokio::test(flavor = "multi_thread")]
async fn downloads_honour_tags_and_ranges() {
    let server = Server::start().await;
    let model = bar_obj(24);
    let id = text(&server.open(model.clone()).await["id"]);
    let url = server.url(&format!("/v1/sessions/{id}/model"));
    let whole = http().get(&url).send().await.unwrap();
    assert_eq!(whole.status(), 200);
    assert_eq!(whole.headers()[header::ACCEPT_RANGES], "bytes");
    assert_eq!(whole.headers()[header::CONTENT_DISPOSITION].to_str().unwrap(), format!("attachment; filename=\"{id}.obj\""));
    let etag = whole.headers()[header::ETAG].to_str().unwrap().to_owned();
    assert!(etag.starts_with('"'), "a strong tag: {etag}");
    let bytes = whole.bytes().await.unwrap();
    assert_eq!(bytes, model.as_bytes(), "at rest the model comes back byte for byte");

    let part = http().get(&url).header("range", "bytes=10-19").send().await.unwrap();
    assert_eq!(part.status(), 206);
    assert_eq!(part.headers()[header::CONTENT_RANGE].to_str().unwrap(), format!("bytes 10-19/{}", bytes.len()));
    assert_eq!(part.bytes().await.unwrap(), bytes.slice(10..20));
    let tail = http().get(&url).header("range", "bytes=-5").header("if-range", &etag).send().await.unwrap();
    assert_eq!((tail.status().as_u16(), tail.bytes().await.unwrap()), (206, bytes.slice(bytes.len() - 5..)));
    let stale = http().get(&url).header("range", "bytes=0-4").header("if-range", "\"old\"").send().await.unwrap();
    assert_eq!(stale.status(), 200);
    let past = http().get(&url).header("range", format!("bytes={}-", bytes.len())).send().await.unwrap();
    assert_eq!(past.status(), 416);
    assert_eq!(past.headers()[header::CONTENT_RANGE].to_str().unwrap(), format!("bytes */{}", bytes.len()));

    let known = http().get(&url).header("if-none-match", &etag).send().await.unwrap();
    assert_eq!((known.status().as_u16(), known.headers()[header::ETAG].to_str().unwrap()), (304, etag.as_str()));
    let head = http().head(&url).send().await.unwrap();
    assert_eq!((head.status().as_u16(), head.headers()[header::CONTENT_LENGTH].to_str().unwrap()), (200, bytes.len().to_string().as_str()));
    let ply = http().get(format!("{url}?format=ply")).send().await.unwrap();
    assert_ne!(ply.headers()[header::ETAG].to_str().unwrap(), etag);

    // A changed shape is another thing.
    let handles = http().put(server.url(&format!("/v1/sessions/{id}/handles"))).json(&json!({"handles": ends()})).send().await.unwrap();
    assert_eq!(handles.status(), 200);
    assert_eq!(post(&server, &format!("/v1/sessions/{id}/solve"), turn_json(0.3)).await.status(), 200);
    let changed = http().get(&url).header("if-none-match", &etag).send().await.unwrap();
    assert_eq!(changed.status(), 200);
    assert_ne!(changed.bytes().await.unwrap(), bytes);
}

/// A glTF file whose buffer lies beside it, and that buffer.
fn split_gltf() -> (String, Vec<u8>) {
    let (points, triangles) = pliant::asset::shapes::box_with_cells(glam::DVec3::new(1.0, 1.0, 4.0), [2, 2, 8]);
    let mut bin: Vec<u8> = points.iter().flat_map(|p| p.as_vec3().to_array()).flat_map(f32::to_le_bytes).collect();
    let indices = bin.len();
    bin.extend(triangles.iter().flatten().flat_map(|i| i.to_le_bytes()));
    let document = json!({
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "parts/my bar.bin".replace(' ', "%20"), "byteLength": bin.len()}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": indices},
            {"buffer": 0, "byteOffset": indices, "byteLength": bin.len() - indices},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": points.len(), "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 4]},
            {"bufferView": 1, "componentType": 5125, "count": triangles.len() * 3, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    });
    (document.to_string(), bin)
}

/// A form: (name, file name, bytes).
fn form(parts: &[(&str, Option<&str>, &[u8])]) -> Vec<u8> {
    let mut body = Vec::new();
    for (name, file, bytes) in parts {
        let file = file.map(|f| format!("; filename=\"{f}\"")).unwrap_or_default();
        body.extend(format!("--edge\r\ncontent-disposition: form-data; name=\"{name}\"{file}\r\n\r\n").into_bytes());
        body.extend_from_slice(bytes);
        body.extend(b"\r\n");
    }
    body.extend(b"--edge--\r\n");
    body
}

async fn send_form(server: &Server, body: Vec<u8>) -> reqwest::Response {
    let request = http().post(server.url("/v1/sessions")).header("content-type", "multipart/form-data; boundary=edge").body(body);
    within("a form", request.send()).await.expect("an answer")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_form_brings_a_model_with_its_companions() {
    let server = Server::start().await;
    let (gltf, bin) = split_gltf();
    let options = br#"{"label": "from a form", "volumeGraph": {"mode": "OFF"}}"#;
    let whole = form(&[
        ("model", Some("bar.gltf"), gltf.as_bytes()),
        ("options", None, options),
        ("buffer", Some("parts/my bar.bin"), &bin),
    ]);
    let answer = send_form(&server, whole).await;
    assert_eq!(answer.status(), 201, "{}", answer.text().await.unwrap());
    let session: Value = answer.json().await.unwrap();
    assert_eq!((session["label"].as_str(), session["model"]["format"].as_str()), (Some("from a form"), Some("gltf")));

    // The main file names the companion, and both come back as they were.
    let id = text(&session["id"]);
    let main = get(&server, &format!("/v1/sessions/{id}/model")).await;
    let link = main.headers()[header::LINK].to_str().unwrap().to_owned();
    assert_eq!(main.bytes().await.unwrap(), gltf.as_bytes());
    let target = link.split(['<', '>']).nth(1).unwrap();
    let companion = get(&server, target).await;
    assert_eq!(companion.status(), 200);
    assert_eq!(companion.bytes().await.unwrap(), bin);

    let alone = send_form(&server, form(&[("model", Some("bar.gltf"), gltf.as_bytes())])).await;
    assert_eq!(alone.status().as_u16() / 100, 4);
    let problem: Value = alone.json().await.unwrap();
    assert!(text(&problem["detail"]).contains("my bar.bin") || text(&problem["detail"]).contains("my%20bar.bin"), "{problem}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_form_with_wrong_parts_is_refused_by_name() {
    let server = Server::start().await;
    let obj = bar_obj(4);
    let model: (&str, Option<&str>, &[u8]) = ("model", Some("a.obj"), obj.as_bytes());
    let cases: [(Vec<u8>, &str); 7] = [
        (form(&[("options", None, b"{}")]), "model"),
        (form(&[model, model]), "two parts \"model\""),
        (form(&[model, ("options", None, b"{}"), ("options", None, b"{}")]), "two parts \"options\""),
        (form(&[model, ("colour", None, b"red")]), "colour"),
        (form(&[model, ("options", None, b"{\"colour\": 1}")]), "colour"),
        (form(&[model, ("f", Some("a.bin"), b"1"), ("g", Some("a.bin"), b"2")]), "a.bin"),
        (b"--edge\r\ncontent-disposition: form-data; name=\"model\"\r\n\r\nv 0 0 0".to_vec(), "form"),
    ];
    for (body, word) in cases {
        let answer = send_form(&server, body).await;
        assert_eq!(answer.status(), 400, "{word}");
        let problem: Value = answer.json().await.unwrap();
        assert!(text(&problem["detail"]).contains(word), "{problem} lacks {word}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_above_the_limit_is_told_even_while_it_is_sent() {
    let server = Server::with(|sessions, _| sessions.upload_bytes = 256 << 10).await;
    // Announced: refused at once.
    let announced = http().post(server.url("/v1/sessions")).body(vec![b'v'; 8 << 20]).send().await.expect("an answer, not a broken pipe");
    assert_eq!(announced.status(), 413);
    // Not announced: refused when the limit is passed.
    let chunks = futures::stream::iter((0..64).map(|_| Ok::<_, std::io::Error>(vec![b'v'; 64 << 10])));
    let streamed = http().post(server.url("/v1/sessions")).body(reqwest::Body::wrap_stream(chunks)).send().await.expect("an answer");
    assert_eq!(streamed.status(), 413);
    let problem: Value = streamed.json().await.unwrap();
    assert!(text(&problem["detail"]).contains("262144"), "{problem}");
    let formed = send_form(&server, form(&[("model", Some("a.obj"), &vec![b'v'; 2 << 20])])).await;
    assert_eq!(formed.status(), 413);
    assert_eq!(get(&server, "/healthz").await.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_server_says_when_to_come_back() {
    let server = Server::with(|sessions, _| sessions.sessions = 1).await;
    server.open(bar_obj(4)).await;
    let answer = http().post(server.url("/v1/sessions")).body(bar_obj(4)).send().await.unwrap();
    assert_eq!(answer.status(), 429);
    assert!(answer.headers()[header::RETRY_AFTER].to_str().unwrap().parse::<u32>().unwrap() >= 1);
    assert_eq!(answer.json::<Value>().await.unwrap()["code"], "RESOURCE_EXHAUSTED");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_sample_is_a_model_that_can_be_opened() {
    let server = Server::start().await;
    let sample = get(&server, "/v1/sample.glb").await;
    assert_eq!(sample.headers()[header::CONTENT_TYPE], "model/gltf-binary");
    let etag = sample.headers()[header::ETAG].clone();
    assert!(sample.bytes().await.unwrap().starts_with(b"glTF"));
    let again = http().get(server.url("/v1/sample.glb")).header("if-none-match", etag).send().await.unwrap();
    assert_eq!(again.status(), 304);
    let opened = http().post(server.url("/v1/sessions?sample=creature")).send().await.unwrap();
    assert_eq!(opened.status(), 201);
    let session: Value = opened.json().await.unwrap();
    assert!(session["model"]["vertices"].as_u64().unwrap() > 1000, "{}", session["model"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn operators_find_health_counts_and_description() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    assert_eq!(post(&server, &format!("/v1/sessions/{id}/solve"), turn_json(0.1)).await.status(), 200);
    assert_eq!(get(&server, "/healthz").await.status(), 200);
    assert_eq!(get(&server, "/readyz").await.status(), 200);
    let page = get(&server, "/").await;
    assert!(page.headers()[header::CONTENT_TYPE].to_str().unwrap().starts_with("text/html"));

    let counts = get(&server, "/metrics").await;
    assert!(counts.headers()[header::CONTENT_TYPE].to_str().unwrap().starts_with("application/openmetrics-text"));
    let counts = counts.text().await.unwrap();
    for line in [
        "pliant_sessions 1",
        "pliant_poses_solved_total 1",
        "pliant_requests_total{transport=\"http\",route=\"/v1/sessions/{id}/solve\",code=\"200\"} 1",
        "pliant_solve_seconds_count 1",
    ] {
        assert!(counts.lines().any(|l| l == line), "{line} is not in\n{counts}");
    }
    assert!(counts.ends_with("# EOF\n"));

    let described: Value = get(&server, "/openapi.json").await.json().await.unwrap();
    assert_eq!(described["openapi"], "3.1.0");
    // What is described answers: no path is unknown to the router, no method refused.
    for (path, methods) in described["paths"].as_object().unwrap() {
        for method in methods.as_object().unwrap().keys() {
            let path = path.replace("{id}", "nobody").replace("{handleId}", "none");
            let request = http().request(method.to_uppercase().parse().unwrap(), server.url(&path));
            let answer = request.send().await.unwrap();
            let status = answer.status().as_u16();
            let said = answer.text().await.unwrap();
            assert!(status != 405 && !said.contains("there is nothing at"), "{method} {path}: {status} {said}");
        }
    }
    let limits: Value = get(&server, "/v1/limits").await.json().await.unwrap();
    assert_eq!(limits["partBytes"], "1048576");
}

#[tokio::test(flavor = "multi_thread")]
async fn json_is_compressed_on_request_and_nothing_else() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let gzip = |path: String| http().get(server.url(&path)).header("accept-encoding", "gzip").send();
    let described = gzip("/openapi.json".into()).await.unwrap();
    assert_eq!(described.headers()[header::CONTENT_ENCODING], "gzip");
    let model = gzip(format!("/v1/sessions/{id}/model")).await.unwrap();
    assert!(!model.headers().contains_key(header::CONTENT_ENCODING));
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_foreign_origins_may_not_call() {
    let server = Server::start().await;
    let from = |origin: &'static str| http().post(server.url("/v1/sessions")).header("origin", origin).body(bar_obj(4)).send();
    let foreign = from("https://evil.example").await.unwrap();
    assert_eq!(foreign.status(), 403);
    assert!(!foreign.headers().contains_key("access-control-allow-origin"));
    let local = from("http://localhost:5173").await.unwrap();
    assert_eq!(local.status(), 201);
    assert_eq!(local.headers()["access-control-allow-origin"], "http://localhost:5173");
    let preflight = http()
        .request(reqwest::Method::OPTIONS, server.url("/v1/sessions"))
        .header("origin", "http://localhost:5173")
        .header("access-control-request-method", "PATCH")
        .header("access-control-request-headers", "content-type,idempotency-key")
        .send()
        .await
        .unwrap();
    assert!(preflight.status().is_success());
    assert!(preflight.headers()["access-control-allow-methods"].to_str().unwrap().contains("PATCH"));
    assert_eq!(preflight.headers()["access-control-allow-headers"], "content-type,idempotency-key");
}

#[tokio::test(flavor = "multi_thread")]
async fn http2_without_upgrade_speaks_the_same() {
    let server = Server::start().await;
    let client = reqwest::Client::builder().no_proxy().http2_prior_knowledge().build().unwrap();
    let answer = client.get(server.url("/v1/limits")).send().await.unwrap();
    assert_eq!((answer.version(), answer.status().as_u16()), (reqwest::Version::HTTP_2, 200));
}

#[tokio::test(flavor = "multi_thread")]
async fn one_connection_too_many_is_told_so() {
    let server = Server::with(|_, config| config.connections = 2).await;
    let silent = [TcpStream::connect(server.address).await.unwrap(), TcpStream::connect(server.address).await.unwrap()];
    let mut third = TcpStream::connect(server.address).await.unwrap();
    third.write_all(b"GET / HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    third.shutdown().await.unwrap();
    let mut told = String::new();
    within("the refusal", third.read_to_string(&mut told)).await.unwrap();
    assert!(told.starts_with("HTTP/1.1 503") && told.contains("retry-after: 1") && told.contains("UNAVAILABLE"), "{told}");
    drop(silent);
    eventually("a free place", async || http().get(server.url("/healthz")).send().await.is_ok_and(|a| a.status() == 200)).await;
    assert!(server.metric("pliant_connections_refused_total").await >= 1.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_that_does_not_begin_is_closed() {
    let server = Server::with(|_, config| config.header_timeout = Duration::from_millis(200)).await;
    for beginning in ["", "GET / HT", "PRI * HTTP/2.0\r\n", "GET / HTTP/1.1\r\nhost: example.org\r\nx-slow: "] {
        let mut socket = TcpStream::connect(server.address).await.unwrap();
        socket.write_all(beginning.as_bytes()).await.unwrap();
        let mut rest = Vec::new();
        // Closed or reset, and at most told that the time is over.
        let _ = within(&format!("the end of a connection that said {beginning:?}"), socket.read_to_end(&mut rest)).await;
        assert!(rest.is_empty() || rest.starts_with(b"HTTP/1.1 408"), "{beginning:?}: {}", String::from_utf8_lossy(&rest));
    }
}
