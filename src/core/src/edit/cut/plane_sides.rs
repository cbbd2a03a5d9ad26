//! On which side of a plane the points of a surface are.

use crate::edit::error::Error;
use crate::edit::surface::SurfaceView;
use crate::mesh::NONE;
use glam::DVec3;
use std::collections::BTreeMap;

/// A plane to cut by: the points x with `normal` · x = `offset`. Above is where it is more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutPlane {
    /// Any length but 0.
    pub normal: DVec3,
    /// In units of the normal's length times the model's.
    pub offset: f64,
}

/// A point nearer to the plane than this fraction of a crossing edge slides onto it.
const SNAP: f64 = 1e-4;

/// On which side of a plane each point is.
pub(super) struct PlaneSides {
    normal: DVec3,
    offset: f64,
    /// For each point of the surface 1 above, −1 below, 0 on the plane.
    pub sign: Vec<i8>,
    low: f64,
    high: f64,
}

impl PlaneSides {
    /// Finds on which side of `plane` each point of `surface` is.
    ///
    /// # Errors
    /// As [`must_part`](Self::must_part).
    pub fn from_plane(surface: &SurfaceView<'_>, plane: &CutPlane) -> Result<Self, Error> {
        let mut sides = Self {
            normal: plane.normal,
            offset: plane.offset,
            sign: vec![0; surface.points as usize],
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
        };
        for (&p, &x) in surface.point_of.iter().zip(surface.positions) {
            if p == NONE {
                continue;
            }
            let dot = plane.normal.dot(x);
            // Below what rounding does to the sum, on is on.
            let noise = 8.0 * f64::EPSILON * (plane.normal.abs().dot(x.abs()) + plane.offset.abs());
            let h = dot - plane.offset;
            sides.low = sides.low.min(dot);
            sides.high = sides.high.max(dot);
            if let Some(s) = sides.sign.get_mut(p as usize) {
                *s = i8::from(h > noise) - i8::from(h < -noise);
            }
        }
        sides.must_part(surface, plane)?;
        Ok(sides)
    }

    /// How far above the plane `x` is, in lengths of the normal.
    pub fn height(&self, x: DVec3) -> f64 {
        self.normal.dot(x) - self.offset
    }

    /// The sides of the corners of a triangle.
    pub fn of_triangle(&self, surface: &SurfaceView<'_>, triangle: &[u32; 3]) -> [i8; 3] {
        triangle.map(|v| {
            (self.sign.get(surface.point_of[v as usize] as usize))
                .copied()
                .unwrap_or(0)
        })
    }

    /// Slides points that are all but on the plane along a crossing edge onto it. Answers where to, and how far.
    pub fn snap_points(&mut self, surface: &SurfaceView<'_>) -> BTreeMap<u32, (DVec3, f64)> {
        let mut moved: BTreeMap<u32, (DVec3, f64)> = BTreeMap::new();
        for t in surface.triangles {
            let s = self.of_triangle(surface, t);
            if !(s.contains(&1) && s.contains(&-1)) {
                continue;
            }
            for k in 0..3 {
                let (u, v) = (t[k], t[(k + 1) % 3]);
                if s[k] * s[(k + 1) % 3] >= 0 {
                    continue;
                }
                let (x, y) = (surface.positions[u as usize], surface.positions[v as usize]);
                let (h, g) = (self.height(x), self.height(y));
                let share = h / (h - g);
                for (near, from, to, share) in [(u, x, y, share), (v, y, x, 1.0 - share)] {
                    if share < SNAP {
                        let place = from.lerp(to, share);
                        let far = place.distance_squared(from);
                        let entry = moved.entry(surface.point_of[near as usize]).or_insert((place, far));
                        let smaller = far.total_cmp(&entry.1).then_with(|| {
                            // Equally far: the order of coordinates decides, not that of the triangles.
                            let order = |p: DVec3, q: DVec3| {
                                p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z))
                            };
                            order(place, entry.0)
                        });
                        if smaller.is_lt() {
                            *entry = (place, far);
                        }
                    }
                }
            }
        }
        for &p in moved.keys() {
            self.sign[p as usize] = 0;
        }
        moved
    }

    /// Refuses a plane that has not something on either side.
    pub fn must_part(&self, surface: &SurfaceView<'_>, plane: &CutPlane) -> Result<(), Error> {
        if self.sign.contains(&1) && self.sign.contains(&-1) {
            return Ok(());
        }
        if surface.triangles.is_empty() || self.low > self.high {
            return Err(Error::impossible("there is no surface to cut", "the whole model"));
        }
        Err(Error::impossible(
            format!(
                "the plane has nothing of the surface on {}; offsets between {} and {} pass through it",
                if self.sign.contains(&1) {
                    "its lower side"
                } else {
                    "its upper side"
                },
                self.low,
                self.high
            ),
            format!("normal {}, offset {}", plane.normal, plane.offset),
        ))
    }
}
