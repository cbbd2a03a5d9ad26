//! What the server says: the detail of problem documents, messages of pose errors, warnings.

use super::Said;
use crate::support::program::ServedProgram;
use crate::support::server::*;
use pliant::server::auth::{TokenEntry, token_digest};
use pliant::session::{Tenant, TenantQuota};
use pliant::wire::pb::{self, deform_request, deform_response};
use serde_json::{Value, json};

/// A triangle alone: a surface without an inside.
const OPEN_SHEET: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

const UNKNOWN_SESSION: &str = "00000000000000000000000000000000";

/// Provocation | method, path | content type | body. `{id}` is a session with handles, `{bare}` one without.
const CALLS: &str = r#"
an empty upload             | POST /v1/sessions              | -                | -
no model                    | POST /v1/sessions              | -                | what is this
a line that is broken       | POST /v1/sessions?format=obj   | -                | v 0 0 zero
an inside that is required  | POST /v1/sessions?format=obj&volumeGraph=REQUIRED | - | {sheet}
a model that is too large   | POST /v1/sessions              | -                | {large model}
an upload that is too large | POST /v1/sessions?format=obj   | -                | {large upload}
a session that is gone      | GET /v1/sessions/{unknown}      | -                | -
no handles yet              | POST /v1/sessions/{bare}/solve | application/json | {}
a handle that is none       | POST /v1/sessions/{id}/solve   | application/json | {"pose": {"handles": [{"id": "nose"}]}}
a region beside the model   | PUT /v1/sessions/{id}/handles  | application/json | {"handles": [{"id": "a", "region": {"sphere": {"center": [9, 9, 9], "radius": 1}}}]}
too many handles            | PUT /v1/sessions/{id}/handles  | application/json | {many handles}
a field that is none        | POST /v1/sessions/{id}/solve   | application/json | {"pse": {}}
no number                   | POST /v1/sessions/{id}/solve   | application/json | {"pose": {"handles": [{"id": "top", "pose": {"translation": ["NaN", 0, 0]}}]}}
no content type             | POST /v1/sessions/{id}/solve   | text/plain       | {}
a message that is too large | POST /v1/sessions/{id}/solve   | application/json | {large message}
nothing to undo             | POST /v1/sessions/{bare}/undo  | -                | -
a cut beside the model      | POST /v1/sessions/{id}/edits   | application/json | {"cut": {"plane": {"normal": [0, 0, 1], "offset": 99}}}
a division without handles  | POST /v1/sessions/{bare}/edits | application/json | {"on": "REST", "subdivide": {"auto": true}}
triangles beyond measure    | POST /v1/sessions/{id}/edits   | application/json | {"remesh": {"edgeLength": 0.0001}}
a clip that is none         | POST /v1/sessions/{id}/animations | application/json | {}
a recording that is none    | POST /v1/sessions/{id}/animations | application/json | {"bvh": "aGVsbG8K"}
a recording without a rig    | POST /v1/sessions/{id}/animations | application/json | {"bvh": "SElFUkFSQ0hZClJPT1QgbG93CnsKT0ZGU0VUIDAgMCAwCkNIQU5ORUxTIDMgWnJvdGF0aW9uIFhyb3RhdGlvbiBZcm90YXRpb24KRW5kIFNpdGUKewpPRkZTRVQgMCAxIDAKfQp9Ck1PVElPTgpGcmFtZXM6IDIKRnJhbWUgVGltZTogMC4wMwowIDAgMAowIDAgOQo="}
a browser at the stream     | GET /v1/sessions/{id}/stream   | -                | -
a path that is none         | GET /v1/session                | -                | -
"#;

/// The text of a problem document.
async fn detail(request: reqwest::RequestBuilder) -> String {
    let answer = request.answer().await;
    assert!(!answer.status().is_success(), "{}", answer.status());
    let problem: Value = answer.json().await.expect("a problem document");
    text(&problem["detail"])
}

async fn said_of(by: &'static str, request: reqwest::RequestBuilder) -> Said {
    let text = detail(request).await;
    Said { by, text }
}

pub async fn provoke() -> Vec<Said> {
    let server = Server::with(|sessions, _| {
        sessions.upload_bytes = 256 << 10;
        sessions.message_bytes = 64 << 10;
        sessions.vertices = 1000;
        sessions.sessions = 4;
        sessions.handles = 3;
    })
    .await;
    let bare = text(&server.open(bar_obj(8)).await["id"]);
    let id = server.bar_session().await;
    let many: Vec<Value> = (0..4)
        .map(|k| json!({"id": k.to_string(), "region": {"halfSpace": {"normal": [0, 0, 1], "offset": 3}}}))
        .collect();
    let fill = |cell: &str| match cell {
        "-" => String::new(),
        "{sheet}" => OPEN_SHEET.to_owned(),
        "{large model}" => bar_obj(200),
        "{large upload}" => " ".repeat(300 << 10),
        "{large message}" => " ".repeat(65 << 10),
        "{many handles}" => json!({"handles": many}).to_string(),
        cell => cell
            .replace("{id}", &id)
            .replace("{bare}", &bare)
            .replace("{unknown}", UNKNOWN_SESSION),
    };
    let mut said = Vec::new();
    for [by, call, kind, body] in rows(CALLS) {
        let (method, path) = call.split_once(' ').expect("method and path");
        let mut request = http()
            .request(method.parse().expect("a method"), server.url(&fill(path)))
            .body(fill(body));
        if kind != "-" {
            request = request.header("content-type", kind);
        }
        let text = detail(request).await.replace(UNKNOWN_SESSION, "ID");
        said.push(Said { by, text });
    }
    said.extend(of_streams(&server, &id).await);
    said.extend(of_origins_and_room(&server).await);
    said.extend(of_warnings().await);
    said.extend(of_strangers().await);
    said.extend(of_quotas().await);
    said.extend(of_stores().await);
    said.push(of_leaving().await);
    said
}

/// A tenant that has used up what it may use.
async fn of_quotas() -> Vec<Said> {
    let unlimited = TenantQuota::default();
    let of_default = async |quota| Server::with(|sessions, _| sessions.quotas.default = quota).await;
    let open = |server: &Server, along| server.post("/v1/sessions").body(bar_obj(along));
    let one = of_default(TenantQuota {
        sessions: Some(1),
        streams: Some(1),
        ..unlimited.clone()
    })
    .await;
    let id = one.bar_session().await;
    let path = format!("/v1/sessions/{id}/stream");
    let _held = one.socket(&path).await.expect("a socket");
    let upgrade = [
        ("connection", "upgrade"),
        ("upgrade", "websocket"),
        ("sec-websocket-version", "13"),
        ("sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ=="),
    ];
    let ask = http().get(one.url(&path));
    let streams = upgrade.iter().fold(ask, |ask, (name, value)| ask.header(*name, *value));
    let mut said = vec![
        said_of("a session beyond the quota", open(&one, 4)).await,
        said_of("a stream beyond the quota", streams).await,
    ];
    let slow = of_default(TenantQuota {
        upload_bytes_per_minute: Some(bar_obj(8).len() as u64 + 10),
        solve_seconds_per_minute: Some(1e-6),
        ..unlimited.clone()
    })
    .await;
    let id = text(&slow.open(bar_obj(8)).await["id"]);
    let handles = http().put(slow.url(&format!("/v1/sessions/{id}/handles")));
    said.push(said_of("an upload beyond the quota", open(&slow, 8)).await);
    said.push(said_of("work beyond the quota", handles.json(&json!({"handles": ends()}))).await);
    let small = of_default(TenantQuota {
        memory_bytes: Some(1 << 20),
        ..unlimited
    })
    .await;
    let full = loop {
        let answer = open(&small, 24).answer().await;
        if answer.status() != 201 {
            break answer.json::<Value>().await.expect("a problem document");
        }
    };
    said.push(Said {
        by: "memory beyond the quota",
        text: text(&full["detail"]),
    });
    said.push(Said {
        by: "a store beyond the quota",
        text: of_full_store().await,
    });
    said
}

/// A store that is damaged, and one that cannot be written.
async fn of_stores() -> Vec<Said> {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let server = ServedProgram::start(&data, &[]);
    let id = server.open(bar_obj(8), "").await;
    server.kill();
    let shelf = std::fs::read_dir(data.join("objects")).expect("shelves").next();
    let shelf = shelf.expect("a shelf").expect("readable").path();
    for object in std::fs::read_dir(&shelf).expect("a shelf") {
        std::fs::write(object.expect("an object").path(), "damaged").expect("writable");
    }
    let server = ServedProgram::start(&data, &[]);
    let get = server.get(&format!("/v1/sessions/{id}"));
    let damaged = detail(get).await;
    std::fs::remove_dir_all(data.join("unfinished")).expect("removed");
    std::fs::write(data.join("unfinished"), "no folder").expect("written");
    let created = server.post("/v1/sessions").body(bar_obj(9));
    vec![
        Said {
            by: "a session that is damaged",
            text: damaged,
        },
        said_of("a store that cannot be written", created).await,
    ]
}

async fn of_full_store() -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("pliant.toml");
    let quota = format!("[quotas]\nstored_bytes = {}\n", bar_obj(8).len() + 2000);
    std::fs::write(&config, quota).expect("written");
    let arguments = ["--config", config.to_str().expect("UTF-8")];
    let server = ServedProgram::start(&folder.path().join("data"), &arguments);
    server.open(bar_obj(8), "").await;
    detail(server.post("/v1/sessions").body(bar_obj(8))).await
}

/// What a stream says about a pose.
async fn of_streams(server: &Server, id: &str) -> Vec<Said> {
    let mut said = Vec::new();
    let mut refused = async |by: &'static str, message: deform_request::Message| {
        let mut socket = server.stream_socket(id).await;
        socket.send(message).await;
        let text = loop {
            match socket.next().await {
                Came::Response(pb::DeformResponse {
                    message: Some(deform_response::Message::Error(error)),
                    ..
                }) => break error.message,
                Came::Response(_) => {}
                Came::Closed(why) => break why.map(|(_, reason)| reason).unwrap_or_default(),
            }
        };
        said.push(Said { by, text });
    };
    let wide = pb::Options {
        window: 64,
        ..pb::Options::default()
    };
    refused("a window that is too large", deform_request::Message::Options(wide)).await;
    let keyed = pb::Pose {
        idempotency_key: "mine".into(),
        ..turned(1, 0.1, false)
    };
    refused("a key of a drag", deform_request::Message::Pose(keyed)).await;
    said
}

/// Pages of elsewhere, and a server that is full.
async fn of_origins_and_room(server: &Server) -> Vec<Said> {
    let foreign = server
        .post("/v1/sessions")
        .header("origin", "https://example.org")
        .body(bar_obj(4));
    let foreign = said_of("a page of another origin", foreign).await;
    let misaddressed = said_of(
        "a name that is not the server's",
        server.get("/v1/limits").header("host", "mesh.example.org:7411"),
    )
    .await;
    server.open(bar_obj(4)).await;
    server.open(bar_obj(4)).await;
    let full = said_of(
        "no room for another session",
        server.post("/v1/sessions").body(bar_obj(4)),
    )
    .await;
    let open = |server: &Server| server.post("/v1/sessions").body(bar_obj(2000));
    let small = Server::with(|sessions, _| sessions.memory_bytes = 2 << 20).await;
    let alone = said_of("a model that needs more memory than there is", open(&small)).await;
    // The least room in which one such model can be opened has none for two.
    let mut room = 14 << 20;
    let one = loop {
        let server = Server::with(|sessions, _| sessions.memory_bytes = room).await;
        let answer = open(&server).answer().await;
        if answer.status() == 201 {
            break server;
        }
        assert!(room < 128 << 20, "{}", answer.text().await.unwrap_or_default());
        room += 2 << 20;
    };
    let both = said_of("no memory for another session", open(&one)).await;
    vec![foreign, misaddressed, full, alone, both]
}

/// What was noticed in a model that opened all the same.
async fn of_warnings() -> Vec<Said> {
    let server = Server::start().await;
    let sheet = server.open(OPEN_SHEET.to_owned()).await;
    let warning = |of: &Value, by, code: &str| {
        let all = of["warnings"].as_array().cloned().unwrap_or_default();
        let found = all.into_iter().find(|w| w["code"] == code).unwrap_or_default();
        Said {
            by,
            text: format!("{code}: {}", text(&found["message"])),
        }
    };
    let without = warning(&sheet, "a surface without an inside", "no-volume-graph");
    let square = "mtllib square.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n".to_owned();
    let bare = server.open(square.clone()).await;
    let library = warning(&bare, "an OBJ without its library", "library-missing");
    let parts = [
        ("model", "square.obj", square.as_str()),
        ("companion", "square.mtl", "newmtl a\nmap_Kd rust.png\nbump bumps.png\n"),
        ("companion", "bumps.png", "any"),
    ];
    let parts = parts.map(|(name, file, text)| {
        format!("--edge\r\ncontent-disposition: form-data; name=\"{name}\"; filename=\"{file}\"\r\n\r\n{text}\r\n")
    });
    let opened = server
        .post("/v1/sessions")
        .header("content-type", "multipart/form-data; boundary=edge")
        .body(parts.concat() + "--edge--\r\n");
    let opened = opened.document().await;
    let image = warning(&opened, "an OBJ without its picture", "image-missing");
    let heights = warning(&opened, "a picture of heights", "bump-map");
    let id = server.bar_session().await;
    let over = json!({"handles": [
        {"id": "base", "region": {"halfSpace": {"normal": [0, 0, -1], "offset": -2}}},
        {"id": "top", "region": {"halfSpace": {"normal": [0, 0, 1], "offset": 1}}},
    ]});
    let set = server.put(&format!("/v1/sessions/{id}/handles")).json(&over);
    let set = set.document().await;
    let overlap = warning(&set, "handles that overlap", "overlapping-handles");
    let bent = json!({"stiff": {"all": true}, "handles": [
        {"id": "base", "region": {"halfSpace": {"normal": [0, 0, -1], "offset": -0.5}}},
        {"id": "top", "region": {"halfSpace": {"normal": [0, 0, 1], "offset": 3}}},
    ]});
    let bent = server.put(&format!("/v1/sessions/{id}/handles")).json(&bent);
    let bent = bent.document().await;
    let bent = warning(&bent, "a stiff part between handles", "stiff-part-held");
    vec![without, library, image, heights, overlap, bent]
}

/// A server that must know who asks.
async fn of_strangers() -> Vec<Said> {
    let entry = |token: &str, expires| TokenEntry {
        tenant: Tenant("a".into()),
        sha256: token_digest(token),
        name: "a".into(),
        expires,
        metrics: false,
    };
    let tokens = vec![
        entry("known", None),
        entry("old", Some(std::time::SystemTime::UNIX_EPOCH)),
    ];
    let server = Server::with(|_, config| config.auth.tokens = tokens).await;
    let limits = || server.get("/v1/limits");
    let calls = [
        ("no token", limits()),
        ("an unknown token", limits().bearer_auth("unknown")),
        ("an old token", limits().bearer_auth("old")),
        ("a password", limits().basic_auth("a", Some("b"))),
        ("counts of all", server.get("/metrics").bearer_auth("known")),
    ];
    let mut said = Vec::new();
    for (by, call) in calls {
        let text = detail(call).await;
        said.push(Said { by, text });
    }
    said
}

/// A server that was asked to stop while a stream is open.
async fn of_leaving() -> Said {
    let mut server = Server::start().await;
    let id = server.bar_session().await;
    let client = http();
    // A connection that is open already is still answered.
    let first = client.get(server.url("/healthz")).answer().await;
    first.bytes().await.expect("a body");
    let mut socket = server.stream_socket(&id).await;
    let pose = deform_request::Message::Pose(turned(1, 0.1, false));
    socket.send(pose).await;
    socket.next().await;
    server.ask_to_stop();
    let mut text = String::new();
    eventually("a refusal", async || {
        let asked = client.post(server.url("/v1/sessions")).body(bar_obj(4)).send().await;
        let Ok(answer) = asked else { return false };
        text = answer
            .json::<Value>()
            .await
            .map(|p| p["detail"].as_str().unwrap_or_default().to_owned())
            .unwrap_or_default();
        !text.is_empty()
    })
    .await;
    Said {
        by: "a server that is leaving",
        text,
    }
}
