//! What a cut does to lines beside the surface, and to splats: what is on the side that goes, goes with it, and a segment that
//! crosses over ends there.

use super::edit_command::{CutLine, Edit};
use super::edit_operations::plan_cut;
use super::error::Error;
use crate::edit::{
    CutOptions, CutPlane, EditWarning, KeptSide, NewVertex, PatchedSurface, SurfacePatch, SurfaceView, apply_patch,
};
use crate::exec::Exec;
use crate::mesh::query::TriangleBvh;
use crate::mesh::{BoundingBox, NONE};
use glam::DVec3;

/// The ends of both parts of a segment that is cut and stays lie by this part of it on their own sides, so that each rides along
/// with the surface there. Lines that follow edits take what is within a millionth for one place.
const PARTED: f64 = 2.5e-7;
/// How much farther, as a share of the box's diagonal, the surface on one side may be than the whole for a place to be on that side.
const ON_PART: f64 = 1e-9;
/// How often what is between both sides is halved: to the last digits of a place.
const HALVINGS: u32 = 48;
/// Segments after which it is asked whether to go on.
const BLOCK: usize = 64;

/// The two sides of a cut.
enum CutSides<'a> {
    /// Of a plane.
    Plane(CutPlane),
    /// Of a curve on the surface: on one side is what is as near to the surface there as to the whole.
    Curve {
        whole: &'a TriangleBvh<'a>,
        part: &'a TriangleBvh<'a>,
        /// 1 where the part is on the left, -1 where it is on the right.
        side: f64,
        tolerance: f64,
    },
}

impl CutSides<'_> {
    /// Where a place is: positive above, negative below.
    fn height(&self, place: DVec3) -> f64 {
        match self {
            Self::Plane(plane) => (plane.normal.dot(place) - plane.offset) / plane.normal.length(),
            Self::Curve {
                whole,
                part,
                side,
                tolerance,
            } => {
                let distance =
                    |surface: &TriangleBvh<'_>| surface.closest_point(place).map_or(f64::MAX, |at| at.distance);
                match distance(part) <= distance(whole) + tolerance {
                    true => *side,
                    false => -side,
                }
            }
        }
    }

    /// How far along a segment between both sides it changes over.
    fn crossing(&self, [from, to]: [DVec3; 2]) -> f64 {
        let heights = [self.height(from), self.height(to)];
        if let Self::Plane(_) = self {
            return heights[0] / (heights[0] - heights[1]);
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            match (self.height(from.lerp(to, middle)) > 0.0) == (heights[0] > 0.0) {
                true => low = middle,
                false => high = middle,
            }
        }
        0.5 * (low + high)
    }
}

/// Cuts lines beside the surface as an edit cuts the surface. Lines between vertices of the surface are cut with it.
/// `seamless` is the surface that the operation was planned on.
///
/// # Errors
/// [`Error::Cancelled`].
pub(super) fn cut_lines(
    patch: &mut SurfacePatch,
    [before, seamless]: [&SurfaceView<'_>; 2],
    segments: &[[u32; 2]],
    edit: &Edit,
    first_vertices: &[u32],
    exec: &Exec<'_>,
) -> Result<(), Error> {
    let Edit::Cut { along, keep, .. } = edit else {
        return Ok(());
    };
    let is_loose = |s: &&[u32; 2]| s[0] != s[1] && s.iter().all(|&v| before.point_of[v as usize] == NONE);
    let segments: Vec<[u32; 2]> = segments.iter().filter(is_loose).copied().collect();
    if segments.is_empty() {
        return Ok(());
    }
    let mut cut = SegmentCut {
        patch,
        before,
        keep: *keep,
        first_vertices,
    };
    if let CutLine::Plane(plane) = along {
        let (normal, point) = plane.unit_normal_and_point();
        let offset = normal.dot(point);
        return cut.run(&segments, &CutSides::Plane(CutPlane { normal, offset }), exec);
    }
    // Parts that the curve is not on stay, whichever side is kept.
    let (kept, side) = match keep {
        KeptSide::Below => (KeptSide::Below, -1.0),
        KeptSide::Above | KeptSide::Both => (KeptSide::Above, 1.0),
    };
    let Some(part) = beside_curve(seamless, along, kept, first_vertices, exec)? else {
        // A curve that parts nothing parts no lines.
        return Ok(());
    };
    let sides = CutSides::Curve {
        whole: &TriangleBvh::build(before.positions, before.triangles, exec.pool),
        part: &TriangleBvh::build(&part.positions, &part.triangles, exec.pool),
        side,
        tolerance: ON_PART * BoundingBox::of(before.positions).diagonal(),
    };
    cut.run(&segments, &sides, exec)
}

/// The surface on one side of a curve; `None` where the curve does not part it.
///
/// # Errors
/// [`Error::Cancelled`].
fn beside_curve(
    seamless: &SurfaceView<'_>,
    along: &CutLine,
    keep: KeptSide,
    first_vertices: &[u32],
    exec: &Exec<'_>,
) -> Result<Option<PatchedSurface>, Error> {
    let options = CutOptions {
        keep,
        ..CutOptions::default()
    };
    let parted =
        plan_cut(seamless, along, &options, exec).and_then(|patch| Ok(apply_patch(seamless, &patch, first_vertices)?));
    match parted {
        Err(Error::Cancelled) => Err(Error::Cancelled),
        other => Ok(other.ok()),
    }
}

/// What of some loose segments goes, and the vertices where those that cross over end.
struct SegmentCut<'a> {
    patch: &'a mut SurfacePatch,
    before: &'a SurfaceView<'a>,
    keep: KeptSide,
    first_vertices: &'a [u32],
}

impl SegmentCut<'_> {
    fn run(&mut self, segments: &[[u32; 2]], sides: &CutSides<'_>, exec: &Exec<'_>) -> Result<(), Error> {
        let keep = self.keep;
        let goes = |height: f64| match keep {
            KeptSide::Both => false,
            KeptSide::Above => height < 0.0,
            KeptSide::Below => height > 0.0,
        };
        let (mut gone, mut count) = (Vec::new(), 0);
        for (k, &[a, b]) in segments.iter().enumerate() {
            if k.is_multiple_of(BLOCK) {
                exec.check()?;
            }
            let places = [a, b].map(|v| self.before.positions[v as usize]);
            let heights = places.map(|place| sides.height(place));
            let ends = [a, b].into_iter().zip(heights);
            gone.extend(ends.filter(|end| goes(end.1)).map(|end| end.0));
            count += usize::from(heights.into_iter().all(goes));
            if heights[0] * heights[1] >= 0.0 {
                continue;
            }
            let at = sides.crossing(places);
            match keep {
                KeptSide::Both => {
                    self.end([a, b], (at - PARTED).max(0.5 * at));
                    self.end([a, b], (at + PARTED).min(0.5 * (1.0 + at)));
                }
                KeptSide::Above | KeptSide::Below => self.end([a, b], at),
            }
        }
        gone.sort_unstable();
        gone.dedup();
        if count > 0 {
            let segments = if count == 1 { "segment" } else { "segments" };
            let message = format!("{count} {segments} of lines were beyond the cut, and went with what was cut off");
            self.patch.warnings.push(EditWarning::new("lines-cut", message, ""));
        }
        self.patch.idle.extend(gone);
        self.patch.idle.sort_unstable();
        self.patch.idle.dedup();
        Ok(())
    }

    /// Ends a segment at a part of it.
    fn end(&mut self, [a, b]: [u32; 2], at: f64) {
        let positions = self.before.positions;
        self.patch.vertices.push(NewVertex {
            primitive: self.first_vertices.partition_point(|&first| first <= a) as u32 - 1,
            point: NONE,
            position: positions[a as usize].lerp(positions[b as usize], at),
            of: [a, b, a],
            weights: [1.0 - at, at, 0.0],
        });
    }
}
