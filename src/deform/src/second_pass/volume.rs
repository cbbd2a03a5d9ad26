//! Volume that a twist or a pull would lose, given back.
//!
//! A twist shears the sections of a bar, and the shape whose edges come closest to the turned ones is thinner: a round bar of
//! radius r, twisted by θ' a unit of length, loses about θ'² r² / 2 of its volume. How much is measured where the harmonic field of
//! what moves alike has one value, which is a section of what bends; given back it is as a scale of the local frames there. Gains and
//! losses cancel across a section of a bend, so that a bend stays as it is.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::pose::FitOrder;
use crate::second_pass::equations::PosedHandles;
use crate::second_pass::refine::RotationFit;
use crate::second_pass::state::SolveState;
use crate::solve::{PoseSolve, SolveTally};
use crate::volume_scales::{AlikeHolds, SECTIONS, VolumeScales, section};
use glam::{DMat3, DVec3};
use pliant_exec::progress::check;
use pliant_solver::{InitialGuess, SolveStats};

/// The power of what is left of the volume that frames are scaled with, negative: ⅓ gives all back where all directions are free
/// to grow, ½ where handles hold the length, as in a twist.
const GIVEN_BACK: f64 = 0.4;
/// The logarithm of the largest scale.
const MOST: f64 = 0.3;
/// Smaller logarithms of scales are not worth a solve: about 0.1 % of the volume.
const LEAST: f64 = 5e-4;
/// Volumes of nodes are summed in so many pieces, whatever the number of threads.
const PIECES: usize = 16;
/// Nodes whose neighbours lie nearly in a plane have no volume: their edges' second moments have a determinant below this part of what
/// it is for edges all round.
const FLAT: f64 = 0.01;
/// What one node's volume counts for at most, and at least.
const VOLUME_RATIO: std::ops::RangeInclusive<f64> = 0.1..=4.0;

/// Sums over nodes at the sections of a field: their weights, and these times their volumes relative to the wanted ones.
#[derive(Clone, Copy)]
struct SectionVolumes {
    weight: [f64; SECTIONS],
    volume: [f64; SECTIONS],
}

impl PoseSolve<'_> {
    /// Whether volume is kept: where rotations are fitted to a pose of its own that scales nothing, and there is an inside
    /// to measure.
    pub(crate) fn keeps_volume(&self) -> bool {
        let request = self.request;
        request.quality.keeps_volume
            && request.steps() > 0
            && request.fits != FitOrder::Carried
            && !self.request.transforms.iter().any(|t| t.log_scale != DMat3::ZERO)
            && !self.inside().is_empty()
    }

    /// Nodes of the inside.
    fn inside(&self) -> std::ops::Range<usize> {
        self.body.graph.surface..self.body.nodes()
    }

    /// Solves on from the fitted solution in `state` with the scales that keep the volume; `state.volume` has them afterwards.
    /// `None` where next to nothing is lost.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`].
    pub(crate) fn keep_volume(
        &self,
        fit: &RotationFit<'_>,
        posed: &mut PosedHandles,
        state: &mut SolveState,
        tally: &mut SolveTally<'_>,
    ) -> Result<Option<SolveStats>, Error> {
        check(self.exec.progress)?;
        let (handles, pool) = (self.handles, self.exec.pool);
        let mut largest = 0.0f64;
        let mut scales_of = |sums: &SectionVolumes| {
            let mut scales = [0.0; SECTIONS];
            // What is held keeps its size, so that scales begin and end with none.
            for s in 1..SECTIONS - 1 {
                if sums.weight[s] > 0.0 {
                    scales[s] = (-GIVEN_BACK * libm::log(sums.volume[s] / sums.weight[s])).clamp(-MOST, MOST);
                    largest = largest.max(scales[s].abs());
                }
            }
            scales
        };
        let groups = AlikeHolds::groups(self.request.transforms, handles.rotation_fields.holds());
        let volumes = self.section_volumes(&groups, fit, &state.x);
        let scales = volumes.iter().map(&mut scales_of).collect();
        if largest < LEAST || tally.stopped {
            return Ok(None);
        }
        state.volume = VolumeScales::new(groups, scales);
        (state.volume).apply(&handles.rotation_fields, &mut posed.frames, pool, |node| {
            fit.is_open(node)
        });
        self.assemble(posed, state);
        self.run(&handles.positions, InitialGuess::Given, 0.0, state, tally)
            .map(Some)
    }

    /// By group of holds, the volume at the sections of its field in a solution (solving coordinates, three numbers a node).
    fn section_volumes(&self, groups: &AlikeHolds, fit: &RotationFit<'_>, x: &[f64]) -> Vec<SectionVolumes> {
        let inside = self.inside();
        let fields = &self.handles.rotation_fields;
        let length = inside.len().div_ceil(PIECES);
        let nothing = SectionVolumes {
            weight: [0.0; SECTIONS],
            volume: [0.0; SECTIONS],
        };
        let pieces = self.exec.pool.map(PIECES, 1, |piece| {
            let (mut sums, mut scratch) = (vec![nothing; groups.count()], Vec::new());
            let first = inside.start + piece * length;
            for node in (first..(first + length).min(inside.end)).filter(|&node| fit.is_open(node)) {
                let Some(ratio) = volume_ratio(self.body, fit.wanted_volume(node), node, x) else {
                    continue;
                };
                groups.each_share(fields, node, &mut scratch, |group, u| {
                    let (sum, (below, part)) = (&mut sums[group], section(u));
                    for (s, part) in [(below, 1.0 - part), (below + 1, part)] {
                        sum.weight[s] += f64::from(u) * part;
                        sum.volume[s] += f64::from(u) * part * ratio;
                    }
                });
            }
            sums
        });
        let mut all = vec![nothing; groups.count()];
        for piece in &pieces {
            for (sum, own) in all.iter_mut().zip(piece) {
                (0..SECTIONS).for_each(|s| {
                    sum.weight[s] += own.weight[s];
                    sum.volume[s] += own.volume[s];
                });
            }
        }
        all
    }
}

/// What the volume around a node is of the `wanted` one: the determinant of the linear map that comes closest to what its edges do.
/// `None` where they lie nearly in a plane.
fn volume_ratio(body: &DeformableBody, wanted: f64, node: usize, x: &[f64]) -> Option<f64> {
    let at = |j: usize| DVec3::new(x[3 * j], x[3 * j + 1], x[3 * j + 2]);
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    let (mut now, mut rest) = (DMat3::ZERO, DMat3::ZERO);
    for (j, w) in body.edges(node) {
        let edge = body.rest(node) - body.rest(j);
        now += outer((at(node) - at(j)) * w, edge);
        rest += outer(edge * w, edge);
    }
    let third = (rest.x_axis.x + rest.y_axis.y + rest.z_axis.z) / 3.0;
    let size = rest.determinant();
    let ratio = now.determinant() / (size * wanted);
    (size > FLAT * third * third * third && ratio.is_finite())
        .then(|| ratio.clamp(*VOLUME_RATIO.start(), *VOLUME_RATIO.end()))
}
