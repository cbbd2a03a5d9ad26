//! Opening a session over HTTP: the model as the body, or a form with the parts `model`, `options`, and companion files by their
//! file names.
//!
//! The model's format is that of `?format=` (or `format` in the options), else of the content type, else of the first bytes.
//!
//! The schema says which options there are; none is named here. `?options={…}` is the JSON message; single fields come by name
//! (`?label=…`, `?components=HOLD`), fields of fields with a dot (`?volumeGraph.interval=0.1`). A field that is a message stands
//! for its first field: `?volumeGraph=OFF` is `volumeGraph.mode`, `?weld=0.001` is `weld.tolerance`. The query wins over the
//! form part, a single field over `options`.

use super::body;
use super::problem::{Problem, clip};
use super::request::{Caller, parameters};
use super::sessions::session_json;
use super::upload::{FormReader, next_bytes};
use crate::state::ServerState;
use crate::uploads::{HeldUpload, UploadPace};
use crate::{auth, redirect};
use axum::extract::{Request, State};
use axum::response::Response;
use bytes::Bytes;
use http::{HeaderValue, StatusCode, Uri, header};
use multer::Field;
use pliant_asset::sample::BuiltInModel;
use pliant_asset::{FileSet, Format};
use pliant_session::Error;
use pliant_wire::pb;
use prost::{Message as _, Name as _};
use prost_reflect::{FieldDescriptor, Kind, MessageDescriptor};
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// Types that do not name a format, among them the defaults of clients.
const GENERAL: [&str; 6] = [
    "",
    "application/octet-stream",
    "binary/octet-stream",
    "application/x-www-form-urlencoded",
    "application/json",
    "text/plain",
];

pub(super) async fn create(
    State(state): State<ServerState>,
    caller: Caller,
    request: Request,
) -> Result<Response, Problem> {
    if state.draining.is_cancelled() {
        return Err(Error::draining().into());
    }
    // An invalid key is rejected before anything is read.
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
        receive_form(&state, request, &mut options).await?
    } else {
        let by_type = Format::from_media_type(&kind);
        if by_type.is_none() && !GENERAL.contains(&kind.as_str()) {
            // Files of splats have no type of their own.
            let own = Format::READ.into_iter().filter(|format| !format.holds_splats_alone());
            let models = own.map(Format::media_type).collect::<Vec<_>>().join(", ");
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
    let options = pliant_wire::session_options(&options, state.manager.ttl_range(&caller.tenant)?)?;
    // From here on the session's own reservation has room for them.
    drop(held);
    let created = caller
        .manager(&state)
        .create(&caller.tenant, files, options, key)
        .await?;
    let location = format!("/v1/sessions/{}", created.value.id);
    let mut response = session_json(&state, created.value)?;
    if !created.repeated {
        *response.status_mut() = StatusCode::CREATED;
    }
    if let Ok(location) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

async fn built_in(name: &str) -> Result<Received, Problem> {
    let model = built_in_model("sample", name)?;
    Ok(Received {
        files: FileSet::single(format!("{name}.glb"), model.glb()),
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
async fn raw(state: &ServerState, request: Request) -> Result<Received, Problem> {
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

/// Files of an upload, which count as under way until dropped.
struct Received {
    files: FileSet,
    held: Option<HeldUpload>,
}

/// Companion files of one form.
const MAX_COMPANIONS: usize = 1000;

/// Receives a form.
async fn receive_form(state: &ServerState, request: Request, options: &mut Options) -> Result<Received, Problem> {
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
    held: HeldUpload,
    model: Option<(String, Bytes)>,
    by_type: Option<Format>,
    options_seen: bool,
    companions: BTreeMap<String, Bytes>,
}

impl ModelForm {
    async fn take(
        &mut self,
        state: &ServerState,
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

/// Create options from a query, a form part and a content type.
struct Options {
    /// A built-in model that was asked for.
    pub sample: Option<String>,
    json: Option<String>,
    single: BTreeMap<String, String>,
    part: Map<String, Value>,
    by_type: Option<Format>,
}

fn schema() -> Result<MessageDescriptor, Error> {
    let name = pb::CreateOptions::full_name();
    let found = pliant_wire::json::descriptors()?.get_message_by_name(&name);
    found.ok_or_else(|| Error::from(pliant_wire::Error::Internal(format!("no message {name}"))))
}

impl Options {
    /// Reads the query of a request.
    pub fn from_query(uri: &Uri) -> Result<Self, Problem> {
        let mut allowed = vec!["options".to_owned(), "sample".to_owned()];
        for field in schema()?.fields() {
            allowed.push(field.json_name().to_owned());
            if let Kind::Message(_) = field.kind() {
                allowed.push(format!("{}.", field.json_name()));
            }
        }
        let allowed: Vec<&str> = allowed.iter().map(String::as_str).collect();
        let mut single = parameters(uri, &allowed)?;
        let (json, sample) = (single.remove("options"), single.remove("sample"));
        Ok(Self {
            sample,
            json,
            single,
            part: Map::new(),
            by_type: None,
        })
    }

    /// Takes the `options` part of a form.
    pub fn take_part(&mut self, text: &[u8]) -> Result<(), Problem> {
        self.part = object(text)?;
        Ok(())
    }

    /// The format that the content type says; an explicit one wins.
    pub fn format_by_type(&mut self, format: Option<Format>) {
        self.by_type = format;
    }

    /// The message.
    pub fn finish(self) -> Result<pb::CreateOptions, Problem> {
        let mut whole = self.part;
        if let Some(json) = &self.json {
            merge(&mut whole, object(json.as_bytes())?);
        }
        let schema = schema()?;
        for (path, text) in self.single {
            set(&mut whole, &schema, &path, text)?;
        }
        let text = Value::Object(whole).to_string();
        let mut options: pb::CreateOptions = pliant_wire::json::from_json(text.as_bytes())?;
        if options.format.is_empty()
            && let Some(format) = self.by_type
        {
            options.format = format.name().to_owned();
        }
        Ok(options)
    }
}

/// A JSON text that must be CreateOptions, as an object. Reading it as the message first gives errors their place.
fn object(text: &[u8]) -> Result<Map<String, Value>, Problem> {
    pliant_wire::json::from_json::<pb::CreateOptions>(text)?;
    match serde_json::from_slice(text) {
        Ok(Value::Object(object)) => Ok(object),
        _ => Err(Error::malformed("options: must be a JSON object").into()),
    }
}

fn merge(into: &mut Map<String, Value>, from: Map<String, Value>) {
    for (name, value) in from {
        match (into.get_mut(&name), value) {
            (Some(Value::Object(inner)), Value::Object(value)) => merge(inner, value),
            (_, value) => {
                into.insert(name, value);
            }
        }
    }
}

fn set(whole: &mut Map<String, Value>, schema: &MessageDescriptor, path: &str, text: String) -> Result<(), Error> {
    let (name, rest) = path
        .split_once('.')
        .map_or((path, None), |(name, rest)| (name, Some(rest)));
    let unknown = || Error {
        field: Some(path.to_owned()),
        ..Error::malformed(format!("{path}: is not a query parameter"))
    };
    let field = schema.get_field_by_json_name(name).ok_or_else(unknown)?;
    match (field.kind(), rest) {
        (Kind::Message(inner), rest) => {
            let first = inner.get_field(1).ok_or_else(unknown)?;
            let rest = rest.unwrap_or_else(|| first.json_name());
            let place = whole.entry(name).or_insert_with(|| Value::Object(Map::new()));
            if !place.is_object() {
                *place = Value::Object(Map::new());
            }
            match place {
                Value::Object(place) => set(place, &inner, rest, text),
                _ => Ok(()),
            }
        }
        (_, Some(_)) => Err(unknown()),
        (_, None) => {
            whole.insert(name.to_owned(), value(&field, text));
            Ok(())
        }
    }
}

/// Proto-JSON takes numbers as texts; names of enumerations are in capitals.
fn value(field: &FieldDescriptor, text: String) -> Value {
    match field.kind() {
        Kind::Enum(_) => Value::String(text.to_ascii_uppercase()),
        Kind::Bool => text.parse().map_or(Value::String(text), Value::Bool),
        _ => Value::String(text),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(query: &str) -> Result<pb::CreateOptions, Problem> {
        Options::from_query(&format!("/v1/sessions?{query}").parse().unwrap())?.finish()
    }

    #[test]
    fn single_fields_are_read_by_the_schema() {
        let read =
            options("label=a%20b&components=hold&weights=COTANGENT&volumeGraph=OFF&volumeGraph.interval=0.25&weld=0.5")
                .unwrap();
        assert_eq!(read.label, "a b");
        assert_eq!(read.components(), pb::create_options::Components::Hold);
        assert_eq!(read.weights(), pb::create_options::Weights::Cotangent);
        let graph = read.volume_graph.unwrap();
        assert_eq!(
            (graph.mode(), graph.interval),
            (pb::create_options::volume_graph::Mode::Off, 0.25)
        );
        assert_eq!(read.weld.unwrap().tolerance, 0.5);
    }

    #[test]
    fn a_single_field_wins_over_the_json_and_the_json_over_the_part() {
        let mut merged = Options::from_query(
            &"/v1/sessions?options=%7B%22label%22%3A%22json%22%2C%22ttl%22%3A%221m%22%7D&label=single"
                .parse()
                .unwrap(),
        )
        .unwrap();
        merged
            .take_part(br#"{"label": "part", "ttl": "9m", "format": "obj"}"#)
            .unwrap();
        let read = merged.finish().unwrap();
        assert_eq!(
            (read.label.as_str(), read.ttl.as_str(), read.format.as_str()),
            ("single", "1m", "obj")
        );
    }

    #[test]
    fn what_the_schema_does_not_know_is_refused() {
        for query in [
            "colour=red",
            "volumeGraph.colour=red",
            "label.x=1",
            "options=%5B%5D",
            "components=SOMETIMES",
            "options=%7B%22x%22%3A1%7D",
        ] {
            assert!(options(query).is_err(), "{query}");
        }
    }
}
