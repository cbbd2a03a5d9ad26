//! Edits of the topology.

use super::body;
use super::problem::Problem;
use super::request::{Caller, Names};
use super::sessions::json;
use crate::server::messages;
use crate::server::state::State;
use crate::wire::{self, pb};
use axum::extract::{Request, State as From};
use axum::response::Response;
use prost::Message as _;

pub(super) async fn edit(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
    request: Request,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    let mut message: pb::EditRequest = body::message(&state, request).await?;
    body::same_session(&message.session_id, &id)?;
    message.session_id = id;
    let key = caller.call_key(|| message.encode_to_vec())?;
    let edit = wire::session_edit(&message)?;
    let done = caller
        .manager(&state)
        .edit(&caller.tenant, &message.session_id, edit, key)
        .await?;
    json(&messages::committed_edit(done))
}
