//! The faces around an edit, as a small mesh of their own, and those that decide what lies inside there.

use crate::graph::resample::change::GraphBefore;
use crate::graph::resample::change::{ChangedPoints, MeshChange};
use crate::graph::resample::hull::{HullChange, fan_over_loop};
use crate::graph::resample::zone::{ChangeZone, RIM};
use crate::graph::volume::columns::FaceColumns;
use crate::mesh::{Adjacency, BoundingBox, NONE};
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// Faces looked at in one go.
const BLOCK: usize = 1 << 14;
/// In a code: the fan of the point changed. The other bits say on which sides of the zone's box it lies.
const FAN: u8 = 64;
/// For each axis the sides across it.
const ACROSS: [u8; 3] = [0b11_1100, 0b11_0011, 0b00_1111];

/// Faces that an edit may have to do with.
pub(super) struct FoundFaces {
    /// Those that may meet the zone or have a point whose fan changed; rising.
    near: Vec<u32>,
    /// Those that lines through the zone along `along` may cross; rising.
    beyond: Vec<u32>,
    along: usize,
}

/// One look at all points and one at all faces.
pub(super) fn find_local(
    change: &MeshChange,
    points: &ChangedPoints,
    zone: Option<&ChangeZone>,
    pool: &Pool,
) -> FoundFaces {
    let bounds = zone.map(ChangeZone::bounds);
    let code = |p: &DVec3| match &bounds {
        None => 1,
        Some(b) => {
            let side = |axis: usize| u8::from(p[axis] < b.min[axis]) | u8::from(p[axis] > b.max[axis]) << 1;
            side(0) | side(1) << 2 | side(2) << 4
        }
    };
    let mut codes: Vec<u8> = pool.install(|| change.positions.par_iter().with_min_len(BLOCK).map(code).collect());
    points.fans.iter().for_each(|&p| codes[p as usize] |= FAN);
    // What all corners of a face share, and what any has: those sides of the box are beside the whole face.
    let both = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| codes[v as usize]);
        (a & b & c & !FAN, (a | b | c) & FAN != 0)
    };
    let seen: Vec<(u32, u8)> = pool.install(|| {
        let blocks = change.triangles.par_chunks(BLOCK).enumerate();
        let found = blocks.flat_map_iter(|(block, faces)| {
            let first = (block * BLOCK) as u32;
            let faces = faces.iter().zip(first..);
            faces.filter_map(|(t, number)| {
                let (beside, changed) = both(t);
                let wanted = changed || ACROSS.iter().any(|across| beside & across == 0);
                wanted.then_some((number, beside))
            })
        });
        found.collect()
    });
    let crossing = |axis: usize| seen.iter().filter(move |s| s.1 & ACROSS[axis] == 0);
    let count = [0, 1, 2].map(|axis| crossing(axis).count());
    let along = (1..3).fold(0, |best, axis| if count[axis] < count[best] { axis } else { best });
    let near = seen
        .iter()
        .filter(|s| s.1 == 0 || both(&change.triangles[s.0 as usize]).1);
    FoundFaces {
        near: near.map(|s| s.0).collect(),
        beyond: if zone.is_some() {
            crossing(along).map(|s| s.0).collect()
        } else {
            Vec::new()
        },
        along,
    }
}

impl FoundFaces {
    /// The faces with a corner among `wanted` (by point).
    pub(super) fn with_corner(&self, change: &MeshChange, wanted: &[bool]) -> Vec<[u32; 3]> {
        let faces = self.near.iter().map(|&t| change.triangles[t as usize]);
        faces.filter(|t| t.iter().any(|&v| wanted[v as usize])).collect()
    }
}

/// A mesh of the faces around an edit.
pub(super) struct LocalMesh {
    /// New numbers of its points, rising.
    pub(super) points: Vec<u32>,
    pub(super) positions: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) adjacency: Adjacency,
    /// For each point whether all its faces are here and its fan changed.
    pub(super) fan_changed: Vec<bool>,
}

impl LocalMesh {
    pub(super) fn gather_faces(
        change: &MeshChange,
        points: &ChangedPoints,
        found: &FoundFaces,
        zone: Option<&ChangeZone>,
        pool: &Pool,
    ) -> Self {
        let at = |v: u32| change.positions[v as usize];
        let has_fan = |v: u32| points.fans.binary_search(&v).is_ok();
        let wanted = |&&t: &&u32| {
            let t = change.triangles[t as usize];
            zone.is_some_and(|zone| zone.box_has_mark(&BoundingBox::of(&t.map(at)), RIM)) || t.into_iter().any(has_fan)
        };
        let faces: Vec<[u32; 3]> = pool.install(|| {
            let near = found.near.par_iter().with_min_len(1024).filter(|t| wanted(t));
            near.map(|&t| change.triangles[t as usize]).collect()
        });
        let mut used: Vec<u32> = faces.iter().flatten().copied().collect();
        pool.install(|| used.par_sort_unstable());
        used.dedup();
        let local = |v: u32| used.binary_search(&v).unwrap_or(0) as u32;
        let triangles: Vec<[u32; 3]> =
            pool.install(|| faces.par_iter().with_min_len(1024).map(|t| t.map(local)).collect());
        Self {
            positions: used.iter().map(|&v| at(v)).collect(),
            adjacency: Adjacency::build(used.len(), &triangles),
            fan_changed: used.iter().map(|&v| has_fan(v)).collect(),
            points: used,
            triangles,
        }
    }

    /// The number here of a point that is here.
    pub(super) fn find_local(&self, point: u32) -> Option<u32> {
        self.points.binary_search(&point).ok().map(|at| at as u32)
    }
}

/// Faces with corners of their own.
#[derive(Default)]
pub(super) struct LocalFaces {
    pub(super) positions: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl LocalFaces {
    /// Numbers the corners of named faces in the order of their names, so that an edge runs the same way in all of them.
    fn from_named_faces(faces: Vec<[u64; 3]>, at: impl Fn(u64) -> DVec3) -> Self {
        let mut names: Vec<u64> = faces.iter().flatten().copied().collect();
        names.sort_unstable();
        names.dedup();
        let local = |name: u64| names.binary_search(&name).unwrap_or(0) as u32;
        Self {
            triangles: faces.into_iter().map(|t| t.map(local)).collect(),
            positions: names.iter().map(|&name| at(name)).collect(),
        }
    }

    /// All faces that lines through the zone may cross, closed by caps.
    pub(super) fn around_zone(change: &MeshChange, hull: &HullChange, found: &FoundFaces) -> Self {
        let points = change.positions.len() as u64;
        let faces = found.beyond.iter().map(|&t| change.triangles[t as usize]);
        let enclosing = faces.filter(|t| hull.reach[t[0] as usize] != 0.0);
        let mut faces: Vec<[u64; 3]> = enclosing.map(|t| t.map(u64::from)).collect();
        let mut middles = Vec::with_capacity(hull.loops.len());
        for ring in &hull.loops {
            let (middle, edges) = fan_over_loop(ring, |v| change.positions[v as usize]);
            let name = points + middles.len() as u64;
            faces.extend(edges.map(|[a, b]| [u64::from(a), u64::from(b), name]));
            middles.push(middle);
        }
        Self::from_named_faces(faces, |name| match name.checked_sub(points) {
            Some(middle) => middles[middle as usize],
            None => change.positions[name as usize],
        })
    }

    /// What the edit added to the enclosing faces, and what it took from them, turned round: together they are closed, and
    /// enclose what became inside or outside.
    pub(super) fn between_hulls(
        old: &GraphBefore<'_>,
        change: &MeshChange,
        points: &ChangedPoints,
        hull: &HullChange,
        found: &FoundFaces,
    ) -> Self {
        let reach = old.recipe.inside.as_ref().map_or(&[][..], |inside| &inside.reach);
        let (new, before) = (change.positions.len() as u64, old.surface as u64);
        // Old points that stay where they were have the names of new ones.
        let name = |o: u32| match points.new_from_old[o as usize] {
            n if n != NONE && !points.moved[n as usize] => u64::from(n),
            _ => new + u64::from(o),
        };
        let turned = |[a, b, c]: [u64; 3]| [a, c, b];
        let mut faces: Vec<[u64; 3]> = Vec::new();
        let gone = change.removed.iter().filter(|t| reach[t[0] as usize] != 0.0);
        faces.extend(gone.map(|t| turned(t.map(name))));
        let mut added: Vec<[u32; 3]> = change.added.iter().map(|&t| change.triangles[t as usize]).collect();
        let enclosing = |t: &&[u32; 3]| hull.reach[t[0] as usize] != 0.0;
        faces.extend(added.iter().filter(enclosing).map(|t| t.map(u64::from)));
        added.sort_unstable();
        let moved = found.with_corner(change, &points.moved);
        for t in moved
            .iter()
            .filter(enclosing)
            .filter(|t| added.binary_search(t).is_err())
        {
            // A face with a new point is new, and named as such.
            if t.iter().all(|&v| (v as usize) < points.kept) {
                faces.push(t.map(u64::from));
                faces.push(turned(t.map(|v| name(change.old_from_new[v as usize]))));
            }
        }
        let mut middles: Vec<DVec3> = Vec::new();
        for ring in &hull.new_loops {
            let (middle, edges) = fan_over_loop(ring, |v| change.positions[v as usize]);
            let own = new + before + middles.len() as u64;
            faces.extend(edges.map(|[a, b]| [u64::from(a), u64::from(b), own]));
            middles.push(middle);
        }
        for ring in &hull.lost_loops {
            let (middle, edges) = fan_over_loop(ring, |v| old.positions[v as usize]);
            let own = new + before + middles.len() as u64;
            faces.extend(edges.map(|[a, b]| turned([name(a), name(b), own])));
            middles.push(middle);
        }
        Self::from_named_faces(faces, |name| {
            if name < new {
                change.positions[name as usize]
            } else if name < new + before {
                old.positions[(name - new) as usize]
            } else {
                middles[(name - new - before) as usize]
            }
        })
    }

    /// Sorted to find what lies inside, along the given axis.
    pub(super) fn sort_columns(&self, along: usize, pool: &Pool) -> FaceColumns<'_> {
        FaceColumns::along(along, &self.positions, &self.triangles, pool)
    }
}

impl FoundFaces {
    /// The axis along which the fewest faces lie beyond the zone.
    pub(super) fn best_axis(&self) -> usize {
        self.along
    }
}
