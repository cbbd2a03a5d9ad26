//! The header of a PLY file: which elements follow, of which properties, in which encoding.

use super::super::text::{TextLexer, TextStyle, TextToken, integer, newline_of, shown};
use crate::asset::{Error, Format};
use std::ops::Range;

/// How the body stores numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PlyEncoding {
    Ascii,
    Little,
    Big,
}

/// The type of one number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PlyScalar {
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
pub(super) struct PlyProperty {
    pub name: String,
    /// The type of the list's count; absent for a single number.
    pub count: Option<PlyScalar>,
    pub scalar: PlyScalar,
    /// Where the header names the type.
    pub type_place: Range<usize>,
}

/// A table of rows.
#[derive(Debug, Clone)]
pub(super) struct PlyElement {
    pub name: String,
    pub rows: u64,
    pub properties: Vec<PlyProperty>,
}

impl PlyElement {
    /// The fewest bytes that its rows can take.
    pub fn least_bytes(&self, encoding: PlyEncoding) -> u64 {
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
pub(super) struct PlyHeader {
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
                b"comment" | b"obj_info" => {}
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
        // After a lone CR the body may begin with a byte that looks like LF.
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
