//! Cutting a surface: by a plane or along a curve on it, with caps over what a cut opens.
//!
//! When a plane cuts, points get a sign: above, below, on. Edges with both signs are split where they meet the plane; a point
//! that is nearer to the plane than a ten-thousandth of such an edge slides along the edge onto it instead, so that no slivers
//! arise. Then every triangle is on one side, and the edges between sides are opened.

mod curve;
mod flat_cap;
mod trace;

use super::fill::CapLook;
use super::patch::SurfacePatch;
use super::region_mesh::{RegionMesh, edge_key};
use super::surface::SurfaceView;
pub use curve::{MOST_POINTS, SurfaceCurve, cut_along_curve, insert_curve};
pub(super) use flat_cap::cap_flat_openings;
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Error, NONE};
use std::collections::{BTreeMap, BTreeSet};

/// Cuts `surface` by `plane`, everywhere. Openings are closed by flat caps.
///
/// # Errors
/// [`Error::Invalid`] for a plane without direction, [`Error::Impossible`] when it does not pass through the surface,
/// [`Error::Cancelled`].
pub fn cut_by_plane(
    surface: &SurfaceView<'_>,
    plane: &CutPlane,
    options: &CutOptions<'_>,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let length = plane.normal.length();
    if !(length > 0.0 && length.is_finite() && plane.offset.is_finite()) {
        return Err(Error::invalid(
            "cut.plane",
            format!(
                "normal {} and offset {}; the normal must be finite and longer than 0, the offset finite",
                plane.normal, plane.offset
            ),
        ));
    }
    let mut sides = PlaneSides::from_plane(surface, plane)?;
    let moved = sides.snap_points(surface);
    sides.must_part(surface, plane)?;
    check(progress)?;

    let dropped = match options.keep {
        KeptSide::Both => None,
        KeptSide::Above => Some(-1i8),
        KeptSide::Below => Some(1i8),
    };
    let (band, gone) = select_band(surface, &sides, dropped);
    let mut mesh = RegionMesh::from_triangles(surface, band);
    for point in &mut mesh.points {
        // All triangles that touch the plane are in the band.
        point.whole = sides.sign[point.old as usize] == 0;
    }
    let mut band = CutBand {
        plane,
        sign: mesh.points.iter().map(|p| sides.sign[p.old as usize]).collect(),
        height: mesh.points.iter().map(|p| sides.height(p.position)).collect(),
        mesh,
    };
    for (&p, &(x, _)) in &moved {
        if let Some(p) = band.mesh.find_point(p) {
            band.mesh.move_surface_point(p, x);
        }
    }
    band.split_crossing_edges(progress)?;
    let cuts = band.part_sides(dropped);
    if options.fill {
        band.close(&cuts, options.cap_look(), progress)?;
    }
    Ok(band.mesh.into_finite_patch(surface, gone)?.0)
}

/// The triangles that touch the plane, and those beside them that go.
fn select_band(surface: &SurfaceView<'_>, sides: &PlaneSides, dropped: Option<i8>) -> (Vec<u32>, Vec<u32>) {
    let (mut band, mut gone) = (Vec::new(), Vec::new());
    for (t, f) in surface.triangles.iter().zip(0u32..) {
        let s = sides.of_triangle(surface, t);
        let (low, high) = (s[0].min(s[1]).min(s[2]), s[0].max(s[1]).max(s[2]));
        if low < 0 && high > 0 || s.contains(&0) {
            if surface.proper_points(f).is_some() {
                band.push(f);
            } else {
                // Without area it can be on neither side.
                gone.push(f);
            }
        } else if dropped == Some(low) {
            gone.push(f);
        }
    }
    (band, gone)
}

/// The triangles that touch the plane while they are cut.
struct CutBand<'a> {
    mesh: RegionMesh,
    plane: &'a CutPlane,
    /// For each point 1 above, −1 below, 0 on the plane; points split off have that of their root.
    sign: Vec<i8>,
    /// How far above the plane each gathered point was.
    height: Vec<f64>,
}

impl CutBand<'_> {
    /// Splits edges between both sides where they meet the plane.
    fn split_crossing_edges(&mut self, progress: &dyn Progress) -> Result<(), Error> {
        let mut crossing = self.mesh.edges();
        crossing.retain(|&(a, b)| self.sign[a as usize] * self.sign[b as usize] < 0);
        for (done, (a, b)) in crossing.into_iter().enumerate() {
            // Each looks through all faces around its ends.
            if done % 128 == 0 {
                check(progress)?;
            }
            let (ha, hb) = (self.height[a as usize], self.height[b as usize]);
            let t = ha / (ha - hb);
            let x = self.mesh.position(a).lerp(self.mesh.position(b), t);
            self.mesh.split_edge(a, b, t, x);
            self.sign.push(0);
        }
        let sign = &self.sign;
        let on_plane = |a, b| [a, b].iter().all(|&p: &u32| sign[p as usize] == 0);
        Ok(self.mesh.improve_split_faces(on_plane, progress)?)
    }

    /// Opens the edges where both sides meet and takes out the side that does not stay. Answers those edges.
    fn part_sides(&mut self, dropped: Option<i8>) -> BTreeSet<(u32, u32)> {
        let mut meets: BTreeMap<(u32, u32), (bool, bool)> = BTreeMap::new();
        let mut dead: Vec<u32> = Vec::new();
        for f in self.mesh.living_faces() {
            let above = self.is_above(f, self.plane.normal);
            let points = self.mesh.points_of(f);
            for k in 0..3 {
                let (a, b) = (points[k], points[(k + 1) % 3]);
                if self.sign[a as usize] == 0 && self.sign[b as usize] == 0 {
                    let meet = meets.entry(edge_key(a, b)).or_default();
                    *if above { &mut meet.0 } else { &mut meet.1 } = true;
                }
            }
            if dropped == Some(if above { 1 } else { -1 }) {
                dead.push(f);
            }
        }
        let both = meets.into_iter().filter(|(_, m)| m.0 && m.1);
        let cuts: BTreeSet<(u32, u32)> = both.map(|(edge, _)| edge).collect();
        dead.into_iter().for_each(|f| self.mesh.remove_face(f));
        self.mesh.open_fans(&cuts);
        cuts
    }

    /// On which side of the plane a face is; one in the plane bounds what lies behind it, seen along `normal`.
    fn is_above(&self, f: u32, normal: DVec3) -> bool {
        let sign = |p: u32| self.sign[self.mesh.points[p as usize].root as usize];
        match self.mesh.points_of(f).map(sign).into_iter().find(|&s| s != 0) {
            Some(s) => s > 0,
            None => self.mesh.area_normal(f).dot(normal) < 0.0,
        }
    }

    /// Closes what the cut opened, on each side.
    fn close(&mut self, cuts: &BTreeSet<(u32, u32)>, look: CapLook<'_>, progress: &dyn Progress) -> Result<(), Error> {
        let root = |p: u32| self.mesh.points[p as usize].root;
        let open = self.mesh.open_sides(|a, b| cuts.contains(&edge_key(root(a), root(b))));
        let unit = self.plane.normal / self.plane.normal.length();
        let (above, below): (Vec<_>, Vec<_>) = open.into_iter().partition(|side| self.is_above(side.2, unit));
        cap_flat_openings(&mut self.mesh, &above, -unit, look, progress)?;
        cap_flat_openings(&mut self.mesh, &below, unit, look, progress)
    }
}

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
struct PlaneSides {
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

/// What stays after a cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum KeptSide {
    /// Both sides, parted.
    #[default]
    Both,
    /// The side that the normal points to; left of a curve, seen from outside.
    Above,
    /// The other side; right of a curve.
    Below,
}

/// What a cut does with the two sides that it makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CutOptions<'a> {
    /// What stays.
    pub keep: KeptSide,
    /// Whether the openings of the sides that stay are closed by caps.
    pub fill: bool,
    /// For each primitive, whether the vertices of its caps are their own (a primitive with normals); no beyond the end.
    pub hard_caps: &'a [bool],
    /// Caps belong to primitives of their own: that of an opening in primitive p is number this + p.
    pub own_caps: Option<u32>,
}

impl<'a> CutOptions<'a> {
    fn cap_look(&self) -> CapLook<'a> {
        CapLook {
            hard: self.hard_caps,
            own: self.own_caps,
        }
    }
}
