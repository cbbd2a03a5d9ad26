//! The bytes of an upload as they arrive, and the parts of a `multipart/form-data` body.

use super::body;
use super::problem::Problem;
use crate::auth;
use crate::state::ServerState;
use crate::uploads::{HeldUpload, UploadPace};
use axum::extract::Request;
use bytes::Bytes;
use futures::StreamExt as _;
use http::{StatusCode, header};
use multer::{Field, Multipart};
use pliant_session::{Error, ErrorCode};
use std::sync::{Arc, Mutex, PoisonError};

/// The next bytes of an upload; gives up when they come too slowly, and when the server is asked to stop.
pub(super) async fn next_bytes(
    state: &ServerState,
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

/// Reads a form part by part.
pub(super) struct FormReader {
    form: Multipart<'static>,
    /// The reason why the body stopped, which the form's reader would hide behind an error of its own.
    stopped: Arc<Mutex<Option<Problem>>>,
}

impl FormReader {
    /// Starts the upload that a form is; rejects an announced length that is too large. Headers of parts do not count, so that the
    /// refusal leaves them room.
    pub fn hold_upload(state: &ServerState, request: &Request) -> Result<HeldUpload, Problem> {
        let tenant = &auth::principal(request.extensions())?.tenant;
        let announced = body::announced(request.headers()).map(|length| length.saturating_sub(1 << 20));
        Ok(state.hold_upload(tenant, announced)?)
    }

    /// A reader of the body.
    pub fn of_request(state: &ServerState, request: Request) -> Result<Self, Problem> {
        let content_type = request
            .headers()
            .get(header::CONTENT_TYPE)
            .and_then(|v| v.to_str().ok())
            .unwrap_or_default();
        let boundary = multer::parse_boundary(content_type).map_err(|_| {
            Problem::from(Error::malformed(
                "the content type multipart/form-data names no boundary",
            ))
        })?;
        let stopped: Arc<Mutex<Option<Problem>>> = Arc::default();
        let stream = request.into_body().into_data_stream();
        let chunks = futures::stream::unfold(
            (
                stream,
                state.clone(),
                Arc::clone(&stopped),
                UploadPace::new(&state.config),
            ),
            |(mut stream, state, stopped, mut pace)| async move {
                let next = match next_bytes(&state, &mut stream, &mut pace).await {
                    Ok(Some(bytes)) => Some(Ok(bytes)),
                    Ok(None) => None,
                    Err(problem) => {
                        *stopped.lock().unwrap_or_else(PoisonError::into_inner) = Some(problem);
                        Some(Err(std::io::Error::other("the body stopped")))
                    }
                };
                next.map(|next| (next, (stream, state, stopped, pace)))
            },
        );
        Ok(Self {
            form: Multipart::new(chunks, boundary),
            stopped,
        })
    }

    /// The next part; `None` after the last.
    pub async fn next_field(&mut self) -> Result<Option<Field<'static>>, Problem> {
        match self.form.next_field().await {
            Ok(field) => Ok(field),
            Err(error) => Err(self.why_unreadable(&error)),
        }
    }

    /// All bytes of a part, at most `limit`; `count` is called with each piece before it is stored.
    pub async fn field_bytes(
        &self,
        field: &mut Field<'_>,
        limit: usize,
        mut count: impl FnMut(usize) -> Result<(), Error>,
    ) -> Result<Vec<u8>, Problem> {
        let part = super::problem::clip(field.name().unwrap_or_default());
        let mut bytes = Vec::new();
        while let Some(chunk) = field.chunk().await.map_err(|e| self.why_unreadable(&e))? {
            count(chunk.len())?;
            if chunk.len() > limit - bytes.len() {
                let text = format!("the part \"{part}\" has more than the {limit} bytes that are allowed");
                return Err(Error::new(ErrorCode::TooLarge, text).into());
            }
            bytes.extend_from_slice(&chunk);
        }
        Ok(bytes)
    }

    fn why_unreadable(&self, error: &multer::Error) -> Problem {
        let stopped = self.stopped.lock().unwrap_or_else(PoisonError::into_inner).take();
        stopped.unwrap_or_else(|| Error::malformed(format!("the form is not readable: {error}")).into())
    }
}
