//! Facts, warnings and qualities as messages.
//!
//! What of a model's file follows its shape: the checked rules, and the report.

use super::check::enumerated;
use super::poses::handle_pose_message;
use super::{Error, pb};
use glam::DVec3;
use pliant_asset::{
    BoneLengthRule, FollowedCounts, Following, LargeSplatRule, MorphTargetRule, Primitive, RigRule, WrittenFiles,
    WrittenWarning,
};
use pliant_core::engine::{
    DeformerFacts, DeformerWarning, FoundTurn, HandlePose, HandlePoses, LoosePart, QualityReport, WarningPlace,
};

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
            stiff_parts: solver.stiff_parts,
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
                pivot: h.pivot.to_array().to_vec(),
                pose: None,
                found_turn: Vec::new(),
            })
            .collect(),
        origin: origin_numbers(facts.origin),
        ..Default::default()
    }
}

/// What positions are relative to, as numbers; none where nothing has to be added.
pub(crate) fn origin_numbers(origin: DVec3) -> Vec<f64> {
    match origin == DVec3::ZERO {
        true => Vec::new(),
        false => origin.to_array().to_vec(),
    }
}

/// What positions of a session's frames and buffers are relative to.
pub fn origin_of(session: &pb::Session) -> DVec3 {
    match session.origin[..] {
        [x, y, z] => DVec3::new(x, y, z),
        _ => DVec3::ZERO,
    }
}

/// Adds poses to the handles of a session; one in the rest pose has none. Targets, which may be millions, are left out.
pub fn handle_poses_message(handles: &mut [pb::HandleFacts], poses: &HandlePoses) {
    for (handle, pose) in handles.iter_mut().zip(poses.0.iter()) {
        let pose = HandlePose {
            targets: None,
            ..pose.clone()
        };
        handle.pose = (pose != HandlePose::default()).then(|| handle_pose_message(&pose));
    }
}

/// Writes the rotations that were found for handles that turn freely.
pub fn found_turns_message(turns: &[FoundTurn]) -> Vec<pb::FoundTurn> {
    let message = |turn: &FoundTurn| pb::FoundTurn {
        id: turn.id.clone(),
        rotation_vector: turn.rotation.to_array().to_vec(),
    };
    turns.iter().map(message).collect()
}

/// Adds these rotations to the handles of a session that they are of; the others have none then.
pub fn add_found_turns(handles: &mut [pb::HandleFacts], turns: &[pb::FoundTurn]) {
    for handle in handles {
        let own = turns.iter().find(|turn| turn.id == handle.id);
        handle.found_turn = own.map_or_else(Vec::new, |turn| turn.rotation_vector.clone());
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
        new_self_intersections: quality.new_self_intersections,
        off_rigid: quality.off_rigid,
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

/// Most joints below which bones are rigid.
const MOST_RIGID_CHAINS: usize = 1024;

/// Reads what follows the shape of a model.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub(super) fn following(create: &pb::CreateOptions) -> Result<Following, Error> {
    let morph_targets = match enumerated(create.morph_targets, "morphTargets")? {
        pb::create_options::morph_targets::Rule::Follow => MorphTargetRule::Follow,
        pb::create_options::morph_targets::Rule::Keep => MorphTargetRule::Keep,
    };
    let rig = match enumerated(create.rig, "rig")? {
        pb::create_options::rig::Rule::Follow => RigRule::Follow,
        pb::create_options::rig::Rule::Keep => RigRule::Keep,
        pb::create_options::rig::Rule::Move => RigRule::Move,
    };
    let chains = &create.rigid_chains;
    let lengths = enumerated(create.bone_lengths, "boneLengths")?;
    if rig == RigRule::Keep {
        let problem = "is given, but rig KEEP leaves all joints where they are; leave one out";
        if lengths == pb::create_options::bone_lengths::Rule::Keep {
            return Err(Error::invalid("boneLengths", problem));
        }
        if !chains.is_empty() {
            return Err(Error::invalid("rigidChains", problem));
        }
    }
    let bone_lengths = match lengths {
        pb::create_options::bone_lengths::Rule::Follow if chains.is_empty() => BoneLengthRule::Follow,
        pb::create_options::bone_lengths::Rule::Follow => BoneLengthRule::KeepBelow(chains.clone()),
        pb::create_options::bone_lengths::Rule::Keep if chains.is_empty() => BoneLengthRule::Keep,
        pb::create_options::bone_lengths::Rule::Keep => {
            let problem = "is given, but boneLengths KEEP keeps those of all bones; leave one out";
            return Err(Error::invalid("rigidChains", problem));
        }
    };
    if chains.len() > MOST_RIGID_CHAINS {
        let problem = format!("has {} entries, at most {MOST_RIGID_CHAINS} are allowed", chains.len());
        return Err(Error::invalid("rigidChains", problem));
    }
    if let Some(k) = chains.iter().position(String::is_empty) {
        return Err(Error::invalid(
            format!("rigidChains[{k}]"),
            "is empty; the name of a joint is needed",
        ));
    }
    let large_splats = match enumerated(create.large_splats, "largeSplats")? {
        pb::create_options::large_splats::Rule::Divide => LargeSplatRule::Divide,
        pb::create_options::large_splats::Rule::Keep => LargeSplatRule::Keep,
    };
    Ok(Following {
        morph_targets,
        rig,
        bone_lengths,
        large_splats,
    })
}

/// What a written model has not, or may be wrong in it.
pub fn written_warnings(written: &WrittenFiles) -> Vec<pb::Warning> {
    let message = |warning: &WrittenWarning| pb::Warning {
        code: warning.code.into(),
        message: warning.message.clone(),
        r#where: warning.place.clone(),
        ..Default::default()
    };
    written.warnings.iter().map(message).collect()
}

/// Writes what followed; `None` where there was nothing that could.
pub fn followed_message(counts: &FollowedCounts) -> Option<pb::Followed> {
    let joint = |travel: &pliant_asset::JointTravel| pb::followed::Joint {
        node: travel.node,
        name: travel.name.clone(),
        distance: travel.distance,
    };
    (!counts.is_none()).then(|| pb::Followed {
        joints: counts.joints,
        moved_joints: counts.moved_joints,
        clips: counts.clips,
        rewritten_clips: counts.rewritten_clips,
        morph_targets: counts.morph_targets,
        carried_morph_targets: counts.carried_morph_targets,
        passengers: counts.passengers,
        moved_passengers: counts.moved_passengers,
        passenger_nodes: counts.passenger_nodes,
        moved_passenger_nodes: counts.moved_passenger_nodes,
        farthest: counts.farthest.iter().map(joint).collect(),
    })
}

#[cfg(test)]
mod following_tests {
    use super::*;

    fn read(text: &str) -> Result<Following, Error> {
        following(&crate::json::from_json(text.as_bytes()).expect("options"))
    }

    #[test]
    fn bones_follow_unless_asked_otherwise() {
        let rule = |text: &str| read(text).expect("allowed").bone_lengths;
        assert_eq!(rule("{}"), BoneLengthRule::Follow);
        assert_eq!(rule(r#"{"boneLengths": "KEEP"}"#), BoneLengthRule::Keep);
        let named = BoneLengthRule::KeepBelow(vec!["arm".into()]);
        assert_eq!(rule(r#"{"rigidChains": ["arm"]}"#), named);
    }

    #[test]
    fn what_says_two_things_or_nothing_is_refused() {
        let many = format!(r#"{{"rigidChains": [{}"a"]}}"#, r#""a","#.repeat(1024));
        for (text, field) in [
            (r#"{"boneLengths": "KEEP", "rigidChains": ["arm"]}"#, "rigidChains"),
            (r#"{"rig": "KEEP", "boneLengths": "KEEP"}"#, "boneLengths"),
            (r#"{"rig": "KEEP", "rigidChains": ["arm"]}"#, "rigidChains"),
            (r#"{"rigidChains": ["arm", ""]}"#, "rigidChains[1]"),
            (r#"{"boneLengths": 7}"#, "boneLengths"),
            (&many, "rigidChains"),
        ] {
            let reported = read(text).expect_err(text);
            assert!(
                matches!(&reported, Error::Invalid { field: at, .. } if at == field),
                "{reported}"
            );
        }
    }
}
