//! Who did what is reported: in the store with the change itself, without one in the log.

use super::{config_file, token_table};
use crate::support::commands::Workplace;
use crate::support::postgres::PostgresServer;
use crate::support::process::needed;
use crate::support::program::ServedProgram;
use crate::support::server::*;
use pliant::session::store::{AuditFilter, Store, StoreLocation, read_audit};
use pliant::session::{AuditEntry, AuditedAction, Tenant};
use pliant::wire::pb::deform_request;
use reqwest::Method;
use serde_json::{Value, json};
use std::path::Path;

async fn ask(server: &ServedProgram, token: &str, method: Method, path: &str, body: Option<Value>) -> u16 {
    let mut request = http()
        .request(method, format!("{}{path}", server.url))
        .bearer_auth(token);
    if let Some(body) = body {
        request = request.json(&body);
    }
    let answer = request.answer().await;
    let status = answer.status().as_u16();
    within(path, answer.bytes()).await.expect("a body");
    status
}

async fn opened(server: &ServedProgram, token: &str) -> String {
    let open = server.post("/v1/sessions").body(bar_obj(8));
    let session = open.bearer_auth(token).answer().await;
    text(&session.json::<Value>().await.expect("JSON")["id"])
}

/// Does all that is noted, with one token and another; the session.
async fn one_of_each(server: &ServedProgram) -> String {
    let id = opened(server, "anna's").await;
    let path = |rest: &str| format!("/v1/sessions/{id}{rest}");
    let handles = json!({"handles": ends()});
    let cut = json!({"on": "REST", "cut": {"plane": {"normal": [0, 0, 1], "offset": 1.5}}});
    let wrong = json!({"pose": {"handles": [{"id": "none"}]}});
    for (method, rest, body) in [
        (Method::PUT, "/handles", Some(handles)),
        (Method::POST, "/solve", Some(turn_json(0.3))),
        // What is refused is not noted.
        (Method::POST, "/solve", Some(wrong)),
        (Method::POST, "/undo", None),
        (Method::POST, "/redo", None),
        (Method::GET, "/model", None),
        (Method::GET, "/positions", None),
        (Method::POST, "/carry", Some(json!({"points": [0, 0, 1]}))),
        (Method::POST, "/edits", Some(cut)),
    ] {
        let status = ask(server, "anna's", method, &path(rest), body).await;
        assert!(status == 200 || rest == "/solve", "{rest}: {status}");
    }
    // A commit on a stream is that of who opened the stream.
    let url = format!("{}{}", server.url.replace("http", "ws"), path("/stream"));
    let socket = Socket::connect_with(&url, "authorization", "Bearer bert's").await;
    let mut socket = socket.expect("a stream");
    let pose = deform_request::Message::Pose(turned(1, 0.2, true));
    socket.send(pose).await;
    eventually("a commit", async || {
        let get = http()
            .get(format!("{}{}", server.url, path("/history")))
            .bearer_auth("anna's");
        let history = get.document().await;
        history["commits"]
            .as_array()
            .is_some_and(|c| c.last().is_some_and(|c| c["kind"] == "pose"))
    })
    .await;
    drop(socket);
    assert_eq!(ask(server, "bert's", Method::DELETE, &path(""), None).await, 204);
    id
}

const EXPECTED: [(&str, &str); 13] = [
    ("anna", "create"),
    ("anna", "handles"),
    ("anna", "pose"),
    ("anna", "undo"),
    ("anna", "redo"),
    ("anna", "export"),
    ("anna", "export"),
    ("anna", "carry"),
    ("anna", "edit"),
    ("bert", "stream"),
    ("bert", "pose"),
    ("bert", "delete"),
    ("cleo", "create"),
];

fn tables() -> String {
    [("a", "anna"), ("a", "bert"), ("b", "cleo")]
        .map(|(tenant, name)| token_table(tenant, &format!("{name}'s"), name))
        .concat()
}

/// What `pliant audit` prints of a folder.
fn audit(folder: &Path, arguments: &[&str]) -> Vec<Value> {
    let place = ["--data-dir", folder.to_str().expect("UTF-8")];
    audit_at(&[&place, arguments].concat())
}

/// What `pliant audit` prints.
fn audit_at(arguments: &[&str]) -> Vec<Value> {
    let lines = Workplace::empty().done(&[&["audit"], arguments].concat()).out;
    let documents = lines.lines().map(|line| serde_json::from_str(line).expect("JSON"));
    documents.collect()
}

fn who_what(lines: &[Value]) -> Vec<(String, String)> {
    lines.iter().map(|l| (text(&l["caller"]), text(&l["action"]))).collect()
}

fn expected() -> Vec<(String, String)> {
    EXPECTED.map(|(who, what)| (who.to_owned(), what.to_owned())).to_vec()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_store_reports_who_did_what_while_the_server_runs_and_after() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let place = ["--data-dir", data.to_str().expect("UTF-8")];
    reports_who_did_what(folder.path(), &place, &place).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn postgres_reports_who_did_what_while_the_server_runs_and_after() {
    let server = needed!(PostgresServer::shared());
    let database = server.database().await;
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let place = ["--database", &database.url];
    let objects = ["--data-dir", data.to_str().expect("UTF-8")];
    reports_who_did_what(folder.path(), &[place, objects].concat(), &place).await;
}

/// A server whose store is known by `served`, and what `pliant audit` reports by `audited`.
async fn reports_who_did_what(folder: &Path, served: &[&str], audited: &[&str]) {
    let audit = |arguments: &[&str]| audit_at(&[audited, arguments].concat());
    let config = config_file(folder, &tables());
    let arguments = [served, &["--config", &config]].concat();
    let server = ServedProgram::start_anywhere(folder.join("log"), &arguments, &[]).expect("the server starts");
    let id = one_of_each(&server).await;
    let others = opened(&server, "cleo's").await;
    let running = audit(&[]);
    assert_eq!(who_what(&running), expected());
    server.kill();
    assert_eq!(audit(&[]), running, "all of it was on disk");
    for (k, line) in running.iter().enumerate() {
        let (tenant, session) = if k < 12 { ("a", &id) } else { ("b", &others) };
        assert_eq!(
            (line["tenant"].as_str(), text(&line["session"])),
            (Some(tenant), session.clone())
        );
        assert!(humantime::parse_rfc3339(&text(&line["time"])).is_ok(), "{line}");
    }
    assert_eq!(audit(&["--tenant", "b"]), running[12..]);
    assert_eq!(audit(&["--session", &id]), running[..12]);
    assert_eq!(audit(&["--since", "1h"]).len(), 13);
    assert_eq!(audit(&["--since", "2100-01-01T00:00:00Z"]).len(), 0);
    // The server's own configuration says where it is.
    let keys = served.chunks(2).map(|pair| {
        let key = pair[0].trim_start_matches("--").replace('-', "_");
        format!("{key} = {:?}\n", pair[1])
    });
    let kept = folder.join("kept.toml");
    std::fs::write(&kept, keys.collect::<String>()).expect("written");
    assert_eq!(audit_at(&["--config", kept.to_str().expect("UTF-8")]), running);
    let words = ["sets neither data_dir nor database"];
    Workplace::empty().refused(&["audit", "--config", &config], &words);
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_store_the_log_reports_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let config = config_file(folder.path(), &tables());
    let arguments = ["--config", &config, "--log-format", "json"];
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &arguments);
    let id = one_of_each(&server).await;
    opened(&server, "cleo's").await;
    let lines: Vec<Value> = (server.log().lines())
        .map(|line| serde_json::from_str::<Value>(line).expect("JSON"))
        .filter(|line| line["target"] == "pliant::audit")
        .collect();
    assert_eq!(who_what(&lines), expected());
    assert!(
        lines[..12]
            .iter()
            .all(|l| l["tenant"] == "a" && l["session.id"] == id.as_str())
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_that_end_by_themselves_are_reported_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let server = ServedProgram::start(&data, &[]);
    server.open(bar_obj(4), "?ttl=1s").await;
    eventually("the end", async || {
        who_what(&audit(&data, &[]))
            .last()
            .is_some_and(|(_, what)| what == "expire")
    })
    .await;
    let reply = [("anyone", "create"), ("pliant", "expire")].map(|(who, what)| (who.to_owned(), what.to_owned()));
    assert_eq!(who_what(&audit(&data, &[])), reply);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_old_is_forgotten_of_one_tenant_and_kept_of_another() {
    let folder = tempfile::tempdir().expect("a folder");
    let location = StoreLocation::in_folder(folder.path());
    let store = Store::open(&location).await.expect("a store");
    for tenant in ["a", "b"] {
        let entry = AuditEntry {
            tenant: Tenant(tenant.into()),
            who: "somebody".into(),
            what: AuditedAction::Export,
            session: "s".into(),
        };
        store.audit(entry).await.expect("noted");
    }
    let tenants = async || store.audited_tenants().await.expect("tenants");
    assert_eq!(tenants().await, ["a", "b"].map(|t| Tenant(t.into())));
    store
        .forget_audit(Some(Tenant("a".into())), 0)
        .await
        .expect("nothing is that old");
    assert_eq!(tenants().await.len(), 2);
    store
        .forget_audit(Some(Tenant("a".into())), u64::MAX)
        .await
        .expect("forgotten");
    let mut left = Vec::new();
    read_audit(&location, &AuditFilter::default(), |entry| {
        left.push(entry.tenant);
        true
    })
    .await
    .expect("a trail");
    assert_eq!(left, ["b"]);
}

const SECRET: &str = "pliant_a-secret-that-must-not-be-seen";

fn lines(server: &ServedProgram) -> Vec<Value> {
    (server.log().lines())
        .map(|line| serde_json::from_str::<Value>(line).expect("JSON"))
        .filter(|line| line["target"] == "pliant::access")
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn each_call_has_a_line_and_no_line_has_a_token() {
    let folder = tempfile::tempdir().expect("a folder");
    let tables = token_table("studio", SECRET, "anna") + &token_table("others", "others-token", "bert");
    let config = config_file(folder.path(), &tables);
    let arguments = ["--config", &config, "--log-format", "json", "--log", "debug"];
    let server = ServedProgram::start(&folder.path().join("data"), &arguments);
    let open = server.post(&format!("/v1/sessions?format=obj&token={SECRET}"));
    let refused = within("an answer", open.bearer_auth(SECRET).body(bar_obj(8)).send()).await;
    assert_eq!(refused.expect("an answer").status(), 400);
    let open = server.post("/v1/sessions");
    let answer = within("a session", open.bearer_auth(SECRET).body(bar_obj(8)).send()).await;
    let body = answer.expect("an answer").text().await.expect("a body");
    let id = text(&serde_json::from_str::<Value>(&body).expect("JSON")["id"]);
    let positions = format!("{}/v1/sessions/{id}/positions?access_token={SECRET}", server.url);
    http().get(&positions).answer().await;
    let own = http()
        .get(positions.split('?').next().expect("a path"))
        .bearer_auth(SECRET);
    let bytes = own.answer().await.bytes().await.expect("a body").len();
    let others = server.get(&format!("/v1/sessions/{id}")).bearer_auth("others-token");
    assert_eq!(others.status().await, 404);
    server.get("/healthz").answer().await;
    let url = format!("{}/v1/sessions/{id}/stream", server.url.replace("http", "ws"));
    let protocols = format!("pliant.v1, pliant.bearer.{SECRET}");
    let socket = Socket::connect_with(&url, "sec-websocket-protocol", &protocols).await;
    drop(socket.expect("a stream"));
    let limits = with_token(pliant::wire::pb::GetLimitsRequest::default(), SECRET);
    let channel = tonic::transport::Endpoint::new(server.url.clone()).expect("an address");
    let channel = channel.connect().await.expect("a connection");
    let mut client = pliant::server::grpc::client::DeformerClient::new(channel);
    within("limits", client.get_limits(limits)).await.expect("limits");

    eventually("all lines", async || {
        lines(&server).iter().filter(|l| l["level"] == "INFO").count() >= 7
    })
    .await;
    let reply: Vec<_> = (lines(&server).iter())
        .map(|l| {
            let message = text(&l["message"]).replace(&id, "ID");
            let caller = l["caller"].as_str().unwrap_or("-").to_owned();
            (text(&l["level"]), message, text(&l["status"]), caller)
        })
        .collect();
    let line = |level: &str, message: &str, status: &str, caller: &str| {
        [level, message, status, caller].map(str::to_owned).into()
    };
    let expected: [(String, String, String, String); 8] = [
        line("INFO", "POST /v1/sessions", "400", "anna"),
        line("INFO", "POST /v1/sessions", "201", "anna"),
        line("INFO", "GET /v1/sessions/ID/positions", "401", "-"),
        line("INFO", "GET /v1/sessions/ID/positions", "200", "anna"),
        line("INFO", "GET /v1/sessions/ID", "404", "bert"),
        line("DEBUG", "GET /healthz", "200", "-"),
        line("INFO", "GET /v1/sessions/ID/stream", "101", "anna"),
        line("INFO", "POST /pliant.v1.Deformer/GetLimits", "OK", "anna"),
    ];
    assert_eq!(reply, expected);
    let of_positions = &lines(&server)[3];
    assert_eq!(of_positions["tenant"], "studio");
    assert_eq!(of_positions["size_bytes"], bytes);
    assert!(of_positions["duration_ms"].as_f64().is_some_and(|ms| ms >= 0.0));
    assert!(of_positions["request.id"].is_string());
    let log = server.log();
    for secret in [SECRET, "others-token"] {
        assert!(
            !log.contains(secret),
            "{}",
            log.lines().find(|l| l.contains(secret)).unwrap_or_default()
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn counts_name_no_tenant() {
    let folder = tempfile::tempdir().expect("a folder");
    let tables = token_table("studio", "a", "anna") + &token_table("others", "b", "bert") + "metrics = true\n";
    let config = config_file(folder.path(), &tables);
    let server = ServedProgram::start(&folder.path().join("data"), &["--config", &config]);
    let open = server.post("/v1/sessions").bearer_auth("a");
    let answer = open.body(bar_obj(8)).answer().await;
    let id = text(&answer.json::<Value>().await.expect("JSON")["id"]);
    let counts = server.get("/metrics").bearer_auth("b");
    let counts = counts.answer().await;
    assert_eq!(counts.status(), 200);
    let counts = counts.text().await.expect("a text");
    assert!(counts.contains("pliant_sessions 1"), "{counts}");
    for secret in ["studio", "others", "anna", "bert", &id] {
        assert!(!counts.contains(secret), "{secret}");
    }
}
