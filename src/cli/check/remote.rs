//! A case on a server, through its HTTP API: open a session, set handles, do every step, fetch the shape.
//!
//! A small HTTP client: one server, one call at a time, whole bodies.

use crate::asset::{FileSet, Model};
use crate::check::{AnimationCase, CaseResult, Metric};
use crate::server::tls::https_connector;
use crate::wire::pb;
use crate::wire::pb::step::Step;
use crate::{asset, batch, wire};
use bytes::Bytes;
use glam::DVec3;
use http::{HeaderMap, Method, Request, StatusCode, Uri, header};
use http_body_util::{BodyExt as _, Full, Limited};
use hyper_rustls::HttpsConnector;
use hyper_util::client::legacy::Client as Connections;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};
use prost::Message as _;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::Duration;

const JSON: &str = "application/json";
const FRAMES: &str = "application/vnd.google.protobuf";
const BUFFER: &str = "application/octet-stream";

/// Asks whether the server answers at all.
///
/// # Errors
/// Why not.
pub(super) fn ask_limits(client: &HttpClient) -> Result<(), String> {
    client.send(&HttpCall::get("/v1/limits", JSON)).map(drop)
}

/// Runs a job, or an animation in its place, on a model, in a session that is closed whatever comes of it. The caller adds the
/// shape before, and the triangles where no step edits. The numbers lack cycles, bytes and constraint errors, which no
/// server reports.
///
/// # Errors
/// Why it cannot be run, with the server's words.
pub(super) fn run_on_server(
    client: &HttpClient,
    files: &FileSet,
    job: &pb::Job,
    animation: Option<&AnimationCase>,
) -> Result<CaseResult, String> {
    let create = animation.map(|a| &a.create).or(job.create.as_ref());
    let create = wire::json::to_json(&create.cloned().unwrap_or_default()).map_err(|e| e.to_string())?;
    let options = utf8_percent_encode(&create.to_string(), NON_ALPHANUMERIC).to_string();
    let (content_type, body) = session_body(files);
    let session = client.send(&HttpCall {
        method: Method::POST,
        path: &format!("/v1/sessions?options={options}"),
        content_type: &content_type,
        accept: JSON,
        body,
    })?;
    let id = parse_document(&session)?["id"].as_str().unwrap_or_default().to_owned();
    if id.is_empty() || !id.bytes().all(|b| b.is_ascii_alphanumeric()) {
        return Err("POST /v1/sessions: the answer names no session".into());
    }
    let session = RemoteSession { client, id: &id };
    let found = match animation {
        Some(animation) => session.run_animation(&animation.options),
        None => session.run_job(job),
    };
    // Also after a failure: a session that is left open would only wait for its expiry.
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
            self.send_message(Method::PUT, "/handles", JSON, &batch::handles_request(job))?;
        }
        let mut found = CaseResult {
            rounded: true,
            ..Default::default()
        };
        let mut quality = None;
        let mut edited = false;
        let steps = batch::steps_of(job).map_err(|e| e.to_string())?;
        for (k, step) in steps.iter().enumerate() {
            let at_step = |e: String| format!("steps[{k}]: {e}");
            quality = None;
            match step {
                Step::Pose(pose) => {
                    let request = pb::SolveRequest {
                        session_id: String::new(),
                        pose: Some(pose.clone()),
                        options: Some(options_for_floats(job.pose_options())),
                    };
                    let answer = self
                        .send_message(Method::POST, "/solve", BUFFER, &request)
                        .map_err(at_step)?;
                    quality = header_quality(&answer.headers);
                    let residual = header_number(&answer.headers, "x-pliant-residual").unwrap_or_default();
                    let most = found.numbers.entry(Metric::Residual).or_insert(0.0);
                    *most = most.max(residual);
                }
                Step::Edit(edit) => {
                    self.send_message(Method::POST, "/edits", JSON, edit).map_err(at_step)?;
                    edited = true;
                }
            }
        }
        found.digest = self.newest_digest()?;
        let positions = self.send_below(Method::GET, "/positions", BUFFER, Bytes::new())?;
        found.positions = positions_from_floats(&positions.body)?;
        if edited {
            let model = self.send_below(Method::GET, "/model?format=ply", "", Bytes::new())?;
            let model = FileSet::single("model.ply", model.body);
            let model = Model::read(model, None, &asset::Limits::default());
            let model = model.map_err(|e| format!("the model that came back: {e}"))?;
            found.triangles = model.geometry.triangles;
            let vertices = found.positions.len();
            if found.triangles.as_flattened().iter().any(|&v| v as usize >= vertices) {
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
        new_self_intersections: header_number(headers, "x-pliant-new-self-intersections").map(|n| n as u32),
        off_rigid: header_number(headers, "x-pliant-off-rigid"),
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

/// Largest answer that is read, bytes.
const LARGEST: usize = 4 << 30;
/// Longest time that one call may take.
const PATIENCE: Duration = Duration::from_secs(900);
/// How often a call is repeated that a busy server turned away.
const TRIES: u32 = 20;
/// Longest wait before it is repeated.
const LONGEST_WAIT: u64 = 10;

/// A server address says where a server is, and who asks.
#[derive(Debug, Clone)]
pub(super) struct ServerAddress {
    base: String,
    token: Option<String>,
    /// PEM file of the authorities that may sign its certificate, in place of the machine's.
    ca: Option<PathBuf>,
}

impl ServerAddress {
    /// Checks a URL such as `http://127.0.0.1:7411`, maybe with a path before the calls' own.
    pub fn new(url: &str, token: Option<&str>, ca: Option<&Path>) -> Result<Self, String> {
        let wrong = |problem: &str| {
            Err(format!(
                "--server is \"{url}\": {problem}, such as http://127.0.0.1:7411"
            ))
        };
        let Ok(uri) = url.parse::<Uri>() else {
            return wrong("it is not a URL; give one");
        };
        match uri.scheme_str() {
            Some("http" | "https") => {}
            _ => return wrong("it must begin with http:// or https://"),
        }
        if uri.query().is_some() || uri.authority().is_none_or(|a| a.as_str().contains('@')) {
            return wrong("it must be host, port and maybe a path");
        }
        if token.is_some_and(|t| t.is_empty() || !t.chars().all(|c| c.is_ascii_graphic())) {
            return Err("--token must be printable ASCII without spaces".into());
        }
        Ok(Self {
            base: url.trim_end_matches('/').to_owned(),
            token: token.map(str::to_owned),
            ca: ca.map(Path::to_owned),
        })
    }
}

/// An HTTP answer is what a server answered.
pub(super) struct HttpAnswer {
    pub headers: HeaderMap,
    pub body: Bytes,
}

/// An HTTP call is what is sent.
pub(super) struct HttpCall<'a> {
    pub method: Method,
    /// Below the server's address, percent-encoded.
    pub path: &'a str,
    pub content_type: &'a str,
    pub accept: &'a str,
    pub body: Bytes,
}

impl<'a> HttpCall<'a> {
    fn get(path: &'a str, accept: &'a str) -> Self {
        Self {
            method: Method::GET,
            path,
            content_type: "",
            accept,
            body: Bytes::new(),
        }
    }

    /// What the call is named in texts, without anything random.
    fn name(&self) -> String {
        let path = self.path.split_once("?options=").map_or(self.path, |(path, _)| path);
        let path = match path.strip_prefix("/v1/sessions/") {
            Some(session) => {
                let id = session.find('/').unwrap_or(session.len());
                format!("/v1/sessions/{{id}}{}", &session[id..])
            }
            None => path.to_owned(),
        };
        format!("{} {path}", self.method)
    }
}

/// An HTTP client calls one server. It is owned by one thread.
pub(super) struct HttpClient {
    address: ServerAddress,
    connections: Connections<HttpsConnector<HttpConnector>, Full<Bytes>>,
    runtime: tokio::runtime::Runtime,
}

impl HttpClient {
    /// Makes a client; nothing is sent yet.
    pub fn new(address: &ServerAddress) -> Result<Self, String> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        Ok(Self {
            address: address.clone(),
            connections: Connections::builder(TokioExecutor::new()).build(https_connector(address.ca.as_deref())?),
            runtime: runtime.map_err(|e| format!("cannot start a runtime: {e}"))?,
        })
    }

    /// Sends a call and waits for its answer. A server that is busy is asked again after the time that it names.
    ///
    /// # Errors
    /// What went wrong, with the server's own words where it gave some.
    pub fn send(&self, call: &HttpCall<'_>) -> Result<HttpAnswer, String> {
        let named = |problem: String| format!("{}: {problem}", call.name());
        let mut tries = 1;
        loop {
            let (status, answer) = self.send_once(call).map_err(named)?;
            let busy = matches!(status, StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE);
            let again = answer.headers.get(header::RETRY_AFTER);
            match again.and_then(|v| v.to_str().ok()?.parse::<u64>().ok()) {
                Some(seconds) if busy && tries < TRIES => {
                    let wait = Duration::from_secs(seconds.clamp(1, LONGEST_WAIT));
                    // The timer is made where the runtime runs.
                    self.runtime.block_on(async { tokio::time::sleep(wait).await });
                    tries += 1;
                }
                _ if status.is_success() => return Ok(answer),
                _ => return Err(named(server_problem(status, &answer.body))),
            }
        }
    }

    fn send_once(&self, call: &HttpCall<'_>) -> Result<(StatusCode, HttpAnswer), String> {
        let uri = format!("{}{}", self.address.base, call.path);
        let mut request = Request::builder().method(call.method.clone()).uri(uri);
        let bearer = self.address.token.as_ref().map(|token| format!("Bearer {token}"));
        for (name, value) in [
            (header::CONTENT_TYPE, call.content_type),
            (header::ACCEPT, call.accept),
            (header::AUTHORIZATION, bearer.as_deref().unwrap_or_default()),
        ] {
            if !value.is_empty() {
                request = request.header(name, value);
            }
        }
        let request = request.body(Full::new(call.body.clone())).map_err(|e| e.to_string())?;
        let answered = async {
            let response = self.connections.request(request).await.map_err(|e| error_chain(&e))?;
            let (parts, body) = response.into_parts();
            let body = Limited::new(body, LARGEST).collect().await;
            let body = body.map_err(|e| format!("the answer broke off: {e}"))?.to_bytes();
            let answer = HttpAnswer {
                headers: parts.headers,
                body,
            };
            Ok((parts.status, answer))
        };
        self.runtime.block_on(async {
            let patient = tokio::time::timeout(PATIENCE, answered).await;
            patient.unwrap_or_else(|_| Err(format!("no answer within {} s", PATIENCE.as_secs())))
        })
    }
}

/// Writes an error with what caused it.
fn error_chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let more = cause.to_string();
        if !text.contains(&more) {
            text += &format!(": {more}");
        }
        next = cause.source();
    }
    text
}

/// Writes what a server says is wrong: the detail of its problem document, or its first words.
fn server_problem(status: StatusCode, body: &[u8]) -> String {
    let document = serde_json::from_slice::<serde_json::Value>(body).ok();
    let detail = document.as_ref().and_then(|d| d.get("detail")?.as_str());
    let words: String = match detail {
        Some(detail) => detail.to_owned(),
        None => String::from_utf8_lossy(body).chars().take(200).collect(),
    };
    format!("{}: {words}", status.as_u16())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_one_of_http_with_or_without_tls() {
        let refused = |url: &str, words: &str| {
            let reported = ServerAddress::new(url, None, None).expect_err(url);
            assert!(reported.contains(words) && reported.contains("--server"), "{reported}");
        };
        assert_eq!(
            ServerAddress::new("http://[::1]:80/pliant/", None, None).map(|a| a.base),
            Ok("http://[::1]:80/pliant".into())
        );
        assert!(ServerAddress::new("https://example.org", None, None).is_ok());
        refused("ftp://example.org", "https://");
        refused("127.0.0.1:7411", "http://");
        refused("http://me:secret@host", "host, port");
        refused("http://a b", "not a URL");
        assert!(
            ServerAddress::new("http://host", Some("a b"), None)
                .expect_err("a space")
                .contains("--token")
        );
    }

    #[test]
    fn a_busy_server_is_asked_again() {
        use std::io::{Read as _, Write as _};
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("an address"));
        let server = std::thread::spawn(move || {
            for answer in ["429 Too Many Requests\r\nretry-after: 1", "200 OK"] {
                let (mut socket, _) = listener.accept().expect("a connection");
                let mut request = Vec::new();
                while !request.ends_with(b"\r\n\r\n") {
                    let mut byte = [0];
                    socket.read_exact(&mut byte).expect("a request");
                    request.extend(byte);
                }
                let answer = format!("HTTP/1.1 {answer}\r\ncontent-length: 2\r\nconnection: close\r\n\r\nok");
                socket.write_all(answer.as_bytes()).expect("an answer");
            }
        });
        let client = HttpClient::new(&ServerAddress::new(&url, None, None).expect("an address")).expect("a client");
        let call = HttpCall::get("/v1/sessions", "");
        assert_eq!(
            client.send(&call).map(|answer| answer.body),
            Ok(Bytes::from_static(b"ok"))
        );
        server.join().expect("both calls came");
    }

    #[test]
    fn what_a_server_says_is_reported() {
        let reported = server_problem(
            StatusCode::UNPROCESSABLE_ENTITY,
            br#"{"detail": "handles[0].id: is empty"}"#,
        );
        assert_eq!(reported, "422: handles[0].id: is empty");
        assert_eq!(server_problem(StatusCode::BAD_GATEWAY, b"upstream"), "502: upstream");
    }
}
