//! The free part of a surface around triangles that cross, with the neighbours of each of its vertices.

use glam::DVec3;
use pliant_mesh::{Mesh, NONE, sorted_set};

/// The region. Its first vertices are free; after them come those around, which stay.
pub(super) struct ContactRegion {
    /// Solver vertices.
    pub nodes: Vec<u32>,
    /// How many of them are free.
    pub free: usize,
    /// By solver vertex: its place in `nodes`, or [`NONE`].
    pub local: Vec<u32>,
    /// Neighbours of each node, as places in `nodes`; of a node that stays those alone that are in the region.
    pub neighbours: Vec<Vec<u32>>,
    /// How many neighbours each node has on the whole surface.
    pub degrees: Vec<f64>,
    /// By face: whether one of its corners is free in the region.
    pub is_near: Vec<bool>,
    /// The median edge, model units.
    pub edge: f64,
}

impl ContactRegion {
    /// The region around pairs of faces, so many rings of faces far. `held` says which vertices stay.
    pub fn around(mesh: &Mesh, held: &[bool], crossings: &[[u32; 2]], rings: usize) -> Self {
        let vertices = mesh.positions.len();
        let mut is_inside = vec![false; vertices];
        for t in crossings.as_flattened() {
            mesh.triangles[*t as usize]
                .iter()
                .for_each(|v| is_inside[*v as usize] = true);
        }
        // What is held is a border: the region does not go on behind it.
        let grows = |v: u32, ring: usize, is_inside: &[bool]| is_inside[v as usize] && (ring == 0 || !held[v as usize]);
        for ring in 0..rings {
            let met = mesh
                .triangles
                .iter()
                .filter(|t| t.iter().any(|v| grows(*v, ring, &is_inside)));
            let met: Vec<u32> = met.flatten().copied().collect();
            met.iter().for_each(|v| is_inside[*v as usize] = true);
        }
        let all = 0..vertices as u32;
        let mut nodes: Vec<u32> = all.filter(|&v| is_inside[v as usize] && !held[v as usize]).collect();
        let free = nodes.len();
        let mut local = vec![NONE; vertices];
        (0u32..).zip(&nodes).for_each(|(k, v)| local[*v as usize] = k);
        let is_near: Vec<bool> = (mesh.triangles.iter())
            .map(|t| t.iter().any(|v| local[*v as usize] != NONE))
            .collect();
        let near = || {
            (mesh.triangles.iter().zip(&is_near))
                .filter(|(_, near)| **near)
                .map(|(t, _)| t)
        };
        let rim = sorted_set(near().flatten().copied().filter(|v| local[*v as usize] == NONE));
        (free as u32..).zip(&rim).for_each(|(k, v)| local[*v as usize] = k);
        nodes.extend(rim);

        let mut around: Vec<Vec<u32>> = vec![Vec::new(); nodes.len()];
        for t in mesh
            .triangles
            .iter()
            .filter(|t| t.iter().any(|v| local[*v as usize] != NONE))
        {
            for (k, v) in t.iter().enumerate() {
                if let Some(own) = around.get_mut(local[*v as usize] as usize) {
                    own.extend([t[(k + 1) % 3], t[(k + 2) % 3]]);
                }
            }
        }
        let around: Vec<Vec<u32>> = around.into_iter().map(sorted_set).collect();
        let degrees = around.iter().map(|own| own.len() as f64).collect();
        let inside = |own: Vec<u32>| {
            own.into_iter()
                .map(|v| local[v as usize])
                .filter(|k| *k != NONE)
                .collect()
        };
        let neighbours = around.into_iter().map(inside).collect();
        let length = |t: &[u32; 3]| mesh.positions[t[0] as usize].distance(mesh.positions[t[1] as usize]);
        let mut lengths: Vec<f64> = near().map(length).collect();
        lengths.sort_unstable_by(f64::total_cmp);
        Self {
            edge: lengths.get(lengths.len() / 2).copied().unwrap_or(0.0),
            nodes,
            free,
            local,
            neighbours,
            degrees,
            is_near,
        }
    }

    /// Subtracts from each node, times its number of neighbours, what they have; what is beyond the region has nothing. `values` may end
    /// after the free nodes.
    pub fn laplace(&self, values: &[DVec3], out: &mut [DVec3]) {
        let at = |k: usize| values.get(k).copied().unwrap_or_default();
        for (k, (out, own)) in out.iter_mut().zip(&self.neighbours).enumerate() {
            *out = at(k) * self.degrees[k] - own.iter().map(|w| at(*w as usize)).sum::<DVec3>();
        }
    }
}
