//! Surfaces kept from crossing, in commits and while they move, and warnings of those that a commit could not keep from it.

use super::Deformer;
use super::derived_structures::DerivedStructures;
use super::error::Error;
use super::facts::DeformerWarning;
use super::handle::HandlePoses;
use super::settings::{Contact, SolveSettings};
use crate::deform::{ContactSurface, HandleSystem, MovingSurface, RestCrossings, SolveState};
use crate::exec::Exec;
use crate::mesh::PairKind;
use glam::DVec3;

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

/// Moves surfaces apart in a frame that goes on from the one before, of which `state` knows.
///
/// # Errors
/// [`Error::Cancelled`].
pub(super) fn part_moving_surfaces(
    derived: &DerivedStructures,
    handles: &HandleSystem,
    contact: Contact,
    state: &mut SolveState,
    positions: &mut [DVec3],
    exec: &Exec<'_>,
) -> Result<(), Error> {
    if contact == Contact::Ignored {
        state.contact().forget();
        return Ok(());
    }
    exec.progress.begin_pass("contact");
    let surface = MovingSurface {
        mesh: &derived.mesh,
        held: handles.given(),
    };
    Ok(state.contact().part(&surface, positions, exec)?)
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
