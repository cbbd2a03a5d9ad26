//! What is next to what: faces around a vertex, vertices around a vertex, edges with the faces on either side.
//!
//! The rims of holes: loops of edges that have one face only.
//!
//! Connected parts.
//!
//! Lists of numbers, one list per row, stored back to back (compressed rows).

use glam::DVec3;

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
    /// use pliant_mesh::Adjacency;
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

/// One rim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundaryLoop {
    /// Number of its edges.
    pub edges: usize,
    /// Sum of their lengths.
    pub length: f64,
    /// A solver vertex on it: the smallest.
    pub vertex: u32,
    /// Whether it comes back to its start. A rim that ends at a non-manifold edge does not.
    pub closed: bool,
}

/// All rims in the order of the first edge found on each. Where rims touch at a vertex they are separate, so that
/// each loop passes a vertex at most once.
///
/// # Panics
/// When `adjacency` belongs to a mesh with more vertices than there are positions.
pub fn boundary_loops(positions: &[DVec3], adjacency: &Adjacency) -> Vec<BoundaryLoop> {
    let rim: Vec<MeshEdge> = adjacency.edges.iter().filter(|e| e.faces() == 1).copied().collect();
    if rim.is_empty() {
        return Vec::new();
    }
    let at = Lists::gather(positions.len(), || {
        rim.iter().zip(0u32..).flat_map(|(e, i)| e.vertices.map(|v| (v, i)))
    });
    let mut walk = BoundaryWalk {
        positions,
        rim: &rim,
        at: &at,
        next: vec![0; positions.len()],
        used: vec![false; rim.len()],
        place: vec![NOWHERE; positions.len()],
        loops: Vec::new(),
    };
    // Open rims first, from their loose ends, so that none is cut in two by starting in its middle.
    for v in 0..positions.len() as u32 {
        if at.of(v).len() % 2 == 1 {
            walk.run(v);
        }
    }
    for e in &rim {
        walk.run(e.vertices[0]);
    }
    walk.loops
}

const NOWHERE: u32 = u32::MAX;

struct BoundaryWalk<'a> {
    positions: &'a [DVec3],
    rim: &'a [MeshEdge],
    at: &'a Lists,
    /// Per vertex, how many of its rim edges have been looked at.
    next: Vec<u32>,
    used: Vec<bool>,
    /// Per vertex, where it stands in the current trail.
    place: Vec<u32>,
    loops: Vec<BoundaryLoop>,
}

impl BoundaryWalk<'_> {
    /// The first unused rim edge at `v`.
    fn take(&mut self, v: u32) -> Option<MeshEdge> {
        let edges = self.at.of(v);
        while let Some(&e) = edges.get(self.next[v as usize] as usize) {
            self.next[v as usize] += 1;
            if !std::mem::replace(&mut self.used[e as usize], true) {
                return Some(self.rim[e as usize]);
            }
        }
        None
    }

    /// Walks unused edges from `start` until stuck. Whenever the trail meets itself, the part since then is a loop and
    /// is cut off; what is left at the end is an open rim.
    fn run(&mut self, start: u32) {
        let mut trail = vec![start];
        self.place[start as usize] = 0;
        let mut here = start;
        while let Some(edge) = self.take(here) {
            here = if edge.vertices[0] == here {
                edge.vertices[1]
            } else {
                edge.vertices[0]
            };
            let met = self.place[here as usize];
            trail.push(here);
            if met == NOWHERE {
                self.place[here as usize] = trail.len() as u32 - 1;
                continue;
            }
            self.record(&trail[met as usize..], true);
            for v in trail.drain(met as usize + 1..) {
                if v != here {
                    self.place[v as usize] = NOWHERE;
                }
            }
        }
        if trail.len() > 1 {
            self.record(&trail, false);
        }
        for v in trail {
            self.place[v as usize] = NOWHERE;
        }
    }

    fn record(&mut self, trail: &[u32], closed: bool) {
        let length = |w: &[u32]| self.positions[w[0] as usize].distance(self.positions[w[1] as usize]);
        self.loops.push(BoundaryLoop {
            edges: trail.len() - 1,
            length: trail.windows(2).map(length).sum(),
            vertex: trail.iter().copied().min().unwrap_or(0),
            closed,
        });
    }
}

/// The connected components of something with vertices, numbered in the order of their smallest vertex.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Components {
    /// The component of each vertex.
    pub of_vertex: Vec<u32>,
    /// How many there are.
    pub count: usize,
}

impl Components {
    /// Parts of a triangle mesh that hang together by shared vertices; a vertex without faces is a part of its own.
    ///
    /// # Panics
    /// When a triangle names a vertex that is not below `vertices`.
    pub fn of_triangles(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let mut sets = DisjointSets::new(vertices);
        for &[a, b, c] in triangles {
            sets.join(a, b);
            sets.join(b, c);
        }
        sets.components()
    }

    /// Components of a graph given by its `edges`.
    ///
    /// # Panics
    /// When an edge names a vertex that is not below `vertices`.
    pub fn of_edges(vertices: usize, edges: impl Iterator<Item = (u32, u32)>) -> Self {
        let mut sets = DisjointSets::new(vertices);
        edges.for_each(|(a, b)| sets.join(a, b));
        sets.components()
    }

    /// The smallest vertex of each component.
    pub fn first_vertices(&self) -> Vec<u32> {
        let mut first = Vec::with_capacity(self.count);
        for (v, &c) in self.of_vertex.iter().enumerate() {
            // Numbered by smallest vertex, so each new number is one more than the last.
            if c as usize == first.len() {
                first.push(v as u32);
            }
        }
        first
    }
}

/// Disjoint sets whose root is always the smallest member.
struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    fn new(count: usize) -> Self {
        Self {
            parent: (0..count as u32).collect(),
        }
    }

    fn root(&mut self, mut v: u32) -> u32 {
        while self.parent[v as usize] != v {
            let above = self.parent[self.parent[v as usize] as usize];
            self.parent[v as usize] = above;
            v = above;
        }
        v
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    fn components(mut self) -> Components {
        let mut of_vertex = vec![0u32; self.parent.len()];
        let mut count = 0;
        for v in 0..self.parent.len() as u32 {
            let root = self.root(v);
            of_vertex[v as usize] = if root == v {
                count += 1;
                count - 1
            } else {
                of_vertex[root as usize]
            };
        }
        Components {
            of_vertex,
            count: count as usize,
        }
    }
}

/// One list of `u32` per row; rows are counted from 0.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Lists {
    offsets: Vec<u32>,
    items: Vec<u32>,
}

impl Lists {
    /// Gathers `(row, item)` pairs: each row gets its items in the order in which `pairs` yields them. `pairs` is
    /// called twice and must yield the same both times.
    ///
    /// # Panics
    /// When a row is not below `rows`, or there are more than `u32::MAX` pairs.
    pub fn gather<I: Iterator<Item = (u32, u32)>>(rows: usize, pairs: impl Fn() -> I) -> Self {
        let mut offsets = vec![0u32; rows + 1];
        let mut total = 0u64;
        for (row, _) in pairs() {
            offsets[row as usize + 1] += 1;
            total += 1;
        }
        assert!(
            total <= u64::from(u32::MAX),
            "{total} list entries cannot be numbered with 32 bits"
        );
        for row in 0..rows {
            offsets[row + 1] += offsets[row];
        }
        let mut next = offsets.clone();
        let mut items = vec![0u32; total as usize];
        for (row, item) in pairs() {
            let slot = &mut next[row as usize];
            items[*slot as usize] = item;
            *slot += 1;
        }
        Self { offsets, items }
    }

    /// Takes rows that are already laid out: row `i` is `items[offsets[i]..offsets[i + 1]]`.
    ///
    /// # Panics
    /// When `offsets` is empty, does not start at 0, falls, or does not end at the number of items.
    pub fn from_parts(offsets: Vec<u32>, items: Vec<u32>) -> Self {
        assert!(
            offsets.first() == Some(&0) && offsets.windows(2).all(|w| w[0] <= w[1]),
            "offsets rise from 0"
        );
        assert_eq!(
            offsets.last().map(|&o| o as usize),
            Some(items.len()),
            "offsets end at the items"
        );
        Self { offsets, items }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// The list of `row`.
    ///
    /// # Panics
    /// When `row` is out of range.
    pub fn of(&self, row: u32) -> &[u32] {
        &self.items[self.offsets[row as usize] as usize..self.offsets[row as usize + 1] as usize]
    }

    /// Where each row starts, and one past the end of the last.
    pub fn offsets(&self) -> &[u32] {
        &self.offsets
    }

    /// All items, row after row.
    pub fn items(&self) -> &[u32] {
        &self.items
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        (self.offsets.capacity() + self.items.capacity()) * size_of::<u32>()
    }
}

/// Sorts items and leaves out repeats.
pub fn sorted_set<T: Ord>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut all: Vec<T> = items.into_iter().collect();
    all.sort_unstable();
    all.dedup();
    all
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

#[cfg(test)]
mod boundary_tests {
    use super::*;

    fn loops(positions: &[DVec3], faces: &[[u32; 3]]) -> Vec<BoundaryLoop> {
        boundary_loops(positions, &Adjacency::build(positions.len(), faces))
    }

    #[test]
    fn touching_rims_are_kept_apart() {
        // Two triangles that share vertex 2 only: a bow tie.
        let p: Vec<DVec3> = [[0., 0.], [0., 1.], [1., 0.], [2., 0.], [2., 1.]]
            .iter()
            .map(|p| DVec3::new(p[0], p[1], 0.0))
            .collect();
        let found = loops(&p, &[[0, 2, 1], [2, 3, 4]]);
        let seen: Vec<_> = found.iter().map(|l| (l.edges, l.vertex, l.closed)).collect();
        assert!(
            seen.contains(&(3, 0, true)) && seen.contains(&(3, 2, true)) && seen.len() == 2,
            "{seen:?}"
        );
        assert!((found.iter().map(|l| l.length).sum::<f64>() - (2.0 + 2.0 * 2f64.sqrt() + 2.0)).abs() < 1e-12);
    }

    #[test]
    fn a_fin_leaves_an_open_rim() {
        // Three faces share the edge 0-1; each outer pair of edges runs from 0 to 1.
        let p: Vec<DVec3> = [DVec3::ZERO, DVec3::Z, DVec3::X, DVec3::Y, DVec3::NEG_X].to_vec();
        let found = loops(&p, &[[0, 1, 2], [0, 1, 3], [1, 0, 4]]);
        assert_eq!(found.iter().map(|l| l.edges).sum::<usize>(), 6);
        assert_eq!(found.iter().filter(|l| !l.closed).count(), 1, "{found:?}");
    }

    #[test]
    fn a_closed_surface_has_none() {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        assert!(loops(&p, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).is_empty());
    }
}

#[cfg(test)]
mod components_tests {
    use super::*;

    #[test]
    fn parts_are_numbered_by_their_smallest_vertex() {
        let c = Components::of_triangles(8, &[[5, 6, 7], [1, 3, 0], [3, 4, 1]]);
        assert_eq!(c.of_vertex, [0, 0, 1, 0, 0, 2, 2, 2]);
        assert_eq!((c.count, c.first_vertices()), (3, vec![0, 2, 5]));
    }

    #[test]
    fn a_long_chain_in_any_order_is_one_part() {
        let n = 10_000u32;
        let backwards = Components::of_edges(n as usize, (1..n).rev().map(|v| (v, v - 1)));
        assert_eq!(backwards.count, 1);
        let odd_even = Components::of_edges(n as usize, (2..n).map(|v| (v - 2, v)));
        assert_eq!(odd_even.count, 2);
    }
}

#[cfg(test)]
mod lists_tests {
    use super::*;

    #[test]
    fn rows_keep_the_order_of_the_pairs() {
        let pairs = [(2, 7), (0, 1), (2, 5), (2, 9)];
        let lists = Lists::gather(4, || pairs.into_iter());
        let rows: Vec<&[u32]> = (0..4).map(|r| lists.of(r)).collect();
        assert_eq!(rows, [&[1][..], &[], &[7, 5, 9], &[]]);
        assert_eq!(
            Lists::from_parts(lists.offsets().to_vec(), lists.items().to_vec()),
            lists
        );
    }
}
