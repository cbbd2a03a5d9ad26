//! Pages that are not calls of the schema: health, counts, the API description, the sample, and the viewer.
//!
//! The viewer at `/` is built from `src/server/viewer/` and is part of the binary. A binary that was built without it (see
//! `src/server/viewer/build.rs`) explains at `/` how to build it.

use super::create::built_in_model;
use super::models::{Download, unchanged};
use super::problem::{self, Problem};
use super::request::{Caller, Names, parameters};
use crate::openapi;
use crate::state::ServerState;
use axum::body::Body;
use axum::extract::State;
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use pliant_asset::sample::BuiltInModel;
use pliant_session::{Error, ErrorCode};
use xxhash_rust::xxh3::xxh3_64;

/// Answers while the process lives.
pub(super) async fn alive() -> &'static str {
    "ok\n"
}

/// Answers while the server takes new work.
pub(super) async fn ready(State(state): State<ServerState>) -> Result<&'static str, Problem> {
    if state.draining.is_cancelled() {
        return Err(Error::draining().into());
    }
    let not_ready = |text: &str| Error {
        retry_after_s: Some(5),
        ..Error::new(ErrorCode::Unavailable, text)
    };
    if !state.manager.admits() {
        return Err(not_ready("the sessions hold nearly all the memory that they may").into());
    }
    if !state.manager.takes_writes() {
        let text = "the store of sessions cannot be written at present: a full disk, a lost permission, or a database or folder that is \
                    gone; the log says which";
        return Err(not_ready(text).into());
    }
    Ok("ready\n")
}

pub(super) async fn metrics(State(state): State<ServerState>, caller: Caller) -> Result<Response, Problem> {
    if !state.config.metrics {
        return Err(Problem::new(
            StatusCode::NOT_FOUND,
            "NOT_FOUND",
            "counts are switched off (key metrics)",
        ));
    }
    if !caller.reads_metrics {
        let text = "this caller may not read the counts of all tenants; its token must say metrics = true";
        return Err(Error::new(ErrorCode::PermissionDenied, text).into());
    }
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    Ok((
        [(header::CONTENT_TYPE, kind)],
        state.telemetry.text(state.manager.metrics()),
    )
        .into_response())
}

pub(super) async fn openapi() -> Result<Response, Problem> {
    let document = openapi::document()?;
    Ok(([(header::CONTENT_TYPE, "application/json")], document).into_response())
}

pub(super) async fn sample(_: Caller, uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    let name = parameters(&uri, &["name"])?.remove("name");
    let model = name.map_or(Ok(BuiltInModel::Creature), |name| built_in_model("name", &name))?;
    let bytes = Bytes::from_static(model.glb());
    // It never changes while the server runs.
    let etag = format!("\"{:016x}\"", xxh3_64(&bytes));
    let download = Download {
        bytes,
        media_type: pliant_asset::Format::GLB.media_type(),
        etag,
        file_name: format!("{}.glb", model.name()),
    };
    download.respond(&headers)
}

/// A file of the page.
struct File {
    /// Its path below `/`.
    path: &'static str,
    /// Distinguishes its builds.
    tag: &'static str,
    plain: &'static [u8],
    /// The same compressed, where that pays.
    gzip: Option<&'static [u8]>,
}

const FILES: &[File] = include!(concat!(env!("OUT_DIR"), "/viewer_files.rs"));

/// The page at `/` without the viewer.
const ABSENT: &str = include_str!("../../viewer/absent.html");

/// The page may load its own files and call this server. Nothing inline, nothing from elsewhere, in no frame.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The page without the viewer has its few lines of style inside.
const ABSENT_POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; \
                             frame-ancestors 'none'";

/// The viewer's page.
pub(super) async fn viewer(headers: HeaderMap) -> Response {
    match find("index.html") {
        Some(file) => respond(file, &headers),
        None => with_page_headers(
            (StatusCode::OK, ABSENT).into_response(),
            "text/html; charset=utf-8",
            ABSENT_POLICY,
        ),
    }
}

/// A file that the page names below `/assets/`.
pub(super) async fn asset(Names(name): Names<String>, headers: HeaderMap) -> Result<Response, Problem> {
    let found = find(&format!("assets/{name}")).ok_or_else(|| {
        let shown = problem::clip(&name);
        let detail = format!("the viewer has no file {shown}; a page of another build asks for it, reload it");
        Problem::new(StatusCode::NOT_FOUND, "NOT_FOUND", detail)
    })?;
    Ok(respond(found, &headers))
}

/// The page's icon.
pub(super) async fn icon(headers: HeaderMap) -> Result<Response, Problem> {
    let found = find("icon.svg").ok_or_else(|| {
        let detail = "this server was built without the viewer";
        Problem::new(StatusCode::NOT_FOUND, "NOT_FOUND", detail)
    })?;
    Ok(respond(found, &headers))
}

fn find(path: &str) -> Option<&'static File> {
    FILES.iter().find(|file| file.path == path)
}

fn respond(file: &File, request: &HeaderMap) -> Response {
    let packed = file.gzip.filter(|_| takes_gzip(request));
    let etag = match packed {
        Some(_) => format!("\"{}-gzip\"", file.tag),
        None => format!("\"{}\"", file.tag),
    };
    let mut response = unchanged(&etag, request).unwrap_or_else(|| {
        let bytes = Bytes::from_static(packed.unwrap_or(file.plain));
        let mut whole = Response::new(Body::from(bytes));
        if packed.is_some() {
            let gzip = HeaderValue::from_static("gzip");
            whole.headers_mut().insert(header::CONTENT_ENCODING, gzip);
        }
        whole
    });
    let headers = response.headers_mut();
    if let Ok(etag) = HeaderValue::from_str(&etag) {
        headers.insert(header::ETAG, etag);
    }
    // Names of assets change with their content; the page itself must be asked for.
    let keep = if file.path.starts_with("assets/") {
        "public, max-age=31536000, immutable"
    } else {
        "no-cache"
    };
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(keep));
    headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    with_page_headers(response, media_type(file.path), POLICY)
}

/// Adds the headers of every page for people: its type, its policy, no referrer, no shared window.
pub(super) fn with_page_headers(mut response: Response, media_type: &'static str, policy: &'static str) -> Response {
    let headers = response.headers_mut();
    let mut set = |name: HeaderName, value: &'static str| headers.insert(name, HeaderValue::from_static(value));
    set(header::CONTENT_TYPE, media_type);
    set(header::CONTENT_SECURITY_POLICY, policy);
    set(header::REFERRER_POLICY, "no-referrer");
    set(HeaderName::from_static("cross-origin-opener-policy"), "same-origin");
    response
}

fn media_type(path: &str) -> &'static str {
    match path.rsplit_once('.').map(|(_, extension)| extension) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "application/octet-stream",
    }
}

/// Whether the client can read gzip: it names it, and not with the weight 0.
fn takes_gzip(request: &HeaderMap) -> bool {
    let accepted = request.get_all(header::ACCEPT_ENCODING).iter();
    accepted
        .filter_map(|value| value.to_str().ok())
        .flat_map(|text| text.split(','))
        .any(|entry| {
            let mut words = entry.split(';').map(str::trim);
            let named = words.next().is_some_and(|coding| coding.eq_ignore_ascii_case("gzip"));
            named && !words.any(|word| matches!(word.replace(' ', "").as_str(), "q=0" | "q=0.0" | "q=0.00" | "q=0.000"))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCRIPT: File = File {
        path: "assets/index-1.js",
        tag: "00000000000000ab",
        plain: b"let plain;",
        gzip: Some(b"packed"),
    };

    fn asking(pairs: &[(HeaderName, &'static str)]) -> HeaderMap {
        pairs
            .iter()
            .map(|(name, value)| (name.clone(), HeaderValue::from_static(value)))
            .collect()
    }

    #[test]
    fn the_page_names_only_files_that_are_here() {
        let Some(page) = find("index.html") else {
            println!("SKIPPED: this build has no viewer");
            return;
        };
        let text = std::str::from_utf8(page.plain).unwrap();
        let named: Vec<&str> = text
            .split(['"', '\''])
            .filter_map(|part| part.strip_prefix("./"))
            .collect();
        assert!(named.iter().any(|path| path.ends_with(".js")), "{text}");
        for path in named {
            assert!(find(path).is_some(), "{path}");
        }
        // The policy refuses both.
        assert!(!text.contains("<style") && !text.contains("style="), "{text}");
        assert!(!text.contains("<script>"), "{text}");
    }

    #[test]
    fn gzip_goes_to_those_who_read_it() {
        let plain = respond(&SCRIPT, &HeaderMap::new());
        assert!(!plain.headers().contains_key(header::CONTENT_ENCODING));
        let packed = respond(&SCRIPT, &asking(&[(header::ACCEPT_ENCODING, "br, GZIP;q=0.5")]));
        assert_eq!(packed.headers()[header::CONTENT_ENCODING], "gzip");
        assert_ne!(plain.headers()[header::ETAG], packed.headers()[header::ETAG]);
        let refused = respond(&SCRIPT, &asking(&[(header::ACCEPT_ENCODING, "gzip;q=0, identity")]));
        assert!(!refused.headers().contains_key(header::CONTENT_ENCODING));
    }

    #[test]
    fn a_known_file_is_not_sent_again() {
        let known = asking(&[(header::IF_NONE_MATCH, "\"00000000000000ab\"")]);
        let response = respond(&SCRIPT, &known);
        assert_eq!(response.status(), StatusCode::NOT_MODIFIED);
        assert_eq!(
            response.headers()[header::CACHE_CONTROL],
            "public, max-age=31536000, immutable"
        );
        let other = asking(&[(header::IF_NONE_MATCH, "\"00000000000000cd\"")]);
        assert_eq!(respond(&SCRIPT, &other).status(), StatusCode::OK);
    }

    #[test]
    fn every_answer_carries_the_policy() {
        let response = respond(&SCRIPT, &HeaderMap::new());
        let policy = response.headers()[header::CONTENT_SECURITY_POLICY].to_str().unwrap();
        assert!(
            policy.contains("default-src 'none'") && policy.contains("frame-ancestors 'none'"),
            "{policy}"
        );
        assert!(!policy.contains("unsafe"), "{policy}");
        assert_eq!(
            response.headers()[header::CONTENT_TYPE],
            "text/javascript; charset=utf-8"
        );
    }
}
