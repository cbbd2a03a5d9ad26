//! What is drawn between the vertices that a primitive names: triangles, lines and points.

use super::document::GltfDocument;
use super::schema::MeshPrimitive;
use crate::Error;
use crate::files::ReadWatch;
use std::ops::Range;

/// Which of its `vertices` in the model a primitive of points or lines names, in order; those that there are not are left out.
pub(super) fn stored_elements(
    doc: &GltfDocument<'_>,
    primitive: &MeshPrimitive,
    vertices: Range<usize>,
) -> Result<Vec<u32>, Error> {
    let count = vertices.len() as u32;
    let stored = match primitive.indices {
        Some(indices) => {
            doc.decode_for([indices.index()])?;
            doc.read_indices(indices.index())?
        }
        None => (0..count).collect(),
    };
    let first = vertices.start as u32;
    Ok(stored.into_iter().filter(|v| *v < count).map(|v| first + v).collect())
}

/// The pairs of vertices that lines of a mode are drawn between.
pub(super) fn segments_between(vertices: &[u32], mode: u64) -> Vec<[u32; 2]> {
    let strip = vertices.windows(2).map(|pair| [pair[0], pair[1]]);
    match (mode, vertices) {
        (1, _) => vertices.as_chunks::<2>().0.to_vec(),
        (2, [first, .., last]) => strip.chain([[*last, *first]]).collect(),
        _ => strip.collect(),
    }
}

/// What is to be said of indices of points and lines that name none of so many vertices. They stay as they are stored until an
/// edit leaves them out.
pub(super) fn indices_beyond(
    doc: &GltfDocument<'_>,
    primitive: &MeshPrimitive,
    vertices: u64,
    watch: &ReadWatch<'_>,
) -> Result<Option<String>, Error> {
    let Some(indices) = primitive.indices else {
        return Ok(None);
    };
    let bytes = doc.accessors.values[indices.index()].count.0.saturating_mul(8);
    watch.reserve(bytes)?;
    let stored = doc.read_indices(indices.index())?;
    watch.release(bytes);
    let beyond = stored.iter().filter(|v| u64::from(**v) >= vertices).count();
    let message =
        format!("{beyond} indices of points or lines name no vertex, there are {vertices}; an edit leaves them out");
    Ok((beyond > 0).then_some(message))
}

/// Lists, strips and fans become triangles; those of strips and fans that only stitch pieces together are left out.
pub(super) fn to_triangles(corners: &[u32], mode: u64) -> Vec<[u32; 3]> {
    let stitched = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
    match (mode, corners) {
        (4, _) => corners.as_chunks::<3>().0.to_vec(),
        (5, _) => corners
            .windows(3)
            .enumerate()
            .map(|(i, w)| {
                if i % 2 == 0 {
                    [w[0], w[1], w[2]]
                } else {
                    [w[0], w[2], w[1]]
                }
            })
            .filter(stitched)
            .collect(),
        (_, [center, rim @ ..]) => rim.windows(2).map(|w| [w[0], w[1], *center]).filter(stitched).collect(),
        _ => Vec::new(),
    }
}
