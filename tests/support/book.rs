//! What a page shows: fenced blocks with the words behind their language, tables, links.

/// A fenced block.
#[derive(Debug, Clone)]
pub struct Block {
    /// The first word behind the fence.
    pub language: String,
    /// The other words as (name, value); a word without `=` has no value.
    words: Vec<(String, String)>,
    /// What is between the fences, with its last line break.
    pub text: String,
    /// Line of the opening fence, counted from 1.
    pub line: usize,
}

impl Block {
    /// The value of a word; empty for a word that stands alone.
    pub fn word(&self, name: &str) -> Option<&str> {
        self.words.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }

    /// Fails for a word that has no meaning, so that a slip of the pen does not turn a test off.
    pub fn check(&self, page: &str) {
        for (name, _) in &self.words {
            let known = ["file", "needs", "by", "is"].contains(&name.as_str());
            assert!(known, "{page}:{}: no block can be told `{name}`", self.line);
        }
    }
}

/// The fenced blocks of a page.
pub fn blocks(page: &str) -> Vec<Block> {
    let mut found = Vec::new();
    let mut open: Option<Block> = None;
    for (k, line) in page.lines().enumerate() {
        match (&mut open, line.strip_prefix("```")) {
            (None, Some(info)) => {
                let mut info = info.split_whitespace();
                let language = info.next().unwrap_or_default().to_owned();
                let pair = |word: &str| {
                    let (name, value) = word.split_once('=').unwrap_or((word, ""));
                    (name.to_owned(), value.to_owned())
                };
                open = Some(Block {
                    language,
                    words: info.map(pair).collect(),
                    text: String::new(),
                    line: k + 1,
                });
            }
            (Some(_), Some(_)) => found.extend(open.take()),
            (Some(block), None) => {
                block.text.push_str(line);
                block.text.push('\n');
            }
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "the last block is not closed");
    found
}

/// The rows of the table whose head begins with `head`: cells without backticks, `\|` as `|`.
pub fn table(page: &str, head: &str) -> Vec<Vec<String>> {
    let cells = |line: &str| {
        let line = line
            .trim()
            .trim_start_matches('|')
            .trim_end_matches('|')
            .replace("\\|", "\u{1}");
        line.split('|')
            .map(|cell| cell.trim().replace('`', "").replace('\u{1}', "|"))
            .collect::<Vec<_>>()
    };
    let mut lines = page.lines().skip_while(|line| !line.starts_with(head));
    assert!(lines.next().is_some(), "there is no table that begins with {head}");
    lines
        .skip(1)
        .take_while(|line| line.starts_with('|'))
        .map(cells)
        .collect()
}

/// Targets of links to files, without what is behind `#`, and the page's words in backticks outside of blocks.
pub fn places(page: &str) -> (Vec<String>, Vec<String>) {
    let mut outside = String::new();
    let mut inside = false;
    for line in page.lines() {
        if line.starts_with("```") {
            inside = !inside;
        } else if !inside {
            outside.push_str(line);
            outside.push('\n');
        }
    }
    let links = outside.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
    let links = links
        .map(|(target, _)| target.split('#').next().unwrap_or_default().to_owned())
        .filter(|target| !target.is_empty() && !target.contains("://"))
        .collect();
    let quoted = outside.split('`').skip(1).step_by(2).map(str::to_owned).collect();
    (links, quoted)
}

/// Whether a line is like a pattern in which `…` stands for anything.
pub fn is_like(line: &str, pattern: &str) -> bool {
    let mut rest = line.trim();
    let mut pieces = pattern.trim().split('…').peekable();
    let mut first = true;
    while let Some(piece) = pieces.next() {
        let at = match (first, pieces.peek()) {
            (true, _) => rest.starts_with(piece).then_some(0),
            (false, None) => rest
                .len()
                .checked_sub(piece.len())
                .filter(|at| rest.is_char_boundary(*at) && rest.ends_with(piece)),
            (false, Some(_)) => rest.find(piece),
        };
        let Some(at) = at else { return false };
        rest = &rest[at + piece.len()..];
        first = false;
    }
    rest.is_empty()
}
