//! Facts, warnings and qualities as messages.

use super::pb;
use super::poses::handle_pose_message;
use crate::asset::Primitive;
use crate::engine::{DeformerFacts, DeformerWarning, HandlePose, HandlePoses, LoosePart, QualityReport, WarningPlace};

/// Writes the facts of a session's model, solver and handles; the caller adds id, revision, times and limits.
pub fn session_message(facts: &DeformerFacts) -> pb::Session {
    let (model, solver) = (&facts.model, &facts.solver);
    pb::Session {
        primitives: facts.primitives.iter().map(primitive_message).collect(),
        warnings: facts.warnings.iter().map(warning_message).collect(),
        model: Some(pb::ModelFacts {
            format: model.format.name().into(),
            bytes: model.file_bytes,
            sha256: model.sha256.clone(),
            vertices: model.counts.vertices,
            triangles: model.counts.faces,
        }),
        solver: Some(pb::SolverFacts {
            solver_vertices: solver.solver_vertices,
            graph_vertices: solver.graph_vertices,
            graph_edges: solver.graph_edges,
            components: solver.components,
            levels: (solver.levels.iter())
                .map(|&(vertices, edges)| pb::solver_facts::Level { vertices, edges })
                .collect(),
            bytes: solver.byte_size,
            ties: solver.ties.ties,
            loose_parts: solver.ties.loose_parts,
            loose: solver.ties.loose.iter().map(loose_part_message).collect(),
        }),
        handles: (facts.handles.iter())
            .map(|h| pb::HandleFacts {
                id: h.id.clone(),
                vertices: h.vertices,
                interior_nodes: h.interior_nodes,
                centroid: h.centroid.to_array().to_vec(),
                pose: None,
            })
            .collect(),
        ..Default::default()
    }
}

/// Adds poses to the handles of a session; one in the rest pose has none.
pub fn handle_poses_message(handles: &mut [pb::HandleFacts], poses: &HandlePoses) {
    for (handle, pose) in handles.iter_mut().zip(poses.0.iter()) {
        handle.pose = (*pose != HandlePose::default()).then(|| handle_pose_message(pose));
    }
}

/// Writes a warning.
pub fn warning_message(warning: &DeformerWarning) -> pb::Warning {
    let (mut vertices, mut position) = (Vec::new(), Vec::new());
    let place = match &warning.place {
        WarningPlace::Text(text) => text.clone(),
        WarningPlace::Vertices { text, vertices: found } => {
            vertices.clone_from(found);
            text.clone()
        }
        WarningPlace::Points { text, points } => {
            position.extend(points.iter().flat_map(|p| p.to_array()));
            text.clone()
        }
        WarningPlace::Handles(numbers) => {
            let fields: Vec<String> = numbers.iter().map(|k| format!("handles[{k}]")).collect();
            fields.join(", ")
        }
        WarningPlace::RegionOfInterest => "regionOfInterest".into(),
    };
    pb::Warning {
        code: warning.code.clone(),
        message: warning.message.clone(),
        r#where: place,
        vertices,
        position,
    }
}

/// Writes the quality of a shape.
pub fn quality_message(quality: &QualityReport) -> pb::Quality {
    pb::Quality {
        edge_rms: quality.edge_rms,
        volume_change: quality.volume_change,
        open_surface: quality.open_surface,
        area_change: quality.area_change,
        flipped_triangles: quality.flipped_triangles,
        max_stretch: quality.max_stretch,
        self_intersections: quality.self_intersections,
        faces_too_large: quality.faces_too_large,
    }
}

fn loose_part_message(part: &LoosePart) -> pb::solver_facts::LoosePart {
    pb::solver_facts::LoosePart {
        component: part.component,
        vertices: part.vertices,
        primitive: part.primitive,
        name: part.name.clone(),
    }
}

fn primitive_message(p: &Primitive) -> pb::Primitive {
    pb::Primitive {
        node: p.node,
        mesh: p.mesh,
        primitive: p.primitive,
        name: p.name.clone(),
        first_vertex: p.first_vertex,
        vertex_count: p.vertex_count,
        index_count: p.index_count,
        has_normals: p.has_normals,
        has_tangents: p.has_tangents,
        passenger: p.is_passenger,
    }
}
