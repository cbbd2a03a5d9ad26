//! Words and numbers of text formats with their places, and edits of them that leave every other byte alone.

use crate::{Error, Format};
use glam::DVec3;
use std::io::Write as _;
use std::ops::Range;

/// A word of a text file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TextToken {
    /// Offset of its first byte.
    pub start: usize,
    /// Offset past its last byte.
    pub end: usize,
    /// Line it stands on, the first line being 1.
    pub line: u32,
}

impl TextToken {
    pub fn range(self) -> Range<usize> {
        self.start..self.end
    }
}

/// What separates words beyond blanks.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct TextStyle {
    /// `#` begins a comment that runs to the end of the line.
    pub comments: bool,
    /// A backslash at the end of a line joins the next line to it.
    pub continuation: bool,
}

/// Reads words one after the other. Lines end with LF, CR LF or CR.
#[derive(Debug, Clone)]
pub(super) struct TextLexer<'a> {
    bytes: &'a [u8],
    at: usize,
    line: u32,
    style: TextStyle,
}

impl<'a> TextLexer<'a> {
    /// Starts at the first byte after a byte-order mark, if there is one.
    pub fn new(bytes: &'a [u8], style: TextStyle) -> Self {
        Self::starting_at(bytes, bytes.len() - without_mark(bytes).len(), 1, style)
    }

    /// Starts at an offset that lies on `line`.
    pub fn starting_at(bytes: &'a [u8], at: usize, line: u32, style: TextStyle) -> Self {
        Self { bytes, at, line, style }
    }

    /// The bytes of a token.
    pub fn text(&self, token: TextToken) -> &'a [u8] {
        &self.bytes[token.range()]
    }

    /// Goes back to a place on the present line.
    pub fn go_back_to(&mut self, at: usize) {
        self.at = self.at.min(at);
    }

    /// The bytes of a place in the text.
    pub fn bytes_at(&self, place: Range<usize>) -> &'a [u8] {
        &self.bytes[place]
    }

    /// Where the next read begins.
    pub fn at(&self) -> usize {
        self.at
    }

    /// The line of the next read.
    pub fn line(&self) -> u32 {
        self.line
    }

    /// Bytes not read yet.
    pub fn bytes_left(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// The next word, on whatever line.
    pub fn token(&mut self) -> Option<TextToken> {
        loop {
            if let Some(token) = self.token_on_line() {
                return Some(token);
            }
            if !self.end_line() {
                return None;
            }
        }
    }

    /// The next word of the present line; `None` at its end.
    pub fn token_on_line(&mut self) -> Option<TextToken> {
        loop {
            match *self.bytes.get(self.at)? {
                b'\n' | b'\r' => return None,
                b'\\' if self.continues() => self.pass_continuation(),
                b if is_blank(b) => self.at += 1,
                b'#' if self.style.comments => {
                    self.at += self.bytes[self.at..].iter().take_while(|&&b| !is_newline(b)).count();
                    return None;
                }
                _ => {
                    let start = self.at;
                    while let Some(&b) = self.bytes.get(self.at) {
                        if is_blank(b) || is_newline(b) || (b == b'\\' && self.continues()) {
                            break;
                        }
                        self.at += 1;
                    }
                    return Some(TextToken {
                        start,
                        end: self.at,
                        line: self.line,
                    });
                }
            }
        }
    }

    /// The place of the words that are left on the present line, from the first to the last, which are then read.
    pub fn rest_of_line(&mut self) -> Range<usize> {
        let mut place = self.at..self.at;
        if let Some(first) = self.token_on_line() {
            place = first.range();
        }
        while let Some(word) = self.token_on_line() {
            place.end = word.end;
        }
        place
    }

    /// The next three words, on whatever lines.
    pub fn three_tokens(&mut self) -> Option<[TextToken; 3]> {
        Some([self.token()?, self.token()?, self.token()?])
    }

    /// The next three words of the present line, or how many there are.
    pub fn three_on_line(&mut self) -> Result<[TextToken; 3], usize> {
        let first = self.token_on_line().ok_or(0_usize)?;
        let second = self.token_on_line().ok_or(1_usize)?;
        Ok([first, second, self.token_on_line().ok_or(2_usize)?])
    }

    /// Three words as a finite position; else the line of the word that is none, and what is wrong with it.
    pub fn position(&self, words: [TextToken; 3]) -> Result<DVec3, (u32, String)> {
        let mut position = DVec3::ZERO;
        for (i, word) in words.into_iter().enumerate() {
            let read = coordinate(self.text(word), NumberPrecision::Double);
            position[i] = read.map_err(|problem| (word.line, problem))?;
        }
        Ok(position)
    }

    /// Three words as numbers, finite or not; else the word that is none.
    pub fn numbers(&self, words: [TextToken; 3]) -> Result<DVec3, TextToken> {
        let mut numbers = DVec3::ZERO;
        for (i, word) in words.into_iter().enumerate() {
            numbers[i] = number(self.text(word)).ok_or(word)?;
        }
        Ok(numbers)
    }

    /// Skips what is left of the present line and its end; false when the text ends with it.
    pub fn end_line(&mut self) -> bool {
        while self.token_on_line().is_some() {}
        let length = self.newline_at(self.at);
        self.at += length;
        self.line = self.line.saturating_add(u32::from(length > 0));
        length > 0
    }

    fn continues(&self) -> bool {
        self.style.continuation && self.newline_at(self.at + 1) > 0
    }

    fn pass_continuation(&mut self) {
        self.at += 1 + self.newline_at(self.at + 1);
        self.line = self.line.saturating_add(1);
    }

    fn newline_at(&self, at: usize) -> usize {
        match (self.bytes.get(at), self.bytes.get(at + 1)) {
            (Some(b'\r'), Some(b'\n')) => 2,
            (Some(b'\r' | b'\n'), _) => 1,
            _ => 0,
        }
    }
}

fn is_blank(b: u8) -> bool {
    matches!(b, b' ' | b'\t' | 0x0b | 0x0c)
}

fn is_newline(b: u8) -> bool {
    matches!(b, b'\n' | b'\r')
}

/// The line end that a text uses: that of its first line.
pub(super) fn newline_of(bytes: &[u8]) -> &'static [u8] {
    match bytes.iter().position(|&b| is_newline(b)) {
        Some(at) if bytes[at] == b'\r' => {
            if bytes.get(at + 1) == Some(&b'\n') {
                b"\r\n"
            } else {
                b"\r"
            }
        }
        _ => b"\n",
    }
}

/// A word as it may be shown in an error text: short and printable.
pub(super) fn shown(word: &[u8]) -> String {
    const LONGEST: usize = 32;
    let text: String = String::from_utf8_lossy(&word[..word.len().min(LONGEST)])
        .chars()
        .map(|c| if c.is_control() { '?' } else { c })
        .collect();
    let dots = if word.len() > LONGEST { "…" } else { "" };
    format!("`{text}{dots}`")
}

/// A real number; `None` when the word is none.
pub(super) fn number(word: &[u8]) -> Option<f64> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// Whether a word is a number but for a comma where the point should be.
fn has_decimal_comma(word: &[u8]) -> bool {
    let text = String::from_utf8_lossy(word);
    text.matches(',').count() == 1 && number(text.replace(',', ".").as_bytes()).is_some()
}

/// A text without the byte-order mark that it may begin with.
pub(super) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// Refuses a text of two bytes a letter, which some editors write.
pub(super) fn refuse_utf16(bytes: &[u8], format: Format) -> Result<(), Error> {
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        let problem = "the text is in UTF-16 (two bytes a letter); save it as UTF-8";
        return Err(Error::malformed(format, "byte 0", problem));
    }
    Ok(())
}

/// A whole number, with its sign; `None` when the word is none or too large.
pub(super) fn integer(word: &[u8]) -> Option<i64> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// A coordinate as its format stores it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NumberPrecision {
    /// 32 bits: written rounded.
    Single,
    /// 64 bits.
    Double,
}

/// A finite coordinate, or what is wrong with it.
pub(super) fn coordinate(word: &[u8], precision: NumberPrecision) -> Result<f64, String> {
    let value = match precision {
        NumberPrecision::Single => std::str::from_utf8(word)
            .ok()
            .and_then(|t| t.parse::<f32>().ok())
            .map(f64::from),
        NumberPrecision::Double => number(word),
    };
    match value {
        Some(value) if value.is_finite() => Ok(value),
        Some(_) => Err(format!(
            "coordinate {} is not finite; a finite number is needed",
            shown(word)
        )),
        None if has_decimal_comma(word) => Err(format!(
            "{} has a decimal comma; numbers are written with a point, whatever the language of the program",
            shown(word)
        )),
        None => Err(format!("{} is not a number; a coordinate is needed", shown(word))),
    }
}

/// Appends the shortest text that reads back to the same number.
pub(super) fn push_number(out: &mut Vec<u8>, value: f64, precision: NumberPrecision) {
    let size = value.abs();
    // Outside this range plain digits would mostly be zeros.
    let plain_digits = size == 0.0 || (1e-5..1e16).contains(&size);
    let result = match (precision, plain_digits) {
        (NumberPrecision::Single, true) => write!(out, "{}", value as f32),
        (NumberPrecision::Single, false) => write!(out, "{:e}", value as f32),
        (NumberPrecision::Double, true) => write!(out, "{value}"),
        (NumberPrecision::Double, false) => write!(out, "{value:e}"),
    };
    debug_assert!(result.is_ok(), "writing to memory does not fail");
}

/// Appends three numbers with blanks between them.
pub(super) fn push_triple(out: &mut Vec<u8>, values: DVec3, precision: NumberPrecision) {
    for (i, value) in values.to_array().into_iter().enumerate() {
        if i > 0 {
            out.push(b' ');
        }
        push_number(out, value, precision);
    }
}

/// A copy of a text in which some words are replaced. Edits come in ascending order of their places.
#[derive(Debug)]
pub(super) struct TextPatch<'a> {
    source: &'a [u8],
    copied: usize,
    out: Vec<u8>,
}

impl<'a> TextPatch<'a> {
    pub fn new(source: &'a [u8]) -> Self {
        Self {
            source,
            copied: 0,
            out: Vec::with_capacity(source.len() + source.len() / 8),
        }
    }

    /// Copies up to `range`, skips it, and hands out the place where the new text goes.
    pub fn replace(&mut self, range: Range<usize>) -> &mut Vec<u8> {
        debug_assert!(self.copied <= range.start, "edits come in ascending order");
        self.out.extend_from_slice(&self.source[self.copied..range.start]);
        self.copied = range.end;
        &mut self.out
    }

    /// Replaces those of three numbers that changed. At single precision a number that rounds to its old value did not.
    pub fn replace_changed(&mut self, tokens: [TextToken; 3], old: DVec3, new: DVec3, precision: NumberPrecision) {
        for (token, (old, new)) in tokens.into_iter().zip(old.to_array().into_iter().zip(new.to_array())) {
            let same = match precision {
                NumberPrecision::Single => (old as f32).to_bits() == (new as f32).to_bits(),
                NumberPrecision::Double => old.to_bits() == new.to_bits(),
            };
            if !same {
                push_number(self.replace(token.range()), new, precision);
            }
        }
    }

    /// Copies the rest.
    pub fn finish(mut self) -> Vec<u8> {
        self.out.extend_from_slice(&self.source[self.copied..]);
        self.out
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::{Error, Model};
    use proptest::prelude::*;

    /// Checks that a file is refused at a place with a phrase.
    pub(in super::super) fn assert_refused(read: Result<Model, Error>, at: &str, phrase: &str, file: &[u8]) {
        let file = String::from_utf8_lossy(file);
        match read {
            Err(Error::Malformed { place, problem, .. }) => {
                assert!(place == at && problem.contains(phrase), "{file}\n{place}: {problem}");
            }
            other => panic!("{file}: {other:?}"),
        }
    }

    const ALL: TextStyle = TextStyle {
        comments: true,
        continuation: true,
    };

    fn words(text: &str, style: TextStyle) -> Vec<(String, u32)> {
        let mut lexer = TextLexer::new(text.as_bytes(), style);
        std::iter::from_fn(|| {
            lexer
                .token()
                .map(|t| (String::from_utf8_lossy(lexer.text(t)).into_owned(), t.line))
        })
        .collect()
    }

    #[test]
    fn every_kind_of_line_end_counts_once() {
        let seen = words("a\nb\r\nc\rd\n\ne", ALL);
        let expected = [("a", 1), ("b", 2), ("c", 3), ("d", 4), ("e", 6)];
        assert_eq!(seen, expected.map(|(w, l)| (w.to_string(), l)));
    }

    #[test]
    fn comments_end_with_their_line_even_before_a_backslash() {
        let seen = words("\u{feff}# a \\\nb c\\\r\n\td # e \\\nf#g", ALL);
        assert_eq!(
            seen,
            [("b", 2), ("c", 2), ("d", 3), ("f#g", 4)].map(|(w, l)| (w.to_string(), l))
        );
        assert_eq!(
            words("a\\\nb", TextStyle::default())[0].0,
            "a\\",
            "a backslash is a letter where lines do not continue"
        );
    }

    #[test]
    fn error_texts_show_short_printable_words() {
        assert_eq!(shown(b"a\x07b"), "`a?b`");
        assert!(shown(&[b'x'; 5000]).len() < 50);
    }

    proptest! {
        #[test]
        fn written_numbers_read_back_to_the_same_bits(bits in any::<u64>()) {
            let value = f64::from_bits(bits);
            prop_assume!(value.is_finite());
            let mut out = Vec::new();
            push_number(&mut out, value, NumberPrecision::Double);
            prop_assert_eq!(coordinate(&out, NumberPrecision::Double).unwrap().to_bits(), bits);
            prop_assert!(out.len() < 30);
            let single = value as f32;
            if single.is_finite() {
                let mut out = Vec::new();
                push_number(&mut out, value, NumberPrecision::Single);
                prop_assert_eq!(coordinate(&out, NumberPrecision::Single).unwrap() as f32, single);
            }
        }

        #[test]
        fn words_are_the_text_without_blanks(text in "[ab#\\\\ \t\r\n]{0,60}") {
            let seen: String = words(&text, TextStyle::default()).into_iter().map(|(w, _)| w).collect();
            let expected: String = text.chars().filter(|c| !c.is_whitespace()).collect();
            prop_assert_eq!(seen, expected);
        }
    }
}
