//! One line for each call, with what an operator needs and nothing secret.

use super::{config_file, token_table};
use crate::support::program::ServedProgram;
use crate::support::server::*;
use serde_json::Value;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;

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
    assert_eq!(others.answer().await.status(), 404);
    server.get("/healthz").answer().await;
    let url = format!("{}/v1/sessions/{id}/stream", server.url.replace("http", "ws"));
    let mut request = url.into_client_request().expect("a request");
    let protocols = format!("pliant.v1, pliant.bearer.{SECRET}").parse().expect("ASCII");
    request.headers_mut().insert("sec-websocket-protocol", protocols);
    drop(
        within("a socket", tokio_tungstenite::connect_async(request))
            .await
            .expect("a stream"),
    );
    let mut limits = tonic::Request::new(pliant::wire::pb::GetLimitsRequest::default());
    let bearer = format!("Bearer {SECRET}").parse().expect("ASCII");
    limits.metadata_mut().insert("authorization", bearer);
    let channel = tonic::transport::Endpoint::new(server.url.clone()).expect("an address");
    let channel = channel.connect().await.expect("a connection");
    let mut client = pliant::server::grpc::client::DeformerClient::new(channel);
    within("limits", client.get_limits(limits)).await.expect("limits");

    eventually("all lines", async || {
        lines(&server).iter().filter(|l| l["level"] == "INFO").count() >= 7
    })
    .await;
    let told: Vec<_> = (lines(&server).iter())
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
    assert_eq!(told, expected);
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
async fn counts_tell_of_no_tenant() {
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
