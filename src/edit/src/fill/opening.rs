//! Openings to be closed: what new faces along their loops hang on, and how they are kept apart from what is there.

use crate::region_mesh::{CAP, RegionMesh};
use glam::DVec3;
use std::collections::BTreeMap;

/// What the faces of a cap belong to and share with the surface beside them.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct CapLook<'a> {
    /// For each primitive, whether its caps have vertices of their own; no beyond the end.
    pub hard: &'a [bool],
    /// Caps are of primitives of their own: that of an opening in primitive p is this number and p.
    pub own: Option<u32>,
}

/// The loops around an opening with what their new faces hang on.
pub(crate) struct OpeningRim {
    /// The primitive of the new faces.
    pub primitive: u32,
    /// The wedge of the new faces at each point of the loops.
    pub wedges: BTreeMap<u32, u32>,
    /// The mean length of the edges that the surface has at each point.
    pub sizes: BTreeMap<u32, f64>,
}

impl OpeningRim {
    /// Loops in the direction that new faces run along them: against the faces that are there.
    pub fn from_loops(mesh: &mut RegionMesh, loops: &[Vec<u32>], look: CapLook<'_>) -> Self {
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
        let own = look.own.is_some() || look.hard.get(primitive as usize).copied().unwrap_or(false);
        let mut rim = Self {
            primitive: primitive + look.own.unwrap_or(0),
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
pub(crate) fn split_double_edges(mesh: &mut RegionMesh, first: usize) {
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
