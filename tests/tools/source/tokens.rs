//! Rust source as words and signs.

/// A word, or one character of punctuation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Token {
    Word(String),
    Sign(char),
}

/// Splits Rust source into tokens with their lines; comments, texts, characters and numbers are left out.
pub fn tokens(source: &str) -> Vec<(Token, usize)> {
    let chars: Vec<char> = source.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let starts = |i: usize, text: &str| text.chars().enumerate().all(|(k, c)| at(i + k) == c);
    let (mut found, mut i, mut line) = (Vec::new(), 0, 1);
    // Moves on to `end`, counting lines.
    let skip = |i: &mut usize, end: usize, line: &mut usize| {
        let end = end.min(chars.len());
        *line += chars[*i..end].iter().filter(|&&c| c == '\n').count();
        *i = end;
    };
    let find = |from: usize, text: &str| (from..chars.len()).find(|&k| starts(k, text)).unwrap_or(chars.len());
    while i < chars.len() {
        let c = chars[i];
        if starts(i, "//") {
            let end = find(i, "\n");
            skip(&mut i, end, &mut line);
        } else if starts(i, "/*") {
            let (mut depth, mut end) = (1, i + 2);
            while depth > 0 && end < chars.len() {
                let step = if starts(end, "/*") {
                    1
                } else if starts(end, "*/") {
                    -1
                } else {
                    0
                };
                depth += step;
                end += if step == 0 { 1 } else { 2 };
            }
            skip(&mut i, end, &mut line);
        } else if c == '"' {
            let mut end = i + 1;
            while end < chars.len() && chars[end] != '"' {
                end += if chars[end] == '\\' { 2 } else { 1 };
            }
            skip(&mut i, end + 1, &mut line);
        } else if c == '\'' {
            // A character ends with a quote; of a lifetime, the name is left over as a word, which harms nothing.
            let end = if at(i + 1) == '\\' {
                find(i + 3, "'") + 1
            } else if at(i + 2) == '\'' {
                i + 3
            } else {
                i + 1
            };
            skip(&mut i, end, &mut line);
        } else if c.is_alphabetic() || c == '_' {
            let end = (i..chars.len())
                .find(|&k| !(chars[k].is_alphanumeric() || chars[k] == '_'))
                .unwrap_or(chars.len());
            let word: String = chars[i..end].iter().collect();
            let hashes = (end..chars.len()).take_while(|&k| chars[k] == '#').count();
            if matches!(word.as_str(), "r" | "br" | "cr") && at(end + hashes) == '"' {
                let close = format!("\"{}", "#".repeat(hashes));
                let close = find(end + hashes + 1, &close) + 1 + hashes;
                skip(&mut i, close, &mut line);
            } else {
                found.push((Token::Word(word), line));
                i = end;
            }
        } else if c.is_ascii_digit() {
            while at(i).is_alphanumeric() || at(i) == '_' {
                i += 1;
            }
        } else {
            if !c.is_whitespace() {
                found.push((Token::Sign(c), line));
            }
            let end = i + 1;
            skip(&mut i, end, &mut line);
        }
    }
    found
}

/// The leaves of what stands between `use` and its semicolon: paths, and the names that they get here (`*` for all).
pub fn use_tree(tokens: &[(Token, usize)]) -> Vec<(Vec<String>, String)> {
    let mut leaves = Vec::new();
    read_use_tree(tokens, 0, &[], &mut leaves);
    leaves
}

fn read_use_tree(
    tokens: &[(Token, usize)],
    mut i: usize,
    before: &[String],
    leaves: &mut Vec<(Vec<String>, String)>,
) -> usize {
    let sign = |i: usize, c: char| matches!(tokens.get(i), Some((Token::Sign(s), _)) if *s == c);
    let word = |i: usize| match tokens.get(i) {
        Some((Token::Word(word), _)) => Some(word.clone()),
        _ => None,
    };
    let mut path = before.to_vec();
    loop {
        if sign(i, '{') {
            i += 1;
            while i < tokens.len() && !sign(i, '}') {
                i = read_use_tree(tokens, i, &path, leaves).max(i + 1);
                i += usize::from(sign(i, ','));
            }
            return i + 1;
        }
        if sign(i, '*') {
            leaves.push((path, "*".to_owned()));
            return i + 1;
        }
        let Some(name) = word(i) else { return i + 1 };
        if name != "self" || path.is_empty() {
            path.push(name);
        }
        i += 1;
        if sign(i, ':') && sign(i + 1, ':') {
            i += 2;
            continue;
        }
        let (alias, end) = match (word(i).as_deref(), word(i + 1)) {
            (Some("as"), Some(alias)) => (alias, i + 2),
            _ => (path.last().cloned().unwrap_or_default(), i),
        };
        leaves.push((path, alias));
        return end;
    }
}

/// A path of a module from the crate's root, when it starts with `self` or `super`.
pub fn resolve_path(path: Vec<String>, module: &[String]) -> Vec<String> {
    let ups = path
        .iter()
        .take_while(|w| *w == "super" || *w == "self")
        .filter(|w| *w == "super")
        .count();
    if !matches!(path.first().map(String::as_str), Some("self" | "super")) {
        return path;
    }
    let rest = path
        .iter()
        .skip_while(|w| matches!(w.as_str(), "self" | "super"))
        .cloned();
    let base = module[..module.len().saturating_sub(ups)].iter().cloned();
    std::iter::once("crate".to_owned()).chain(base).chain(rest).collect()
}
