//! What attributes of elements of a 3MF say: numbers, places, transforms and colours.

use super::package::{attribute_of, unescaped};
use crate::formats::text::{NumberPrecision, coordinate};
use glam::{DAffine3, DVec3};
use quick_xml::events::BytesStart;

/// The position that an element `vertex` gives.
pub(super) fn position_of(element: &BytesStart<'_>) -> Result<DVec3, String> {
    let mut found = [None; 3];
    for attribute in element.attributes().with_checks(false) {
        let attribute = attribute.map_err(|error| error.to_string())?;
        if let Some(axis) = axis_of(attribute.key.as_ref()) {
            found[axis] = Some(coordinate(attribute.value.trim().as_bytes(), NumberPrecision::Double)?);
        }
    }
    match found {
        [Some(x), Some(y), Some(z)] => Ok(DVec3::new(x, y, z)),
        _ => Err("a vertex needs x, y and z".into()),
    }
}

/// The axis that an attribute of a vertex is named after.
pub(super) fn axis_of(key: &str) -> Option<usize> {
    ["x", "y", "z"].iter().position(|axis| *axis == key)
}

/// Twelve numbers: where x, y and z go, and the shift.
pub(super) fn transform_of(words: &str) -> Result<DAffine3, String> {
    let mut numbers = [0.0; 12];
    let mut count = 0;
    for word in words.split_ascii_whitespace() {
        if let Some(place) = numbers.get_mut(count) {
            *place = coordinate(word.as_bytes(), NumberPrecision::Double)?;
        }
        count += 1;
    }
    match count {
        12 => Ok(DAffine3::from_cols_array(&numbers)),
        _ => Err(format!("a transform has 12 numbers, this one {count}")),
    }
}

pub(super) fn whole(element: &BytesStart<'_>, name: &str) -> Result<u32, String> {
    optional_whole(element, name)?.ok_or_else(|| format!("the attribute {name} is missing"))
}

pub(super) fn optional_whole(element: &BytesStart<'_>, name: &str) -> Result<Option<u32>, String> {
    let word = attribute_of(element, name);
    word.map(|word| whole_of(name, &word)).transpose()
}

pub(super) fn whole_of(name: &str, word: &str) -> Result<u32, String> {
    let seen = || word.chars().take(40).collect::<String>();
    word.trim()
        .parse()
        .map_err(|_| format!("{name} is `{}`, a whole number is needed", seen()))
}

/// `#RRGGBB` or `#RRGGBBAA`; grey where a material says none.
pub(super) fn colour_of(word: &str) -> Result<[f32; 4], String> {
    let digits = word.trim().strip_prefix('#').unwrap_or(word.trim());
    if digits.is_empty() {
        return Ok([0.5, 0.5, 0.5, 1.0]);
    }
    let seen = || word.chars().take(40).collect::<String>();
    let wrong = || format!("`{}` is not a colour; #RRGGBB or #RRGGBBAA is needed", seen());
    if !digits.is_ascii() || !(digits.len() == 6 || digits.len() == 8) {
        return Err(wrong());
    }
    let mut colour = [1.0; 4];
    for (place, pair) in colour.iter_mut().zip(digits.as_bytes().chunks(2)) {
        let pair = std::str::from_utf8(pair).map_err(|_| wrong())?;
        *place = f32::from(u8::from_str_radix(pair, 16).map_err(|_| wrong())?) / 255.0;
    }
    Ok(colour)
}

/// The attributes of an element but some, as written, each with a blank before it.
pub(super) fn attributes_but(element: &BytesStart<'_>, but: &[&str]) -> String {
    let mut text = String::new();
    for attribute in element.attributes().with_checks(false).flatten() {
        if !but.contains(&attribute.key.local_name().as_ref()) {
            let value = quick_xml::escape::escape(unescaped(&attribute.value));
            text.push_str(&format!(" {}=\"{value}\"", attribute.key.as_ref()));
        }
    }
    text
}
