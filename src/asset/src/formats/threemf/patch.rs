//! A 3MF whose shape alone has changed: numbers of vertices that moved, in place.

use super::package::{FORMAT, Package};
use super::part::read_part;
use super::scene::{PrintNotes, stale_parts, unwritable, uses_of_objects};
use super::words::axis_of;
use super::write;
use crate::files::ReadWatch;
use crate::formats::text::{NumberPrecision, TextPatch, push_number};
use crate::model::{is_same, position_bits};
use crate::{Error, Limits, Model, WrittenFiles};
use glam::{DAffine3, DVec3};
use pliant_exec::progress::Silent;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// The package with the vertices at `positions`.
pub(super) fn patch(model: &Model, positions: &[DVec3]) -> Result<WrittenFiles, Error> {
    let notes: &PrintNotes = model.notes_or_refuse(FORMAT)?;
    let counts = uses_of_objects(&notes.uses);
    let uses = notes.uses.iter().zip(&model.geometry.primitives);
    let mut moved: BTreeMap<(usize, u32), (DAffine3, Range<usize>)> = BTreeMap::new();
    for (one, primitive) in uses {
        let own = primitive.vertices();
        if is_same(&model.positions[own.clone()], &positions[own.clone()]) {
            continue;
        }
        let back = one.world_from_object.inverse();
        if counts.get(&(one.part, one.object)) != Some(&1) || !back.is_finite() {
            return write::write_whole(model, positions);
        }
        moved.insert((one.part, one.object), (back, own));
    }
    let limits = Limits::UNLIMITED;
    let watch = ReadWatch::new(&limits, &Silent, 0);
    let mut package = Package::open(&model.files.main)?;
    let mut replaced = BTreeMap::new();
    let parts: BTreeSet<usize> = moved.keys().map(|(part, _)| *part).collect();
    for part in parts {
        let name = &notes.scene.parts[part].name;
        let Some(bytes) = package.part(name, &watch)? else {
            return Err(unwritable(format!("the part {name} is gone")));
        };
        let mut text = TextPatch::new(&bytes);
        read_part(&bytes, name, &mut [0; 2], &watch, &mut |vertex| {
            let Some((back, own)) = moved.get(&(part, vertex.object)) else {
                return;
            };
            let at = own.start + vertex.place;
            if at < own.end && position_bits(model.positions[at]) != position_bits(positions[at]) {
                let place = back.transform_point3(positions[at]);
                push_vertex(&bytes[vertex.bytes.clone()], place, text.replace(vertex.bytes));
            }
        })?;
        replaced.insert(name.clone(), text.finish());
    }
    let mut written = WrittenFiles::single(package.rewritten(replaced)?);
    written.warnings.extend(stale_parts(&package, notes));
    Ok(written)
}

/// An element of a vertex with other coordinates; all else in it stays.
fn push_vertex(element: &[u8], place: DVec3, out: &mut Vec<u8>) {
    let mut rest = element;
    while let Some(equals) = rest.iter().position(|b| *b == b'=') {
        let quote = rest[equals..].iter().position(|b| matches!(b, b'"' | b'\''));
        let Some(open) = quote.map(|at| equals + at) else { break };
        let Some(length) = rest[open + 1..].iter().position(|b| *b == rest[open]) else {
            break;
        };
        let key = rest[..equals].trim_ascii_end();
        let key = key.rsplit(u8::is_ascii_whitespace).next().unwrap_or_default();
        let end = open + 1 + length;
        match std::str::from_utf8(key).ok().and_then(axis_of) {
            Some(axis) => {
                out.extend_from_slice(&rest[..=open]);
                push_number(out, place[axis], NumberPrecision::Double);
            }
            None => out.extend_from_slice(&rest[..end]),
        }
        rest = &rest[end..];
    }
    out.extend_from_slice(rest);
}
