//! Sessions: list, describe, close; their commits; the limits.

use super::problem::Problem;
use super::query;
use super::request::{Caller, Names};
use crate::server::state::State;
use crate::session::Error;
use crate::wire;
use crate::wire::pb;
use axum::Json;
use axum::extract::State as From;
use axum::response::{IntoResponse as _, Response};
use http::{StatusCode, Uri};
use prost::Message;

/// The JSON answer that a message is.
pub(super) fn json<M: Message + prost::Name>(message: &M) -> Result<Response, Problem> {
    Ok(Json(wire::json::to_json(message)?).into_response())
}

pub(super) async fn list(From(state): From<State>, caller: Caller, uri: Uri) -> Result<Response, Problem> {
    let mut found = query::parameters(&uri, &["pageSize", "pageToken", "page_size", "page_token"])?;
    let mut take = |camel: &str, snake: &str| found.remove(camel).or_else(|| found.remove(snake));
    let page_size = match take("pageSize", "page_size") {
        None => 0,
        Some(text) => text.parse().map_err(|_| {
            Error::invalid(
                "pageSize",
                format!(
                    "\"{}\" is not a whole number from 1 to 1000",
                    super::problem::clip(&text)
                ),
            )
        })?,
    };
    let page_token = take("pageToken", "page_token").unwrap_or_default();
    json(
        &state
            .manager
            .list(&caller.tenant, pb::ListSessionsRequest { page_size, page_token })
            .await?,
    )
}

pub(super) async fn get(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    json(&state.manager.get(&caller.tenant, &id).await?)
}

pub(super) async fn delete(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    state.manager.delete(&caller.tenant, &id).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

pub(super) async fn undo(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    json(&state.manager.undo(&caller.tenant, &id, caller.key()?).await?)
}

pub(super) async fn redo(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    json(&state.manager.redo(&caller.tenant, &id, caller.key()?).await?)
}

pub(super) async fn history(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    json(&state.manager.history(&caller.tenant, &id).await?)
}

pub(super) async fn limits(From(state): From<State>, _: Caller) -> Result<Response, Problem> {
    json(&state.manager.limits())
}
