//! `edit`: the operations of HTTP, with words where a region may stand.

use super::arguments::{EditArguments, below, message_of};
use super::scene::SessionCaller;
use crate::answer::ToolAnswer;
use pliant_core::engine::Error as EngineError;
use pliant_session::Error;
use pliant_wire::pb;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Words inside of one edit.
const MOST_WORDS: usize = 16;

impl SessionCaller {
    /// Edits the topology: an operation as HTTP takes it, with `{"words": …}` wherever a region may stand.
    pub async fn edit(&self, arguments: EditArguments) -> Result<ToolAnswer, Error> {
        let EditArguments {
            session,
            operation,
            picture,
        } = arguments;
        let order = picture.order()?;
        let mut operation = Value::Object(operation);
        let mut asked: Vec<(String, String)> = Vec::new();
        words_in(&operation, "operation", &mut asked);
        if asked.len() > MOST_WORDS {
            let problem = format!(
                "has words for {} regions, at most {MOST_WORDS} are allowed",
                asked.len()
            );
            return Err(Error::invalid("operation", problem));
        }
        if !asked.is_empty() {
            let resolved = self
                .see(&session, move |scene| {
                    let each = asked.iter().map(|(field, words)| {
                        let found = scene.resolver.resolve(words, &format!("{field}.words"))?;
                        Ok((words.clone(), found.set.list()))
                    });
                    each.collect::<Result<BTreeMap<String, Vec<u32>>, EngineError>>()
                })
                .await?;
            put_vertices(&mut operation, &resolved);
        }
        let Value::Object(operation) = operation else {
            return Err(Error::malformed("operation: must be an object"));
        };
        let request = pb::EditRequest {
            session_id: String::new(),
            ..message_of::<pb::EditRequest>(operation, "operation")?
        };
        let edit = pliant_wire::session_edit(&request).map_err(|e| below(e.into(), "operation"))?;
        let done = self.manager.edit(&self.tenant, &session, edit, None).await?;
        let warnings: Vec<String> = done
            .warnings
            .iter()
            .take(8)
            .map(|w| format!("{}: {}", w.code, w.message))
            .collect();
        let mut report = pliant_wire::json::to_json(&done)?;
        if let Some(report) = report.as_object_mut() {
            // Maps between old vertices and new ones say nothing to an agent, and are long.
            ["kept", "curve", "creases", "ms"]
                .iter()
                .for_each(|name| _ = report.shift_remove(*name));
        }
        let seen = self.seen(&session, Vec::new(), order).await?;
        let mut text = format!("The edit is done (revision {}).", done.revision);
        if done.volume_change != 0.0 {
            text += &format!(" Volume {:+.1} %.", 100.0 * done.volume_change);
        }
        if !warnings.is_empty() {
            text += &format!(" Warnings: {}.", warnings.join("; "));
        }
        text += &format!("\nNow: {}", seen.text);
        Ok(ToolAnswer {
            text,
            facts: json!({"edit": report, "model": seen.facts}),
            pictures: seen.pictures,
            ..ToolAnswer::default()
        })
    }
}

/// The words that stand for regions: objects whose only field is `words`.
fn region_words(value: &Map<String, Value>) -> Option<&str> {
    match value.len() {
        1 => value.get("words")?.as_str(),
        _ => None,
    }
}

fn words_in(value: &Value, path: &str, found: &mut Vec<(String, String)>) {
    match value {
        Value::Object(own) => match region_words(own) {
            Some(words) => found.push((path.to_owned(), words.to_owned())),
            None => own
                .iter()
                .for_each(|(name, inner)| words_in(inner, &format!("{path}.{name}"), found)),
        },
        Value::Array(all) => {
            (all.iter().enumerate()).for_each(|(k, inner)| words_in(inner, &format!("{path}[{k}]"), found))
        }
        _ => {}
    }
}

fn put_vertices(value: &mut Value, resolved: &BTreeMap<String, Vec<u32>>) {
    match value {
        Value::Object(own) => match region_words(own).and_then(|words| resolved.get(words)) {
            Some(list) => *value = json!({"vertices": {"indices": list}}),
            None => own.values_mut().for_each(|inner| put_vertices(inner, resolved)),
        },
        Value::Array(all) => all.iter_mut().for_each(|inner| put_vertices(inner, resolved)),
        _ => {}
    }
}
