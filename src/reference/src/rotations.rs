//! Orientation diffusion (paper equation 2): a field of unit quaternions in which each is the mean of its neighbours'.
//!
//! In the steady state q_i is parallel to Σ w_ij q_j: a discrete harmonic map into the unit sphere. Local relaxation is
//! too slow on real meshes. So the iteration starts from the blend by harmonic fields, which is exact where all turns
//! share one axis, and each step is global: with the tangential part r_i of Σ w (q_j − q_i), L c = r is solved on the
//! graph's hierarchy, and q_i becomes (q_i + c_i) / |q_i + c_i|. A step that does not lower Σ w |q_i − q_j|² is
//! discarded. Signs are those of the blend: each handle has one, the same wherever its field is not 0.
//!
//! Linear frames (Lipman et al. 2005), for comparison with the paper's first pass (its figure 2).
//!
//! The frames B_i change along every edge as the rest frames do: they minimise Σ w ‖B_j − (I + Γ_ij) B_i‖² with the
//! handles' frames given. Written as B_i = M_i B_i⁰ this is Σ w ‖M_j − M_i‖², so each of the nine entries of M is
//! harmonic between the handles' rotations. The bounded fields u_k span the harmonic functions between the same
//! handles, hence M_i = Σ_k u_k(i) R_k, without a solve. M is not a rotation: half-way through a turn by θ it shrinks
//! to cos(θ/2) across the axis. The nearest rotation replaces it.

use glam::{DQuat, DVec4};
use pliant_deform::{
    DeformableBody, Error, HandleSystem, LocalRotation, PoseBlend, Transform, UNHELD, fade, pack_rotation,
};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_mesh::rotation::fit_rotation;
use pliant_solver::{Constraints, InitialGuess, SolveControl, SolveOptions, Workspace};
use std::f64::consts::{PI, TAU};

/// Most steps; each brings the error down to about (θ / 2π)² of what it was for turns by θ.
const STEPS: usize = 8;
/// Largest change of a quaternion that is not worth another step: about a hundredth of a degree.
const SETTLED: f64 = 1e-4;
/// Relative residual of a step's correction.
const STEP_TOLERANCE: f64 = 1e-2;
/// Most solver iterations of a step.
const STEP_ITERATIONS: usize = 20;
/// Longest correction of a unit quaternion in one step.
const LONGEST: f64 = 0.5;

/// Up to the first angle between handles the steady state is taken whole, from the second on not at all.
const WINDS: [f64; 2] = [1.5 * PI, TAU];

/// The rotations of all nodes by orientation diffusion; `None` where nothing is turned.
///
/// # Errors
/// [`Error::Solver`], [`Error::Cancelled`].
pub fn diffuse(
    body: &DeformableBody,
    handles: &HandleSystem,
    transforms: &[Transform],
    exec: &Exec<'_>,
) -> Result<Option<Vec<LocalRotation>>, Error> {
    exec.progress.begin_pass("blend");
    let blend = &PoseBlend::new(body, handles, transforms, None);
    if blend.is_unturned() {
        return Ok(None);
    }
    let nodes = body.nodes();
    let begun: Vec<DVec4> = exec
        .pool
        .map(nodes, 1024, |i| blend.rotation(i).unwrap_or(DQuat::IDENTITY).into());
    // Beyond a full turn there is a shorter way round the sphere, and descent would find it.
    let kept = fade(blend.reach(), WINDS);
    if kept == 1.0 {
        return Ok(Some(
            exec.pool
                .map(nodes, 1024, |i| pack_rotation(DQuat::from_vec4(begun[i]))),
        ));
    }
    let mut q = begun.clone();
    relax(body, handles, blend, &mut q, exec)?;
    Ok(Some(exec.pool.map(nodes, 1024, |i| {
        let between = begun[i] * kept + q[i] * (1.0 - kept);
        pack_rotation(DQuat::from_vec4(between.try_normalize().unwrap_or(begun[i])))
    })))
}

fn relax(
    body: &DeformableBody,
    handles: &HandleSystem,
    blend: &PoseBlend<'_>,
    q: &mut Vec<DVec4>,
    exec: &Exec<'_>,
) -> Result<(), Error> {
    let nodes = body.nodes();
    let diffusion = OrientationDiffusion::new(body, handles, blend);
    let own;
    let (rotation, position) = (handles.rotation_owners(), handles.position_owners());
    let system = match rotation.hard == position.hard && rotation.soft == position.soft {
        true => handles.position_system(),
        false => {
            let fixed: Vec<bool> = (0..nodes).map(|i| !diffusion.is_open(i)).collect();
            let stiffness = rotation.stiffness();
            let constraints = Constraints {
                fixed: &fixed,
                stiffness: stiffness.as_deref(),
            };
            own = body.hierarchy.constrain(&constraints, exec.pool)?;
            &own
        }
    };
    let options = SolveOptions {
        start: InitialGuess::FullMultigrid {
            frames: None,
            rest: None,
        },
        tolerance: Some(STEP_TOLERANCE),
        max_iterations: STEP_ITERATIONS,
        ..Default::default()
    };
    let mut workspace = Workspace::default();
    let mut energy = diffusion.energy(q, exec.pool);
    for _ in 0..STEPS {
        exec.check()?;
        let rhs: Vec<f64> = exec
            .pool
            .map(nodes, 1024, |i| diffusion.residual(i, q).to_array())
            .into_flattened();
        let mut step = vec![0.0; nodes * 4];
        system
            .equations(&body.hierarchy, 4, &rhs)
            .solve(&mut step, &options, &mut workspace, exec, &mut |_| {
                SolveControl::Continue
            })?;
        let step: &[[f64; 4]] = step.as_chunks().0;
        let next = exec.pool.map(nodes, 1024, |i| match diffusion.is_open(i) {
            true => (q[i] + DVec4::from_array(step[i]).clamp_length_max(LONGEST)).normalize(),
            false => q[i],
        });
        let after = diffusion.energy(&next, exec.pool);
        let lower = after < energy;
        if !lower {
            break;
        }
        energy = after;
        let change = q
            .iter()
            .zip(&next)
            .map(|(a, b)| a.distance_squared(*b))
            .fold(0.0, f64::max);
        *q = next;
        if change < SETTLED * SETTLED {
            break;
        }
    }
    Ok(())
}

/// What quaternions are pulled to: their neighbours', and those of soft handles.
struct OrientationDiffusion<'a> {
    body: &'a DeformableBody,
    handles: &'a HandleSystem,
    blend: &'a PoseBlend<'a>,
    /// Where each node's soft pulls begin in the list; empty without any.
    soft: Vec<u32>,
    /// By hold.
    held: Vec<DVec4>,
}

impl<'a> OrientationDiffusion<'a> {
    fn new(body: &'a DeformableBody, handles: &'a HandleSystem, blend: &'a PoseBlend<'a>) -> Self {
        Self {
            body,
            handles,
            blend,
            soft: handles.rotation_owners().first_pulls(),
            held: (0..=handles.handle_count())
                .map(|k| blend.held_rotation(k).into())
                .collect(),
        }
    }

    /// Whether a node's rotation is open: some handle has a say in it, and none decides it.
    fn is_open(&self, node: usize) -> bool {
        self.handles.rotation_owners().hard[node] == UNHELD && self.blend.is_covered(node)
    }

    /// Soft pulls on a node: (stiffness, quaternion).
    fn pulls(&self, node: usize) -> impl Iterator<Item = (f64, DVec4)> + '_ {
        let range = match self.soft.is_empty() {
            true => 0..0,
            false => self.soft[node] as usize..self.soft[node + 1] as usize,
        };
        self.handles.rotation_owners().soft[range]
            .iter()
            .map(|&(_, k, stiffness)| (stiffness, self.held[k as usize]))
    }

    /// The tangential part of Σ w (q_j − q_i); 0 on nodes that are not open.
    fn residual(&self, i: usize, q: &[DVec4]) -> DVec4 {
        if !self.is_open(i) {
            return DVec4::ZERO;
        }
        let neighbours = self.body.edges(i).map(|(j, w)| (w, q[j]));
        let sum: DVec4 = neighbours.chain(self.pulls(i)).map(|(w, other)| other * w).sum();
        sum - q[i] * q[i].dot(sum)
    }

    /// ½ Σ w |q_i − q_j|² over edges and pulls, summed in an order that does not depend on threads.
    fn energy(&self, q: &[DVec4], pool: &Pool) -> f64 {
        const BLOCK: usize = 1024;
        let of_node = |i: usize| {
            let edges = self.body.edges(i).filter(|&(j, _)| j < i);
            let edges: f64 = edges.map(|(j, w)| w * q[i].distance_squared(q[j])).sum();
            match self.is_open(i) {
                true => {
                    edges
                        + self
                            .pulls(i)
                            .map(|(s, held)| s * q[i].distance_squared(held))
                            .sum::<f64>()
                }
                false => edges,
            }
        };
        let nodes = self.body.nodes();
        let of_block = |b: usize| (b * BLOCK..nodes.min((b + 1) * BLOCK)).map(of_node).sum();
        let blocks: Vec<f64> = pool.map(nodes.div_ceil(BLOCK), 1, of_block);
        0.5 * blocks.iter().sum::<f64>()
    }
}

/// The rotations of all nodes by linear frames; `None` where nothing is turned.
pub fn linear_frames(
    body: &DeformableBody,
    handles: &HandleSystem,
    transforms: &[Transform],
    pool: &Pool,
) -> Option<Vec<LocalRotation>> {
    let blend = PoseBlend::new(body, handles, transforms, None);
    let rotation = |i| pack_rotation(blend.matrix(i).map_or(DQuat::IDENTITY, fit_rotation));
    (!blend.is_unturned()).then(|| pool.map(body.nodes(), 1024, rotation))
}
