//! The bytes of an upload as they arrive.

use crate::server::http::body;
use crate::server::http::problem::Problem;
use crate::server::state::State;
use crate::session::Error;
use bytes::Bytes;

/// The next bytes of an upload; gives up when the server is asked to stop.
pub(super) async fn next_bytes(
    state: &State,
    stream: &mut axum::body::BodyDataStream,
) -> Result<Option<Bytes>, Problem> {
    tokio::select! {
        bytes = body::next(state, stream) => bytes,
        () = state.draining.cancelled() => Err(Error::draining().into()),
    }
}
