//! OFF out: the uploaded text with the changed numbers replaced, or a fresh text.

use super::super::text::{NumberPrecision, TextLexer, TextPatch, push_triple};
use super::read::{OffNotes, STYLE, three_words};
use crate::asset::Geometry;
use crate::asset::neutral::NeutralModel;
use crate::mesh::shading;
use glam::DVec3;

/// The uploaded text with the vertices at `positions`.
pub(super) fn patch(bytes: &[u8], notes: &OffNotes, rest: &Geometry, positions: &[DVec3]) -> Vec<u8> {
    let gradients = notes.has_normals.then(|| {
        shading::gradients(
            &rest.positions,
            positions,
            &rest.triangles,
            &rest.triangles,
            positions.len(),
        )
    });
    let mut lexer = TextLexer::starting_at(bytes, notes.vertices_at as usize, 1, STYLE);
    let mut patch = TextPatch::new(bytes);
    for (i, (&old, &new)) in rest.positions.iter().zip(positions).enumerate() {
        if let Some(words) = three_words(&mut lexer) {
            patch.replace_changed(words, old, new, NumberPrecision::Double);
        }
        if let Some(gradients) = &gradients
            && let Some(words) = three_words(&mut lexer)
            && let Some(gradient) = &gradients[i]
        {
            let (old, new) = (rest.normals[i], shading::carry_normal(gradient, rest.normals[i]));
            patch.replace_changed(words, old.as_dvec3(), new.as_dvec3(), NumberPrecision::Single);
        }
        lexer.end_line();
    }
    patch.finish()
}

/// A fresh text, with normals where every vertex has one, colours where any has some, and polygons as they were.
pub(super) fn build(neutral: &NeutralModel) -> Vec<u8> {
    let geometry = &neutral.geometry;
    let with_normals = geometry.all_have_normals();
    let faces: usize = neutral.primitives().map(|own| own.face_count()).sum();
    let colours = &neutral.colours;
    let keyword = match (colours.is_empty(), with_normals) {
        (true, false) => "OFF",
        (true, true) => "NOFF",
        (false, false) => "COFF",
        (false, true) => "CNOFF",
    };
    let mut out = format!("{keyword}\n{} {faces} 0\n", geometry.positions.len()).into_bytes();
    for (i, &position) in geometry.positions.iter().enumerate() {
        push_triple(&mut out, position, NumberPrecision::Double);
        if with_normals {
            out.push(b' ');
            push_triple(&mut out, geometry.normals[i].as_dvec3(), NumberPrecision::Single);
        }
        for share in colours.get(i).into_iter().flatten() {
            out.extend(format!(" {}", (share.clamp(0.0, 1.0) * 255.0).round()).bytes());
        }
        out.push(b'\n');
    }
    for own in neutral.primitives() {
        own.each_face(|corners| {
            out.extend(corners.len().to_string().bytes());
            for &corner in corners {
                out.extend(format!(" {}", own.vertex_at(corner)).bytes());
            }
            out.push(b'\n');
        });
    }
    out
}
