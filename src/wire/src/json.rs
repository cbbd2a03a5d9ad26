//! Messages as canonical proto-JSON, by descriptor: no field is written twice.

use super::{Error, pb};
use prost::Message;
use prost_reflect::{DescriptorPool, DeserializeOptions, DynamicMessage, Kind, MessageDescriptor, SerializeOptions};
use serde::de::{self, DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_path_to_error::{Path, Segment};
use std::collections::BTreeSet;
use std::fmt;
use std::sync::LazyLock;

static POOL: LazyLock<Result<DescriptorPool, String>> =
    LazyLock::new(|| DescriptorPool::decode(pb::DESCRIPTORS).map_err(|e| e.to_string()));

/// The descriptors of the schema.
///
/// # Errors
/// [`Error::Internal`] when the descriptors built into this program cannot be read, which a test rules out.
pub fn descriptors() -> Result<&'static DescriptorPool, Error> {
    POOL.as_ref()
        .map_err(|e| Error::Internal(format!("descriptor set: {e}")))
}

fn descriptor(name: &str) -> Result<MessageDescriptor, Error> {
    descriptors()?
        .get_message_by_name(name)
        .ok_or_else(|| Error::Internal(format!("no message {name}")))
}

/// Reads a message from JSON. Unknown fields are refused with their path.
///
/// # Errors
/// [`Error::Malformed`] with the path of the field and what is wrong.
pub fn from_json<M: Message + Default + prost::Name>(text: &[u8]) -> Result<M, Error> {
    let options = DeserializeOptions::new().deny_unknown_fields(true);
    let mut json = serde_json::Deserializer::from_slice(text);
    let mut track = serde_path_to_error::Track::new();
    let tracked = serde_path_to_error::Deserializer::new(&mut json, &mut track);
    let message = descriptor(&M::full_name())?;
    let dynamic = DynamicMessage::deserialize_with_options(message.clone(), tracked, &options);
    let dynamic = dynamic.map_err(|e| {
        let (path, problem) = (track.path(), e.to_string());
        let allowed = match value_at(message, &path) {
            Some(Kind::Message(inner)) if is_about_fields(&problem) => Some(fields_of(&inner)),
            Some(kind) if is_about_a_value(&problem) => allowed_values(&kind).map(|all| format!("allowed are {all}")),
            _ => None,
        };
        Error::Malformed {
            field: place_of(&path.to_string(), &problem),
            problem: allowed.map_or_else(|| problem.clone(), |allowed| format!("{problem}; {allowed}")),
        }
    })?;
    json.end().map_err(|e| Error::Malformed {
        field: "body".into(),
        problem: e.to_string(),
    })?;
    keys_stand_once(text)?;
    M::decode(dynamic.encode_to_vec().as_slice()).map_err(|e| Error::Internal(format!("transcoding: {e}")))
}

/// The path of the field that a problem is about. Tracking ends at the object that holds an unknown field, so the
/// field's own name is taken from the text.
fn place_of(path: &str, problem: &str) -> String {
    // Where the text itself breaks off there is no name; the problem names line and column.
    let path = path.trim_end_matches('?').trim_end_matches('.');
    let named = |start| problem.strip_prefix(start).and_then(|rest: &str| rest.split_once('\''));
    let unknown = named("unrecognized field name '").or_else(|| named(TWICE));
    match (path, unknown) {
        ("", None) => "body".into(),
        ("", Some((name, _))) => name.into(),
        (path, None) => path.into(),
        (path, Some((name, _))) => format!("{path}.{name}"),
    }
}

/// How the refusal of a field that stands twice begins; its name follows.
const TWICE: &str = "there are two fields named '";

/// Refuses a text in which an object has a field twice: which of them is meant?
fn keys_stand_once(text: &[u8]) -> Result<(), Error> {
    let mut json = serde_json::Deserializer::from_slice(text);
    let mut track = serde_path_to_error::Track::new();
    let tracked = serde_path_to_error::Deserializer::new(&mut json, &mut track);
    UniqueKeys.deserialize(tracked).map_err(|e| {
        let problem = e.to_string();
        let field = place_of(&track.path().to_string(), &problem);
        Error::Malformed { field, problem }
    })
}

/// Reads any JSON, and keeps nothing of it but the names of the objects that it is in.
struct UniqueKeys;

impl<'de> DeserializeSeed<'de> for UniqueKeys {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for UniqueKeys {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_unit<E>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_bool<E>(self, _: bool) -> Result<(), E> {
        Ok(())
    }

    fn visit_i64<E>(self, _: i64) -> Result<(), E> {
        Ok(())
    }

    fn visit_u64<E>(self, _: u64) -> Result<(), E> {
        Ok(())
    }

    fn visit_f64<E>(self, _: f64) -> Result<(), E> {
        Ok(())
    }

    fn visit_str<E>(self, _: &str) -> Result<(), E> {
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<(), A::Error> {
        while items.next_element_seed(UniqueKeys)?.is_some() {}
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<(), A::Error> {
        let mut names = BTreeSet::new();
        while let Some(name) = fields.next_key::<String>()? {
            if names.contains(&name) {
                return Err(de::Error::custom(format!("{TWICE}{name}', each may stand once")));
            }
            names.insert(name);
            fields.next_value_seed(UniqueKeys)?;
        }
        Ok(())
    }
}

/// Whether a value was refused that is of the right kind, but none of those that its field has.
fn is_about_a_value(problem: &str) -> bool {
    problem.starts_with("unrecognized enum value") || problem.starts_with("out of range integral type")
}

/// Whether an object was refused for a field that it does not have, or something else where an object is needed.
fn is_about_fields(problem: &str) -> bool {
    problem.starts_with("unrecognized field name") || problem.contains(", expected a map")
}

/// The fields that an object may have, in words.
fn fields_of(message: &MessageDescriptor) -> String {
    let names: Vec<String> = message
        .fields()
        .map(|field| format!("\"{}\"", field.json_name()))
        .collect();
    match names.as_slice() {
        [] => "allowed is an object without fields".into(),
        [one] => format!("allowed is an object with the field {one}"),
        _ => format!("allowed is an object with the fields {}", names.join(", ")),
    }
}

/// Of which kind the value is to which a path leads.
fn value_at(mut message: MessageDescriptor, path: &Path) -> Option<Kind> {
    let mut kind = Kind::Message(message.clone());
    for segment in path {
        match segment {
            Segment::Map { key } => {
                if let Kind::Message(inner) = &kind {
                    message = inner.clone();
                }
                let by_name = || message.get_field_by_name(key);
                kind = message.get_field_by_json_name(key).or_else(by_name)?.kind();
            }
            Segment::Seq { .. } => {}
            // Tracking ends at the object that holds an unknown field.
            Segment::Unknown => break,
            Segment::Enum { .. } => return None,
        }
    }
    Some(kind)
}

/// What a field that has only certain values may be: the names of an enum, or the range of a whole number.
fn allowed_values(kind: &Kind) -> Option<String> {
    Some(match kind {
        Kind::Enum(names) => {
            let names: Vec<String> = names.values().map(|value| format!("\"{}\"", value.name())).collect();
            names.join(", ")
        }
        Kind::Uint32 | Kind::Fixed32 => format!("whole numbers from 0 to {}", u32::MAX),
        Kind::Uint64 | Kind::Fixed64 => format!("whole numbers from 0 to {}", u64::MAX),
        Kind::Int32 | Kind::Sint32 | Kind::Sfixed32 => format!("whole numbers from {} to {}", i32::MIN, i32::MAX),
        Kind::Int64 | Kind::Sint64 | Kind::Sfixed64 => format!("whole numbers from {} to {}", i64::MIN, i64::MAX),
        _ => return None,
    })
}

/// Writes a message as JSON, with fields that have their default value, so that clients need not know the defaults.
///
/// # Errors
/// [`Error::Internal`], never for a message of this schema.
pub fn to_json<M: Message + prost::Name>(message: &M) -> Result<serde_json::Value, Error> {
    let described = descriptor(&M::full_name())?;
    let mut dynamic = DynamicMessage::new(described.clone());
    dynamic
        .merge(message.encode_to_vec().as_slice())
        .map_err(|e| Error::Internal(format!("transcoding: {e}")))?;
    let options = SerializeOptions::new().skip_default_fields(false);
    let mut value = dynamic
        .serialize_with_options(serde_json::value::Serializer, &options)
        .map_err(|e| Error::Internal(format!("JSON: {e}")))?;
    sort_maps(&mut value, &described);
    Ok(value)
}

/// Sorts the entries of all maps of a message, which come in any order, by their keys.
fn sort_maps(value: &mut serde_json::Value, message: &MessageDescriptor) {
    let Some(object) = value.as_object_mut() else {
        return;
    };
    for field in message.fields() {
        let (Some(value), Kind::Message(of)) = (object.get_mut(field.json_name()), field.kind()) else {
            continue;
        };
        match value {
            serde_json::Value::Object(entries) if field.is_map() => {
                entries.sort_keys();
                if let Kind::Message(of) = of.map_entry_value_field().kind() {
                    entries.values_mut().for_each(|value| sort_maps(value, &of));
                }
            }
            serde_json::Value::Array(items) => items.iter_mut().for_each(|item| sort_maps(item, &of)),
            single => sort_maps(single, &of),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_field_is_refused_with_its_path() {
        let refused = |text: &str, path: &str| match from_json::<pb::Job>(text.as_bytes()) {
            Err(Error::Malformed { field: place, problem }) => assert_eq!(place, path, "{problem}"),
            other => panic!("{path}: {other:?}"),
        };
        refused(r#"{"handels": []}"#, "handels");
        refused(
            r#"{"handles": [{"id": "a"}, {"id": "b", "regionn": {}}]}"#,
            "handles[1].regionn",
        );
        refused(
            r#"{"handles": [{"region": {"sphere": {"radius": "wide"}}}]}"#,
            "handles[0].region.sphere.radius",
        );
        refused("[1]", "body");
        refused("{bad", "body");
        refused(r#"{"handles": [{"id": "a", }]}"#, "handles[0]");
        // A field that stands twice, wherever it stands.
        refused(r#"{"handles": [], "handles": []}"#, "handles");
        refused(
            r#"{"handles": [{"id": "a"}, {"id": "b", "region": {"sphere": {"radius": 1, "radius": 2}}}]}"#,
            "handles[1].region.sphere.radius",
        );
        refused(r#"{"options": {}} x"#, "body");
    }

    #[test]
    fn a_value_that_a_field_does_not_have_is_refused_with_those_that_it_has() {
        for (text, path, allowed) in [
            (
                r#"{"create": {"rig": "KEP"}}"#,
                "create.rig",
                r#""FOLLOW", "KEEP", "MOVE""#,
            ),
            (
                r#"{"create": {"boneLengths": "keep"}}"#,
                "create.boneLengths",
                r#""FOLLOW", "KEEP""#,
            ),
            (
                r#"{"create": {"bone_lengths": "keep"}}"#,
                "create.bone_lengths",
                r#""FOLLOW", "KEEP""#,
            ),
            (
                r#"{"handles": [{"id": "a", "constrains": ["POSITION", "TURN"]}]}"#,
                "handles[0].constrains[1]",
                r#""POSITION", "ROTATION", "SCALE""#,
            ),
            (
                r#"{"steps": [{}, {"edit": {"subdivide": {"scheme": "AUTO"}}}]}"#,
                "steps[1].edit.subdivide.scheme",
                r#""LOOP", "MIDPOINT""#,
            ),
            (
                r#"{"create": {"passengers": [{"node": -1}]}}"#,
                "create.passengers[0].node",
                "whole numbers from 0 to 4294967295",
            ),
        ] {
            match from_json::<pb::Job>(text.as_bytes()) {
                Err(Error::Malformed { field: place, problem }) => {
                    assert_eq!(place, path, "{problem}");
                    assert!(problem.ends_with(&format!("; allowed are {allowed}")), "{problem}");
                }
                other => panic!("{path}: {other:?}"),
            }
        }
    }

    #[test]
    fn an_object_that_is_none_or_has_another_field_is_refused_with_the_fields_that_it_has() {
        for (text, path, allowed) in [
            (
                r#"{"handles": [{"id": "a", "region": {"component": 0}}]}"#,
                "handles[0].region.component",
                r#"allowed is an object with the field "index""#,
            ),
            (
                r#"{"handles": [{"id": "a", "region": {"component": {"component": 0}}}]}"#,
                "handles[0].region.component.component",
                r#"allowed is an object with the field "index""#,
            ),
            (
                r#"{"handles": [{"id": "a", "region": {"sphere": {"centre": [0, 0, 0]}}}]}"#,
                "handles[0].region.sphere.centre",
                r#"allowed is an object with the fields "center", "radius""#,
            ),
            (
                r#"{"handels": []}"#,
                "handels",
                r#"allowed is an object with the fields "create", "handles""#,
            ),
        ] {
            match from_json::<pb::Job>(text.as_bytes()) {
                Err(Error::Malformed { field: place, problem }) => {
                    assert_eq!(place, path, "{problem}");
                    assert!(problem.contains(&format!("; {allowed}")), "{problem}");
                }
                other => panic!("{path}: {other:?}"),
            }
        }
    }

    #[test]
    fn a_message_survives_json() {
        let text =
            r#"{"options": {"tolerance": 1e-6, "refine": 0}, "handles": [{"id": "a", "constrains": ["ROTATION"]}]}"#;
        let job: pb::Job = from_json(text.as_bytes()).expect("a job");
        assert_eq!(job.options.and_then(|o| o.refine), Some(0));
        let again: pb::Job = from_json(to_json(&job).expect("JSON").to_string().as_bytes()).expect("a job");
        assert_eq!(again, job);
    }
}
