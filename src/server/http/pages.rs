//! What is not a call of the schema: health, counts, the API description, the sample, and a page for people.

use super::create::built_in_model;
use super::download::Download;
use super::problem::Problem;
use super::query;
use super::request::Caller;
use crate::asset::sample::BuiltInModel;
use crate::server::state::State;
use crate::server::{openapi, sample};
use crate::session::{Error, ErrorCode};
use axum::extract::State as From;
use axum::response::{IntoResponse as _, Response};
use http::{HeaderMap, StatusCode, Uri, header};

/// The process lives.
pub(super) async fn alive() -> &'static str {
    "ok\n"
}

/// New work is taken.
pub(super) async fn ready(From(state): From<State>) -> Result<&'static str, Problem> {
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

pub(super) async fn metrics(From(state): From<State>, caller: Caller) -> Result<Response, Problem> {
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
    Ok(([(header::CONTENT_TYPE, kind)], state.telemetry.text()).into_response())
}

pub(super) async fn openapi() -> Result<Response, Problem> {
    let document = openapi::document()?;
    Ok(([(header::CONTENT_TYPE, "application/json")], document).into_response())
}

pub(super) async fn sample(_: Caller, uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    let name = query::parameters(&uri, &["name"])?.remove("name");
    let model = name.map_or(Ok(BuiltInModel::Creature), |name| built_in_model("name", &name))?;
    let bytes = sample::glb(model).await?;
    let etag = sample::etag(&bytes);
    let download = Download {
        bytes,
        media_type: crate::asset::Format::GLB.media_type(),
        etag,
        file_name: format!("{}.glb", model.name()),
    };
    download.respond(&headers)
}
