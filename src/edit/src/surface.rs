//! The surface that an edit reads, and flat scans over it.

use glam::DVec3;
use pliant_mesh::{Error, NONE};

/// The surface that an edit works on. Render vertices and triangles stand in file order; triangles of one primitive stand
/// together, primitives in rising order.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceView<'a> {
    /// Render vertices, in the shape that the edit is to see.
    pub positions: &'a [DVec3],
    /// Triangles over render vertices.
    pub triangles: &'a [[u32; 3]],
    /// The primitive of each triangle, never falling.
    pub primitive_of: &'a [u32],
    /// The point of each render vertex; [`NONE`](pliant_mesh::NONE) where no triangle uses it. Vertices of one point
    /// have the same position.
    pub point_of: &'a [u32],
    /// How many points there are.
    pub points: u32,
}

impl SurfaceView<'_> {
    /// Where each point is.
    pub fn point_positions(&self) -> Vec<DVec3> {
        let mut positions = vec![DVec3::ZERO; self.points as usize];
        for (&p, &x) in self.point_of.iter().zip(self.positions) {
            if p != NONE {
                positions[p as usize] = x;
            }
        }
        positions
    }

    /// The points of a triangle when they are three different ones.
    pub(super) fn proper_points(&self, triangle: u32) -> Option<[u32; 3]> {
        let [a, b, c] = self.triangles[triangle as usize].map(|v| self.point_of[v as usize]);
        (a != b && b != c && c != a && ![a, b, c].contains(&NONE)).then_some([a, b, c])
    }

    /// The points of all triangles with three different ones.
    pub(super) fn proper_faces(&self) -> impl Iterator<Item = [u32; 3]> {
        (0..self.triangles.len() as u32).filter_map(|t| self.proper_points(t))
    }

    /// Where the corners of a triangle are.
    pub(super) fn corner_positions(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }

    /// The points at the corners of some triangles; numbers beyond the surface are ignored.
    pub(super) fn points_of_triangles(&self, triangles: &[u32]) -> BitSet {
        let mut points = BitSet::new(self.points as usize);
        for &t in triangles {
            for &v in self.triangles.get(t as usize).into_iter().flatten() {
                points.insert(self.point_of[v as usize]);
            }
        }
        points
    }

    /// The triangles with a corner at one of some points, rising: flat scans of the surface.
    pub(super) fn triangles_touching(&self, points: &BitSet) -> Vec<u32> {
        // A bit for each render vertex stays in the cache, its point would not.
        let mut near = BitSet::new(self.positions.len());
        for (v, &p) in self.point_of.iter().enumerate() {
            if points.contains(p) {
                near.insert(v as u32);
            }
        }
        let touches = |t: &[u32; 3]| t.iter().any(|&v| near.contains(v));
        let numbered = self.triangles.iter().zip(0u32..);
        numbered.filter(|(t, _)| touches(t)).map(|(_, i)| i).collect()
    }
}

/// A set of numbers below a limit, one bit per number.
pub(super) struct BitSet(Vec<u64>);

impl BitSet {
    /// Makes the empty set of numbers below `limit`.
    pub fn new(limit: usize) -> Self {
        Self(vec![0; limit.div_ceil(64)])
    }

    /// Puts `i` in; numbers out of range are ignored.
    pub fn insert(&mut self, i: u32) {
        if let Some(word) = self.0.get_mut(i as usize / 64) {
            *word |= 1 << (i % 64);
        }
    }

    /// Whether `i` is in.
    pub fn contains(&self, i: u32) -> bool {
        self.0
            .get(i as usize / 64)
            .is_some_and(|word| word >> (i % 64) & 1 == 1)
    }
}

/// Pairs of faces around one point, at all points together, that an edit may have to look at: seconds, a minute at worst. Where six
/// faces meet at each point there are 36 for each.
pub const MOST_FACE_PAIRS: u64 = 1 << 30;

/// Refuses a surface where so many faces meet at few points that edits, which look through all faces around a point for each that
/// they change there, would take very long.
///
/// # Errors
/// [`Error::Impossible`] with the point where most faces meet.
pub fn check_faces_at_points(surface: &SurfaceView) -> Result<(), Error> {
    let mut meeting = vec![0u64; surface.points as usize];
    for v in surface.triangles.as_flattened() {
        if let Some(count) = meeting.get_mut(surface.point_of[*v as usize] as usize) {
            *count += 1;
        }
    }
    let squares = meeting.iter().map(|n| n.saturating_mul(*n));
    let pairs = squares.fold(0, u64::saturating_add);
    if pairs <= MOST_FACE_PAIRS {
        return Ok(());
    }
    let most = meeting.iter().copied().max().unwrap_or(0);
    let is_there = |p: &u32| meeting.get(*p as usize) == Some(&most);
    let vertex = surface.point_of.iter().position(is_there).unwrap_or(0);
    Err(Error::impossible(
        format!(
            "{most} faces meet at one point, and an edit looks at all pairs of faces around a point: {pairs} in all, at most \
             {MOST_FACE_PAIRS} are allowed; cut the model's flat faces into triangles that do not all meet at one point"
        ),
        format!("vertex {vertex}"),
    ))
}

/// Refuses a region that is empty, not rising, or names triangles that are not there.
pub(super) fn check_region(surface: &SurfaceView, triangles: &[u32]) -> Result<(), Error> {
    let invalid = |problem: String| Err(Error::invalid("region", problem));
    let Some(&last) = triangles.last() else {
        return invalid("it holds no whole triangle, at least one is needed".to_owned());
    };
    if triangles.windows(2).any(|f| f[0] >= f[1]) {
        return invalid("its triangles must be named once each, in rising order".to_owned());
    }
    if last as usize >= surface.triangles.len() {
        let count = surface.triangles.len();
        return invalid(format!(
            "triangle {last} does not exist, there are {count}, counted from 0"
        ));
    }
    Ok(())
}

/// A surface of unit tests, of one primitive, with a point for each vertex.
#[cfg(test)]
pub(super) struct TestSurface {
    pub positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    primitive_of: Vec<u32>,
    point_of: Vec<u32>,
}

#[cfg(test)]
impl TestSurface {
    pub fn new(positions: impl Into<Vec<DVec3>>, triangles: impl Into<Vec<[u32; 3]>>) -> Self {
        let (positions, triangles) = (positions.into(), triangles.into());
        Self {
            primitive_of: vec![0; triangles.len()],
            point_of: (0..positions.len() as u32).collect(),
            positions,
            triangles,
        }
    }

    pub fn view(&self) -> SurfaceView<'_> {
        SurfaceView {
            positions: &self.positions,
            triangles: &self.triangles,
            primitive_of: &self.primitive_of,
            point_of: &self.point_of,
            points: self.positions.len() as u32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_whose_faces_all_meet_at_one_point_is_refused_beyond_a_bound() {
        let checked = |count: u32| {
            let positions: Vec<DVec3> = (0..=count).map(|k| DVec3::splat(f64::from(k))).collect();
            let triangles: Vec<[u32; 3]> = (1..count).map(|k| [k, k + 1, 0]).collect();
            check_faces_at_points(&TestSurface::new(positions, triangles).view())
        };
        assert_eq!(checked(30_000), Ok(()));
        let refused = checked(40_000).expect_err("too many meet").to_string();
        assert!(refused.starts_with("39999 faces meet at one point"), "{refused}");
        assert!(refused.ends_with("(vertex 0)"), "{refused}");
    }
}
