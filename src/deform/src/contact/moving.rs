//! Contact while things move: frames of a drag or of a recording.
//!
//! Each frame goes on from the displacement of the one before, carried along in frames of the surface around each vertex, and a little
//! ahead. So what is apart stays on its side in a deep pose that is reached in small steps. A few steps shorten the curves in which
//! surfaces cross. A frame that does not cross without a displacement keeps its bits, and nothing is left of earlier ones.

use super::contour::contour_conditions;
use super::displace::DisplacementProblem;
use super::find::{ContactFinder, Knowledge};
use super::layers::LayerSides;
use super::region::ContactRegion;
use super::{CONTOUR_BACK, CONTOUR_STYLE, MOST_PARTED, displaced, faces_of_vertices, rest_bend};
use crate::surface_faults::most_overlaps;
use glam::{DMat3, DVec3};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::{Lists, Mesh, MovingCrossings, is_crossing};

/// How far the region reaches around triangles that cross, in rings of faces.
const RINGS: usize = 8;
/// How far surfaces go apart in an update, median edges.
const STEP: f64 = 0.5;
/// What part of the last change of the displacement is expected to come again.
const AHEAD: f64 = 0.5;
/// A displacement with so many times the pairs of the frame without it is given up.
const LOST: f64 = 1.5;

/// A surface that handles hold in part, while it moves.
pub struct MovingSurface<'a> {
    /// In the rest pose.
    pub mesh: &'a Mesh,
    /// By graph node, those of the surface first: whether it stays.
    pub held: &'a [bool],
    /// How often the displacement of a frame is improved at most.
    pub updates: usize,
}

/// Bytes that parting takes for each vertex, or for two triangles where there are more of these.
const VERTEX_BYTES: u64 = 1024;

impl MovingSurface<'_> {
    /// About how many bytes parting its first frame takes.
    pub fn byte_estimate(&self) -> u64 {
        let (vertices, triangles) = (self.mesh.positions.len(), self.mesh.triangles.len());
        VERTEX_BYTES * vertices.max(triangles.div_ceil(2)) as u64
    }
}

/// What a frame leaves to the next about contact. It belongs to one surface and its handles.
#[derive(Debug, Default)]
pub struct ContactMemory {
    known: Option<KnownSurface>,
    /// The displacements of the last two frames, the newest first, in the frame of the surface around each vertex.
    moved: [Vec<(u32, DVec3)>; 2],
    /// Pairs of the last frame without displacement.
    pairs: usize,
}

/// What is known of a surface whatever its pose.
#[derive(Debug)]
struct KnownSurface {
    search: MovingCrossings,
    faces_of: Lists,
    /// By face: whether a corner is free.
    is_free: Vec<bool>,
    rest_bend: Vec<f64>,
}

/// A displacement of a frame.
#[derive(Clone)]
struct FrameAttempt {
    /// By free node.
    moved: Vec<DVec3>,
    /// All places.
    at: Vec<DVec3>,
    /// Pairs of faces that cross.
    crossings: Vec<[u32; 2]>,
}

/// A frame that is being parted.
struct FrameParting<'a> {
    surface: &'a MovingSurface<'a>,
    /// Without displacement.
    base: &'a [DVec3],
    region: &'a ContactRegion,
}

impl ContactMemory {
    /// Moves vertices among the `positions` of a frame (of graph nodes, those of the surface first) so that fewer pairs of triangles
    /// cross that do not in the rest pose; returns whether it has. Where it cannot, they keep their bits.
    ///
    /// # Errors
    /// [`Cancelled`]; what earlier frames have left is forgotten.
    pub fn part(
        &mut self,
        surface: &MovingSurface<'_>,
        positions: &mut [DVec3],
        exec: &Exec<'_>,
    ) -> Result<bool, Cancelled> {
        let Self { known, moved, pairs } = std::mem::take(self);
        let mut known = known.unwrap_or_else(|| KnownSurface::of(surface, exec));
        let base = &positions[..surface.mesh.positions.len()];
        let before = known.crossings(surface, base, exec)?;
        let mut has_moved = false;
        if (1..=MOST_PARTED).contains(&before.len()) {
            let held = &surface.held[..base.len()];
            let region = ContactRegion::around(surface.mesh, &known.faces_of, held, &before, RINGS);
            let frames = LocalFrames::of(&region, &known.faces_of, surface.mesh, base);
            let parting = FrameParting {
                surface,
                base,
                region: &region,
            };
            let start = frames.start(&region, &moved, before.len() >= pairs);
            let best = parting.improve(start, &mut known, exec)?;
            let best = best.filter(|best| best.at.iter().all(|p| p.is_finite()));
            if let Some(best) = best.filter(|best| best.crossings.len() as f64 <= LOST * before.len() as f64) {
                let [last, _] = moved;
                self.moved = [frames.local(&region, &best.moved), last];
                self.pairs = before.len();
                if best.crossings.len() < before.len() {
                    positions[..best.at.len()].copy_from_slice(&best.at);
                    has_moved = true;
                }
            }
        }
        self.known = Some(known);
        Ok(has_moved)
    }

    /// Whether triangles of a frame cross that do not in the rest pose. The frame leaves nothing to the next.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn would_part(
        &mut self,
        surface: &MovingSurface<'_>,
        positions: &[DVec3],
        exec: &Exec<'_>,
    ) -> Result<bool, Cancelled> {
        let known = self.known.get_or_insert_with(|| KnownSurface::of(surface, exec));
        let crossings = known.crossings(surface, &positions[..surface.mesh.positions.len()], exec)?;
        Ok((1..=MOST_PARTED).contains(&crossings.len()))
    }

    /// Whether nothing is known yet, so that the next frame takes memory ([`MovingSurface::byte_estimate`]).
    pub fn is_empty(&self) -> bool {
        self.known.is_none()
    }

    /// Forgets what frames have left.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let moved: usize = self.moved.iter().map(Vec::capacity).sum();
        self.known.as_ref().map_or(0, KnownSurface::byte_size) + moved * size_of::<(u32, DVec3)>()
    }
}

/// Those of some pairs of faces that do not cross in the rest pose.
fn new_crossings(mesh: &Mesh, mut crossings: Vec<[u32; 2]>) -> Vec<[u32; 2]> {
    let origin = mesh.bounds().origin();
    crossings.retain(|pair| !is_crossing(&mesh.positions, origin, &mesh.triangles, *pair));
    crossings
}

impl KnownSurface {
    fn of(surface: &MovingSurface<'_>, exec: &Exec<'_>) -> Self {
        let mesh = surface.mesh;
        let is_free = |t: &[u32; 3]| t.iter().any(|v| !surface.held[*v as usize]);
        Self {
            search: MovingCrossings::build(&mesh.positions, &mesh.triangles, exec),
            faces_of: faces_of_vertices(mesh),
            is_free: mesh.triangles.iter().map(is_free).collect(),
            rest_bend: rest_bend(mesh),
        }
    }

    /// Pairs of faces that cross and do not in the rest pose; none where nearly all faces overlap.
    fn crossings(
        &mut self,
        surface: &MovingSurface<'_>,
        at: &[DVec3],
        exec: &Exec<'_>,
    ) -> Result<Vec<[u32; 2]>, Cancelled> {
        let most = most_overlaps(&surface.mesh.triangles);
        let found = self.search.find(at, &self.is_free, most, exec)?;
        Ok(found.map_or_else(Vec::new, |all| new_crossings(surface.mesh, all)))
    }

    fn byte_size(&self) -> usize {
        self.search.byte_size()
            + self.faces_of.byte_size()
            + self.is_free.capacity()
            + self.rest_bend.capacity() * size_of::<f64>()
    }
}

impl FrameParting<'_> {
    /// Improves a displacement a few times; returns the best of all, `None` where nearly all faces overlap.
    fn improve(
        &self,
        start: Vec<DVec3>,
        known: &mut KnownSurface,
        exec: &Exec<'_>,
    ) -> Result<Option<FrameAttempt>, Cancelled> {
        let Some(mut now) = self.look(start, known, exec)? else {
            return Ok(None);
        };
        let mut best = now.clone();
        for _ in 0..self.surface.updates {
            if best.crossings.is_empty() {
                break;
            }
            let moved = self.shorten_curves(&now, &known.rest_bend, exec)?;
            match self.look(moved, known, exec)? {
                Some(next) => now = next,
                None => break,
            }
            if now.crossings.len() < best.crossings.len() {
                best.clone_from(&now);
            }
        }
        Ok(Some(best))
    }

    fn look(
        &self,
        moved: Vec<DVec3>,
        known: &mut KnownSurface,
        exec: &Exec<'_>,
    ) -> Result<Option<FrameAttempt>, Cancelled> {
        let mesh = self.surface.mesh;
        let at = displaced(self.base, self.region, &moved);
        let found = (known.search).find_again(&at, &self.region.faces, most_overlaps(&mesh.triangles), exec)?;
        Ok(found.map(|found| FrameAttempt {
            moved,
            crossings: new_crossings(mesh, found),
            at,
        }))
    }

    /// Makes the displacement that shortens the curves of crossings, while what is no longer needed goes.
    fn shorten_curves(&self, now: &FrameAttempt, rest_bend: &[f64], exec: &Exec<'_>) -> Result<Vec<DVec3>, Cancelled> {
        let finder = ContactFinder {
            mesh: self.surface.mesh,
            region: self.region,
            layers: &LayerSides::default(),
            clearance: 0.0,
            is_posed: true,
            style: CONTOUR_STYLE,
            // Nothing is flattened: no normal is asked for.
            normals: Vec::new(),
            knowledge: Knowledge::default(),
        };
        let conditions = contour_conditions(self.surface.mesh, &now.at, &now.crossings, STEP * self.region.edge);
        let part = |part: f64| now.moved.iter().map(|by| *by * part).collect::<Vec<DVec3>>();
        let (kept, mut by) = (part(1.0 - CONTOUR_BACK), part(CONTOUR_BACK));
        let from = displaced(self.base, self.region, &kept);
        DisplacementProblem::new(&finder, &from, rest_bend).improve(conditions, 1, &mut by, exec)?;
        Ok(kept.iter().zip(&by).map(|(kept, by)| *kept + *by).collect())
    }
}

/// Orthonormal frames of the surface around the free nodes of a region.
struct LocalFrames(Vec<DMat3>);

impl LocalFrames {
    fn of(region: &ContactRegion, faces_of: &Lists, mesh: &Mesh, at: &[DVec3]) -> Self {
        let frame = |k: usize| {
            let v = region.nodes[k];
            let normals = faces_of.of(v).iter().map(|t| {
                let [a, b, c] = mesh.triangles[*t as usize].map(|v| at[v as usize]);
                (b - a).cross(c - a)
            });
            let normal = normals.sum::<DVec3>().normalize_or_zero();
            let beside = region.neighbours[k].first().map_or(v, |w| region.nodes[*w as usize]);
            let along = at[beside as usize] - at[v as usize];
            let along = (along - normal * normal.dot(along)).normalize_or_zero();
            match normal == DVec3::ZERO || along == DVec3::ZERO {
                true => DMat3::IDENTITY,
                false => DMat3::from_cols(along, normal.cross(along), normal),
            }
        };
        Self((0..region.free).map(frame).collect())
    }

    /// The displacement that a frame begins with, after those of two frames before it.
    fn start(&self, region: &ContactRegion, moved: &[Vec<(u32, DVec3)>; 2], goes_on: bool) -> Vec<DVec3> {
        let [mut last, earlier] = [0, 1].map(|k| self.world(region, &moved[k]));
        if goes_on && !moved[1].is_empty() {
            let ahead = |(now, then): (&mut DVec3, &DVec3)| *now += (*now - *then) * AHEAD;
            last.iter_mut().zip(&earlier).for_each(ahead);
        }
        last
    }

    /// What was displaced, by free node.
    fn world(&self, region: &ContactRegion, moved: &[(u32, DVec3)]) -> Vec<DVec3> {
        let mut all = vec![DVec3::ZERO; region.free];
        for (v, by) in moved {
            let k = region.local[*v as usize] as usize;
            if let Some(frame) = self.0.get(k) {
                all[k] = *frame * *by;
            }
        }
        all
    }

    /// The reverse of `world`.
    fn local(&self, region: &ContactRegion, moved: &[DVec3]) -> Vec<(u32, DVec3)> {
        let nodes = region.nodes.iter().zip(&self.0).zip(moved);
        nodes.map(|((v, frame), by)| (*v, frame.transpose() * *by)).collect()
    }
}
