//! Edits of the topology; and what this version refuses by name.

use super::body;
use super::problem::Problem;
use super::request::{Caller, Names};
use super::sessions::json;
use crate::server::state::State;
use crate::session::{Error, ErrorCode};
use crate::wire::pb;
use axum::extract::{Request, State as From};
use axum::response::Response;

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
    json(&state.manager.edit(&caller.tenant, message, caller.key()?).await?)
}

pub(super) async fn animate(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    Err(Error::new(
        ErrorCode::Unimplemented,
        "animations are not implemented by this version",
    )
    .into())
}
