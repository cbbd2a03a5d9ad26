//! A few triangles of a surface with their own numbers, and what is next to what among them.

use super::Surface;
use crate::mesh::{Lists, NONE};
use glam::DVec3;

/// Chosen triangles over points that are numbered anew, from 0, in the order of their numbers in the surface.
///
/// Triangles without three different points are never part of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Local {
    /// The triangles, by number in the surface, rising.
    pub faces: Vec<u32>,
    /// The local points at the corners of each.
    pub corners: Vec<[u32; 3]>,
    /// The render vertices at the corners of each.
    pub vertices: Vec<[u32; 3]>,
    /// The number of each local point in the surface, rising.
    pub points: Vec<u32>,
    /// Where each local point is.
    pub positions: Vec<DVec3>,
    /// Whether all triangles around the point are part of this. Filled in by [`Local::around`]; false after
    /// [`Local::of`].
    pub whole: Vec<bool>,
    /// The local faces around each local point, rising.
    pub around: Lists,
}

/// One side of an edge: the edge's local points, the smaller first, and the corner of the face where the side starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Side {
    /// The ends of the edge, the smaller first.
    pub edge: [u32; 2],
    /// The local face.
    pub face: u32,
    /// The side runs from this corner of the face to the next.
    pub corner: u32,
}

impl Local {
    /// Takes the triangles `faces`; numbers need not rise and may repeat. Numbers beyond the surface are left out.
    pub fn of(surface: &Surface<'_>, mut faces: Vec<u32>) -> Self {
        faces.sort_unstable();
        faces.dedup();
        faces.retain(|&f| (surface.triangles.get(f as usize)).is_some_and(|t| points_of(surface, t).is_some()));
        let vertices: Vec<[u32; 3]> = faces.iter().map(|&f| surface.triangles[f as usize]).collect();
        let mut points: Vec<u32> = vertices
            .iter()
            .flatten()
            .map(|&v| surface.point_of[v as usize])
            .collect();
        points.sort_unstable();
        points.dedup();
        let local = |v: u32| points.partition_point(|&p| p < surface.point_of[v as usize]) as u32;
        let corners: Vec<[u32; 3]> = vertices.iter().map(|t| t.map(local)).collect();
        let mut positions = vec![DVec3::ZERO; points.len()];
        for (corner, vertex) in corners.iter().flatten().zip(vertices.iter().flatten()) {
            positions[*corner as usize] = surface.positions[*vertex as usize];
        }
        let around = Lists::gather(points.len(), || {
            corners.iter().zip(0u32..).flat_map(|(t, f)| t.map(|p| (p, f)))
        });
        Self {
            faces,
            corners,
            vertices,
            whole: vec![false; points.len()],
            points,
            positions,
            around,
        }
    }

    /// Takes the triangles `faces` and, `rings` times, all that touch a point of those taken before. Each ring is one
    /// pass over the surface. With at least one ring, the points of all but the last ring are [whole](Self::whole).
    pub fn around(surface: &Surface<'_>, faces: &[u32], rings: usize) -> Self {
        let mut taken: Vec<u32> = faces.to_vec();
        let mut marked = vec![false; surface.points as usize];
        for _ in 0..rings {
            for &f in &taken {
                let Some(triangle) = surface.triangles.get(f as usize) else {
                    continue;
                };
                for &v in triangle {
                    if let Some(mark) = marked.get_mut(surface.point_of[v as usize] as usize) {
                        *mark = true;
                    }
                }
            }
            taken = touching(surface, &marked);
        }
        let mut local = Self::of(surface, taken);
        local.whole = local.points.iter().map(|&p| marked[p as usize]).collect();
        local
    }

    /// All sides of all faces, sorted, so that those of one edge stand together.
    pub fn sides(&self) -> Vec<Side> {
        let mut sides: Vec<Side> = Vec::with_capacity(3 * self.corners.len());
        for (t, face) in self.corners.iter().zip(0u32..) {
            for corner in 0..3u32 {
                let (a, b) = (t[corner as usize], t[(corner as usize + 1) % 3]);
                sides.push(Side {
                    edge: [a.min(b), a.max(b)],
                    face,
                    corner,
                });
            }
        }
        sides.sort_unstable();
        sides
    }

    /// Sides that no other side lies along: the rim of these faces. Where the ends are [whole](Self::whole) it is the
    /// surface's own rim.
    pub fn rim(&self) -> Vec<Side> {
        let sides = self.sides();
        sides
            .chunk_by(|a, b| a.edge == b.edge)
            .filter(|s| s.len() == 1)
            .map(|s| s[0])
            .collect()
    }

    /// From which local point to which the side runs.
    pub fn ends(&self, side: Side) -> [u32; 2] {
        let t = self.corners[side.face as usize];
        [t[side.corner as usize], t[(side.corner as usize + 1) % 3]]
    }

    /// The local number of a point of the surface.
    pub fn find(&self, point: u32) -> Option<u32> {
        self.points.binary_search(&point).ok().map(|p| p as u32)
    }
}

/// The triangles with a marked point.
pub fn touching(surface: &Surface<'_>, marked: &[bool]) -> Vec<u32> {
    let is = |v: &u32| {
        (marked.get(surface.point_of[*v as usize] as usize))
            .copied()
            .unwrap_or(false)
    };
    let touched = surface.triangles.iter().zip(0u32..).filter(|(t, _)| t.iter().any(is));
    touched.map(|(_, f)| f).collect()
}

/// The points of a triangle when they are three different ones.
pub fn points_of(surface: &Surface<'_>, triangle: &[u32; 3]) -> Option<[u32; 3]> {
    let [a, b, c] = triangle.map(|v| surface.point_of[v as usize]);
    (a != b && b != c && c != a && ![a, b, c].contains(&NONE)).then_some([a, b, c])
}

/// Cuts trails out of directed edges: each passes a point at most once and is closed, but for those that come second,
/// which end somewhere else than they start. Deterministic in the order of `edges`.
pub fn trails(edges: &[[u32; 2]]) -> (Vec<Vec<u32>>, Vec<Vec<u32>>) {
    let mut order: Vec<u32> = (0..edges.len() as u32).collect();
    order.sort_by_key(|&e| edges[e as usize][0]);
    let start = |p: u32| order.partition_point(|&e| edges[e as usize][0] < p);
    let mut used = vec![false; edges.len()];
    let take = |p: u32, used: &mut Vec<bool>| {
        let from = start(p);
        let rest = order[from..].iter().take_while(|&&e| edges[e as usize][0] == p);
        let free = rest.copied().find(|&e| !used[e as usize])?;
        used[free as usize] = true;
        Some(edges[free as usize][1])
    };
    // Where more edges start than end, an open trail starts: those first, so that none begins in its middle.
    let mut surplus: Vec<(u32, i32)> = edges.iter().flat_map(|e| [(e[0], 1), (e[1], -1)]).collect();
    surplus.sort_unstable();
    let loose = surplus
        .chunk_by(|a, b| a.0 == b.0)
        .flat_map(|c| std::iter::repeat_n(c[0].0, c.iter().map(|s| s.1).sum::<i32>().max(0) as usize));
    let starts: Vec<u32> = loose.chain(edges.iter().map(|e| e[0])).collect();
    let (mut closed, mut open) = (Vec::new(), Vec::new());
    let mut place: std::collections::BTreeMap<u32, usize> = std::collections::BTreeMap::new();
    for first in starts {
        let mut trail = vec![first];
        place.insert(first, 0);
        while let Some(next) = trail.last().and_then(|&here| take(here, &mut used)) {
            if let Some(&met) = place.get(&next) {
                closed.push(trail[met..].to_vec());
                for gone in trail.drain(met + 1..) {
                    place.remove(&gone);
                }
            } else {
                place.insert(next, trail.len());
                trail.push(next);
            }
        }
        if trail.len() > 1 {
            open.push(trail);
        }
        place.clear();
    }
    (closed, open)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_grow_and_know_which_points_are_whole() {
        // A strip of six triangles over points 0..=7.
        let positions: Vec<DVec3> = (0..8)
            .map(|i| DVec3::new(f64::from(i / 2), f64::from(i % 2), 0.0))
            .collect();
        let triangles: Vec<[u32; 3]> = (0..3)
            .flat_map(|i| [[2 * i, 2 * i + 2, 2 * i + 1], [2 * i + 1, 2 * i + 2, 2 * i + 3]])
            .collect();
        let points: Vec<u32> = (0..8).collect();
        let surface = Surface {
            positions: &positions,
            triangles: &triangles,
            primitive_of: &[0; 6],
            point_of: &points,
            points: 8,
        };
        let alone = Local::of(&surface, vec![1, 99, 1]);
        assert_eq!(
            (alone.faces.as_slice(), alone.points.as_slice()),
            (&[1][..], &[1, 2, 3][..])
        );
        let ring = Local::around(&surface, &[0], 1);
        assert_eq!(ring.faces, [0, 1, 2]);
        assert_eq!(ring.whole, [true, true, true, false, false]);
        assert_eq!(Local::around(&surface, &[0], 2).faces, [0, 1, 2, 3, 4]);
        assert_eq!(ring.rim().len(), 5);
        assert_eq!(ring.positions[4], positions[4]);
    }

    #[test]
    fn trails_part_where_they_meet_themselves() {
        let (closed, open) = trails(&[[0, 1], [1, 2], [2, 0], [2, 3], [3, 4], [4, 2], [8, 9], [7, 8]]);
        assert_eq!(closed.len(), 2);
        assert!(closed.iter().all(|l| l.len() == 3), "{closed:?}");
        assert_eq!(open, [vec![7, 8, 9]]);
    }
}
