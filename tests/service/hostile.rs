//! Broken and malicious models through the front door: every one gets a clear answer, the server serves on, and memory
//! stays bounded. What the right answer is, the data folder's manifest says.

use crate::support::data::{data_folder, files_below};
use crate::support::process::needed;
use crate::support::process::{peak_memory, runs_alone};
use crate::support::server::*;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// What the manifest asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Right {
    /// It opens and can be deformed.
    Works,
    /// It is refused.
    Refused,
    /// Either, as long as the answer is clear and finite.
    Either,
}

fn manifest(data: &Path) -> BTreeMap<String, Right> {
    let text = std::fs::read_to_string(data.join("MANIFEST.md")).expect("a manifest beside the data");
    let mut right = BTreeMap::new();
    for line in text.lines().filter(|l| l.starts_with("| hostile/")) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [path, _, answer] = cells[..] else { continue };
        // The sources of importer suites stand in the third column; they name no answer.
        let rule = match answer {
            a if a.contains("(or") || a.contains(" or ") => Right::Either,
            a if a.starts_with("4xx") => Right::Refused,
            a if a.starts_with("200") => Right::Works,
            _ => Right::Either,
        };
        right.insert(path.to_owned(), rule);
    }
    right
}

/// The upload of a file: a form with what lies beside it for glTF with files of its own, else the bytes.
fn upload(path: &Path) -> (Option<&'static str>, Vec<u8>) {
    let bytes = std::fs::read(path).expect("a readable file");
    if path.extension().is_none_or(|e| e != "gltf") {
        return (None, bytes);
    }
    let mut body = Vec::new();
    let mut part = |name: &str, file: &str, bytes: &[u8]| {
        body.extend(
            format!("--edge\r\ncontent-disposition: form-data; name=\"{name}\"; filename=\"{file}\"\r\n\r\n")
                .into_bytes(),
        );
        body.extend_from_slice(bytes);
        body.extend(b"\r\n");
    };
    part("model", "model.gltf", &bytes);
    let beside = std::fs::read_dir(path.parent().expect("a folder")).expect("a readable folder");
    for entry in beside {
        let other = entry.expect("a readable entry").path();
        let model = other.extension().is_some_and(|e| e == "gltf" || e == "glb");
        if other.is_file() && !model {
            let name = other.file_name().expect("a file").to_string_lossy().into_owned();
            part("companion", &name, &std::fs::read(&other).expect("a readable file"));
        }
    }
    body.extend(b"--edge--\r\n");
    (Some("multipart/form-data; boundary=edge"), body)
}

/// Opens a model and pulls one vertex of it; how that ended, or what was wrong with the answers.
async fn try_model(
    server: &Server,
    client: &reqwest::Client,
    (kind, bytes): (Option<&str>, Vec<u8>),
) -> Result<String, String> {
    let mut create = client.post(server.url("/v1/sessions")).body(bytes);
    if let Some(kind) = kind {
        create = create.header("content-type", kind);
    }
    let created = within("create", create.send())
        .await
        .map_err(|e| format!("no answer: {e}"))?;
    let status = created.status().as_u16();
    let body: Value = created
        .json()
        .await
        .map_err(|e| format!("{status} without JSON: {e}"))?;
    if status != 201 {
        return clear(status, &body).map(|detail| format!("{status} {detail}"));
    }
    let id = text(&body["id"]);
    let vertices = body["model"]["vertices"].as_u64().ok_or("no vertex count")?;
    let vertex =
        |id: &str, first: u64| json!({"id": id, "region": {"vertices": {"ranges": [{"first": first, "count": 1}]}}});
    let mut handles = vec![vertex("first", 0)];
    if vertices > 1 {
        handles.push(vertex("last", vertices - 1));
    }
    let moved = handles.last().map(|h| h["id"].clone());
    let url = |end: &str| server.url(&format!("/v1/sessions/{id}{end}"));
    let held = client.put(url("/handles")).json(&json!({"handles": handles}));
    let pose = json!({"pose": {"handles": [{"id": moved, "pose": {"translation": [0.1, 0, 0]}}]}});
    let solve = client
        .post(url("/solve"))
        .header("accept", "application/octet-stream")
        .json(&pose);
    let said = pulled([held, solve, client.get(url("/model"))], vertices).await?;
    let deleted = client.delete(url("")).send().await.map_err(|e| e.to_string())?;
    if deleted.status() == 204 {
        Ok(said)
    } else {
        Err(format!("{} on delete", deleted.status()))
    }
}

/// Sets handles, solves and exports; how that ended, or what was wrong with the answers.
async fn pulled(calls: [reqwest::RequestBuilder; 3], vertices: u64) -> Result<String, String> {
    for (step, call) in ["handles", "solve", "export"].into_iter().zip(calls) {
        let answer = within(step, call.send()).await.map_err(|e| e.to_string())?;
        let status = answer.status().as_u16();
        if status != 200 {
            let body = answer.json().await.map_err(|e| e.to_string())?;
            return Ok(format!("{status} on {step}: {}", clear(status, &body)?));
        }
        if step == "solve" {
            let numbers = floats(&answer.bytes().await.map_err(|e| e.to_string())?);
            if numbers.len() as u64 != vertices * 3 {
                return Err(format!("{} numbers for {vertices} vertices", numbers.len()));
            }
            if numbers.iter().any(|n| !n.is_finite()) {
                return Err("numbers that are not finite".into());
            }
        }
    }
    Ok("works".to_owned())
}

/// The detail of a refusal, when it is one that a user can work with.
fn clear(status: u16, problem: &Value) -> Result<String, String> {
    let detail = problem["detail"].as_str().unwrap_or_default();
    if !(400..500).contains(&status) {
        return Err(format!("{status}: {detail}"));
    }
    let panicky = ["panick", "unwrap", "index out of", "overflow when", ".rs:"]
        .iter()
        .any(|word| detail.contains(word));
    if detail.len() < 12 || panicky {
        return Err(format!("{status} with an unclear text: {detail:?}"));
    }
    Ok(detail.to_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn every_hostile_file_gets_a_clear_answer() {
    if !runs_alone("hostile::every_hostile_file_gets_a_clear_answer") {
        return;
    }
    let data = needed!(data_folder("hostile files"));
    let right = manifest(&data);
    let server = Server::with(|sessions, _| {
        sessions.memory_bytes = 1 << 30;
        sessions.upload_bytes = 64 << 20;
    })
    .await;
    let client = http();
    // One ordinary round first, so that what follows is measured against a server that has worked.
    let ordinary = try_model(&server, &client, (None, bar_obj(24).into_bytes())).await;
    assert_eq!(ordinary.as_deref(), Ok("works"));
    let before = peak_memory();
    let (mut wrong, mut tried) = (Vec::new(), 0);
    for path in files_below(&data.join("hostile"), |_| true) {
        let name = path
            .strip_prefix(&data)
            .expect("below the data folder")
            .display()
            .to_string();
        let outcome = try_model(&server, &client, upload(&path)).await;
        tried += 1;
        println!("{name}: {outcome:?}");
        let rule = right.get(&name).copied().unwrap_or(Right::Either);
        let fits = match (&outcome, rule) {
            (Err(_), _) => false,
            (Ok(_), Right::Either) => true,
            (Ok(said), Right::Works) => said == "works",
            (Ok(said), Right::Refused) => said.starts_with('4'),
        };
        if !fits {
            wrong.push(format!("{name}: {rule:?}, but {outcome:?}"));
        }
    }
    let ordinary = try_model(&server, &client, (None, bar_obj(24).into_bytes())).await;
    assert_eq!(ordinary.as_deref(), Ok("works"), "the server serves on");
    assert!(tried > 0, "the folder is empty");
    let grown = peak_memory().saturating_sub(before);
    println!("{tried} files; peak memory grew by {} MiB", grown >> 20);
    assert!(grown < 1 << 30, "peak memory grew by {grown} bytes");
    assert!(
        wrong.is_empty(),
        "{} of {tried} answers are wrong:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

/// Things that need no data: requests that are no models at all.
#[tokio::test(flavor = "multi_thread")]
async fn bytes_that_are_nothing_are_refused_quickly() {
    let server = Server::start().await;
    let client = http();
    let zeros = vec![0u8; 1 << 20];
    let noise: Vec<u8> = (0..1u32 << 16)
        .flat_map(|i| i.wrapping_mul(2_654_435_761).to_le_bytes())
        .collect();
    let mut glb = b"glTF\x02\x00\x00\x00".to_vec();
    glb.extend(u32::MAX.to_le_bytes());
    glb.extend([0xff; 64]);
    let stl = [vec![b' '; 80], u32::MAX.to_le_bytes().to_vec(), vec![0; 50]].concat();
    let nested = [
        b"{\"asset\": {\"version\": \"2.0\"}, \"extras\": ".as_slice(),
        &b"[".repeat(1 << 16),
    ]
    .concat();
    let faces = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n".to_vec();
    for (name, bytes) in [
        ("zeros", zeros),
        ("noise", noise),
        ("glb", glb),
        ("stl", stl),
        ("package", b"PK\x03\x043D/3dmodel.model PK\x05\x06".repeat(64)),
        ("nested", nested),
        ("faces", faces),
    ] {
        let outcome = try_model(&server, &client, (None, bytes)).await;
        assert!(
            outcome.as_ref().is_ok_and(|said| said.starts_with('4')),
            "{name}: {outcome:?}"
        );
    }
}

/// Bytes that are no request either.
#[tokio::test(flavor = "multi_thread")]
async fn connections_that_speak_nonsense_harm_no_one() {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    let server = Server::start().await;
    let preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".as_slice();
    let cases: [Vec<u8>; 8] = [
        vec![0; 4096],
        vec![0xff; 4096],
        b"GET\r\n\r\n".repeat(100),
        [b"GET / HTTP/1.1\r\n".as_slice(), &b"a: b\r\n".repeat(10_000), b"\r\n"].concat(),
        [b"GET /".as_slice(), &b"a".repeat(1 << 18), b" HTTP/1.1\r\n\r\n"].concat(),
        b"POST /v1/sessions HTTP/1.1\r\nhost: x\r\ntransfer-encoding: chunked\r\n\r\nffffffffffffffffff\r\n".to_vec(),
        [preface, &[0xff; 512]].concat(),
        // A frame that says that it is larger than any may be.
        [preface, &[0xff, 0xff, 0xff, 0x04, 0, 0, 0, 0, 0], &[0; 512]].concat(),
    ];
    for bytes in cases {
        let mut socket = tokio::net::TcpStream::connect(server.address).await.unwrap();
        let _ = socket.write_all(&bytes).await;
        let _ = socket.shutdown().await;
        let mut answer = Vec::new();
        let _ = within("the end of the connection", socket.read_to_end(&mut answer)).await;
        assert!(
            !answer.starts_with(b"HTTP/1.1 5"),
            "{}",
            String::from_utf8_lossy(&answer)
        );
    }
    assert_eq!(server.get("/healthz").status().await, 200);
}
