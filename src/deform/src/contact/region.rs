//! The free part of a surface around triangles that cross, with the neighbours of each of its vertices.

use glam::DVec3;
use pliant_mesh::{Lists, Mesh, NONE, sorted_set};

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
    /// Faces with a corner that is free in the region, ascending.
    pub faces: Vec<u32>,
    /// By face: whether it is one of them.
    pub is_near: Vec<bool>,
    /// Whether a free vertex lies on a border of the surface.
    pub has_border: bool,
    /// The median edge, model units.
    pub edge: f64,
}

impl ContactRegion {
    /// The region of so many `rings` of faces around pairs of faces. `held` says which vertices stay, `faces_of` which faces each has.
    pub fn around(mesh: &Mesh, faces_of: &Lists, held: &[bool], crossings: &[[u32; 2]], rings: usize) -> Self {
        let vertices = mesh.positions.len();
        let corners_of = |faces: &[u32]| sorted_set(faces.iter().flat_map(|t| mesh.triangles[*t as usize]));
        let faces_around = |some: &[u32]| sorted_set(some.iter().flat_map(|v| faces_of.of(*v).iter().copied()));
        let mut is_inside = vec![false; vertices];
        let mut front = corners_of(crossings.as_flattened());
        let mut inside = Vec::new();
        for ring in 0..=rings {
            front.iter().for_each(|v| is_inside[*v as usize] = true);
            inside.extend_from_slice(&front);
            // What is held is a border: the region does not go on behind it.
            front.retain(|v| ring == 0 || !held[*v as usize]);
            front = corners_of(&faces_around(&front));
            front.retain(|v| !is_inside[*v as usize]);
        }
        inside.sort_unstable();
        inside.retain(|v| !held[*v as usize]);
        let (free, mut nodes) = (inside.len(), inside);
        let mut local = vec![NONE; vertices];
        (0u32..).zip(&nodes).for_each(|(k, v)| local[*v as usize] = k);
        let faces = faces_around(&nodes);
        let mut is_near = vec![false; mesh.triangles.len()];
        faces.iter().for_each(|t| is_near[*t as usize] = true);
        let mut rim = corners_of(&faces);
        rim.retain(|v| local[*v as usize] == NONE);
        (free as u32..).zip(&rim).for_each(|(k, v)| local[*v as usize] = k);
        nodes.extend(rim);

        let mut around: Vec<Vec<u32>> = vec![Vec::new(); nodes.len()];
        for t in faces_around(&nodes) {
            let t = mesh.triangles[t as usize];
            for (k, v) in t.iter().enumerate() {
                if let Some(own) = around.get_mut(local[*v as usize] as usize) {
                    own.extend([t[(k + 1) % 3], t[(k + 2) % 3]]);
                }
            }
        }
        let around: Vec<Vec<u32>> = around.into_iter().map(sorted_set).collect();
        // Around a vertex inside of a surface there are as many faces as neighbours, and more where three meet at an edge.
        let mut inner = nodes[..free].iter().zip(&around);
        let has_border = inner.any(|(v, own)| faces_of.of(*v).len() < own.len());
        let degrees = around.iter().map(|own| own.len() as f64).collect();
        let inside = |own: Vec<u32>| {
            own.into_iter()
                .map(|v| local[v as usize])
                .filter(|k| *k != NONE)
                .collect()
        };
        let neighbours = around.into_iter().map(inside).collect();
        let length = |t: &u32| {
            let [a, b, _] = mesh.triangles[*t as usize].map(|v| mesh.positions[v as usize]);
            a.distance(b)
        };
        let mut lengths: Vec<f64> = faces.iter().map(length).collect();
        lengths.sort_unstable_by(f64::total_cmp);
        Self {
            has_border,
            edge: lengths.get(lengths.len() / 2).copied().unwrap_or(0.0),
            nodes,
            free,
            local,
            neighbours,
            degrees,
            faces,
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
