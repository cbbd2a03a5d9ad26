//! What is next to what: faces around a vertex, vertices around a vertex, edges with the faces on either side.

use crate::mesh::lists::Lists;

/// An edge and how many faces run along it in each direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshEdge {
    /// Its ends, the smaller index first.
    pub vertices: [u32; 2],
    /// Faces that pass it from the smaller to the larger end; counts stop at 65,535.
    pub forward: u16,
    /// Faces that pass it the other way; counts stop at 65,535.
    pub backward: u16,
}

impl MeshEdge {
    /// Number of faces along it: 1 on a boundary, 2 in the inside of a manifold surface.
    pub fn faces(&self) -> u32 {
        u32::from(self.forward) + u32::from(self.backward)
    }
}

/// Neighbourhoods of a triangle mesh.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adjacency {
    /// Faces around each vertex, in rising order.
    pub faces: Lists,
    /// Vertices that share an edge with each vertex, in rising order, each once.
    pub neighbours: Lists,
    /// All edges, each once, sorted by their ends.
    pub edges: Vec<MeshEdge>,
}

impl Adjacency {
    /// Finds all neighbourhoods in time linear in the number of triangles.
    ///
    /// ```
    /// use pliant_core::mesh::Adjacency;
    ///
    /// let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    /// let adjacency = Adjacency::build(4, &tetrahedron);
    /// assert_eq!(adjacency.neighbours.of(0), [1, 2, 3]);
    /// assert!(adjacency.edges.len() == 6 && adjacency.is_balanced());
    /// ```
    ///
    /// # Panics
    /// When a triangle names a vertex that is not below `vertices`, or there are more than 2³¹ of these. Triangles of a
    /// [`super::Mesh`] never do, and it never has.
    pub fn build(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let faces = Lists::gather(vertices, || {
            triangles.iter().zip(0u32..).flat_map(|(t, i)| t.map(|v| (v, i)))
        });
        let edges = edges(vertices, triangles);
        // Edges are sorted, so each row gets its smaller neighbours first, then its larger ones, both rising.
        let neighbours = Lists::gather(vertices, || {
            edges
                .iter()
                .flat_map(|e| [(e.vertices[0], e.vertices[1]), (e.vertices[1], e.vertices[0])])
        });
        Self {
            faces,
            neighbours,
            edges,
        }
    }

    /// Whether each edge is passed equally often both ways. Such a surface encloses space without holes: its winding
    /// number is a whole number everywhere off the surface.
    pub fn is_balanced(&self) -> bool {
        self.edges.iter().all(|e| e.forward == e.backward)
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.faces.byte_size() + self.neighbours.byte_size() + self.edges.capacity() * size_of::<MeshEdge>()
    }
}

/// All edges of `triangles`, sorted: half edges are gathered at their smaller end and each short row is sorted.
fn edges(vertices: usize, triangles: &[[u32; 3]]) -> Vec<MeshEdge> {
    assert!(
        vertices <= 1 << 31,
        "{vertices} vertices cannot be numbered with 31 bits"
    );
    // The larger end, and in the lowest bit whether the half edge begins there.
    let half_edges = |&[a, b, c]: &[u32; 3]| {
        let packed = |from: u32, to: u32| (from.min(to), from.max(to) << 1 | u32::from(from > to));
        let all = [(a, b), (b, c), (c, a)].into_iter();
        all.filter(|(from, to)| from != to)
            .map(move |(from, to)| packed(from, to))
    };
    let rows = Lists::gather(vertices, || triangles.iter().flat_map(half_edges));
    let mut edges: Vec<MeshEdge> = Vec::with_capacity(rows.items().len() / 2 + 1);
    let mut row: Vec<u32> = Vec::new();
    for v in 0..vertices as u32 {
        row.clear();
        row.extend_from_slice(rows.of(v));
        row.sort_unstable();
        for same in row.chunk_by(|a, b| a >> 1 == b >> 1) {
            let backward = same.iter().filter(|&&s| s & 1 == 1).count();
            let count = |n: usize| u16::try_from(n).unwrap_or(u16::MAX);
            edges.push(MeshEdge {
                vertices: [v, same[0] >> 1],
                forward: count(same.len() - backward),
                backward: count(backward),
            });
        }
    }
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_of_faces_knows_its_edges_and_rows() {
        let a = Adjacency::build(5, &[[0, 1, 2], [2, 1, 3]]);
        let seen: Vec<_> = a.edges.iter().map(|e| (e.vertices, e.forward, e.backward)).collect();
        assert_eq!(
            seen,
            [
                ([0, 1], 1, 0),
                ([0, 2], 0, 1),
                ([1, 2], 1, 1),
                ([1, 3], 1, 0),
                ([2, 3], 0, 1)
            ]
        );
        assert_eq!(a.neighbours.of(1), [0, 2, 3]);
        assert_eq!(a.faces.of(2), [0, 1]);
        assert!(a.neighbours.of(4).is_empty() && a.faces.of(4).is_empty());
        assert!(!a.is_balanced());
    }

    #[test]
    fn closed_surfaces_are_balanced_and_flipped_faces_are_not() {
        let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        assert!(Adjacency::build(4, &tetrahedron).is_balanced());
        let mut flipped = tetrahedron;
        flipped[0].swap(0, 1);
        let a = Adjacency::build(4, &flipped);
        assert!(!a.is_balanced());
        assert!(a.edges.iter().all(|e| e.faces() == 2), "flipping a face opens no edge");
    }
}
