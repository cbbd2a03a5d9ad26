//! Type names: where each stands.

use super::modules::SourceFile;
use std::collections::BTreeMap;

/// Every type and trait that files define, as (name, places). Associated types and items for tests only are left out.
pub fn defined_types(files: &[SourceFile]) -> BTreeMap<String, Vec<String>> {
    let mut defined: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for file in files {
        let mut i = 0;
        while i < file.tokens.len() {
            // An implementation defines no types but associated ones; macros define what they are given.
            let skipped = matches!(file.word(i), Some("impl" | "macro_rules")) && is_item_start(file, i);
            if skipped {
                while i < file.tokens.len() && !file.is_sign(i, '{') {
                    i += 1;
                }
                i = file.after_bracket(i);
                continue;
            }
            let keyword = matches!(file.word(i), Some("struct" | "enum" | "union" | "trait" | "type"));
            let name = file.word(i + 1).filter(|name| name.starts_with(char::is_uppercase));
            if let Some(name) = name.filter(|_| keyword && !file.test_only[i] && is_item_start(file, i)) {
                let place = format!("{}:{}", file.place, file.line(i));
                defined.entry(name.to_owned()).or_default().push(place);
                if file.word(i) == Some("trait") {
                    while i < file.tokens.len() && !file.is_sign(i, '{') {
                        i += 1;
                    }
                    i = file.after_bracket(i);
                    continue;
                }
            }
            i += 1;
        }
    }
    defined
}

/// Whether a keyword begins an item: after another one's end, an attribute, or `pub`.
fn is_item_start(file: &SourceFile, i: usize) -> bool {
    i == 0
        || [';', '}', '{', ']', ')'].iter().any(|&sign| file.is_sign(i - 1, sign))
        || matches!(file.word(i - 1), Some("pub" | "unsafe" | "default"))
}
