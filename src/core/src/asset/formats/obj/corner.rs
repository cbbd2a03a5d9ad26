//! Corners of faces, the words of lines, and what separates them.

use super::super::text::{TextLexer, TextStyle, TextToken, integer};

/// What separates words.
pub(super) const STYLE: TextStyle = TextStyle {
    comments: true,
    continuation: true,
};

/// Marks a corner that names no normal.
pub(super) const NO_NORMAL: u32 = u32::MAX;

/// One corner of a face as written: vertex, texture coordinate and normal, each counted from 1 or from the end.
#[derive(Debug, Clone, Copy)]
pub(super) struct FaceCorner {
    pub vertex: i64,
    pub texture: Option<i64>,
    pub normal: Option<i64>,
    /// Where the number of the normal stands.
    pub normal_token: TextToken,
}

impl FaceCorner {
    /// Reads a corner; `None` when the word is none.
    pub fn parse(lexer: &TextLexer<'_>, token: TextToken) -> Option<Self> {
        let mut end = token.start;
        let mut next = || {
            let start = end;
            let text = lexer.text(TextToken {
                start: start.min(token.end),
                ..token
            });
            let length = text.iter().position(|&b| b == b'/').unwrap_or(text.len());
            end = start + length + 1;
            (
                &text[..length],
                TextToken {
                    start,
                    end: start + length,
                    ..token
                },
            )
        };
        let optional = |text: &[u8]| {
            if text.is_empty() {
                Some(None)
            } else {
                integer(text).map(Some)
            }
        };
        let (vertex, texture, (normal, normal_token)) = (next().0, next().0, next());
        let complete = end > token.end;
        complete.then_some(Self {
            vertex: integer(vertex)?,
            texture: optional(texture)?,
            normal: optional(normal)?,
            normal_token,
        })
    }
}

/// The place in a list of `count` lines so far that a written index means; `None` for 0 and for places before the first.
/// An index past `count` may name a line that is still to come.
pub(super) fn resolve(index: i64, count: u32) -> Option<u32> {
    let place = if index > 0 { index - 1 } else { i64::from(count) + index };
    u32::try_from(place).ok().filter(|_| index != 0)
}

/// The next three words of the line, or how many there were.
pub(super) fn three_words(lexer: &mut TextLexer<'_>) -> Result<[TextToken; 3], usize> {
    let mut words = [TextToken {
        start: 0,
        end: 0,
        line: 0,
    }; 3];
    for i in 0..3 {
        words[i] = lexer.token_on_line().ok_or(i)?;
    }
    Ok(words)
}
