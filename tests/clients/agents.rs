//! `pliant mcp` and `/mcp` as agents use them: the protocol, what is refused, and written tasks with checked outcomes.

#[path = "agents/talk.rs"]
mod talk;
#[path = "agents/tasks.rs"]
mod tasks;

use crate::support::program::ServedProgram;
use crate::support::server::{AnsweredCall as _, bar_obj, text};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use pliant::asset::sample;
use pliant::server::auth::token_digest;
use serde_json::{Value, json};
use std::path::Path;
use talk::{Agent, facts, picture_size, refused};

fn folder_with(name: &str, bytes: impl AsRef<[u8]>) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join(name), bytes).expect("written");
    folder
}

#[test]
fn a_session_by_stdio_from_open_to_export() {
    let folder = folder_with("creature.glb", sample::creature_glb());
    let mut agent = Agent::start(folder.path());
    let tools = agent.request("tools/list", json!({}));
    let names: Vec<&str> = tools["result"]["tools"]
        .as_array()
        .expect("tools")
        .iter()
        .filter_map(|t| t["name"].as_str())
        .collect();
    assert_eq!(
        names,
        [
            "open", "look", "region", "pose", "edit", "undo", "redo", "export", "close", "sessions"
        ]
    );

    let page = crate::support::process::file_of_repository("deploy/docs/agents.md");
    let told = crate::support::book::table(&page, "| tool | what |");
    let titles = tools["result"]["tools"]
        .as_array()
        .expect("tools")
        .iter()
        .map(|t| [text(&t["name"]), text(&t["title"])]);
    assert_eq!(
        told,
        titles.map(|row| row.to_vec()).collect::<Vec<_>>(),
        "the table of deploy/docs/agents.md"
    );

    let opened = agent.call("open", json!({"path": "creature.glb", "front": "x"}));
    let session = text(&facts(&opened)["session"]);
    assert_eq!(picture_size(&opened), [960, 480]);
    let named = agent.call(
        "region",
        json!({"session": session, "words": "tail", "name": "The Wag"}),
    );
    assert_eq!(facts(&named)["name"], "wag");
    let posed = agent.call(
        "pose",
        json!({"session": session, "held": ["bottom 10%"],
        "moved": [{"region": "wag", "translation": [0, 0.3, 0]}]}),
    );
    let moved = &facts(&posed)["moved"][0];
    assert!(facts(&posed)["quality"]["flippedTriangles"].is_number(), "{posed}");
    let risen = moved["center"][1].as_f64().expect("a number");
    let center_of = |look: &Value| facts(look)["highlight"][0]["center"][1].as_f64().expect("a number");
    let look = json!({"session": session, "highlight": ["wag"], "picture": {"views": ["three-quarter"], "width": 200, "height": 100}});
    let seen = agent.call("look", look.clone());
    assert_eq!(picture_size(&seen), [200, 100]);
    assert!((center_of(&seen) - risen).abs() < 1e-9);
    agent.call("undo", json!({"session": session}));
    let back = center_of(&agent.call("look", look.clone()));
    assert!(back < risen - 0.25, "{back} {risen}");
    agent.call("redo", json!({"session": session}));
    assert_eq!(center_of(&agent.call("look", look)), risen);

    let written = agent.call("export", json!({"session": session, "path": "out/posed.obj"}));
    assert_eq!(facts(&written)["files"], json!(["out/posed.obj"]));
    assert!(folder.path().join("out/posed.obj").exists());
    refused(
        &agent.call("export", json!({"session": session, "path": "out/posed.obj"})),
        "ALREADY_EXISTS",
        "path",
    );
    let list = agent.call("sessions", json!({}));
    assert_eq!(facts(&list)["sessions"][0]["session"], session);
    agent.call("close", json!({"session": session}));
    refused(&agent.call("look", json!({"session": session})), "NOT_FOUND", "");
    agent.end();
}

#[test]
fn what_is_wrong_is_said_and_the_program_goes_on() {
    let outer = tempfile::tempdir().expect("a folder");
    let inner = outer.path().join("in");
    std::fs::create_dir(&inner).expect("a folder");
    std::fs::write(outer.path().join("secret.obj"), bar_obj(8)).expect("written");
    std::os::unix::fs::symlink(outer.path(), inner.join("out")).expect("a link");
    let mut agent = Agent::start(&inner);
    let outside = outer.path().join("secret.obj").display().to_string();
    for path in ["../secret.obj", "out/secret.obj", &outside, "/etc/passwd"] {
        refused(&agent.call("open", json!({"path": path})), "PERMISSION_DENIED", "path");
    }
    refused(&agent.call("open", json!({"path": "none.glb"})), "NOT_FOUND", "path");
    refused(&agent.call("open", json!({})), "INVALID_ARGUMENT", "");
    refused(
        &agent.call("open", json!({"sample": "creature", "colour": 1})),
        "INVALID_ARGUMENT",
        "colour",
    );
    refused(&agent.call("open", json!({"data": "!!!!"})), "INVALID_ARGUMENT", "data");
    let session = text(&facts(&agent.call("open", json!({"sample": "creature"})))["session"]);
    for (tool, arguments, field) in [
        ("look", json!({"session": 7}), "session"),
        (
            "look",
            json!({"session": session, "picture": {"views": []}}),
            "picture.views",
        ),
        (
            "look",
            json!({"session": session, "picture": {"width": 100000}}),
            "picture.width",
        ),
        (
            "region",
            json!({"session": session, "words": "x".repeat(1000)}),
            "words",
        ),
        ("region", json!({"session": session, "words": "carburettor"}), "words"),
        ("pose", json!({"session": session, "moved": []}), "moved"),
        (
            "pose",
            json!({"session": session, "moved": [{"region": "top"}]}),
            "moved[0]",
        ),
        (
            "pose",
            json!({"session": session, "moved": [{"region": "top", "aim": "sideways"}]}),
            "moved[0].aim",
        ),
        (
            "pose",
            json!({"session": session, "moved": [{"region": "top", "aim": 7}]}),
            "moved[0].aim",
        ),
        (
            "pose",
            json!({"session": session, "moved": [{"region": "top", "rotation": {"axis": [1], "degrees": 40}}]}),
            "moved[0].rotation.axis",
        ),
        (
            "pose",
            json!({"session": session, "moved": [{"region": "top", "scale": 1e30}]}),
            "moved[0].scale",
        ),
        (
            "edit",
            json!({"session": session, "operation": {"explode": {}}}),
            "operation.explode",
        ),
        (
            "edit",
            json!({"session": session, "operation": {"delete": {"region": {"words": "hat"}}}}),
            "operation.delete.region.words",
        ),
        ("export", json!({"session": session, "path": "a.xyz"}), "path"),
        ("export", json!({"session": session, "path": "out/a.glb"}), "path"),
    ] {
        let answer = agent.call(tool, arguments.clone());
        assert_eq!(answer["isError"], true, "{tool} {arguments}");
        assert_eq!(facts(&answer)["field"], field, "{tool} {arguments}: {answer}");
    }
    // Three angles, as other programs take them.
    let turned = json!({"session": session, "moved": [{"region": "top", "rotation": [0, 0, 40]}]});
    let answer = agent.call("pose", turned);
    refused(&answer, "INVALID_ARGUMENT", "moved[0].rotation");
    let allowed = "expected an axis and degrees, such as {\\\"axis\\\": \\\"z\\\", \\\"degrees\\\": 40}";
    assert!(answer.to_string().contains(allowed), "{answer}");
    let said = agent
        .call("region", json!({"session": session, "words": "carburettor"}))
        .to_string();
    assert!(said.contains("top quarter") && said.contains("tip 1"), "{said}");
    let no_body = "no body was found that stands along y and faces x";
    assert!(!said.contains(no_body), "{said}");
    let said = agent
        .call("region", json!({"session": session, "words": "left elbow"}))
        .to_string();
    assert!(said.contains(no_body), "{said}");
    assert!(!outer.path().join("a.glb").exists());

    let unknown = agent.request("tools/call", json!({"name": "explode", "arguments": {}}));
    assert_eq!(unknown["error"]["code"], -32602);
    // Neither of these is a message; both are passed over.
    agent.send(&"[".repeat(1_000_000));
    agent.send(&format!("{{\"jsonrpc\": \"2.0\", \"x\": \"{}\"}}", "y".repeat(8 << 20)));
    assert_eq!(
        facts(&agent.call("sessions", json!({})))["sessions"]
            .as_array()
            .map(Vec::len),
        Some(1)
    );
    agent.end();
}

#[test]
fn a_call_that_is_cancelled_stops_and_one_that_takes_long_says_so() {
    let folder = folder_with(
        "sheet.obj",
        crate::support::shapes::obj_text(&crate::support::shapes::sheet(700, 700)),
    );
    let mut agent = Agent::start(folder.path());
    let call = json!({"name": "open", "arguments": {"path": "sheet.obj"}, "_meta": {"progressToken": "t"}});
    let id = agent.begin("tools/call", call);
    let note = agent.next();
    assert_eq!(note["method"], "notifications/progress", "{note}");
    assert_eq!(note["params"]["progressToken"], "t");
    agent
        .send(&json!({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": id}}).to_string());
    // Nothing was opened: the call was given up.
    let list = agent.call("sessions", json!({}));
    assert_eq!(facts(&list)["sessions"], json!([]));
    agent.end();
}

fn guarded(folder: &Path) -> ServedProgram {
    let table = |tenant: &str, token: &str| {
        let sha256: String = token_digest(token).iter().map(|b| format!("{b:02x}")).collect();
        format!("[[auth.tokens]]\ntenant = \"{tenant}\"\nsha256 = \"{sha256}\"\n")
    };
    let config = folder.join("pliant.toml");
    std::fs::write(&config, table("studio", "anna") + &table("other", "bert")).expect("written");
    let arguments = ["--config", config.to_str().expect("UTF-8")];
    ServedProgram::start_in_memory(folder.join("log"), &arguments)
}

async fn ask(server: &ServedProgram, token: &str, method: &str, params: Value) -> (u16, Value) {
    let message = json!({"jsonrpc": "2.0", "id": 1, "method": method, "params": params});
    let call = server
        .post("/mcp")
        .header("accept", "application/json, text/event-stream")
        .json(&message);
    let call = if token.is_empty() {
        call
    } else {
        call.bearer_auth(token)
    };
    let answer = call.answer().await;
    let status = answer.status().as_u16();
    (status, answer.json().await.unwrap_or(Value::Null))
}

async fn call(server: &ServedProgram, token: &str, tool: &str, arguments: Value) -> Value {
    let (status, answer) = ask(
        server,
        token,
        "tools/call",
        json!({"name": tool, "arguments": arguments}),
    )
    .await;
    assert_eq!(status, 200, "{answer}");
    answer["result"].clone()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_http_with_tokens_and_tenants() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = guarded(folder.path());
    let handshake =
        json!({"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "t", "version": "1"}});
    assert_eq!(ask(&server, "", "initialize", handshake.clone()).await.0, 401);
    assert_eq!(ask(&server, "wrong", "initialize", handshake.clone()).await.0, 401);
    let (_, hello) = ask(&server, "anna", "initialize", handshake).await;
    assert_eq!(hello["result"]["serverInfo"]["name"], "pliant", "{hello}");
    let (_, list) = ask(&server, "anna", "tools/list", json!({})).await;
    assert!(
        list["result"]["tools"][0]["inputSchema"]["properties"]
            .get("path")
            .is_none(),
        "{list}"
    );

    let data = STANDARD.encode(bar_obj(8));
    let opened = call(&server, "anna", "open", json!({"data": data, "name": "bar.obj"})).await;
    let session = text(&facts(&opened)["session"]);
    // The same session as that of HTTP.
    let described = server
        .get(&format!("/v1/sessions/{session}"))
        .bearer_auth("anna")
        .document()
        .await;
    assert_eq!(described["id"], session);
    let named = call(
        &server,
        "anna",
        "region",
        json!({"session": session, "words": "left end", "name": "end"}),
    )
    .await;
    assert!(facts(&named)["vertices"].as_u64() > Some(3), "{named}");
    let pose =
        json!({"session": session, "held": ["right end"], "moved": [{"region": "end", "translation": [0, 0.5, 0]}]});
    let posed = call(&server, "anna", "pose", pose).await;
    assert_eq!(posed["isError"], false, "{posed}");
    let export = call(&server, "anna", "export", json!({"session": session, "format": "obj"})).await;
    let blob = text(&export["content"][1]["resource"]["blob"]);
    let model = STANDARD.decode(blob).expect("base64");
    assert!(model.starts_with(b"v ") || String::from_utf8_lossy(&model).contains("\nv "));

    // Another tenant knows nothing of it, nor of its names.
    for (tool, arguments) in [
        ("look", json!({"session": session})),
        (
            "pose",
            json!({"session": session, "moved": [{"region": "end", "translation": [0, 1, 0]}]}),
        ),
        ("close", json!({"session": session})),
    ] {
        refused(&call(&server, "bert", tool, arguments).await, "NOT_FOUND", "");
    }
    refused(
        &call(&server, "anna", "open", json!({"path": "/etc/passwd"})).await,
        "INVALID_ARGUMENT",
        "path",
    );
    let deep = format!("{}1{}", "[".repeat(1_000_000), "]".repeat(1_000_000));
    for body in [deep, "{".to_owned(), String::new()] {
        let answer = server
            .post("/mcp")
            .header("accept", "application/json, text/event-stream")
            .header("content-type", "application/json")
            .bearer_auth("anna")
            .body(body);
        assert!((400..500).contains(&answer.status().await));
    }
    let foreign = server
        .post("/mcp")
        .bearer_auth("anna")
        .header("origin", "http://elsewhere.example")
        .body("{}");
    assert_eq!(foreign.status().await, 403);
    assert_eq!(server.get("/mcp").bearer_auth("anna").status().await, 405);
    server.stop().await;
}
