//! Parts of the contract that this version reads and refuses by name.

use super::body;
use super::problem::Problem;
use super::request::{Caller, Names};
use crate::job::pb;
use crate::server::edits;
use crate::server::state::State;
use crate::session::{Code, Error};
use axum::extract::{Request, State as From};
use axum::response::Response;

pub(super) async fn edit(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
    request: Request,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    let message: pb::EditRequest = body::message(&state, request).await?;
    body::same_session(&message.session_id, &id)?;
    Err(edits::refusal(&message).into())
}

pub(super) async fn animate(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    Err(Error::new(Code::Unimplemented, "animations are not implemented by this version").into())
}
