//! The numbers after a PLY header, in text or binary, with their places.

use super::super::text::{NumberPrecision, TextLexer, TextStyle, coordinate, integer, number, push_number, shown};
use super::header::{PlyElement, PlyEncoding, PlyProperty, PlyScalar};
use crate::asset::{Error, Format};
use std::ops::Range;

/// Reads one number after the other.
pub(super) enum PlyBody<'a> {
    Text(TextLexer<'a>),
    Binary { bytes: &'a [u8], at: usize, big: bool },
}

impl<'a> PlyBody<'a> {
    /// Begins at an offset that, in a text, lies on `line`.
    pub fn starting_at(bytes: &'a [u8], encoding: PlyEncoding, (at, line): (usize, u32)) -> Self {
        match encoding {
            PlyEncoding::Ascii => Self::Text(TextLexer::starting_at(bytes, at, line, TextStyle::default())),
            PlyEncoding::Little => Self::Binary { bytes, at, big: false },
            PlyEncoding::Big => Self::Binary { bytes, at, big: true },
        }
    }

    /// Offset and, in a text, line of the next number.
    pub fn next_place(&self) -> (usize, u32) {
        match self {
            Self::Text(lexer) => (lexer.at(), lexer.line()),
            Self::Binary { at, .. } => (*at, 0),
        }
    }

    pub fn bytes_left(&self) -> u64 {
        match self {
            // The last word needs no blank after it.
            Self::Text(lexer) => lexer.bytes_left() as u64 + 1,
            Self::Binary { bytes, at, .. } => (bytes.len() - at) as u64,
        }
    }

    pub fn malformed(&self, problem: impl Into<String>) -> Error {
        let place = match self {
            Self::Text(lexer) => format!("line {}", lexer.line()),
            Self::Binary { at, .. } => format!("byte {at}"),
        };
        Error::malformed(Format::PLY, place, problem)
    }

    /// Steps over the next number and says where it stands.
    pub fn skip_number(&mut self, scalar: PlyScalar) -> Result<Range<usize>, Error> {
        let range = match self {
            Self::Text(lexer) => lexer.token().map(|t| t.range()),
            Self::Binary { bytes, at, .. } => {
                let end = at.checked_add(scalar.byte_size()).filter(|&end| end <= bytes.len());
                end.map(|end| std::mem::replace(at, end)..end)
            }
        };
        range.ok_or_else(|| self.malformed("the file ends where a number is needed"))
    }

    /// The next number; not finite only if a binary file says so.
    pub fn read_number(&mut self, scalar: PlyScalar) -> Result<f64, Error> {
        let place = self.skip_number(scalar)?;
        match self {
            Self::Text(lexer) => parse_number(lexer.bytes_at(place), scalar).map_err(|problem| self.malformed(problem)),
            Self::Binary { bytes, big, .. } => Ok(decode_number(&bytes[place], scalar, *big)),
        }
    }

    /// The next number of a normal. Exports of degenerate faces often say `nan`, which counts as no normal.
    pub fn read_normal(&mut self, scalar: PlyScalar) -> Result<f64, Error> {
        let place = self.skip_number(scalar)?;
        match self {
            Self::Text(lexer) => {
                let word = lexer.bytes_at(place);
                let problem = || format!("{} is not a number; a normal is needed", shown(word));
                number(word).ok_or_else(|| self.malformed(problem()))
            }
            Self::Binary { bytes, big, .. } => Ok(decode_number(&bytes[place], scalar, *big)),
        }
    }

    /// The count of a list, of which the items are known to fit the bytes that are left.
    pub fn list_count(&mut self, count: PlyScalar, item: PlyScalar) -> Result<u64, Error> {
        let number = self.read_number(count)?;
        let least = if matches!(self, Self::Text(_)) {
            2
        } else {
            item.byte_size() as u64
        };
        let left = self.bytes_left();
        if !(number >= 0.0 && number * least as f64 <= left as f64) {
            return Err(self.malformed(format!("a list of {number} items; {left} bytes are left")));
        }
        Ok(number as u64)
    }

    pub fn skip_property(&mut self, property: &PlyProperty) -> Result<(), Error> {
        let Some(count) = property.count else {
            return self.skip_number(property.scalar).map(drop);
        };
        for _ in 0..self.list_count(count, property.scalar)? {
            self.skip_number(property.scalar)?;
        }
        Ok(())
    }

    pub fn skip_rows(&mut self, element: &PlyElement) -> Result<(), Error> {
        let fixed = element.properties.iter().all(|p| p.count.is_none());
        match self {
            // The caller has checked that they fit.
            Self::Binary { at, .. } if fixed => {
                let row: usize = element.properties.iter().map(|p| p.scalar.byte_size()).sum();
                *at += row * element.rows as usize;
            }
            _ if element.properties.is_empty() => {}
            _ => {
                for _ in 0..element.rows {
                    for property in &element.properties {
                        self.skip_property(property)?;
                    }
                }
            }
        }
        Ok(())
    }
}

fn parse_number(word: &[u8], scalar: PlyScalar) -> Result<f64, String> {
    match scalar {
        PlyScalar::F32 => coordinate(word, NumberPrecision::Single),
        PlyScalar::F64 => coordinate(word, NumberPrecision::Double),
        _ => integer(word)
            .map(|i| i as f64)
            .filter(|&i| scalar.holds_exactly(i))
            .ok_or_else(|| format!("{} does not fit the declared whole-number type", shown(word))),
    }
}

fn decode_number(bytes: &[u8], scalar: PlyScalar, big: bool) -> f64 {
    let mut little = [0; 8];
    for (i, &b) in bytes.iter().take(8).enumerate() {
        little[if big { bytes.len() - 1 - i } else { i }] = b;
    }
    let [a, b, c, d, ..] = little;
    match scalar {
        PlyScalar::I8 => f64::from(a as i8),
        PlyScalar::U8 => f64::from(a),
        PlyScalar::I16 => f64::from(i16::from_le_bytes([a, b])),
        PlyScalar::U16 => f64::from(u16::from_le_bytes([a, b])),
        PlyScalar::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
        PlyScalar::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
        PlyScalar::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
        PlyScalar::F64 => f64::from_le_bytes(little),
    }
}

/// Appends a number that the type holds, up to rounding of real numbers.
pub(super) fn push(out: &mut Vec<u8>, value: f64, scalar: PlyScalar, encoding: PlyEncoding) {
    if encoding == PlyEncoding::Ascii {
        let precision = if scalar == PlyScalar::F32 {
            NumberPrecision::Single
        } else {
            NumberPrecision::Double
        };
        return push_number(out, value, precision);
    }
    let first = out.len();
    match scalar {
        PlyScalar::I8 => out.extend((value as i8).to_le_bytes()),
        PlyScalar::U8 => out.extend((value as u8).to_le_bytes()),
        PlyScalar::I16 => out.extend((value as i16).to_le_bytes()),
        PlyScalar::U16 => out.extend((value as u16).to_le_bytes()),
        PlyScalar::I32 => out.extend((value as i32).to_le_bytes()),
        PlyScalar::U32 => out.extend((value as u32).to_le_bytes()),
        PlyScalar::F32 => out.extend((value as f32).to_le_bytes()),
        PlyScalar::F64 => out.extend(value.to_le_bytes()),
    }
    if encoding == PlyEncoding::Big {
        out[first..].reverse();
    }
}
