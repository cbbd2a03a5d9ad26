//! Checks of numbers, with the field's path in every refusal.

use super::{Error, pb};
use glam::DVec3;
use pliant_core::engine::Plane;

/// Largest coordinate, translation, radius and rotation that a request may hold.
const LARGEST: f64 = 1e30;

/// Exactly three finite numbers.
pub(super) fn vector(values: &[f64], field: &str) -> Result<DVec3, Error> {
    if values.len() != 3 {
        return Err(Error::invalid(
            field,
            format!("has {} numbers, a vector has 3 [x, y, z]", values.len()),
        ));
    }
    for (k, v) in values.iter().enumerate() {
        number(*v, &format!("{field}[{k}]"))?;
    }
    Ok(DVec3::from_slice(values))
}

/// A finite number of sane size.
pub(super) fn number(value: f64, field: &str) -> Result<f64, Error> {
    if value.abs() <= LARGEST {
        Ok(value)
    } else {
        Err(Error::invalid(
            field,
            format!("is {value:?}, allowed are finite numbers up to {LARGEST:e}"),
        ))
    }
}

/// A finite number above 0.
pub(super) fn positive(value: f64, field: &str) -> Result<f64, Error> {
    number(value, field)?;
    if value > 0.0 {
        Ok(value)
    } else {
        Err(Error::invalid(field, format!("is {value:?}, it must be above 0")))
    }
}

/// 0 for "not given", else a number in `range`.
pub(super) fn optional_within(value: f64, low: f64, high: f64, field: &str) -> Result<Option<f64>, Error> {
    if value == 0.0 {
        return Ok(None);
    }
    if (low..=high).contains(&value) {
        Ok(Some(value))
    } else {
        Err(Error::invalid(
            field,
            format!("is {value:?}, allowed are {low:e} to {high:e}, or 0 for the default"),
        ))
    }
}

/// A text for people: no control characters, which logs and terminals would obey.
pub(super) fn plain_text(text: &str, field: &str) -> Result<(), Error> {
    match text.chars().find(|c| c.is_control()) {
        Some(c) => {
            let problem = format!("holds the control character U+{:04X}, none is allowed", u32::from(c));
            Err(Error::invalid(field, problem))
        }
        None => Ok(()),
    }
}

/// A known enum value.
pub(super) fn enumerated<E: TryFrom<i32>>(value: i32, field: &str) -> Result<E, Error> {
    E::try_from(value).map_err(|_| Error::invalid(field, format!("is {value}, which is not a value of this enum")))
}

/// A plane whose normal is a direction.
pub(super) fn plane(plane: &pb::Plane, field: &str) -> Result<Plane, Error> {
    let normal = vector(&plane.normal, &format!("{field}.normal"))?;
    let offset = number(plane.offset, &format!("{field}.offset"))?;
    let length = normal.length();
    if !(length > 0.0 && length.is_finite()) {
        return Err(Error::invalid(
            format!("{field}.normal"),
            "is zero, a plane needs a direction",
        ));
    }
    Ok(Plane { normal, offset })
}

/// Points as x, y, z of each in a row, all numbers checked; `problem` says what is wrong with a count.
pub(super) fn points(
    values: &[f64],
    counts: std::ops::RangeInclusive<usize>,
    field: &str,
    problem: impl Fn(usize) -> String,
) -> Result<Vec<DVec3>, Error> {
    if !values.len().is_multiple_of(3) || !counts.contains(&(values.len() / 3)) {
        return Err(Error::invalid(field, problem(values.len())));
    }
    for (k, v) in values.iter().enumerate() {
        number(*v, &format!("{field}[{k}]"))?;
    }
    Ok(values.chunks_exact(3).map(DVec3::from_slice).collect())
}
