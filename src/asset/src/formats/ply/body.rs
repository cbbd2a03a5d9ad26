//! The numbers after a PLY header, in text or binary, with their places.
//!
//! The header of a PLY file: which elements follow, of which properties, in which encoding.

use super::super::text::{
    NumberPrecision, TextLexer, TextStyle, TextToken, coordinate, integer, newline_of, number, push_number, shown,
};
use crate::{Error, Format};
use std::ops::Range;

/// Reads one number after the other.
pub(in crate::formats) enum PlyBody<'a> {
    Text(TextLexer<'a>),
    Binary { bytes: &'a [u8], at: usize, big: bool },
}

impl<'a> PlyBody<'a> {
    /// Begins at an offset that, in a text, lies on `line`.
    pub fn starting_at(bytes: &'a [u8], encoding: PlyEncoding, at: usize, line: u32) -> Self {
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

    /// Refuses an element whose rows cannot fit into what is left, before memory is taken for them.
    pub fn require_rows_of(&self, element: &PlyElement, encoding: PlyEncoding) -> Result<(), Error> {
        let (least, left) = (element.least_bytes(encoding), self.bytes_left());
        let (name, rows) = (&element.name, element.rows);
        match least > left {
            true => Err(self.malformed(format!(
                "{rows} rows of `{name}` take {least} bytes at least, {left} are left"
            ))),
            false => Ok(()),
        }
    }

    fn bytes_left(&self) -> u64 {
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
pub(in crate::formats) fn push(out: &mut Vec<u8>, value: f64, scalar: PlyScalar, encoding: PlyEncoding) {
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

/// How the body stores numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::formats) enum PlyEncoding {
    Ascii,
    Little,
    Big,
}

/// The type of one number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::formats) enum PlyScalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl PlyScalar {
    pub fn from_name(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes in a binary body.
    pub fn byte_size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The name that every reader knows.
    pub fn name(self) -> &'static str {
        match self {
            Self::I8 => "char",
            Self::U8 => "uchar",
            Self::I16 => "short",
            Self::U16 => "ushort",
            Self::I32 => "int",
            Self::U32 => "uint",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// The least and the largest value of a whole-number type; without bounds for the others.
    fn value_range(self) -> (f64, f64) {
        match self {
            Self::I8 => (f64::from(i8::MIN), f64::from(i8::MAX)),
            Self::U8 => (0.0, f64::from(u8::MAX)),
            Self::I16 => (f64::from(i16::MIN), f64::from(i16::MAX)),
            Self::U16 => (0.0, f64::from(u16::MAX)),
            Self::I32 => (f64::from(i32::MIN), f64::from(i32::MAX)),
            Self::U32 => (0.0, f64::from(u32::MAX)),
            Self::F32 | Self::F64 => (f64::NEG_INFINITY, f64::INFINITY),
        }
    }

    /// The largest value of a whole-number type.
    pub fn largest_value(self) -> f64 {
        self.value_range().1
    }

    /// What stands for the whole of a share, such as a colour: the largest whole number, or 1.
    pub fn full_value(self) -> f64 {
        if self.is_integer() { self.largest_value() } else { 1.0 }
    }

    /// The nearest value that a whole-number type holds.
    pub fn nearest_value(self, value: f64) -> f64 {
        let (low, high) = self.value_range();
        if value.is_nan() {
            0.0
        } else {
            value.round().clamp(low, high)
        }
    }

    pub fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// Whether the type holds the value without rounding it.
    pub fn holds_exactly(self, value: f64) -> bool {
        match self {
            Self::F32 => return f64::from(value as f32).to_bits() == value.to_bits(),
            Self::F64 => return true,
            _ => {}
        }
        let (low, high) = self.value_range();
        (low..=high).contains(&value) && value.fract() == 0.0
    }
}

/// One number, or a counted list of numbers, of each row of an element.
#[derive(Debug, Clone)]
pub(in crate::formats) struct PlyProperty {
    pub name: String,
    /// The type of the list's count; absent for a single number.
    pub count: Option<PlyScalar>,
    pub scalar: PlyScalar,
    /// Where the header names the type.
    pub type_place: Range<usize>,
}

/// A table of rows.
#[derive(Debug, Clone)]
pub(in crate::formats) struct PlyElement {
    pub name: String,
    pub rows: u64,
    pub properties: Vec<PlyProperty>,
}

impl PlyElement {
    /// The fewest bytes that its rows can take.
    fn least_bytes(&self, encoding: PlyEncoding) -> u64 {
        let row: usize = match encoding {
            PlyEncoding::Ascii => self.properties.len() * 2,
            _ => self
                .properties
                .iter()
                .map(|p| p.count.unwrap_or(p.scalar).byte_size())
                .sum(),
        };
        self.rows.saturating_mul(row as u64)
    }

    /// The place of a single-number property.
    pub fn scalar_property(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.name == name && p.count.is_none())
    }
}

/// A header that was read.
#[derive(Debug, Clone)]
pub(in crate::formats) struct PlyHeader {
    pub encoding: PlyEncoding,
    pub elements: Vec<PlyElement>,
    /// Offset and line of the first byte after it.
    pub body: (usize, u32),
}

fn malformed(line: u32, problem: impl Into<String>) -> Error {
    Error::malformed(Format::PLY, format!("line {line}"), problem)
}

impl PlyHeader {
    pub fn read(bytes: &[u8]) -> Result<Self, Error> {
        let mut lexer = TextLexer::new(bytes, TextStyle::default());
        let mut encoding = None;
        let mut elements: Vec<PlyElement> = Vec::new();
        if lexer.token_on_line().is_none_or(|t| lexer.text(t) != b"ply") {
            return Err(malformed(1, "the first line is not `ply`"));
        }
        lexer.end_line();
        loop {
            let Some(keyword) = lexer.token() else {
                return Err(malformed(lexer.line(), "the file ends inside the header"));
            };
            match lexer.text(keyword) {
                // Old files of Blender say `Created by Blender3D` without being a comment.
                b"comment" | b"obj_info" | b"Created" => {}
                b"format" => encoding = Some(read_encoding(&mut lexer, keyword)?),
                b"element" => elements.push(read_element(&mut lexer, keyword)?),
                b"property" => {
                    let property = read_property(&mut lexer, keyword)?;
                    let Some(element) = elements.last_mut() else {
                        return Err(malformed(keyword.line, "a property before any element"));
                    };
                    element.properties.push(property);
                }
                b"end_header" => break,
                other => {
                    let problem = format!(
                        "{}; allowed are comment, obj_info, format, element, property and end_header",
                        shown(other)
                    );
                    return Err(malformed(keyword.line, problem));
                }
            }
            lexer.end_line();
        }
        let encoding = encoding.ok_or_else(|| malformed(lexer.line(), "the header names no format"))?;
        // After a single CR the body may begin with a byte that looks like LF.
        let body = if newline_of(bytes) == b"\r" && bytes.get(lexer.at()) == Some(&b'\r') {
            (lexer.at() + 1, lexer.line() + 1)
        } else {
            lexer.end_line();
            (lexer.at(), lexer.line())
        };
        Ok(Self {
            encoding,
            elements,
            body,
        })
    }
}

fn read_word<'a>(lexer: &mut TextLexer<'a>, keyword: TextToken, needed: &str) -> Result<(TextToken, &'a [u8]), Error> {
    let token = lexer
        .token_on_line()
        .ok_or_else(|| malformed(keyword.line, format!("{needed} is missing")))?;
    Ok((token, lexer.text(token)))
}

fn read_encoding(lexer: &mut TextLexer<'_>, keyword: TextToken) -> Result<PlyEncoding, Error> {
    match read_word(lexer, keyword, "the name of the format")?.1 {
        b"ascii" => Ok(PlyEncoding::Ascii),
        b"binary_little_endian" => Ok(PlyEncoding::Little),
        b"binary_big_endian" => Ok(PlyEncoding::Big),
        other => {
            let problem = format!(
                "format {}; allowed are ascii, binary_little_endian and binary_big_endian",
                shown(other)
            );
            Err(malformed(keyword.line, problem))
        }
    }
}

fn read_element(lexer: &mut TextLexer<'_>, keyword: TextToken) -> Result<PlyElement, Error> {
    let name = String::from_utf8_lossy(read_word(lexer, keyword, "the name of the element")?.1).into_owned();
    let count = read_word(lexer, keyword, "the number of rows")?.1;
    let rows = integer(count).and_then(|n| u64::try_from(n).ok()).ok_or_else(|| {
        malformed(
            keyword.line,
            format!(
                "{} rows of element `{name}`; a whole number from 0 is needed",
                shown(count)
            ),
        )
    })?;
    Ok(PlyElement {
        name,
        rows,
        properties: Vec::new(),
    })
}

fn read_property(lexer: &mut TextLexer<'_>, keyword: TextToken) -> Result<PlyProperty, Error> {
    let scalar_type = |(token, text): (TextToken, &[u8])| {
        let scalar = PlyScalar::from_name(text).ok_or_else(|| {
            let allowed = "char, uchar, short, ushort, int, uint, float, double, int8 … float64 and list";
            malformed(
                token.line,
                format!("property type {}; allowed are {allowed}", shown(text)),
            )
        })?;
        Ok::<_, Error>((token, scalar))
    };
    let first = read_word(lexer, keyword, "the type of the property")?;
    let (count, (token, scalar)) = if first.1 == b"list" {
        let next = read_word(lexer, keyword, "the type of the list's count")?;
        let (_, count) = scalar_type(next)?;
        if !count.is_integer() {
            return Err(malformed(
                keyword.line,
                "the count of a list is not of a whole-number type",
            ));
        }
        let next = read_word(lexer, keyword, "the type of the list's items")?;
        (Some(count), scalar_type(next)?)
    } else {
        (None, scalar_type(first)?)
    };
    let name = String::from_utf8_lossy(read_word(lexer, keyword, "the name of the property")?.1).into_owned();
    Ok(PlyProperty {
        name,
        count,
        scalar,
        type_place: token.range(),
    })
}
