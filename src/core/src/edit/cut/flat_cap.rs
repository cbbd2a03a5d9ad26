//! Closing flat openings: the loops that a plane leaves are filled by triangles in that plane.
//!
//! Loops inside loops are holes of the section, loops inside those are islands. Each opening's triangles belong to the
//! primitive that most of its edges have.

use crate::edit::boundary::split_into_loops;
use crate::edit::error::Error;
use crate::edit::fill::{
    OpeningRim, RefineSize, WHOLE_EDGES, double_area, loop_contains, refine_faces, split_double_edges,
    triangulate_polygon,
};
use crate::edit::patch::EditWarning;
use crate::edit::region_mesh::RegionMesh;
use crate::progress::{Progress, check};
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;

/// Fills the openings along `open_sides` (sides of living faces: from, to, face), which lie in a plane with the outward
/// normal `normal`. `hard[p]`: caps of primitive `p` do not share vertices with the surface beside them.
pub(super) fn cap_flat_openings(
    mesh: &mut RegionMesh,
    open_sides: &[(u32, u32, u32)],
    normal: DVec3,
    hard: &[bool],
    progress: &dyn Progress,
) -> Result<(), Error> {
    let closed = gather_section_loops(mesh, open_sides);
    let Some(origin) = closed.first().map(|ring| mesh.position(ring[0])) else {
        return Ok(());
    };
    let right = normal.any_orthonormal_vector();
    let up = normal.cross(right);
    let mut flat: Vec<DVec2> = Vec::new();
    let mut number: BTreeMap<u32, u32> = BTreeMap::new();
    let mut points: Vec<u32> = Vec::new();
    for &p in closed.iter().flatten() {
        number.entry(p).or_insert_with(|| {
            let x = mesh.position(p) - origin;
            flat.push(DVec2::new(x.dot(right), x.dot(up)));
            points.push(p);
            points.len() as u32 - 1
        });
    }
    let rings: Vec<Vec<u32>> = closed
        .iter()
        .map(|ring| ring.iter().map(|p| number[p]).collect())
        .collect();
    for (outer, holes) in nest_loops(&mut flat, &rings) {
        check(progress)?;
        let mut at = flat.clone();
        let mirrored = double_area(|p| at[p as usize], outer) < 0.0;
        if mirrored {
            at.iter_mut().for_each(|p| p.y = -p.y);
        }
        let triangles = triangulate_polygon(&at, outer, &holes, progress)?;
        let loops: Vec<Vec<u32>> = std::iter::once(outer)
            .chain(holes.iter().map(Vec::as_slice))
            .map(|ring| ring.iter().map(|&p| points[p as usize]).collect())
            .collect();
        let mut rim = OpeningRim::from_loops(mesh, &loops, hard);
        rim.sizes.values_mut().for_each(|s| *s *= WHOLE_EDGES);
        let first = mesh.faces.len();
        match triangles {
            Some(triangles) => {
                for t in triangles {
                    rim.add_face(mesh, t.map(|p| points[p as usize]));
                }
            }
            None => loops.iter().for_each(|ring| rim.fill_with_fan(mesh, ring)),
        }
        split_double_edges(mesh, first);
        refine_faces(
            mesh,
            first,
            &rim.sizes,
            RefineSize::for_loop(rim.wedges.len()),
            progress,
        )?;
    }
    Ok(())
}

/// The loops of a section in the direction that its caps run along them; what encloses nothing is warned of.
fn gather_section_loops(mesh: &mut RegionMesh, open_sides: &[(u32, u32, u32)]) -> Vec<Vec<u32>> {
    let edges: Vec<[u32; 2]> = open_sides.iter().map(|&(from, to, _)| [to, from]).collect();
    let (mut closed, open) = split_into_loops(&edges);
    for trail in open {
        let ends = [trail[0], trail[trail.len() - 1]].map(|p| mesh.position(p));
        warn_of_open_section(mesh, &trail, format!("{} to {}", ends[0], ends[1]));
    }
    closed.retain(|ring| {
        if ring.len() < 3 {
            let place = format!("{}", mesh.position(ring[0]));
            let message = "a section of two edges is not filled";
            mesh.warnings.push(EditWarning::new("open-section", message, place));
        }
        ring.len() >= 3
    });
    closed
}

/// Warns that a cut runs from boundary to boundary along `trail` and so encloses nothing.
pub(super) fn warn_of_open_section(mesh: &mut RegionMesh, trail: &[u32], place: String) {
    let message = format!(
        "the cut runs from rim to rim over {} edges and encloses nothing to fill",
        trail.len() - 1
    );
    mesh.warnings.push(EditWarning::new("open-section", message, place));
}

/// Sorts loops into openings: an outer loop and its holes. Mirrors all coordinates when most of the section is wound
/// clockwise: the surface is inside out.
fn nest_loops<'a>(flat: &mut [DVec2], rings: &'a [Vec<u32>]) -> Vec<(&'a [u32], Vec<Vec<u32>>)> {
    let total: f64 = rings.iter().map(|r| double_area(|p| flat[p as usize], r)).sum();
    if total < 0.0 {
        flat.iter_mut().for_each(|p| p.y = -p.y);
    }
    let at = |p: u32| flat[p as usize];
    let area: Vec<f64> = rings.iter().map(|r| double_area(at, r)).collect();
    let bounds: Vec<(DVec2, DVec2)> = (rings.iter())
        .map(|r| {
            r.iter()
                .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), &p| {
                    (low.min(at(p)), high.max(at(p)))
                })
        })
        .collect();
    let mut holes: Vec<Vec<Vec<u32>>> = vec![Vec::new(); rings.len()];
    let mut outer: Vec<usize> = Vec::new();
    for (i, ring) in rings.iter().enumerate() {
        if area[i] >= 0.0 {
            outer.push(i);
            continue;
        }
        let around = (0..rings.len())
            .filter(|&j| area[j] > 0.0 && area[j] >= -area[i])
            .filter(|&j| bounds[j].0.cmple(bounds[i].0).all() && bounds[j].1.cmpge(bounds[i].1).all())
            .filter(|&j| {
                let side = ring.iter().find_map(|&p| loop_contains(at, &rings[j], at(p)));
                side.unwrap_or(true)
            })
            .min_by(|&a, &b| area[a].total_cmp(&area[b]));
        match around {
            Some(j) => holes[j].push(ring.clone()),
            // Nothing around it: a part that is inside out, filled by itself.
            None => outer.push(i),
        }
    }
    outer
        .into_iter()
        .map(|i| (rings[i].as_slice(), std::mem::take(&mut holes[i])))
        .collect()
}
