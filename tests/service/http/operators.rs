//! What operators and browsers meet: health, counts, the description, compression, origins.

use super::{get, post};
use crate::support::data::tell_skipped;
use crate::support::server::*;
use reqwest::header::{self, HeaderName};
use serde_json::Value;
use std::process::Command;

#[tokio::test(flavor = "multi_thread")]
async fn operators_find_health_counts_and_description() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    assert_eq!(
        post(&server, &format!("/v1/sessions/{id}/solve"), turn_json(0.1))
            .await
            .status(),
        200
    );
    assert_eq!(get(&server, "/healthz").await.status(), 200);
    assert_eq!(get(&server, "/readyz").await.status(), 200);
    let page = get(&server, "/").await;
    assert!(
        page.headers()[header::CONTENT_TYPE]
            .to_str()
            .unwrap()
            .starts_with("text/html")
    );

    let counts = get(&server, "/metrics").await;
    assert!(
        counts.headers()[header::CONTENT_TYPE]
            .to_str()
            .unwrap()
            .starts_with("application/openmetrics-text")
    );
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
            let answer = request.answer().await;
            let status = answer.status().as_u16();
            let said = answer.text().await.unwrap();
            assert!(
                status != 405 && !said.contains("there is nothing at"),
                "{method} {path}: {status} {said}"
            );
        }
    }
    // A call on a session may be sent to the node that has it, and one that opens a session to a node with more room.
    for (path, methods) in described["paths"].as_object().unwrap() {
        for (method, call) in methods.as_object().unwrap() {
            let may_move = path.starts_with("/v1/sessions/") || (path == "/v1/sessions" && method == "post");
            let told = &call["responses"]["307"]["$ref"];
            assert_eq!(
                told == "#/components/responses/SentOn",
                may_move,
                "{method} {path}: {told}"
            );
        }
    }
    let sent_on = &described["components"]["responses"]["SentOn"];
    for name in ["Location", "x-pliant-owner", "x-pliant-node"] {
        assert!(sent_on["headers"][name]["schema"].is_object(), "{sent_on}");
    }
    let limits: Value = get(&server, "/v1/limits").await.json().await.unwrap();
    assert_eq!(limits["partBytes"], "1048576");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_reference_is_a_page_that_loads_nothing_from_elsewhere() {
    let server = Server::start().await;
    assert_eq!(get(&server, "/docs/").await.status(), 200);
    let answer = get(&server, "/docs").await;
    assert_eq!(answer.status(), 200);
    assert_eq!(answer.headers()[header::CONTENT_TYPE], "text/html; charset=utf-8");
    let policy = answer.headers()["content-security-policy"].to_str().unwrap().to_owned();
    assert!(
        policy.starts_with("default-src 'none'") && policy.contains("script-src 'self'; connect-src 'self';"),
        "{policy}"
    );
    let script = get(&server, "/docs.js").await;
    assert_eq!(script.headers()[header::CONTENT_TYPE], "text/javascript; charset=utf-8");
    let page = answer.text().await.unwrap();
    for part in ["/v1/sessions/{id}/solve", "message-SetHandlesRequest", "Absent = hard"] {
        assert!(page.contains(part), "{part} is not in the page");
    }
}

/// What the samples find when they run: a failed call ends them, and the end of a WebSocket's time is not a failure.
const SAMPLES_BEGIN: &str = r#"set -euxo pipefail
curl() { command curl "$@" || test $? = 28; }
jq() { cut -d '"' -f 4; }"#;

/// The samples in curl of the API description, as they stand there; deletions last, the session's at the end.
#[tokio::test(flavor = "multi_thread")]
async fn every_curl_sample_of_the_reference_works() {
    let is_absent = |program: &&str| Command::new(program).arg("--version").output().is_err();
    if let Some(program) = ["bash", "curl"].into_iter().find(is_absent) {
        return tell_skipped("the samples in curl", &format!("there is no {program}"));
    }
    let server = Server::start().await;
    let document: Value = get(&server, "/openapi.json").await.json().await.unwrap();
    let paths = document["paths"].as_object().unwrap().values();
    let calls = paths.flat_map(|methods| methods.as_object().unwrap());
    let (deletions, others): (Vec<_>, Vec<_>) = calls.partition(|(method, _)| *method == "delete");
    let mut script = SAMPLES_BEGIN.to_owned();
    for (_, call) in others.iter().chain(deletions.iter().rev()) {
        script = script + "\n" + call["x-codeSamples"][0]["source"].as_str().expect("a sample");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let mut bash = Command::new("bash");
    bash.args(["-c", &script.replace("http://127.0.0.1:7411", &server.url(""))])
        .current_dir(folder.path());
    let ran = tokio::task::spawn_blocking(move || bash.output()).await;
    let ran = ran.expect("it ends").expect("bash runs");
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    for file in ["bent.glb", "walk.glb", "creature.glb"] {
        let bytes = std::fs::read(folder.path().join(file)).expect(file);
        assert!(bytes.starts_with(b"glTF"), "{file}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn json_is_compressed_on_request_and_nothing_else() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let gzip = |path: String| server.get(&path).header("accept-encoding", "gzip").send();
    let described = gzip("/openapi.json".into()).await.unwrap();
    assert_eq!(described.headers()[header::CONTENT_ENCODING], "gzip");
    let model = gzip(format!("/v1/sessions/{id}/model")).await.unwrap();
    assert!(!model.headers().contains_key(header::CONTENT_ENCODING));
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_origins_may_read_every_fact_of_an_answer() {
    let server = Server::start().await;
    let id = server.bar_session().await;
    let origin = "http://localhost:5173";
    let solve = server
        .post(&format!("/v1/sessions/{id}/solve"))
        .header("accept", "application/octet-stream")
        .json(&turn_json(0.1));
    let model = server.get(&format!("/v1/sessions/{id}/model?format=glb"));
    let figure = server.post("/v1/sessions?sample=figure");
    let figure = figure.told().await;
    let walk = server
        .post(&format!("/v1/sessions/{}/animations", text(&figure["id"])))
        .header("accept", "model/gltf-binary")
        .json(&serde_json::json!({"clip": "walk", "fps": 2}));
    let mut told = 0;
    for call in [solve, model, walk] {
        let answer = call.header("origin", origin).answer().await;
        assert_eq!(answer.status(), 200);
        let exposed = answer.headers()["access-control-expose-headers"]
            .to_str()
            .unwrap()
            .to_lowercase();
        let exposed: Vec<&str> = exposed.split(',').map(str::trim).collect();
        // It tells browsers something, and pages nothing.
        let is_fact = |name: &&HeaderName| name.as_str().starts_with("x-") && **name != header::X_CONTENT_TYPE_OPTIONS;
        for name in answer.headers().keys().filter(is_fact) {
            assert!(exposed.contains(&name.as_str()), "{name} is hidden from pages");
            told += 1;
        }
    }
    assert!(told > 15, "{told}");
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_foreign_origins_may_not_call() {
    let server = Server::start().await;
    let from = |origin: &'static str| {
        server
            .post("/v1/sessions")
            .header("origin", origin)
            .body(bar_obj(4))
            .send()
    };
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
        .answer()
        .await;
    assert!(preflight.status().is_success());
    assert!(
        preflight.headers()["access-control-allow-methods"]
            .to_str()
            .unwrap()
            .contains("PATCH")
    );
    assert_eq!(
        preflight.headers()["access-control-allow-headers"],
        "content-type,idempotency-key"
    );
}
