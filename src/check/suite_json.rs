//! Reads the JSON of cases and goldens; an error names its place.

use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use std::fmt;
use std::marker::PhantomData;

/// What some editors put before UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// A suite error is a mistake in a suite's file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct SuiteError {
    /// The file, from the suite's folder.
    pub file: String,
    /// What is wrong, where in the file, and what is allowed.
    pub problem: String,
}

/// A value that is written as a JSON object. What serde derives would also take the fields as a list, without names.
#[derive(Debug)]
pub(super) struct JsonObject<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for JsonObject<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ObjectVisitor<T>(PhantomData<T>);

        impl<'de, T: Deserialize<'de>> Visitor<'de> for ObjectVisitor<T> {
            type Value = T;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a JSON object")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<T, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map))
            }
        }

        deserializer.deserialize_map(ObjectVisitor(PhantomData)).map(Self)
    }
}

/// Makes the error of something that is wrong in a file. `file` is its name in the suite's folder; without a place it is the
/// file itself that is wrong.
pub(super) fn suite_error(file: &str, place: &str, problem: impl fmt::Display) -> SuiteError {
    SuiteError {
        file: file.to_owned(),
        problem: match place {
            "" => problem.to_string(),
            place => format!("{place}: {problem}"),
        },
    }
}

/// Reads a file that is one JSON object.
///
/// # Errors
/// What is wrong with it and where.
pub(super) fn from_json_object<'a, T: Deserialize<'a>>(file: &str, text: &'a [u8]) -> Result<T, SuiteError> {
    if text.starts_with(BYTE_ORDER_MARK) {
        let problem = "begins with a byte order mark, UTF-8 without one is needed";
        return Err(suite_error(file, "", problem));
    }
    let mut json = serde_json::Deserializer::from_slice(text);
    let read: JsonObject<T> = serde_path_to_error::deserialize(&mut json)
        .map_err(|e| suite_error(file, readable_path(&e.path().to_string()), e.inner()))?;
    json.end().map_err(|e| suite_error(file, "", e))?;
    Ok(read.0)
}

/// Writes a path as people read it: where a text breaks off, its last part is not known. Empty for the file itself.
fn readable_path(path: &str) -> &str {
    path.trim_end_matches(['.', '?'])
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Pair {
        left: u32,
        right: u32,
    }

    fn refused(text: &[u8]) -> String {
        from_json_object::<Pair>("x.json", text)
            .expect_err("refused")
            .to_string()
    }

    #[test]
    fn an_object_is_an_object() {
        assert_eq!(
            from_json_object("x.json", br#"{"left": 1, "right": 2}"#),
            Ok(Pair { left: 1, right: 2 })
        );
        for list in ["[1, 2]", "[]", "3", "null", "\"x\""] {
            let reported = refused(list.as_bytes());
            assert!(
                reported.starts_with("x.json: invalid type") && reported.contains("a JSON object"),
                "{reported}"
            );
        }
    }

    #[test]
    fn a_place_is_told_wherever_a_text_breaks_off() {
        for text in ["", "{", r#"{"left"#, r#"{"left": 1, "ri"#, r#"{"left": 1"#] {
            let reported = refused(text.as_bytes());
            assert!(reported.starts_with("x.json: EOF while parsing"), "{text}: {reported}");
        }
        assert!(refused(br#"{"left": "#).starts_with("x.json: left: EOF while parsing"));
        assert!(refused(br#"{"left": 1, "right": 2} x"#).starts_with("x.json: trailing"));
    }

    #[test]
    fn a_byte_order_mark_is_named() {
        let reported = refused(b"\xef\xbb\xbf{\"left\": 1, \"right\": 2}");
        assert!(
            reported.contains("byte order mark") && reported.contains("without one"),
            "{reported}"
        );
    }
}
