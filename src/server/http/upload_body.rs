//! The bytes of an upload as they arrive.

use crate::server::http::problem::Problem;
use crate::server::state::State;
use crate::server::upload_pace::UploadPace;
use crate::session::Error;
use bytes::Bytes;
use futures::StreamExt as _;
use http::StatusCode;

/// The next bytes of an upload; gives up when they come too slowly, and when the server is asked to stop.
pub(super) async fn next_bytes(
    state: &State,
    stream: &mut axum::body::BodyDataStream,
    pace: &mut UploadPace,
) -> Result<Option<Bytes>, Problem> {
    let next = tokio::select! {
        next = tokio::time::timeout_at(pace.due(), stream.next()) => next,
        () = state.draining.cancelled() => return Err(Error::draining().into()),
    };
    match next {
        Ok(None) => Ok(None),
        Ok(Some(Ok(bytes))) => {
            pace.take(bytes.len());
            Ok(Some(bytes))
        }
        Ok(Some(Err(_))) => Err(Error::malformed("the body broke off").into()),
        Err(_) => {
            let late = pace.late();
            let timed_out = StatusCode::REQUEST_TIMEOUT;
            Err(Problem::new(timed_out, "DEADLINE_EXCEEDED", late.message))
        }
    }
}
