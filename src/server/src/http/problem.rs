//! Failures over HTTP: problem documents (RFC 9457) with the same codes as gRPC.

use crate::redirect;
use axum::body::Body;
use axum::response::{IntoResponse, Response};
use http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use pliant_session::OwnerAddress;
use serde_json::json;

/// The media type of a problem document.
pub(crate) const PROBLEM_JSON: &str = "application/problem+json";

/// A failure, ready to be sent.
#[derive(Debug, Clone)]
pub(crate) struct Problem {
    status: StatusCode,
    code: &'static str,
    detail: String,
    field: Option<String>,
    headers: Vec<(HeaderName, String)>,
    /// The node to ask instead.
    owner: Option<Box<OwnerAddress>>,
}

impl Problem {
    /// A problem that only HTTP knows, such as a wrong method.
    pub fn new(status: StatusCode, code: &'static str, detail: impl Into<String>) -> Self {
        Self {
            status,
            code,
            detail: detail.into(),
            field: None,
            headers: Vec::new(),
            owner: None,
        }
    }

    /// A defect of the server; `what` is for its log.
    pub fn internal(what: &str) -> Self {
        tracing::error!("internal: {what}");
        pliant_session::Error::new(
            pliant_session::ErrorCode::Internal,
            "a defect of the server; its log says more",
        )
        .into()
    }

    /// The body is of a type that this path does not take.
    pub fn media_type(seen: &str, allowed: &str) -> Self {
        let detail = if seen.is_empty() {
            format!("the content type is missing; allowed are {allowed}")
        } else {
            format!(
                "the content type \"{}\" is not accepted here; allowed are {allowed}",
                clip(seen)
            )
        };
        Self::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "INVALID_ARGUMENT", detail)
    }

    /// Adds a header to the answer.
    pub fn with_header(mut self, name: HeaderName, value: String) -> Self {
        self.headers.push((name, value));
        self
    }

    /// Redirects a call of `uri` to the node that has the session, unless the client goes there itself.
    pub fn send_to_owner(&mut self, uri: &Uri, headers: &HeaderMap) {
        let Some(owner) = &self.owner else { return };
        if !redirect::follows_by_itself(headers) {
            self.status = StatusCode::TEMPORARY_REDIRECT;
            self.headers.push((header::LOCATION, redirect::location(owner, uri)));
        }
    }

    /// Whether it reports damage in the store, not a failure of the server.
    pub fn is_data_loss(&self) -> bool {
        self.code == pliant_session::ErrorCode::DataLoss.name()
    }

    fn document(&self, instance: Option<&str>) -> serde_json::Value {
        let words = self.code.to_ascii_lowercase();
        let mut document = json!({
            "type": format!("urn:pliant:problem:{}", words.replace('_', "-")),
            "title": words.replace('_', " "),
            "status": self.status.as_u16(),
            "detail": self.detail,
            "code": self.code,
        });
        if let Some(instance) = instance {
            document["instance"] = instance.into();
        }
        if let Some(field) = &self.field {
            let problem = self
                .detail
                .strip_prefix(field.as_str())
                .and_then(|d| d.strip_prefix(": "))
                .unwrap_or(&self.detail);
            document["errors"] = json!([{ "field": field, "problem": problem }]);
        }
        document
    }

    /// The answer; `instance` is the path that was asked for.
    pub fn respond(self, instance: Option<&str>) -> Response {
        let text = self.document(instance).to_string();
        let mut response = Response::new(Body::from(text));
        *response.status_mut() = self.status;
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        for (name, value) in &self.headers {
            if let Ok(value) = HeaderValue::from_str(value) {
                headers.insert(name.clone(), value);
            }
        }
        response.extensions_mut().insert(self);
        response
    }
}

/// At most 100 characters of a text that came from outside.
pub(crate) fn clip(text: &str) -> String {
    let mut clipped: String = text.chars().take(100).collect();
    if clipped.len() < text.len() {
        clipped.push('…');
    }
    clipped
}

impl From<pliant_session::Error> for Problem {
    fn from(error: pliant_session::Error) -> Self {
        let status = StatusCode::from_u16(error.http_status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let mut problem = Self::new(status, error.code_name(), error.message);
        problem.field = error.field;
        if let Some(owner) = error.owner {
            let headers = [(redirect::OWNER, &owner.address), (redirect::NODE, &owner.node)];
            problem
                .headers
                .extend(headers.map(|(name, value)| (HeaderName::from_static(name), value.clone())));
            problem.owner = Some(owner);
        }
        if status == StatusCode::UNAUTHORIZED {
            problem
                .headers
                .push((header::WWW_AUTHENTICATE, "Bearer realm=\"pliant\"".into()));
        }
        // An overloaded or leaving server always says when to come back.
        let waits = matches!(status, StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE);
        if let Some(seconds) = error.retry_after_s.or(waits.then_some(1)) {
            problem.headers.push((header::RETRY_AFTER, seconds.max(1).to_string()));
        }
        problem
    }
}

impl From<pliant_wire::Error> for Problem {
    fn from(error: pliant_wire::Error) -> Self {
        pliant_session::Error::from(error).into()
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        self.respond(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_session::{Error, ErrorCode};

    #[test]
    fn a_problem_names_field_and_code() {
        let problem = Problem::from(Error::invalid("handles[1].pose.scale", "is [0], above 0 is allowed"));
        assert_eq!(
            problem.document(Some("/v1/sessions/x/handles")),
            json!({
                "type": "urn:pliant:problem:invalid-argument", "title": "invalid argument", "status": 422,
                "detail": "handles[1].pose.scale: is [0], above 0 is allowed", "code": "INVALID_ARGUMENT",
                "instance": "/v1/sessions/x/handles",
                "errors": [{"field": "handles[1].pose.scale", "problem": "is [0], above 0 is allowed"}],
            })
        );
    }

    #[test]
    fn overload_always_says_when_to_come_back() {
        for error in [
            Error::new(ErrorCode::ResourceExhausted, "full"),
            Error::new(ErrorCode::Unavailable, "leaving"),
        ] {
            let response = Problem::from(error).into_response();
            assert_eq!(response.headers()[header::RETRY_AFTER], "1");
        }
        let response = Problem::from(Error::exhausted("full", 7)).into_response();
        assert_eq!(response.headers()[header::RETRY_AFTER], "7");
        let response = Problem::from(Error::new(ErrorCode::TooLarge, "huge")).into_response();
        assert_eq!(response.status(), StatusCode::PAYLOAD_TOO_LARGE);
        assert!(!response.headers().contains_key(header::RETRY_AFTER));
    }
}
