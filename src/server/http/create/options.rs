//! CreateOptions from a query and a form part. The schema says which keys there are; none is written down here.
//!
//! `?options={…}` is the JSON message; single fields come by name (`?label=…`, `?components=HOLD`), fields of fields with
//! a dot (`?volumeGraph.interval=0.1`). A field that is a message stands for its first field: `?volumeGraph=OFF` is
//! `volumeGraph.mode`, `?weld=0.001` is `weld.tolerance`. The query wins over the form part, a single field over `options`.

use crate::asset::Format;
use crate::server::http::problem::Problem;
use crate::server::http::query;
use crate::session::Error;
use crate::wire;
use crate::wire::pb;
use http::Uri;
use prost::Name as _;
use prost_reflect::{FieldDescriptor, Kind, MessageDescriptor};
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// Options on their way to a message.
pub(super) struct Options {
    /// A built-in model that was asked for.
    pub sample: Option<String>,
    json: Option<String>,
    single: BTreeMap<String, String>,
    part: Map<String, Value>,
    by_type: Option<Format>,
}

fn schema() -> Result<MessageDescriptor, Error> {
    let name = pb::CreateOptions::full_name();
    let found = wire::json::descriptors()?.get_message_by_name(&name);
    found.ok_or_else(|| Error::from(wire::Error::Internal(format!("no message {name}"))))
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
        let mut single = query::parameters(uri, &allowed)?;
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
        let mut options: pb::CreateOptions = wire::json::from_json(text.as_bytes())?;
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
    wire::json::from_json::<pb::CreateOptions>(text)?;
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
