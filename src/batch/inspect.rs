//! Reports what a model is and what the solver would use of it, without solving.

use super::contents::{ModelContents, contents_of};
use crate::asset::{FileSet, ModelNode};
use crate::engine::{Deformer, DeformerLimits};
use crate::exec::Exec;
use crate::mesh::MeshReport;
use crate::wire::{Error, open_options, pb, session_message};

/// How many nodes an inspection lists.
pub const MOST_NODES_TOLD: usize = 1000;

fn node_message((index, node): (u32, &ModelNode)) -> pb::ModelNode {
    pb::ModelNode {
        index,
        name: node.name.clone(),
        joint: node.is_joint,
        position: node.world_from_node.translation.to_array().to_vec(),
    }
}

/// Reads a model and reports what the solver would use, without solving.
///
/// # Errors
/// As [`Deformer::open`].
pub fn inspect(
    files: FileSet,
    create: &pb::CreateOptions,
    limits: &DeformerLimits,
    exec: &Exec<'_>,
) -> Result<pb::Inspection, Error> {
    Ok(inspect_contents(files, create, limits, exec)?.0)
}

/// As [`inspect`], and what the file holds beside its mesh, where its format has such things.
///
/// # Errors
/// As [`Deformer::open`].
pub fn inspect_contents(
    files: FileSet,
    create: &pb::CreateOptions,
    limits: &DeformerLimits,
    exec: &Exec<'_>,
) -> Result<(pb::Inspection, Option<ModelContents>), Error> {
    let bench = Deformer::open(files, &open_options(create)?, limits, exec)?;
    let facts = session_message(&bench.facts());
    let report: &MeshReport = bench.report();
    let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    let nodes = bench.model().nodes()?.unwrap_or_default();
    let renders = report.render_vertices - report.unreferenced_vertices;
    let inspection = pb::Inspection {
        components: count(report.parts.len()),
        boundary_loops: count(report.boundary_loops.len()),
        non_manifold_edges: count(report.non_manifold_edges),
        non_manifold_vertices: count(report.non_manifold_vertices),
        seam_vertices: count(renders.min(report.coincident_vertices)),
        closed: report.closed,
        box_min: report.bounds.min.to_array().to_vec(),
        box_max: report.bounds.max.to_array().to_vec(),
        area: report.area,
        volume: if report.closed { report.volume } else { 0.0 },
        memory_estimate: bench.estimate(),
        degenerate_faces: count(report.degenerate_triangles),
        duplicate_faces: count(report.duplicate_triangles),
        unreferenced_vertices: count(report.unreferenced_vertices),
        model: facts.model,
        primitives: facts.primitives,
        solver: facts.solver,
        warnings: facts.warnings,
        node_count: count(nodes.len()),
        nodes: (0..).zip(&nodes).take(MOST_NODES_TOLD).map(node_message).collect(),
    };
    Ok((inspection, contents_of(bench.model())))
}
