//! Opening a session over HTTP: the model as the body, or a form with the model, its companions and the options.
//!
//! What the model's format is: `?format=` (or `format` in the options), else the content type, else the first bytes.

mod form;
mod options;
mod received;

use super::body;
use super::problem::{Problem, clip};
use super::request::Caller;
use super::sessions::session_json;
use super::upload_body::next_bytes;
use crate::asset::sample::BuiltInModel;
use crate::asset::{FileSet, Format};
use crate::server::auth;
use crate::server::redirect;
use crate::server::sample;
use crate::server::state::State;
use crate::server::upload_pace::UploadPace;
use crate::session::Error;
use crate::wire;
use axum::extract::{Request, State as From};
use axum::response::Response;
use bytes::Bytes;
use http::{HeaderValue, StatusCode, header};
use options::Options;
use prost::Message as _;
use received::Received;

/// Types that say nothing about the format, among them the defaults of clients.
const GENERAL: [&str; 6] = [
    "",
    "application/octet-stream",
    "binary/octet-stream",
    "application/x-www-form-urlencoded",
    "application/json",
    "text/plain",
];

pub(super) async fn create(From(state): From<State>, caller: Caller, request: Request) -> Result<Response, Problem> {
    if state.draining.is_cancelled() {
        return Err(Error::draining().into());
    }
    // A key that is none is refused before anything is read.
    caller.key()?;
    state
        .manager
        .place_new(request.headers().contains_key(redirect::NODE))
        .await?;
    let mut options = Options::from_query(request.uri())?;
    let kind = body::content_type(request.headers());
    let Received { files, held } = if let Some(name) = options.sample.take() {
        built_in(&name).await?
    } else if kind == "multipart/form-data" {
        form::receive(&state, request, &mut options).await?
    } else {
        let by_type = Format::from_media_type(&kind);
        if by_type.is_none() && !GENERAL.contains(&kind.as_str()) {
            let models = Format::READ.map(Format::media_type).join(", ");
            return Err(Problem::media_type(
                &kind,
                &format!("{models}, application/octet-stream and multipart/form-data"),
            ));
        }
        let received = raw(&state, request).await?;
        options.format_by_type(by_type);
        received
    };
    let options = options.finish()?;
    let key = caller.call_key(|| options.encode_to_vec())?;
    let options = wire::session_options(&options, state.manager.ttl_range(&caller.tenant)?)?;
    // From here on the session's own reservation has room for them.
    drop(held);
    let created = caller
        .manager(&state)
        .create(&caller.tenant, files, options, key)
        .await?;
    let mut response = session_json(&state, &created.value)?;
    if !created.repeated {
        *response.status_mut() = StatusCode::CREATED;
    }
    if let Ok(location) = HeaderValue::from_str(&format!("/v1/sessions/{}", created.value.id)) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

async fn built_in(name: &str) -> Result<Received, Problem> {
    let model = built_in_model("sample", name)?;
    Ok(Received {
        files: FileSet::single(format!("{name}.glb"), sample::glb(model).await?),
        held: None,
    })
}

/// The built-in model of that name, which a parameter gave.
pub(super) fn built_in_model(parameter: &str, name: &str) -> Result<BuiltInModel, Error> {
    BuiltInModel::from_name(name).ok_or_else(|| {
        let (seen, allowed) = (clip(name), BuiltInModel::name_list());
        Error::invalid(parameter, format!("\"{seen}\" is not built in; there is {allowed}"))
    })
}

/// The body as the model.
async fn raw(state: &State, request: Request) -> Result<Received, Problem> {
    let tenant = &auth::principal(request.extensions())?.tenant;
    let mut held = state.hold_upload(tenant, body::announced(request.headers()))?;
    let mut stream = request.into_body().into_data_stream();
    let mut pace = UploadPace::new(&state.config);
    let mut main = Vec::new();
    while let Some(bytes) = next_bytes(state, &mut stream, &mut pace).await? {
        held.grow(bytes.len())?;
        main.extend_from_slice(&bytes);
    }
    if main.is_empty() {
        return Err(Error::malformed("the body is empty; it must be the model").into());
    }
    Ok(Received {
        files: FileSet::single("body", Bytes::from(main)),
        held: Some(held),
    })
}
