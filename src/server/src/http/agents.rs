//! `POST /mcp`: the Model Context Protocol, with the tools of pliant-mcp. A call may bring a model, so its body counts as an upload.

use super::body;
use super::problem::Problem;
use super::request::Caller;
use super::upload::next_bytes;
use crate::state::ServerState;
use crate::uploads::UploadPace;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::response::Response;
use bytes::{Bytes, BytesMut};
use http_body_util::Full;

pub(super) async fn call(
    State(state): State<ServerState>,
    caller: Caller,
    request: Request,
) -> Result<Response, Problem> {
    let mut held = state.hold_upload(&caller.tenant, body::announced(request.headers()))?;
    let (mut parts, unread) = request.into_parts();
    let mut stream = unread.into_data_stream();
    let mut pace = UploadPace::new(&state.config);
    let mut text = BytesMut::new();
    while let Some(bytes) = next_bytes(&state, &mut stream, &mut pace).await? {
        held.grow(bytes.len())?;
        text.extend_from_slice(&bytes);
    }
    parts.extensions.insert(caller.agent());
    let whole: Full<Bytes> = text.freeze().into();
    let answer = state.agents.answer(http::Request::from_parts(parts, whole)).await;
    // What came counts until it has been answered.
    drop(held);
    Ok(answer.map(Body::new))
}
