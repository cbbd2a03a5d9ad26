//! `/openapi.json`: OpenAPI 3.1, made from the schema's descriptors and comments and from the route table.

mod schemas;

use super::http::{ANIMATION_TYPES, ROUTES, Route};
use pliant_asset::Format;

use pliant_session::Error;
use schemas::Schemas;
use schemas::{body_example, code_samples, parameter_example};
use serde_json::{Map, Value, json};
use std::sync::LazyLock;

static DOCUMENT: LazyLock<Result<String, Error>> = LazyLock::new(|| build().map(|document| document.to_string()));

/// The description, made once.
///
/// # Errors
/// `INTERNAL`, when the descriptors built into this program cannot be read.
pub(super) fn document() -> Result<String, Error> {
    DOCUMENT.clone()
}

fn build() -> Result<Value, Error> {
    let schemas = Schemas::new(pliant_wire::json::descriptors()?);
    let mut paths = Map::new();
    for route in &ROUTES {
        let place = paths.entry(route.path).or_insert_with(|| Value::Object(Map::new()));
        place[route.method] = operation(route, &schemas);
    }
    Ok(json!({
        "openapi": "3.1.0",
        "info": {
            "title": "pliant",
            "version": env!("CARGO_PKG_VERSION"),
            "description": "Headless mesh deformation. JSON bodies are the canonical proto-JSON form of pliant.v1: 64-bit \
                numbers are strings, bytes are base64, the server rejects unknown fields and names their path.",
        },
        "paths": paths,
        "components": {"schemas": components(&schemas), "responses": {"Problem": problem_response(), "SentOn": sent_on_response()}},
    }))
}

fn components(schemas: &Schemas) -> Value {
    let mut all = schemas.all();
    let frames = json!({
        "type": "object",
        "description": "The frame of a solve in parts, and what was committed.",
        "properties": {
            "frames": {"type": "array", "items": {"$ref": "#/components/schemas/Frame"}},
            "revision": {"type": "string", "description": "The session's revision."},
            "digest": {"type": "string", "description": "Digest of the positions."},
        },
    });
    let problem = json!({
        "type": "object",
        "description": "What went wrong (RFC 9457), with the code that gRPC uses.",
        "required": ["type", "title", "status", "detail", "code"],
        "properties": {
            "type": {"type": "string", "format": "uri"},
            "title": {"type": "string"},
            "status": {"type": "integer"},
            "detail": {"type": "string", "description": "What was seen and what is allowed."},
            "code": {"type": "string", "description": "Name of the gRPC status."},
            "instance": {"type": "string", "description": "The path that was asked for."},
            "errors": {"type": "array", "items": {"type": "object", "properties": {
                "field": {"type": "string", "description": "Path of the field in JSON names."},
                "problem": {"type": "string"},
            }}},
        },
    });
    all.insert("Frames".into(), frames);
    all.insert("Problem".into(), problem);
    Value::Object(all)
}

fn problem_response() -> Value {
    json!({
        "description": "The server rejected the call, or the call failed; nothing has changed.",
        "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}},
    })
}

fn sent_on_response() -> Value {
    let header = |text: &str| json!({"description": text, "required": true, "schema": {"type": "string"}});
    json!({
        "description": "Another node has the session, or more room for a new one. Repeat the call there.",
        "headers": {
            "Location": header("Where to repeat the call, as it was."),
            "x-pliant-owner": header("The address of the node that has the session."),
            "x-pliant-node": header("The name of that node, for a proxy that routes by it."),
        },
        "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}},
    })
}

fn operation(route: &Route, schemas: &Schemas) -> Value {
    let mut operation = Map::new();
    operation.insert("operationId".into(), operation_id(route).into());
    operation.insert("summary".into(), route.summary.into());
    if let Some(text) = route.rpc.and_then(|rpc| schemas.rpc_comment(rpc)) {
        operation.insert("description".into(), text.into());
    }
    let mut parameters: Vec<Value> = route
        .path
        .split('/')
        .filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'))
        .map(|name| json!({"name": name, "in": "path", "required": true, "schema": {"type": "string"}}))
        .collect();
    parameters.extend(
        route.query.iter().map(
            |(name, text)| json!({"name": name, "in": "query", "description": text, "schema": {"type": "string"}}),
        ),
    );
    if route.keyed {
        let text = "A retry with the same key gets the first answer.";
        parameters.push(
            json!({"name": "Idempotency-Key", "in": "header", "description": text, "schema": {"type": "string"}}),
        );
    }
    for parameter in &mut parameters {
        let name = parameter["name"].as_str().unwrap_or_default();
        if let Some(example) = parameter_example(route, name) {
            parameter["example"] = example.into();
        }
    }
    if !parameters.is_empty() {
        operation.insert("parameters".into(), parameters.into());
    }
    if let Some(body) = request_body(route) {
        operation.insert("requestBody".into(), body);
    }
    let mut responses = Map::new();
    responses.insert(route.status.to_string(), success(route));
    for status in schemas::other_successes(route) {
        responses.insert(status.to_string(), success(route));
    }
    if schemas::is_sent_on(route) {
        responses.insert("307".into(), json!({"$ref": "#/components/responses/SentOn"}));
    }
    for status in schemas::refusals(route) {
        responses.insert(status.to_string(), json!({"$ref": "#/components/responses/Problem"}));
    }
    operation.insert("responses".into(), responses.into());
    let samples = code_samples(route, &operation_id(route));
    operation.insert("x-codeSamples".into(), samples.into());
    operation.into()
}

fn operation_id(route: &Route) -> String {
    match route.rpc {
        Some(rpc) => {
            let mut letters = rpc.chars();
            letters
                .next()
                .map(|first| first.to_ascii_lowercase())
                .into_iter()
                .chain(letters)
                .collect()
        }
        None => {
            let words = route
                .path
                .split(|c: char| !c.is_ascii_alphanumeric())
                .filter(|w| !w.is_empty() && *w != "v1");
            words.fold(route.method.to_owned(), |id, word| {
                let (first, rest) = word.split_at(1);
                id + &first.to_ascii_uppercase() + rest
            })
        }
    }
}

fn bytes() -> Value {
    json!({"schema": {"type": "string", "format": "binary"}})
}

fn models(formats: &[Format]) -> Map<String, Value> {
    formats
        .iter()
        .map(|format| (format.media_type().to_owned(), bytes()))
        .collect()
}

fn request_body(route: &Route) -> Option<Value> {
    if route.rpc == Some("CreateSession") {
        let mut content = models(&Format::READ);
        content.insert("application/octet-stream".into(), bytes());
        content.insert(
            "multipart/form-data".into(),
            json!({"schema": {"type": "object", "required": ["model"], "properties": {
                "model": {"type": "string", "format": "binary", "description": "The model; its file name may give the format."},
                "options": {"$ref": "#/components/schemas/CreateOptions"},
            }, "additionalProperties": {"type": "string", "format": "binary", "description": "A companion file; its file name is the URI by which the model names it."}}}),
        );
        return Some(json!({"content": content}));
    }
    let message = route.takes?;
    let schema = json!({"$ref": format!("#/components/schemas/{message}")});
    let mut plain = json!({"schema": schema});
    if let Some(example) = body_example(route) {
        plain["example"] = example;
    }
    if route.rpc == Some("Animate") {
        let form = json!({"schema": {"type": "object", "properties": {
            "options": schema,
            "clip": {"type": "string", "format": "binary", "description": "A BVH file; without it a clip of the model itself."},
        }}});
        let content = json!({"application/json": plain, "multipart/form-data": form});
        return Some(json!({"content": content}));
    }
    Some(json!({"content": {"application/json": plain}}))
}

fn success(route: &Route) -> Value {
    let mut content = Map::new();
    if let Some(message) = route.gives {
        content.insert(
            "application/json".into(),
            json!({"schema": {"$ref": format!("#/components/schemas/{message}")}}),
        );
    }
    match route.path {
        "/v1/sessions/{id}/solve" => {
            content.insert("application/octet-stream".into(), bytes());
            content.extend(models(&Format::ALL));
        }
        "/v1/sessions/{id}/animations" => {
            let frame = json!({"schema": {"$ref": "#/components/schemas/Frame"}});
            let [lines, delimited, model] = ANIMATION_TYPES;
            content.insert(lines.into(), frame);
            content.insert(delimited.into(), bytes());
            content.insert(model.into(), bytes());
        }
        "/v1/sessions/{id}/model" => {
            content = models(&Format::ALL);
            content.extend(models(&Format::SPLATS));
        }
        "/v1/sessions/{id}/positions" => {
            content.insert("application/octet-stream".into(), bytes());
        }
        "/v1/sample.glb" => {
            content.insert("model/gltf-binary".into(), bytes());
        }
        "/metrics" => {
            content.insert(
                "application/openmetrics-text".into(),
                json!({"schema": {"type": "string"}}),
            );
        }
        "/healthz" | "/readyz" => {
            content.insert("text/plain".into(), json!({"schema": {"type": "string"}}));
        }
        _ => {}
    }
    let mut response = Map::new();
    response.insert("description".into(), "Done.".into());
    if !content.is_empty() {
        response.insert("content".into(), content.into());
    }
    response.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_description_is_whole() {
        let document = build().unwrap();
        let schemas = document["components"]["schemas"].as_object().unwrap();
        // Every reference leads somewhere.
        let text = document.to_string();
        for reference in text.split("\"#/components/schemas/").skip(1) {
            let name = reference.split('"').next().unwrap();
            assert!(schemas.contains_key(name), "{name} is referred to and not described");
        }
        // Comments of the schema arrive.
        assert_eq!(
            schemas["SetHandlesRequest"]["description"],
            "Replaces a session's handles."
        );
        assert!(
            schemas["Handle"]["properties"]["stiffness"]["description"]
                .as_str()
                .unwrap()
                .starts_with("Absent = hard")
        );
        assert_eq!(
            schemas["Session"]["properties"]["revision"]["type"],
            json!(["string", "integer"])
        );
        assert_eq!(
            schemas["CreateOptions.Components"]["enum"],
            json!(["FOLLOW", "HOLD", "FREE"])
        );
        assert_eq!(
            schemas["Session"]["properties"]["buildMs"]["additionalProperties"]["type"],
            "number"
        );
    }

    /// Every field that is not a list is a parameter; the text of `options` names the lists.
    #[test]
    fn every_create_option_is_a_parameter_or_mentioned() {
        let document = build().unwrap();
        let parameters = document["paths"]["/v1/sessions"]["post"]["parameters"]
            .as_array()
            .unwrap();
        let named = |name: &str| parameters.iter().find(|p| p["name"] == name);
        let options = named("options").unwrap()["description"].as_str().unwrap();
        let schema = pliant_wire::json::descriptors()
            .unwrap()
            .get_message_by_name("pliant.v1.CreateOptions")
            .unwrap();
        for field in schema.fields() {
            let name = field.json_name();
            let is_described =
                named(name).is_some() || options.split(|c: char| !c.is_alphanumeric()).any(|word| word == name);
            assert!(
                is_described,
                "POST /v1/sessions takes {name}, and its description does not say so"
            );
        }
    }

    #[test]
    fn operation_ids_are_unique() {
        let mut ids: Vec<String> = ROUTES.iter().map(operation_id).collect();
        ids.sort();
        let count = ids.len();
        ids.dedup();
        assert_eq!(ids.len(), count, "{ids:?}");
    }

    #[test]
    fn every_call_has_a_sample_in_curl_and_every_part_of_the_program_in_python_is_one() {
        let document = build().unwrap();
        let mut in_python = 0;
        for route in &ROUTES {
            let samples = &document["paths"][route.path][route.method]["x-codeSamples"];
            let curl = samples[0]["source"].as_str().unwrap();
            let path = route.path.replace("{id}", "$id").replace("{handleId}", "head");
            let names_both = curl.contains(&path.replace("$id/animations", "$figure/animations"))
                && (route.method == "get" || curl.contains(&format!("-X {}", route.method.to_uppercase())));
            assert!(
                samples[0]["lang"] == "curl" && names_both,
                "{} {path}: {curl}",
                route.method
            );
            in_python += usize::from(samples[1]["lang"] == "Python");
        }
        assert_eq!(
            in_python,
            schemas::python_parts().count(),
            "a part of samples.py has the name of no call"
        );
    }

    #[test]
    fn every_rpc_with_a_message_form_has_a_route() {
        let service = pliant_wire::json::descriptors()
            .unwrap()
            .get_service_by_name("pliant.v1.Deformer")
            .unwrap();
        for method in service.methods() {
            assert!(
                ROUTES.iter().any(|r| r.rpc == Some(method.name())),
                "{} has no route",
                method.name()
            );
        }
        for route in &ROUTES {
            if let Some(rpc) = route.rpc {
                assert!(service.methods().any(|m| m.name() == rpc), "{rpc} is not an rpc");
            }
        }
    }
}
