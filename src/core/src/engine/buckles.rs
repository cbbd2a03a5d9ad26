//! Fits of rotations in a commit that asks for none, kept from making a commit worse.
//!
//! A fit brings rotations nearer to the shape that was solved with those before it. Where a surface is squeezed (a nape, the inside
//! of an elbow) it may follow a wrinkle, and make it a fold. So the fitted shape is looked at: around faces that are folded onto
//! their neighbours or cross others, what the fits have added is smoothed and the pose is solved again, at first a little way
//! around them, then further wherever that was not enough. At last there is the pose without fits. The shape with the fewest
//! faults of all of these is kept, the earlier one of equals, so the fitted pose stays, bit for bit, where nothing is better.

use super::contact::ContactPose;
use super::derived_structures::DerivedStructures;
use super::error::Error;
use super::handle::{Falloff, FalloffCurve};
use super::resolved_handles::fading_weights;
use super::settings::{Contact, SolveSettings};
use crate::deform::{
    FaceSurroundings, FreeSurface, HandleSystem, LocalRotation, PoseRequest, Quality, SolveState, SolvedNodes,
    SurfaceFaults, TurnChange, TurnChangeKind, VolumeScales, unfold_suspects,
};
use crate::exec::Exec;
use crate::mesh::{Mesh, signed_volume, surface_area};
use glam::DVec3;
use std::sync::OnceLock;

/// How often the pose is solved again with smoother rotations.
const ROUNDS: u8 = 3;
/// How many times further smoothing reaches in a round than in the one before.
const FURTHER: f64 = 3.0;
/// How far around a fault rotations are smoothed in the first round: so many times the model's volume divided by its area, half
/// the thickness of a limb,
const DEPTH: f64 = 2.0;
/// or so many mean edges, if that is more.
const EDGES: f64 = 5.0;
/// Within this part of the way rotations are smoothed wholly.
const WHOLE: f64 = 1.5;
/// How far smoothed rotations are fitted again, where 1 is to the rotation that fits best.
const REACH: f32 = 0.3;

/// What a commit is solved on, for a look at its faults.
pub(super) struct BuckleWatch<'a> {
    derived: &'a DerivedStructures,
    handles: &'a HandleSystem,
    request: PoseRequest<'a>,
    /// Found where they are first asked for. They are not kept, so that what a session takes does not depend on what was solved.
    surroundings: OnceLock<FaceSurroundings>,
    exec: &'a Exec<'a>,
}

/// A shape with its faults and what fits have added to the rotations of the first pass.
struct Candidate {
    solved: SolvedNodes,
    turns: Vec<LocalRotation>,
    faults: SurfaceFaults,
}

/// The pose without fits, which is finished where it is asked for.
struct PlainPose {
    solved: Option<SolvedNodes>,
    /// If it has fewer faults than the best one had then.
    finished: Option<Candidate>,
}

/// By vertex the rounds in which it was part of a fault that was still there, and by node how far the smoothing around such reached.
struct FaultPlaces {
    level: Vec<u8>,
    covered: Vec<u8>,
}

impl<'a> BuckleWatch<'a> {
    /// Watches a pose of handles, by harmonic fields.
    pub fn of(
        derived: &'a DerivedStructures,
        handles: &'a HandleSystem,
        request: PoseRequest<'a>,
        exec: &'a Exec<'a>,
    ) -> Self {
        Self {
            derived,
            handles,
            request,
            surroundings: OnceLock::new(),
            exec,
        }
    }

    /// Brings back what turned over, as in every commit.
    fn unfold(&self, solved: &mut SolvedNodes) {
        self.exec.progress.begin_pass("unfold");
        unfold_suspects(
            &self.derived.mesh,
            &self.surroundings,
            self.handles,
            &mut solved.positions,
            self.exec.pool,
        );
    }

    /// Finishes a commit: what turned over is brought back, fits are kept from making it worse, and surfaces from crossing, as far as
    /// `settings` ask for these.
    ///
    /// # Errors
    /// [`Error::Cancelled`], and those of a solve.
    pub fn finished_commit(
        &self,
        mut solved: SolvedNodes,
        settings: &SolveSettings,
        state: &mut SolveState,
    ) -> Result<SolvedNodes, Error> {
        state.release_start();
        self.unfold(&mut solved);
        if settings.watches_fits() {
            solved = self.unbuckled(solved, state)?;
        }
        self.part_surfaces(settings.contact, state, &mut solved.positions)?;
        Ok(solved)
    }

    /// Moves surfaces apart that the pose pushes through each other, as far as `contact` asks for it.
    ///
    /// # Errors
    /// [`Error::Cancelled`], and those of a solve.
    pub fn part_surfaces(
        &self,
        contact: Contact,
        state: &mut SolveState,
        positions: &mut [DVec3],
    ) -> Result<(), Error> {
        let mut pose = ContactPose {
            derived: self.derived,
            handles: self.handles,
            request: self.request,
            state,
            exec: self.exec,
        };
        pose.part_surfaces(contact, positions)
    }

    /// Returns the fitted pose, which `state` has, or a better one.
    ///
    /// # Errors
    /// [`Error::Cancelled`], and those of a solve.
    fn unbuckled(&self, fitted: SolvedNodes, state: &mut SolveState) -> Result<SolvedNodes, Error> {
        let vertices = self.derived.mesh.positions.len();
        if state.added_turns().len() != self.derived.body.nodes() {
            return Ok(fitted);
        }
        self.exec.progress.begin_pass("faults");
        let given = &self.handles.given()[..vertices];
        let surface = FreeSurface::of(&self.derived.mesh, &self.surroundings, given, self.exec.pool);
        if !surface.is_suspect(&fitted.positions[..vertices], self.exec)? {
            return Ok(fitted);
        }
        let Some(faults) = surface.faults(&fitted.positions[..vertices], self.exec)? else {
            return Ok(fitted);
        };
        let mut best = Candidate {
            faults,
            solved: self.without_needless_frames(fitted),
            turns: state.added_turns().to_vec(),
        };
        let mut plain = self.without_fits(state)?;
        self.let_volume_go(&surface, &mut best, state)?;
        self.smooth_around_faults(&surface, &mut best, &mut plain, state)?;
        let most = best.faults.weight();
        if self
            .weigh(&surface, &mut plain, &best.faults)?
            .is_some_and(|weight| weight < most)
        {
            best = plain.finished.unwrap_or(best);
        }
        state.set_added_turns(best.turns);
        Ok(best.solved)
    }

    /// Where the volume that is given back squeezes the surface until it folds, the pose does without.
    fn let_volume_go(
        &self,
        surface: &FreeSurface<'_>,
        best: &mut Candidate,
        state: &mut SolveState,
    ) -> Result<(), Error> {
        let kept = state.exchange_volume(VolumeScales::default());
        if kept.is_empty() {
            return Ok(());
        }
        let unchanged = TurnChange {
            kind: TurnChangeKind::Smooth,
            turns: &best.turns,
            weights: &vec![0.0; self.derived.body.nodes()],
        };
        let (solved, turns) =
            (self.handles).solve_changed(&self.derived.body, &self.request, &unchanged, state, self.exec)?;
        match self.finished(surface, solved, turns, &best.faults)? {
            Some(free) => *best = free,
            None => drop(state.exchange_volume(kept)),
        }
        Ok(())
    }

    /// The pose of the paper's two passes, as where no fit is asked for.
    fn without_fits(&self, state: &mut SolveState) -> Result<PlainPose, Error> {
        let quality = Quality {
            refine: Some(0),
            ..self.request.quality
        };
        let request = PoseRequest {
            quality,
            ..self.request
        };
        let solved = self
            .handles
            .solve(&self.derived.body, &request, state, self.exec, &mut |_| true)?;
        state.release_start();
        Ok(PlainPose {
            solved: Some(self.without_needless_frames(solved)),
            finished: None,
        })
    }

    /// What the faults of the pose without fits weigh, where that is less than the `best` one's; `best` never gets worse.
    fn weigh(
        &self,
        surface: &FreeSurface<'_>,
        plain: &mut PlainPose,
        best: &SurfaceFaults,
    ) -> Result<Option<usize>, Error> {
        if let Some(solved) = plain.solved.take_if(|_| best.weight() > 0) {
            plain.finished = self.finished(surface, solved, Vec::new(), best)?;
        }
        Ok(plain.finished.as_ref().map(|plain| plain.faults.weight()))
    }

    /// Solves again with rotations smoothed around faults, and keeps the best. Goes on while that helps, and while there are more
    /// faults than without fits.
    fn smooth_around_faults(
        &self,
        surface: &FreeSurface<'_>,
        best: &mut Candidate,
        plain: &mut PlainPose,
        state: &mut SolveState,
    ) -> Result<(), Error> {
        let fits = best.turns.clone();
        let mut places = FaultPlaces {
            level: vec![0; self.derived.mesh.positions.len()],
            covered: vec![0; self.derived.body.nodes()],
        };
        let nearest = self.nearest();
        for _ in 0..ROUNDS {
            let before = best.faults.weight();
            let weights = self.weights_around(&best.faults, nearest, &mut places)?;
            let mut turns = fits.clone();
            for kind in [TurnChangeKind::Smooth, TurnChangeKind::FitPartly(REACH)] {
                let change = TurnChange {
                    kind,
                    turns: &turns,
                    weights: &weights,
                };
                let (solved, changed) =
                    (self.handles).solve_changed(&self.derived.body, &self.request, &change, state, self.exec)?;
                turns.clone_from(&changed);
                if let Some(better) = self.finished(surface, solved, changed, &best.faults)? {
                    *best = better;
                }
                if best.faults.weight() == 0 {
                    return Ok(());
                }
            }
            let now = best.faults.weight();
            if now == before
                && self
                    .weigh(surface, plain, &best.faults)?
                    .is_none_or(|fewest| now <= fewest)
            {
                return Ok(());
            }
        }
        Ok(())
    }

    /// A solved pose with thin faces settled and folds brought back as in every commit, if it has fewer faults than `best`.
    fn finished(
        &self,
        surface: &FreeSurface<'_>,
        mut solved: SolvedNodes,
        turns: Vec<LocalRotation>,
        best: &SurfaceFaults,
    ) -> Result<Option<Candidate>, Error> {
        let SolvedNodes { positions, frames, .. } = &mut solved;
        self.derived
            .thin
            .settle(&self.derived.body, self.handles, frames, positions, self.exec.pool);
        self.unfold(&mut solved);
        self.exec.progress.begin_pass("faults");
        let positions = &solved.positions[..self.derived.mesh.positions.len()];
        let faults = surface.fewer_faults(positions, best, self.exec)?;
        Ok(faults.map(|faults| Candidate {
            solved: self.without_needless_frames(solved),
            turns,
            faults,
        }))
    }

    /// Several shapes are held at a time: where none is shown by its frames, they go.
    fn without_needless_frames(&self, mut solved: SolvedNodes) -> SolvedNodes {
        if self.derived.framed_nodes().is_empty() {
            solved.frames = Vec::new();
        }
        solved
    }

    /// How far smoothing reaches in the first round, model units.
    fn nearest(&self) -> f64 {
        let Mesh {
            positions, triangles, ..
        } = &self.derived.mesh;
        let edge = |t: &[u32; 3]| positions[t[0] as usize].distance(positions[t[1] as usize]);
        let edges = triangles.iter().map(edge).sum::<f64>() / triangles.len().max(1) as f64;
        let depth =
            signed_volume(positions, triangles).abs() / surface_area(positions, triangles).max(f64::MIN_POSITIVE);
        // An open surface may have any volume.
        (DEPTH * depth.min(0.1 * self.derived.body.diagonal)).max(EDGES * edges)
    }

    /// By node how far rotations are smoothed, 0 to 1.
    fn weights_around(
        &self,
        faults: &SurfaceFaults,
        nearest: f64,
        places: &mut FaultPlaces,
    ) -> Result<Vec<f32>, Error> {
        let FaultPlaces { level, covered } = places;
        for &v in faults.faces().flat_map(|t| &self.derived.mesh.triangles[t as usize]) {
            level[v as usize] = level[v as usize].max(covered[v as usize] + 1);
        }
        let mut weights = vec![0.0f32; self.derived.body.nodes()];
        covered.fill(0);
        for round in 1..=ROUNDS {
            let core: Vec<u32> = (0u32..)
                .zip(&*level)
                .filter(|(_, l)| **l == round)
                .map(|(v, _)| v)
                .collect();
            if core.is_empty() {
                continue;
            }
            let falloff = Falloff {
                radius: nearest * libm::pow(FURTHER, f64::from(round - 1)),
                curve: FalloffCurve::Smooth,
            };
            let around = fading_weights(&self.derived.body, &core, falloff, self.exec)?;
            for (node, weight) in core.iter().map(|&v| (v, 1.0)).chain(around) {
                let weight = (WHOLE * weight).min(1.0) as f32;
                weights[node as usize] = weights[node as usize].max(weight);
                covered[node as usize] = round;
            }
        }
        Ok(weights)
    }
}
