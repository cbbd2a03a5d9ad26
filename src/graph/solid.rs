//! Which connected parts of a mesh enclose space, and which way leads in.
//!
//! The winding number jumps by one across a face. Across a closed surface it jumps between whole numbers; across a
//! sheet in empty space between −½ and ½; a surface with holes lies between the two. A part whose faces see values
//! nearer to a half than to a whole number is a sheet: it encloses nothing, and it is left out when other parts are
//! asked what they enclose.

use super::Error;
use super::parallel::map;
use super::winding::WindingTree;
use crate::mesh::{Adjacency, Components, Mesh};
use crate::pool::Pool;
use crate::progress::Progress;
use glam::DVec3;

/// Places of each part that are looked at.
const SAMPLES: usize = 256;
/// A part is a sheet when the winding number beside its faces is on average further than this from a whole number.
/// Measured: 0.47 to 0.50 for sheets, 0.26 for a car body without floor, under 0.07 for scans with holes.
const OPEN: f64 = 0.35;

/// A unit vector for each vertex that has one.
pub(super) type Directions = Vec<DVec3>;

/// The connected parts of a mesh, and for each whether it may enclose space.
pub(super) struct Parts {
    pub(super) components: Components,
    pub(super) solid: Vec<bool>,
}

impl Parts {
    /// Tells solids from sheets. `step` is a small length beside an edge.
    pub(super) fn sort(
        mesh: &Mesh,
        adjacency: &Adjacency,
        tree: &WindingTree,
        step: f64,
        pool: &Pool,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let components = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
        let mut solid = vec![true; components.count];
        for e in adjacency.edges.iter().filter(|e| e.forward != e.backward) {
            solid[components.of_vertex[e.vertices[0] as usize] as usize] = false;
        }
        if solid.contains(&false) {
            let part = |t: u32| components.of_vertex[mesh.triangles[t as usize][0] as usize] as usize;
            let faces = (0..mesh.triangles.len() as u32).filter(|&t| !solid[part(t)]).collect();
            let looked_at = sample(faces, components.count, part);
            let open = map(&looked_at, pool, progress, |&t| {
                let [a, b, c] = mesh.triangles[t as usize].map(|v| mesh.positions[v as usize]);
                let beside = (b - a).cross(c - a).try_normalize()? * step;
                let winding = tree.at((a + b + c) / 3.0 - beside);
                Some((winding - winding.round()).abs())
            })?;
            let mut seen = vec![(0.0, 0.0); components.count];
            for (&t, open) in looked_at.iter().zip(open).filter_map(|(t, o)| Some((t, o?))) {
                let s: &mut (f64, f64) = &mut seen[part(t)];
                *s = (s.0 + open, s.1 + 1.0);
            }
            for (solid, (sum, count)) in solid.iter_mut().zip(seen) {
                *solid |= count > 0.0 && sum <= OPEN * count;
            }
        }
        Ok(Self { components, solid })
    }

    fn is_solid(&self, vertex: u32) -> bool {
        self.solid[self.components.of_vertex[vertex as usize] as usize]
    }

    /// The faces of solid parts.
    pub(super) fn solid_triangles(&self, mesh: &Mesh) -> Vec<[u32; 3]> {
        mesh.triangles.iter().copied().filter(|t| self.is_solid(t[0])).collect()
    }

    /// Whether the solid parts have a whole winding number everywhere off their surface.
    pub(super) fn is_balanced(&self, adjacency: &Adjacency) -> bool {
        adjacency
            .edges
            .iter()
            .all(|e| e.forward == e.backward || !self.is_solid(e.vertices[0]))
    }

    /// The unit vector that leads inwards from each vertex; zero where the vertex has no normal, and on parts that
    /// enclose nothing. Normals of a part that is wound inside out are turned round. `tree` holds the solid parts.
    pub(super) fn inward(
        &self,
        mesh: &Mesh,
        adjacency: &Adjacency,
        tree: &WindingTree,
        step: f64,
        pool: &Pool,
        progress: &dyn Progress,
    ) -> Result<Directions, Error> {
        let vertices: Vec<u32> = (0..mesh.positions.len() as u32).collect();
        let mut inward = map(&vertices, pool, progress, |&v| {
            if self.is_solid(v) {
                -normal(mesh, adjacency, v)
            } else {
                DVec3::ZERO
            }
        })?;
        let part = |v: u32| self.components.of_vertex[v as usize] as usize;
        let candidates = vertices
            .into_iter()
            .filter(|&v| inward[v as usize] != DVec3::ZERO)
            .collect();
        let asked = sample(candidates, self.solid.len(), part);
        let sides = map(&asked, pool, progress, |&v| {
            let (p, d) = (mesh.positions[v as usize], inward[v as usize] * step);
            (tree.contains(p + d), tree.contains(p - d))
        })?;
        let mut votes = vec![(0usize, 0usize); self.solid.len()];
        for (&v, (ahead, behind)) in asked.iter().zip(sides) {
            let vote = &mut votes[part(v)];
            vote.0 += usize::from(ahead);
            vote.1 += usize::from(behind);
        }
        for (d, v) in inward.iter_mut().zip(0u32..) {
            match votes[part(v)] {
                (0, 0) => *d = DVec3::ZERO,
                (ahead, behind) if behind > ahead => *d = -*d,
                _ => {}
            }
        }
        Ok(inward)
    }
}

/// At most about [`SAMPLES`] members of each part, evenly spread over `members`.
fn sample(members: Vec<u32>, parts: usize, part: impl Fn(u32) -> usize) -> Vec<u32> {
    let mut size = vec![0usize; parts];
    members.iter().for_each(|&m| size[part(m)] += 1);
    let mut seen = vec![0usize; parts];
    let mut chosen = members;
    chosen.retain(|&m| {
        let part = part(m);
        seen[part] += 1;
        (seen[part] - 1).is_multiple_of(size[part].div_ceil(SAMPLES))
    });
    chosen
}

/// Unit normal of a vertex: face normals weighted by the angle at the vertex; zero where they cancel.
fn normal(mesh: &Mesh, adjacency: &Adjacency, v: u32) -> DVec3 {
    let p = mesh.positions[v as usize];
    let mut sum = DVec3::ZERO;
    for &f in adjacency.faces.of(v) {
        let t = mesh.triangles[f as usize];
        let first = t.iter().position(|&c| c == v).unwrap_or(0);
        let (a, b) = (
            mesh.positions[t[(first + 1) % 3] as usize] - p,
            mesh.positions[t[(first + 2) % 3] as usize] - p,
        );
        let cross = a.cross(b);
        let twice_area = cross.length();
        if twice_area > 0.0 {
            sum += cross / twice_area * libm::atan2(twice_area, a.dot(b));
        }
    }
    if sum.length() > 1e-9 {
        sum.normalize()
    } else {
        DVec3::ZERO
    }
}
