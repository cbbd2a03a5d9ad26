//! Surfaces kept from crossing, in commits and while they move, and warnings of those that a commit could not keep from it.

use super::Deformer;
use super::derived_structures::DerivedStructures;
use super::error::Error;
use super::facts::DeformerWarning;
use super::handle::HandlePoses;
use super::settings::{Contact, HeldBeside, SolveSettings};
use crate::deform::{
    self, ContactMemory, ContactSurface, HandleSystem, MovingSurface, PosePath, PoseRequest, RestCrossings, SolveState,
    Transform,
};
use crate::exec::Exec;
use crate::mesh::PairKind;
use crate::pool::Pool;
use crate::progress::Progress as _;
use glam::DVec3;

/// How often what parts the surfaces of a frame of a drag is improved.
const DRAG_UPDATES: usize = 2;
/// How many pairs of triangles are looked through for those that a warning names,
const MOST_SEEN: usize = 10_000;
/// and how many it names.
const MOST_NAMED: usize = 8;
/// Bytes that parting takes for each vertex: shapes, searches and displacements,
const PARTED_BYTES: u64 = 1024;
/// what is near it,
const CONDITION_BYTES: u64 = 8192;
/// and that at most, of all vertices.
const MOST_CONDITION_BYTES: u64 = 160 << 20;

/// A pose with which surfaces may cross.
pub(super) struct ContactPose<'a> {
    pub derived: &'a DerivedStructures,
    pub handles: &'a HandleSystem,
    pub request: PoseRequest<'a>,
    pub state: &'a mut SolveState,
    pub exec: &'a Exec<'a>,
}

impl ContactPose<'_> {
    /// Moves surfaces apart that the pose pushes through each other, whatever was solved before. `state` keeps its solution.
    ///
    /// # Errors
    /// [`Error::Cancelled`], and those of a solve.
    pub fn part_surfaces(&mut self, contact: Contact, positions: &mut [DVec3]) -> Result<(), Error> {
        let Contact::Avoided { clearance } = contact else {
            return Ok(());
        };
        let (derived, handles, exec) = (self.derived, self.handles, self.exec);
        exec.progress.begin_pass("contact");
        let layers = derived.layer_sides(exec)?;
        let surface = ContactSurface {
            mesh: &derived.mesh,
            held: handles.given(),
            clearance,
            layers: &layers,
            at_rest: RestCrossings::Stay,
        };
        // A part of a pose with targets is not known from its transforms.
        if handles.has_targets() {
            return Ok(surface.part(positions, exec)?);
        }
        let kept = self.state.take_solution();
        let parted = surface.part_on(positions, Some(self), exec);
        self.state.put_back(kept);
        parted
    }
}

impl PosePath for ContactPose<'_> {
    type Error = Error;

    fn shape_at(&mut self, part: f64) -> Result<Vec<DVec3>, Error> {
        let DerivedStructures { mesh, body, thin, .. } = self.derived;
        let transforms: Vec<Transform> = self.request.transforms.iter().map(|t| t.in_part(part)).collect();
        let request = PoseRequest {
            transforms: &transforms,
            ..self.request
        };
        let mut solved = (self.handles).solve(body, &request, self.state, self.exec, &mut |_| true)?;
        thin.settle(
            body,
            self.handles,
            &solved.frames,
            &mut solved.positions,
            self.exec.pool,
        );
        self.exec.progress.begin_pass("contact");
        let shape = solved.positions[..mesh.positions.len()].to_vec();
        self.state.recycle(solved.positions, solved.frames);
        Ok(shape)
    }
}

/// Bytes that parting surfaces takes at most, beside what a deformer of so many solver vertices holds.
pub(super) fn contact_bytes(vertices: usize) -> u64 {
    let vertices = vertices as u64;
    vertices * PARTED_BYTES + (vertices * CONDITION_BYTES).min(MOST_CONDITION_BYTES)
}

/// Moves surfaces apart in a frame of a drag; `state` knows of the one before. What is held `beside` is the caller's.
///
/// # Errors
/// [`Error::TooLarge`] where there is no room for the memory, [`Error::Cancelled`].
pub(super) fn part_drag(
    derived: &DerivedStructures,
    handles: &HandleSystem,
    state: &mut SolveState,
    beside: &HeldBeside<'_>,
    positions: &mut [DVec3],
    pool: &Pool,
) -> Result<(), Error> {
    let surface = MovingSurface {
        mesh: &derived.mesh,
        held: handles.given(),
        updates: DRAG_UPDATES,
    };
    part_moving_surface(&surface, state.contact(), beside, positions, pool).map(drop)
}

/// Moves surfaces apart in a frame that goes on from the one before, of which `memory` knows; returns whether it has. What is held
/// `beside` is the caller's.
///
/// # Errors
/// [`Error::TooLarge`] where there is no room for the memory, [`Error::Cancelled`].
pub(super) fn part_moving_surface(
    surface: &MovingSurface<'_>,
    memory: &mut ContactMemory,
    beside: &HeldBeside<'_>,
    positions: &mut [DVec3],
    pool: &Pool,
) -> Result<bool, Error> {
    beside.begin_pass("contact");
    admit_memory(surface, memory, beside)?;
    Ok(memory.part(surface, positions, &Exec::new(pool, beside))?)
}

/// Refuses the first frame of a surface where there is no room for what it takes.
pub(super) fn admit_memory(
    surface: &MovingSurface<'_>,
    memory: &ContactMemory,
    beside: &HeldBeside<'_>,
) -> Result<(), Error> {
    let bytes = surface.byte_estimate();
    if memory.is_empty() && !beside.may_hold(bytes) {
        return Err(beside.refusal(deform::Error::TooLarge { bytes }));
    }
    Ok(())
}

impl Deformer {
    /// What a user should know of `poses` and of their shape (one position per render vertex), solved with `settings`: as
    /// [`Deformer::pose_warnings`], and which crossings are left where none were wanted.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when `progress` says so.
    pub fn shape_warnings(
        &self,
        positions: &[DVec3],
        poses: &HandlePoses,
        settings: &SolveSettings,
        exec: &Exec<'_>,
    ) -> Result<Vec<DeformerWarning>, Error> {
        let mut warnings = self.pose_warnings(poses);
        warnings.extend(self.contact_warnings(positions, settings, exec)?);
        Ok(warnings)
    }

    fn contact_warnings(
        &self,
        positions: &[DVec3],
        settings: &SolveSettings,
        exec: &Exec<'_>,
    ) -> Result<Vec<DeformerWarning>, Error> {
        if settings.contact == Contact::Ignored {
            return Ok(Vec::new());
        }
        let found = self.crossing_pairs(positions, MOST_SEEN, exec)?;
        let warning = |kind, count, problem: &str| {
            let of_kind = found.pairs.iter().filter(|pair| pair.kind == kind);
            let some: Vec<String> = of_kind
                .take(MOST_NAMED)
                .map(|pair| format!("{} and {}", pair.triangles[0], pair.triangles[1]))
                .collect();
            let place = format!("triangles {}", some.join(", "));
            (count > 0)
                .then(|| DeformerWarning::new("contact-left", format!("{count} pairs of triangles {problem}"), place))
        };
        let left = "cross that did not in the rest pose; contact AVOID found no shape without";
        let held = "cross that handles hold wholly; move the handles apart, or let them hold less";
        let all = [
            warning(PairKind::New, found.new, left),
            warning(PairKind::Held, found.held, held),
        ];
        Ok(all.into_iter().flatten().collect())
    }
}
