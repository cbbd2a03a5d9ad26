//! Taking noise off a surface while it keeps its volume.
//!
//! Points go towards the mean of their neighbours and back again by a little more (Taubin, "A Signal Processing Approach to Fair
//! Surface Design", 1995), so that waves shorter than some edges go and longer ones stay. The weights are the cotangents of
//! the surface as it was (Desbrun et al. 1999; kept from the start as by Kazhdan et al. 2012), so points hardly slide.
//! What volume is still lost or won then comes back along the normals, where points have moved. Of coarse closed parts the size comes
//! back after each iteration.

use super::patch::{EditWarning, SurfacePatch};
use super::region_mesh::RegionMesh;
use super::smooth_closed::PASSED;
use super::surface::SurfaceView;
use super::triangle;
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Error, NONE};

/// How strongly and how often points are moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothOptions {
    /// How often, 1 to [`MOST_SMOOTHINGS`].
    pub iterations: u32,
    /// The share of the largest step, above 0 and at most 1.
    pub strength: f64,
    /// Edges whose faces' normals differ by more stay where they are, degrees above 0 and up to 180.
    pub sharp_degrees: f64,
}

/// The most iterations of a smoothing or relaxation.
pub const MOST_SMOOTHINGS: u32 = 1000;

/// Iterations where nothing else is asked for.
pub const SMOOTHINGS: u32 = 10;

/// Strength where nothing else is asked for.
pub const SMOOTH_STRENGTH: f64 = 0.5;

/// The most moves of a point, all iterations together: about a minute.
const MOST_MOVES: u64 = 1 << 29;

/// The step of strength 1, in parts of the way to the mean of the neighbours: longer ones make the shortest waves grow.
const STEP: f64 = 0.63;

/// Weights of an edge are no less than this, so that all are positive.
const LEAST_WEIGHT: f64 = 0.02;

/// No more than this, so that no sliver counts for all.
const LARGEST_WEIGHT: f64 = 20.0;

/// Smooths the triangles `faces`, rising numbers. Boundaries, the rim of the region, points around which the faces make no
/// single fan and edges sharper than asked for stay as they are. The patch says by which part of the whole volume that of the
/// surface differs after it; one that changes nothing comes with the warning `smooth-nothing`.
///
/// # Errors
/// [`Error::Invalid`] for options out of range or no region; [`Error::TooLarge`] for more moves of points than take a minute;
/// [`Error::Cancelled`].
pub fn smooth_region(
    surface: &SurfaceView<'_>,
    faces: &[u32],
    options: &SmoothOptions,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let mesh = options.gather(surface, faces, MOST_MOVES)?;
    let mut work = Smoother::new(mesh, options.sharp_cosine(), progress)?;
    let whole = work.whole_parts();
    let back = 1.0 / (PASSED - 1.0 / (STEP * options.strength));
    for iteration in 0..options.iterations {
        progress.report("edit", iteration as f32 / options.iterations as f32);
        check(progress)?;
        let before = work.positions();
        work.step(STEP * options.strength);
        work.step(back);
        work.restore_extents(&whole, &before);
        work.take_back(&before);
    }
    work.restore_volume(&whole, progress)?;
    let change = work.volume_change(surface);
    let mut patch = work.mesh.into_moves(surface);
    patch.volume_change = change;
    if patch.moved.is_empty() {
        let message =
            "every point is held, by the rim, a boundary or a sharp edge, or is of a part too coarse to smooth";
        patch
            .warnings
            .push(EditWarning::new("smooth-nothing", message, "region"));
    }
    Ok(patch)
}

impl SmoothOptions {
    /// The region to move points of, where the options are in range and ask for no more moves than `limit`.
    pub(super) fn gather(&self, surface: &SurfaceView<'_>, faces: &[u32], limit: u64) -> Result<RegionMesh, Error> {
        self.check()?;
        let mesh = RegionMesh::with_frozen_ring(surface, faces)?;
        let seen = mesh.points.len() as u64 * u64::from(self.iterations);
        if seen > limit {
            let what = "moves of points (points of the region times smooth.iterations)";
            return Err(Error::TooLarge { what, seen, limit });
        }
        Ok(mesh)
    }

    /// Refuses what is out of range.
    fn check(&self) -> Result<(), Error> {
        let refuse = |field: &str, problem: String| Err(Error::invalid(format!("smooth.{field}"), problem));
        if !(1..=MOST_SMOOTHINGS).contains(&self.iterations) {
            let problem = format!("is {}, allowed are 1 to {MOST_SMOOTHINGS}", self.iterations);
            return refuse("iterations", problem);
        }
        if !(self.strength > 0.0 && self.strength <= 1.0) {
            return refuse(
                "strength",
                format!("is {}, allowed is above 0 and up to 1", self.strength),
            );
        }
        if !(self.sharp_degrees > 0.0 && self.sharp_degrees <= 180.0) {
            let problem = format!("is {}, allowed is above 0 and up to 180 degrees", self.sharp_degrees);
            return refuse("sharpDegrees", problem);
        }
        Ok(())
    }

    /// The cosine of the angle beyond which edges stay.
    pub(super) fn sharp_cosine(&self) -> f64 {
        libm::cos(self.sharp_degrees.to_radians())
    }
}

/// A region while it is smoothed.
pub(super) struct Smoother {
    pub mesh: RegionMesh,
    /// The points that move, rising, and of each its neighbours with weights that sum to 1.
    pub free: Vec<u32>,
    pub rows: Vec<Vec<(u32, f64)>>,
    /// The place of each point of the mesh among those that move, or [`NONE`].
    pub row_of: Vec<u32>,
    /// Where the points of the mesh were.
    pub before: Vec<DVec3>,
}

impl Smoother {
    fn new(mesh: RegionMesh, sharp_cosine: f64, progress: &dyn Progress) -> Result<Self, Error> {
        let mut held: Vec<bool> = mesh.points.iter().map(|p| p.fixed).collect();
        let mut weights = Vec::new();
        for (k, (a, b)) in mesh.edges().into_iter().enumerate() {
            if k.is_multiple_of(4096) {
                check(progress)?;
            }
            let edge = mesh.edge_faces(a, b);
            let sides: Vec<u32> = edge.faces().collect();
            let is_sharp = |f: u32, g: u32| {
                let cosine = triangle::cosine(mesh.area_normal(f), mesh.area_normal(g));
                cosine.is_some_and(|c| c < sharp_cosine)
            };
            match sides[..] {
                [f, g] if !edge.tangled && !is_sharp(f, g) => {}
                _ => [a, b].into_iter().for_each(|p| held[p as usize] = true),
            }
            let cotangents = sides.iter().filter_map(|&f| {
                let tip = mesh.position(mesh.opposite_corner(f, a, b)?);
                let (u, v) = (mesh.position(a) - tip, mesh.position(b) - tip);
                Some(u.dot(v) / u.cross(v).length())
            });
            let sum: f64 = cotangents.sum();
            let weight = if sum.is_nan() { LEAST_WEIGHT } else { sum };
            weights.push((a, b, weight.clamp(LEAST_WEIGHT, LARGEST_WEIGHT)));
        }
        let is_free = |p: &u32| !held[*p as usize] && !mesh.faces_around(*p).is_empty();
        let free: Vec<u32> = (0..mesh.points.len() as u32).filter(is_free).collect();
        let mut row_of = vec![NONE; mesh.points.len()];
        for (row, &p) in (0u32..).zip(&free) {
            row_of[p as usize] = row;
        }
        let mut rows: Vec<Vec<(u32, f64)>> = vec![Vec::new(); free.len()];
        for (a, b, weight) in weights {
            for (p, q) in [(a, b), (b, a)] {
                if let Some(row) = rows.get_mut(row_of[p as usize] as usize) {
                    row.push((q, weight));
                }
            }
        }
        for row in &mut rows {
            let sum: f64 = row.iter().map(|n| n.1).sum();
            row.iter_mut().for_each(|n| n.1 /= sum);
        }
        Ok(Self {
            before: mesh.points.iter().map(|p| p.position).collect(),
            mesh,
            free,
            rows,
            row_of,
        })
    }

    /// Where the points that move are.
    pub fn positions(&self) -> Vec<DVec3> {
        self.free.iter().map(|&p| self.mesh.position(p)).collect()
    }

    pub fn set_positions(&mut self, positions: &[DVec3]) {
        for (&p, &x) in self.free.iter().zip(positions) {
            self.mesh.points[p as usize].position = x;
        }
    }

    /// Moves all points by a part of the way to the mean of their neighbours.
    fn step(&mut self, part: f64) {
        let moved: Vec<DVec3> = (self.free.iter().zip(&self.rows))
            .map(|(&p, row)| {
                let mean: DVec3 = row.iter().map(|&(q, weight)| self.mesh.position(q) * weight).sum();
                let here = self.mesh.position(p);
                here + (mean - here) * part
            })
            .collect();
        self.set_positions(&moved);
    }

    /// Puts points back where they were `before` while a face at them has turned over, against the faces around it, or lost its
    /// area. One that was turned over may stay so or turn back.
    pub fn take_back(&mut self, before: &[DVec3]) {
        let is_free = |p: &u32| self.row_of[*p as usize] != NONE;
        let faces: Vec<u32> = (self.mesh.living_faces())
            .filter(|&f| self.mesh.points_of(f).iter().any(is_free))
            .collect();
        let was_over = self.turned_over(&faces, |p| match self.row_of[p as usize] {
            NONE => self.mesh.position(p),
            row => before[row as usize],
        });
        loop {
            let is_over = self.turned_over(&faces, |p| self.mesh.position(p));
            let worse = (0..faces.len()).filter(|&k| is_over[k] && !was_over[k]);
            let mut changed = false;
            for p in worse.flat_map(|k| self.mesh.points_of(faces[k])).collect::<Vec<u32>>() {
                if let Some(&was) = before.get(self.row_of[p as usize] as usize) {
                    let point = &mut self.mesh.points[p as usize];
                    changed |= point.position != was;
                    point.position = was;
                }
            }
            if !changed {
                break;
            }
        }
    }

    /// Which of some faces look away from the mean normal of the faces around their corners, were the points at these places.
    fn turned_over(&self, faces: &[u32], at: impl Fn(u32) -> DVec3) -> Vec<bool> {
        let area_normal = |f: u32| triangle::area_normal(self.mesh.points_of(f).map(&at));
        let mut normals = vec![DVec3::ZERO; self.mesh.points.len()];
        for (f, face) in (0u32..).zip(&self.mesh.faces) {
            let normal = area_normal(f);
            face.points.iter().for_each(|&p| normals[p as usize] += normal);
        }
        let looks_away = |&f: &u32| {
            let around: DVec3 = self.mesh.points_of(f).iter().map(|&p| normals[p as usize]).sum();
            area_normal(f).dot(around) <= 0.0
        };
        faces.iter().map(looks_away).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::patch::apply_patch;
    use crate::remesh::relax_region;
    use crate::surface::TestSurface;
    use pliant_exec::progress::Silent;
    use pliant_mesh::BoundingBox;
    use std::f64::consts::TAU;

    /// Numbers between −1 and 1 that look like chance.
    fn chance(k: usize) -> f64 {
        let mixed = (k as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        ((mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// A grid of `u` by `v` cells, closed both ways when `closed`.
    fn grid(u: u32, v: u32, closed: bool, at: impl Fn(f64, f64) -> DVec3) -> TestSurface {
        let (rows, columns) = if closed { (u, v) } else { (u + 1, v + 1) };
        let places = (0..rows).flat_map(|i| (0..columns).map(move |j| (i, j)));
        let positions: Vec<DVec3> = places
            .map(|(i, j)| at(f64::from(i) / f64::from(u), f64::from(j) / f64::from(v)))
            .collect();
        let point = |i: u32, j: u32| i % rows * columns + j % columns;
        let cells = (0..u).flat_map(|i| (0..v).map(move |j| (i, j)));
        let triangles: Vec<[u32; 3]> = cells
            .flat_map(|(i, j)| {
                let [a, b, c, d] = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect();
        TestSurface::new(positions, triangles)
    }

    fn torus() -> TestSurface {
        grid(48, 24, true, |s, t| {
            let (s, t) = (s * TAU, t * TAU);
            let out = 2.0 + 0.7 * libm::cos(t);
            DVec3::new(out * libm::cos(s), out * libm::sin(s), 0.7 * libm::sin(t))
        })
    }

    fn off_torus(p: DVec3) -> f64 {
        (p.truncate().length() - 2.0).hypot(p.z) - 0.7
    }

    fn options(iterations: u32, sharp_degrees: f64) -> SmoothOptions {
        SmoothOptions {
            iterations,
            strength: 1.0,
            sharp_degrees,
        }
    }

    fn volume(surface: &SurfaceView<'_>) -> f64 {
        let cones = (0..surface.triangles.len() as u32).map(|t| surface.corner_positions(t));
        cones.map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    #[test]
    fn noise_goes_while_the_volume_and_what_is_outside_stay() {
        let mut noisy = torus();
        for (k, p) in noisy.positions.iter_mut().enumerate() {
            *p += DVec3::new(chance(3 * k), chance(3 * k + 1), chance(3 * k + 2)) * 0.03;
        }
        let view = noisy.view();
        let upper: Vec<u32> = (0..view.triangles.len() as u32)
            .filter(|&t| view.corner_positions(t).iter().all(|p| p.z > -0.2))
            .collect();
        let all: Vec<u32> = (0..view.triangles.len() as u32).collect();
        // The rim of the upper part stays noisy.
        for (region, left) in [(all, 0.35), (upper, 0.6)] {
            let patch = smooth_region(&view, &region, &options(20, 180.0), &Silent).expect("smooths");
            let now = apply_patch(&view, &patch, &[0]).expect("applies");
            assert_eq!(
                (&now.triangles[..], now.old_from_vertex.len()),
                (view.triangles, view.positions.len())
            );
            let inside = view.points_of_triangles(&region);
            let noise = |positions: &[DVec3]| {
                let moved = patch.moved.iter().map(|m| off_torus(positions[m.0 as usize]).powi(2));
                (moved.sum::<f64>() / patch.moved.len() as f64).sqrt()
            };
            assert!(
                noise(&now.positions) < left * noise(view.positions),
                "{}",
                noise(&now.positions)
            );
            assert!((volume(&now.surface()) / volume(&view) - 1.0).abs() < 1e-8);
            assert!(patch.volume_change.abs() < 1e-8 && patch.moved.len() > region.len() / 3);
            for (p, place) in view.positions.iter().enumerate() {
                assert!(inside.contains(p as u32) || now.positions[p] == *place);
            }
        }
    }

    /// A closed cone of so many sides.
    fn cone(sides: u32, height: f64) -> TestSurface {
        let at = |k: u32| f64::from(k) * TAU / f64::from(sides);
        let rim = (0..sides).map(|k| DVec3::new(libm::cos(at(k)), libm::sin(at(k)), 0.0));
        let positions: Vec<DVec3> = rim.chain([DVec3::ZERO, DVec3::Z * height]).collect();
        let round = |k: u32| (k + 1) % sides;
        let faces = (0..sides).flat_map(|k| [[k, round(k), sides + 1], [round(k), k, sides]]);
        TestSurface::new(positions, faces.collect::<Vec<_>>())
    }

    #[test]
    fn a_coarse_closed_part_keeps_its_volume_and_its_extents() {
        for (sides, height, iterations) in [(16, 2.0, 20), (4, 0.5, 10), (8, 30.0, 20), (16, 2.0, 500)] {
            let cone = cone(sides, height);
            let view = cone.view();
            let all: Vec<u32> = (0..view.triangles.len() as u32).collect();
            let patch = smooth_region(&view, &all, &options(iterations, 180.0), &Silent).expect("smooths");
            let now = apply_patch(&view, &patch, &[0]).expect("applies");
            let kept = volume(&now.surface()) / volume(&view);
            let [was, is] = [view.positions, &now.positions].map(|p| BoundingBox::of(p).size());
            assert!((kept - 1.0).abs() < 1e-8, "{sides} sides, {iterations} times: {kept}");
            assert!(patch.volume_change.abs() < 1e-8);
            assert!(
                (is / was).min_element() > 0.6 && (is / was).max_element() < 1.5,
                "{was} {is}"
            );
        }
    }

    #[test]
    fn boundaries_and_sharp_edges_stay_and_nothing_turns_over() {
        // A roof with a ridge along x = 0.5, its tiles uneven.
        let mut roof = grid(20, 20, false, |s, t| DVec3::new(s, t, 0.5 - (s - 0.5).abs()));
        for (k, p) in roof.positions.iter_mut().enumerate() {
            if p.x != 0.5 {
                p.z += 0.004 * chance(k);
            }
        }
        let view = roof.view();
        let all: Vec<u32> = (0..view.triangles.len() as u32).collect();
        for (degrees, is_kept) in [(60.0, true), (180.0, false)] {
            let patch = smooth_region(&view, &all, &options(15, degrees), &Silent).expect("smooths");
            let now = apply_patch(&view, &patch, &[0]).expect("applies");
            for (k, (was, is)) in view.positions.iter().zip(&now.positions).enumerate() {
                let on_rim = [was.x, was.y].iter().any(|c| *c == 0.0 || *c == 1.0);
                assert!(was == is || !(on_rim || (is_kept && was.x == 0.5)), "point {k}");
            }
            let inner = view
                .positions
                .iter()
                .position(|p| p.x == 0.5 && p.y == 0.5)
                .expect("the middle");
            assert_eq!(now.positions[inner] == view.positions[inner], is_kept);
            for t in 0..view.triangles.len() as u32 {
                let [was, is] = [view, now.surface()].map(|s| triangle::area_normal(s.corner_positions(t)));
                assert!(was.dot(is) > 0.0);
            }
        }
    }

    #[test]
    fn relaxing_evens_triangles_where_they_are_and_attributes_follow_on_both_sides_of_a_seam() {
        // A bent sheet of uneven cells whose columns before and after the middle have vertices of their own.
        let warped = |s: f64| s + 0.11 * libm::sin(9.0 * s) * (s * (1.0 - s)).sqrt();
        let sheet = grid(16, 16, false, |s, t| {
            let (x, y) = (if s == 0.5 { s } else { warped(s) }, warped(t));
            DVec3::new(x, y, 0.0)
        });
        let whole = sheet.view();
        let middle = |v: u32| whole.positions[v as usize].x == 0.5;
        let right = |t: &[u32; 3]| t.iter().map(|&v| whole.positions[v as usize].x).sum::<f64>() > 1.5;
        let twins: Vec<u32> = (0..whole.positions.len() as u32).filter(|&v| middle(v)).collect();
        let mut positions = whole.positions.to_vec();
        positions.extend(twins.iter().map(|&v| whole.positions[v as usize]));
        let twin = |v: u32| {
            twins
                .binary_search(&v)
                .map_or(v, |k| (whole.positions.len() + k) as u32)
        };
        let triangles: Vec<[u32; 3]> = (whole.triangles.iter())
            .map(|t| if right(t) { t.map(twin) } else { *t })
            .collect();
        let point_of: Vec<u32> = (0..whole.positions.len() as u32).chain(twins.iter().copied()).collect();
        let seamed = SurfaceView {
            positions: &positions,
            triangles: &triangles,
            point_of: &point_of,
            ..whole
        };
        let all: Vec<u32> = (0..triangles.len() as u32).collect();
        let patch = relax_region(&seamed, &all, &options(30, 40.0), &Silent).expect("relaxes");
        let now = apply_patch(&seamed, &patch, &[0]).expect("applies");
        let worst = |s: &SurfaceView<'_>| {
            let aspects = (0..all.len() as u32).map(|t| triangle::aspect(s.corner_positions(t)));
            aspects.fold(0.0, f64::max)
        };
        let [before, after] = [seamed, now.surface()].map(|s| worst(&s));
        assert!(before > 2.0 && after < 1.6, "{before} {after}");
        assert!(patch.deviation < 1e-12 && patch.blended.len() > 200);
        for blended in &patch.blended {
            let made: DVec3 = blended.parts().map(|(v, w)| positions[v as usize] * w).sum();
            assert!(made.distance(now.positions[blended.vertex as usize]) < 1e-12);
            let side = |v: u32| v as usize >= whole.positions.len() || (positions[v as usize].x > 0.5);
            let seam = positions[blended.vertex as usize].x == 0.5;
            let own = blended.vertex as usize >= whole.positions.len();
            assert!(
                !seam
                    || blended
                        .parts()
                        .all(|(v, _)| positions[v as usize].x == 0.5 && side(v) == own)
            );
        }
        assert!(patch.blended.iter().any(|b| twins.contains(&b.vertex)));
        // What is even already stays.
        let even = grid(8, 8, false, |s, t| DVec3::new(s + 0.5 * t, t * 0.75f64.sqrt(), 0.0));
        let all: Vec<u32> = (0..even.view().triangles.len() as u32).collect();
        let nothing = relax_region(&even.view(), &all, &options(5, 40.0), &Silent).expect("nothing to do");
        assert_eq!((nothing.moved.len(), &*nothing.warnings[0].code), (0, "smooth-nothing"));
    }
}
