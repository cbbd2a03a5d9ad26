//! A case on a server, through its HTTP API: open a session, set handles, do every step, fetch the shape.

use super::http::{HttpAnswer, HttpCall, HttpClient};
use crate::asset::{self, FileSet, Model};
use crate::batch;
use crate::check::{AnimationCase, CaseResult, Metric};
use crate::wire::{self, pb};
use bytes::Bytes;
use glam::DVec3;
use http::{HeaderMap, Method};
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};
use prost::Message as _;
use serde_json::Value;

const JSON: &str = "application/json";
const FRAMES: &str = "application/vnd.google.protobuf";
const BUFFER: &str = "application/octet-stream";

/// Asks whether the server answers at all.
///
/// # Errors
/// Why not.
pub(super) fn ask_limits(client: &HttpClient) -> Result<(), String> {
    get_document(client, "/v1/limits", "/v1/limits", JSON).map(drop)
}

/// Runs a job on a model. The caller adds the shape before, and the triangles where no step edits. The numbers lack
/// cycles, bytes and constraint errors, which no server reports.
///
/// # Errors
/// Why it cannot be run, with the server's words.
pub(super) fn run_on_server(client: &HttpClient, files: &FileSet, job: &pb::Job) -> Result<CaseResult, String> {
    let create = job.create.clone().unwrap_or_default();
    with_session(client, files, &create, |session| session.run_job(job))
}

/// Runs an animation of a model, as [`run_on_server`] runs a job.
///
/// # Errors
/// Why it cannot be run, with the server's words.
pub(super) fn animate_on_server(
    client: &HttpClient,
    files: &FileSet,
    animation: &AnimationCase,
) -> Result<CaseResult, String> {
    with_session(client, files, &animation.create, |session| {
        session.run_animation(&animation.options)
    })
}

/// Opens a session on a model, and closes it whatever comes of it.
fn with_session(
    client: &HttpClient,
    files: &FileSet,
    create: &pb::CreateOptions,
    run: impl FnOnce(&RemoteSession<'_>) -> Result<CaseResult, String>,
) -> Result<CaseResult, String> {
    let create = wire::json::to_json(create).map_err(|e| e.to_string())?;
    let options = utf8_percent_encode(&create.to_string(), NON_ALPHANUMERIC).to_string();
    let (content_type, body) = session_body(files);
    let session = client.send(&HttpCall {
        method: Method::POST,
        path: &format!("/v1/sessions?options={options}"),
        name: "/v1/sessions",
        content_type: &content_type,
        accept: JSON,
        body,
    })?;
    let id = parse_document(&session)?["id"].as_str().unwrap_or_default().to_owned();
    if id.is_empty() || !id.bytes().all(|b| b.is_ascii_alphanumeric()) {
        return Err("POST /v1/sessions: the answer names no session".into());
    }
    let session = RemoteSession { client, id: &id };
    let found = run(&session);
    // Also after a failure: a session that nobody closes would only wait for its expiry.
    let closed = session.send_below(Method::DELETE, "", JSON, Bytes::new()).map(drop);
    let found = found?;
    closed.map(|()| found)
}

struct RemoteSession<'a> {
    client: &'a HttpClient,
    id: &'a str,
}

impl RemoteSession<'_> {
    fn send_below(&self, method: Method, below: &str, accept: &str, body: Bytes) -> Result<HttpAnswer, String> {
        self.client.send(&HttpCall {
            method,
            path: &format!("/v1/sessions/{}{below}", self.id),
            name: &format!("/v1/sessions/{{id}}{below}"),
            content_type: if body.is_empty() { "" } else { JSON },
            accept,
            body,
        })
    }

    fn send_message<M: prost::Message + prost::Name>(
        &self,
        method: Method,
        below: &str,
        accept: &str,
        message: &M,
    ) -> Result<HttpAnswer, String> {
        let body = wire::json::to_json(message).map_err(|e| e.to_string())?;
        self.send_below(method, below, accept, body.to_string().into())
    }

    fn run_animation(&self, options: &pb::AnimateOptions) -> Result<CaseResult, String> {
        let options = pb::AnimateOptions {
            output: None,
            ..options.clone()
        };
        let answer = self.send_message(Method::POST, "/animations", FRAMES, &options)?;
        let mut found = CaseResult {
            rounded: true,
            ..Default::default()
        };
        let mut left = answer.body;
        let mut data = Vec::new();
        let mut is_whole = false;
        while !left.is_empty() {
            let part = pb::Frame::decode_length_delimited(&mut left).map_err(|e| format!("a frame: {e}"))?;
            let reported = part.animated.unwrap_or_default();
            is_whole |= reported.report.is_some();
            if part.parts == 0 {
                continue;
            }
            if part.part == 0 {
                data.clear();
            }
            data.extend_from_slice(&part.data);
            if part.part + 1 == part.parts {
                found.positions = positions_from_floats(&data)?;
                found.digest.clone_from(&reported.digest);
                found.frames.push(reported.digest);
                found.take_quality(&part.quality.unwrap_or_default());
            }
        }
        match is_whole {
            true => Ok(found),
            false => Err("the animation broke off before its last frame".into()),
        }
    }

    fn run_job(&self, job: &pb::Job) -> Result<CaseResult, String> {
        if !job.handles.is_empty() {
            let request = pb::SetHandlesRequest {
                session_id: String::new(),
                handles: job.handles.clone(),
                symmetry_plane: job.symmetry_plane.clone(),
                region_of_interest: job.region_of_interest.clone(),
            };
            self.send_message(Method::PUT, "/handles", JSON, &request)?;
        }
        let mut found = CaseResult {
            rounded: true,
            ..Default::default()
        };
        let mut quality = None;
        let mut edited = false;
        for (k, step) in remote_steps(job).iter().enumerate() {
            let at_step = |e: String| format!("steps[{k}]: {e}");
            quality = None;
            match step {
                RemoteStep::Pose(pose) => {
                    let request = pb::SolveRequest {
                        session_id: String::new(),
                        pose: Some(pose.clone()),
                        options: Some(options_for_floats(job.options.unwrap_or_default())),
                    };
                    let answer = self
                        .send_message(Method::POST, "/solve", BUFFER, &request)
                        .map_err(at_step)?;
                    quality = header_quality(&answer.headers);
                    let residual = header_number(&answer.headers, "x-pliant-residual").unwrap_or_default();
                    let most = found.numbers.entry(Metric::Residual).or_insert(0.0);
                    *most = most.max(residual);
                }
                RemoteStep::Edit(edit) => {
                    self.send_message(Method::POST, "/edits", JSON, edit).map_err(at_step)?;
                    edited = true;
                }
            }
        }
        found.digest = self.newest_digest()?;
        found.positions =
            positions_from_floats(&self.send_below(Method::GET, "/positions", BUFFER, Bytes::new())?.body)?;
        if edited {
            let model = self.send_below(Method::GET, "/model?format=ply", "", Bytes::new())?;
            let model = Model::read(
                FileSet::single("model.ply", model.body),
                None,
                &asset::Limits::default(),
            );
            found.triangles = model
                .map_err(|e| format!("the model that came back: {e}"))?
                .geometry
                .triangles;
            if found
                .triangles
                .as_flattened()
                .iter()
                .any(|&v| v as usize >= found.positions.len())
            {
                return Err("the model and the positions that came back have other vertices".into());
            }
        }
        if let Some(quality) = &quality {
            found.take_quality(quality);
        }
        let report = pb::Report {
            quality,
            digest: found.digest.clone(),
            ..Default::default()
        };
        found.unmet = batch::unmet_expectations(job.expect.as_ref(), &report).0;
        Ok(found)
    }

    /// Digest of the newest commit.
    fn newest_digest(&self) -> Result<String, String> {
        let history = parse_document(&self.send_below(Method::GET, "/history", JSON, Bytes::new())?)?;
        let commits = history["commits"].as_array();
        let current = commits.and_then(|all| all.iter().find(|c| c["revision"] == history["current"]));
        let digest = current.and_then(|c| c["digest"].as_str());
        digest
            .map(str::to_owned)
            .ok_or_else(|| "GET /v1/sessions/{id}/history: the answer names no digest".into())
    }
}

enum RemoteStep {
    Pose(pb::Pose),
    Edit(pb::EditRequest),
}

/// Lists the steps as [`batch::run`] does them: without steps the poses that the handles come with are one.
fn remote_steps(job: &pb::Job) -> Vec<RemoteStep> {
    if job.steps.is_empty() && job.handles.iter().any(|h| h.pose.is_some()) {
        return vec![RemoteStep::Pose(pb::Pose::default())];
    }
    let steps = job.steps.iter().filter_map(|s| s.step.as_ref());
    steps
        .map(|step| match step {
            pb::step::Step::Pose(pose) => RemoteStep::Pose(pose.clone()),
            pb::step::Step::Edit(edit) => RemoteStep::Edit(edit.clone()),
        })
        .collect()
}

/// Changes options so that the answer is a whole buffer of plain floats.
fn options_for_floats(options: pb::Options) -> pb::Options {
    let asked = options.output.unwrap_or_default();
    pb::Options {
        progressive: false,
        window: 0,
        output: Some(pb::Output {
            self_intersections: asked.self_intersections,
            ..Default::default()
        }),
        ..options
    }
}

/// Builds the body that opens a session: the model, with companions as a form.
fn session_body(files: &FileSet) -> (String, Bytes) {
    if files.companions.is_empty() {
        return (BUFFER.into(), files.main.clone());
    }
    // A line that is in no part.
    let parts = || files.companions.values().chain([&files.main]);
    let within = |text: &str| parts().any(|p| p.windows(text.len()).any(|w| w == text.as_bytes()));
    let mut boundary = "pliant-check-part".to_owned();
    while within(&boundary) {
        boundary.push('x');
    }
    let quoted = |name: &str| name.replace('"', "%22").replace(['\r', '\n'], " ");
    let mut body = Vec::new();
    let mut part = |field: &str, name: &str, bytes: &[u8]| {
        let head = format!(
            "--{boundary}\r\ncontent-disposition: form-data; name=\"{field}\"; filename=\"{}\"\r\ncontent-type: {BUFFER}\r\n\r\n",
            quoted(name)
        );
        body.extend_from_slice(head.as_bytes());
        body.extend_from_slice(bytes);
        body.extend_from_slice(b"\r\n");
    };
    part("model", &files.name, &files.main);
    files
        .companions
        .iter()
        .for_each(|(name, bytes)| part("companion", name, bytes));
    body.extend_from_slice(format!("--{boundary}--\r\n").as_bytes());
    (format!("multipart/form-data; boundary={boundary}"), body.into())
}

fn get_document(client: &HttpClient, path: &str, name: &str, accept: &str) -> Result<HttpAnswer, String> {
    client.send(&HttpCall {
        method: Method::GET,
        path,
        name,
        content_type: "",
        accept,
        body: Bytes::new(),
    })
}

fn parse_document(answer: &HttpAnswer) -> Result<Value, String> {
    serde_json::from_slice(&answer.body).map_err(|e| format!("the answer is not JSON: {e}"))
}

fn header_number(headers: &HeaderMap, name: &str) -> Option<f64> {
    headers.get(name)?.to_str().ok()?.parse().ok()
}

fn header_quality(headers: &HeaderMap) -> Option<pb::Quality> {
    Some(pb::Quality {
        edge_rms: header_number(headers, "x-pliant-edge-rms")?,
        volume_change: header_number(headers, "x-pliant-volume-change")?,
        open_surface: headers
            .get("x-pliant-open-surface")
            .is_some_and(|reported| reported == "true"),
        area_change: header_number(headers, "x-pliant-area-change")?,
        flipped_triangles: header_number(headers, "x-pliant-flipped-triangles")? as u32,
        max_stretch: header_number(headers, "x-pliant-max-stretch")?,
        self_intersections: header_number(headers, "x-pliant-self-intersections").map(|n| n as u32),
        faces_too_large: header_number(headers, "x-pliant-faces-too-large").unwrap_or(0.0) as u32,
    })
}

/// Reads positions from little-endian 32-bit floats.
fn positions_from_floats(bytes: &[u8]) -> Result<Vec<DVec3>, String> {
    let (vertices, rest) = bytes.as_chunks::<12>();
    if !rest.is_empty() {
        return Err(format!(
            "{} bytes of positions are not a whole number of vertices",
            bytes.len()
        ));
    }
    let float = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let vertex = |v: &[u8; 12]| DVec3::new(float(&v[0..4]), float(&v[4..8]), float(&v[8..12]));
    Ok(vertices.iter().map(vertex).collect())
}
