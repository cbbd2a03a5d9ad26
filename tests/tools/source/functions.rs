//! Functions: their names, lengths and parameters.

use super::modules::SourceFile;

/// A function that a file defines.
pub struct DefinedFunction {
    /// Its name.
    pub name: String,
    /// `src/mesh/weld.rs:12`.
    pub place: String,
    /// From `fn` to its closing brace.
    pub lines: usize,
    /// `self` counts.
    pub parameters: usize,
    /// Whether a trait of others gives the name: it stands in `impl … for …`.
    pub named_by_trait: bool,
}

/// Every function of the files outside of tests.
pub fn defined_functions(files: &[SourceFile]) -> Vec<DefinedFunction> {
    let mut found = Vec::new();
    for file in files {
        // Ends of the implementations of traits that are open.
        let mut implementation_end = 0;
        for i in 0..file.tokens.len() {
            if file.word(i) == Some("impl") && i >= implementation_end {
                implementation_end = implementation_of_a_trait(file, i).unwrap_or(implementation_end);
            }
            let name = file
                .word(i + 1)
                .filter(|_| file.word(i) == Some("fn") && !file.test_only[i]);
            let Some(name) = name else { continue };
            let Some(open) = (i + 2..file.tokens.len()).find(|&k| file.is_sign(k, '(')) else {
                continue;
            };
            let open = parameter_list(file, i + 2).unwrap_or(open);
            let end = body_end(file, file.after_bracket(open));
            found.push(DefinedFunction {
                name: name.to_owned(),
                place: format!("{}:{}", file.place, file.line(i)),
                lines: file.line(end.saturating_sub(1)) + 1 - file.line(i),
                parameters: count_parameters(file, open),
                named_by_trait: i < implementation_end,
            });
        }
    }
    found
}

/// The end of an `impl … for … { … }`; nothing for an inherent one and for `impl Trait` in a type.
fn implementation_of_a_trait(file: &SourceFile, start: usize) -> Option<usize> {
    let begins = start == 0
        || ['}', ';', '{', ']'].iter().any(|&sign| file.is_sign(start - 1, sign))
        || file.word(start - 1) == Some("unsafe");
    let (mut depth, mut of_a_trait) = (0i32, false);
    for i in start + 1..file.tokens.len() {
        match () {
            () if file.is_sign(i, '<') => depth += 1,
            () if file.is_sign(i, '>') && !file.is_sign(i - 1, '-') => depth -= 1,
            () if depth == 0 && file.word(i) == Some("for") => of_a_trait = true,
            () if file.is_sign(i, '{') => return (begins && of_a_trait).then(|| file.after_bracket(i)),
            () if file.is_sign(i, ';') => return None,
            () => {}
        }
    }
    None
}

/// The bracket that opens the parameters, behind generics.
fn parameter_list(file: &SourceFile, mut i: usize) -> Option<usize> {
    let mut depth = 0i32;
    while i < file.tokens.len() {
        if file.is_sign(i, '<') {
            depth += 1;
        } else if file.is_sign(i, '>') && !file.is_sign(i - 1, '-') {
            depth -= 1;
        } else if file.is_sign(i, '(') && depth == 0 {
            return Some(i);
        }
        i += 1;
    }
    None
}

/// The token after the body, or after the semicolon of a function without one.
fn body_end(file: &SourceFile, mut i: usize) -> usize {
    while i < file.tokens.len() {
        if file.is_sign(i, '{') {
            return file.after_bracket(i);
        }
        if file.is_sign(i, ';') {
            return i + 1;
        }
        i = if file.is_sign(i, '[') || file.is_sign(i, '(') {
            file.after_bracket(i)
        } else {
            i + 1
        };
    }
    i
}

fn count_parameters(file: &SourceFile, open: usize) -> usize {
    let end = file.after_bracket(open) - 1;
    let (mut i, mut depth, mut count, mut pending) = (open + 1, 0i32, 0, false);
    while i < end {
        if file.is_sign(i, '<') {
            depth += 1;
        } else if file.is_sign(i, '>') && !file.is_sign(i - 1, '-') {
            depth -= 1;
        } else if depth == 0 && file.is_sign(i, ',') {
            count += usize::from(pending);
            pending = false;
            i += 1;
            continue;
        }
        pending = true;
        let bracket = ['(', '[', '{'].iter().any(|&sign| file.is_sign(i, sign));
        i = if bracket { file.after_bracket(i) } else { i + 1 };
    }
    count + usize::from(pending)
}
