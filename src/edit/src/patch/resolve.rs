//! What a patch says, checked against the surface that it is for.

use super::surface_patch::{NewVertex, PatchedSurface, SurfacePatch};
use crate::surface::SurfaceView;
use glam::DVec3;
use pliant_mesh::{Error, NONE, sorted_set};
use std::collections::BTreeMap;

/// What a patch says about points, checked and ready to look up.
pub(super) struct ResolvedPatch {
    /// Which old points join which: empty when the patch joins none.
    joined: BTreeMap<u32, u32>,
    /// Where the old points that the patch names are after it.
    places: BTreeMap<u32, DVec3>,
}

impl ResolvedPatch {
    pub fn resolve_checked(
        surface: &SurfaceView<'_>,
        patch: &SurfacePatch,
        first_vertex: &[u32],
    ) -> Result<Self, Error> {
        let rising = |what: &'static str, seen: &mut dyn Iterator<Item = u32>, limit: usize| -> Result<(), Error> {
            let mut last = None;
            for s in seen {
                if s as usize >= limit || last.is_some_and(|l| l >= s) {
                    let problem = format!("{s} after {last:?}; numbers must rise and stay below {limit}");
                    return Err(Error::invalid(format!("patch.{what}"), problem));
                }
                last = Some(s);
            }
            Ok(())
        };
        let points = surface.points as usize;
        rising("removed", &mut patch.removed.iter().copied(), surface.triangles.len())?;
        rising("moved", &mut patch.moved.iter().map(|m| m.0), points)?;
        rising("joined", &mut patch.joined.iter().map(|j| j.0), points)?;
        let counts = [
            ("vertices", surface.positions.len() + patch.vertices.len()),
            ("triangles", surface.triangles.len() + patch.triangles.len()),
        ];
        for (what, seen) in counts {
            if seen > (NONE / 6) as usize {
                return Err(Error::TooLarge {
                    what,
                    seen: seen as u64,
                    limit: u64::from(NONE / 6),
                });
            }
        }
        let mut resolved = Self {
            joined: patch.joined.iter().copied().collect(),
            places: BTreeMap::new(),
        };
        for &(from, to) in &patch.joined {
            if to >= surface.points || resolved.joined.contains_key(&to) {
                let problem = format!("point {from} joins {to}, which joins another point or does not exist");
                return Err(Error::invalid("patch.joined", problem));
            }
        }
        if let Some(m) = patch.moved.iter().find(|m| !m.1.is_finite()) {
            return Err(Error::invalid(
                "patch.moved",
                format!("point {} moves to {}, not a place", m.0, m.1),
            ));
        }
        let old = patch.vertices.iter().map(|v| v.point).filter(|&p| p < surface.points);
        let named: Vec<u32> = sorted_set(old.chain(patch.joined.iter().map(|j| j.1)));
        if !named.is_empty() {
            let mut marked = vec![false; points];
            named.iter().for_each(|&p| marked[p as usize] = true);
            for (&p, &x) in surface.point_of.iter().zip(surface.positions) {
                if p != NONE && marked[p as usize] {
                    resolved.places.insert(p, x);
                }
            }
        }
        resolved.places.extend(patch.moved.iter().copied());
        resolved.check_vertices(surface, patch, first_vertex)?;
        resolved.check_triangles(surface, patch, first_vertex)?;
        Ok(resolved)
    }

    fn check_vertices(
        &self,
        surface: &SurfaceView<'_>,
        patch: &SurfacePatch,
        first_vertex: &[u32],
    ) -> Result<(), Error> {
        let mut next = surface.points;
        let mut places: Vec<DVec3> = Vec::new();
        for (index, v) in patch.vertices.iter().enumerate() {
            let refuse = |problem: String| {
                Err(Error::invalid(
                    "patch.vertices",
                    format!("new vertex {index} {problem}"),
                ))
            };
            if v.primitive as usize >= first_vertex.len() {
                return refuse(format!(
                    "is of primitive {}, there are {}",
                    v.primitive,
                    first_vertex.len()
                ));
            }
            if !v.position.is_finite() {
                return refuse(format!("lies at {}, which is not a finite place", v.position));
            }
            if v.point == NONE {
                let run = run_of(first_vertex, surface.positions.len(), v.primitive);
                check_blend(&run, v.of, v.weights).or_else(refuse)?;
                continue;
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
                if self.joined.contains_key(&v.point) || self.places.get(&v.point) != Some(&v.position) {
                    return refuse(format!(
                        "lies apart from its old point {}, or that joins another",
                        v.point
                    ));
                }
            }
            let cap = patch.caps.iter().find(|cap| cap.0 == v.primitive);
            let lender = cap.map_or(v.primitive, |cap| cap.1);
            let run = run_of(first_vertex, surface.positions.len(), lender);
            check_blend(&run, v.of, v.weights).or_else(refuse)?;
        }
        let mut last = None;
        for v in &patch.blended {
            let refuse = |problem: String| {
                Err(Error::invalid(
                    "patch.blended",
                    format!("vertex {} {problem}", v.vertex),
                ))
            };
            if v.vertex as usize >= surface.positions.len() || last.is_some_and(|l| l >= v.vertex) {
                return refuse(format!(
                    "comes after {last:?}; numbers must rise and stay below {}",
                    surface.positions.len()
                ));
            }
            last = Some(v.vertex);
            let primitive = first_vertex.partition_point(|&first| first <= v.vertex) as u32 - 1;
            let run = run_of(first_vertex, surface.positions.len(), primitive);
            check_blend(&run, v.of, v.weights).or_else(refuse)?;
        }
        Ok(())
    }

    fn check_triangles(
        &self,
        surface: &SurfaceView<'_>,
        patch: &SurfacePatch,
        first_vertex: &[u32],
    ) -> Result<(), Error> {
        let old = surface.positions.len();
        for (index, t) in patch.triangles.iter().enumerate() {
            let refuse = |problem: String| {
                Err(Error::invalid(
                    "patch.triangles",
                    format!("new triangle {index} {problem}"),
                ))
            };
            if t.primitive as usize >= first_vertex.len() {
                return refuse(format!(
                    "is of primitive {}, there are {}",
                    t.primitive,
                    first_vertex.len()
                ));
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
                    return refuse(format!(
                        "of primitive {} names vertex {corner} of another, or unused",
                        t.primitive
                    ));
                }
                *point = self.joined_point(of);
            }
            let [a, b, c] = points;
            if a == b || b == c || c == a {
                return refuse(format!("has the points {points:?}, two are one"));
            }
        }
        Ok(())
    }

    /// The point itself, or the one that it joins.
    fn joined_point(&self, p: u32) -> u32 {
        self.joined.get(&p).copied().unwrap_or(p)
    }

    /// Numbers the points that are left and writes what depends on that.
    pub fn number_points(&self, surface: &SurfaceView<'_>, patch: &SurfacePatch, applied: &mut PatchedSurface) {
        let old_vertices = surface.positions.len();
        let points = patch.vertices.iter().map(|v| v.point).filter(|&p| p != NONE);
        let fresh = points.map(|p| p + 1).max().unwrap_or(0);
        let all = fresh.max(surface.points);
        applied.point_of.reserve_exact(applied.old_from_vertex.len());
        applied.point_of.extend(applied.old_from_vertex.iter().map(|&v| {
            let fresh = patch.vertices.get((v as usize).wrapping_sub(old_vertices));
            fresh.map_or_else(|| surface.point_of[v as usize], |fresh| fresh.point)
        }));
        if !self.joined.is_empty() || !patch.moved.is_empty() {
            for (p, x) in applied.point_of.iter_mut().zip(&mut applied.positions) {
                *p = self.joined_point(*p);
                if let Some(&place) = self.places.get(p) {
                    *x = place;
                }
            }
        }
        // Marks first, numbers after, so that numbers follow the old ones and not the order of the vertices.
        let mut number = vec![NONE; all as usize];
        for &p in applied.point_of.iter().filter(|&&p| p != NONE) {
            number[p as usize] = 0;
        }
        applied.old_from_point.reserve_exact(all as usize);
        for (p, n) in number.iter_mut().enumerate().filter(|(_, n)| **n == 0) {
            *n = applied.old_from_point.len() as u32;
            applied
                .old_from_point
                .push(if p < surface.points as usize { p as u32 } else { NONE });
        }
        applied.points = applied.old_from_point.len() as u32;
        for p in applied.point_of.iter_mut().filter(|p| **p != NONE) {
            *p = number[*p as usize];
        }
        number.truncate(surface.points as usize);
        for (&from, &to) in &self.joined {
            number[from as usize] = number[to as usize];
        }
        applied.point_from_old = number;
    }
}

/// Refuses a blend of vertices outside of `run`, the vertices of its primitive, and weights that are none.
fn check_blend(run: &std::ops::Range<u32>, of: [u32; 3], weights: [f64; 3]) -> Result<(), String> {
    let mut sum = 0.0;
    for (of, weight) in of.into_iter().zip(weights).filter(|part| part.1 != 0.0) {
        if !(weight > 0.0 && weight <= 1.0 + 1e-9 && run.contains(&of)) {
            return Err(format!(
                "is blended from vertex {of} by {weight}; allowed are {run:?}, 0 to 1"
            ));
        }
        sum += weight;
    }
    if (sum - 1.0).abs() > 1e-6 {
        return Err(format!("has weights that sum to {sum}, not 1"));
    }
    Ok(())
}

/// The render vertices of a primitive.
fn run_of(first_vertex: &[u32], vertices: usize, primitive: u32) -> std::ops::Range<u32> {
    let p = primitive as usize;
    first_vertex[p]..first_vertex.get(p + 1).map_or(vertices as u32, |&v| v)
}

/// Refuses a surface whose arrays do not fit together, so that nothing after this can index out of range.
pub(super) fn check_surface(surface: &SurfaceView<'_>, first_vertex: &[u32]) -> Result<(), Error> {
    let vertices = surface.positions.len();
    let refuse = |problem: String| Err(Error::invalid("surface", problem));
    if surface.point_of.len() != vertices || surface.primitive_of.len() != surface.triangles.len() {
        return refuse("arrays differ in length".to_owned());
    }
    let runs = first_vertex.first().is_none_or(|&v| v == 0)
        && first_vertex.windows(2).all(|w| w[0] <= w[1])
        && first_vertex.last().map_or(vertices == 0, |&v| v as usize <= vertices);
    if !runs {
        return refuse("the vertex runs of the primitives do not rise from 0 to the number of vertices".to_owned());
    }
    if !surface.primitive_of.is_sorted()
        || surface
            .primitive_of
            .last()
            .is_some_and(|&p| p as usize >= first_vertex.len())
    {
        return refuse("primitives of triangles fall, or have no vertex run".to_owned());
    }
    // Folds instead of searches: they run over several numbers at once.
    if surface.triangles.as_flattened().iter().fold(0, |most, &v| most.max(v)) as usize >= vertices.max(1) {
        return refuse(format!(
            "a triangle names a vertex beyond the last, there are {vertices}"
        ));
    }
    // NONE becomes 0, all others one more.
    if surface.point_of.iter().fold(0, |most, &p| most.max(p.wrapping_add(1))) > surface.points {
        return refuse(format!(
            "a vertex has a point beyond the last, there are {}",
            surface.points
        ));
    }
    Ok(())
}
