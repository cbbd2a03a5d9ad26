//! Isotropic remeshing of a region: triangles near to equilateral, edges near to a target length.
//!
//! After Botsch and Kobbelt, "A Remeshing Approach to Multiresolution Modeling" (2004). Every point knows where on the
//! original surface it lies, so shape and attributes come from there and nothing drifts. Boundaries, seams, primitive
//! borders and sharp edges are lines: their points slide along them, are added and taken away, but never leave them.
//! The rim of the region and edges with more than two faces stay as they are, so what lies outside does not notice;
//! target lengths approach those of the rim towards it.

mod curves;
mod original;
mod passes;
mod sizing;
mod state;
mod stretched;

use super::editable::{Editable, check_faces, triangle};
use super::{Error, Patch, Surface};
use crate::progress::Progress;
use glam::DVec3;
use state::State;

/// What to aim for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target<'a> {
    /// Edges of this length everywhere.
    Length(f64),
    /// Only around faces with an edge longer than [`STRETCH`] times its rest length, or an aspect over [`ASPECT`]; there
    /// edges as long as they are at rest.
    Auto {
        /// The rest shape: one position per render vertex.
        rest: &'a [DVec3],
    },
}

/// [`Target::Auto`] remeshes where an edge is longer than this times its rest length.
pub const STRETCH: f64 = 1.5;

/// [`Target::Auto`] remeshes where a face is further from equilateral than this: longest side times perimeter over 4·√3
/// times the area, 1 at best.
pub const ASPECT: f64 = 4.0;

/// Faces are mended until none is worse than this, as far as rim and lines allow.
pub const MENDED: f64 = 4.0;

/// Most triangles that a remesh makes.
pub const MOST_TRIANGLES: u64 = 8 << 20;

/// Rounds of split, collapse, flip, smooth.
const ROUNDS: usize = 6;

/// Rounds end when no more than one in so many edges was changed.
const SETTLED: usize = 50;

/// Rounds of mending at the end.
const MENDING: usize = 6;

/// Remeshes `faces`, rising triangle numbers. With [`Target::Auto`] nothing changes where nothing is stretched; a patch
/// that changes nothing comes with the warning `remesh-nothing`. Faces that stay worse than [`MENDED`] are counted in the
/// warning `remesh-aspect`, those that stand against the surface beside them, because it is thinner there than the target
/// length, in `remesh-thin`.
///
/// # Errors
/// [`Error::Invalid`] for a length that is not positive, a rest shape of another size, or no region;
/// [`Error::TooLarge`] when the target is so short that more than [`MOST_TRIANGLES`] would come;
/// [`Error::Cancelled`].
pub fn remesh(surface: &Surface, faces: &[u32], target: Target, progress: &dyn Progress) -> Result<Patch, Error> {
    let invalid = |field: &str, problem: String| Error::Invalid {
        field: field.to_owned(),
        problem,
    };
    check_faces(surface, faces)?;
    let (mesh, wanted) = match target {
        Target::Length(length) => {
            if !(length > 0.0 && length.is_finite()) {
                let problem = format!("{length} is no length, it must be finite and above 0");
                return Err(invalid("remesh.edgeLength", problem));
            }
            let mesh = Editable::gather(surface, faces)?;
            let wanted = vec![length; mesh.points.len()];
            (mesh, wanted)
        }
        Target::Auto { rest } => {
            if rest.len() != surface.positions.len() {
                let (seen, needed) = (rest.len(), surface.positions.len());
                let problem = format!("the rest shape has {seen} vertices, the surface {needed}");
                return Err(invalid("remesh.auto", problem));
            }
            let stretched = stretched::faces(surface, faces, rest);
            if stretched.is_empty() {
                return Ok(nothing());
            }
            let mesh = Editable::gather(surface, &stretched)?;
            let wanted = stretched::rest_lengths(&mesh, rest);
            (mesh, wanted)
        }
    };
    let sizes = sizing::graded(&mesh, &wanted);
    let expected = sizing::estimate(&mesh, &sizes);
    if expected.is_nan() || expected > MOST_TRIANGLES as f64 {
        return Err(Error::TooLarge {
            what: "triangles in the remeshed region",
            seen: if expected < 1e18 { expected as u64 } else { u64::MAX },
            limit: MOST_TRIANGLES,
        });
    }
    let start = mesh.faces.len();
    // Twice what equilateral triangles would be, and the faces that splits and collapses leave behind.
    let most = start + 4 * expected as usize + 4096;
    let mut state = State::new(mesh, sizes);
    for round in 0..ROUNDS {
        progress.report("edit", round as f32 / ROUNDS as f32);
        let edges = 3 * state.mesh.living().count() / 2;
        let split = passes::split_long(&mut state, start + (round + 1) * most, progress)?;
        let collapsed = passes::collapse_short(&mut state, progress)?;
        let flipped = passes::flip(&mut state, progress)?;
        if round > 0 && split + collapsed + flipped == 0 {
            break;
        }
        passes::smooth(&mut state, progress)?;
        if round >= 2 && split + collapsed + flipped < edges / SETTLED {
            break;
        }
    }
    for _ in 0..MENDING {
        if passes::mend(&mut state, MENDED, progress)? == 0 {
            break;
        }
        passes::flip(&mut state, progress)?;
        passes::smooth(&mut state, progress)?;
    }
    state.refresh_sources();
    let warnings: Vec<_> = [
        warning(&state, "remesh-aspect", |state, f| {
            triangle::aspect(state.mesh.corners_of(f)) > MENDED
        }),
        warning(&state, "remesh-thin", State::stands_against),
    ]
    .into_iter()
    .flatten()
    .collect();
    let mut patch = state.mesh.into_patch();
    patch.warnings = warnings;
    if patch.removed.is_empty() && patch.triangles.is_empty() {
        patch.warnings.extend(nothing().warnings);
    }
    Ok(patch)
}

/// Counts faces of which `holds` is true and says where the first one is.
fn warning(state: &State, code: &str, holds: impl Fn(&State, u32) -> bool) -> Option<(String, String, String)> {
    let mut found = state.mesh.living().filter(|&f| holds(state, f));
    let place = state.mesh.corners_of(found.next()?)[0];
    let count = 1 + found.count();
    let message = if code == "remesh-thin" {
        format!("{count} triangles cut across parts of the surface that are thinner than the target length")
    } else {
        format!(
            "{count} triangles stay further than {MENDED} from equilateral: the rim of the region, seams, boundaries or sharp edges hold them"
        )
    };
    Some((code.to_owned(), message, format!("{place}")))
}

fn nothing() -> Patch {
    Patch {
        warnings: vec![(
            "remesh-nothing".to_owned(),
            "no triangle of the region needs remeshing".to_owned(),
            "region".to_owned(),
        )],
        ..Patch::default()
    }
}
