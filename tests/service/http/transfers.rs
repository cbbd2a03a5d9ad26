//! Downloads: entity tags, ranges, conditional requests.

use super::{get, post};
use crate::support::server::*;
use reqwest::header;
use serde_json::{Value, json};

#[tokio::test(flavor = "multi_thread")]
async fn downloads_honour_tags_and_ranges() {
    let server = Server::start().await;
    let model = bar_obj(24);
    let id = text(&server.open(model.clone()).await["id"]);
    let url = server.url(&path(&id, "/model"));
    let whole = http().get(&url).answer().await;
    assert_eq!(whole.status(), 200);
    assert_eq!(whole.headers()[header::ACCEPT_RANGES], "bytes");
    assert_eq!(
        header(&whole, header::CONTENT_DISPOSITION),
        format!("attachment; filename=\"{id}.obj\"")
    );
    let etag = header(&whole, header::ETAG).to_owned();
    assert!(etag.starts_with('"'), "a strong tag: {etag}");
    let bytes = whole.bytes().await.unwrap();
    assert_eq!(bytes, model.as_bytes(), "at rest the model comes back byte for byte");

    let ranged = |range: &str| http().get(&url).header("range", range);
    let part = ranged("bytes=10-19").answer().await;
    assert_eq!(part.status(), 206);
    assert_eq!(
        header(&part, header::CONTENT_RANGE),
        format!("bytes 10-19/{}", bytes.len())
    );
    assert_eq!(part.bytes().await.unwrap(), bytes.slice(10..20));
    let tail = ranged("bytes=-5").header("if-range", &etag).answer().await;
    assert_eq!(
        (tail.status().as_u16(), tail.bytes().await.unwrap()),
        (206, bytes.slice(bytes.len() - 5..))
    );
    let stale = ranged("bytes=0-4").header("if-range", "\"old\"").answer().await;
    assert_eq!(stale.status(), 200);
    let past = ranged(&format!("bytes={}-", bytes.len())).answer().await;
    assert_eq!(past.status(), 416);
    assert_eq!(header(&past, header::CONTENT_RANGE), format!("bytes */{}", bytes.len()));

    let known = http().get(&url).header("if-none-match", &etag).answer().await;
    assert_eq!(
        (known.status().as_u16(), header(&known, header::ETAG)),
        (304, etag.as_str())
    );
    let head = http().head(&url).answer().await;
    assert_eq!(
        (head.status().as_u16(), header(&head, header::CONTENT_LENGTH)),
        (200, bytes.len().to_string().as_str())
    );
    let ply = http().get(format!("{url}?format=ply")).answer().await;
    assert_ne!(header(&ply, header::ETAG), etag);

    // A changed shape is another thing.
    server.hold_ends(&id).await;
    assert_eq!(post(&server, &path(&id, "/solve"), turn_json(0.3)).await.status(), 200);
    let changed = http().get(&url).header("if-none-match", &etag).answer().await;
    assert_eq!(changed.status(), 200);
    assert_ne!(changed.bytes().await.unwrap(), bytes);
}

/// A glTF file whose buffer lies beside it, and that buffer.
fn split_gltf() -> (String, Vec<u8>) {
    let (points, triangles) = pliant::asset::shapes::box_with_cells(glam::DVec3::new(1.0, 1.0, 4.0), [2, 2, 8]);
    let mut bin: Vec<u8> = points
        .iter()
        .flat_map(|p| p.as_vec3().to_array())
        .flat_map(f32::to_le_bytes)
        .collect();
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
    let request = server
        .post("/v1/sessions")
        .header("content-type", "multipart/form-data; boundary=edge")
        .body(body);
    request.answer().await
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
    assert_eq!(
        (session["label"].as_str(), session["model"]["format"].as_str()),
        (Some("from a form"), Some("gltf"))
    );

    // The main file names the companion, and both come back as they were.
    let id = text(&session["id"]);
    let main = get(&server, &path(&id, "/model")).await;
    let link = header(&main, header::LINK).to_owned();
    assert_eq!(main.bytes().await.unwrap(), gltf.as_bytes());
    let target = link.split(['<', '>']).nth(1).unwrap();
    let companion = get(&server, target).await;
    assert_eq!(companion.status(), 200);
    assert_eq!(companion.bytes().await.unwrap(), bin);

    let alone = send_form(&server, form(&[("model", Some("bar.gltf"), gltf.as_bytes())])).await;
    assert_eq!(alone.status().as_u16() / 100, 4);
    let problem: Value = alone.json().await.unwrap();
    assert!(
        text(&problem["detail"]).contains("my bar.bin") || text(&problem["detail"]).contains("my%20bar.bin"),
        "{problem}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_form_with_wrong_parts_is_refused_by_name() {
    let server = Server::start().await;
    let obj = bar_obj(4);
    let model: (&str, Option<&str>, &[u8]) = ("model", Some("a.obj"), obj.as_bytes());
    let cases: [(Vec<u8>, &str); 7] = [
        (form(&[("options", None, b"{}")]), "model"),
        (form(&[model, model]), "two parts \"model\""),
        (
            form(&[model, ("options", None, b"{}"), ("options", None, b"{}")]),
            "two parts \"options\"",
        ),
        (form(&[model, ("colour", None, b"red")]), "colour"),
        (form(&[model, ("options", None, b"{\"colour\": 1}")]), "colour"),
        (
            form(&[model, ("f", Some("a.bin"), b"1"), ("g", Some("a.bin"), b"2")]),
            "a.bin",
        ),
        (
            b"--edge\r\ncontent-disposition: form-data; name=\"model\"\r\n\r\nv 0 0 0".to_vec(),
            "form",
        ),
    ];
    for (body, word) in cases {
        let answer = send_form(&server, body).await;
        assert_eq!(answer.status(), 400, "{word}");
        let problem: Value = answer.json().await.unwrap();
        assert!(text(&problem["detail"]).contains(word), "{problem} lacks {word}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_above_the_limit_is_reported_even_while_it_is_sent() {
    let server = Server::with(|sessions, _| sessions.upload_bytes = 256 << 10).await;
    // Announced: refused at once.
    let announced = server.post("/v1/sessions").body(vec![b'v'; 8 << 20]).answer().await;
    assert_eq!(announced.status(), 413);
    // Not announced: refused when the limit is passed.
    let chunks = futures::stream::iter((0..64).map(|_| Ok::<_, std::io::Error>(vec![b'v'; 64 << 10])));
    let streamed = server.post("/v1/sessions").body(reqwest::Body::wrap_stream(chunks));
    let problem = streamed.refusal(413).await;
    assert!(text(&problem["detail"]).contains("262144"), "{problem}");
    let formed = send_form(&server, form(&[("model", Some("a.obj"), &vec![b'v'; 2 << 20])])).await;
    assert_eq!(formed.status(), 413);
    assert_eq!(get(&server, "/healthz").await.status(), 200);
}
