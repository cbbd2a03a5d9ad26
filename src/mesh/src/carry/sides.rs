//! Parts of a surface that touch and are not joined, as the halves of a cut are: what is beside one does not follow the other.

use glam::DVec3;
use std::collections::BTreeSet;
use std::ops::Range;

/// The part of a node below which triangles of several parts lie.
const SEVERAL: u32 = u32::MAX;

/// Which connected part of a surface triangles and nodes of its tree are of, and which parts touch: those with vertices of their own in
/// one place.
#[derive(Debug, Clone)]
pub(super) struct SurfaceSides {
    of_triangle: Vec<u32>,
    of_node: Vec<u32>,
    /// Pairs, each in both orders.
    touching: BTreeSet<(u32, u32)>,
}

/// What a point beside one part sees of the others.
#[derive(Clone, Copy)]
pub(super) struct OwnSide<'a> {
    sides: &'a SurfaceSides,
    own: u32,
}

impl SurfaceSides {
    /// Those of a surface, without the nodes of its tree; `None` where no parts touch.
    pub fn of(rest: &[DVec3], triangles: &[[u32; 3]]) -> Option<Self> {
        let part_of = parts_of_vertices(rest.len(), triangles);
        let place = |v: &u32| (rest[*v as usize] + DVec3::ZERO).to_array().map(f64::to_bits);
        let mut used: Vec<u32> = triangles.as_flattened().to_vec();
        used.sort_unstable();
        used.dedup();
        used.sort_by_cached_key(place);
        let mut touching = BTreeSet::new();
        for there in used.chunk_by(|a, b| place(a) == place(b)) {
            let parts: BTreeSet<u32> = there.iter().map(|v| part_of[*v as usize]).collect();
            // In a place of many parts each touches the next, which bounds the pairs.
            for (a, b) in parts.iter().zip(parts.iter().skip(1)) {
                touching.extend([(*a, *b), (*b, *a)]);
            }
        }
        (!touching.is_empty()).then(|| Self {
            of_triangle: triangles.iter().map(|t| part_of[t[0] as usize]).collect(),
            of_node: Vec::new(),
            touching,
        })
    }

    /// Adds the next node of the tree: a leaf with these triangles.
    pub fn push_leaf(&mut self, triangles: &[u32]) {
        let parts = triangles.iter().map(|&t| self.of_triangle[t as usize]);
        self.of_node.push(common_part(parts));
    }

    /// Adds the next node of the tree, with these nodes below it.
    pub fn push_node(&mut self, children: Range<usize>) {
        self.of_node.push(common_part(self.of_node[children].iter().copied()));
    }

    /// What is seen from beside a triangle; `None` where its part touches no other.
    pub fn beside(&self, triangle: u32) -> Option<OwnSide<'_>> {
        let own = self.of_triangle[triangle as usize];
        let touches = self.touching.range((own, 0)..=(own, u32::MAX)).next().is_some();
        touches.then_some(OwnSide { sides: self, own })
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        4 * (self.of_triangle.len() + self.of_node.len()) + 16 * self.touching.len()
    }
}

impl OwnSide<'_> {
    fn is_beyond(self, part: u32) -> bool {
        part != SEVERAL && self.sides.touching.contains(&(self.own, part))
    }

    /// Whether all below a node is of a part that touches the own one.
    pub fn hides_node(self, node: u32) -> bool {
        self.is_beyond(self.sides.of_node[node as usize])
    }

    /// Whether a node has triangles of several parts, so that it cannot stand for them.
    pub fn divides(self, node: u32) -> bool {
        self.sides.of_node[node as usize] == SEVERAL
    }

    /// Whether a triangle is of a part that touches the own one.
    pub fn hides(self, triangle: u32) -> bool {
        self.is_beyond(self.sides.of_triangle[triangle as usize])
    }
}

/// The part that all are of.
fn common_part(mut parts: impl Iterator<Item = u32>) -> u32 {
    let first = parts.next().unwrap_or(SEVERAL);
    if parts.all(|part| part == first) {
        first
    } else {
        SEVERAL
    }
}

/// The connected part of each vertex, named by its lowest vertex.
fn parts_of_vertices(count: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut above: Vec<u32> = (0..count as u32).collect();
    let root = |above: &mut Vec<u32>, mut v: u32| {
        while above[v as usize] != v {
            let next = above[above[v as usize] as usize];
            above[v as usize] = next;
            v = next;
        }
        v
    };
    for &[a, b, c] in triangles {
        for other in [b, c] {
            let (x, y) = (root(&mut above, a), root(&mut above, other));
            above[x.max(y) as usize] = x.min(y);
        }
    }
    (0..above.len() as u32).map(|v| root(&mut above, v)).collect()
}
