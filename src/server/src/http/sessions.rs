//! The calls on sessions that answer with JSON; a solve, which may answer with a vertex buffer or the deformed model; and a clip that
//! drives a session's model, as frames in a row or as a GLB that plays it.

use super::problem::{Problem, clip};
use super::request::{Caller, SessionCall, negotiate, parameters};
use super::upload::FormReader;
use super::{body, models};
use crate::messages;
use crate::state::ServerState;
use crate::stream_messages::AnimationFrames;
use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use pliant_asset::Format;
use pliant_session::{AnimatedModel, CommittedPose, Error, ErrorCode};
use pliant_wire::frames::{Frame, encode};
use pliant_wire::pb::animate_options::Source;
use pliant_wire::{AnimateOrder, animate_options_from_json, animate_order, pb};
use prost::Message;
use std::convert::Infallible;

/// The JSON answer that a message is.
fn json<M: Message + prost::Name>(message: &M) -> Result<Response, Problem> {
    Ok(Json(pliant_wire::json::to_json(message)?).into_response())
}

/// The JSON answer that a session is.
pub(super) fn session_json(state: &ServerState, session: pb::Session) -> Result<Response, Problem> {
    json(&messages::described_session(session, state.manager.config()))
}

pub(super) async fn list(State(state): State<ServerState>, caller: Caller, uri: Uri) -> Result<Response, Problem> {
    let mut found = parameters(&uri, &["pageSize", "pageToken", "page_size", "page_token"])?;
    let mut take = |camel: &str, snake: &str| found.remove(camel).or_else(|| found.remove(snake));
    let page_size = match take("pageSize", "page_size") {
        None => 0,
        // Only a message has no other way to say nothing than 0.
        Some(text) => text.parse().ok().filter(|size| *size > 0).ok_or_else(|| {
            let seen = clip(&text);
            Error::invalid("pageSize", format!("\"{seen}\" is not a whole number from 1 to 1000"))
        })?,
    };
    let page_token = take("pageToken", "page_token").unwrap_or_default();
    let page = pliant_wire::session_page(&pb::ListSessionsRequest { page_size, page_token })?;
    let list = state.manager.list(&caller.tenant, page).await?;
    json(&messages::session_list(list, state.manager.config()))
}

pub(super) async fn get(call: SessionCall) -> Result<Response, Problem> {
    session_json(&call.state, call.manager.get(&call.caller.tenant, &call.id).await?)
}

pub(super) async fn delete(call: SessionCall) -> Result<Response, Problem> {
    call.manager.delete(&call.caller.tenant, &call.id).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

pub(super) async fn undo(call: SessionCall) -> Result<Response, Problem> {
    let undone = call.manager.undo(&call.caller.tenant, &call.id, call.caller.key()?);
    session_json(&call.state, undone.await?)
}

pub(super) async fn redo(call: SessionCall) -> Result<Response, Problem> {
    let redone = call.manager.redo(&call.caller.tenant, &call.id, call.caller.key()?);
    session_json(&call.state, redone.await?)
}

pub(super) async fn history(call: SessionCall) -> Result<Response, Problem> {
    json(&call.manager.history(&call.caller.tenant, &call.id).await?)
}

pub(super) async fn limits(State(state): State<ServerState>, caller: Caller) -> Result<Response, Problem> {
    let left = state.manager.quotas_left(&caller.tenant).await?;
    let longest = *state.manager.ttl_range(&caller.tenant)?.end();
    json(&messages::limits_left(state.manager.config(), left, longest))
}

pub(super) async fn set_handles(call: SessionCall, request: Request) -> Result<Response, Problem> {
    let message: pb::SetHandlesRequest = call.message(request).await?;
    let (key, handles) = (call.key_of(&message)?, pliant_wire::handle_set(&message)?);
    let set = call.manager.set_handles(&call.caller.tenant, &call.id, handles, key);
    session_json(&call.state, set.await?)
}

pub(super) async fn patch_handle(call: SessionCall, request: Request) -> Result<Response, Problem> {
    call.check_session().await?;
    let text = body::text(&call.state, request).await?;
    let mut handle: pb::Handle = if text.is_empty() {
        pb::Handle::default()
    } else {
        pliant_wire::json::from_json(&text)?
    };
    if !handle.id.is_empty() && handle.id != call.handle_id {
        let (seen, path) = (clip(&handle.id), clip(&call.handle_id));
        return Err(Error::invalid("id", format!("is \"{seen}\", the path says \"{path}\"")).into());
    }
    handle.id.clone_from(&call.handle_id);
    let tenant = &call.caller.tenant;
    let fields = present(&text);
    let key = || [fields.join(",").as_bytes(), &handle.encode_to_vec()].concat();
    let key = call.caller.call_key(key)?;
    let patch = pliant_wire::handle_patch(&handle, &fields, &call.manager.handles(tenant, &call.id).await?)?;
    session_json(
        &call.state,
        call.manager.put_handle(tenant, &call.id, patch, key).await?,
    )
}

pub(super) async fn delete_handle(call: SessionCall) -> Result<Response, Problem> {
    let (tenant, key) = (&call.caller.tenant, call.caller.key()?);
    let removed = call.manager.remove_handle(tenant, &call.id, &call.handle_id, key);
    session_json(&call.state, removed.await?)
}

/// The names of the fields that a JSON object gives.
fn present(text: &[u8]) -> Vec<String> {
    match serde_json::from_slice(text) {
        Ok(serde_json::Value::Object(fields)) => fields.into_iter().map(|(name, _)| name).collect(),
        _ => Vec::new(),
    }
}

pub(super) async fn edit(call: SessionCall, request: Request) -> Result<Response, Problem> {
    let message: pb::EditRequest = call.message(request).await?;
    let (key, edit) = (call.key_of(&message)?, pliant_wire::session_edit(&message)?);
    let done = call.manager.edit(&call.caller.tenant, &call.id, edit, key).await?;
    json(&done)
}

pub(super) async fn carry(call: SessionCall, request: Request) -> Result<Response, Problem> {
    let message: pb::CarryRequest = call.message(request).await?;
    let order = pliant_wire::carry_order(&message)?;
    json(&call.manager.carry(&call.caller.tenant, &call.id, order).await?)
}

pub(super) async fn crossings(call: SessionCall, request: Request) -> Result<Response, Problem> {
    let message: pb::CrossingsRequest = call.message(request).await?;
    let order = pliant_wire::crossings_order(&message)?;
    json(&call.manager.crossings(&call.caller.tenant, &call.id, order).await?)
}

pub(super) async fn rig(call: SessionCall, request: Request) -> Result<Response, Problem> {
    let message: pb::MakeRigRequest = call.message(request).await?;
    let order = pliant_wire::make_rig_order(&message)?;
    json(&call.manager.make_rig(&call.caller.tenant, &call.id, order).await?)
}

pub(super) async fn transfer(call: SessionCall, request: Request) -> Result<Response, Problem> {
    let message: pb::TransferRequest = call.message(request).await?;
    let order = messages::transfer_order(&message)?;
    if order.command.format == Some(Format::GLTF) {
        return Err(Error::invalid("output", "is \"gltf\", which has files beside it; ask for glb").into());
    }
    let came = call.manager.transfer(&call.caller.tenant, &call.id, order).await?;
    let shapes = &came.report.shapes;
    let flipped: u32 = shapes.iter().map(|shape| shape.flipped_triangles).sum();
    let in_source: u32 = shapes.iter().map(|shape| shape.flipped_in_source).sum();
    let mut told = format!(
        "shapes={}, clips={}, flipped-triangles={flipped}/{in_source}",
        shapes.len(),
        came.report.clips
    );
    if let Some(on) = came.report.wrap.and_then(|wrap| wrap.to_target) {
        told += &format!(", wrapped-p95={:.5}", on.p95);
    }
    if let Some(fit) = came.report.fit {
        told += &format!(", inside={}, crossings={}", fit.inside, fit.crossings);
    }
    let mut response = models::main_file(&call.id, None, came.model, &HeaderMap::new())?;
    if let Ok(told) = HeaderValue::from_str(&told) {
        response.headers_mut().insert(TRANSFERRED, told);
    }
    Ok(response)
}

/// The header that counts what came: triangles that are turned over, and those that are so in the source.
const TRANSFERRED: HeaderName = HeaderName::from_static("x-pliant-transferred");

const JSON: &str = "application/json";
const BUFFER: &str = "application/octet-stream";

/// The media types of a solve's answer: JSON, the buffer, then the model in every format.
fn offers() -> Vec<&'static str> {
    let models = Format::ALL.into_iter().map(Format::media_type);
    [JSON, BUFFER].into_iter().chain(models).collect()
}

pub(super) async fn solve(call: SessionCall, request: Request) -> Result<Response, Problem> {
    call.check_session().await?;
    let offer = negotiate(request.headers(), &offers())?;
    let message: pb::SolveRequest = call.body_message(request).await?;
    if offer == BUFFER {
        whole_buffer(message.options.as_ref())?;
    }
    let (tenant, key) = (&call.caller.tenant, call.key_of(&message)?);
    let pose = pliant_wire::pose_commit(&message, call.manager.config().window)?;
    let solved = call.manager.solve(tenant, &call.id, pose, key).await?;
    let facts = facts(&solved);
    let mut response = match offer {
        JSON => as_json(solved).await?,
        BUFFER => as_buffer(frame_parts(solved.frame).await?),
        model => {
            let format = Format::from_media_type(model);
            let exported = call.manager.export(tenant, &call.id, format).await?;
            models::main_file(&call.id, None, exported, &HeaderMap::new())?
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
        if let Some(pairs) = quality.new_self_intersections {
            set("x-pliant-new-self-intersections", pairs.to_string());
        }
        if let Some(off) = quality.off_rigid {
            set("x-pliant-off-rigid", off.to_string());
        }
    }
    headers.extend(models::origin_value(solved.frame.origin).map(|value| (models::ORIGIN, value)));
    headers
}

/// All parts of a frame, encoded on a blocking thread.
async fn frame_parts(frame: Frame) -> Result<Vec<pb::Frame>, Problem> {
    let encoded = tokio::task::spawn_blocking(move || encode(frame).collect()).await;
    encoded.map_err(|_| Error::new(ErrorCode::Internal, "the frame cannot be encoded").into())
}

async fn as_json(solved: CommittedPose) -> Result<Response, Problem> {
    let frames = frame_parts(solved.frame).await?;
    let frames = frames
        .iter()
        .map(pliant_wire::json::to_json)
        .collect::<Result<Vec<_>, _>>()?;
    let answer = serde_json::json!({
        "frames": frames,
        // As proto-JSON writes 64-bit numbers.
        "revision": solved.revision.to_string(),
        "digest": solved.digest,
    });
    Ok(Json(answer).into_response())
}

fn as_buffer(mut frames: Vec<pb::Frame>) -> Response {
    // In the order of the enumeration, as the documentation says; parts of one attribute keep theirs.
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

/// A JSON object a line.
const LINES: &str = "application/x-ndjson";
/// Messages in a row, each after its length as a varint.
const DELIMITED: &str = "application/vnd.google.protobuf";
/// The same with what it is of.
const DELIMITED_FRAMES: &str = "application/vnd.google.protobuf; proto=pliant.v1.Frame; encoding=delimited";
const GLB: &str = "model/gltf-binary";

/// What an answer can be.
pub(crate) const OFFERS: [&str; 3] = [LINES, DELIMITED, GLB];

pub(super) async fn animate(call: SessionCall, request: Request) -> Result<Response, Problem> {
    call.check_session().await?;
    let offer = negotiate(request.headers(), &OFFERS)?;
    let order = received_order(&call.state, request, &call.id).await?;
    let tenant = &call.caller.tenant;
    if offer == GLB {
        let played = call.manager.animate_to_model(tenant, &call.id, order).await?;
        return Ok(model_answer(played));
    }
    let (input, output) = call.manager.animate(tenant, &call.id, order).await?;
    input.finish_input();
    let mut frames = AnimationFrames::of_output(output);
    // What is wrong with clip or rig is known before the first frame, and has a status of its own.
    let first = loop {
        match frames.next_message().await {
            None => return Err(Problem::internal("an animation ended without a result")),
            Some(Err(error)) => return Err(error.into()),
            Some(Ok(frame)) if frame.parts == 0 && frame.animated.as_ref().is_some_and(|a| a.report.is_none()) => {}
            Some(Ok(frame)) => break frame,
        }
    };
    Ok(frames_answer(call.state, first, frames, offer == LINES))
}

/// Reads the request.
async fn received_order(state: &ServerState, request: Request, id: &str) -> Result<AnimateOrder, Problem> {
    let mut options = pb::AnimateOptions::default();
    if body::content_type(request.headers()) == "multipart/form-data" {
        let parts = received_form(state, request).await?;
        if let Some(text) = parts.options {
            options = animate_options_from_json(&text)?;
        }
        if let Some(clip) = parts.clip
            && options.source.replace(Source::Bvh(clip)).is_some()
        {
            let problem = "is given twice: as the part clip, and by clip, bvh or bvhSize in the options";
            return Err(Error::invalid("clip", problem).into());
        }
    } else {
        let text = body::text(state, request).await?;
        if !text.is_empty() {
            options = animate_options_from_json(&text)?;
        }
    }
    body::same_session(&options.session_id, id)?;
    let config = state.manager.config();
    let order = animate_order(&options, config.window, config.clip_bytes)?;
    if order.bvh_size.is_some() {
        let problem = "is for gRPC; send the BVH file as the part clip of a form";
        return Err(Error::invalid("bvhSize", problem).into());
    }
    Ok(order)
}

/// The parts of a form.
#[derive(Default)]
struct AnimationForm {
    options: Option<Bytes>,
    clip: Option<Bytes>,
}

async fn received_form(state: &ServerState, request: Request) -> Result<AnimationForm, Problem> {
    let clip_bytes = usize::try_from(state.manager.config().clip_bytes).unwrap_or(usize::MAX);
    let mut held = FormReader::hold_upload(state, &request)?;
    let mut form = FormReader::of_request(state, request)?;
    let mut parts = AnimationForm::default();
    while let Some(mut field) = form.next_field().await? {
        let name = field.name().unwrap_or_default().to_owned();
        let (place, limit) = match name.as_str() {
            "options" => (&mut parts.options, state.message_bytes),
            "clip" => (&mut parts.clip, clip_bytes),
            other => {
                let text = format!("the form has a part \"{}\"; allowed are options and clip", clip(other));
                return Err(Error::malformed(text).into());
            }
        };
        let bytes = form.field_bytes(&mut field, limit, |count| held.grow(count)).await?;
        if place.replace(bytes.into()).is_some() {
            return Err(Error::malformed(format!("the form has two parts \"{name}\"")).into());
        }
    }
    Ok(parts)
}

/// A GLB, with the facts of its frames as headers.
fn model_answer(played: AnimatedModel) -> Response {
    let mut response = Response::new(Body::from(played.model));
    let totals = pliant_wire::animation_totals(&played.summary.sums, played.summary.ms);
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(GLB));
    for (name, value) in [
        ("x-pliant-frames", totals.frames.to_string()),
        ("x-pliant-volume-change", totals.volume_change_mean.to_string()),
        ("x-pliant-flipped-triangles", totals.flipped_triangles_worst.to_string()),
        ("x-pliant-max-stretch", totals.max_stretch.to_string()),
        ("x-pliant-edge-rms", totals.edge_rms_mean.to_string()),
    ] {
        if let Ok(value) = HeaderValue::from_str(&value) {
            headers.insert(HeaderName::from_static(name), value);
        }
    }
    models::add_warnings(headers, played.summary.warnings.iter().map(String::as_str));
    response
}

/// Frames in a row, each encoded when the client has taken the one before. A failure breaks the body off.
fn frames_answer(state: ServerState, first: pb::Frame, frames: AnimationFrames, as_lines: bool) -> Response {
    let stream = futures::stream::unfold(Some((state, Some(first), frames)), move |open| async move {
        let (state, first, mut frames) = open?;
        let next = match first {
            Some(frame) => Some(Ok(frame)),
            None => tokio::select! {
                next = frames.next_message() => next,
                () = state.closing.cancelled() => Some(Err(Error::draining())),
            },
        };
        match next?.and_then(|frame| frame_bytes(&frame, as_lines)) {
            Ok(bytes) => Some((Ok(bytes), Some((state, None, frames)))),
            Err(error) => Some((Err(error), None)),
        }
    });
    let mut response = Response::new(Body::from_stream(stream));
    let kind = if as_lines { LINES } else { DELIMITED_FRAMES };
    (response.headers_mut()).insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}

fn frame_bytes(frame: &pb::Frame, as_lines: bool) -> Result<Bytes, Error> {
    if !as_lines {
        return Ok(frame.encode_length_delimited_to_vec().into());
    }
    let mut line = pliant_wire::json::to_json(frame)?.to_string();
    line.push('\n');
    Ok(line.into())
}
