//! Points, and a model, carried along with the current shape.

use super::body;
use super::problem::Problem;
use super::request::{Caller, Names};
use super::sessions::json;
use crate::server::messages;
use crate::server::state::State;
use crate::wire::{self, pb};
use axum::extract::{Request, State as From};
use axum::response::Response;

pub(super) async fn carry(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
    request: Request,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    let message: pb::CarryRequest = body::message(&state, request).await?;
    body::same_session(&message.session_id, &id)?;
    let order = wire::carry_order(&message)?;
    json(&messages::carried_message(
        caller.manager(&state).carry(&caller.tenant, &id, order).await?,
    ))
}
