//! JSON Schemas of the messages, as canonical proto-JSON writes them.

use prost_reflect::prost_types::FileDescriptorProto;
use prost_reflect::{DescriptorPool, EnumDescriptor, FieldDescriptor, FileDescriptor, Kind, MessageDescriptor};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

const PACKAGE: &str = "pliant.v1";

/// The messages and enumerations of the schema, with their comments.
pub(super) struct Schemas<'a> {
    pool: &'a DescriptorPool,
    comments: BTreeMap<Vec<i32>, String>,
}

impl<'a> Schemas<'a> {
    /// Reads the comments of the schema's file.
    pub fn new(pool: &'a DescriptorPool) -> Self {
        let file = pool
            .files()
            .find(|file: &FileDescriptor| file.package_name() == PACKAGE);
        let comments = file
            .map(|file| comments(file.file_descriptor_proto()))
            .unwrap_or_default();
        Self { pool, comments }
    }

    /// The comment of a method of the service.
    pub fn rpc_comment(&self, rpc: &str) -> Option<&str> {
        let service = self.pool.services().find(|s| s.package_name() == PACKAGE)?;
        let method = service.methods().find(|m| m.name() == rpc)?;
        self.comment(method.path())
    }

    /// Every message and enumeration by its name below the package.
    pub fn all(&self) -> Map<String, Value> {
        let mut all = BTreeMap::new();
        for message in self
            .pool
            .all_messages()
            .filter(|m| m.package_name() == PACKAGE && !m.is_map_entry())
        {
            all.insert(name(message.full_name()), self.message(&message));
        }
        for kind in self.pool.all_enums().filter(|e| e.package_name() == PACKAGE) {
            all.insert(name(kind.full_name()), self.enumeration(&kind));
        }
        all.into_iter().collect()
    }

    fn comment(&self, path: &[i32]) -> Option<&str> {
        self.comments.get(path).map(String::as_str)
    }

    fn describe(&self, mut schema: Value, path: &[i32]) -> Value {
        if let Some(text) = self.comment(path) {
            schema["description"] = text.into();
        }
        schema
    }

    fn message(&self, message: &MessageDescriptor) -> Value {
        let properties: Map<String, Value> = message
            .fields()
            .map(|field| (field.json_name().to_owned(), self.field(&field)))
            .collect();
        let mut schema = json!({"type": "object", "properties": properties, "additionalProperties": false});
        let choices: Vec<String> = message
            .oneofs()
            .filter(|one| !one.is_synthetic())
            .map(|one| {
                one.fields()
                    .map(|f| f.json_name().to_owned())
                    .collect::<Vec<_>>()
                    .join(", ")
            })
            .collect();
        if !choices.is_empty() {
            schema["$comment"] = format!("at most one of {}", choices.join("; at most one of ")).into();
        }
        self.describe(schema, message.path())
    }

    fn enumeration(&self, kind: &EnumDescriptor) -> Value {
        let values: Vec<String> = kind.values().map(|v| v.name().to_owned()).collect();
        let said: Vec<String> = kind
            .values()
            .filter_map(|v| Some(format!("{}: {}", v.name(), self.comment(v.path())?)))
            .collect();
        let each: Map<String, Value> = kind
            .values()
            .filter_map(|v| Some((v.name().to_owned(), self.comment(v.path())?.into())))
            .collect();
        let schema = json!({"type": "string", "enum": values, "$comment": said.join(" "), "x-enumDescriptions": each});
        self.describe(schema, kind.path())
    }

    fn field(&self, field: &FieldDescriptor) -> Value {
        let schema = if field.is_map() {
            let value = match field.kind() {
                Kind::Message(entry) => one(&entry.map_entry_value_field().kind()),
                _ => json!({}),
            };
            json!({"type": "object", "additionalProperties": value})
        } else if field.is_list() {
            json!({"type": "array", "items": one(&field.kind())})
        } else {
            one(&field.kind())
        };
        self.describe(schema, field.path())
    }
}

fn name(full: &str) -> String {
    full.strip_prefix(PACKAGE)
        .and_then(|n| n.strip_prefix('.'))
        .unwrap_or(full)
        .to_owned()
}

fn one(kind: &Kind) -> Value {
    match kind {
        Kind::Double | Kind::Float => json!({"type": "number"}),
        Kind::Int32 | Kind::Sint32 | Kind::Sfixed32 => json!({"type": "integer", "format": "int32"}),
        Kind::Uint32 | Kind::Fixed32 => json!({"type": "integer", "minimum": 0, "maximum": u32::MAX}),
        // Written as strings, since readers of JSON lose digits of large numbers; read in both forms.
        Kind::Int64 | Kind::Sint64 | Kind::Sfixed64 => json!({"type": ["string", "integer"], "format": "int64"}),
        Kind::Uint64 | Kind::Fixed64 => json!({"type": ["string", "integer"], "format": "uint64"}),
        Kind::Bool => json!({"type": "boolean"}),
        Kind::String => json!({"type": "string"}),
        Kind::Bytes => json!({"type": "string", "contentEncoding": "base64"}),
        Kind::Message(message) => json!({"$ref": format!("#/components/schemas/{}", name(message.full_name()))}),
        Kind::Enum(kind) => json!({"$ref": format!("#/components/schemas/{}", name(kind.full_name()))}),
    }
}

/// Leading comments by the path of what they stand before.
fn comments(file: &FileDescriptorProto) -> BTreeMap<Vec<i32>, String> {
    let locations = file.source_code_info.iter().flat_map(|info| &info.location);
    locations
        .filter_map(|location| {
            let words: Vec<&str> = location.leading_comments().split_whitespace().collect();
            (!words.is_empty()).then(|| (location.path.clone(), words.join(" ")))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_in_the_schema_is_explained() {
        let pool = crate::wire::json::descriptors().unwrap();
        let schemas = Schemas::new(pool);
        let mut bare = Vec::new();
        let mut look = |path: &[i32], what: String| {
            if schemas.comment(path).is_none() {
                bare.push(what);
            }
        };
        for service in pool.services().filter(|s| s.package_name() == PACKAGE) {
            look(service.path(), service.full_name().to_owned());
            for method in service.methods() {
                look(method.path(), method.full_name().to_owned());
            }
        }
        for message in pool
            .all_messages()
            .filter(|m| m.package_name() == PACKAGE && !m.is_map_entry())
        {
            look(message.path(), message.full_name().to_owned());
            for field in message.fields() {
                look(field.path(), field.full_name().to_owned());
            }
        }
        for kind in pool.all_enums().filter(|e| e.package_name() == PACKAGE) {
            look(kind.path(), kind.full_name().to_owned());
            for value in kind.values() {
                look(value.path(), value.full_name().to_owned());
            }
        }
        assert!(bare.is_empty(), "without a comment in the schema: {bare:?}");
    }
}
