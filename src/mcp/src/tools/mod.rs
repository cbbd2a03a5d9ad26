//! The tools: their names, schemas and descriptions (`tools.json`), and what each does.

mod arguments;
mod calls;
mod edits;
mod files;
mod pose;
mod scene;

pub(crate) use scene::SessionCaller;

use crate::answer::ToolAnswer;
use crate::folder::AgentFolder;
use arguments::read;
use pliant_session::Error;
use rmcp::model::Tool;
use serde_json::{Map, Value};

/// The tools as an agent reads of them.
const TOOLS: &str = include_str!("../tools.json");

/// The list of tools, those of one that reads files or one that gets them in calls.
pub(crate) fn list(has_folder: bool) -> Result<Vec<Tool>, serde_json::Error> {
    let mut tools: Vec<Tool> = serde_json::from_str(TOOLS)?;
    for tool in &mut tools {
        let mut schema = (*tool.input_schema).clone();
        if let Some(Value::Object(fields)) = schema.get_mut("properties") {
            let unused: &[&str] = match (tool.name.as_ref(), has_folder) {
                ("open", true) => &["data", "name"],
                ("open", false) => &["path"],
                ("export", false) => &["path", "overwrite"],
                _ => &[],
            };
            unused.iter().for_each(|name| _ = fields.shift_remove(*name));
        }
        if tool.name == "export" && has_folder {
            schema.insert("required".to_owned(), serde_json::json!(["session", "path"]));
        }
        tool.input_schema = schema.into();
    }
    Ok(tools)
}

impl SessionCaller {
    /// Runs a tool; `None` where there is none of that name.
    pub async fn run(
        &self,
        name: &str,
        arguments: Option<Map<String, Value>>,
        folder: Option<&AgentFolder>,
    ) -> Option<Result<ToolAnswer, Error>> {
        // Boxed one by one: together their futures are large.
        macro_rules! run {
            ($arguments:ident => $call:expr) => {
                match read(arguments) {
                    Ok($arguments) => Box::pin($call).await,
                    Err(error) => Err(error),
                }
            };
        }
        Some(match name {
            "open" => run!(own => self.open(own, folder)),
            "look" => run!(own => self.look(own)),
            "region" => run!(own => self.region(own)),
            "pose" => run!(own => self.pose(own)),
            "edit" => run!(own => self.edit(own)),
            "undo" => run!(own => self.step(own, true)),
            "redo" => run!(own => self.step(own, false)),
            "export" => run!(own => self.export(own, folder)),
            "close" => run!(own => self.close(own)),
            "sessions" => run!(own => self.sessions(own)),
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schemas_are_strict_and_every_field_is_described() {
        fn check(schema: &Value, place: &str) {
            if schema["type"] == "object" && schema.get("properties").is_some() {
                assert_eq!(schema["additionalProperties"], Value::Bool(false), "{place}");
                for (name, field) in schema["properties"].as_object().expect("fields") {
                    let place = format!("{place}.{name}");
                    assert!(
                        field["description"].as_str().is_some_and(|text| text.len() > 8),
                        "{place}"
                    );
                    check(field, &place);
                    check(&field["items"], &place);
                }
            }
        }
        for has_folder in [true, false] {
            let tools = list(has_folder).expect("tools");
            assert_eq!(tools.len(), 10);
            for tool in tools {
                assert!(tool.description.is_some_and(|text| text.len() > 40), "{}", tool.name);
                check(&Value::Object((*tool.input_schema).clone()), &tool.name);
            }
        }
    }
}
