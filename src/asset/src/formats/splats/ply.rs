//! Gaussian splats in PLY: the numbers that 3DGS gives to each vertex, and whatever else stands beside them.

use super::super::ply::body::{PlyBody, PlyElement, PlyEncoding, PlyHeader, PlyProperty, PlyScalar, push};
use super::super::text::{TextPatch, newline_of};
use super::cloud::{SplatChange, SplatLook, SplatShape, Splats, bytes_of_splat, coefficients_of};
use crate::files::ReadWatch;
use crate::{Error, Format};
use bytes::Bytes;
use glam::{DVec3, Vec3};
use std::fmt::Write as _;

/// Bytes of a file in which the header of splats ends.
const LONGEST_HEADER: usize = 1 << 16;

/// What a number of a vertex is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SplatNumber {
    Center(usize),
    Normal(usize),
    Colour(usize),
    Harmonic(usize),
    Opacity,
    Scale(usize),
    /// Of x, y, z, w.
    Turn(usize),
}

/// Whether a PLY file is of splats: its vertices have what splats need, and there are no faces.
pub(super) fn holds_splats(bytes: &[u8]) -> bool {
    let words = &bytes[..bytes.len().min(LONGEST_HEADER)];
    let named = |name: &[u8]| words.windows(name.len()).any(|w| w == name);
    if !named(b"rot_0") || !named(b"scale_0") {
        return false;
    }
    let Ok(header) = PlyHeader::read(bytes) else {
        return false;
    };
    let has_faces = header.elements.iter().any(|e| e.rows > 0 && e.name == "face");
    !has_faces && vertex_of(&header).is_some_and(|vertex| numbers_of(vertex).is_some())
}

fn vertex_of(header: &PlyHeader) -> Option<&PlyElement> {
    header.elements.iter().find(|e| e.name == "vertex")
}

/// What each property is; `None` where one is missing that splats need. Those of surfels have two scales.
fn numbers_of(vertex: &PlyElement) -> Option<Vec<Option<SplatNumber>>> {
    let number = |name: &str| -> Option<SplatNumber> {
        let (stem, place) = name.rsplit_once('_').unwrap_or((name, ""));
        let place = place.parse::<usize>().ok();
        Some(match (stem, place) {
            ("x", None) => SplatNumber::Center(0),
            ("y", None) => SplatNumber::Center(1),
            ("z", None) => SplatNumber::Center(2),
            ("nx", None) => SplatNumber::Normal(0),
            ("ny", None) => SplatNumber::Normal(1),
            ("nz", None) => SplatNumber::Normal(2),
            ("opacity", None) => SplatNumber::Opacity,
            ("f_dc", Some(colour @ 0..=2)) => SplatNumber::Colour(colour),
            ("f_rest", Some(place)) => SplatNumber::Harmonic(place),
            ("scale", Some(axis @ 0..=2)) => SplatNumber::Scale(axis),
            ("rot", Some(0)) => SplatNumber::Turn(3),
            ("rot", Some(place @ 1..=3)) => SplatNumber::Turn(place - 1),
            _ => return None,
        })
    };
    let property = |p: &PlyProperty| {
        let is_real = p.count.is_none() && !p.scalar.is_integer();
        if is_real { number(&p.name) } else { None }
    };
    let numbers: Vec<Option<SplatNumber>> = vertex.properties.iter().map(property).collect();
    let needed = (0..3)
        .flat_map(|i| [SplatNumber::Center(i), SplatNumber::Colour(i)])
        .chain((0..4).map(SplatNumber::Turn))
        .chain([SplatNumber::Scale(0), SplatNumber::Scale(1), SplatNumber::Opacity]);
    let mut needed = needed.map(|n| numbers.contains(&Some(n)));
    needed.all(|there| there).then_some(numbers)
}

/// The degree of the harmonics of these numbers.
fn degree_of(numbers: &[Option<SplatNumber>]) -> Result<u8, Error> {
    let is_harmonic = |n: &&Option<SplatNumber>| matches!(n, Some(SplatNumber::Harmonic(_)));
    let count = numbers.iter().filter(is_harmonic).count();
    let whole = (0..count).all(|k| numbers.contains(&Some(SplatNumber::Harmonic(k))));
    let degree = (0..=3).find(|&degree| coefficients_of(degree) == count);
    degree.filter(|_| whole).ok_or_else(|| {
        Error::unsupported(
            Format::PLY,
            "header",
            format!("{count} properties f_rest_…"),
            "allowed are 0, 9, 24 or 45, numbered from 0: spherical harmonics of degree 0 to 3",
        )
    })
}

/// Goes to the vertices of a body whose rows fit.
fn body_at_vertices<'a>(bytes: &'a [u8], header: &PlyHeader) -> Result<PlyBody<'a>, Error> {
    let mut body = PlyBody::starting_at(bytes, header.encoding, header.body.0, header.body.1);
    for element in &header.elements {
        body.require_rows_of(element, header.encoding)?;
        if element.name == "vertex" {
            break;
        }
        body.skip_rows(element)?;
    }
    Ok(body)
}

/// The header, its vertices and what their properties are.
fn layout_of(bytes: &[u8]) -> Result<(PlyHeader, PlyElement, Vec<Option<SplatNumber>>), Error> {
    let header = PlyHeader::read(bytes)?;
    let found = vertex_of(&header).and_then(|vertex| Some((vertex.clone(), numbers_of(vertex)?)));
    let Some((vertex, numbers)) = found else {
        let problem =
            "element `vertex` needs the real numbers x, y, z, f_dc_0 to 2, opacity, scale_0 to 1 or 2 and rot_0 to 3";
        return Err(Error::malformed(Format::PLY, "header", problem));
    };
    Ok((header, vertex, numbers))
}

/// Reads a file of splats.
pub(super) fn read(main: Bytes, watch: &ReadWatch<'_>) -> Result<Splats, Error> {
    let (header, vertex, numbers) = layout_of(&main)?;
    let degree = degree_of(&numbers)?;
    let width = coefficients_of(degree);
    let mut body = body_at_vertices(&main, &header)?;
    watch.check_vertices(vertex.rows)?;
    watch.reserve(vertex.rows.saturating_mul(bytes_of_splat(width)))?;
    let rows = vertex.rows as usize;
    let has_normals = numbers.contains(&Some(SplatNumber::Normal(0)));
    let mut splats = Splats {
        normals: Vec::with_capacity(if has_normals { rows } else { 0 }),
        beyond: beyond(&header, &vertex, &numbers),
        ..Splats::with_room(Format::PLY, rows, degree, main.clone())
    };
    for row in 0..rows {
        watch.check_at(row)?;
        let (mut center, mut normal) = (DVec3::ZERO, Vec3::ZERO);
        let (mut turn, mut log_scale) = ([0.0f32; 4], [f32::NEG_INFINITY; 3]);
        let mut look = SplatLook {
            colour: [0.0; 3],
            opacity: 0.0,
        };
        for (property, number) in vertex.properties.iter().zip(&numbers) {
            let Some(number) = number else {
                body.skip_property(property)?;
                continue;
            };
            let value = body.read_normal(property.scalar)?;
            match *number {
                SplatNumber::Center(axis) => center[axis] = value,
                SplatNumber::Normal(axis) => normal[axis] = value as f32,
                SplatNumber::Colour(colour) => look.colour[colour] = value as f32,
                SplatNumber::Harmonic(k) => splats.harmonics[row * width + k] = value as f32,
                SplatNumber::Opacity => look.opacity = value as f32,
                SplatNumber::Scale(axis) => log_scale[axis] = value as f32,
                SplatNumber::Turn(place) => turn[place] = value as f32,
            }
        }
        splats.centers.push(center);
        splats.shapes.push(SplatShape::new(turn, log_scale));
        splats.looks.push(look);
        if has_normals {
            splats.normals.push(normal);
        }
    }
    if splats.normals.iter().all(|normal| *normal == Vec3::ZERO) {
        splats.normals = Vec::new();
    }
    Ok(splats)
}

/// What a file has that other formats of splats have not, in words.
fn beyond(header: &PlyHeader, vertex: &PlyElement, numbers: &[Option<SplatNumber>]) -> Vec<String> {
    let known = numbers.iter().map(Option::is_some);
    let others = vertex.properties.iter().zip(known).filter(|(_, known)| !known);
    let others = others.map(|(p, _)| format!("property `{}`", p.name));
    let elements = header.elements.iter().filter(|e| e.rows > 0 && e.name != "vertex");
    others
        .chain(elements.map(|e| format!("element `{}`", e.name)))
        .collect()
}

/// The file with the rows of these splats alone, each as often as it is there.
fn with_rows(splats: &Splats) -> Result<Vec<u8>, Error> {
    let bytes = &splats.source;
    let (header, vertex, _) = layout_of(bytes)?;
    let is_text = header.encoding == PlyEncoding::Ascii;
    let mut body = body_at_vertices(bytes, &header)?;
    let mut starts = vec![body.next_place().0];
    for _ in 0..vertex.rows {
        for property in &vertex.properties {
            body.skip_property(property)?;
        }
        starts.push(body.next_place().0);
    }
    let (first, end) = (starts[0], starts[vertex.rows as usize]);
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    for line in bytes[..header.body.0].split_inclusive(|byte| *byte == b'\n') {
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        let names_count = words.next() == Some(b"element") && words.next() == Some(b"vertex");
        match words.next().filter(|_| names_count) {
            Some(count) => {
                let place = line.windows(count.len()).rposition(|word| word == count).unwrap_or(0);
                out.extend_from_slice(&line[..place]);
                out.extend_from_slice(splats.len().to_string().as_bytes());
                out.extend_from_slice(&line[place + count.len()..]);
            }
            None => out.extend_from_slice(line),
        }
        at += line.len();
    }
    out.extend_from_slice(&bytes[at..first]);
    let newline = newline_of(bytes);
    for &row in &splats.rows {
        let own = &bytes[starts[row as usize]..starts[row as usize + 1]];
        match is_text {
            true => {
                out.extend_from_slice(own.trim_ascii());
                out.extend_from_slice(newline);
            }
            false => out.extend_from_slice(own),
        }
    }
    let rest = &bytes[end..];
    out.extend_from_slice(if is_text { rest.trim_ascii_start() } else { rest });
    Ok(out)
}

/// The file with the numbers changed of what has moved.
pub(super) fn patch(splats: &Splats) -> Result<Vec<u8>, Error> {
    let chosen;
    let bytes = match splats.is_whole() {
        true => &splats.source[..],
        false => {
            chosen = with_rows(splats)?;
            &chosen[..]
        }
    };
    let (header, vertex, numbers) = layout_of(bytes)?;
    let width = splats.coefficients();
    let mut body = body_at_vertices(bytes, &header)?;
    let mut patch = TextPatch::new(bytes);
    for row in 0..splats.len() {
        let change = splats.changes[row];
        let shape = &splats.shapes[row];
        for (property, number) in vertex.properties.iter().zip(&numbers) {
            let changed = match *number {
                Some(SplatNumber::Center(axis)) => Some(splats.centers[row][axis]),
                Some(SplatNumber::Normal(axis)) => splats.normals.get(row).map(|normal| f64::from(normal[axis])),
                Some(SplatNumber::Harmonic(k)) => Some(f64::from(splats.harmonics[row * width + k])),
                Some(SplatNumber::Scale(axis)) => shape.is_sound().then(|| f64::from(shape.log_scale[axis])),
                Some(SplatNumber::Turn(place)) => shape.is_sound().then(|| f64::from(shape.turn[place])),
                Some(SplatNumber::Opacity) => {
                    (change == SplatChange::Divided).then(|| f64::from(splats.looks[row].opacity))
                }
                Some(SplatNumber::Colour(_)) | None => None,
            };
            let Some(value) = changed.filter(|_| change > SplatChange::None) else {
                body.skip_property(property)?;
                continue;
            };
            let place = body.skip_number(property.scalar)?;
            // A flat splat has a logarithm that is infinite, and keeps it.
            if value.is_finite() {
                check_size(Format::PLY, row, value)?;
                push(patch.replace(place), value, property.scalar, header.encoding);
            }
        }
    }
    Ok(patch.finish())
}

/// Whether a file of theirs has centres as doubles: their own one may.
pub(super) fn has_double_centers(splats: &Splats) -> bool {
    let own = (splats.format == Format::PLY)
        .then(|| layout_of(&splats.source).ok())
        .flatten();
    own.is_some_and(|(_, vertex, numbers)| {
        let mut centers = vertex.properties.iter().zip(numbers);
        centers.all(|(p, number)| !matches!(number, Some(SplatNumber::Center(_))) || p.scalar == PlyScalar::F64)
    })
}

/// Refuses what single precision does not hold.
pub(super) fn check_size(format: Format, splat: usize, value: f64) -> Result<(), Error> {
    match (value as f32).is_finite() {
        true => Ok(()),
        false => {
            let problem = format!("a number of splat {splat} is {value}, too large for the file's floats");
            Err(Error::unwritable(format, problem))
        }
    }
}

/// A fresh file, as 3DGS writes it.
pub(super) fn build(splats: &Splats) -> Result<Vec<u8>, Error> {
    let width = splats.coefficients();
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n",
        splats.len()
    );
    let rest = (0..width).map(|k| format!("f_rest_{k}"));
    let first = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(str::to_owned);
    let last = "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
        .split(' ')
        .map(str::to_owned);
    for name in first.into_iter().chain(rest).chain(last) {
        let result = writeln!(header, "property float {name}");
        debug_assert!(result.is_ok(), "writing to memory does not fail");
    }
    let mut out = header.into_bytes();
    out.extend(b"end_header\n");
    out.reserve(splats.len() * 4 * (17 + width));
    for row in 0..splats.len() {
        for value in splats.centers[row].to_array() {
            check_size(Format::PLY, row, value)?;
            out.extend((value as f32).to_le_bytes());
        }
        let (shape, look) = (&splats.shapes[row], &splats.looks[row]);
        let normal = splats.normals.get(row).copied().unwrap_or(Vec3::ZERO);
        // One that is none is written as none.
        let [x, y, z, w] = shape.turn.map(|part| if part.is_finite() { part } else { 0.0 });
        let harmonics = &splats.harmonics[row * width..(row + 1) * width];
        let numbers = normal
            .to_array()
            .into_iter()
            .chain(look.colour)
            .chain(harmonics.iter().copied());
        let numbers = numbers.chain([look.opacity]).chain(shape.log_scale).chain([w, x, y, z]);
        out.extend(numbers.flat_map(f32::to_le_bytes));
    }
    Ok(out)
}
