//! `.spz`, versions 2 and 3: arrays of whole numbers behind a header of 16 bytes, compressed with gzip (nianticlabs/spz).
//!
//! In a row for all splats: centres in fixed point of 24 bits, opacities, colours, logarithms of scales, rotations (of version 2
//! x, y and z in a byte each, of version 3 the three smallest in 10 bits each), spherical harmonics.

use super::cloud::{SplatChange, SplatLook, SplatShape, Splats, bytes_of_splat, coefficients_of};
use super::records::{byte_of, clamps, logit, opacity_byte};
use crate::files::ReadWatch;
use crate::{Error, Format};
use bytes::Bytes;
use flate2::Compression;
use flate2::bufread::GzDecoder;
use flate2::write::GzEncoder;
use glam::DVec3;
use std::io::{Read as _, Write as _};
use std::ops::Range;

const HEADER: usize = 16;
const MAGIC: u32 = 0x5053_474e;
/// Deflate makes at most so many bytes of one.
const MOST_INFLATION: u64 = 1040;
/// Bytes behind the arrays that are kept as they are.
const MOST_BEHIND: u64 = 1 << 20;
/// Bytes that are decompressed between two looks at whether the work is still wanted.
const BLOCK: u64 = 1 << 22;
/// What a colour's coefficient of degree 0 is multiplied with before it becomes a share of a byte.
const COLOUR: f32 = 0.15;
/// The most binary places of a coordinate in a fresh file.
const MOST_PLACES: u8 = 20;
/// Whole numbers of coordinates are below this.
const COORDINATE_END: f64 = 8_388_608.0;
/// The largest of the three smallest parts of a quaternion.
const SMALLEST: f32 = std::f32::consts::FRAC_1_SQRT_2;

/// Whether a file begins with gzip that holds the mark.
pub(super) fn begins_like(bytes: &[u8]) -> bool {
    let mut mark = [0; 4];
    bytes.starts_with(&[0x1f, 0x8b])
        && GzDecoder::new(bytes).read_exact(&mut mark).is_ok()
        && u32::from_le_bytes(mark) == MAGIC
}

/// What the header says, and where the arrays are.
#[derive(Debug, Clone, Copy)]
struct SpzLayout {
    version: u32,
    count: usize,
    degree: u8,
    places: u8,
}

impl SpzLayout {
    fn read(header: [u8; HEADER]) -> Result<Self, Error> {
        let word = |k: usize| u32::from_le_bytes([header[k], header[k + 1], header[k + 2], header[k + 3]]);
        let unsupported = |problem: String, hint: &str| Err(Error::unsupported(Format::SPZ, "header", problem, hint));
        if word(0) != MAGIC {
            return Err(Error::malformed(
                Format::SPZ,
                "header",
                "the first four bytes are not NGSP",
            ));
        }
        let layout = Self {
            version: word(4),
            count: word(8) as usize,
            degree: header[12],
            places: header[13],
        };
        if !matches!(layout.version, 2 | 3) {
            return unsupported(
                format!("version {}", layout.version),
                "allowed are 2 and 3; convert it to ply",
            );
        }
        if layout.degree > 3 {
            return unsupported(
                format!("spherical harmonics of degree {}", layout.degree),
                "allowed are 0 to 3",
            );
        }
        if layout.places > 30 {
            return unsupported(format!("{} binary places", layout.places), "allowed are 0 to 30");
        }
        Ok(layout)
    }

    fn bytes_of_turn(self) -> usize {
        if self.version == 2 { 3 } else { 4 }
    }

    /// Bytes of a splat, in the order of the arrays.
    fn widths(self) -> [usize; 6] {
        [9, 1, 3, 3, self.bytes_of_turn(), coefficients_of(self.degree)]
    }

    /// Bytes of header and arrays.
    fn bytes(self) -> u64 {
        let width: usize = self.widths().iter().sum();
        HEADER as u64 + self.count as u64 * width as u64
    }

    /// Where a splat's own bytes are in that array.
    fn place(self, array: usize, splat: usize) -> Range<usize> {
        let widths = self.widths();
        let before: usize = widths[..array].iter().sum();
        let first = HEADER + before * self.count + widths[array] * splat;
        first..first + widths[array]
    }
}

/// Decompresses a file as far as its header says, and no farther.
fn inflate(main: &Bytes, watch: &ReadWatch<'_>) -> Result<(SpzLayout, Vec<u8>), Error> {
    let malformed = |problem: String| Error::malformed(Format::SPZ, "the file", problem);
    let mut decoder = GzDecoder::new(&main[..]);
    let mut header = [0; HEADER];
    let read = decoder.read_exact(&mut header);
    read.map_err(|e| malformed(format!("its header cannot be decompressed: {e}")))?;
    let layout = SpzLayout::read(header)?;
    let needed = layout.bytes();
    if needed > MOST_INFLATION * main.len() as u64 {
        return Err(malformed(format!(
            "{} splats take {needed} bytes, more than {} bytes of gzip can hold",
            layout.count,
            main.len()
        )));
    }
    watch.check_vertices(layout.count as u64)?;
    watch.reserve(needed + MOST_BEHIND)?;
    let mut out = Vec::with_capacity(needed as usize);
    out.extend(header);
    while (out.len() as u64) < needed + MOST_BEHIND {
        watch.check()?;
        let wanted = BLOCK.min(needed + MOST_BEHIND - out.len() as u64);
        let read = decoder.by_ref().take(wanted).read_to_end(&mut out);
        if read.map_err(|e| malformed(format!("it cannot be decompressed: {e}")))? == 0 {
            break;
        }
    }
    if (out.len() as u64) < needed {
        return Err(malformed(format!(
            "{} splats take {needed} bytes, it holds {}",
            layout.count,
            out.len()
        )));
    }
    Ok((layout, out))
}

/// Reads a file.
pub(super) fn read(main: Bytes, watch: &ReadWatch<'_>) -> Result<Splats, Error> {
    let (layout, bytes) = inflate(&main, watch)?;
    let (rows, width) = (layout.count, coefficients_of(layout.degree));
    watch.reserve(rows as u64 * bytes_of_splat(width))?;
    let mut splats = Splats::with_room(Format::SPZ, rows, layout.degree, main);
    let unit = 1.0 / f64::from(1u32 << layout.places);
    for row in 0..rows {
        watch.check_at(row)?;
        let part = |array: usize| &bytes[layout.place(array, row)];
        let center = part(0).as_chunks::<3>().0;
        // The highest byte has the sign.
        let coordinate = |c: usize| {
            let [a, b, sign] = center[c];
            f64::from(i32::from_le_bytes([0, a, b, sign]) >> 8) * unit
        };
        splats
            .centers
            .push(DVec3::new(coordinate(0), coordinate(1), coordinate(2)));
        let colours = part(2);
        splats.looks.push(SplatLook {
            colour: [0, 1, 2].map(|c| (f32::from(colours[c]) / 255.0 - 0.5) / COLOUR),
            opacity: logit(part(1)[0]),
        });
        let scales = part(3);
        let log_scale = [0, 1, 2].map(|c| f32::from(scales[c]) / 16.0 - 10.0);
        splats.shapes.push(SplatShape::new(unpack_turn(part(4)), log_scale));
        for (k, byte) in part(5).iter().enumerate() {
            // There the three colours of a coefficient stand together.
            splats.harmonics[row * width + (k % 3) * (width / 3) + k / 3] = (f32::from(*byte) - 128.0) / 128.0;
        }
    }
    splats.source = bytes.into();
    Ok(splats)
}

fn unpack_turn(bytes: &[u8]) -> [f32; 4] {
    let mut turn = [0.0; 4];
    if let [x, y, z] = *bytes {
        for (part, byte) in turn.iter_mut().zip([x, y, z]) {
            *part = f32::from(byte) / 127.5 - 1.0;
        }
        turn[3] = (1.0 - turn[..3].iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
        return turn;
    }
    let mut packed = bytes.iter().rev().fold(0u32, |word, byte| word << 8 | u32::from(*byte));
    let largest = (packed >> 30) as usize;
    for part in (0..4).rev().filter(|&part| part != largest) {
        let size = SMALLEST * (packed & 511) as f32 / 511.0;
        turn[part] = if packed & 512 == 0 { size } else { -size };
        packed >>= 10;
    }
    turn[largest] = (1.0 - turn.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    turn
}

fn pack_turn(turn: [f32; 4], out: &mut [u8]) {
    if let [x, y, z] = out {
        let side = if turn[3] < 0.0 { -127.5 } else { 127.5 };
        (*x, *y, *z) = (
            byte_of(turn[0] * side + 127.5),
            byte_of(turn[1] * side + 127.5),
            byte_of(turn[2] * side + 127.5),
        );
        return;
    }
    let mut largest = 0;
    for part in 1..4 {
        if turn[part].abs() > turn[largest].abs() {
            largest = part;
        }
    }
    let mut packed = largest as u32;
    for part in (0..4).filter(|&part| part != largest) {
        let sign = u32::from((turn[part] < 0.0) != (turn[largest] < 0.0));
        let size = libm::roundf(511.0 * (turn[part].abs() / SMALLEST).min(1.0)) as u32;
        packed = packed << 10 | sign << 9 | size;
    }
    out.copy_from_slice(&packed.to_le_bytes());
}

/// The file with the numbers changed of what has moved.
pub(super) fn patch(splats: &Splats) -> Result<Vec<u8>, Error> {
    let source = &splats.source;
    let mut header = [0; HEADER];
    header.copy_from_slice(&source[..HEADER]);
    let old = SpzLayout::read(header)?;
    let layout = SpzLayout {
        count: splats.len(),
        ..old
    };
    let mut bytes = header.to_vec();
    bytes[8..12].copy_from_slice(&(splats.len() as u32).to_le_bytes());
    for array in 0..layout.widths().len() {
        let own = |row: &u32| source[old.place(array, *row as usize)].iter().copied();
        bytes.extend(splats.rows.iter().flat_map(own));
    }
    bytes.extend_from_slice(&source[old.bytes() as usize..]);
    for row in (0..splats.len()).filter(|&row| splats.changes[row] > SplatChange::None) {
        put_place(splats, row, layout, &mut bytes)?;
        if splats.changes[row] == SplatChange::Divided {
            bytes[layout.place(1, row)][0] = opacity_byte(splats.looks[row].opacity);
        }
    }
    deflate(&bytes)
}

/// The binary places of coordinates in a fresh file: as many as leave room for the largest one.
fn fresh_places(splats: &Splats) -> u8 {
    let farthest = splats.centers.iter().map(|c| c.abs().max_element()).fold(0.0, f64::max);
    let fits = |places: &u8| farthest * f64::from(1u32 << places) < COORDINATE_END - 1.0;
    (0..=MOST_PLACES).rev().find(fits).unwrap_or(0)
}

/// The step of coordinates in a file of these splats: the one that they came in, or a fresh one.
pub(super) fn step(splats: &Splats) -> f64 {
    let own = splats.source.get(13).filter(|_| splats.format == Format::SPZ);
    let places = own.copied().unwrap_or_else(|| fresh_places(splats));
    1.0 / f64::from(1u32 << places.min(30))
}

/// A fresh file of version 3, with coordinates as fine as they fit.
pub(super) fn build(splats: &Splats) -> Result<Vec<u8>, Error> {
    let layout = SpzLayout {
        version: 3,
        count: splats.len(),
        degree: splats.degree,
        places: fresh_places(splats),
    };
    let mut bytes = vec![0; layout.bytes() as usize];
    for (k, word) in [MAGIC, layout.version, layout.count as u32].into_iter().enumerate() {
        bytes[4 * k..4 * k + 4].copy_from_slice(&word.to_le_bytes());
    }
    (bytes[12], bytes[13]) = (layout.degree, layout.places);
    for row in 0..splats.len() {
        let SplatLook { colour, opacity } = splats.looks[row];
        bytes[layout.place(1, row)][0] = opacity_byte(opacity);
        for (byte, colour) in bytes[layout.place(2, row)].iter_mut().zip(colour) {
            *byte = byte_of((colour * COLOUR + 0.5) * 255.0);
        }
        let shape = &splats.shapes[row];
        if !shape.is_sound() {
            pack_turn([0.0, 0.0, 0.0, 1.0], &mut bytes[layout.place(4, row)]);
            put_scales(shape.sound_scales(), &mut bytes[layout.place(3, row)]);
        }
        put_place(splats, row, layout, &mut bytes)?;
    }
    deflate(&bytes)
}

/// Writes centre, scales, rotation and harmonics.
fn put_place(splats: &Splats, row: usize, layout: SpzLayout, bytes: &mut [u8]) -> Result<(), Error> {
    let unit = f64::from(1u32 << layout.places);
    let center = &mut bytes[layout.place(0, row)];
    for (out, value) in center.chunks_exact_mut(3).zip(splats.centers[row].to_array()) {
        let whole = libm::round(value * unit);
        let fits = whole.abs() < COORDINATE_END;
        if !fits {
            let problem = format!(
                "a coordinate of splat {row} is {value}, those with {} binary places are below {}; choose ply",
                layout.places,
                COORDINATE_END / unit
            );
            return Err(Error::unwritable(Format::SPZ, problem));
        }
        out.copy_from_slice(&(whole as i32).to_le_bytes()[..3]);
    }
    let shape: &SplatShape = &splats.shapes[row];
    if shape.is_sound() {
        put_scales(shape.log_scale, &mut bytes[layout.place(3, row)]);
        pack_turn(shape.turn, &mut bytes[layout.place(4, row)]);
    }
    let width = splats.coefficients();
    for (k, byte) in bytes[layout.place(5, row)].iter_mut().enumerate() {
        let value = splats.harmonics[row * width + (k % 3) * (width / 3) + k / 3];
        *byte = byte_of(value * 128.0 + 128.0);
    }
    Ok(())
}

fn put_scales(log_scale: [f32; 3], bytes: &mut [u8]) {
    for (byte, log_scale) in bytes.iter_mut().zip(log_scale) {
        *byte = byte_of((log_scale + 10.0) * 16.0);
    }
}

/// Whether scales or harmonics are beyond what bytes hold, by more than they round. A flat splat is as thin as can be.
pub(super) fn clamps_shape(shape: &SplatShape, harmonics: &[f32]) -> bool {
    let scales = shape.log_scale.into_iter().filter(|s| s.is_finite());
    scales.map(|s| (s + 10.0) * 16.0).any(clamps) || harmonics.iter().any(|v| clamps(v * 128.0 + 128.0))
}

/// Whether colours are.
pub(super) fn clamps_colours(colours: [f32; 3]) -> bool {
    colours
        .into_iter()
        .any(|colour| clamps((colour * COLOUR + 0.5) * 255.0))
}

fn deflate(bytes: &[u8]) -> Result<Vec<u8>, Error> {
    let mut encoder = GzEncoder::new(Vec::with_capacity(bytes.len() / 2), Compression::default());
    let written = encoder.write_all(bytes).and_then(|()| encoder.finish());
    written.map_err(|e| Error::unwritable(Format::SPZ, e.to_string()))
}
