//! The parts of a `multipart/form-data` body as they arrive.

use super::body;
use super::problem::Problem;
use super::upload_body::next_bytes;
use crate::server::auth;
use crate::server::state::State;
use crate::server::upload_pace::UploadPace;
use crate::server::uploads::Held;
use crate::session::{Error, ErrorCode};
use axum::extract::Request;
use http::header;
use multer::{Field, Multipart};
use std::sync::{Arc, Mutex, PoisonError};

/// Reads a form part by part.
pub(super) struct FormReader {
    form: Multipart<'static>,
    /// The reason why the body stopped, which the form's reader would hide behind an error of its own.
    stopped: Arc<Mutex<Option<Problem>>>,
}

impl FormReader {
    /// Starts the upload that a form is; refuses an announced length that is too large. Headers of parts do not count, so that the
    /// refusal leaves them room.
    pub fn hold_upload(state: &State, request: &Request) -> Result<Held, Problem> {
        let tenant = &auth::principal(request.extensions())?.tenant;
        let announced = body::announced(request.headers()).map(|length| length.saturating_sub(1 << 20));
        Ok(state.hold_upload(tenant, announced)?)
    }

    /// A reader of the body.
    pub fn of_request(state: &State, request: Request) -> Result<Self, Problem> {
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

    /// All bytes of a part, at most `limit`; `count` hears of each piece before it is kept.
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
        let told = self.stopped.lock().unwrap_or_else(PoisonError::into_inner).take();
        told.unwrap_or_else(|| Error::malformed(format!("the form is not readable: {error}")).into())
    }
}
