//! What `/openapi.json` says of messages and answers: JSON Schemas as canonical proto-JSON writes them, statuses by operation, and
//! examples in curl and Python. Examples fit a session with the built-in creature, one after the other in the order of the route
//! table, deletions last; tests run all of them.

use crate::http::Route;
use prost_reflect::prost_types::FileDescriptorProto;
use prost_reflect::{DescriptorPool, EnumDescriptor, FieldDescriptor, FileDescriptor, Kind, MessageDescriptor};
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};

const PACKAGE: &str = "pliant.v1";

/// The messages and enumerations of the schema, with their comments.
pub(super) struct Schemas<'a> {
    pool: &'a DescriptorPool,
    comments: BTreeMap<Vec<i32>, String>,
}

impl<'a> Schemas<'a> {
    /// Reads the comments of the schema's file.
    pub fn new(pool: &'a DescriptorPool) -> Self {
        let file = pool
            .files()
            .find(|file: &FileDescriptor| file.package_name() == PACKAGE);
        let comments = file
            .map(|file| comments(file.file_descriptor_proto()))
            .unwrap_or_default();
        Self { pool, comments }
    }

    /// The comment of a method of the service.
    pub fn rpc_comment(&self, rpc: &str) -> Option<&str> {
        let service = self.pool.services().find(|s| s.package_name() == PACKAGE)?;
        let method = service.methods().find(|m| m.name() == rpc)?;
        self.comment(method.path())
    }

    /// Every message and enumeration by its name below the package.
    pub fn all(&self) -> Map<String, Value> {
        let mut all = BTreeMap::new();
        for message in self
            .pool
            .all_messages()
            .filter(|m| m.package_name() == PACKAGE && !m.is_map_entry())
        {
            all.insert(name(message.full_name()), self.message(&message));
        }
        for kind in self.pool.all_enums().filter(|e| e.package_name() == PACKAGE) {
            all.insert(name(kind.full_name()), self.enumeration(&kind));
        }
        all.into_iter().collect()
    }

    fn comment(&self, path: &[i32]) -> Option<&str> {
        self.comments.get(path).map(String::as_str)
    }

    fn describe(&self, mut schema: Value, path: &[i32]) -> Value {
        if let Some(text) = self.comment(path) {
            schema["description"] = text.into();
        }
        schema
    }

    fn message(&self, message: &MessageDescriptor) -> Value {
        let properties: Map<String, Value> = message
            .fields()
            .map(|field| (field.json_name().to_owned(), self.field(&field)))
            .collect();
        let mut schema = json!({"type": "object", "properties": properties, "additionalProperties": false});
        let choices: Vec<String> = message
            .oneofs()
            .filter(|one| !one.is_synthetic())
            .map(|one| {
                one.fields()
                    .map(|f| f.json_name().to_owned())
                    .collect::<Vec<_>>()
                    .join(", ")
            })
            .collect();
        if !choices.is_empty() {
            schema["$comment"] = format!("at most one of {}", choices.join("; at most one of ")).into();
        }
        self.describe(schema, message.path())
    }

    fn enumeration(&self, kind: &EnumDescriptor) -> Value {
        let values: Vec<String> = kind.values().map(|v| v.name().to_owned()).collect();
        let said: Vec<String> = kind
            .values()
            .filter_map(|v| Some(format!("{}: {}", v.name(), self.comment(v.path())?)))
            .collect();
        let each: Map<String, Value> = kind
            .values()
            .filter_map(|v| Some((v.name().to_owned(), self.comment(v.path())?.into())))
            .collect();
        let schema = json!({"type": "string", "enum": values, "$comment": said.join(" "), "x-enumDescriptions": each});
        self.describe(schema, kind.path())
    }

    fn field(&self, field: &FieldDescriptor) -> Value {
        let schema = if field.is_map() {
            let value = match field.kind() {
                Kind::Message(entry) => one(&entry.map_entry_value_field().kind()),
                _ => json!({}),
            };
            json!({"type": "object", "additionalProperties": value})
        } else if field.is_list() {
            json!({"type": "array", "items": one(&field.kind())})
        } else {
            one(&field.kind())
        };
        self.describe(schema, field.path())
    }
}

fn name(full: &str) -> String {
    full.strip_prefix(PACKAGE)
        .and_then(|n| n.strip_prefix('.'))
        .unwrap_or(full)
        .to_owned()
}

fn one(kind: &Kind) -> Value {
    match kind {
        Kind::Double | Kind::Float => json!({"type": "number"}),
        Kind::Int32 | Kind::Sint32 | Kind::Sfixed32 => json!({"type": "integer", "format": "int32"}),
        Kind::Uint32 | Kind::Fixed32 => json!({"type": "integer", "minimum": 0, "maximum": u32::MAX}),
        // Written as strings, since readers of JSON lose digits of large numbers; read in both forms.
        Kind::Int64 | Kind::Sint64 | Kind::Sfixed64 => json!({"type": ["string", "integer"], "format": "int64"}),
        Kind::Uint64 | Kind::Fixed64 => json!({"type": ["string", "integer"], "format": "uint64"}),
        Kind::Bool => json!({"type": "boolean"}),
        Kind::String => json!({"type": "string"}),
        Kind::Bytes => json!({"type": "string", "contentEncoding": "base64"}),
        Kind::Message(message) => json!({"$ref": format!("#/components/schemas/{}", name(message.full_name()))}),
        Kind::Enum(kind) => json!({"$ref": format!("#/components/schemas/{}", name(kind.full_name()))}),
    }
}

/// Leading comments by the path of what they stand before.
fn comments(file: &FileDescriptorProto) -> BTreeMap<Vec<i32>, String> {
    let locations = file.source_code_info.iter().flat_map(|info| &info.location);
    locations
        .filter_map(|location| {
            let words: Vec<&str> = location.leading_comments().split_whitespace().collect();
            (!words.is_empty()).then(|| (location.path.clone(), words.join(" ")))
        })
        .collect()
}

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
        ("post", "/v1/sessions/{id}/crossings") => json!({"limit": 1000}),
        ("post", "/v1/sessions/{id}/rig") => json!({"preset": "mixamo"}),
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
        // The source and the same in another shape; here both are the session's.
        Some("Transfer") => format!(
            "curl {QUIET} \"{SERVER}/v1/sessions/$id/model\" -o bent.glb\n\
             printf '{{\"session\": \"%s\", \"shape\": \"%s\"}}' \"$id\" \"$(base64 -w0 bent.glb)\" |\n  {line} \\\n  \
             -H 'content-type: application/json' --data-binary @- -o carried.glb"
        ),
        _ => line,
    }
}

/// What every operation may answer: a malformed head, missing or insufficient credentials, a page of another origin, a
/// too large head, an exhausted quota, a defect, a server that stops or has no room, a deadline.
const EVERYWHERE: [u16; 9] = [400, 401, 403, 404, 429, 431, 500, 503, 504];

/// Successes beside the usual one: what was made before, a part of an answer, and one that the caller has already.
pub(super) fn other_successes(route: &Route) -> Vec<u16> {
    match route.rpc {
        // An idempotent repeat.
        Some("CreateSession") => vec![200],
        _ if is_download(route) => vec![206, 304],
        _ => Vec::new(),
    }
}

/// Statuses with which an operation refuses or fails.
pub(super) fn refusals(route: &Route) -> BTreeSet<u16> {
    let mut all = BTreeSet::from(EVERYWHERE);
    if !is_about_the_server(route) {
        // A state that prevents it, more than the limits allow, what means nothing, a caller that has left, what is not done here.
        all.extend([409, 413, 422, 499, 501]);
    }
    if ["post", "put", "patch"].contains(&route.method) {
        // Bodies that come too slowly, or of a kind that is not read.
        all.extend([408, 415]);
    }
    if is_download(route) {
        all.insert(416);
    }
    if ["/v1/sessions/{id}/solve", "/v1/sessions/{id}/animations"].contains(&route.path) {
        all.insert(406);
    }
    if route.path.ends_with("/stream") {
        all.insert(426);
    }
    all
}

/// Whether it is about a session that another one of several nodes may have, or have more room for: the caller is sent there.
pub(super) fn is_sent_on(route: &Route) -> bool {
    route.rpc == Some("CreateSession") || route.path.starts_with("/v1/sessions/{id}")
}

/// Whether it answers with bytes that can be asked for in parts.
fn is_download(route: &Route) -> bool {
    [
        "/v1/sessions/{id}/model",
        "/v1/sessions/{id}/positions",
        "/v1/sample.glb",
    ]
    .contains(&route.path)
}

/// Whether it is about the server alone, and takes nothing that could be wrong.
fn is_about_the_server(route: &Route) -> bool {
    ["/healthz", "/readyz", "/metrics", "/openapi.json", "/v1/limits"].contains(&route.path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_in_the_schema_is_explained() {
        let pool = pliant_wire::json::descriptors().unwrap();
        let schemas = Schemas::new(pool);
        let mut bare = Vec::new();
        let mut look = |path: &[i32], what: String| {
            if schemas.comment(path).is_none() {
                bare.push(what);
            }
        };
        for service in pool.services().filter(|s| s.package_name() == PACKAGE) {
            look(service.path(), service.full_name().to_owned());
            for method in service.methods() {
                look(method.path(), method.full_name().to_owned());
            }
        }
        for message in pool
            .all_messages()
            .filter(|m| m.package_name() == PACKAGE && !m.is_map_entry())
        {
            look(message.path(), message.full_name().to_owned());
            for field in message.fields() {
                look(field.path(), field.full_name().to_owned());
            }
        }
        for kind in pool.all_enums().filter(|e| e.package_name() == PACKAGE) {
            look(kind.path(), kind.full_name().to_owned());
            for value in kind.values() {
                look(value.path(), value.full_name().to_owned());
            }
        }
        assert!(bare.is_empty(), "without a comment in the schema: {bare:?}");
    }
}
