//! Texture coordinates of an OBJ for formats that divide no vertices: by vertex where all corners agree, else by corner.

use super::statements::{NO_TEXTURE, ObjStatements, parse_numbers};
use crate::asset::edited::{EditedModel, PrimitiveRun, TriangleOrigins};

/// The texture coordinates of a run, counted from the upper left corner of the picture.
pub(super) enum RunCoordinates {
    None,
    /// One for each vertex.
    OfVertices(Vec<[f32; 2]>),
    /// One for each corner of a triangle.
    OfCorners(Vec<[f32; 2]>),
}

/// Finds the coordinates of a run. `statements` are its base's.
pub(super) fn coordinates_of(
    edited: &EditedModel<'_>,
    run: &PrimitiveRun,
    statements: &ObjStatements<'_>,
) -> RunCoordinates {
    let old = &edited.base(run).model.geometry.triangles;
    let seam = &statements.corner_textures;
    if seam.len() != 3 * old.len() || seam.iter().all(|&line| line == NO_TEXTURE) {
        return RunCoordinates::None;
    }
    let pair = |line: &&[u8]| {
        let numbers = parse_numbers(line);
        let at = |i: usize| numbers.get(i).copied().filter(|v| v.is_finite()).unwrap_or(0.0);
        [at(0), at(1)]
    };
    let lines: Vec<[f64; 2]> = statements.textures.iter().map(pair).collect();
    let origins = TriangleOrigins::new(edited, run, old);
    let mut corners = Vec::with_capacity(3 * run.triangle_count as usize);
    for triangle in 0..run.triangle_count as usize {
        for k in 0..3 {
            let (mut sum, mut total) = ([0.0; 2], 0.0);
            for (corner, weight) in origins.corner(triangle, k, seam) {
                if let Some([u, v]) = lines.get(seam[corner as usize] as usize) {
                    sum = [sum[0] + u * weight, sum[1] + v * weight];
                    total += weight;
                }
            }
            let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
            corners.push([(sum[0] * scale) as f32, (1.0 - sum[1] * scale) as f32]);
        }
    }
    by_vertex(edited, run, &corners).map_or(RunCoordinates::OfCorners(corners), RunCoordinates::OfVertices)
}

/// One coordinate for each vertex, if all of its corners have the same.
fn by_vertex(edited: &EditedModel<'_>, run: &PrimitiveRun, corners: &[[f32; 2]]) -> Option<Vec<[f32; 2]>> {
    let mut of_vertex: Vec<Option<[f32; 2]>> = vec![None; run.vertex_count as usize];
    let vertices = edited.triangles[run.triangles()].as_flattened();
    for (&vertex, &here) in vertices.iter().zip(corners) {
        let known = of_vertex[(vertex - run.first_vertex) as usize].get_or_insert(here);
        if known.map(f32::to_bits) != here.map(f32::to_bits) {
            return None;
        }
    }
    Some(of_vertex.into_iter().map(Option::unwrap_or_default).collect())
}
