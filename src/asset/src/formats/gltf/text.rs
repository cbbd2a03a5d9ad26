//! JSON text that is read where it lies and edited where it must change.
//!
//! A glTF document is never rebuilt: its values are slices of the text, and an [`JsonEdits`] list splices new text over some
//! of them. Key order, number texts, escapes, duplicate keys and white space of everything else stay as they were.

use super::schema::WholeNumber;
use serde::de::{Deserializer as _, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;

/// One key of an object, and its value as a slice of the text.
pub(super) struct JsonMember<'a> {
    pub(super) key: String,
    pub(super) value: &'a str,
}

/// The members of the object that `text` holds, in order, duplicates included.
pub(super) fn members(text: &str) -> Result<Vec<JsonMember<'_>>, serde_json::Error> {
    struct Collect;
    impl<'de> Visitor<'de> for Collect {
        type Value = Vec<JsonMember<'de>>;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("an object")
        }
        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
            let mut list = Vec::new();
            while let Some(key) = map.next_key::<String>()? {
                let value = map.next_value::<&'de RawValue>()?.get();
                list.push(JsonMember { key, value });
            }
            Ok(list)
        }
    }
    let mut reader = serde_json::Deserializer::from_str(text);
    let list = reader.deserialize_map(Collect)?;
    reader.end()?;
    Ok(list)
}

/// The items of the array that `text` holds.
pub(super) fn items(text: &str) -> Result<Vec<&str>, serde_json::Error> {
    let raw: Vec<&RawValue> = serde_json::from_str(text)?;
    Ok(raw.into_iter().map(RawValue::get).collect())
}

/// How many items the array that `text` holds has, without keeping any. Stops with an error when `goes_on` says so.
pub(super) fn count_items(text: &str, goes_on: impl FnMut(usize) -> bool) -> Result<usize, serde_json::Error> {
    struct Count<F>(F);
    impl<'de, F: FnMut(usize) -> bool> Visitor<'de> for Count<F> {
        type Value = usize;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a sequence")
        }
        fn visit_seq<A: SeqAccess<'de>>(mut self, mut seq: A) -> Result<usize, A::Error> {
            let mut count = 0;
            while seq.next_element::<IgnoredAny>()?.is_some() {
                if !(self.0)(count) {
                    return Err(A::Error::custom("stopped"));
                }
                count += 1;
            }
            Ok(count)
        }
    }
    let mut reader = serde_json::Deserializer::from_str(text);
    let count = reader.deserialize_seq(Count(goes_on))?;
    reader.end()?;
    Ok(count)
}

/// The value of `key` in the object that `text` holds; the last one when the key is repeated.
pub(super) fn value_of<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    members(text)
        .ok()?
        .into_iter()
        .rev()
        .find(|m| m.key == key)
        .map(|m| m.value)
}

/// The items of the array under `key` in the object that `text` holds; none where there is no such array.
pub(super) fn list_of<'a>(text: &'a str, key: &str) -> Vec<&'a str> {
    value_of(text, key)
        .and_then(|array| items(array).ok())
        .unwrap_or_default()
}

/// The value that lies in an object below several keys.
pub(super) fn value_at<'a>(object: &'a str, path: &[&str]) -> Option<&'a str> {
    path.iter().try_fold(object, |object, key| value_of(object, key))
}

/// The index that a text holds.
pub(super) fn parse_index(json: &str) -> Option<usize> {
    serde_json::from_str::<WholeNumber>(json).ok().map(WholeNumber::index)
}

/// The index that an object has under a key.
pub(super) fn index_of(object: &str, key: &str) -> Option<usize> {
    value_of(object, key).and_then(parse_index)
}

/// The text that an object has under a key.
pub(super) fn string_of(object: &str, key: &str) -> Option<String> {
    serde_json::from_str(value_of(object, key)?).ok()
}

/// What a channel of an animation moves: a node, and its path as JSON, which is empty where there is none.
pub(super) fn channel_target(channel: &str) -> Option<(usize, &str)> {
    let target = value_of(channel, "target")?;
    Some((index_of(target, "node")?, value_of(target, "path").unwrap_or_default()))
}

/// The path of a channel that moves morph targets.
pub(super) const WEIGHTS: &str = "\"weights\"";

/// A JSON string literal.
pub(super) fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// The texts or numbers of a list as one JSON array.
pub(super) fn json_array<T: ToString>(list: impl IntoIterator<Item = T>) -> String {
    let texts: Vec<String> = list.into_iter().map(|item| item.to_string()).collect();
    format!("[{}]", texts.join(","))
}

/// Keys with values, which are JSON, as one object.
pub(super) fn json_object<K: AsRef<str>, V: fmt::Display>(members: impl IntoIterator<Item = (K, V)>) -> String {
    let one = |(key, value): (K, V)| format!("{}:{value}", quoted(key.as_ref()));
    format!("{{{}}}", members.into_iter().map(one).collect::<Vec<_>>().join(","))
}

/// The object without some of its keys.
pub(super) fn without_keys(object: &str, keys: &[&str]) -> String {
    let mut text = object.to_owned();
    for key in keys {
        if value_of(&text, key).is_some() {
            let mut edits = JsonEdits::new(&text);
            edits.remove(&text, key);
            text = edits.apply();
        }
    }
    text
}

/// The object without some extensions; and without `extensions` when none is left.
pub(super) fn without_extensions(object: &str, names: &[&str]) -> String {
    let Some(extensions) = value_of(object, "extensions") else {
        return object.to_owned();
    };
    let left = without_keys(extensions, names);
    if left.len() == extensions.len() {
        return object.to_owned();
    }
    if members(&left).is_ok_and(|list| list.is_empty()) {
        return without_keys(object, &["extensions"]);
    }
    let mut edits = JsonEdits::new(object);
    edits.set(object, "extensions", &left);
    edits.apply()
}

/// The object with a key set.
pub(super) fn with_member(object: &str, key: &str, json: impl fmt::Display) -> String {
    let mut edits = JsonEdits::new(object);
    edits.set(object, key, json);
    edits.apply()
}

/// A list of places of one text and what to put there.
pub(super) struct JsonEdits<'a> {
    text: &'a str,
    list: Vec<(Range<usize>, String)>,
}

impl<'a> JsonEdits<'a> {
    /// No edits of `text` yet.
    pub(super) fn new(text: &'a str) -> Self {
        Self { text, list: Vec::new() }
    }

    /// Whether nothing is to be changed.
    pub(super) fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Puts `with` in place of `part`, which must be a slice of the text.
    pub(super) fn replace(&mut self, part: &'a str, with: impl Into<String>) {
        let range = self.range_of(part);
        self.list.push((range, with.into()));
    }

    /// Gives `key` of `object` (a slice of the text that holds an object) the value `json`: in its place when the key is
    /// there, else after the last member.
    pub(super) fn set(&mut self, object: &'a str, key: &str, json: impl fmt::Display) {
        let list = members(object).unwrap_or_default();
        match (list.iter().rev().find(|m| m.key == key), list.last()) {
            (Some(member), _) => self.replace(member.value, json.to_string()),
            (None, Some(last)) => {
                let end = self.range_of(last.value).end;
                self.list.push((end..end, format!(",{}:{json}", quoted(key))));
            }
            (None, None) => self.fill(object, &format!("{}:{json}", quoted(key))),
        }
    }

    /// Gives an object without members one, or one more when it was given some before.
    fn fill(&mut self, object: &'a str, member: &str) {
        let range = self.range_of(object);
        match self.list.iter_mut().find(|(filled, _)| *filled == range) {
            Some((_, text)) if text.ends_with('}') => {
                text.pop();
                *text += &format!(",{member}}}");
            }
            _ => self.list.push((range, format!("{{{member}}}"))),
        }
    }

    /// Takes `key` out of `object`, with the comma that is then one too many.
    pub(super) fn remove(&mut self, object: &'a str, key: &str) {
        let list = members(object).unwrap_or_default();
        let Some(at) = list.iter().rposition(|m| m.key == key) else {
            return;
        };
        let end = self.range_of(list[at].value).end;
        let range = if let Some(before) = at.checked_sub(1) {
            self.range_of(list[before].value).end..end
        } else {
            let start = self.range_of(object).start + 1;
            // The first of several: its comma follows.
            let comma = if list.len() > 1 {
                self.text[end..].find(',').map_or(0, |i| i + 1)
            } else {
                0
            };
            start..end + comma
        };
        self.list.push((range, String::new()));
    }

    /// Takes an extension out of `object`, and with it a list of extensions that would be empty, which is an error of its own.
    pub(super) fn remove_extension(&mut self, object: &'a str, name: &str) {
        let Some(extensions) = value_of(object, "extensions") else {
            return;
        };
        match members(extensions).map_or(0, |list| list.iter().filter(|m| m.key != name).count()) {
            0 => self.remove(object, "extensions"),
            _ => self.remove(extensions, name),
        }
    }

    /// Takes an item that is not the first out of its array, with the comma before it.
    pub(super) fn remove_item(&mut self, item: &'a str) {
        let range = self.range_of(item);
        let comma = self.text[..range.start].rfind(',').unwrap_or(range.start);
        self.list.push((comma..range.end, String::new()));
    }

    /// Adds `json` after the last item of `array`, a slice of the text that holds an array.
    pub(super) fn push(&mut self, array: &'a str, json: &[String]) {
        if json.is_empty() {
            return;
        }
        let added = json.join(",");
        match items(array).unwrap_or_default().last() {
            Some(last) => {
                let end = self.range_of(last).end;
                self.list.push((end..end, format!(",{added}")));
            }
            None => self.replace(array, format!("[{added}]")),
        }
    }

    /// Adds `json` to `array`, the value of `key` of `object`, or gives `object` such an array when there is none.
    pub(super) fn push_or_set(&mut self, object: &'a str, key: &str, array: Option<&'a str>, json: &[String]) {
        match array {
            Some(array) => self.push(array, json),
            None if json.is_empty() => {}
            None => self.set(object, key, json_array(json)),
        }
    }

    /// The text with every edit made.
    pub(super) fn apply(mut self) -> String {
        // Stable: insertions at one place stay in the order in which they were asked for.
        self.list.sort_by_key(|(range, _)| (range.start, range.end));
        let grown: usize = self.list.iter().map(|(_, with)| with.len()).sum();
        let mut out = String::with_capacity(self.text.len() + grown);
        let mut at = 0;
        for (range, with) in &self.list {
            debug_assert!(at <= range.start, "edits overlap");
            out.push_str(&self.text[at..range.start.max(at)]);
            out.push_str(with);
            at = at.max(range.end);
        }
        out.push_str(&self.text[at..]);
        out
    }

    fn range_of(&self, part: &str) -> Range<usize> {
        place_in(self.text, part)
    }
}

/// New texts of top-level members of a document; `None` for those that go.
#[derive(Default)]
pub(super) struct JsonSections(BTreeMap<&'static str, Option<String>>);

impl JsonSections {
    /// Gives a member a new value.
    pub(super) fn set(&mut self, key: &'static str, json: String) {
        self.0.insert(key, Some(json));
    }

    /// Gives a member a list of items, which are JSON; without any the member goes.
    pub(super) fn set_list(&mut self, key: &'static str, list: &[String]) {
        self.0.insert(key, (!list.is_empty()).then(|| json_array(list)));
    }

    /// Edits the text of a document: the new members stand in place of the old ones, added ones follow.
    pub(super) fn edit<'a>(&self, text: &'a str, edits: &mut JsonEdits<'a>) {
        for (key, json) in &self.0 {
            match json {
                Some(json) => edits.set(text, key, json),
                None => edits.remove(text, key),
            }
        }
    }

    /// As [`JsonSections::edit`], without the white space between members.
    pub(super) fn replace_in(mut self, text: &str) -> String {
        let stored = members(text).unwrap_or_default().into_iter();
        let stored = stored.filter_map(|JsonMember { key, value }| {
            let new = self.0.remove(key.as_str());
            Some((key, new.unwrap_or_else(|| Some(value.to_owned()))?))
        });
        let mut all: Vec<(String, String)> = stored.collect();
        let added = self.0.into_iter();
        all.extend(added.filter_map(|(key, json)| Some((key.to_owned(), json?))));
        json_object(all)
    }
}

/// Where `part`, a slice of `text`, lies in it.
pub(super) fn place_in(text: &str, part: &str) -> Range<usize> {
    let start = (part.as_ptr() as usize).wrapping_sub(text.as_ptr() as usize);
    assert!(
        start <= text.len() && part.len() <= text.len() - start,
        "a part of the edited text"
    );
    start..start + part.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edit_leaves_every_other_byte_alone() {
        let text = "{ \"b\" : 1.50e0,\n\"\\u0061\":[1 , 2.0], \"x\":\"\\/\\u00e9\", \"x\": {\"deep\":[]} }";
        let mut edits = JsonEdits::new(text);
        edits.replace(items(value_of(text, "a").expect("escaped key")).expect("array")[1], "7");
        assert_eq!(edits.apply(), text.replace("2.0", "7"));
    }

    #[test]
    fn members_keep_order_and_duplicates() {
        let keys: Vec<_> = members(r#"{"z":1,"a":2,"z":3}"#)
            .expect("object")
            .into_iter()
            .map(|m| (m.key, m.value))
            .collect();
        assert_eq!(keys, [("z".into(), "1"), ("a".into(), "2"), ("z".into(), "3")]);
        assert_eq!(value_of(r#"{"z":1,"a":2,"z":3}"#, "z"), Some("3"));
    }

    #[test]
    fn set_adds_or_replaces_and_remove_takes_the_comma_with_it() {
        let cases = [
            ("{}", r#"{"k":1}"#, "{}"),
            (r#"{ "a" : 2 }"#, r#"{ "a" : 2,"k":1 }"#, r#"{ "a" : 2 }"#),
            (r#"{"k":[] , "a":2}"#, r#"{"k":1 , "a":2}"#, r#"{ "a":2}"#),
            (r#"{"a":2 , "k" : {"k":3}}"#, r#"{"a":2 , "k" : 1}"#, r#"{"a":2}"#),
            (r#"{"k" : 5 }"#, r#"{"k" : 1 }"#, "{ }"),
        ];
        for (text, set, removed) in cases {
            let mut edits = JsonEdits::new(text);
            edits.set(text, "k", "1");
            assert_eq!(edits.apply(), set);
            let mut edits = JsonEdits::new(text);
            edits.remove(text, "k");
            assert_eq!(edits.apply(), removed);
        }
    }

    #[test]
    fn several_additions_in_one_place_keep_their_order() {
        let text = r#"{"list":[ 1 ],"none":[]}"#;
        let mut edits = JsonEdits::new(text);
        edits.push(value_of(text, "list").expect("list"), &["2".into(), "3".into()]);
        edits.push(value_of(text, "none").expect("none"), &["4".into()]);
        edits.set(text, "x", "5");
        edits.set(text, "y", "6");
        assert_eq!(edits.apply(), r#"{"list":[ 1,2,3 ],"none":[4],"x":5,"y":6}"#);
    }

    #[test]
    fn an_object_without_members_takes_several() {
        let text = r#"[{ },{}]"#;
        let objects = items(text).expect("a list");
        let mut edits = JsonEdits::new(text);
        edits.set(objects[0], "a", "1");
        edits.set(objects[1], "c", "3");
        edits.set(objects[0], "b", "[2]");
        assert_eq!(edits.apply(), r#"[{"a":1,"b":[2]},{"c":3}]"#);
    }

    #[test]
    fn extensions_go_and_take_an_empty_object_with_them() {
        let text = r#"{"a":1,"extensions":{"X":{},"Y":{}},"b":2}"#;
        assert_eq!(
            without_extensions(text, &["X"]),
            r#"{"a":1,"extensions":{"Y":{}},"b":2}"#
        );
        assert_eq!(without_extensions(text, &["X", "Y"]), r#"{"a":1,"b":2}"#);
        assert_eq!(without_extensions(text, &["Z"]), text);
        assert_eq!(without_keys(r#"{"a":1,"b":2}"#, &["a", "b"]), "{}");
    }

    #[test]
    fn a_hundred_thousand_brackets_are_skipped_without_recursion() {
        let text = format!("{{\"extras\":{}{}}}", "[".repeat(100_000), "]".repeat(100_000));
        assert_eq!(members(&text).expect("valid JSON").len(), 1);
    }
}
