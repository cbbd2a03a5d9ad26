//! `/docs`: the API description as a page for people, made from `/openapi.json` alone, nothing from elsewhere. Its script searches
//! and makes calls of this server; without it the page reads as well.

use super::pages::with_page_headers;
use super::problem::Problem;
use crate::openapi;
use axum::body::Body;
use axum::response::Response;
use pliant_session::Error;
use serde_json::Value;
use std::fmt::Write as _;
use std::sync::LazyLock;

/// The page may run its own script and call this server; its style stands inside.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'self'; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

static PAGE: LazyLock<Result<String, Error>> = LazyLock::new(|| {
    let document: Value = serde_json::from_str(&openapi::document()?)
        .map_err(|_| Error::new(pliant_session::ErrorCode::Internal, "the API description is not JSON"))?;
    Ok(render(&document))
});

/// The page.
pub(crate) async fn page() -> Result<Response, Problem> {
    let text = PAGE.as_deref().map_err(Clone::clone)?;
    let response = Response::new(Body::from(text));
    Ok(with_page_headers(response, "text/html; charset=utf-8", POLICY))
}

/// The page's script.
pub(crate) async fn script() -> Response {
    with_page_headers(
        Response::new(Body::from(SCRIPT)),
        "text/javascript; charset=utf-8",
        POLICY,
    )
}

/// The whole page of an OpenAPI document.
fn render(document: &Value) -> String {
    let info = &document["info"];
    let mut calls = String::new();
    let mut messages = String::new();
    let mut contents = String::from(
        "<div hidden><input id=\"search\" type=\"search\" placeholder=\"Search ( / )\" aria-label=\"Search calls and messages\"></div>\
         <h2>Calls</h2><ul>",
    );
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
            let shared = &document["components"]["responses"];
            call(&mut calls, &method, path, operation, shared);
        }
    }
    contents.push_str("</ul><h2>Messages</h2><ul>");
    for (name, schema) in entries(&document["components"]["schemas"]) {
        let _ = write!(contents, "<li>{}</li>", link(name));
        message(&mut messages, name, schema);
    }
    contents.push_str("</ul>");
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}: the API</title>\n<style>{STYLE}</style>\n<nav aria-label=\"Calls and messages\">{contents}</nav>\n<main>\n\
         <h1>{title} {version}: the API</h1>\n<p>{about}</p>\n\
         <p>The same calls answer over gRPC and gRPC-Web on this port, as <code>pliant.v1.Deformer</code>. \
         <a href=\"/openapi.json\">/openapi.json</a> is this page for programs, \
         <a href=\"/v1/limits\">/v1/limits</a> what this server allows.</p>\n\
         <p>Examples fit a session with a built-in model. Open it first, as <code>createSession</code> shows: the other calls use its \
         <code>$id</code> in curl and its <code>session</code> in Python, which needs the package of <code>proto/clients/python</code>.</p>\n\
         <noscript><p>Without scripts this page neither searches nor calls.</p></noscript>\n\
         <label>Token, where the server asks for one <input id=\"token\" type=\"password\" autocomplete=\"off\"></label>\n\
         <p id=\"nothing\" hidden>Nothing fits.</p>\n\
         <h2>Calls</h2>\n{calls}<h2>Messages</h2>\n{messages}</main>\n<script src=\"/docs.js\"></script>\n</html>\n",
        title = escape(word(&info["title"])),
        version = escape(word(&info["version"])),
        about = escape(word(&info["description"])),
    )
}

/// What a call answers with, by status; those with the same body in one row, as most refusals are.
fn answers(rows: &mut String, operation: &Value, shared: &Value) {
    let mut found: Vec<(String, &Value)> = Vec::new();
    for (status, response) in entries(&operation["responses"]) {
        if status == "default" {
            continue;
        }
        let named = response["$ref"].as_str().and_then(|r| r.rsplit('/').next());
        let content = &named.map_or(response, |name| &shared[name])["content"];
        match found.iter_mut().find(|(_, other)| *other == content) {
            Some((statuses, _)) => {
                let _ = write!(statuses, ", {status}");
            }
            None => found.push((format!("answer {status}"), content)),
        }
    }
    for (statuses, content) in found {
        body(rows, &statuses, content);
    }
}

fn call(page: &mut String, method: &str, path: &str, operation: &Value, shared: &Value) {
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
    answers(&mut rows, operation, shared);
    table(page, &rows);
    samples(page, method, path, operation);
    page.push_str("</section>\n");
}

/// The samples of a call, and what the script makes it from.
fn samples(page: &mut String, method: &str, path: &str, operation: &Value) {
    for sample in operation["x-codeSamples"].as_array().into_iter().flatten() {
        let [lang, source] = ["lang", "source"].map(|key| escape(word(&sample[key])));
        let _ = writeln!(page, "<h4>{lang}</h4>\n<pre tabindex=\"0\"><code>{source}</code></pre>");
    }
    if operation["responses"]["101"].is_object() {
        // Nothing that a form can do.
        return;
    }
    let content = &operation["requestBody"]["content"];
    let json = &content["application/json"]["example"];
    let call = serde_json::json!({
        "method": method,
        "path": path,
        "parameters": operation["parameters"],
        "json": json.is_object().then_some(json),
        "file": content.is_object() && !json.is_object(),
    });
    let _ = writeln!(page, "<div data-call=\"{}\"></div>", escape(&call.to_string()));
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
                for sample in operation["x-codeSamples"].as_array().unwrap() {
                    assert!(
                        page.contains(&escape(word(&sample["source"]))),
                        "{method} {path}: {sample}"
                    );
                }
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
    fn refusals_are_one_row_that_says_what_they_hold() {
        let page = PAGE.as_ref().unwrap();
        let create = page.split("<section id=\"createSession\">").nth(1).unwrap();
        let create = create.split("</section>").next().unwrap();
        let rows: Vec<&str> = create.split("<tr>").filter(|row| row.contains(">answer ")).collect();
        assert_eq!(rows.len(), 2, "{rows:#?}");
        assert!(
            rows[1].contains("answer 307, 400, 401,") && rows[1].contains("application/problem+json"),
            "{}",
            rows[1]
        );
    }

    #[test]
    fn nothing_is_loaded_from_elsewhere() {
        let page = PAGE.as_ref().unwrap();
        for part in ["<link", "<img", "@import", "url(", " onclick", " onload"] {
            assert!(!page.contains(part), "{part} is in the page");
        }
        let scripts: Vec<&str> = attribute(page, "src").collect();
        assert_eq!(
            (scripts.as_slice(), page.matches("<script").count()),
            (&["/docs.js"][..], 1)
        );
        assert!(!SCRIPT.contains("://") && !SCRIPT.contains("innerHTML"));
        // Samples call the server at its usual address.
        let rest = page.replace("http://127.0.0.1:7411", "");
        let place = rest.find("://");
        assert_eq!(
            place,
            None,
            "an address of elsewhere: {:?}",
            place.map(|at| &rest[at - 20..at + 20])
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
