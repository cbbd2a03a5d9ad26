//! Handles of a session: all at once, or one.

use super::problem::Problem;
use super::request::{Caller, Names};
use super::sessions::session_json;
use super::{body, problem};
use crate::server::state::State;
use crate::session::Error;
use crate::wire::{self, pb};
use axum::extract::{Request, State as From};
use axum::response::Response;
use prost::Message as _;

pub(super) async fn put(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
    request: Request,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    let mut handles: pb::SetHandlesRequest = body::message(&state, request).await?;
    body::same_session(&handles.session_id, &id)?;
    handles.session_id = id;
    let key = caller.call_key(|| handles.encode_to_vec())?;
    let set = wire::handle_set(&handles)?;
    let session = caller
        .manager(&state)
        .set_handles(&caller.tenant, &handles.session_id, set, key)
        .await?;
    session_json(&state, &session)
}

pub(super) async fn patch(
    From(state): From<State>,
    caller: Caller,
    Names((id, handle_id)): Names<(String, String)>,
    request: Request,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    let text = body::text(&state, request).await?;
    let mut handle: pb::Handle = if text.is_empty() {
        pb::Handle::default()
    } else {
        wire::json::from_json(&text)?
    };
    if !handle.id.is_empty() && handle.id != handle_id {
        let shown = problem::clip(&handle.id);
        return Err(Error::invalid(
            "id",
            format!("is \"{shown}\", the path says \"{}\"", problem::clip(&handle_id)),
        )
        .into());
    }
    handle.id = handle_id;
    let fields = present(&text);
    let key = caller.call_key(|| [fields.join(",").as_bytes(), &handle.encode_to_vec()].concat())?;
    let patch = wire::handle_patch(&handle, &fields, &state.manager.handles(&caller.tenant, &id).await?)?;
    let session = caller
        .manager(&state)
        .put_handle(&caller.tenant, &id, patch, key)
        .await?;
    session_json(&state, &session)
}

pub(super) async fn delete(
    From(state): From<State>,
    caller: Caller,
    Names((id, handle_id)): Names<(String, String)>,
) -> Result<Response, Problem> {
    let (tenant, key) = (&caller.tenant, caller.key()?);
    let session = caller
        .manager(&state)
        .remove_handle(tenant, &id, &handle_id, key)
        .await?;
    session_json(&state, &session)
}

/// The names of the fields that a JSON object gives.
fn present(text: &[u8]) -> Vec<String> {
    match serde_json::from_slice(text) {
        Ok(serde_json::Value::Object(fields)) => fields.into_iter().map(|(name, _)| name).collect(),
        _ => Vec::new(),
    }
}
