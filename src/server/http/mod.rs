//! HTTP/1.1 and HTTP/2: JSON in and out, models and vertex buffers as bytes, problems as documents.
//!
//! The order of layers, outermost first: request number and count → what the door refused → problem documents → compression of
//! JSON → routes. Each call checks in the order authentication, session, then query and body.

mod animate;
mod body;
mod carry;
mod create;
mod docs;
mod download;
mod edits;
mod form_reader;
mod handles;
mod late_end;
mod models;
mod negotiate;
mod pages;
pub(super) mod problem;
mod query;
mod request;
mod route_table;
mod routes;
mod sessions;
mod solve;
mod upload_body;
mod viewer;

pub(super) use animate::OFFERS as ANIMATION_TYPES;
pub(super) use request::Caller;
pub(super) use route_table::{ROUTES, Route};

use super::redirect;
use super::state::State;
use super::telemetry::{self, Recorder};
use super::visitors::Refused;
use axum::Router;
use axum::body::Body;
use axum::extract::{MatchedPath, Request};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse as _, Response};
use futures::FutureExt as _;
use http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use late_end::UnreadRest;
use problem::Problem;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::Predicate;
use tracing::Instrument as _;

/// The number of a request; returned as it came.
pub(super) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// All HTTP routes over `state`.
pub(super) fn router(state: &State) -> Router {
    routes::all()
        .fallback(unknown_route)
        .method_not_allowed_fallback(wrong_method)
        .layer(CompressionLayer::new().gzip(true).compress_when(JsonOnly))
        .layer(middleware::from_fn_with_state(state.clone(), frame))
        .with_state(state.clone())
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

/// Numbers, counts and guards a call, and gives its problem document the path.
async fn frame(axum::extract::State(state): axum::extract::State<State>, mut request: Request, next: Next) -> Response {
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
    let mut recorder = Recorder::start(&state.telemetry, ("http", route), Arc::clone(&request_id), &request);

    let asked = (request.uri().clone(), request.headers().clone());
    if let Some(without) = redirect::without_node(&asked.0) {
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
            let (body, rest) = UnreadRest::of(body);
            unread = Some(rest);
            body
        }
    };
    let refused = request.extensions_mut().remove::<Refused>();
    let response = answer_call(&state, request, refused, next, &recorder).await;

    let mut response = match response.extensions().get::<Problem>().cloned() {
        // Allow and other headers that the route added stay.
        Some(mut problem) => {
            problem.send_to_owner(&asked.0, &asked.1);
            let mut told = problem.respond(Some(&path));
            for (name, value) in response.headers() {
                if !told.headers().contains_key(name)
                    && name != header::CONTENT_LENGTH
                    && name != header::CONTENT_ENCODING
                {
                    told.headers_mut().append(name.clone(), value.clone());
                }
            }
            told
        }
        None => response,
    };
    if let Ok(id) = HeaderValue::from_str(&request_id) {
        response.headers_mut().insert(REQUEST_ID, id);
    }
    let status = response.status();
    // What is damaged in the store has been told as that.
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

/// Answers a call, or refuses it before anything of its body is read.
async fn answer_call(
    state: &State,
    request: Request,
    refused: Option<Refused>,
    next: Next,
    recorder: &Recorder,
) -> Response {
    if let Some(Refused(error)) = refused {
        Problem::from(error).into_response()
    } else if let Some(encoding) = unread_encoding(request.headers()) {
        let told = format!("the content encoding \"{encoding}\" is not read; send the body as it is");
        Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "INVALID_ARGUMENT", told)
            .with_header(header::ACCEPT_ENCODING, "identity".into())
            .into_response()
    } else if state.draining.is_cancelled() && matches!(*request.method(), Method::POST | Method::PUT | Method::PATCH) {
        Problem::from(state.manager.leaving().await).into_response()
    } else {
        // A defect costs its call an answer of 500, not the connection.
        match AssertUnwindSafe(next.run(request))
            .catch_unwind()
            .instrument(recorder.span())
            .await
        {
            Ok(response) => response,
            Err(_panic) => Problem::internal("a call panicked").into_response(),
        }
    }
}

/// How a body is encoded that nothing here decodes.
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
