//! `/docs`: the API description as a page for people, made from `/openapi.json` alone. No script, nothing from elsewhere.

use super::problem::Problem;
use super::viewer::guarded;
use crate::server::openapi;
use crate::session::Error;
use axum::body::Body;
use axum::response::Response;
use serde_json::Value;
use std::fmt::Write as _;
use std::sync::LazyLock;

/// The page may do nothing but show itself; its style stands inside.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

const STYLE: &str = "
:root { color-scheme: light dark; --line: #8884; --quiet: #8881 }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0; display: grid; grid-template-columns: 16rem minmax(0, 1fr) }
nav { position: sticky; top: 0; height: 100vh; overflow-y: auto; padding: 1.5rem 1rem; box-sizing: border-box; font-size: .875rem; border-right: 1px solid var(--line) }
nav ul { list-style: none; margin: 0 0 1rem; padding: 0 }
nav a { text-decoration: none; overflow-wrap: anywhere }
main { padding: 1.5rem 2rem; max-width: 60rem; min-width: 0; box-sizing: border-box; overflow-wrap: break-word }
h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line) }
h3 { margin: 2rem 0 .25rem; font-size: 1.05rem; overflow-wrap: anywhere }
code { font-size: .9em; background: var(--quiet); padding: .1em .3em; border-radius: .25em; overflow-wrap: anywhere }
table { border-collapse: collapse; width: 100%; font-size: .9rem }
th, td { text-align: left; vertical-align: top; padding: .3rem .75rem .3rem 0; border-bottom: 1px solid var(--line) }
td:first-child { width: 26%; overflow-wrap: anywhere }
.method { display: inline-block; min-width: 4.5rem; font-weight: 700 }
@media (max-width: 50rem) {
  body { display: block }
  nav { position: static; height: auto; max-height: 9rem; padding: .5rem 1rem; border-right: 0; border-bottom: 1px solid var(--line) }
  main { padding: 1rem }
  table, tbody, tr, td, td:first-child { display: block; width: auto }
  td { padding: 0; border: 0; overflow-wrap: anywhere }
  tr { padding: .4rem 0; border-bottom: 1px solid var(--line) }
}
";

static PAGE: LazyLock<Result<String, Error>> = LazyLock::new(|| {
    let document: Value = serde_json::from_str(&openapi::document()?)
        .map_err(|_| Error::new(crate::session::ErrorCode::Internal, "the API description is no JSON"))?;
    Ok(render(&document))
});

/// The page.
pub(super) async fn page() -> Result<Response, Problem> {
    let text = PAGE.as_deref().map_err(Clone::clone)?;
    let response = Response::new(Body::from(text));
    Ok(guarded(response, "text/html; charset=utf-8", POLICY))
}

/// The whole page of an OpenAPI document.
fn render(document: &Value) -> String {
    let info = &document["info"];
    let mut calls = String::new();
    let mut messages = String::new();
    let mut contents = String::from("<p>Calls</p><ul>");
    for (path, methods) in entries(&document["paths"]) {
        for (method, operation) in entries(methods) {
            let id = word(&operation["operationId"]);
            let method = method.to_uppercase();
            let _ = write!(
                contents,
                "<li><a href=\"#{}\">{} {}</a></li>",
                escape(id),
                escape(&method),
                escape(path)
            );
            call(&mut calls, &method, path, operation);
        }
    }
    contents.push_str("</ul><p>Messages</p><ul>");
    for (name, schema) in entries(&document["components"]["schemas"]) {
        let _ = write!(contents, "<li>{}</li>", link(name));
        message(&mut messages, name, schema);
    }
    contents.push_str("</ul>");
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}: the API</title>\n<style>{STYLE}</style>\n<nav>{contents}</nav>\n<main>\n\
         <h1>{title} {version}: the API</h1>\n<p>{about}</p>\n\
         <p>The same calls answer over gRPC and gRPC-Web on this port, as <code>pliant.v1.Deformer</code>. \
         <a href=\"/openapi.json\">/openapi.json</a> is this page for programs, \
         <a href=\"/v1/limits\">/v1/limits</a> what this server allows.</p>\n\
         <h2>Calls</h2>\n{calls}<h2>Messages</h2>\n{messages}</main>\n</html>\n",
        title = escape(word(&info["title"])),
        version = escape(word(&info["version"])),
        about = escape(word(&info["description"])),
    )
}

fn call(page: &mut String, method: &str, path: &str, operation: &Value) {
    let id = escape(word(&operation["operationId"]));
    let _ = writeln!(
        page,
        "<section id=\"{id}\"><h3><span class=\"method\">{}</span><code>{}</code></h3>",
        escape(method),
        escape(path)
    );
    for text in [word(&operation["summary"]), word(&operation["description"])] {
        if !text.is_empty() {
            let _ = writeln!(page, "<p>{}</p>", escape(text));
        }
    }
    let mut rows = String::new();
    for parameter in operation["parameters"].as_array().into_iter().flatten() {
        let place = format!("in the {}", word(&parameter["in"]));
        let text = word(&parameter["description"]);
        row(&mut rows, word(&parameter["name"]), &escape(&place), text);
    }
    body(&mut rows, "body", &operation["requestBody"]["content"]);
    for (status, response) in entries(&operation["responses"]) {
        if status != "default" {
            body(&mut rows, &format!("answer {status}"), &response["content"]);
        }
    }
    table(page, &rows);
    page.push_str("</section>\n");
}

/// A row for what a body may be.
fn body(rows: &mut String, name: &str, content: &Value) {
    let mut kinds = Vec::new();
    let mut shapes = Vec::new();
    for (kind, of) in entries(content) {
        kinds.push(kind.clone());
        if of["schema"]["$ref"].is_string() {
            shapes.push(shape(&of["schema"]));
        }
    }
    if !kinds.is_empty() || name.starts_with("answer") {
        let text = match kinds.as_slice() {
            [] => "no body".to_owned(),
            kinds => kinds.join(", "),
        };
        row(rows, name, &shapes.join(", "), &text);
    }
}

fn message(page: &mut String, name: &str, schema: &Value) {
    let name = escape(name);
    let _ = writeln!(page, "<section id=\"message-{name}\"><h3><code>{name}</code></h3>");
    for text in [word(&schema["description"]), word(&schema["$comment"])] {
        if !text.is_empty() && !schema["enum"].is_array() {
            let _ = writeln!(page, "<p>{}</p>", escape(text));
        }
    }
    let mut rows = String::new();
    if let Some(values) = schema["enum"].as_array() {
        let _ = writeln!(page, "<p>{}</p>", escape(word(&schema["description"])));
        for value in values {
            let value = word(value);
            row(&mut rows, value, "", word(&schema["x-enumDescriptions"][value]));
        }
    }
    for (field, of) in entries(&schema["properties"]) {
        row(&mut rows, field, &shape(of), word(&of["description"]));
    }
    table(page, &rows);
    page.push_str("</section>\n");
}

/// What a value looks like, as HTML.
fn shape(schema: &Value) -> String {
    if let Some(name) = schema["$ref"].as_str().and_then(|r| r.rsplit('/').next()) {
        return link(name);
    }
    if schema["items"].is_object() {
        return format!("list of {}", shape(&schema["items"]));
    }
    if schema["additionalProperties"].is_object() {
        return format!("map to {}", shape(&schema["additionalProperties"]));
    }
    let kind = match &schema["type"] {
        Value::Array(kinds) => kinds.iter().map(word).collect::<Vec<_>>().join(" or "),
        kind => word(kind).to_owned(),
    };
    let finer = schema["format"].as_str().or(schema["contentEncoding"].as_str());
    escape(&finer.map_or(kind.clone(), |finer| format!("{kind} ({finer})")))
}

/// `shape` is HTML, the others are text.
fn row(rows: &mut String, name: &str, shape: &str, text: &str) {
    let _ = writeln!(
        rows,
        "<tr><td><code>{}</code></td><td>{shape}</td><td>{}</td></tr>",
        escape(name),
        escape(text)
    );
}

fn table(page: &mut String, rows: &str) {
    if !rows.is_empty() {
        let _ = writeln!(page, "<table>{rows}</table>");
    }
}

fn link(name: &str) -> String {
    let name = escape(name);
    format!("<a href=\"#message-{name}\">{name}</a>")
}

fn entries(object: &Value) -> impl Iterator<Item = (&String, &Value)> {
    object.as_object().into_iter().flatten()
}

fn word(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn attribute<'a>(page: &'a str, name: &str) -> impl Iterator<Item = &'a str> {
        page.split(&format!(" {name}=\""))
            .skip(1)
            .filter_map(|rest| rest.split('"').next())
            .collect::<Vec<_>>()
            .into_iter()
    }

    #[test]
    fn every_call_and_message_has_a_place_and_every_link_leads_to_one() {
        let document: Value = serde_json::from_str(&openapi::document().unwrap()).unwrap();
        let page = PAGE.as_ref().unwrap();
        let places: BTreeSet<&str> = attribute(page, "id").collect();
        for (path, methods) in entries(&document["paths"]) {
            for (method, operation) in entries(methods) {
                assert!(places.contains(word(&operation["operationId"])), "{method} {path}");
            }
        }
        for (name, schema) in entries(&document["components"]["schemas"]) {
            assert!(places.contains(format!("message-{name}").as_str()), "{name}");
            for (field, of) in entries(&schema["properties"]) {
                let text = escape(word(&of["description"]));
                assert!(page.contains(&text), "{name}.{field}: {text}");
            }
        }
        for target in attribute(page, "href") {
            match target.strip_prefix('#') {
                Some(place) => assert!(places.contains(place), "{target} leads nowhere"),
                None => assert!(["/openapi.json", "/v1/limits"].contains(&target), "{target}"),
            }
        }
    }

    #[test]
    fn nothing_is_loaded_and_nothing_runs() {
        let page = PAGE.as_ref().unwrap();
        for part in [
            "<script", "<link", "<img", "@import", "url(", "src=", " onclick", " onload",
        ] {
            assert!(!page.contains(part), "{part} is in the page");
        }
        let place = page.find("://");
        assert_eq!(
            place,
            None,
            "an address of elsewhere: {:?}",
            place.map(|at| &page[at - 20..at + 20])
        );
    }

    #[test]
    fn words_of_the_schema_cannot_become_markup() {
        let document = serde_json::json!({
            "info": {"title": "<b>", "version": "&", "description": "\"x\" < y"},
            "paths": {"/<i>": {"get": {"operationId": "a\"b", "summary": "<script>"}}},
            "components": {"schemas": {"<u>": {"properties": {"<p>": {"type": "<a>", "description": "1 < 2"}}}}},
        });
        let page = render(&document);
        for markup in ["<b>", "<i>", "<u>", "<script>", "<a>", "a\"b"] {
            assert!(!page.contains(markup), "{markup}");
        }
        assert!(page.contains("1 &lt; 2") && page.contains("&lt;script&gt;"));
    }
}
