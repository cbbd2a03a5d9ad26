//! Sessions: list, describe, close; their commits; the limits.

use super::problem::Problem;
use super::query;
use super::request::{Caller, Names};
use crate::server::messages;
use crate::server::state::State;
use crate::session::{Error, SessionFacts};
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

/// The JSON answer that a session is.
pub(super) fn session_json(state: &State, session: &SessionFacts) -> Result<Response, Problem> {
    json(&messages::described_session(session, state.manager.config()))
}

pub(super) async fn list(From(state): From<State>, caller: Caller, uri: Uri) -> Result<Response, Problem> {
    let mut found = query::parameters(&uri, &["pageSize", "pageToken", "page_size", "page_token"])?;
    let mut take = |camel: &str, snake: &str| found.remove(camel).or_else(|| found.remove(snake));
    let page_size = match take("pageSize", "page_size") {
        None => 0,
        // Only a message has no other way to say nothing than 0.
        Some(text) => text.parse().ok().filter(|size| *size > 0).ok_or_else(|| {
            let seen = super::problem::clip(&text);
            Error::invalid("pageSize", format!("\"{seen}\" is not a whole number from 1 to 1000"))
        })?,
    };
    let page_token = take("pageToken", "page_token").unwrap_or_default();
    let page = wire::session_page(&pb::ListSessionsRequest { page_size, page_token })?;
    let list = state.manager.list(&caller.tenant, page).await?;
    json(&messages::session_list(&list, state.manager.config()))
}

pub(super) async fn get(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    session_json(&state, &state.manager.get(&caller.tenant, &id).await?)
}

pub(super) async fn delete(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    caller.manager(&state).delete(&caller.tenant, &id).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

pub(super) async fn undo(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    let session = caller.manager(&state).undo(&caller.tenant, &id, caller.key()?).await?;
    session_json(&state, &session)
}

pub(super) async fn redo(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    let session = caller.manager(&state).redo(&caller.tenant, &id, caller.key()?).await?;
    session_json(&state, &session)
}

pub(super) async fn history(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    json(&messages::history_message(
        state.manager.history(&caller.tenant, &id).await?,
    ))
}

pub(super) async fn limits(From(state): From<State>, caller: Caller) -> Result<Response, Problem> {
    let left = state.manager.quotas_left(&caller.tenant).await?;
    let longest = *state.manager.ttl_range(&caller.tenant)?.end();
    json(&messages::limits_left(state.manager.config(), &left, longest))
}
