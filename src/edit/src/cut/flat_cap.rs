//! Closing flat openings: the loops that a plane leaves are filled by triangles in that plane.
//!
//! Loops inside loops are holes of the section, loops inside those are islands. Each opening's triangles belong to the
//! primitive that most of its edges have.
//!
//! Closing an opening in any shape by the shortest way, alike on both sides of a cut.
//!
//! The cap depends on nothing but the loop, begun at the same point in the same direction from either side; so the caps
//! of two parts fit, and their volumes add up to that of the whole.

use crate::fill::{
    CapLook, OpeningRim, RefineSize, WHOLE_EDGES, double_area, loop_contains, refine_faces, split_double_edges,
    triangulate_loop, triangulate_polygon,
};
use crate::patch::EditWarning;
use crate::region_mesh::{CAP, RegionMesh, Wedge};
use crate::topology::split_into_loops;
use glam::{DVec2, DVec3};
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Error, NONE};
use std::collections::BTreeMap;

/// Fills the openings along `open_sides` (sides of living faces: from, to, face), which lie in a plane with the outward
/// normal `normal`.
pub(crate) fn cap_flat_openings(
    mesh: &mut RegionMesh,
    open_sides: &[(u32, u32, u32)],
    normal: DVec3,
    look: CapLook<'_>,
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
        let mut rim = OpeningRim::from_loops(mesh, &loops, look);
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
            // Nothing around it: a part that is inside out, filled on its own.
            None => outer.push(i),
        }
    }
    outer
        .into_iter()
        .map(|i| (rings[i].as_slice(), std::mem::take(&mut holes[i])))
        .collect()
}

/// Fills the opening inside `ring`, given in the direction that the new faces run along it.
pub(super) fn cap_opening_alike(
    mesh: &mut RegionMesh,
    ring: &[u32],
    look: CapLook<'_>,
    progress: &dyn Progress,
) -> Result<(), Error> {
    let n = ring.len();
    let root = |i: usize| mesh.points[ring[i % n] as usize].root;
    let start = (0..n).min_by_key(|&i| root(i)).unwrap_or(0);
    let turned = root(start + n - 1) < root(start + 1);
    let common: Vec<u32> = (0..n)
        .map(|i| ring[if turned { start + n - i } else { start + i } % n])
        .collect();
    let cap = mesh_cap(mesh, &common, progress)?;

    let rim = OpeningRim::from_loops(mesh, &[ring.to_vec()], look);
    let first = mesh.faces.len();
    let mut point = common.clone();
    point.extend(cap.points[n..].iter().map(|p| mesh.add_point(p.position)));
    let mut wedge: BTreeMap<u32, u32> = BTreeMap::new();
    for face in cap.faces.iter().filter(|f| f.alive) {
        let mut points = face.points.map(|p| point[p as usize]);
        let mut wedges = [0; 3];
        for k in 0..3 {
            let w = cap.wedges[face.wedges[k] as usize];
            let of = |i: usize| rim.wedges.get(&common[w.of[i] as usize]).copied();
            let simple = (face.points[k] as usize) < n;
            let mixed = match (simple, wedge.get(&face.wedges[k])) {
                (true, _) => rim.wedges.get(&points[k]).copied(),
                (false, Some(&w)) => Some(w),
                (false, None) => {
                    let parts: Vec<(u32, f64)> = (0..3)
                        .filter(|&i| w.weights[i] > 0.0)
                        .filter_map(|i| Some((of(i)?, w.weights[i])))
                        .collect();
                    Some(mesh.blend_wedges(&parts))
                }
            };
            let Some(mixed) = mixed else {
                return Ok(());
            };
            wedge.insert(face.wedges[k], mixed);
            wedges[k] = mixed;
        }
        if turned {
            points.swap(1, 2);
            wedges.swap(1, 2);
        }
        mesh.add_face(points, wedges, CAP, rim.primitive);
    }
    split_double_edges(mesh, first);
    split_twin_faces(mesh, first);
    Ok(())
}

/// Makes the cap on its own, with places in the loop `ring` for points and vertices alike.
fn mesh_cap(mesh: &RegionMesh, ring: &[u32], progress: &dyn Progress) -> Result<RegionMesh, Error> {
    let n = ring.len();
    let mut cap = RegionMesh::default();
    let mut sizes: BTreeMap<u32, f64> = BTreeMap::new();
    for i in 0..n {
        let at = |k: usize| mesh.position(ring[k % n]);
        let p = cap.add_point(at(i));
        cap.add_wedge(Wedge {
            vertex: NONE,
            point: NONE,
            of: [p; 3],
            weights: [1.0, 0.0, 0.0],
        });
        let beside = at(i).distance(at(i + 1)) + at(i).distance(at(i + n - 1));
        sizes.insert(p, beside * 0.5 * WHOLE_EDGES);
    }
    let all: Vec<u32> = (0..n as u32).collect();
    match triangulate_loop(&cap, &all, false, progress)? {
        Some(triangles) => triangles.into_iter().for_each(|t| {
            cap.add_face(t, t, CAP, 0);
        }),
        None => {
            let rim = OpeningRim {
                primitive: 0,
                wedges: all.iter().map(|&p| (p, p)).collect(),
                sizes: sizes.clone(),
            };
            rim.fill_with_fan(&mut cap, &all);
        }
    }
    refine_faces(&mut cap, 0, &sizes, RefineSize::for_loop(n), progress)?;
    Ok(cap)
}

/// Splits a new face whose corners are those of an old one.
fn split_twin_faces(mesh: &mut RegionMesh, first: usize) {
    for f in first..mesh.faces.len() {
        let face = mesh.faces[f];
        let [a, b, c] = face.points;
        let twin = |g: u32| (g as usize) < first && mesh.faces[g as usize].corner_of(c).is_some();
        if face.alive && mesh.faces_along(a, b).any(twin) {
            let sum: glam::DVec3 = face.points.iter().map(|&p| mesh.position(p)).sum();
            mesh.split_face(f as u32, [1.0 / 3.0; 3], sum / 3.0);
        }
    }
}
