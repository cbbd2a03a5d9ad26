//! `multipart/form-data`: the part `model`, the part `options`, and companion files by their file names.

use super::options::Options;
use super::received::Received;
use crate::asset::{FileSet, Format};
use crate::server::http::form_reader::FormReader;
use crate::server::http::problem::{Problem, clip};
use crate::server::state::State;
use crate::server::uploads::Held;
use crate::session::Error;
use axum::extract::Request;
use bytes::Bytes;
use multer::Field;
use std::collections::BTreeMap;

/// Companion files of one form.
const MAX_COMPANIONS: usize = 1000;

/// Receives a form.
pub(super) async fn receive(state: &State, request: Request, options: &mut Options) -> Result<Received, Problem> {
    let held = FormReader::hold_upload(state, &request)?;
    let mut form = FormReader::of_request(state, request)?;
    let mut parts = ModelForm {
        held,
        model: None,
        by_type: None,
        options_seen: false,
        companions: BTreeMap::new(),
    };
    while let Some(field) = form.next_field().await? {
        parts.take(state, &form, field, options).await?;
    }
    let Some((name, main)) = parts.model else {
        let file = parts.companions.keys().next().map_or_else(String::new, |file| {
            format!(
                "; the file \"{}\" came in a part of another name, which files beside the model do",
                clip(file)
            )
        });
        return Err(Error::malformed(format!("the form has no part \"model\"{file}")).into());
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

struct ModelForm {
    held: Held,
    model: Option<(String, Bytes)>,
    by_type: Option<Format>,
    options_seen: bool,
    companions: BTreeMap<String, Bytes>,
}

impl ModelForm {
    async fn take(
        &mut self,
        state: &State,
        form: &FormReader,
        mut field: Field<'static>,
        options: &mut Options,
    ) -> Result<(), Problem> {
        let part = field.name().unwrap_or_default().to_owned();
        let file = field.file_name().map(str::to_owned);
        let media_type = field.content_type().map(|m| m.essence_str().to_owned());
        let limit = if part == "options" {
            state.message_bytes
        } else {
            usize::MAX
        };
        let bytes = form
            .field_bytes(&mut field, limit, |count| self.held.grow(count))
            .await?;
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
