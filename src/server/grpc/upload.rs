//! The CreateSession stream: options, then the model's bytes, then companions.

use super::status::{inbound_message, status};
use crate::asset::FileSet;
use crate::server::state::State;
use crate::server::upload_pace::UploadPace;
use crate::server::uploads::Held;
use crate::session::{Error, Tenant};
use crate::wire::pb::{self, create_session_request::Message};
use bytes::Bytes;
use prost::Message as _;
use std::collections::BTreeMap;
use tonic::{Status, Streaming};

/// Companion files of one model.
const MAX_COMPANIONS: usize = 1000;

/// A received upload. The bytes count as under way until it is dropped.
pub(super) struct Upload {
    pub files: FileSet,
    pub options: pb::CreateOptions,
    pub held: Held,
}

/// Receives the stream to its end; refuses it as soon as it breaks a rule or a limit.
///
/// # Cancel safety
/// Dropping it gives back what was received.
pub(super) async fn receive(
    state: &State,
    tenant: &Tenant,
    mut inbound: Streaming<pb::CreateSessionRequest>,
) -> Result<Upload, Status> {
    let mut parts = UploadParts {
        held: state.hold_upload(tenant, None).map_err(status)?,
        main: Vec::new(),
        options: None,
        companions: BTreeMap::new(),
        current: None,
        messages: 0,
    };
    let mut pace = UploadPace::new(&state.config);
    loop {
        let message = tokio::select! {
            message = tokio::time::timeout_at(pace.due(), inbound_message(&mut inbound)) => message,
            () = state.draining.cancelled() => return Err(status(Error::draining())),
        };
        match message {
            Ok(Ok(Some(request))) => {
                pace.take(request.encoded_len());
                parts.take(request).map_err(status)?;
            }
            Ok(Ok(None)) => return Ok(parts.finish()),
            Ok(Err(broken)) => return Err(broken),
            Err(_) => return Err(status(pace.late())),
        }
    }
}

struct UploadParts {
    held: Held,
    main: Vec<u8>,
    options: Option<pb::CreateOptions>,
    companions: BTreeMap<String, Vec<u8>>,
    current: Option<String>,
    messages: u64,
}

impl UploadParts {
    fn take(&mut self, request: pb::CreateSessionRequest) -> Result<(), Error> {
        let first = self.messages == 0;
        self.messages += 1;
        match request.message {
            Some(Message::Options(options)) if first => {
                self.options = Some(options);
                Ok(())
            }
            Some(Message::Options(_)) => Err(Error::invalid("options", "come as the first message only, and once")),
            Some(Message::Chunk(chunk)) => {
                self.held.grow(chunk.len())?;
                let file = match &self.current {
                    Some(uri) => self.companions.entry(uri.clone()).or_default(),
                    None => &mut self.main,
                };
                file.extend_from_slice(&chunk);
                Ok(())
            }
            Some(Message::Companion(companion)) => {
                if companion.uri.is_empty() {
                    return Err(Error::invalid(
                        "companion.uri",
                        "is empty; give the URI by which the model names the file",
                    ));
                }
                if self.companions.len() >= MAX_COMPANIONS {
                    return Err(Error::invalid(
                        "companion",
                        format!("more than {MAX_COMPANIONS} companion files"),
                    ));
                }
                self.held.grow(companion.uri.len())?;
                if self.companions.insert(companion.uri.clone(), Vec::new()).is_some() {
                    let shown: String = companion.uri.chars().take(100).collect();
                    return Err(Error::invalid(
                        "companion.uri",
                        format!("\"{shown}\" came before; every file comes once"),
                    ));
                }
                self.current = Some(companion.uri);
                Ok(())
            }
            None => Err(Error::invalid(
                "message",
                "is empty; allowed are options, chunk and companion",
            )),
        }
    }

    fn finish(self) -> Upload {
        let companions = self
            .companions
            .into_iter()
            .map(|(uri, bytes)| (uri, Bytes::from(bytes)))
            .collect();
        let files = FileSet {
            name: "upload".into(),
            main: Bytes::from(self.main),
            companions,
        };
        Upload {
            files,
            options: self.options.unwrap_or_default(),
            held: self.held,
        }
    }
}
