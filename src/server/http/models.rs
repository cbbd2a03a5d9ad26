//! The model in its current shape, and its vertex buffer, for download.

use super::download::{self, Download};
use super::problem::{Problem, clip};
use super::query;
use super::request::{Caller, Names};
use crate::asset::FollowedCounts;
use crate::server::format_name::parse_format_name;
use crate::server::state::State;
use crate::session::{Error, ExportedModel};
use axum::extract::State as From;
use axum::response::Response;
use bytes::Bytes;
use http::{HeaderMap, HeaderName, HeaderValue, Uri, header};
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};
use xxhash_rust::xxh3::xxh3_64;

/// Says what followed the shape of an exported model.
const FOLLOWED: HeaderName = HeaderName::from_static("x-pliant-followed");

/// `GET …/model`. A glTF file with external buffers is the main file with a `Link` header for every companion; with
/// `?uri=` it is that companion.
pub(super) async fn model(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    let mut found = query::parameters(&uri, &["format", "uri"])?;
    let format = found.remove("format").map(|name| parse_format_name("format", &name));
    let format = format.transpose()?;
    let wanted = found.remove("uri").filter(|uri| !uri.is_empty());
    if wanted.is_none() && headers.contains_key(header::IF_NONE_MATCH) {
        let etag = state.manager.export_etag(&caller.tenant, &id, format).await?;
        if let Some(response) = download::unchanged(&etag, &headers) {
            return Ok(response);
        }
    }
    let exported = caller.manager(&state).export(&caller.tenant, &id, format).await?;
    match wanted {
        None => main_file(&id, exported, &headers),
        Some(uri) => companion(exported, &uri, &headers),
    }
}

/// The main file of an export.
pub(super) fn main_file(id: &str, exported: ExportedModel, headers: &HeaderMap) -> Result<Response, Problem> {
    let ExportedModel { written, format, etag } = exported;
    let file_name = format!("{id}.{format}");
    let download = Download {
        bytes: Bytes::from(written.main),
        media_type: format.media_type(),
        etag,
        file_name,
    };
    let mut response = download.respond(headers)?;
    if let Some(text) = followed_text(&written.followed)
        && let Ok(value) = HeaderValue::from_str(&text)
    {
        response.headers_mut().insert(FOLLOWED, value);
    }
    for uri in written.companions.keys() {
        let target = utf8_percent_encode(uri, NON_ALPHANUMERIC);
        if let Ok(link) = HeaderValue::from_str(&format!(
            "</v1/sessions/{id}/model?format={format}&uri={target}>; rel=\"item\""
        )) {
            response.headers_mut().append(header::LINK, link);
        }
    }
    Ok(response)
}

/// What followed the shape, in numbers; `None` where the file holds nothing of the kind.
fn followed_text(counts: &FollowedCounts) -> Option<String> {
    (!counts.is_none()).then(|| {
        format!(
            "joints={}/{}, clips={}/{}, morph-targets={}/{}, passengers={}/{}, passenger-nodes={}/{}",
            counts.moved_joints,
            counts.joints,
            counts.rewritten_clips,
            counts.clips,
            counts.carried_morph_targets,
            counts.morph_targets,
            counts.moved_passengers,
            counts.passengers,
            counts.moved_passenger_nodes,
            counts.passenger_nodes
        )
    })
}

fn companion(exported: ExportedModel, uri: &str, headers: &HeaderMap) -> Result<Response, Problem> {
    let ExportedModel {
        mut written,
        format,
        etag,
    } = exported;
    let Some(bytes) = written.companions.remove(uri) else {
        let known: Vec<&str> = written.companions.keys().map(String::as_str).collect();
        let list = if known.is_empty() {
            format!("this {format} file has none")
        } else {
            format!("there are {}", clip(&known.join(", ")))
        };
        return Err(Error::invalid("uri", format!("\"{}\" names no companion file; {list}", clip(uri))).into());
    };
    let etag = format!("\"{}-{:016x}\"", etag.trim_matches('"'), xxh3_64(uri.as_bytes()));
    let file_name = uri.rsplit('/').next().unwrap_or(uri).to_owned();
    Download {
        bytes: Bytes::from(bytes),
        media_type: "application/octet-stream",
        etag,
        file_name,
    }
    .respond(headers)
}

/// `GET …/positions`: little-endian x, y, z per render vertex.
pub(super) async fn positions(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    query::parameters(&uri, &[])?;
    let positions = caller.manager(&state).positions(&caller.tenant, &id).await?;
    let file_name = format!("{id}.f32");
    let download = Download {
        bytes: positions.bytes,
        media_type: "application/octet-stream",
        etag: positions.etag,
        file_name,
    };
    download.respond(&headers)
}
