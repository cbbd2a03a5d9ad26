//! What operators and browsers meet: health, counts, the description, compression, origins.

use super::{get, post};
use crate::support::certificates::{Authority, Files};
use crate::support::commands::words;
use crate::support::commands::{Ran, Workplace, pliant_in};
use crate::support::data::report_skipped;
use crate::support::program::ServedProgram;
use crate::support::server::*;
use reqwest::header::{self, HeaderName};
use serde_json::Value;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};

#[tokio::test(flavor = "multi_thread")]
async fn operators_find_health_counts_and_description() {
    let (server, id) = Server::start_with_bar().await;
    assert_eq!(
        post(&server, &format!("/v1/sessions/{id}/solve"), turn_json(0.1))
            .await
            .status(),
        200
    );
    assert_eq!(get(&server, "/healthz").await.status(), 200);
    assert_eq!(get(&server, "/readyz").await.status(), 200);
    let page = get(&server, "/").await;
    assert!(header(&page, header::CONTENT_TYPE).starts_with("text/html"));

    let counts = get(&server, "/metrics").await;
    assert!(header(&counts, header::CONTENT_TYPE).starts_with("application/openmetrics-text"));
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

    let described = server.document("/openapi.json").await;
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
            let reply = &call["responses"]["307"]["$ref"];
            assert_eq!(
                reply == "#/components/responses/SentOn",
                may_move,
                "{method} {path}: {reply}"
            );
        }
    }
    let sent_on = &described["components"]["responses"]["SentOn"];
    for name in ["Location", "x-pliant-owner", "x-pliant-node"] {
        assert!(sent_on["headers"][name]["schema"].is_object(), "{sent_on}");
    }
    let limits = server.document("/v1/limits").await;
    assert_eq!(limits["partBytes"], "1048576");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_reference_is_a_page_that_loads_nothing_from_elsewhere() {
    let server = Server::start().await;
    assert_eq!(get(&server, "/docs/").await.status(), 200);
    let answer = get(&server, "/docs").await;
    assert_eq!(answer.status(), 200);
    assert_eq!(answer.headers()[header::CONTENT_TYPE], "text/html; charset=utf-8");
    let policy = header(&answer, "content-security-policy").to_owned();
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
        return report_skipped("the samples in curl", &format!("there is no {program}"));
    }
    let server = Server::start().await;
    let document = server.document("/openapi.json").await;
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
    let (server, id) = Server::start_with_bar().await;
    let gzip = |path: String| server.get(&path).header("accept-encoding", "gzip").send();
    let described = gzip("/openapi.json".into()).await.unwrap();
    assert_eq!(described.headers()[header::CONTENT_ENCODING], "gzip");
    let model = gzip(format!("/v1/sessions/{id}/model")).await.unwrap();
    assert!(!model.headers().contains_key(header::CONTENT_ENCODING));
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_origins_may_read_every_fact_of_an_answer() {
    let (server, id) = Server::start_with_bar().await;
    let origin = "http://localhost:5173";
    let solve = server
        .post(&format!("/v1/sessions/{id}/solve"))
        .header("accept", "application/octet-stream")
        .json(&turn_json(0.1));
    let model = server.get(&format!("/v1/sessions/{id}/model?format=glb"));
    let figure = server.post("/v1/sessions?sample=figure");
    let figure = figure.document().await;
    let walk = server
        .post(&format!("/v1/sessions/{}/animations", text(&figure["id"])))
        .header("accept", "model/gltf-binary")
        .json(&serde_json::json!({"clip": "walk", "fps": 2}));
    let mut reply = 0;
    for call in [solve, model, walk] {
        let answer = call.header("origin", origin).answer().await;
        assert_eq!(answer.status(), 200);
        let exposed = header(&answer, "access-control-expose-headers").to_lowercase();
        let exposed: Vec<&str> = exposed.split(',').map(str::trim).collect();
        // It instructs browsers, and is not a fact for pages.
        let is_fact = |name: &&HeaderName| name.as_str().starts_with("x-") && **name != header::X_CONTENT_TYPE_OPTIONS;
        for name in answer.headers().keys().filter(is_fact) {
            assert!(exposed.contains(&name.as_str()), "{name} is hidden from pages");
            reply += 1;
        }
    }
    assert!(reply > 15, "{reply}");
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
    assert!(header(&preflight, "access-control-allow-methods").contains("PATCH"));
    assert_eq!(
        preflight.headers()["access-control-allow-headers"],
        "content-type,idempotency-key"
    );
}

/// Exit code and the last line that was written.
fn health(arguments: &[&str], variables: &[(&str, &str)]) -> (Option<i32>, String) {
    let arguments = [&["health"], arguments].concat();
    let ran = Ran::of(pliant_in(Path::new("."), &arguments).envs(variables.iter().copied()));
    let said = ran.out + &ran.err;
    (ran.code, said.lines().last().unwrap_or_default().to_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn health_reports_whether_a_server_takes_sessions() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &["--drain-deadline", "60s"]);
    let url = server.url.clone();
    assert_eq!(health(&[&url], &[]), (Some(0), "ready".into()));
    assert_eq!(health(&[&url, "--live"], &[]), (Some(0), "ok".into()));
    // In a container the server listens on every address, as its environment or its file says.
    let port = url.rsplit(':').next().expect("a port").to_owned();
    let everywhere = [
        ("PLIANT_LISTEN", format!("0.0.0.0:{port}")),
        ("PLIANT_INSECURE_OPEN", "true".into()),
    ];
    let everywhere = everywhere.each_ref().map(|(key, value)| (*key, value.as_str()));
    assert_eq!(health(&[], &everywhere), (Some(0), "ready".into()));
    let config = folder.path().join("pliant.toml");
    std::fs::write(&config, format!("listen = \"127.0.0.1:{port}\"\n")).expect("written");
    assert_eq!(
        health(&["--config", config.to_str().expect("UTF-8")], &[]),
        (Some(0), "ready".into())
    );

    // A session that streams holds the stop up: the process lives, and takes nothing new.
    let id = server.open(bar_obj(8), "").await;
    let socket = format!("{}/v1/sessions/{id}/stream", url.replace("http", "ws"));
    let _stream = within("a socket", tokio_tungstenite::connect_async(socket))
        .await
        .expect("a socket");
    server.ask_to_stop();
    eventually("it leaves", async || {
        let (code, said) = health(&[&url], &[]);
        code == Some(1) && said.starts_with(&format!("pliant: {url} answers 503"))
    })
    .await;
    assert_eq!(health(&[&url, "--live"], &[]).0, Some(0));
    server.kill();
    let (code, said) = health(&[&url], &[]);
    assert!(code == Some(1) && said.contains("does not answer"), "{said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_with_tls_is_known_by_its_own_certificate() {
    let folder = tempfile::tempdir().expect("a folder");
    let authority = Authority::new("an authority that this machine does not know");
    let files = Files::new(&authority.server(1));
    let given = |files: &Files, name: &str| files.path(name).to_str().expect("UTF-8").to_owned();
    let (certificate, key) = (given(&files, "server.pem"), given(&files, "server.key"));
    let arguments = ["--tls-certificate", &certificate, "--tls-key", &key];
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &arguments);
    let address = server.url.strip_prefix("https://").expect("TLS").to_owned();
    let own = |certificate: &str, key: &str| {
        let variables = [
            ("PLIANT_LISTEN", address.as_str()),
            ("PLIANT_TLS_CERTIFICATE", certificate),
            ("PLIANT_TLS_KEY", key),
        ];
        health(&[], &variables)
    };
    assert_eq!(own(&certificate, &key), (Some(0), "ready".into()));
    let another = Files::new(&authority.server(2));
    let (code, said) = own(&given(&another, "server.pem"), &given(&another, "server.key"));
    assert!(code == Some(1) && said.contains("does not answer"), "{said}");
    let (code, said) = health(&[&server.url], &[]);
    assert!(
        code == Some(1) && said.contains("certificate"),
        "named by a URL it has to be trusted: {said}"
    );
}

#[test]
fn what_is_no_server_s_address_is_refused() {
    for (arguments, words) in [
        (["127.0.0.1:7411"].as_slice(), "is not the URL of a server"),
        (&["ftp://host"], "is not the URL of a server"),
        (&["--config", "/nowhere.toml"], "/nowhere.toml"),
        (&["http://127.0.0.1:1", "--ca", "/nowhere.pem"], "/nowhere.pem"),
    ] {
        let (code, said) = health(arguments, &[]);
        assert!(code == Some(2) && said.contains(words), "{arguments:?}: {said}");
    }
}

/// Everything that a server wrote, by stream, and its exit code.
struct WrittenLog {
    out: String,
    err: String,
    code: Option<i32>,
}

/// Starts a server with a sample and a remark on its configuration, makes calls that succeed and that fail, and stops it.
async fn life(format: &str) -> WrittenLog {
    let mut child = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .args(words(&format!(
            "serve --sample --listen 0.0.0.0:0 --insecure-open --threads 2 --log-format {format}"
        )))
        .env_remove("PLIANT_CONFIG")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let err = BufReader::new(child.stderr.take().expect("piped"));
    let heard = Arc::new(Mutex::new(String::new()));
    let hearing = Arc::clone(&heard);
    let reader = std::thread::spawn(move || {
        for line in err.lines() {
            let mut text = hearing.lock().expect("whole");
            *text += &line.expect("text");
            text.push('\n');
        }
    });
    let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
    let mut out = String::new();
    stdout.read_line(&mut out).expect("a line");
    let start = out.find("http://").unwrap_or_else(|| panic!("{out}"));
    let url: String = (out[start..].chars())
        .take_while(|c| !c.is_whitespace() && *c != '"')
        .collect();
    let url = url.replace("0.0.0.0", "127.0.0.1");
    let get = async |path: &str| {
        let sent = http().get(format!("{url}{path}")).send();
        within(path, sent)
            .await
            .expect("an answer")
            .text()
            .await
            .expect("a body")
    };
    // The last of what is reported at the start: what to try with the sample.
    eventually("the sample", async || {
        heard.lock().expect("whole").contains("creature.obj")
    })
    .await;
    get("/v1/sessions/nobody").await;
    get("/no%0Asuch%1B%5B31mplace%22").await;
    let asked = Command::new("kill").args(["-TERM", &child.id().to_string()]).status();
    assert!(asked.expect("kill runs").success());
    let rest = tokio::task::spawn_blocking(move || {
        stdout.read_to_string(&mut out).expect("text");
        (out, child.wait().expect("an end").code())
    });
    let (out, code) = within("the end", rest).await.expect("it ends");
    reader.join().expect("all is read");
    let err = heard.lock().expect("whole").clone();
    WrittenLog { out, err, code }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_line_is_json_where_the_log_is() {
    let WrittenLog { out, err, code } = life("json").await;
    assert_eq!(code, Some(0), "{err}");
    assert_eq!(out.lines().count(), 1, "{out}");
    let mut messages = Vec::new();
    for line in out.lines().chain(err.lines()) {
        let parsed: Value = serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"));
        for field in ["timestamp", "level", "message", "target"] {
            assert!(parsed[field].is_string(), "{field} of {line}");
        }
        let time = text(&parsed["timestamp"]);
        assert!(time.len() == 27 && time.ends_with('Z'), "{line}");
        messages.push(text(&parsed["message"]));
    }
    let said = |words: &str| messages.iter().filter(|m| m.starts_with(words)).count();
    assert_eq!(said("listening on http://0.0.0.0:"), 1, "{messages:?}");
    assert_eq!(said("what clients send is not encrypted"), 1);
    assert_eq!(said("GET /v1/sessions/nobody"), 1, "each call has its line");
    assert_eq!(said("to try: curl"), 4, "what to try is logged as lines too");
    assert_eq!(said("stopped"), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn every_line_of_the_text_log_has_its_time_level_and_place() {
    let WrittenLog { out, err, code } = life("text").await;
    assert_eq!(code, Some(0), "{err}");
    let url = out.trim_end().strip_prefix("listening on http://0.0.0.0:");
    assert!(
        out.lines().count() == 1 && url.is_some_and(|port| port.parse::<u16>().is_ok()),
        "{out}"
    );
    for line in err.lines() {
        let mut words = line.split_whitespace();
        let time = words.next().unwrap_or_default();
        let level = words.next().unwrap_or_default();
        let target = words.next().unwrap_or_default();
        let is_line = time.len() == 27
            && time.ends_with('Z')
            && ["ERROR", "WARN", "INFO", "DEBUG", "TRACE"].contains(&level)
            && target.starts_with("pliant")
            && target.ends_with(':');
        assert!(is_line, "{line:?} in\n{err}");
        assert!(!line.contains('\u{1b}'), "{line:?}");
    }
    assert!(err.contains("GET /v1/sessions/nobody"), "{err}");
}

#[test]
fn why_it_does_not_start_is_reported_in_the_log_s_form() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    let run = |format: &str| {
        let arguments = ["serve", "--listen", &address, "--log-format", format];
        let ran = Workplace::empty().run(&arguments).exits(2);
        assert_eq!(ran.out, "");
        ran
    };
    let json = run("json");
    for line in json.err.lines() {
        serde_json::from_str::<Value>(line).unwrap_or_else(|e| panic!("{e}: {line}"));
    }
    let reply: Value = serde_json::from_str(json.last()).expect("JSON");
    assert!(
        reply["level"] == "ERROR" && text(&reply["message"]).contains("cannot listen on"),
        "{reply}"
    );
    assert!(run("text").last().starts_with("pliant: cannot listen on"));
}
