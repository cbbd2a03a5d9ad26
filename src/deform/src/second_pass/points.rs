//! Points of the surface that holds pull, solved for again and again until nothing moves.
//!
//! Each solve goes as far as the majorization of the points lets it ([`PulledPoint`](crate::handles::PulledPoint)), and goes on from
//! beyond where the last one ended, as far as it came from the one before (Nesterov's acceleration), or from the end itself where that was
//! the wrong way.
//!
//! Points that are wanted in a plane may slide along it, and the stiffer they are, the less of that a majorization allows. So what a solve
//! has left is solved for by conjugate gradients, whose preconditioner is the sum of two solves: one with the whole stiffness, for what
//! moves across the planes, and one with next to none, of what lies in them.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::handles::pulled_points::PulledPoint;
use crate::handles::system::{ConstrainedSystem, HandleSystem};
use crate::pose::SolveStart;
use crate::second_pass::equations::PosedHandles;
use crate::second_pass::refine::RotationFit;
use crate::second_pass::state::SolveState;
use crate::solve::{PoseSolve, SolveTally};
use glam::DVec3;
use pliant_exec::pool::Pool;
use pliant_exec::progress::check;
use pliant_solver::{InitialGuess, SolveControl, SolveOptions, SolveStats};

/// Solves at most.
const MOST: u32 = 60;
/// A solve that moves no node by more than this part of the diagonal is the last one.
const ENOUGH: f64 = 2e-6;
/// Conjugate gradients after each at most.
const SLIDES: usize = 4;
/// What part of the stiffness the planes of points keep along them in the second solve of the preconditioner, which else nothing might
/// hold.
const HELD: f64 = 1e-3;

/// The half of the preconditioner for what lies in the planes of points.
struct SlidingSolve {
    system: ConstrainedSystem,
    /// By node: across its plane, of unit length; zero where it has none.
    normals: Vec<DVec3>,
}

impl SlidingSolve {
    /// `None` where no point is wanted in a plane.
    fn of(body: &DeformableBody, handles: &HandleSystem, pool: &Pool) -> Result<Option<Self>, Error> {
        let points = handles.places.points().iter();
        let mut planes = points
            .filter(|p| p.normal != DVec3::ZERO && p.tangential > 0.0)
            .peekable();
        if planes.peek().is_none() {
            return Ok(None);
        }
        let mut stiffness = handles.stiffness().unwrap_or_else(|| vec![0.0; body.nodes()]);
        let mut normals = vec![DVec3::ZERO; body.nodes()];
        for PulledPoint {
            nodes,
            corners,
            weight,
            normal,
            tangential,
            ..
        } in planes
        {
            for (node, corner) in nodes.map(|n| n as usize).into_iter().zip(*corners) {
                let share = weight * corner;
                stiffness[node] -= (1.0 - HELD) * tangential * share;
                normals[node] += *normal * share;
            }
        }
        stiffness.iter_mut().for_each(|s| *s = s.max(0.0));
        normals.iter_mut().for_each(|n| *n = n.normalize_or_zero());
        let system = ConstrainedSystem::of(body, handles.positions.fixed.clone(), Some(&stiffness), pool)?;
        Ok(Some(Self { system, normals }))
    }

    /// Takes out of each vector what it has across the plane of its node.
    fn project(&self, vectors: &mut [f64]) {
        for (vector, normal) in vectors.as_chunks_mut::<3>().0.iter_mut().zip(&self.normals) {
            let all = DVec3::from_array(*vector);
            *vector = (all - *normal * normal.dot(all)).to_array();
        }
    }
}

impl PoseSolve<'_> {
    /// Solves a shape that is to last on, until points of the surface are where their holds want them. A pose of a drag has one solve,
    /// and comes nearer with the poses that follow.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`].
    pub(crate) fn settle_points(
        &self,
        fit: Option<&RotationFit<'_>>,
        posed: &mut PosedHandles,
        state: &mut SolveState,
        tally: &mut SolveTally<'_>,
    ) -> Result<Option<SolveStats>, Error> {
        if self.request.start == SolveStart::Warm {
            return Ok(None);
        }
        let pool = self.exec.pool;
        let sliding = SlidingSolve::of(self.body, self.handles, pool)?;
        let mut turns = fit.map(|fit| fit.resume(&state.extra, pool));
        let mut before = state.x.clone();
        let (mut stats, mut run) = (None, 0u32);
        let enough = ENOUGH * self.body.diagonal / self.body.unit;
        for _ in 0..MOST {
            check(self.exec.progress)?;
            if tally.stopped {
                break;
            }
            let beyond = f64::from(run) / f64::from(run + 3);
            let start: Vec<f64> = (state.x.iter().zip(&before))
                .map(|(now, before)| now + beyond * (now - before))
                .collect();
            before = std::mem::replace(&mut state.x, start.clone());
            if let Some((fit, turns)) = fit.zip(turns.as_mut()) {
                *turns = fit.step(turns, &state.x, pool);
                posed.frames = fit.frames(turns, pool);
            }
            self.assemble(posed, state);
            stats = Some(self.run(&self.handles.positions, InitialGuess::Given, 0.0, state, tally)?);
            if let Some(sliding) = &sliding {
                self.slide(sliding, enough, posed, state)?;
            }
            let (mut most, mut way) = (0.0f64, 0.0);
            for ((now, start), before) in state.x.iter().zip(&start).zip(&before) {
                most = most.max((now - before).abs());
                way += (start - now) * (now - before);
            }
            if most <= enough {
                break;
            }
            run = if way > 0.0 { 0 } else { run + 1 };
        }
        if let Some((fit, turns)) = fit.zip(turns.as_ref()) {
            state.extra = fit.extra(turns, pool);
        }
        Ok(stats)
    }

    /// What the equations lack at the place of `state.x`, in which points pull as they are.
    fn lack(&self, posed: &mut PosedHandles, state: &mut SolveState) -> Result<Vec<f64>, Error> {
        self.assemble(posed, state);
        let mut lack = vec![0.0; state.x.len()];
        let equations = self
            .handles
            .positions
            .system
            .equations(&self.body.hierarchy, 3, &state.rhs);
        equations.residual(&state.x, Some(&mut lack), self.exec.pool)?;
        Ok(lack)
    }

    /// About what it takes to make up for `lack`, by one iteration of both solves.
    fn preconditioned(&self, sliding: &SlidingSolve, lack: &[f64], state: &mut SolveState) -> Result<Vec<f64>, Error> {
        let options = SolveOptions {
            start: InitialGuess::Zero,
            tolerance: None,
            max_error: Some(f64::MAX),
            max_iterations: 1,
        };
        let mut once = |constrained: &ConstrainedSystem, rhs: &[f64]| -> Result<Vec<f64>, Error> {
            let mut way = vec![0.0; rhs.len()];
            let equations = constrained.system.equations(&self.body.hierarchy, 3, rhs);
            equations.solve(&mut way, &options, &mut state.workspace, self.exec, &mut |_| {
                SolveControl::Continue
            })?;
            Ok(way)
        };
        let mut way = once(&self.handles.positions, lack)?;
        let mut along = lack.to_vec();
        sliding.project(&mut along);
        let mut along = once(&sliding.system, &along)?;
        sliding.project(&mut along);
        add_to(&mut way, &along, 1.0);
        Ok(way)
    }

    /// Solves for `state.x` by conjugate gradients, until no node is about more than `enough` from where it should be.
    fn slide(
        &self,
        sliding: &SlidingSolve,
        enough: f64,
        posed: &mut PosedHandles,
        state: &mut SolveState,
    ) -> Result<(), Error> {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut lack = self.lack(posed, state)?;
        let mut last: Option<(Vec<f64>, f64)> = None;
        let mut before = vec![0.0; lack.len()];
        for _ in 0..SLIDES {
            check(self.exec.progress)?;
            let way = self.preconditioned(sliding, &lack, state)?;
            if way.iter().all(|w| w.abs() <= enough) {
                break;
            }
            let gain = dot(&way, &lack);
            // Polak and Ribière: the preconditioner is not quite the same each time.
            let beyond = last
                .as_ref()
                .map_or(0.0, |(_, gained)| ((gain - dot(&way, &before)) / gained).max(0.0));
            let mut step = way;
            if let Some((last, _)) = &last {
                add_to(&mut step, last, beyond);
            }
            let here = state.x.clone();
            add_to(&mut state.x, &step, 1.0);
            let there = self.lack(posed, state)?;
            let downhill = dot(&step, &lack);
            let curvature = downhill - dot(&step, &there);
            let length = downhill / curvature;
            state.x = here;
            if !(curvature > 0.0 && length.is_finite()) {
                break;
            }
            add_to(&mut state.x, &step, length);
            before.copy_from_slice(&lack);
            lack.iter_mut()
                .zip(&there)
                .for_each(|(lack, there)| *lack += length * (there - *lack));
            last = Some((step, gain));
        }
        Ok(())
    }
}

/// Adds a multiple of a vector to another.
fn add_to(sum: &mut [f64], vector: &[f64], by: f64) {
    sum.iter_mut().zip(vector).for_each(|(sum, v)| *sum += by * v);
}
