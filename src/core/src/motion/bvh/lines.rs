//! The text of a clip, line by line.

use crate::motion::error::Error;
use std::borrow::Cow;

/// Goes through the lines of a text that have something on them.
pub(super) struct ClipLines<'a> {
    rest: &'a [u8],
    number: usize,
}

impl<'a> ClipLines<'a> {
    /// A mark of byte order at the beginning is passed over.
    pub(super) fn of(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes),
            number: 0,
        }
    }

    /// The next line with something on it. Lines end with LF, CR LF or CR.
    pub(super) fn next_line(&mut self) -> Option<ClipLine<'a>> {
        while !self.rest.is_empty() {
            let end = self.rest.iter().position(|&b| b == b'\n' || b == b'\r');
            let (line, after) = self.rest.split_at(end.unwrap_or(self.rest.len()));
            let after = after.strip_prefix(b"\r\n").or_else(|| after.get(1..));
            self.rest = after.unwrap_or_default();
            self.number += 1;
            let text = line.trim_ascii();
            if !text.is_empty() {
                let number = self.number;
                return Some(ClipLine { text, number });
            }
        }
        None
    }

    /// The number of the last line that was read.
    pub(super) fn number(&self) -> usize {
        self.number
    }

    /// At least how many more bytes there are.
    pub(super) fn bytes_left(&self) -> usize {
        self.rest.len()
    }
}

/// A line without what is blank around it.
#[derive(Clone, Copy)]
pub(super) struct ClipLine<'a> {
    pub text: &'a [u8],
    pub number: usize,
}

impl<'a> ClipLine<'a> {
    pub(super) fn words(&self) -> impl Iterator<Item = &'a [u8]> {
        self.text.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
    }

    /// Whether its first word is `word`, in capitals or not.
    pub(super) fn begins_with(&self, word: &str) -> bool {
        self.words()
            .next()
            .is_some_and(|first| first.eq_ignore_ascii_case(word.as_bytes()))
    }

    /// What follows after so many bytes, without what is blank around it.
    pub(super) fn after(&self, bytes: usize) -> &'a [u8] {
        self.text.get(bytes..).unwrap_or_default().trim_ascii()
    }

    pub(super) fn refuse(&self, problem: impl Into<String>) -> Error {
        Error::Malformed {
            line: self.number,
            problem: problem.into(),
        }
    }

    /// A number on this line.
    pub(super) fn number_of(&self, word: &[u8]) -> Result<f64, Error> {
        let text = std::str::from_utf8(word).ok();
        let number = text.and_then(|text| text.parse::<f64>().ok());
        match number {
            Some(number) if number.abs() <= LARGEST => Ok(number),
            Some(number) if number.is_finite() => Err(self.refuse(format!(
                "\"{}\" is too large; numbers from -1e15 to 1e15 are allowed",
                shown(word)
            ))),
            Some(_) => Err(self.refuse(format!("\"{}\" is not finite", shown(word)))),
            None if word.contains(&b',') => Err(self.refuse(format!(
                "\"{}\" is not a number; decimals need a point, not a comma",
                shown(word)
            ))),
            None => Err(self.refuse(format!("\"{}\" is not a number", shown(word)))),
        }
    }
}

/// The largest number of a clip, in degrees, units or seconds: what is computed from such numbers is far from the end of doubles.
const LARGEST: f64 = 1e15;

/// At most 60 characters of a text, for a message.
pub(super) fn shown(text: &[u8]) -> String {
    let text: Cow<'_, str> = String::from_utf8_lossy(text);
    let mut clipped: String = text.chars().take(60).collect();
    if clipped.len() < text.len() {
        clipped.push('…');
    }
    clipped
}
