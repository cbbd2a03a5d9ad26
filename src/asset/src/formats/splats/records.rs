//! `.splat`: 32 bytes for each splat, as the first viewers in browsers read it (antimatter15/splat).
//!
//! Centre and standard deviations in single precision, red, green, blue and opacity in bytes, and the rotation w, x, y, z in
//! bytes around 128. There are no spherical harmonics, no header and no mark.

use super::cloud::{SplatChange, SplatLook, SplatShape, Splats, bytes_of_splat};
use super::ply::check_size;
use crate::files::ReadWatch;
use crate::{Error, Format};
use bytes::Bytes;
use glam::DVec3;

/// Bytes of a splat.
const RECORD: usize = 32;
/// Bytes that are looked at to find that a file is a text, which has no other bytes than letters.
const LOOKED_AT: usize = 1 << 10;
/// The harmonic of degree 0.
const C0: f32 = 0.282_094_8;
/// An opacity of 0 or 1 counts as this near to it, so that its logit is a number.
const LEAST_OPACITY: f32 = 1.0 / 1024.0;

/// Reads a file of records.
pub(super) fn read(main: Bytes, watch: &ReadWatch<'_>) -> Result<Splats, Error> {
    if main.is_empty() || !main.len().is_multiple_of(RECORD) {
        let problem = format!(
            "{} bytes; a whole number of records of {RECORD} bytes is needed",
            main.len()
        );
        return Err(Error::malformed(Format::SPLAT, "the file", problem));
    }
    let is_text = |byte: &u8| byte.is_ascii_graphic() || byte.is_ascii_whitespace();
    if main.iter().take(LOOKED_AT).all(is_text) {
        let problem = "is a text; records of splats are bytes";
        return Err(Error::malformed(Format::SPLAT, "the file", problem));
    }
    let rows = main.len() / RECORD;
    watch.check_vertices(rows as u64)?;
    watch.reserve(rows as u64 * bytes_of_splat(0))?;
    let mut splats = Splats::with_room(Format::SPLAT, rows, 0, main.clone());
    for (row, record) in main.chunks_exact(RECORD).enumerate() {
        watch.check_at(row)?;
        let real =
            |k: usize| f32::from_le_bytes([record[4 * k], record[4 * k + 1], record[4 * k + 2], record[4 * k + 3]]);
        let center = [real(0), real(1), real(2)].map(f64::from);
        splats.centers.push(DVec3::from_array(center));
        let part = |k: usize| (f32::from(record[k]) - 128.0) / 128.0;
        // A negative scale has NaN as its logarithm, and the splat has no shape then.
        let log_scale = [real(3), real(4), real(5)].map(libm::logf);
        splats
            .shapes
            .push(SplatShape::new([part(29), part(30), part(31), part(28)], log_scale));
        splats.looks.push(SplatLook {
            colour: [24, 25, 26].map(|k| (f32::from(record[k]) / 255.0 - 0.5) / C0),
            opacity: logit(record[27]),
        });
    }
    Ok(splats)
}

/// The file with the numbers changed of what has moved.
pub(super) fn patch(splats: &Splats) -> Result<Vec<u8>, Error> {
    let own = |row: &u32| {
        let first = *row as usize * RECORD;
        splats.source[first..first + RECORD].iter().copied()
    };
    let mut out: Vec<u8> = splats.rows.iter().flat_map(own).collect();
    for (row, record) in out.chunks_exact_mut(RECORD).enumerate() {
        let change = splats.changes[row];
        if change > SplatChange::None {
            put_place(splats, row, record)?;
        }
        if change == SplatChange::Divided {
            record[27] = opacity_byte(splats.looks[row].opacity);
        }
    }
    Ok(out)
}

/// A fresh file.
pub(super) fn build(splats: &Splats) -> Result<Vec<u8>, Error> {
    let mut out = vec![0; splats.len() * RECORD];
    for (row, record) in out.chunks_exact_mut(RECORD).enumerate() {
        put_place(splats, row, record)?;
        let SplatLook { colour, opacity } = splats.looks[row];
        for (byte, colour) in record[24..27].iter_mut().zip(colour) {
            *byte = byte_of((colour * C0 + 0.5) * 255.0);
        }
        record[27] = opacity_byte(opacity);
        let shape = &splats.shapes[row];
        if !shape.is_sound() {
            // Without a turn; scales that are none stay 0.
            record[28..].copy_from_slice(&[255, 128, 128, 128]);
            for (scale, log_scale) in record[12..24].chunks_exact_mut(4).zip(shape.sound_scales()) {
                scale.copy_from_slice(&(libm::exp(f64::from(log_scale)) as f32).to_le_bytes());
            }
        }
    }
    Ok(out)
}

/// Writes centre, scales and rotation.
fn put_place(splats: &Splats, row: usize, record: &mut [u8]) -> Result<(), Error> {
    let mut put = |k: usize, value: f64| {
        check_size(Format::SPLAT, row, value)?;
        record[4 * k..4 * k + 4].copy_from_slice(&(value as f32).to_le_bytes());
        Ok::<(), Error>(())
    };
    for (k, value) in splats.centers[row].to_array().into_iter().enumerate() {
        put(k, value)?;
    }
    let shape = &splats.shapes[row];
    if !shape.is_sound() {
        return Ok(());
    }
    for (k, log_scale) in shape.log_scale.into_iter().enumerate() {
        put(3 + k, libm::exp(f64::from(log_scale)))?;
    }
    let [x, y, z, w] = shape.turn;
    for (byte, part) in record[28..].iter_mut().zip([w, x, y, z]) {
        *byte = byte_of(part * 128.0 + 128.0);
    }
    Ok(())
}

/// Whether colours are beyond what bytes hold, by more than they round.
pub(super) fn clamps_colours(colours: [f32; 3]) -> bool {
    colours.into_iter().any(|colour| clamps((colour * C0 + 0.5) * 255.0))
}

/// Whether a number is farther from the nearest byte than rounding takes it.
pub(super) fn clamps(value: f32) -> bool {
    !(-0.5..=255.5).contains(&value)
}

/// The nearest byte.
pub(super) fn byte_of(value: f32) -> u8 {
    libm::roundf(value.clamp(0.0, 255.0)) as u8
}

/// The opacity before the logistic function, of a byte.
pub(super) fn logit(byte: u8) -> f32 {
    let opacity = (f32::from(byte) / 255.0).clamp(LEAST_OPACITY, 1.0 - LEAST_OPACITY);
    libm::logf(opacity / (1.0 - opacity))
}

/// The byte of an opacity before the logistic function.
pub(super) fn opacity_byte(opacity: f32) -> u8 {
    byte_of(255.0 / (1.0 + libm::expf(-opacity)))
}
