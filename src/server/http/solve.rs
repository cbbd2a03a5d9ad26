//! One pose, solved and committed: as JSON, as a vertex buffer, or as the deformed model.

use super::problem::Problem;
use super::request::{Caller, Names};
use super::{body, models, negotiate};
use crate::asset::Format;
use crate::server::state::State;
use crate::session::{CommittedPose, Error, ErrorCode};
use crate::wire::frames::{Frame, encode};
use crate::wire::{self, pb};
use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State as From};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use prost::Message as _;
use std::convert::Infallible;

const JSON: &str = "application/json";
const BUFFER: &str = "application/octet-stream";

/// What an answer can be: JSON, the buffer, then the model in every format.
fn offers() -> Vec<&'static str> {
    let models = Format::ALL.into_iter().map(Format::media_type);
    [JSON, BUFFER].into_iter().chain(models).collect()
}

pub(super) async fn solve(
    From(state): From<State>,
    caller: Caller,
    Names(id): Names<String>,
    request: Request,
) -> Result<Response, Problem> {
    state.manager.get(&caller.tenant, &id).await?;
    let offers = offers();
    let accept = request.headers().get(header::ACCEPT).and_then(|v| v.to_str().ok());
    let Some(offer) = negotiate::choose(accept, &offers).and_then(|k| offers.get(k).copied()) else {
        let detail = format!(
            "none of the types in Accept is offered; there are {}",
            offers.join(", ")
        );
        return Err(Problem::new(StatusCode::NOT_ACCEPTABLE, "INVALID_ARGUMENT", detail));
    };
    let mut message: pb::SolveRequest = body::message(&state, request).await?;
    body::same_session(&message.session_id, &id)?;
    if offer == BUFFER {
        whole_buffer(message.options.as_ref())?;
    }
    message.session_id = id.clone();
    let key = caller.call_key(|| message.encode_to_vec())?;
    let pose = wire::pose_commit(&message, state.manager.config().window)?;
    let solved = caller.manager(&state).solve(&caller.tenant, &id, pose, key).await?;
    let facts = facts(&solved);
    let mut response = match offer {
        JSON => as_json(solved).await?,
        BUFFER => as_buffer(frame_parts(solved.frame).await?),
        model => {
            let exported = caller
                .manager(&state)
                .export(&caller.tenant, &id, Format::from_media_type(model))
                .await?;
            models::main_file(&id, exported, &HeaderMap::new())?
        }
    };
    response.headers_mut().extend(facts);
    Ok(response)
}

/// The whole buffer is plain floats of every vertex; other forms need the frames that JSON carries.
fn whole_buffer(options: Option<&pb::Options>) -> Result<(), Error> {
    let Some(output) = options.and_then(|o| o.output.as_ref()) else {
        return Ok(());
    };
    if output.encoding() != pb::frame::Encoding::F32 {
        return Err(Error::invalid(
            "options.output.encoding",
            format!("only F32 comes as {BUFFER}; ask for {JSON}"),
        ));
    }
    if output.changed_only.is_some() {
        return Err(Error::invalid(
            "options.output.changedOnly",
            format!("a part of the vertices cannot come as {BUFFER}; ask for {JSON}"),
        ));
    }
    Ok(())
}

/// What is known of a solve, as headers, for the forms that cannot say it themselves.
fn facts(solved: &CommittedPose) -> HeaderMap {
    let mut headers = HeaderMap::new();
    let mut set = |name: &'static str, value: String| {
        if let Ok(value) = HeaderValue::from_str(&value) {
            headers.insert(HeaderName::from_static(name), value);
        }
    };
    set("x-pliant-revision", solved.revision.to_string());
    set("x-pliant-digest", solved.digest.clone());
    set("x-pliant-vertices", solved.frame.positions.len().to_string());
    let header = &solved.frame.header;
    set("x-pliant-residual", header.residual.to_string());
    set("x-pliant-max-error", header.max_error.to_string());
    set("x-pliant-solve-ms", header.solve_ms.to_string());
    set("x-pliant-queue-ms", header.queue_ms.to_string());
    if let Some(quality) = &header.quality {
        set("x-pliant-edge-rms", quality.edge_rms.to_string());
        set("x-pliant-volume-change", quality.volume_change.to_string());
        set("x-pliant-open-surface", quality.open_surface.to_string());
        set("x-pliant-area-change", quality.area_change.to_string());
        set("x-pliant-flipped-triangles", quality.flipped_triangles.to_string());
        set("x-pliant-max-stretch", quality.max_stretch.to_string());
        set("x-pliant-faces-too-large", quality.faces_too_large.to_string());
        if let Some(pairs) = quality.self_intersections {
            set("x-pliant-self-intersections", pairs.to_string());
        }
    }
    headers
}

/// All parts of a frame, encoded on a blocking thread.
async fn frame_parts(frame: Frame) -> Result<Vec<pb::Frame>, Problem> {
    let encoded = tokio::task::spawn_blocking(move || encode(frame).collect()).await;
    encoded.map_err(|_| Error::new(ErrorCode::Internal, "the frame cannot be encoded").into())
}

async fn as_json(solved: CommittedPose) -> Result<Response, Problem> {
    let frames = frame_parts(solved.frame).await?;
    let frames = frames.iter().map(wire::json::to_json).collect::<Result<Vec<_>, _>>()?;
    let answer = serde_json::json!({
        "frames": frames,
        // As proto-JSON writes 64-bit numbers.
        "revision": solved.revision.to_string(),
        "digest": solved.digest,
    });
    Ok(Json(answer).into_response())
}

fn as_buffer(mut frames: Vec<pb::Frame>) -> Response {
    // Positions, then normals, then tangents; parts of one attribute keep their order.
    frames.sort_by_key(|frame| (frame.attribute, frame.part));
    let parts: Vec<Bytes> = frames.into_iter().map(|frame| frame.data).collect();
    let bytes: usize = parts.iter().map(Bytes::len).sum();
    let body = Body::from_stream(futures::stream::iter(parts.into_iter().map(Ok::<_, Infallible>)));
    let mut response = Response::new(body);
    response
        .headers_mut()
        .insert(header::CONTENT_TYPE, HeaderValue::from_static(BUFFER));
    response
        .headers_mut()
        .insert(header::CONTENT_LENGTH, HeaderValue::from(bytes));
    response
}
