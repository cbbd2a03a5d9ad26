//! Examples of calls: bodies, parameters, and samples in curl and Python. They fit a session with the built-in creature, one after
//! the other in the order of the route table, deletions last; tests run all samples.

use crate::server::http::Route;
use serde_json::{Value, json};

/// The example of a call's JSON body, if it takes one.
pub(super) fn body_example(route: &Route) -> Option<Value> {
    let feet = json!({"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}});
    let head = json!({"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}});
    let example = match (route.method, route.path) {
        ("put", "/v1/sessions/{id}/handles") => json!({
            "handles": [{"id": "feet", "region": feet}, {"id": "head", "region": head}],
        }),
        ("patch", _) => json!({"region": head, "stiffness": 0.5}),
        ("post", "/v1/sessions/{id}/solve") => json!({
            "pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, 0.8, 0], "translation": [0, 0.1, 0]}}]},
            "options": {"refine": 4},
        }),
        ("post", "/v1/sessions/{id}/edits") => json!({"subdivide": {"region": head, "scheme": "MIDPOINT"}}),
        ("post", "/v1/sessions/{id}/carry") => json!({"points": [0.76, 1.22, 0]}),
        ("post", "/v1/sessions/{id}/animations") => json!({"fps": 30, "count": 10}),
        _ => return None,
    };
    Some(example)
}

/// The example of a parameter in the path or the query, if it has one.
pub(super) fn parameter_example(route: &Route, name: &str) -> Option<&'static str> {
    match (route.path, name) {
        (_, "handleId") => Some("head"),
        ("/v1/sessions", "sample") | ("/v1/sample.glb", "name") => Some("creature"),
        ("/v1/sessions", "ttl") => Some("1h"),
        ("/v1/sessions", "pageSize") => Some("10"),
        _ => None,
    }
}

/// The server that samples call.
const SERVER: &str = "http://127.0.0.1:7411";

/// No progress bar; a refusal is printed and ends curl with an error.
const QUIET: &str = "-sS --fail-with-body";

/// What samples do with an answer that opens a session.
const READ_ID: &str = "jq -r .id";

/// A program in Python; each part stands below the id of its operation.
const PYTHON: &str = include_str!("samples.py");

/// The samples of an operation for `x-codeSamples`: always curl, and Python where its package has the call.
pub(super) fn code_samples(route: &Route, operation_id: &str) -> Vec<Value> {
    let curl = json!({"lang": "curl", "source": curl_sample(route)});
    let python = python_parts().find(|(id, _)| *id == operation_id);
    let python = python.map(|(_, source)| json!({"lang": "Python", "source": source}));
    [curl].into_iter().chain(python).collect()
}

/// The parts of the program in Python, each with the id of its operation.
pub(super) fn python_parts() -> impl Iterator<Item = (&'static str, &'static str)> {
    let parts = PYTHON.split("\n# ").skip(1);
    parts.filter_map(|part| part.split_once('\n').map(|(id, source)| (id, source.trim_end())))
}

fn curl_sample(route: &Route) -> String {
    let path = route.path.replace("{id}", "$id").replace("{handleId}", "head");
    let query: Vec<String> = route
        .query
        .iter()
        .filter_map(|(name, _)| Some(format!("{name}={}", parameter_example(route, name)?)))
        .collect();
    let method = match route.method {
        "get" => String::new(),
        method => format!("-X {} ", method.to_uppercase()),
    };
    let mark = if query.is_empty() { "" } else { "?" };
    let mut line = format!("curl {QUIET} {method}\"{SERVER}{path}{mark}{}\"", query.join("&"));
    if let Some(body) = body_example(route) {
        line += &format!(" \\\n  -H 'content-type: application/json' \\\n  -d '{body}'");
    }
    line += match route.path {
        "/v1/sample.glb" => " -o creature.glb",
        "/v1/sessions/{id}/solve" => " \\\n  -H 'accept: model/gltf-binary' -o bent.glb",
        "/v1/sessions/{id}/animations" => " \\\n  -H 'accept: model/gltf-binary' -o walk.glb",
        "/v1/sessions/{id}/model" => " -o bent.glb",
        "/v1/sessions/{id}/positions" => " -o positions.f32",
        // The answer is 101; binary messages would follow.
        "/v1/sessions/{id}/stream" => {
            " --http1.1 --include --max-time 1 \\\n  -H 'connection: upgrade' -H 'upgrade: websocket' \\\n  \
             -H 'sec-websocket-version: 13' -H 'sec-websocket-key: cGxpYW50LXdlYnNvY2tldA=='"
        }
        _ => "",
    };
    match route.rpc {
        Some("CreateSession") => {
            format!("# Your own model: --data-binary @model.glb in place of sample=creature\nid=$({line} | {READ_ID})")
        }
        Some("Animate") => {
            let opened = format!("figure=$(curl {QUIET} -X POST \"{SERVER}/v1/sessions?sample=figure\" | {READ_ID})");
            format!("{opened}\n{}", line.replace("$id", "$figure"))
        }
        _ => line,
    }
}
