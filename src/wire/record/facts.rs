//! Facts, warnings and reports, read from their messages. Written again they give the same messages; a place in words
//! stands for the handles of a warning.

use crate::asset::{Format, Primitive};
use crate::engine::{
    DeformerFacts, DeformerWarning, EditReport, HandleFacts, KeptVertexRun, LoosePart, MeshCounts, ModelFacts,
    SolverFacts, TieFacts, WarningPlace,
};
use crate::wire::{Error, pb};
use glam::DVec3;

/// Reads the facts of a session.
pub(super) fn recorded_facts(message: Option<&pb::Session>) -> Result<DeformerFacts, Error> {
    let message = message.ok_or_else(|| Error::invalid("facts", "is missing"))?;
    let model = message.model.clone().unwrap_or_default();
    let solver = message.solver.clone().unwrap_or_default();
    Ok(DeformerFacts {
        model: ModelFacts {
            format: Format::from_name(&model.format)
                .ok_or_else(|| Error::invalid("facts.model.format", "is not a format"))?,
            file_bytes: model.bytes,
            sha256: model.sha256,
            counts: MeshCounts {
                vertices: model.vertices,
                faces: model.triangles,
            },
        },
        primitives: message.primitives.iter().map(recorded_primitive).collect(),
        solver: recorded_solver(&solver),
        handles: message.handles.iter().map(recorded_handle).collect::<Result<_, _>>()?,
        warnings: recorded_warnings(&message.warnings),
    })
}

fn recorded_primitive(p: &pb::Primitive) -> Primitive {
    Primitive {
        node: p.node,
        mesh: p.mesh,
        primitive: p.primitive,
        name: p.name.clone(),
        first_vertex: p.first_vertex,
        vertex_count: p.vertex_count,
        index_count: p.index_count,
        has_normals: p.has_normals,
        has_tangents: p.has_tangents,
        is_passenger: p.passenger,
    }
}

fn recorded_solver(solver: &pb::SolverFacts) -> SolverFacts {
    let loose = |part: &pb::solver_facts::LoosePart| LoosePart {
        component: part.component,
        vertices: part.vertices,
        primitive: part.primitive,
        name: part.name.clone(),
    };
    SolverFacts {
        solver_vertices: solver.solver_vertices,
        graph_vertices: solver.graph_vertices,
        graph_edges: solver.graph_edges,
        components: solver.components,
        ties: TieFacts {
            ties: solver.ties,
            loose_parts: solver.loose_parts,
            loose: solver.loose.iter().map(loose).collect(),
        },
        levels: solver.levels.iter().map(|l| (l.vertices, l.edges)).collect(),
        byte_size: solver.bytes,
    }
}

fn recorded_handle(handle: &pb::HandleFacts) -> Result<HandleFacts, Error> {
    let centroid = <[f64; 3]>::try_from(handle.centroid.as_slice())
        .map_err(|_| Error::invalid("facts.handles.centroid", "is not a vector"))?;
    Ok(HandleFacts {
        id: handle.id.clone(),
        vertices: handle.vertices,
        interior_nodes: handle.interior_nodes,
        centroid: DVec3::from_array(centroid),
    })
}

/// Reads warnings.
pub(super) fn recorded_warnings(messages: &[pb::Warning]) -> Vec<DeformerWarning> {
    let place = |w: &pb::Warning| match (w.vertices.is_empty(), w.position.is_empty()) {
        (false, _) => WarningPlace::Vertices {
            text: w.r#where.clone(),
            vertices: w.vertices.clone(),
        },
        (true, false) => WarningPlace::Points {
            text: w.r#where.clone(),
            points: w.position.chunks_exact(3).map(DVec3::from_slice).collect(),
        },
        (true, true) => WarningPlace::Text(w.r#where.clone()),
    };
    let warnings = messages.iter().map(|w| DeformerWarning {
        code: w.code.clone(),
        message: w.message.clone(),
        place: place(w),
    });
    warnings.collect()
}

/// Reads what an edit did.
pub(super) fn recorded_report(message: Option<&pb::EditResult>) -> Result<EditReport, Error> {
    let message = message.ok_or_else(|| Error::invalid("report", "is missing"))?;
    let counts = |c: Option<pb::edit_result::Counts>| {
        c.map_or_else(MeshCounts::default, |c| MeshCounts {
            vertices: c.vertices,
            faces: c.faces,
        })
    };
    let runs = message.kept.iter().map(|run| KeptVertexRun {
        was: run.was,
        now: run.now,
        count: run.count,
    });
    Ok(EditReport {
        before: counts(message.before),
        after: counts(message.after),
        handles_kept: message.handles_kept.clone(),
        warnings: recorded_warnings(&message.warnings),
        kept: runs.collect(),
        curve: message.curve.clone(),
        deviation: message.deviation,
        digest: message.digest.clone(),
        repaired: message.repaired,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{session_message, warning_message};

    fn warned(place: WarningPlace) -> DeformerWarning {
        DeformerWarning {
            code: "a-code".into(),
            message: "what it is".into(),
            place,
        }
    }

    #[test]
    fn facts_are_told_as_they_were_before() {
        let facts = DeformerFacts {
            model: ModelFacts {
                format: Format::OBJ,
                file_bytes: 7,
                sha256: "ab".into(),
                counts: MeshCounts { vertices: 8, faces: 12 },
            },
            primitives: vec![recorded_primitive(&pb::Primitive {
                node: 1,
                mesh: 2,
                primitive: 3,
                name: "a part".into(),
                first_vertex: 4,
                vertex_count: 5,
                index_count: 6,
                has_normals: true,
                has_tangents: true,
                passenger: true,
            })],
            solver: SolverFacts {
                solver_vertices: 1,
                graph_vertices: 2,
                graph_edges: 3,
                components: 4,
                ties: TieFacts {
                    ties: 5,
                    loose_parts: 1,
                    loose: vec![LoosePart {
                        component: 3,
                        vertices: 2,
                        primitive: 1,
                        name: "loose".into(),
                    }],
                },
                levels: vec![(2, 3), (1, 0)],
                byte_size: 99,
            },
            handles: vec![HandleFacts {
                id: "h".into(),
                vertices: 3,
                interior_nodes: 4,
                centroid: DVec3::new(0.1, -0.0, 3e-300),
            }],
            warnings: vec![
                warned(WarningPlace::Handles(vec![1, 3])),
                warned(WarningPlace::Vertices {
                    text: "there".into(),
                    vertices: vec![3],
                }),
                warned(WarningPlace::Points {
                    text: "here".into(),
                    points: vec![DVec3::new(1.0, 2.0, 3.0)],
                }),
                warned(WarningPlace::RegionOfInterest),
            ],
        };
        let told = session_message(&facts);
        let again = recorded_facts(Some(&told)).expect("it was recorded");
        assert_eq!(session_message(&again), told);
        assert_eq!(again.solver, facts.solver);
        assert_eq!(again.warnings[1..3], facts.warnings[1..3]);
        assert_eq!(warning_message(&again.warnings[0]), warning_message(&facts.warnings[0]));
    }
}
