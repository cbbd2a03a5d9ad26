//! Sizes and times as people write them in a configuration.

use serde::{Deserialize, Deserializer, de};
use std::{fmt, time::Duration};

/// A number of bytes: `1048576`, `"512MiB"`, `"2 GB"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ByteSize(pub u64);

/// A span of time with a unit: `"15m"`, `"1h 30m"`, `"250ms"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimeSpan(pub Duration);

/// A list of texts, or one text with commas.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WordList(pub Vec<String>);

const UNITS: [(&str, u64); 9] = [
    ("", 1),
    ("B", 1),
    ("KiB", 1 << 10),
    ("MiB", 1 << 20),
    ("GiB", 1 << 30),
    ("TiB", 1 << 40),
    ("KB", 1_000),
    ("MB", 1_000_000),
    ("GB", 1_000_000_000),
];

/// Reads a number of bytes; the problem does not name the key.
pub(super) fn parse_byte_size(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = (&text[..digits], text[digits..].trim());
    let refuse =
        || format!("\"{text}\" is not a size; allowed are bytes or a whole number with KiB, MiB, GiB, KB, MB or GB");
    let number: u64 = number.parse().map_err(|_| refuse())?;
    let (_, factor) = UNITS
        .into_iter()
        .find(|(name, _)| name.eq_ignore_ascii_case(unit))
        .ok_or_else(refuse)?;
    number
        .checked_mul(factor)
        .ok_or_else(|| format!("\"{text}\" is more than 2^64 bytes"))
}

/// Reads a span of time; the problem does not name the key.
pub(super) fn parse_time_span(text: &str) -> Result<Duration, String> {
    humantime::parse_duration(text).map_err(|_| {
        format!("\"{text}\" is not a span of time; allowed are numbers with units, such as 250ms, 10s or 1h 30m")
    })
}

impl<'de> Deserialize<'de> for ByteSize {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ByteSizeVisitor;
        impl de::Visitor<'_> for ByteSizeVisitor {
            type Value = ByteSize;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a size such as 1048576 or \"512MiB\"")
            }

            fn visit_u64<E: de::Error>(self, value: u64) -> Result<ByteSize, E> {
                Ok(ByteSize(value))
            }

            fn visit_i64<E: de::Error>(self, value: i64) -> Result<ByteSize, E> {
                u64::try_from(value)
                    .map(ByteSize)
                    .map_err(|_| E::invalid_value(de::Unexpected::Signed(value), &self))
            }

            fn visit_str<E: de::Error>(self, value: &str) -> Result<ByteSize, E> {
                parse_byte_size(value).map(ByteSize).map_err(E::custom)
            }
        }
        deserializer.deserialize_any(ByteSizeVisitor)
    }
}

impl<'de> Deserialize<'de> for TimeSpan {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct TimeSpanVisitor;
        impl de::Visitor<'_> for TimeSpanVisitor {
            type Value = TimeSpan;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a span of time with a unit, such as \"250ms\", \"10s\" or \"1h 30m\"")
            }

            fn visit_str<E: de::Error>(self, value: &str) -> Result<TimeSpan, E> {
                parse_time_span(value).map(TimeSpan).map_err(E::custom)
            }
        }
        deserializer.deserialize_any(TimeSpanVisitor)
    }
}

impl<'de> Deserialize<'de> for WordList {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct WordListVisitor;
        impl<'de> de::Visitor<'de> for WordListVisitor {
            type Value = WordList;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of texts, or one text with commas")
            }

            fn visit_str<E: de::Error>(self, value: &str) -> Result<WordList, E> {
                Ok(WordList(
                    value
                        .split(',')
                        .map(str::trim)
                        .filter(|w| !w.is_empty())
                        .map(str::to_owned)
                        .collect(),
                ))
            }

            fn visit_seq<A: de::SeqAccess<'de>>(self, mut seq: A) -> Result<WordList, A::Error> {
                let mut words = Vec::new();
                while let Some(word) = seq.next_element::<String>()? {
                    words.push(word);
                }
                Ok(WordList(words))
            }
        }
        deserializer.deserialize_any(WordListVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_take_binary_and_decimal_units() {
        assert_eq!(parse_byte_size("512MiB"), Ok(512 << 20));
        assert_eq!(parse_byte_size(" 2 gb "), Ok(2_000_000_000));
        assert_eq!(parse_byte_size("17"), Ok(17));
    }

    #[test]
    fn a_wrong_size_says_what_is_allowed() {
        for text in ["", "MiB", "1.5MiB", "-1", "12 parsecs", "99999999999999999999"] {
            let problem = parse_byte_size(text).unwrap_err();
            assert!(problem.contains("allowed are") && problem.contains(text), "{problem}");
        }
        assert!(parse_byte_size("99999999999TiB").unwrap_err().contains("2^64"));
    }

    #[test]
    fn a_time_without_unit_is_refused() {
        assert_eq!(parse_time_span("1h 30m"), Ok(Duration::from_secs(5400)));
        assert!(parse_time_span("15").unwrap_err().contains("allowed are"));
    }
}
