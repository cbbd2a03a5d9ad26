//! From the surface to the editable region.

use super::{Editable, Face, Point, Wedge};
use crate::edit::{Error, Surface};
use crate::mesh::NONE;

/// The triangles of a surface that touch given points, found in flat scans of it.
pub(in crate::edit) struct Touching {
    /// By number, rising.
    pub triangles: Vec<u32>,
}

impl Touching {
    /// Finds the triangles with a corner at a point for which `wanted` holds.
    pub fn find(surface: &Surface, wanted: &Bits) -> Self {
        // A bit for each render vertex stays in the cache, its point would not.
        let mut near = Bits::new(surface.positions.len());
        for (v, &p) in surface.point_of.iter().enumerate() {
            if p != NONE && wanted.has(p) {
                near.set(v as u32);
            }
        }
        let touches = |t: &[u32; 3]| t.iter().any(|&v| near.has(v));
        let numbered = surface.triangles.iter().zip(0u32..);
        Self {
            triangles: numbered.filter(|(t, _)| touches(t)).map(|(_, i)| i).collect(),
        }
    }
}

/// One bit per number.
pub(in crate::edit) struct Bits(Vec<u64>);

impl Bits {
    /// None of `count` numbers.
    pub fn new(count: usize) -> Self {
        Self(vec![0; count.div_ceil(64)])
    }

    /// Puts `i` in; numbers out of range are ignored.
    pub fn set(&mut self, i: u32) {
        if let Some(word) = self.0.get_mut(i as usize / 64) {
            *word |= 1 << (i % 64);
        }
    }

    /// Whether `i` is in.
    pub fn has(&self, i: u32) -> bool {
        self.0
            .get(i as usize / 64)
            .is_some_and(|word| word >> (i % 64) & 1 == 1)
    }
}

/// Refuses a region that is empty, not rising, or names triangles that are not there.
pub(in crate::edit) fn check_faces(surface: &Surface, faces: &[u32]) -> Result<(), Error> {
    let invalid = |problem: String| {
        Err(Error::Invalid {
            field: "region".to_owned(),
            problem,
        })
    };
    let Some(&last) = faces.last() else {
        return invalid("it holds no whole triangle, at least one is needed".to_owned());
    };
    if faces.windows(2).any(|f| f[0] >= f[1]) {
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

/// The points of a triangle; `None` when two are the same or one is missing.
pub(in crate::edit) fn proper_points(surface: &Surface, triangle: u32) -> Option<[u32; 3]> {
    let [a, b, c] = surface.triangles[triangle as usize].map(|v| surface.point_of[v as usize]);
    let missing = a == NONE || b == NONE || c == NONE;
    (!missing && a != b && b != c && c != a).then_some([a, b, c])
}

impl Editable {
    /// Takes `faces`, rising triangle numbers, to be changed, and freezes the others that touch them. Triangles of the
    /// region with two corners at one point are left alone, with all that they touch.
    ///
    /// # Errors
    /// [`Error::Invalid`] when `faces` is no region, see [`check_faces`].
    pub fn gather(surface: &Surface, faces: &[u32]) -> Result<Self, Error> {
        check_faces(surface, faces)?;
        let mut mesh = Self {
            old_vertices: surface.positions.len() as u32,
            old_points: surface.points,
            ..Self::default()
        };
        let mut numbers = Numbers {
            point: vec![0; surface.points as usize],
            wedge: vec![0; surface.positions.len()],
        };
        let mut bits = Bits::new(surface.points as usize);
        let mut improper = Vec::new();
        for &t in faces {
            match proper_points(surface, t) {
                Some(p) => {
                    p.iter().for_each(|&p| bits.set(p));
                    mesh.region.push(t);
                    mesh.take(surface, t, false, &mut numbers);
                }
                None => improper.push(t),
            }
        }
        let inside = mesh.points.len();
        if faces.len() < surface.triangles.len() {
            let mut region = faces.iter().peekable();
            for t in Touching::find(surface, &bits).triangles {
                while region.next_if(|&&f| f < t).is_some() {}
                if region.peek() == Some(&&t) {
                    continue;
                }
                if proper_points(surface, t).is_some() {
                    mesh.take(surface, t, true, &mut numbers);
                } else {
                    improper.push(t);
                }
            }
        }
        for p in 0..mesh.points.len() {
            let frozen = |&f: &u32| mesh.faces[f as usize].frozen;
            let point = &mesh.points[p];
            mesh.points[p].fixed = p >= inside || point.faces.iter().any(frozen) || !mesh.is_single_fan(p as u32);
        }
        for v in improper.iter().flat_map(|&t| surface.triangles[t as usize]) {
            let p = surface.point_of[v as usize];
            if p != NONE && numbers.point[p as usize] > 0 {
                mesh.points[numbers.point[p as usize] as usize - 1].fixed = true;
            }
        }
        Ok(mesh)
    }

    fn take(&mut self, surface: &Surface, t: u32, frozen: bool, numbers: &mut Numbers) {
        let f = self.faces.len() as u32;
        let corners = surface.triangles[t as usize].map(|v| {
            let known = &mut numbers.wedge[v as usize];
            if *known > 0 {
                return *known - 1;
            }
            let old_point = surface.point_of[v as usize];
            let point = &mut numbers.point[old_point as usize];
            if *point == 0 {
                self.points.push(Point {
                    position: surface.positions[v as usize],
                    old: old_point,
                    faces: Vec::new(),
                    fixed: false,
                });
                *point = self.points.len() as u32;
            }
            self.wedges.push(Wedge {
                point: *point - 1,
                primitive: surface.primitive_of[t as usize],
                old: v,
                of: [v; 3],
                weights: [1.0, 0.0, 0.0],
            });
            *known = self.wedges.len() as u32;
            *known - 1
        });
        let points = corners.map(|w| self.wedges[w as usize].point);
        for p in points {
            self.points[p as usize].faces.push(f);
        }
        self.faces.push(Face {
            corners,
            points,
            primitive: surface.primitive_of[t as usize],
            old: t,
            frozen,
            alive: true,
            source: f,
        });
    }
}

/// One more than the local number of a point or render vertex, 0 for those not met. Zeroed memory costs only where it
/// is touched.
struct Numbers {
    point: Vec<u32>,
    wedge: Vec<u32>,
}
