//! Deleting faces and filling holes, and what cuts use of it to close what they open.
//!
//! Openings to be closed: what new faces along their loops hang on, and how they are kept apart from what is there.

mod loop_fill;
mod polygon;

use super::error::{EditSubject, Error, ErrorPlace};
use super::patch::{EditWarning, SurfacePatch};
use super::region_mesh::{CAP, RegionMesh};
use super::surface::{BitSet, SurfaceView};
use super::topology::{boundary_loops, split_into_loops};
use crate::progress::{Progress, check};
use glam::DVec3;
use loop_fill::fill_loop;
pub(super) use loop_fill::{RefineSize, WHOLE_EDGES, refine_faces, triangulate_loop};
pub(super) use polygon::{double_area, loop_contains, triangulate_polygon};
use std::collections::{BTreeMap, BTreeSet};

/// The loops around an opening with what their new faces hang on.
pub(in crate::edit) struct OpeningRim {
    /// The primitive of the new faces.
    pub primitive: u32,
    /// The wedge of the new faces at each point of the loops.
    pub wedges: BTreeMap<u32, u32>,
    /// The mean length of the edges that the surface has at each point.
    pub sizes: BTreeMap<u32, f64>,
}

impl OpeningRim {
    /// Loops in the direction that new faces run along them: against the faces that are there.
    pub fn from_loops(mesh: &mut RegionMesh, loops: &[Vec<u32>], hard: &[bool]) -> Self {
        let mut votes: BTreeMap<u32, usize> = BTreeMap::new();
        let sides = |ring: &[u32]| -> Vec<(u32, u32)> {
            ring.iter()
                .copied()
                .zip(ring.iter().copied().cycle().skip(1))
                .take(ring.len())
                .collect()
        };
        for (a, b) in loops.iter().flat_map(|r| sides(r)) {
            if let Some(f) = mesh.faces_along(a, b).next() {
                *votes.entry(mesh.faces[f as usize].primitive).or_default() += 1;
            }
        }
        let primitive = votes
            .iter()
            .max_by_key(|(p, n)| (**n, std::cmp::Reverse(**p)))
            .map_or(0, |(p, _)| *p);
        let own = hard.get(primitive as usize).copied().unwrap_or(false);
        let mut rim = Self {
            primitive,
            wedges: BTreeMap::new(),
            sizes: BTreeMap::new(),
        };
        let mut spare = None;
        for ring in loops {
            let native: Vec<Option<u32>> = (0..ring.len())
                .map(|i| {
                    let (p, next, prev) = (
                        ring[i],
                        ring[(i + 1) % ring.len()],
                        ring[(i + ring.len() - 1) % ring.len()],
                    );
                    let beside = mesh.faces_along(p, next).chain(mesh.faces_along(p, prev));
                    let all = beside.chain(mesh.faces_around(p).iter().copied());
                    let mut faces = all
                        .map(|f| &mesh.faces[f as usize])
                        .filter(|f| f.primitive == primitive);
                    faces.next().and_then(|f| f.wedge_at(p))
                })
                .collect();
            let n = ring.len();
            for i in 0..n {
                let wedge = match native[i] {
                    Some(w) if own => mesh.add_hard_wedge(w),
                    Some(w) => w,
                    // The neighbour along the loop that has one lends its blend.
                    None => {
                        let near = (1..=n / 2).flat_map(|d| [native[(i + d) % n], native[(i + n - d) % n]]);
                        match near.flatten().next().or(spare) {
                            Some(w) => mesh.add_hard_wedge(w),
                            None => continue,
                        }
                    }
                };
                spare = spare.or(native[i]);
                rim.wedges.insert(ring[i], wedge);
            }
        }
        for &p in loops.iter().flatten() {
            rim.sizes.insert(p, mean_edge_length(mesh, p));
        }
        rim
    }

    /// Adds a face over points of the loops.
    pub fn add_face(&self, mesh: &mut RegionMesh, points: [u32; 3]) {
        let wedges = points.map(|p| self.wedges.get(&p).copied());
        if let [Some(a), Some(b), Some(c)] = wedges {
            mesh.add_face(points, [a, b, c], CAP, self.primitive);
        }
    }

    /// Fills one loop by triangles around a new point in its middle: always possible.
    pub fn fill_with_fan(&self, mesh: &mut RegionMesh, ring: &[u32]) {
        let n = ring.len();
        let sum: DVec3 = ring.iter().map(|&p| mesh.position(p)).sum();
        let middle = mesh.add_point(sum / n as f64);
        let shares: Vec<(u32, f64)> = [0, n / 3, 2 * n / 3]
            .iter()
            .filter_map(|&i| self.wedges.get(&ring[i]))
            .map(|&w| (w, 1.0 / 3.0))
            .collect();
        let wedge = mesh.blend_wedges(&shares);
        for i in 0..n {
            let (a, b) = (ring[i], ring[(i + 1) % n]);
            if let (Some(&wa), Some(&wb)) = (self.wedges.get(&a), self.wedges.get(&b)) {
                mesh.add_face([a, b, middle], [wa, wb, wedge], CAP, self.primitive);
            }
        }
    }
}

/// The mean length of the edges at a point.
fn mean_edge_length(mesh: &RegionMesh, p: u32) -> f64 {
    let here = mesh.position(p);
    let (mut sum, mut count) = (0.0, 0usize);
    for &f in mesh.faces_around(p) {
        for q in mesh.faces[f as usize].points.into_iter().filter(|&q| q != p) {
            sum += here.distance(mesh.position(q));
            count += 1;
        }
    }
    if count > 0 { sum / count as f64 } else { 0.0 }
}

/// Splits inner edges of the new faces (from `first` on) that join points which the surface joins already: without
/// this, such an edge would have four faces.
pub(in crate::edit) fn split_double_edges(mesh: &mut RegionMesh, first: usize) {
    let mut f = first;
    while f < mesh.faces.len() {
        let face = mesh.faces[f];
        let double = (0..3).find_map(|k| {
            let (a, b) = (face.points[k], face.points[(k + 1) % 3]);
            let inner = mesh.faces_along(a, b).filter(|&g| g as usize >= first).count() == 2;
            (face.alive && inner && mesh.faces_along(a, b).any(|g| (g as usize) < first)).then_some((a, b))
        });
        if let Some((a, b)) = double {
            let position = (mesh.position(a) + mesh.position(b)) * 0.5;
            let m = mesh.add_point(position);
            let sides: Vec<u32> = mesh.faces_along(a, b).filter(|&g| g as usize >= first).collect();
            let wedge = match (face.wedge_at(a), face.wedge_at(b)) {
                (Some(wa), Some(wb)) => mesh.blend_wedges(&[(wa, 0.5), (wb, 0.5)]),
                _ => face.wedges[0],
            };
            for g in sides {
                let old = mesh.faces[g as usize];
                mesh.remove_face(g);
                for end in [a, b] {
                    let (mut points, mut wedges) = (old.points, old.wedges);
                    if let Some(k) = old.corner_of(end) {
                        points[k] = m;
                        wedges[k] = wedge;
                        mesh.add_face(points, wedges, CAP, old.primitive);
                    }
                }
            }
        }
        f += 1;
    }
}

/// Removes the triangles `faces`. With `fill`, the holes that this leaves are closed by new triangles as large as those
/// around, faired; where the hole runs into the boundary of the surface it stays open, with a warning.
///
/// # Errors
/// [`Error::Impossible`] when nothing or everything is named, [`Error::TooLarge`] for a hole with too long a boundary,
/// [`Error::Cancelled`].
pub fn delete_faces(
    surface: &SurfaceView<'_>,
    faces: &[u32],
    fill: bool,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let mut faces = faces.to_vec();
    faces.sort_unstable();
    faces.dedup();
    faces.retain(|&f| (f as usize) < surface.triangles.len());
    if faces.is_empty() || faces.len() == surface.triangles.len() {
        return Err(Error::Impossible {
            problem: format!(
                "the region holds {} of {} faces; name at least one and leave at least one",
                faces.len(),
                surface.triangles.len()
            ),
            place: ErrorPlace::Argument(EditSubject::DeletedRegion),
        });
    }
    let mut mesh = RegionMesh::with_ring(surface, &faces);
    let doomed: Vec<u32> = (0..mesh.triangles.len() as u32)
        .filter(|&f| faces.binary_search(&mesh.triangles[f as usize]).is_ok())
        .collect();
    for (k, &f) in doomed.iter().enumerate() {
        // Each looks through all faces around its corners.
        if k.is_multiple_of(64) {
            check(progress)?;
        }
        mesh.remove_face(f);
    }
    if fill {
        let (closed, open) = split_into_loops(&edges_left_open(&mesh, &doomed));
        for trail in open {
            let message = format!(
                "the hole runs into the surface's rim over {} edges and is not filled",
                trail.len() - 1
            );
            let place = format!("{}", mesh.position(trail[0]));
            mesh.warnings.push(EditWarning::new("open-rim", message, place));
        }
        for ring in closed.iter().filter(|r| r.len() > 2) {
            fill_loop(&mut mesh, ring, progress)?;
        }
    }
    mesh.open_fans(&BTreeSet::new());
    // Triangles without area are not in the mesh.
    Ok(mesh.into_finite_patch(surface, faces)?.0)
}

/// The edges between removed faces and ones that are left, as faces that fill the hole would pass them, sorted.
fn edges_left_open(mesh: &RegionMesh, removed: &[u32]) -> Vec<[u32; 2]> {
    let mut open: BTreeSet<[u32; 2]> = BTreeSet::new();
    for &f in removed {
        let t = mesh.points_of(f);
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            let mut along = mesh.faces_along(a, b);
            if let (Some(g), None) = (along.next(), along.next()) {
                let forward = mesh.faces[g as usize].has_directed_edge(a, b);
                open.insert(if forward { [b, a] } else { [a, b] });
            }
        }
    }
    open.into_iter().collect()
}

/// Fills the holes whose boundary touches a point of the triangles `region`, or all holes. New triangles are as large as
/// those around and faired.
///
/// # Errors
/// [`Error::Impossible`] when there is no such hole, [`Error::TooLarge`] for one with too long a boundary,
/// [`Error::Cancelled`].
pub fn fill_holes(
    surface: &SurfaceView<'_>,
    region: Option<&[u32]>,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let (mut closed, open) = boundary_loops(surface);
    let total = closed.len();
    let wanted = region.map(|region| surface.points_of_triangles(region));
    let touches = |&p: &u32| wanted.as_ref().is_none_or(|wanted| wanted.contains(p));
    closed.retain(|ring| ring.len() > 2 && ring.iter().any(touches));
    if closed.is_empty() {
        let problem = match (total, open.len()) {
            (0, 0) => "the surface has no hole".to_owned(),
            (0, n) => format!("none of the surface's {n} rims closes to a loop"),
            (n, _) => format!("none of the surface's {n} holes touches the region; widen it up to a rim"),
        };
        return Err(Error::Impossible {
            problem,
            place: ErrorPlace::Argument(EditSubject::FilledRegion),
        });
    }
    check(progress)?;
    let mut around = BitSet::new(surface.points as usize);
    closed.iter().flatten().for_each(|&p| around.insert(p));
    let mut mesh = RegionMesh::around_points(surface, &around);
    for ring in &closed {
        let ring: Vec<u32> = ring.iter().filter_map(|&p| mesh.find_point(p)).collect();
        fill_loop(&mut mesh, &ring, progress)?;
    }
    mesh.open_fans(&BTreeSet::new());
    Ok(mesh.into_finite_patch(surface, Vec::new())?.0)
}
