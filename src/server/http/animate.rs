//! A clip that drives a session's model: its frames in a row, or a GLB that plays it.
//!
//! The body is a form with the parts `options` (AnimateOptions as JSON) and `clip` (a BVH file), or the options alone.

use super::body;
use super::problem::{Problem, clip as shortened};
use super::request::{SessionCall, negotiate};
use super::upload::FormReader;
use crate::server::state::ServerState;
use crate::server::stream_messages::AnimationFrames;
use crate::session::{AnimatedModel, Error};
use crate::wire::pb::{self, animate_options::Source};
use crate::wire::{self, AnimateOrder, animate_options_from_json, animate_order};
use axum::body::Body;
use axum::extract::Request;
use axum::response::Response;
use bytes::Bytes;
use http::{HeaderName, HeaderValue, header};
use prost::Message as _;

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
                let text = format!(
                    "the form has a part \"{}\"; allowed are options and clip",
                    shortened(other)
                );
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
    let totals = wire::animation_totals(&played.summary.sums, played.summary.ms);
    let warnings: Vec<String> = (played.summary.warnings.iter())
        .map(|line| {
            line.chars()
                .map(|c| if c.is_ascii_graphic() || c == ' ' { c } else { '?' })
                .collect()
        })
        .collect();
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
    for warning in warnings {
        if let Ok(value) = HeaderValue::from_str(&shortened(&warning)) {
            headers.append(HeaderName::from_static("x-pliant-warning"), value);
        }
    }
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
    let mut line = wire::json::to_json(frame)?.to_string();
    line.push('\n');
    Ok(line.into())
}
