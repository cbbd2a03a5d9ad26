//! Surfaces kept from crossing, in commits and while they move, and warnings of those that a commit could not keep from it.

use super::Deformer;
use super::derived_structures::DerivedStructures;
use super::error::Error;
use super::facts::DeformerWarning;
use super::handle::HandlePoses;
use super::settings::{Contact, HeldBeside, SolveSettings};
use crate::deform::{self, ContactMemory, ContactSurface, HandleSystem, MovingSurface, RestCrossings, SolveState};
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

/// Moves surfaces apart that a pose pushes through each other, whatever was solved before.
///
/// # Errors
/// [`Error::Cancelled`].
pub(super) fn part_surfaces(
    derived: &DerivedStructures,
    handles: &HandleSystem,
    contact: Contact,
    positions: &mut [DVec3],
    exec: &Exec<'_>,
) -> Result<(), Error> {
    let Contact::Avoided { clearance } = contact else {
        return Ok(());
    };
    exec.progress.begin_pass("contact");
    let layers = derived.layer_sides(exec)?;
    let surface = ContactSurface {
        mesh: &derived.mesh,
        held: handles.given(),
        clearance,
        layers: &layers,
        at_rest: RestCrossings::Stay,
    };
    Ok(surface.part(positions, exec)?)
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
