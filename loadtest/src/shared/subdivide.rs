//! Larger models from smaller ones: every triangle cut into four at the middles of its edges.

use crate::failure::LoadtestFailure;
use glam::DVec3;
use pliant::asset::{FileSet, Limits, Model};
use std::collections::BTreeMap;

/// Most times that a model is subdivided: 4¹⁰ is a million triangles from one.
pub(crate) const MOST_SUBDIVISIONS: u8 = 10;

/// The model with its triangles cut `times` times, as a file of its own. Its vertices come first and keep their
/// numbers; midpoints of edges follow. Edges whose ends coincide have bit-identical midpoints.
pub(crate) fn subdivide_model(files: FileSet, times: u8) -> Result<FileSet, LoadtestFailure> {
    if times == 0 {
        return Ok(files);
    }
    let name = files.name.clone();
    let model =
        Model::read(files, None, &Limits::default()).map_err(|e| LoadtestFailure::Usage(format!("{name}: {e}")))?;
    let (mut positions, mut triangles) = (model.positions.clone(), model.triangles.clone());
    for _ in 0..times {
        if triangles.len() * 4 > Limits::default().triangles as usize {
            let most = Limits::default().triangles;
            let problem = format!(
                "{name}: {} triangles cannot be cut again, at most {most} are allowed",
                triangles.len()
            );
            return Err(LoadtestFailure::Usage(problem));
        }
        triangles = split_triangles(&mut positions, &triangles);
    }
    Ok(FileSet::single(
        format!("{name}.subdivided.ply"),
        write_ply(&positions, &triangles),
    ))
}

/// One round: appends the midpoints and returns the new triangles.
fn split_triangles(positions: &mut Vec<DVec3>, triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let mut middles = BTreeMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
            positions.push((positions[a as usize] + positions[b as usize]) * 0.5);
            positions.len() as u32 - 1
        })
    };
    triangles
        .iter()
        .flat_map(|&[a, b, c]| {
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        })
        .collect()
}

/// A binary PLY file with positions in double precision.
pub(crate) fn write_ply(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<u8> {
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
         property double z\nelement face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        positions.len(),
        triangles.len()
    );
    let mut bytes = Vec::with_capacity(header.len() + positions.len() * 24 + triangles.len() * 13);
    bytes.extend_from_slice(header.as_bytes());
    for v in positions.iter().flat_map(|p| p.to_array()) {
        bytes.extend_from_slice(&v.to_le_bytes());
    }
    for corners in triangles {
        bytes.push(3);
        corners.iter().for_each(|c| bytes.extend_from_slice(&c.to_le_bytes()));
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tetrahedron_keeps_its_vertices_and_its_shape() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
        let file = || FileSet::single("four.obj", text);
        let read = |files| Model::read(files, None, &Limits::default()).unwrap();
        let (rest, twice) = (read(file()), read(subdivide_model(file(), 2).unwrap()));
        // V − E + F stays 2: 4 − 6 + 4, then 34 − 96 + 64.
        assert_eq!((twice.positions.len(), twice.triangles.len()), (34, 64));
        assert_eq!(twice.positions[..4], rest.positions[..]);
        let area = |m: &Model| -> f64 {
            let of = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|v| m.positions[v as usize]);
                (b - a).cross(c - a).length() / 2.0
            };
            m.triangles.iter().map(of).sum()
        };
        assert!((area(&rest) - area(&twice)).abs() < 1e-14);
    }
}
