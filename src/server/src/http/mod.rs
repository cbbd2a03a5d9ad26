//! HTTP/1.1 and HTTP/2: JSON in and out, models and vertex buffers as bytes, problems as documents.
//!
//! The order of layers, outermost first: request number and count → rejections of the request filter → problem documents → compression of
//! JSON → routes. Each call checks in the order authentication, session, then query and body.

mod agents;
mod body;
mod create;
mod docs;
mod models;
mod pages;
pub(super) mod problem;
mod request;
mod route_table;
mod sessions;
mod upload;

pub(super) use request::Caller;
pub(super) use route_table::{ROUTES, Route};
pub(super) use sessions::OFFERS as ANIMATION_TYPES;

use super::redirect;
use super::request_filter::Rejected;
use super::state::ServerState;
use super::telemetry::{self, Recorder};
use super::websocket;
use axum::Router;
use axum::body::Body;
use axum::extract::{MatchedPath, Request, State};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse as _, Response};
use axum::routing::{get, patch, post, put};
use body::UnreadBody;
use futures::FutureExt as _;
use http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use problem::Problem;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::Predicate;
use tracing::{Instrument as _, Span};

/// The id of a request; the server returns it unchanged.
pub(super) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// All HTTP routes over `state`.
pub(super) fn router(state: &ServerState) -> Router {
    routes()
        .fallback(unknown_route)
        .method_not_allowed_fallback(wrong_method)
        .layer(CompressionLayer::new().gzip(true).compress_when(JsonOnly))
        .layer(middleware::from_fn_with_state(state.clone(), frame))
        .with_state(state.clone())
}

/// All routes.
fn routes() -> Router<ServerState> {
    Router::new()
        .route("/v1/sessions", post(create::create).get(sessions::list))
        .route("/v1/sessions/{id}", get(sessions::get).delete(sessions::delete))
        .route("/v1/sessions/{id}/handles", put(sessions::set_handles))
        .route(
            "/v1/sessions/{id}/handles/{handleId}",
            patch(sessions::patch_handle).delete(sessions::delete_handle),
        )
        .route("/v1/sessions/{id}/solve", post(sessions::solve))
        .route("/v1/sessions/{id}/edits", post(sessions::edit))
        .route("/v1/sessions/{id}/carry", post(sessions::carry))
        .route("/v1/sessions/{id}/crossings", post(sessions::crossings))
        .route("/v1/sessions/{id}/rig", post(sessions::rig))
        .route("/v1/sessions/{id}/transfer", post(sessions::transfer))
        .route("/v1/sessions/{id}/animations", post(sessions::animate))
        .route("/v1/sessions/{id}/undo", post(sessions::undo))
        .route("/v1/sessions/{id}/redo", post(sessions::redo))
        .route("/v1/sessions/{id}/history", get(sessions::history))
        .route("/v1/sessions/{id}/model", get(models::model))
        .route("/v1/sessions/{id}/positions", get(models::positions))
        .route(
            "/v1/sessions/{id}/stream",
            get(websocket::upgrade).connect(websocket::upgrade),
        )
        .route("/mcp", post(agents::call))
        .route("/v1/limits", get(sessions::limits))
        .route("/v1/sample.glb", get(pages::sample))
        .route("/healthz", get(pages::alive))
        .route("/readyz", get(pages::ready))
        .route("/metrics", get(pages::metrics))
        .route("/openapi.json", get(pages::openapi))
        .route("/docs", get(docs::page))
        .route("/docs/", get(docs::page))
        .route("/docs.js", get(docs::script))
        .route("/", get(pages::viewer))
        .route("/icon.svg", get(pages::icon))
        .route("/assets/{name}", get(pages::asset))
}

async fn unknown_route(request: Request) -> Problem {
    let path = problem::clip(request.uri().path());
    Problem::new(
        StatusCode::NOT_FOUND,
        "NOT_FOUND",
        format!("there is nothing at {path}; /openapi.json lists what there is"),
    )
}

async fn wrong_method(request: Request) -> Problem {
    let (method, path) = (request.method(), problem::clip(request.uri().path()));
    Problem::new(
        StatusCode::METHOD_NOT_ALLOWED,
        "UNIMPLEMENTED",
        format!("{method} is not a method of {path}; the header Allow lists them"),
    )
}

/// Numbers and counts a call, catches its panics, and gives its problem document the path.
async fn frame(State(state): State<ServerState>, mut request: Request, next: Next) -> Response {
    let request_id = request
        .headers()
        .get(REQUEST_ID)
        .and_then(|v| v.to_str().ok())
        .filter(|id| !id.is_empty() && id.len() <= 128)
        .map_or_else(telemetry::request_id, Arc::from);
    let path: String = request.uri().path().chars().take(1024).collect();
    let route = request
        .extensions()
        .get::<MatchedPath>()
        .map_or("unknown", |m| m.as_str())
        .to_owned();
    let mut recorder = Recorder::start(&state.telemetry, "http", route, Arc::clone(&request_id), &request);

    let (uri, headers) = (request.uri().clone(), request.headers().clone());
    if let Some(without) = redirect::without_node(&uri) {
        *request.uri_mut() = without;
        request
            .headers_mut()
            .insert(redirect::NODE, HeaderValue::from_static("sent"));
    }
    let body = std::mem::replace(request.body_mut(), Body::empty());
    let mut unread = None;
    *request.body_mut() = match request.version() < http::Version::HTTP_2 {
        true => body::linger(body),
        false => {
            let (body, rest) = UnreadBody::of(body);
            unread = Some(rest);
            body
        }
    };
    let response = answer_call(&state, request, next, recorder.span()).await;

    let mut response = match response.extensions().get::<Problem>().cloned() {
        // Allow and other headers that the route added stay.
        Some(mut problem) => {
            problem.send_to_owner(&uri, &headers);
            let mut whole = problem.respond(Some(&path));
            for (name, value) in response.headers() {
                if !whole.headers().contains_key(name)
                    && name != header::CONTENT_LENGTH
                    && name != header::CONTENT_ENCODING
                {
                    whole.headers_mut().append(name.clone(), value.clone());
                }
            }
            whole
        }
        None => response,
    };
    if let Ok(id) = HeaderValue::from_str(&request_id) {
        response.headers_mut().insert(REQUEST_ID, id);
    }
    let status = response.status();
    // Damage in the store was reported as such.
    let is_damage = response
        .extensions()
        .get::<Problem>()
        .is_some_and(Problem::is_data_loss);
    if status == StatusCode::INTERNAL_SERVER_ERROR && !is_damage {
        tracing::error!(request.id = %request_id, http.path = %path, "a call failed by a defect of the server");
    }
    recorder.set_code(status.as_str());
    let unread = unread.filter(|_| status.is_client_error() || status.is_server_error());
    response.map(|body| {
        let answer = recorder.observe(body);
        match unread {
            Some(rest) => rest.delay_end(answer),
            None => answer,
        }
    })
}

/// Answers a call, or rejects it before anything of its body is read.
async fn answer_call(state: &ServerState, mut request: Request, next: Next, span: Span) -> Response {
    if let Some(Rejected(error)) = request.extensions_mut().remove() {
        Problem::from(error).into_response()
    } else if let Some(encoding) = unread_encoding(request.headers()) {
        let detail = format!("the content encoding \"{encoding}\" is not read; send the body as it is");
        Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "INVALID_ARGUMENT", detail)
            .with_header(header::ACCEPT_ENCODING, "identity".into())
            .into_response()
    } else if state.draining.is_cancelled() && matches!(*request.method(), Method::POST | Method::PUT | Method::PATCH) {
        Problem::from(state.manager.leaving().await).into_response()
    } else {
        // A defect ends its call with 500, not the connection.
        match AssertUnwindSafe(next.run(request))
            .catch_unwind()
            .instrument(span)
            .await
        {
            Ok(response) => response,
            Err(_panic) => Problem::internal("a call panicked").into_response(),
        }
    }
}

/// The encoding of a body that the server does not decode.
fn unread_encoding(headers: &HeaderMap) -> Option<String> {
    let encodings = headers.get_all(header::CONTENT_ENCODING).iter();
    encodings
        .map(|value| problem::clip(&String::from_utf8_lossy(value.as_bytes())))
        .find(|value| !value.is_empty() && !value.eq_ignore_ascii_case("identity"))
}

/// JSON answers are worth compressing; models and vertex buffers are not.
#[derive(Clone, Copy)]
struct JsonOnly;

impl Predicate for JsonOnly {
    fn should_compress<B: http_body::Body>(&self, response: &http::Response<B>) -> bool {
        let kind = response
            .headers()
            .get(header::CONTENT_TYPE)
            .and_then(|v| v.to_str().ok())
            .unwrap_or_default();
        let json = kind.starts_with("application/json");
        json && response.body().size_hint().exact().is_none_or(|bytes| bytes >= 1024)
    }
}
