//! Cutting by a plane.
//!
//! Points get a sign: above, below, on. Edges with both signs are split where they meet the plane; a point that is
//! nearer to the plane than a ten-thousandth of such an edge slides along the edge onto it instead, so that no slivers
//! arise. Then every triangle is on one side, and the edges between sides are opened.

use super::cap::cap_plane;
use super::draft::{Draft, key};
use super::local::{Local, points_of};
use super::{Error, Patch, Surface};
use crate::mesh::NONE;
use crate::progress::Progress;
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// The points x with `normal` · x = `offset`; above is where it is more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Any length but 0.
    pub normal: DVec3,
    /// In units of the normal's length times the model's.
    pub offset: f64,
}

/// What stays after a cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Keep {
    /// Both sides, parted.
    #[default]
    Both,
    /// The side that the normal points to; left of a curve, seen from outside.
    Above,
    /// The other side; right of a curve.
    Below,
}

/// A point nearer to the plane than this fraction of a crossing edge slides onto it.
const SNAP: f64 = 1e-4;

/// Cuts `surface` by `plane`, everywhere. With `fill` the openings of the sides that stay are closed by flat caps, whose
/// vertices are their own where `hard[primitive]` says so (a primitive with normals; beyond the slice: no).
///
/// # Errors
/// [`Error::Invalid`] for a plane without direction, [`Error::Impossible`] when it does not pass through the surface,
/// [`Error::Cancelled`].
pub fn cut_plane(
    surface: &Surface<'_>,
    plane: &Plane,
    keep: Keep,
    fill: bool,
    hard: &[bool],
    progress: &dyn Progress,
) -> Result<Patch, Error> {
    let length = plane.normal.length();
    if !(length > 0.0 && length.is_finite() && plane.offset.is_finite()) {
        return Err(Error::Invalid {
            field: "cut.plane".to_owned(),
            problem: format!(
                "normal {} and offset {}; the normal must be finite and longer than 0, the offset finite",
                plane.normal, plane.offset
            ),
        });
    }
    let mut sides = Sides::of(surface, plane)?;
    let moved = sides.snap(surface);
    sides.must_part(surface, plane)?;
    if progress.cancelled() {
        return Err(Error::Cancelled);
    }

    // The band: all triangles that touch the plane. Its points on the plane are whole by that.
    let dropped = match keep {
        Keep::Both => None,
        Keep::Above => Some(-1i8),
        Keep::Below => Some(1i8),
    };
    let (mut band, mut gone) = (Vec::new(), Vec::new());
    for (t, f) in surface.triangles.iter().zip(0u32..) {
        let s = sides.of_triangle(surface, t);
        let (low, high) = (s[0].min(s[1]).min(s[2]), s[0].max(s[1]).max(s[2]));
        if low < 0 && high > 0 || s.contains(&0) {
            if points_of(surface, t).is_some() {
                band.push(f);
            } else {
                // Without area it can be on neither side.
                gone.push(f);
            }
        } else if dropped == Some(low) {
            gone.push(f);
        }
    }
    let mut local = Local::of(surface, band);
    for (whole, &p) in local.whole.iter_mut().zip(&local.points) {
        *whole = sides.sign[p as usize] == 0;
    }
    let mut sign: Vec<i8> = local.points.iter().map(|&p| sides.sign[p as usize]).collect();
    let height: Vec<f64> = local.positions.iter().map(|&x| sides.height(x)).collect();
    let mut draft = Draft::new(surface, local);
    for (&p, &(x, _)) in &moved {
        if let Some(p) = draft.local.find(p) {
            draft.positions[p as usize] = x;
        }
    }

    let mut crossing: Vec<(u32, u32)> = Vec::new();
    for t in &draft.local.corners {
        for k in 0..3 {
            let (a, b) = key(t[k], t[(k + 1) % 3]);
            if sign[a as usize] * sign[b as usize] < 0 {
                crossing.push((a, b));
            }
        }
    }
    crossing.sort_unstable();
    crossing.dedup();
    for (done, (a, b)) in crossing.into_iter().enumerate() {
        if done % 1024 == 0 && progress.cancelled() {
            return Err(Error::Cancelled);
        }
        let (ha, hb) = (height[a as usize], height[b as usize]);
        let t = ha / (ha - hb);
        let x = draft.positions[a as usize].lerp(draft.positions[b as usize], t);
        draft.split_edge(a, b, t, x);
        sign.push(0);
    }
    draft.improve(|a, b| sign[a as usize] == 0 && sign[b as usize] == 0);

    // Where sides meet is where to cut.
    let mut meets: BTreeMap<(u32, u32), (bool, bool)> = BTreeMap::new();
    let mut dead: Vec<u32> = Vec::new();
    for f in 0..draft.faces.len() as u32 {
        let face = draft.faces[f as usize];
        if !face.alive {
            continue;
        }
        let above = match face.corners.map(|p| sign[p as usize]).into_iter().find(|&s| s != 0) {
            Some(s) => s > 0,
            // In the plane: it bounds what lies behind it.
            None => draft.area_normal(f).dot(plane.normal) < 0.0,
        };
        for k in 0..3 {
            let (a, b) = (face.corners[k], face.corners[(k + 1) % 3]);
            if sign[a as usize] == 0 && sign[b as usize] == 0 {
                let meet = meets.entry(key(a, b)).or_default();
                *if above { &mut meet.0 } else { &mut meet.1 } = true;
            }
        }
        if dropped == Some(if above { 1 } else { -1 }) {
            dead.push(f);
        }
    }
    let cuts: BTreeSet<(u32, u32)> = meets
        .into_iter()
        .filter(|(_, m)| m.0 && m.1)
        .map(|(edge, _)| edge)
        .collect();
    dead.into_iter().for_each(|f| draft.kill(f));
    draft.open(&cuts);
    if fill {
        let unit = plane.normal / length;
        let rim = draft.rim(|a, b| cuts.contains(&key(draft.root[a as usize], draft.root[b as usize])));
        let sign_of = |p: u32| sign[draft.root[p as usize] as usize];
        let is_above = |f: u32| match draft.faces[f as usize]
            .corners
            .map(sign_of)
            .into_iter()
            .find(|&s| s != 0)
        {
            Some(s) => s > 0,
            None => draft.area_normal(f).dot(unit) < 0.0,
        };
        let (above, below): (Vec<_>, Vec<_>) = rim.into_iter().partition(|r| is_above(r.2));
        cap_plane(&mut draft, &above, -unit, hard, progress)?;
        cap_plane(&mut draft, &below, unit, hard, progress)?;
    }
    Ok(draft.finish(gone)?.0)
}

/// On which side of a plane each point is.
struct Sides {
    normal: DVec3,
    offset: f64,
    sign: Vec<i8>,
    low: f64,
    high: f64,
}

impl Sides {
    fn of(surface: &Surface<'_>, plane: &Plane) -> Result<Self, Error> {
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

    fn height(&self, x: DVec3) -> f64 {
        self.normal.dot(x) - self.offset
    }

    fn of_triangle(&self, surface: &Surface<'_>, triangle: &[u32; 3]) -> [i8; 3] {
        triangle.map(|v| {
            (self.sign.get(surface.point_of[v as usize] as usize))
                .copied()
                .unwrap_or(0)
        })
    }

    /// Slides points that are all but on the plane along a crossing edge onto it. Answers where to, and how far.
    fn snap(&mut self, surface: &Surface<'_>) -> BTreeMap<u32, (DVec3, f64)> {
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
    fn must_part(&self, surface: &Surface<'_>, plane: &Plane) -> Result<(), Error> {
        if self.sign.contains(&1) && self.sign.contains(&-1) {
            return Ok(());
        }
        if surface.triangles.is_empty() || self.low > self.high {
            return Err(Error::Impossible {
                problem: "there is no surface to cut".to_owned(),
                place: "the whole model".to_owned(),
            });
        }
        Err(Error::Impossible {
            problem: format!(
                "the plane has nothing of the surface on {}; offsets between {} and {} pass through it",
                if self.sign.contains(&1) {
                    "its lower side"
                } else {
                    "its upper side"
                },
                self.low,
                self.high
            ),
            place: format!("normal {}, offset {}", plane.normal, plane.offset),
        })
    }
}
