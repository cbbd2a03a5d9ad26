//! Spans of calls and of their work, as a collector gets them.

use crate::animations::{bar_rig, bending_clip};
use crate::support::program::ServedProgram;
use crate::support::server::{AnsweredCall as _, Came, bar_obj, ends, eventually, http, turn_json, turned};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{TraceService, TraceServiceServer};
use opentelemetry_proto::tonic::collector::trace::v1::{ExportTraceServiceRequest, ExportTraceServiceResponse};
use opentelemetry_proto::tonic::common::v1::any_value::Value as AnyValue;
use opentelemetry_proto::tonic::trace::v1::Span;
use pliant::session::WorkKind;
use pliant::wire::pb::deform_request::Message;
use serde_json::json;
use std::sync::{Arc, Mutex};
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Request, Response, Status};

/// A collector that keeps what it is sent.
#[derive(Clone, Default)]
struct Collector(Arc<Mutex<Vec<Span>>>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        let resources = request.into_inner().resource_spans.into_iter();
        let scopes = resources.flat_map(|resource| resource.scope_spans);
        self.0
            .lock()
            .expect("no panic")
            .extend(scopes.flat_map(|scope| scope.spans));
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

impl Collector {
    /// Starts it; its address.
    async fn start(&self) -> String {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("its address");
        let service = TraceServiceServer::new(self.clone());
        let served = tonic::transport::Server::builder()
            .add_service(service)
            .serve_with_incoming(TcpListenerStream::new(listener));
        tokio::spawn(served);
        format!("http://{address}")
    }

    fn named(&self, name: &str) -> Option<Span> {
        self.0
            .lock()
            .expect("no panic")
            .iter()
            .find(|span| span.name == name)
            .cloned()
    }
}

impl Collector {
    /// The names of the calls that have work of a name.
    fn calls_of(&self, work: &str) -> Vec<String> {
        let spans = self.0.lock().expect("no panic");
        let parents = spans
            .iter()
            .filter(|span| span.name == work)
            .map(|span| &span.parent_span_id);
        let calls = parents.filter_map(|id| spans.iter().find(|span| span.span_id == *id));
        calls.map(|call| call.name.clone()).collect()
    }
}

/// The call that has work of a kind; `None` where the work is not part of one call, or only a large model has it.
fn call_of(work: WorkKind) -> Option<&'static str> {
    Some(match work {
        WorkKind::Build => "/v1/sessions",
        WorkKind::Handles => "/v1/sessions/{id}/handles",
        WorkKind::Solve | WorkKind::Replay | WorkKind::Recall => "/v1/sessions/{id}/solve",
        WorkKind::Drag => "/v1/sessions/{id}/stream",
        WorkKind::Edit => "/v1/sessions/{id}/edits",
        WorkKind::History => "/v1/sessions/{id}/undo",
        WorkKind::Export => "/v1/sessions/{id}/model",
        WorkKind::Carry => "/v1/sessions/{id}/carry",
        WorkKind::Rig => "/v1/sessions/{id}/rig",
        WorkKind::Transfer => "/v1/sessions/{id}/transfer",
        WorkKind::Crossings => "/v1/sessions/{id}/crossings",
        WorkKind::Look => "/mcp",
        WorkKind::Animate | WorkKind::Frame | WorkKind::Clip => "/v1/sessions/{id}/animations",
        WorkKind::Settle => return None,
    })
}

fn attribute(span: &Span, key: &str) -> Option<AnyValue> {
    let found = span.attributes.iter().find(|attribute| attribute.key == key)?;
    found.value.clone()?.value
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_collector_gets_the_calls_and_their_work_as_part_of_the_callers_trace() {
    let collector = Collector::default();
    let address = collector.start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let server = ServedProgram::start(&folder.path().join("data"), &["--otlp-endpoint", &address]);
    let id = server.open(bar_obj(8), "").await;
    server
        .done(
            "PUT",
            &format!("/v1/sessions/{id}/handles"),
            Some(&json!({"handles": ends()})),
        )
        .await;
    let trace = "4bf92f3577b34da6a3ce929d0e0e4736";
    let answer = server
        .post(&format!("/v1/sessions/{id}/solve"))
        .header("traceparent", format!("00-{trace}-00f067aa0ba902b7-01"))
        .json(&turn_json(0.4))
        .answer()
        .await;
    assert_eq!(answer.status().as_u16(), 200, "{}", server.log());
    answer.bytes().await.expect("a body");
    eventually("the spans of the solve", async || {
        collector.named("solve").is_some() && collector.named("/v1/sessions/{id}/solve").is_some()
    })
    .await;
    let (call, solve) = (collector.named("/v1/sessions/{id}/solve"), collector.named("solve"));
    let (call, solve) = (call.expect("the call"), solve.expect("its work"));
    let hex = |bytes: &[u8]| bytes.iter().map(|b| format!("{b:02x}")).collect::<String>();
    assert_eq!(
        (hex(&call.trace_id).as_str(), hex(&call.parent_span_id).as_str()),
        (trace, "00f067aa0ba902b7")
    );
    assert_eq!(
        (solve.trace_id.clone(), &solve.parent_span_id),
        (call.trace_id.clone(), &call.span_id)
    );
    let text = |span: &Span, key: &str| match attribute(span, key) {
        Some(AnyValue::StringValue(text)) => text,
        other => panic!("{key}: {other:?}"),
    };
    assert_eq!(
        (text(&call, "request.code"), text(&solve, "session.id")),
        ("200".to_owned(), id)
    );
    assert!(
        matches!(attribute(&solve, "cycles"), Some(AnyValue::IntValue(1..))),
        "{:?}",
        solve.attributes
    );
    assert!(matches!(attribute(&solve, "queue_ms"), Some(AnyValue::DoubleValue(ms)) if ms >= 0.0));
    assert!(
        collector
            .named("build")
            .is_some_and(|build| attribute(&build, "vertices").is_some())
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_collector_that_is_not_there_stops_no_call() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = ServedProgram::start(&folder.path().join("data"), &["--otlp-endpoint", "http://127.0.0.1:9"]);
    let id = server.open(bar_obj(8), "").await;
    server.done("GET", &format!("/v1/sessions/{id}"), None).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn work_of_every_kind_has_its_own_name_below_the_call_that_asked_for_it() {
    let collector = Collector::default();
    let address = collector.start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let arguments = ["--otlp-endpoint", &address];
    let mut server = ServedProgram::start(&data, &arguments);
    let id = server.open(bar_obj(8), "").await;
    let path = |rest: &str| format!("/v1/sessions/{id}/{rest}");
    server
        .done("PUT", &path("handles"), Some(&json!({"handles": ends()})))
        .await;
    let (solve, pose) = (path("solve"), turn_json(0.4));
    let (status, _) = server.call_with_key("POST", &solve, Some(&pose), Some("once")).await;
    assert_eq!(status, 200, "{}", server.log());
    // Once in sixteen solves the newest shape is stored. A server that starts again has at hand what was solved after it.
    for step in 0..17 {
        let turned = turn_json(0.02 * f64::from(step));
        server.done("POST", &solve, Some(&turned)).await;
    }
    server.done("GET", &path("model"), None).await;
    server
        .done("POST", &path("carry"), Some(&json!({"points": [0, 0, 0]})))
        .await;
    server.done("POST", &path("crossings"), Some(&json!({}))).await;
    let look = json!({"jsonrpc": "2.0", "id": 1, "method": "tools/call",
        "params": {"name": "look", "arguments": {"session": id}}});
    let seen = server
        .post("/mcp")
        .header("accept", "application/json, text/event-stream");
    assert_eq!(
        seen.json(&look).answer().await.status().as_u16(),
        200,
        "{}",
        server.log()
    );
    // The bar is not a figure; the search is done all the same.
    server.call_with_key("POST", &path("rig"), Some(&json!({})), None).await;
    // Nor has it blend shapes, which is found by the work of a transfer.
    let order = json!({"model": STANDARD.encode(bar_obj(8))});
    server
        .call_with_key("POST", &path("transfer"), Some(&order), None)
        .await;
    let mut stream = server.socket(&path("stream")).await;
    stream.send(Message::Pose(turned(1, 0.2, false))).await;
    assert!(matches!(stream.next().await, Came::Response(_)));
    drop(stream);
    let driven = json!({"bvh": STANDARD.encode(bending_clip(2)), "rig": bar_rig(), "skipFirst": "NO"});
    let played = http()
        .post(format!("{}{}", server.url, path("animations")))
        .header("accept", "model/gltf-binary")
        .json(&driven)
        .answer()
        .await;
    assert_eq!(
        played.status().as_u16(),
        200,
        "{}",
        played.text().await.expect("a reason")
    );
    // A server that starts again replays the session and computes the answer of the commit again.
    server.stop().await;
    server = ServedProgram::start(&data, &arguments);
    let (status, _) = server.call_with_key("POST", &solve, Some(&pose), Some("once")).await;
    assert_eq!(status, 200, "{}", server.log());
    for _ in 0..4 {
        server.done("POST", &path("undo"), None).await;
    }
    let edit = json!({"subdivide": {"scheme": "MIDPOINT"}});
    server.done("POST", &path("edits"), Some(&edit)).await;
    server.stop().await;
    for work in WorkKind::ALL {
        let Some(call) = call_of(*work) else { continue };
        let calls = collector.calls_of(work.name());
        assert!(
            calls.iter().any(|seen| seen == call),
            "\"{}\" is part of {calls:?}, not of {call}",
            work.name()
        );
    }
}
