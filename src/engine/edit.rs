//! Edits of the topology on a bench: the operation on the surface, then everything that follows from it.
//!
//! An edit works on the current shape or on the rest shape. On the current shape what the user sees becomes the rest shape,
//! and all handles are at rest; on the rest shape poses stay, and the result is solved with them. The bench changes only
//! when everything has succeeded.

use super::carry_handles::{CarriedHandles, carry, runs};
use super::derived_structures::{DerivedStructures, TopologyChange};
use super::edit_operations::{EditContext, plan};
use super::model_topology::EditSurface;
use super::region::{self, ResolvedRegion};
use super::topology_state::{self, TopologyState};
use super::{Deformer, HandlePoses, SolveMode};
use crate::asset::FileSet;
use crate::edit::{EditSubject, EditWarning, ErrorPlace, PatchedSurface, apply_patch};
use crate::exec::Exec;
use crate::graph::{GraphRecipe, GraphStats, MeshGraph};
use crate::wire::check::enumerated;
use crate::wire::{DeformOptions, Error, pb};
use glam::DVec3;
use std::sync::Arc;

/// An edit, and the state that it is to change.
pub struct EditCommand<'a> {
    /// What is to be done.
    pub request: &'a pb::EditRequest,
    /// The current shape, one position per render vertex. Where [`Deformer::remembers`] it, graph and hierarchy can follow
    /// the edit; else they are built from nothing.
    pub shape: &'a Arc<Vec<DVec3>>,
    /// The poses in force.
    pub poses: &'a HandlePoses,
    /// How the current shape was solved; `None` when it is the rest shape. An edit on the rest shape solves it again like this.
    pub settings: Option<&'a DeformOptions>,
    /// For a merge with another session, that session's model in its current shape.
    pub other: Option<FileSet>,
}

/// What an edit came to.
#[derive(Debug, Clone)]
pub struct EditOutcome {
    /// What clients are told; revision and times are the caller's.
    pub result: pb::EditResult,
    /// The handles in force, in the new numbers; already set.
    pub handles: pb::SetHandlesRequest,
    /// Their poses.
    pub poses: HandlePoses,
    /// How the shape was solved, when it is not the rest shape.
    pub solved: Option<DeformOptions>,
    /// The shape after the edit.
    pub positions: Arc<Vec<DVec3>>,
}

impl Deformer {
    /// Carries out an edit. On an error nothing has changed.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the field; [`Error::Precondition`] when the surface does not allow what is asked for;
    /// [`Error::TooLarge`], [`Error::Cancelled`].
    pub fn edit(&mut self, order: &EditCommand<'_>, exec: &Exec<'_>) -> Result<EditOutcome, Error> {
        exec.progress.report("edit", 0.0);
        let request = order.request;
        let at_rest = match enumerated(request.on, "on")? {
            pb::edit_request::On::Current => false,
            pb::edit_request::On::Rest => true,
        };
        if order.shape.len() != self.rest().len() {
            return Err(Error::Internal("the shape of another model".into()));
        }
        let rest = Arc::clone(self.rest());
        let shape = if at_rest { &rest } else { order.shape };
        let mut sheet = self.sheet(shape);
        let points = (!Arc::ptr_eq(shape, &rest)).then(|| sheet.point_positions());
        let mesh = &self.derived.mesh;
        let mut origins = self.derived.foundation().origins(mesh);
        let before = (sheet.positions.len(), self.geometry().triangles.len());
        let mut planned = plan(
            &mut EditContext {
                bench: self,
                sheet: &mut sheet,
                origins: &mut origins,
                shape,
                other: order.other.as_ref(),
            },
            request,
            exec.progress,
        )?;
        exec.check()?;
        planned.patch.idle = std::mem::take(&mut sheet.idle);
        let patch = &planned.patch;
        let applied = apply_patch(&sheet.surface(), patch, &sheet.first_vertices()).map_err(refused)?;
        self.admit_size(&applied)?;
        let carried = self.carried(&applied, &planned, at_rest.then_some(order.poses))?;
        let mut result = pb::EditResult {
            before: Some(counts(before.0, before.1)),
            after: Some(counts(applied.positions.len(), applied.triangles.len())),
            handles_kept: carried.kept.clone(),
            warnings: carried.warnings.clone(),
            kept: runs(&applied, before.0),
            curve: planned.curve(&applied),
            ..Default::default()
        };
        result.warnings.extend(patch.warnings.iter().map(warning));
        if mesh.collapsed_triangles.len() + mesh.duplicate_triangles.len() > 0 {
            let (collapsed, duplicate) = (&mesh.collapsed_triangles, &mesh.duplicate_triangles);
            let message = format!(
                "{} triangles without area and {} that repeat another are left out from now on",
                collapsed.len(),
                duplicate.len()
            );
            result
                .warnings
                .push(warning(&EditWarning::new("triangles-dropped", message, "")));
        }
        let (foundation, applied) = (self.derived.foundation()).edited(&sheet, &origins, applied, patch, planned.parts);
        drop((sheet, origins));
        exec.check()?;
        let nodes = match points {
            None => Some(None),
            Some(points) => self.nodes_of(shape).map(|nodes| Some(with_points(nodes, &points))),
        };
        let change = TopologyChange {
            foundation: Arc::new(foundation),
            applied: &applied,
            follow: nodes.is_some() && applied.old_from_point.len() == applied.points as usize,
            nodes: nodes.flatten(),
            carried: self.restart(&carried),
        };
        let derived = (self.derived).edited(change, &self.choices, &self.limits, exec)?;
        result.repaired = derived.is_followed();
        let mut next = self.on(Arc::new(derived));
        next.set_handles(&carried.request, exec)?;
        let settings = match order.settings {
            Some(settings) => settings.clone(),
            None => DeformOptions::check(&pb::Options::default(), "options", u32::MAX)?,
        };
        let outcome = next.after_edit(carried, result, at_rest.then_some(settings), exec)?;
        *self = next;
        Ok(outcome)
    }

    /// What the fields of carried handles begin from: those that they have, if none was lost.
    fn restart(&self, carried: &CarriedHandles) -> Option<topology_state::KeptHandleFields> {
        let all = carried.kept.len() == self.handles().handles.len();
        let rig = self.rig().filter(|_| all)?;
        Some(topology_state::KeptHandleFields {
            request: carried.request.clone(),
            fields: rig.keep_fields(),
        })
    }

    /// The shape after an edit, and all that is told of it; with `settings` the poses are solved for.
    fn after_edit(
        &mut self,
        carried: CarriedHandles,
        mut result: pb::EditResult,
        settings: Option<DeformOptions>,
        exec: &Exec<'_>,
    ) -> Result<EditOutcome, Error> {
        let poses = self.initial_poses();
        let posed = poses.0.iter().any(is_posed);
        let (positions, solved) = if let Some(settings) = settings.filter(|_| posed) {
            exec.progress.report("solve", 0.0);
            let solved = self.solve(&poses, &settings, SolveMode::Commit, exec, &mut |_| true)?;
            (solved.positions, Some(settings))
        } else {
            (Arc::clone(self.rest()), None)
        };
        result.digest = super::digest(&positions);
        Ok(EditOutcome {
            result,
            handles: carried.request,
            poses,
            solved,
            positions,
        })
    }

    /// The state but for its handles.
    pub fn trail(&self) -> TopologyState {
        TopologyState(Arc::clone(&self.derived.path))
    }

    /// Goes to another state, without handles. On an error nothing has changed.
    ///
    /// # Errors
    /// [`Error::TooLarge`], [`Error::Cancelled`].
    pub fn retrace(&mut self, trail: &TopologyState, exec: &Exec<'_>) -> Result<(), Error> {
        if Arc::ptr_eq(&self.derived.path, &trail.0) {
            return Ok(());
        }
        let derived = match self.kept(&trail.0) {
            Some(derived) => derived,
            None => Arc::new(DerivedStructures::retrace(trail, &self.choices, &self.limits, exec)?),
        };
        *self = self.on(derived);
        Ok(())
    }

    /// The surface in a shape, as an operation reads it.
    fn sheet(&self, shape: &[DVec3]) -> EditSurface {
        let geometry = self.geometry();
        let shading = match geometry.normals.is_empty() {
            true => Default::default(),
            false => super::shading::shading(geometry, self.rest(), shape),
        };
        let tangents = if geometry.tangents.is_empty() {
            Vec::new()
        } else {
            shading.tangents
        };
        EditSurface::new(&self.derived.mesh, geometry, shape, shading.normals, tangents)
    }

    fn admit_size(&self, applied: &PatchedSurface) -> Result<(), Error> {
        let limits = &self.limits.model;
        let sizes = [
            (
                "the number of vertices after the edit",
                applied.positions.len(),
                limits.vertices,
            ),
            (
                "the number of triangles after the edit",
                applied.triangles.len(),
                limits.triangles,
            ),
        ];
        if let Some((what, seen, limit)) = sizes.into_iter().find(|(_, seen, limit)| *seen as u64 > *limit) {
            let seen = seen as u64;
            return Err(Error::TooLarge { what, seen, limit });
        }
        // What grows is expected to need as much for each vertex as what there is.
        let (before, after) = (self.rest().len().max(1) as u64, applied.positions.len() as u64);
        let seen = self.derived.estimate() / before * after;
        if after > before && seen > self.room {
            return Err(Error::TooLarge {
                what: "the estimated memory of the session in bytes",
                seen,
                limit: self.room,
            });
        }
        Ok(())
    }

    /// What the handles in force hold after an edit.
    fn carried(
        &self,
        applied: &PatchedSurface,
        planned: &super::edit_operations::PlannedEdit,
        poses: Option<&HandlePoses>,
    ) -> Result<CarriedHandles, Error> {
        let old = self.handles();
        // Only render vertices are asked for.
        let blank = self.without_nodes();
        let ground = region::RegionContext {
            graph: &blank,
            ..self.ground()
        };
        let mut held: Vec<ResolvedRegion> = Vec::new();
        for (k, handle) in old.handles.iter().enumerate() {
            let field = format!("handles[{k}].region");
            held.push(region::resolve(&ground, handle.region.as_ref(), None, &field)?);
        }
        if let Some(region) = &old.region_of_interest {
            held.push(region::resolve(&ground, Some(region), None, "regionOfInterest")?);
        }
        let poses = poses.map(|p| p.0.as_slice());
        Ok(carry(old, &held, self.centroids(), poses, applied, &planned.patch))
    }

    /// A graph of which regions hold no node.
    fn without_nodes(&self) -> MeshGraph {
        MeshGraph {
            offsets: vec![0],
            neighbours: Vec::new(),
            weights: None,
            positions: Vec::new(),
            surface: self.derived.mesh.positions.len(),
            nearest_surface: Vec::new(),
            component: Vec::new(),
            components: 0,
            stats: GraphStats::default(),
            recipe: GraphRecipe::default(),
        }
    }

    /// The triangles of a region in the shape that is edited, rising: those with at least `corners` corners inside. All of
    /// them without a region.
    pub(super) fn faces(
        &self,
        sheet: &EditSurface,
        shape: &[DVec3],
        region: Option<&pb::Region>,
        corners: usize,
        field: &str,
    ) -> Result<Vec<u32>, Error> {
        if region.is_none() {
            return Ok((0..sheet.triangles.len() as u32).collect());
        }
        let blank = self.without_nodes();
        let current = !std::ptr::eq(shape.as_ptr(), self.rest().as_ptr());
        let ground = region::RegionContext {
            pose: if current { "the current shape" } else { "the rest pose" },
            positions: shape,
            graph: &blank,
            ..self.ground()
        };
        let marks = region::resolve(&ground, region, None, field)?.render;
        let faces: Vec<u32> = (0u32..)
            .zip(&sheet.triangles)
            .filter(|(_, t)| t.iter().filter(|&&v| marks[v as usize]).count() >= corners)
            .map(|(t, _)| t)
            .collect();
        if faces.is_empty() {
            return Err(Error::invalid(
                field,
                "holds no triangle; a triangle is inside when its three corners are",
            ));
        }
        Ok(faces)
    }
}

/// Whether a pose may move anything. A pivot alone does not.
fn is_posed(pose: &pb::HandlePose) -> bool {
    let pivot = Vec::new();
    pb::HandlePose { pivot, ..pose.clone() } != pb::HandlePose::default()
}

/// FollowedNodes with those of the surface where an edit takes them to be.
fn with_points(nodes: &Arc<Vec<DVec3>>, points: &[DVec3]) -> Arc<Vec<DVec3>> {
    if nodes[..points.len()] == *points {
        return Arc::clone(nodes);
    }
    let mut nodes = nodes.as_ref().clone();
    nodes[..points.len()].copy_from_slice(points);
    Arc::new(nodes)
}

fn counts(vertices: usize, faces: usize) -> pb::edit_result::Counts {
    let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    pb::edit_result::Counts {
        vertices: count(vertices),
        faces: count(faces),
    }
}

fn warning(warning: &EditWarning) -> pb::Warning {
    pb::Warning {
        code: warning.code.clone(),
        message: warning.message.clone(),
        r#where: warning.place.clone(),
    }
}

/// What the refusal of an operation means to its caller.
pub(super) fn refused(e: crate::edit::Error) -> Error {
    use crate::edit::Error as Edit;
    match e {
        Edit::Invalid { subject, problem } => Error::invalid(field_of(subject), problem),
        Edit::Impossible {
            problem,
            place: ErrorPlace::Argument(subject),
        } => Error::Precondition(format!("{problem} ({})", field_of(subject))),
        Edit::Impossible { .. } => Error::Precondition(e.to_string()),
        Edit::TooLarge { what, seen, limit } => Error::TooLarge { what, seen, limit },
        Edit::Cancelled => Error::Cancelled,
    }
}

/// The field of a request that an argument of an operation comes from.
fn field_of(subject: EditSubject) -> String {
    let field = match subject {
        EditSubject::CutPlane => "cut.plane",
        EditSubject::CutCurve => "cut.polyline",
        EditSubject::CutPath => "cut.path",
        EditSubject::InsertedCurve => "insertCurve.points",
        EditSubject::DecimationRatio => "decimate.ratio",
        EditSubject::RemeshEdgeLength => "remesh.edgeLength",
        EditSubject::RemeshRestShape => "remesh.auto",
        EditSubject::Region => "region",
        EditSubject::DeletedRegion => "delete.region",
        EditSubject::FilledRegion => "fill.region",
        EditSubject::WeldTolerance => "weld.tolerance",
        EditSubject::BoundaryWeldTolerance => "merge.tolerance",
        EditSubject::Surface | EditSubject::Patch(_) => return subject.to_string(),
    };
    field.to_owned()
}
