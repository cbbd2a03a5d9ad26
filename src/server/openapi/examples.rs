//! Bodies of calls to begin with. They fit a session with the built-in creature, one after the other in the order of the route table;
//! a test makes all of these calls.

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
