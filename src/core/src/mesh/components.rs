//! Connected parts.

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

#[cfg(test)]
mod tests {
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
