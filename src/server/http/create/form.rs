//! `multipart/form-data`: the part `model`, the part `options`, and companion files by their file names.

use super::options::Options;
use super::received::Received;
use super::upload_body::next_bytes;
use crate::asset::{FileSet, Format};
use crate::server::http::body;
use crate::server::http::problem::{Problem, clip};
use crate::server::state::State;
use crate::server::uploads::Held;
use crate::session::{Error, ErrorCode};
use axum::extract::Request;
use bytes::Bytes;
use http::header;
use multer::{Field, Multipart};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Companion files of one form.
const MAX_COMPANIONS: usize = 1000;

/// Receives a form.
pub(super) async fn receive(state: &State, request: Request, options: &mut Options) -> Result<Received, Problem> {
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
    if let Some(length) = body::announced(request.headers()) {
        // Headers of parts do not count, so the refusal of an announced length leaves them room.
        state.uploads.announce(length.saturating_sub(1 << 20))?;
    }
    // The reason why the body stopped, which the form's reader would hide behind an error of its own.
    let stopped: Arc<Mutex<Option<Problem>>> = Arc::default();
    let stream = request.into_body().into_data_stream();
    let chunks = futures::stream::unfold(
        (stream, state.clone(), Arc::clone(&stopped)),
        |(mut stream, state, stopped)| async move {
            let next = match next_bytes(&state, &mut stream).await {
                Ok(Some(bytes)) => Some(Ok(bytes)),
                Ok(None) => None,
                Err(problem) => {
                    *stopped.lock().unwrap_or_else(PoisonError::into_inner) = Some(problem);
                    Some(Err(std::io::Error::other("the body stopped")))
                }
            };
            next.map(|next| (next, (stream, state, stopped)))
        },
    );
    let mut form = Multipart::new(chunks, boundary);
    let reason = |error: multer::Error| {
        let told = stopped.lock().unwrap_or_else(PoisonError::into_inner).take();
        told.unwrap_or_else(|| Error::malformed(format!("the form is not readable: {error}")).into())
    };
    let mut parts = FormParts {
        held: state.uploads.hold(),
        model: None,
        by_type: None,
        options_seen: false,
        companions: BTreeMap::new(),
    };
    while let Some(field) = form.next_field().await.map_err(reason)? {
        parts.take(state, field, options, &reason).await?;
    }
    let Some((name, main)) = parts.model else {
        return Err(Error::malformed("the form has no part \"model\"").into());
    };
    if main.is_empty() {
        return Err(Error::malformed("the part \"model\" is empty").into());
    }
    options.format_by_type(parts.by_type);
    Ok(Received {
        files: FileSet {
            name,
            main,
            companions: parts.companions,
        },
        held: Some(parts.held),
    })
}

struct FormParts {
    held: Held,
    model: Option<(String, Bytes)>,
    by_type: Option<Format>,
    options_seen: bool,
    companions: BTreeMap<String, Bytes>,
}

impl FormParts {
    async fn take(
        &mut self,
        state: &State,
        mut field: Field<'_>,
        options: &mut Options,
        reason: &impl Fn(multer::Error) -> Problem,
    ) -> Result<(), Problem> {
        let part = field.name().unwrap_or_default().to_owned();
        let file = field.file_name().map(str::to_owned);
        let media_type = field.content_type().map(|m| m.essence_str().to_owned());
        let limit = if part == "options" {
            state.message_bytes
        } else {
            usize::MAX
        };
        let mut bytes = Vec::new();
        while let Some(chunk) = field.chunk().await.map_err(reason)? {
            self.held.grow(chunk.len())?;
            if chunk.len() > limit - bytes.len() {
                let text = format!("the part \"options\" has more than the {limit} bytes that are allowed");
                return Err(Error::new(ErrorCode::TooLarge, text).into());
            }
            bytes.extend_from_slice(&chunk);
        }
        match (part.as_str(), file) {
            ("model", file) => {
                self.by_type = media_type.as_deref().and_then(Format::from_media_type);
                let name = file.unwrap_or_else(|| "model".to_owned());
                if self.model.replace((name, Bytes::from(bytes))).is_some() {
                    return Err(Error::malformed("the form has two parts \"model\"").into());
                }
            }
            ("options", _) => {
                if std::mem::replace(&mut self.options_seen, true) {
                    return Err(Error::malformed("the form has two parts \"options\"").into());
                }
                options.take_part(&bytes)?;
            }
            (_, Some(uri)) if !uri.is_empty() => {
                if self.companions.len() >= MAX_COMPANIONS {
                    return Err(
                        Error::malformed(format!("the form has more than {MAX_COMPANIONS} companion files")).into(),
                    );
                }
                self.held.grow(uri.len())?;
                if self.companions.insert(uri.clone(), Bytes::from(bytes)).is_some() {
                    return Err(Error::malformed(format!("the form has two files \"{}\"", clip(&uri))).into());
                }
            }
            (other, _) => {
                let allowed = "model, options, and files with a file name";
                let text = format!("the form has a part \"{}\"; allowed are {allowed}", clip(other));
                return Err(Error::malformed(text).into());
            }
        }
        Ok(())
    }
}
