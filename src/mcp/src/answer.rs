//! Answers of tools: words, pictures, numbers, and errors in the service's own words.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use pliant_session::Error;
use rmcp::model::{CallToolResult, ContentBlock, ResourceContents};
use serde_json::{Value, json};

/// What a tool answers.
#[derive(Debug, Default)]
pub(crate) struct ToolAnswer {
    /// What an agent reads.
    pub text: String,
    /// The same in numbers.
    pub facts: Value,
    /// PNG files.
    pub pictures: Vec<Vec<u8>>,
    /// Files that go out in the answer: name, media type, bytes.
    pub files: Vec<(String, &'static str, Vec<u8>)>,
}

impl ToolAnswer {
    /// The answer as the protocol has it.
    pub fn into_result(self) -> CallToolResult {
        let mut content = vec![ContentBlock::text(self.text)];
        let picture = |png: &Vec<u8>| ContentBlock::image(STANDARD.encode(png), "image/png");
        content.extend(self.pictures.iter().map(picture));
        for (name, media_type, bytes) in &self.files {
            let uri = format!("pliant://export/{name}");
            let blob = ResourceContents::blob(STANDARD.encode(bytes), uri).with_mime_type(*media_type);
            content.push(ContentBlock::resource(blob));
        }
        let mut result = CallToolResult::success(content);
        result.structured_content = Some(self.facts);
        result
    }
}

/// An error as the answer of a tool: what, where and what is allowed.
pub(crate) fn refusal(error: &Error) -> CallToolResult {
    let mut facts = json!({"code": error.code.name(), "message": error.message});
    if let Some(field) = &error.field {
        facts["field"] = field.as_str().into();
    }
    if let Some(seconds) = error.retry_after_s {
        facts["retryAfterSeconds"] = seconds.into();
    }
    let mut text = format!("{}: {}", error.code.name(), error.message);
    if let Some(owner) = &error.owner {
        text += &format!(" (the session is at the node \"{}\", {})", owner.node, owner.address);
        facts["node"] = owner.address.to_string().into();
    }
    let mut result = CallToolResult::error(vec![ContentBlock::text(text)]);
    result.structured_content = Some(facts);
    result
}

/// A number with as many digits as matter in a sentence.
pub(crate) fn short(x: f64) -> String {
    let text = format!("{x:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    match text {
        "" | "-0" => "0".to_owned(),
        text => text.to_owned(),
    }
}

/// A point in a sentence.
pub(crate) fn place(p: glam::DVec3) -> String {
    format!("({}, {}, {})", short(p.x), short(p.y), short(p.z))
}
