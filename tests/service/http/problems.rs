//! Every class of failure, with the document that reports it.

use crate::support::server::*;
use reqwest::header;
use serde_json::{Value, json};

/// Method, path | content type | body | status and code | field | words of the detail, with ; between them.
///
/// `{id}` is a session with handles, `{bare}` one without, `{unknown}` an id that is none; `-` is nothing, and `?` as a field
/// means some field.
const CASES: &str = r#"
GET /v2/nothing                | -                | -      | 404 NOT_FOUND           | -         | /v2/nothing; openapi
GET /v1/sessions/{unknown}      | -                | -      | 404 NOT_FOUND           | -         | no session
POST /v1/sessions/{unknown}/solve | image/png      | x      | 404 NOT_FOUND           | -         | no session
POST /v1/sessions/{unknown}/edits | application/json | {    | 404 NOT_FOUND           | -         | no session
GET /v1/sessions/{unknown}/model?format=doc | -    | -      | 404 NOT_FOUND           | -         | no session
PUT /v1/sessions               | -                | -      | 405 UNIMPLEMENTED       | -         | PUT
POST /v1/sessions/{id}/model   | -                | -      | 405 UNIMPLEMENTED       | -         | POST
POST /v1/sessions/{id}/solve   | text/plain       | {}     | 415 INVALID_ARGUMENT    | -         | text/plain; application/json
POST /v1/sessions              | image/png        | x      | 415 INVALID_ARGUMENT    | -         | image/png; model/obj
POST /v1/sessions/{id}/solve   | application/json | {"pose" | 400 INVALID_ARGUMENT   | ?         | -
POST /v1/sessions/{id}/solve   | application/json | {bad   | 400 INVALID_ARGUMENT    | body      | line 1 column 2
POST /v1/sessions/{id}/solve   | application/json | {"pose": {"handles": [{"id": "top"}, {"id": "top"}]}} | 422 INVALID_ARGUMENT | pose.handles[1].id | handles[0]; again
POST /v1/sessions/{id}/solve   | application/json | {"options": {"output": {}, "output": {}}} | 400 INVALID_ARGUMENT | options.output | two fields; once
POST /v1/sessions/{id}/solve   | application/json | {"options": {"tolerance": 1e-300}} | 422 INVALID_ARGUMENT | options.tolerance | is 1e-300
POST /v1/sessions/{id}/edits   | application/json | {"remesh": {"edgeLength": 1e-9}} | 413 RESOURCE_EXHAUSTED | - | more than 1000000000000
POST /v1/sessions/{id}/solve   | application/json | {deep} | 400 INVALID_ARGUMENT    | ?         | -
POST /v1/sessions/{id}/solve   | application/json | {"pse": {}} | 400 INVALID_ARGUMENT | ?       | pse
PUT /v1/sessions/{id}/handles  | application/json | {"handles": [{"id": "a"}, {"id": "b", "region": {"sphere": {"center": "x"}}}]} | 400 INVALID_ARGUMENT | handles[1].region.sphere.center | -
PUT /v1/sessions/{id}/handles  | application/json | {"handles": [{"id": "a", "region": {"sphere": {"center": [0, 0, 0], "radius": -1}}}]} | 422 INVALID_ARGUMENT | handles[0].region.sphere.radius | -1; 0
PUT /v1/sessions/{id}/handles  | application/json | {"sessionId": "another"} | 422 INVALID_ARGUMENT | sessionId | differs
POST /v1/sessions/{id}/solve   | application/json | {"pose": {"handles": [{"id": "nose"}]}} | 422 INVALID_ARGUMENT | pose.handles[0].id | nose
POST /v1/sessions/{id}/solve   | application/json | {"pose": {"handles": [{"id": "top", "pose": {"translation": ["NaN", 0, 0]}}]}} | 422 INVALID_ARGUMENT | pose.handles[0].pose.translation[0] | finite
POST /v1/sessions/{id}/solve   | application/json | {large} | 413 RESOURCE_EXHAUSTED | -         | 65536
POST /v1/sessions/{bare}/solve | application/json | {}     | 409 FAILED_PRECONDITION | -         | handles
POST /v1/sessions/{id}/redo    | -                | -      | 409 FAILED_PRECONDITION | -         | redo
POST /v1/sessions/{id}/edits   | application/json | {"cut": {"keep": "ABOVE"}} | 422 INVALID_ARGUMENT | cut | polyline
POST /v1/sessions/{id}/edits   | application/json | {"cut": {"plane": {"normal": [0, 0, 1], "offset": 1e6}}} | 409 FAILED_PRECONDITION | - | plane
POST /v1/sessions/{id}/edits   | application/json | {}     | 422 INVALID_ARGUMENT    | operation | cut
POST /v1/sessions/{id}/animations | -             | -      | 422 INVALID_ARGUMENT    | clip      | no clips of its own
POST /v1/sessions/{id}/solve   | application/json | {"options": {"method": 7}} | 422 INVALID_ARGUMENT | options.method | 7
POST /v1/sessions?colour=red   | -                | x      | 400 INVALID_ARGUMENT    | colour    | volumeGraph
POST /v1/sessions?format=doc   | -                | x      | 422 INVALID_ARGUMENT    | format    | doc; glb
POST /v1/sessions?label=%00%0a | -                | v 0 0 0 | 422 INVALID_ARGUMENT   | label     | control; U+0000
POST /v1/sessions?label=%ff%fe | -                | v 0 0 0 | 400 INVALID_ARGUMENT   | -         | UTF-8
POST /v1/sessions?ttl=soon     | -                | v 0 0 0 | 422 INVALID_ARGUMENT   | ttl       | soon
POST /v1/sessions?sample=dragon | -               | -      | 422 INVALID_ARGUMENT    | sample    | dragon; creature or figure
GET /v1/sample.glb?name=dragon  | -               | -      | 422 INVALID_ARGUMENT    | name      | dragon; creature or figure
POST /v1/sessions              | -                | -      | 400 INVALID_ARGUMENT    | -         | empty
POST /v1/sessions              | -                | what is this | 400 INVALID_ARGUMENT | -      | glb, gltf, obj
POST /v1/sessions?format=obj   | -                | v 0 0 zero | 400 INVALID_ARGUMENT | -        | line 1; zero
GET /v1/sessions?pageSize=many | -                | -      | 422 INVALID_ARGUMENT    | pageSize  | many
GET /v1/sessions?pageSize=0    | -                | -      | 422 INVALID_ARGUMENT    | pageSize  | 0; 1 to 1000
GET /v1/sessions?pageSize=1001 | -                | -      | 422 INVALID_ARGUMENT    | pageSize  | 1001; 1000
GET /v1/sessions/{id}/model?format=doc | -        | -      | 422 INVALID_ARGUMENT    | format    | doc; glb
GET /v1/sessions/{id}/model?uri=a.bin | -         | -      | 422 INVALID_ARGUMENT    | uri       | a.bin
GET /v1/sessions/{id}/positions?x=1 | -           | -      | 400 INVALID_ARGUMENT    | x         | none here
GET /v1/sessions/{id}/stream   | -                | -      | 426 INVALID_ARGUMENT    | -         | WebSocket
"#;

const UNKNOWN_SESSION: &str = "00000000000000000000000000000000";

#[tokio::test(flavor = "multi_thread")]
async fn problems_say_what_where_and_what_is_allowed() {
    let server = Server::with(|sessions, _| {
        sessions.upload_bytes = 1 << 20;
        sessions.message_bytes = 64 << 10;
    })
    .await;
    let bare = text(&server.open(bar_obj(8)).await["id"]);
    let id = server.bar_session().await;
    let deep = format!("{{\"pose\": {}1{}}}", "[".repeat(2000), "]".repeat(2000));
    let large = " ".repeat(65 << 10);
    let fill = |cell: &str| match cell {
        "-" => String::new(),
        "{deep}" => deep.clone(),
        "{large}" => large.clone(),
        cell => cell
            .replace("{id}", &id)
            .replace("{bare}", &bare)
            .replace("{unknown}", UNKNOWN_SESSION),
    };
    for case @ [call, kind, body, outcome, field, words] in rows(CASES) {
        let (method, path) = call.split_once(' ').expect("method and path");
        let path = fill(path);
        let mut request = http()
            .request(method.parse().unwrap(), server.url(&path))
            .body(fill(body));
        if kind != "-" {
            request = request.header("content-type", kind);
        }
        let answer = request.answer().await;
        let (status, code) = outcome.split_once(' ').expect("status and code");
        let seen = answer.status().as_u16();
        assert_eq!(
            answer.headers()[header::CONTENT_TYPE],
            "application/problem+json",
            "{case:?}"
        );
        assert!(answer.headers().contains_key("x-request-id"), "{case:?}");
        let problem: Value = answer.json().await.unwrap();
        assert_eq!(
            (seen.to_string().as_str(), problem["code"].as_str()),
            (status, Some(code)),
            "{case:?}: {problem}"
        );
        assert_eq!(problem["status"], seen, "{case:?}");
        assert_eq!(problem["instance"], path.split('?').next().unwrap(), "{case:?}");
        assert!(
            text(&problem["type"]).starts_with("urn:pliant:problem:"),
            "{case:?}: {problem}"
        );
        let detail = text(&problem["detail"]);
        for word in words.split("; ").filter(|word| *word != "-") {
            assert!(detail.contains(word), "{case:?}: {detail:?} lacks {word:?}");
        }
        match field {
            "?" => assert!(problem["errors"][0]["field"].is_string(), "{case:?}: {problem}"),
            "-" => assert!(problem.get("errors").is_none(), "{case:?}: {problem}"),
            field => assert_eq!(problem["errors"][0]["field"], field, "{case:?}: {problem}"),
        }
    }
    let whole = server.document(&format!("/v1/sessions/{UNKNOWN_SESSION}")).await;
    let expected = json!({
        "type": "urn:pliant:problem:not-found",
        "title": "not found",
        "status": 404,
        "detail": format!("no session \"{UNKNOWN_SESSION}\"; it may have expired or been deleted"),
        "code": "NOT_FOUND",
        "instance": format!("/v1/sessions/{UNKNOWN_SESSION}"),
    });
    assert_eq!(whole, expected);
    // Nothing that was refused left a trace.
    let history = server.document(&format!("/v1/sessions/{id}/history")).await;
    assert_eq!(history["commits"].as_array().map(Vec::len), Some(2));
    assert_eq!(server.metric("pliant_sessions").await, 2.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_method_names_the_right_ones() {
    let server = Server::start().await;
    let answer = server.put("/v1/sessions").answer().await;
    let allow = header(&answer, header::ALLOW);
    assert!(allow.contains("GET") && allow.contains("POST"), "{allow}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_accepted_is_refused_before_work_is_done() {
    let (server, id) = Server::start_with_bar().await;
    let url = server.url(&format!("/v1/sessions/{id}/solve"));
    let call = |accept| http().post(&url).header("accept", accept);
    assert_eq!(call("image/png").json(&turn_json(0.1)).status().await, 406);
    let mut packed = turn_json(0.1);
    packed["options"] = json!({"output": {"encoding": "U16"}});
    assert_eq!(call("application/octet-stream").json(&packed).status().await, 422);
    let history = server.document(&format!("/v1/sessions/{id}/history")).await;
    assert_eq!(history["commits"].as_array().map(Vec::len), Some(2));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_in_an_encoding_that_is_not_read_is_415() {
    let (server, id) = Server::start_with_bar().await;
    for path in ["/v1/sessions".to_owned(), format!("/v1/sessions/{id}/solve")] {
        for (encoding, status) in [("gzip", 415), ("identity, br", 415), ("identity", 0), ("", 0)] {
            let call = server.post(&path).header("content-encoding", encoding).body(bar_obj(4));
            let answer = call.answer().await;
            let is_refused = answer.status() == 415 && answer.headers().contains_key("accept-encoding");
            assert_eq!(is_refused, status == 415, "{path} {encoding}: {}", answer.status());
        }
    }
}
