//! From a surface and a patch to the next surface, with the maps between both.
//!
//! Flat passes over the arrays: what the patch does not name is copied in runs. Vertices stay grouped by primitive; in
//! each group the old ones that are left come first, in their old order, then the new ones. Triangles likewise. Points:
//! the old ones that are left, in their old order, then the new ones.

use super::{Error, NewVertex, Patch, Surface};
use crate::mesh::NONE;
use glam::DVec3;

/// A surface after an edit, and where each part of it comes from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Applied {
    /// Render vertices.
    pub positions: Vec<DVec3>,
    /// Triangles over render vertices.
    pub triangles: Vec<[u32; 3]>,
    /// The primitive of each triangle, never falling.
    pub primitive_of: Vec<u32>,
    /// The point of each render vertex, or [`NONE`].
    pub point_of: Vec<u32>,
    /// How many points there are.
    pub points: u32,
    /// The first render vertex of each primitive; a primitive that lost all its vertices has an empty run.
    pub first_vertex: Vec<u32>,
    /// For each old render vertex its number now, or [`NONE`] when it is gone.
    pub vertex_from_old: Vec<u32>,
    /// For each old point its number now (that of the point that it joined), or [`NONE`] when it is gone.
    pub point_from_old: Vec<u32>,
    /// For each render vertex what it was: an old number, or the number of old vertices plus an index into
    /// [`Patch::vertices`].
    pub old_from_vertex: Vec<u32>,
    /// For each point the old number, or [`NONE`] when it is new.
    pub old_from_point: Vec<u32>,
    /// For each triangle the old number, or [`NONE`] when it is new.
    pub old_from_triangle: Vec<u32>,
}

impl Applied {
    /// The surface to edit next.
    pub fn surface(&self) -> Surface<'_> {
        Surface {
            positions: &self.positions,
            triangles: &self.triangles,
            primitive_of: &self.primitive_of,
            point_of: &self.point_of,
            points: self.points,
        }
    }
}

/// Applies `patch` to `surface`, whose render vertices stand in one run per primitive: run `p` starts at
/// `first_vertex[p]`.
///
/// Vertices that no triangle used before stay. Linear in the surface, single-threaded.
///
/// # Errors
/// [`Error::Invalid`] when surface or patch break what their fields promise, [`Error::Impossible`] when no triangle
/// would be left, [`Error::TooLarge`] beyond what 32-bit numbers count.
pub fn apply(surface: &Surface<'_>, patch: &Patch, first_vertex: &[u32]) -> Result<Applied, Error> {
    check_surface(surface, first_vertex)?;
    let resolved = Resolved::of(surface, patch, first_vertex)?;
    let old_vertices = surface.positions.len();
    let mut applied = Applied::default();

    // Triangles, still with old corners; new ones after the old ones of their primitive.
    let kept = surface.triangles.len() - patch.removed.len();
    let total = kept + patch.triangles.len();
    if total == 0 {
        return Err(Error::Impossible {
            problem: "the edit would leave no triangle; keep a part of the surface".to_owned(),
            place: format!("all {} faces", surface.triangles.len()),
        });
    }
    applied.triangles.reserve_exact(total);
    applied.primitive_of.reserve_exact(total);
    applied.old_from_triangle.reserve_exact(total);
    let mut fresh: Vec<u32> = (0..patch.triangles.len() as u32).collect();
    fresh.sort_by_key(|&t| patch.triangles[t as usize].primitive);
    let mut fresh = fresh.into_iter().peekable();
    let mut removed = patch.removed.iter().map(|&t| t as usize).peekable();
    let mut done = 0;
    for primitive in 0..first_vertex.len() as u32 {
        let end = done + surface.primitive_of[done..].partition_point(|&p| p <= primitive);
        while done < end {
            let stop = removed.peek().map_or(end, |&r| r.min(end));
            applied.triangles.extend_from_slice(&surface.triangles[done..stop]);
            applied.old_from_triangle.extend(done as u32..stop as u32);
            done = stop;
            if removed.next_if_eq(&done).is_some() {
                done += 1;
            }
        }
        while let Some(t) = fresh.next_if(|&t| patch.triangles[t as usize].primitive == primitive) {
            applied.triangles.push(patch.triangles[t as usize].corners);
            applied.old_from_triangle.push(NONE);
        }
        applied.primitive_of.resize(applied.triangles.len(), primitive);
    }

    // A vertex that had a point goes when no triangle of the result names it.
    let mut used = vec![false; old_vertices + patch.vertices.len()];
    for corner in applied.triangles.iter().flatten() {
        used[*corner as usize] = true;
    }
    if let Some(idle) = used[old_vertices..].iter().position(|u| !u) {
        return Err(invalid("patch.vertices", format!("new vertex {idle} is in no triangle")));
    }
    let mut number = vec![NONE; used.len()];
    let mut order: Vec<u32> = (0..patch.vertices.len() as u32).collect();
    order.sort_by_key(|&v| patch.vertices[v as usize].primitive);
    let mut order = order.into_iter().peekable();
    let capacity = used.len();
    applied.positions.reserve_exact(capacity);
    applied.old_from_vertex.reserve_exact(capacity);
    for primitive in 0..first_vertex.len() {
        applied.first_vertex.push(applied.positions.len() as u32);
        let end = first_vertex.get(primitive + 1).map_or(old_vertices, |&v| v as usize);
        for v in first_vertex[primitive] as usize..end {
            if used[v] || surface.point_of[v] == NONE {
                number[v] = applied.positions.len() as u32;
                applied.positions.push(surface.positions[v]);
                applied.old_from_vertex.push(v as u32);
            }
        }
        while let Some(v) = order.next_if(|&v| patch.vertices[v as usize].primitive as usize == primitive) {
            number[old_vertices + v as usize] = applied.positions.len() as u32;
            applied.positions.push(patch.vertices[v as usize].position);
            applied.old_from_vertex.push(old_vertices as u32 + v);
        }
    }
    for triangle in &mut applied.triangles {
        *triangle = triangle.map(|v| number[v as usize]);
    }
    number.truncate(old_vertices);
    applied.vertex_from_old = number;
    resolved.number_points(surface, patch, &mut applied);
    Ok(applied)
}

/// What a patch says about points, checked and ready to look up.
struct Resolved {
    /// Old points that change place or number, with the vertex run that shows it: empty when the patch has none.
    joined: Vec<u32>,
    /// Position of each old point, where the patch moves or joins any.
    moved: Vec<Option<DVec3>>,
}

impl Resolved {
    fn of(surface: &Surface<'_>, patch: &Patch, first_vertex: &[u32]) -> Result<Self, Error> {
        let rising = |what: &str, seen: &mut dyn Iterator<Item = u32>, limit: usize| -> Result<(), Error> {
            let mut last = None;
            for s in seen {
                if s as usize >= limit || last.is_some_and(|l| l >= s) {
                    let problem = format!("{s} after {last:?}; numbers must rise and stay below {limit}");
                    return Err(invalid(what, problem));
                }
                last = Some(s);
            }
            Ok(())
        };
        let points = surface.points as usize;
        rising("patch.removed", &mut patch.removed.iter().copied(), surface.triangles.len())?;
        rising("patch.moved", &mut patch.moved.iter().map(|m| m.0), points)?;
        rising("patch.joined", &mut patch.joined.iter().map(|j| j.0), points)?;
        let counts = [
            ("vertices", surface.positions.len() + patch.vertices.len()),
            ("triangles", surface.triangles.len() + patch.triangles.len()),
        ];
        for (what, seen) in counts {
            if seen > (NONE / 6) as usize {
                return Err(Error::TooLarge { what, seen: seen as u64, limit: u64::from(NONE / 6) });
            }
        }
        let mut resolved = Self { joined: Vec::new(), moved: Vec::new() };
        if !patch.joined.is_empty() {
            resolved.joined = (0..surface.points).collect();
            for &(from, to) in &patch.joined {
                let chained = patch.joined.binary_search_by_key(&to, |j| j.0).is_ok();
                if to >= surface.points || chained {
                    let problem = format!("point {from} joins {to}, which joins another point or does not exist");
                    return Err(invalid("patch.joined", problem));
                }
                resolved.joined[from as usize] = to;
            }
        }
        if let Some(m) = patch.moved.iter().find(|m| !m.1.is_finite()) {
            return Err(invalid("patch.moved", format!("point {} moves to {}, not a place", m.0, m.1)));
        }
        let needs_places = !patch.moved.is_empty()
            || !patch.joined.is_empty()
            || patch.vertices.iter().any(|v| v.point < surface.points);
        if needs_places {
            resolved.moved = vec![None; points];
            for (&p, &x) in surface.point_of.iter().zip(surface.positions) {
                if p != NONE {
                    resolved.moved[p as usize] = Some(x);
                }
            }
            for &(p, x) in &patch.moved {
                resolved.moved[p as usize] = Some(x);
            }
        }
        resolved.check_vertices(surface, patch, first_vertex)?;
        resolved.check_triangles(surface, patch, first_vertex)?;
        Ok(resolved)
    }

    fn check_vertices(&self, surface: &Surface<'_>, patch: &Patch, first_vertex: &[u32]) -> Result<(), Error> {
        let mut next = surface.points;
        let mut places: Vec<DVec3> = Vec::new();
        for (index, v) in patch.vertices.iter().enumerate() {
            let refuse = |problem: String| Err(invalid("patch.vertices", format!("new vertex {index} {problem}")));
            if v.primitive as usize >= first_vertex.len() {
                return refuse(format!("is of primitive {}, there are {}", v.primitive, first_vertex.len()));
            }
            if !v.position.is_finite() {
                return refuse(format!("lies at {}, which is no place", v.position));
            }
            if v.point > next {
                return refuse(format!("names point {} where {next} is the next new one", v.point));
            }
            if v.point == next {
                next += 1;
                places.push(v.position);
            } else if v.point >= surface.points {
                if places[(v.point - surface.points) as usize] != v.position {
                    return refuse(format!("lies apart from the others of its point {}", v.point));
                }
            } else {
                let joins = self.joined.get(v.point as usize).is_some_and(|&to| to != v.point);
                if joins || self.moved[v.point as usize] != Some(v.position) {
                    return refuse(format!("lies apart from its old point {}, or that joins another", v.point));
                }
            }
            let mut sum = 0.0;
            for (&of, &weight) in v.of.iter().zip(&v.weights) {
                if weight == 0.0 {
                    continue;
                }
                let run = run_of(first_vertex, surface.positions.len(), v.primitive);
                if !(weight > 0.0 && weight <= 1.0 + 1e-9) || !run.contains(&of) {
                    return refuse(format!("is blended from vertex {of} by {weight}; allowed are {run:?}, 0 to 1"));
                }
                sum += weight;
            }
            if !((sum - 1.0).abs() <= 1e-6) {
                return refuse(format!("has weights that sum to {sum}, not 1"));
            }
        }
        Ok(())
    }

    fn check_triangles(&self, surface: &Surface<'_>, patch: &Patch, first_vertex: &[u32]) -> Result<(), Error> {
        let old = surface.positions.len();
        for (index, t) in patch.triangles.iter().enumerate() {
            let refuse = |problem: String| Err(invalid("patch.triangles", format!("new triangle {index} {problem}")));
            if t.primitive as usize >= first_vertex.len() {
                return refuse(format!("is of primitive {}, there are {}", t.primitive, first_vertex.len()));
            }
            let mut points = [NONE; 3];
            for (point, &corner) in points.iter_mut().zip(&t.corners) {
                let fresh = (corner as usize).checked_sub(old).map(|v| patch.vertices.get(v));
                let (primitive, of) = match fresh {
                    None => {
                        let run = run_of(first_vertex, old, t.primitive);
                        let primitive = if run.contains(&corner) { t.primitive } else { NONE };
                        (primitive, surface.point_of[corner as usize])
                    }
                    Some(Some(NewVertex { primitive, point, .. })) => (*primitive, *point),
                    Some(None) => return refuse(format!("names vertex {corner}, which does not exist")),
                };
                if primitive != t.primitive || of == NONE {
                    return refuse(format!("of primitive {} names vertex {corner} of another, or unused", t.primitive));
                }
                *point = self.joined.get(of as usize).copied().unwrap_or(of);
            }
            let [a, b, c] = points;
            if a == b || b == c || c == a {
                return refuse(format!("has the points {points:?}, two are one"));
            }
        }
        Ok(())
    }

    /// Numbers the points that are left and writes what depends on that.
    fn number_points(&self, surface: &Surface<'_>, patch: &Patch, applied: &mut Applied) {
        let old_vertices = surface.positions.len();
        let root = |p: u32| self.joined.get(p as usize).copied().unwrap_or(p);
        let fresh = patch.vertices.iter().map(|v| v.point).filter(|&p| p != NONE && p >= surface.points).max();
        let all = fresh.map_or(surface.points, |p| p + 1);
        let mut number = vec![NONE; all as usize];
        applied.point_of = (applied.old_from_vertex.iter())
            .map(|&v| match patch.vertices.get((v as usize).wrapping_sub(old_vertices)) {
                Some(fresh) => fresh.point,
                None => match surface.point_of[v as usize] {
                    NONE => NONE,
                    p => root(p),
                },
            })
            .collect();
        // Marks first, numbers after, so that numbers follow the old ones and not the order of the vertices.
        for &p in applied.point_of.iter().filter(|&&p| p != NONE) {
            number[p as usize] = 0;
        }
        for (p, n) in number.iter_mut().enumerate().filter(|(_, n)| **n == 0) {
            *n = applied.old_from_point.len() as u32;
            applied.old_from_point.push(if p < surface.points as usize { p as u32 } else { NONE });
        }
        applied.points = applied.old_from_point.len() as u32;
        let moves = !patch.moved.is_empty() || !patch.joined.is_empty();
        for (p, x) in applied.point_of.iter_mut().zip(&mut applied.positions) {
            if *p != NONE {
                if moves && let Some(Some(place)) = self.moved.get(*p as usize) {
                    *x = *place;
                }
                *p = number[*p as usize];
            }
        }
        number.truncate(surface.points as usize);
        for &(from, to) in &patch.joined {
            number[from as usize] = number[to as usize];
        }
        applied.point_from_old = number;
    }
}

fn invalid(field: &str, problem: String) -> Error {
    Error::Invalid { field: field.to_owned(), problem }
}

/// The render vertices of a primitive.
fn run_of(first_vertex: &[u32], vertices: usize, primitive: u32) -> std::ops::Range<u32> {
    let p = primitive as usize;
    first_vertex[p]..first_vertex.get(p + 1).map_or(vertices as u32, |&v| v)
}

/// Refuses a surface whose arrays do not fit together, so that nothing after this can index out of range.
fn check_surface(surface: &Surface<'_>, first_vertex: &[u32]) -> Result<(), Error> {
    let vertices = surface.positions.len();
    let refuse = |problem: String| Err(invalid("surface", problem));
    if surface.point_of.len() != vertices || surface.primitive_of.len() != surface.triangles.len() {
        return refuse("arrays differ in length".to_owned());
    }
    let runs = first_vertex.first().is_none_or(|&v| v == 0)
        && first_vertex.windows(2).all(|w| w[0] <= w[1])
        && first_vertex.last().map_or(vertices == 0, |&v| v as usize <= vertices);
    if !runs {
        return refuse("the vertex runs of the primitives do not rise from 0 to the number of vertices".to_owned());
    }
    let primitives = surface.primitive_of.windows(2).all(|w| w[0] <= w[1]);
    if !primitives || surface.primitive_of.last().is_some_and(|&p| p as usize >= first_vertex.len()) {
        return refuse("primitives of triangles fall, or have no vertex run".to_owned());
    }
    if let Some(t) = surface.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= vertices)) {
        return refuse(format!("triangle {t} names a vertex that does not exist"));
    }
    if let Some(v) = surface.point_of.iter().position(|&p| p != NONE && p >= surface.points) {
        return refuse(format!("vertex {v} has a point that does not exist"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::{NewTriangle, check};
    use super::*;

    const POSITIONS: [DVec3; 7] = [
        DVec3::new(0.0, 0.0, 0.0),
        DVec3::new(1.0, 0.0, 0.0),
        DVec3::new(1.0, 1.0, 0.0),
        DVec3::new(9.0, 9.0, 9.0),
        DVec3::new(0.0, 0.0, 0.0),
        DVec3::new(1.0, 1.0, 0.0),
        DVec3::new(0.0, 1.0, 0.0),
    ];

    /// Two triangles of a square, one in each primitive; vertex 3 is in none.
    fn square() -> Surface<'static> {
        Surface {
            positions: &POSITIONS,
            triangles: &[[0, 1, 2], [4, 5, 6]],
            primitive_of: &[0, 1],
            point_of: &[0, 1, 2, NONE, 0, 2, 3],
            points: 4,
        }
    }

    fn vertex(primitive: u32, point: u32, position: DVec3, of: u32) -> NewVertex {
        NewVertex { primitive, point, position, of: [of; 3], weights: [1.0, 0.0, 0.0] }
    }

    #[test]
    fn an_empty_patch_changes_nothing() {
        let s = square();
        let a = apply(&s, &Patch::default(), &[0, 4]).expect("applies");
        assert_eq!((a.positions.as_slice(), a.triangles.as_slice()), (s.positions, s.triangles));
        assert_eq!((a.point_of.as_slice(), a.points), (s.point_of, 4));
        assert_eq!((a.first_vertex.as_slice(), a.old_from_triangle.as_slice()), (&[0, 4][..], &[0, 1][..]));
        assert_eq!(a.vertex_from_old, [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(check(&a.surface()), Ok(()));
    }

    #[test]
    fn a_split_keeps_primitives_together_and_numbers_points_after_the_old_ones() {
        // The middle of 0–2 in the first primitive's triangle only; point 1 leaves with its vertex.
        let middle = DVec3::new(0.5, 0.5, 0.0);
        let patch = Patch {
            removed: vec![0, 1],
            vertices: vec![
                NewVertex { primitive: 1, point: 4, position: middle, of: [4, 5, 0], weights: [0.5, 0.5, 0.0] },
                vertex(0, 4, middle, 0),
                vertex(0, 5, DVec3::X * 2.0, 1),
            ],
            triangles: vec![
                NewTriangle { primitive: 1, corners: [4, 7, 6] },
                NewTriangle { primitive: 0, corners: [0, 9, 8] },
            ],
            ..Patch::default()
        };
        let a = apply(&square(), &patch, &[0, 4]).expect("applies");
        assert_eq!(a.old_from_vertex, [0, 3, 8, 9, 4, 6, 7]);
        assert_eq!(a.triangles, [[0, 3, 2], [4, 6, 5]]);
        assert_eq!((a.primitive_of.as_slice(), a.first_vertex.as_slice()), (&[0, 1][..], &[0, 4][..]));
        assert_eq!(a.point_from_old, [0, NONE, NONE, 1]);
        assert_eq!(a.old_from_point, [0, 3, NONE, NONE]);
        assert_eq!(a.point_of, [0, NONE, 2, 3, 0, 1, 2]);
        assert_eq!(check(&a.surface()), Ok(()));
    }

    #[test]
    fn moved_and_joined_points_take_all_their_vertices_along() {
        let patch = Patch {
            moved: vec![(0, DVec3::Z)],
            joined: vec![(3, 1)],
            ..Patch::default()
        };
        let a = apply(&square(), &patch, &[0, 4]).expect("applies");
        assert_eq!((a.positions[0], a.positions[4], a.positions[6]), (DVec3::Z, DVec3::Z, DVec3::X));
        assert_eq!((a.points, a.point_from_old.as_slice()), (3, &[0, 1, 2, 1][..]));
    }

    #[test]
    fn broken_patches_are_refused_by_name() {
        let s = square();
        let fresh = |v: NewVertex| Patch {
            vertices: vec![v],
            triangles: vec![NewTriangle { primitive: 0, corners: [0, 1, 7] }],
            ..Patch::default()
        };
        let cases = [
            (Patch { removed: vec![1, 1], ..Patch::default() }, "patch.removed"),
            (Patch { removed: vec![0, 1], ..Patch::default() }, "no triangle"),
            (Patch { moved: vec![(9, DVec3::ZERO)], ..Patch::default() }, "patch.moved"),
            (Patch { moved: vec![(0, DVec3::NAN)], ..Patch::default() }, "no"),
            (Patch { joined: vec![(0, 1), (1, 2)], ..Patch::default() }, "patch.joined"),
            (fresh(vertex(0, 5, DVec3::Z, 0)), "next new one"),
            (fresh(vertex(0, 4, DVec3::Z, 4)), "blended from vertex 4"),
            (fresh(vertex(7, 4, DVec3::Z, 0)), "primitive 7"),
            (fresh(vertex(0, 3, DVec3::Z, 0)), "old point 3"),
            (fresh(vertex(0, 0, DVec3::ZERO, 0)), "two are one"),
            (fresh(NewVertex { weights: [0.5, 0.2, 0.0], ..vertex(0, 4, DVec3::Z, 0) }), "sum to 0.7"),
            (Patch { triangles: vec![NewTriangle { primitive: 0, corners: [0, 1, 3] }], ..Patch::default() }, "unused"),
            (Patch { vertices: vec![vertex(0, 4, DVec3::Z, 0)], ..Patch::default() }, "in no triangle"),
        ];
        for (patch, words) in cases {
            let text = apply(&s, &patch, &[0, 4]).expect_err(words).to_string();
            assert!(text.contains(words), "{text}");
        }
        assert!(apply(&s, &Patch::default(), &[0, 9]).is_err());
        assert!(apply(&s, &Patch::default(), &[0]).is_err());
    }
}
