//! Answers of sessions as messages of the schema, and names of formats as callers write them.

use pliant_asset::Format;
use pliant_session::{Error, SessionConfig, SessionList};
use pliant_wire::{TransferOrder, page_token, pb};
use std::time::Duration;

/// A request about one session.
pub(super) trait NamesSession {
    /// The session's id.
    fn session_id(&self) -> &str;

    /// Replaces the id.
    fn set_session_id(&mut self, id: &str);
}

macro_rules! names_session {
    ($($request:ident),*) => {$(
        impl NamesSession for pb::$request {
            fn session_id(&self) -> &str {
                &self.session_id
            }

            fn set_session_id(&mut self, id: &str) {
                id.clone_into(&mut self.session_id);
            }
        }
    )*};
}

names_session!(
    SetHandlesRequest,
    SolveRequest,
    EditRequest,
    CarryRequest,
    CrossingsRequest,
    MakeRigRequest,
    TransferRequest
);

/// Reads a request for a transfer.
pub(super) fn transfer_order(request: &pb::TransferRequest) -> Result<TransferOrder, Error> {
    let format = match request.output.as_str() {
        "" => None,
        name => Some(parse_format_name("output", name)?),
    };
    Ok(pliant_wire::transfer_order(request, format)?)
}

/// A session as its owner sees it, with the limits of the server.
pub(super) fn described_session(mut session: pb::Session, config: &SessionConfig) -> pb::Session {
    session.limits = Some(limits_message(config));
    session
}

/// Writes a page of sessions.
pub(super) fn session_list(list: SessionList, config: &SessionConfig) -> pb::ListSessionsResponse {
    pb::ListSessionsResponse {
        sessions: list
            .sessions
            .into_iter()
            .map(|s| described_session(s, config))
            .collect(),
        next_page_token: list.next_after.map(page_token).unwrap_or_default(),
    }
}

/// Writes the limits for clients.
pub(super) fn limits_message(config: &SessionConfig) -> pb::Limits {
    let narrow = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    pb::Limits {
        upload_bytes: config.upload_bytes,
        vertices: config.vertices,
        sessions: config.sessions as u64,
        memory_bytes: config.memory_bytes,
        handles: narrow(config.handles),
        message_bytes: config.message_bytes,
        window: config.window,
        part_bytes: config.part_bytes as u64,
        ttl_seconds: config.max_ttl.as_secs_f64(),
        history: narrow(config.history),
        solve_ms: config.solve.as_secs_f64() * 1e3,
        streams: narrow(config.streams),
        animations: narrow(config.animations),
        clip_bytes: config.clip_bytes,
        clip_joints: narrow(config.clip_joints),
        animation_frames: narrow(config.animation_frames),
        animation_vertices: config.animation_vertices,
        quotas: None,
    }
}

/// Writes the limits with what a tenant may use of them, and what is left; `max_ttl` is the longest time that its sessions may name.
pub(super) fn limits_left(config: &SessionConfig, quotas: pb::Quotas, max_ttl: Duration) -> pb::Limits {
    pb::Limits {
        quotas: Some(quotas).filter(|quotas| *quotas != pb::Quotas::default()),
        ttl_seconds: max_ttl.as_secs_f64(),
        ..limits_message(config)
    }
}

/// Reads the name of a format that results can be had in.
///
/// # Errors
/// `INVALID_ARGUMENT` on `field`, with the names that are allowed.
pub(super) fn parse_format_name(field: &str, name: &str) -> Result<Format, Error> {
    let format = Format::from_name(name).ok_or_else(|| {
        let names = Format::name_list("and");
        let shown: String = name.chars().take(64).collect();
        Error::invalid(field, format!("\"{shown}\" is not a format; allowed are {names}"))
    })?;
    match format.refusal_to_write() {
        Some(problem) => Err(Error::invalid(field, problem)),
        None => Ok(format),
    }
}
