//! Skeletons follow the body: what is written in the rest pose, what clips do to it, what a rigid motion does, and what stays.
//! Runs over every skinned model of the data folder.

use crate::skins::{diagonal, off_from_drawn, read_back, skinned_models};
use crate::support::bench::largest_distance;
use crate::support::gltf_parsed::Parsed;
use crate::support::shapes::bounds;
use crate::support::skinning::{ClipTime, DrawnPrimitive, clip_length, draw, list, numbers, world_transforms};
use glam::{DAffine3, DQuat, DVec3};
use pliant::asset::{
    BaseModel, EditedModel, Following, Model, Primitive, PrimitiveRun, RigRule, VertexBlends, WrittenFiles,
    write_edited_model,
};

/// Ways to reshape the upper half while the lower one is held.
#[derive(Debug, Clone, Copy)]
pub enum Reshaping {
    Turned,
    Twisted,
    Scaled,
    Longer,
}

impl Reshaping {
    pub const ALL: [Self; 4] = [Self::Turned, Self::Twisted, Self::Scaled, Self::Longer];

    pub fn of(self, positions: &[DVec3]) -> Vec<DVec3> {
        let (low, high) = bounds(positions);
        let middle = (low + high) * 0.5;
        let tall = (high - low).y.max(1e-9);
        let reshape = |&p: &DVec3| {
            let t = ((p.y - low.y) / tall * 3.0 - 1.0).clamp(0.0, 1.0);
            let t = t * t * (3.0 - 2.0 * t);
            let angle = std::f64::consts::FRAC_PI_4 * t;
            match self {
                Self::Turned => middle + DQuat::from_rotation_x(angle) * (p - middle),
                Self::Twisted => middle + DQuat::from_rotation_y(angle) * (p - middle),
                Self::Scaled => middle + (p - middle) * (1.0 + 0.4 * t),
                Self::Longer => p + DVec3::Y * (0.3 * tall * t),
            }
        };
        positions.iter().map(reshape).collect()
    }
}

fn write_with(model: &Model, positions: &[DVec3], rig: RigRule) -> WrittenFiles {
    let following = Following {
        rig,
        ..Following::default()
    };
    model
        .write_following(positions, model.format, following)
        .expect("writable")
}

/// The lengths of all edges of what is drawn.
pub fn edge_lengths(model: &Model, drawn: &[DrawnPrimitive]) -> Vec<f64> {
    let mut lengths = Vec::new();
    for row in &model.primitives {
        let own = drawn
            .iter()
            .find(|d| (d.node, d.primitive) == (row.node as usize, row.primitive as usize));
        let Some(own) = own else { continue };
        let range = row.first_vertex..row.first_vertex + row.vertex_count;
        for t in model.triangles.iter().filter(|t| range.contains(&t[0])) {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let at = |v: u32| own.positions[(v - row.first_vertex) as usize];
                lengths.push(at(a).distance(at(b)));
            }
        }
    }
    lengths
}

/// How many times as long as in the rest pose the edges of a model become over the times of all clips, ascending; `None` for files
/// that the plain player does not read, or without clips.
pub fn stretches(model: &Model, file: &Parsed) -> Option<Vec<f64>> {
    let rest = edge_lengths(model, &draw(file, None, &[])?);
    let size = diagonal(&model.positions);
    let mut all = Vec::new();
    for clip in 0..list(&file.json["animations"]).len() {
        let length = clip_length(file, clip);
        for step in 0..8 {
            let seconds = length * f64::from(step) / 8.0;
            let now = edge_lengths(model, &draw(file, Some(ClipTime { clip, seconds }), &[])?);
            let edges = now.iter().zip(&rest).filter(|(_, rest)| **rest > 2e-3 * size);
            all.extend(edges.map(|(now, rest)| now / rest));
        }
    }
    all.sort_by(f64::total_cmp);
    (!all.is_empty()).then_some(all)
}

/// The largest of a list in order, and the one that only one in a thousand is above.
pub fn largest(ascending: &[f64]) -> [f64; 2] {
    let last = ascending.len() - 1;
    [ascending[last], ascending[last - last / 1000]]
}

/// The nodes that are joints.
pub fn joints(file: &Parsed) -> Vec<usize> {
    let skins = list(&file.json["skins"]).iter();
    let all = skins.flat_map(|skin| list(&skin["joints"]).iter());
    let mut all: Vec<usize> = all.filter_map(|j| j.as_u64()).map(|j| j as usize).collect();
    all.sort_unstable();
    all.dedup();
    all
}

#[test]
fn a_reshaped_model_is_drawn_at_rest_as_it_was_put() {
    for (path, model, file) in skinned_models("reshaped rest poses") {
        for how in Reshaping::ALL {
            let wanted = how.of(&model.positions);
            let (again, after) = read_back(&write_with(&model, &wanted, RigRule::Follow), model.format);
            let size = diagonal(&wanted);
            let off = largest_distance(&again.positions, &wanted);
            assert!(off <= 1e-5 * size, "{path} {how:?}: off by {off} of {size}");
            if let Some(off) = off_from_drawn(&wanted, &model, &after) {
                assert!(off <= 1e-5 * size, "{path} {how:?}: drawn off by {off} of {size}");
            }
            let nodes = |file: &Parsed| file.json["nodes"].clone();
            let has_moved = largest_distance(&model.positions, &wanted) > 1e-3 * size;
            assert_eq!(nodes(&file) != nodes(&after), has_moved, "{path} {how:?}");
        }
    }
}

#[test]
fn clips_play_on_the_reshaped_body_without_tearing_it() {
    for (path, model, file) in skinned_models("clips on reshaped bodies") {
        let Some(before) = stretches(&model, &file) else {
            continue;
        };
        let [worst_before, many_before] = largest(&before);
        for how in Reshaping::ALL {
            let written = write_with(&model, &how.of(&model.positions), RigRule::Follow);
            let (again, after) = read_back(&written, model.format);
            let [worst, many] = largest(&stretches(&again, &after).expect("as readable as the original"));
            assert!(
                many <= 1.35 * many_before,
                "{path} {how:?}: one edge in a thousand becomes {many} times as long, it was {many_before}"
            );
            assert!(
                worst <= 1.6 * worst_before,
                "{path} {how:?}: an edge becomes {worst} times as long, it was {worst_before}"
            );
        }
    }
}

#[test]
fn a_rigid_motion_takes_the_whole_skeleton_and_its_clips_along() {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 1.1);
    for (path, model, file) in skinned_models("rigid motions") {
        let size = diagonal(&model.positions);
        let motion = DAffine3::from_rotation_translation(turn, DVec3::new(0.4, -0.2, 0.9) * size);
        let wanted: Vec<DVec3> = model.positions.iter().map(|&p| motion.transform_point3(p)).collect();
        let (_, after) = read_back(&write_with(&model, &wanted, RigRule::Follow), model.format);
        let world = |file: &Parsed| world_transforms(file, None).expect("transforms are never compressed");
        let (old, new) = (world(&file), world(&after));
        for joint in joints(&file) {
            let expected = motion * old[joint];
            let off = (expected.translation - new[joint].translation).length();
            assert!(off <= 3e-6 * size, "{path}: joint {joint} is off by {off} of {size}");
            let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| {
                let (a, b) = (expected.transform_vector3(axis), new[joint].transform_vector3(axis));
                (a - b).length() / a.length()
            });
            assert!(axes.iter().all(|&off| off < 1e-5), "{path}: joint {joint}: {axes:?}");
        }
        // A clip does to the moved model what it did to the other, moved.
        let clips = list(&file.json["animations"]).len();
        for clip in 0..clips {
            let at = Some(ClipTime {
                clip,
                seconds: 0.4 * clip_length(&file, clip),
            });
            let (Some(old), Some(new)) = (draw(&file, at, &[]), draw(&after, at, &[])) else {
                continue;
            };
            for (old, new) in old.iter().zip(&new) {
                let expected: Vec<DVec3> = old.positions.iter().map(|&p| motion.transform_point3(p)).collect();
                let off = largest_distance(&expected, &new.positions);
                assert!(off <= 1e-5 * size, "{path}: clip {clip} is off by {off} of {size}");
            }
        }
    }
}

/// Everything of a file that a skeleton consists of, as numbers.
fn skeleton(file: &Parsed) -> Vec<Option<Vec<f64>>> {
    let json = &file.json;
    let skins = list(&json["skins"]).iter();
    let binds = skins.filter(|s| !s["inverseBindMatrices"].is_null());
    let mut all: Vec<_> = binds.map(|s| numbers(file, &s["inverseBindMatrices"])).collect();
    for animation in list(&json["animations"]).iter() {
        let samplers = list(&animation["samplers"]).iter();
        all.extend(samplers.flat_map(|s| [numbers(file, &s["input"]), numbers(file, &s["output"])]));
    }
    all
}

#[test]
fn a_rig_that_is_to_stay_is_written_as_it_was() {
    for (path, model, file) in skinned_models("kept rigs") {
        let wanted = Reshaping::Twisted.of(&model.positions);
        let (again, after) = read_back(&write_with(&model, &wanted, RigRule::Keep), model.format);
        for section in ["nodes", "skins", "animations"] {
            assert_eq!(file.json[section], after.json[section], "{path}: {section}");
        }
        assert_eq!(skeleton(&file), skeleton(&after), "{path}");
        let off = largest_distance(&again.positions, &wanted);
        assert!(off <= 1e-5 * diagonal(&wanted), "{path}: {off}");
    }
}

#[test]
fn what_stays_keeps_its_bytes_while_joints_move() {
    for (path, model, file) in skinned_models("parts that stay under moved joints") {
        let [first, rest @ ..] = model.primitives.as_slice() else {
            continue;
        };
        let mut wanted = model.positions.clone();
        let size = diagonal(&wanted);
        for p in &mut wanted[..first.vertex_count as usize] {
            p.y += 0.1 * size;
        }
        let (again, after) = read_back(&write_with(&model, &wanted, RigRule::Follow), model.format);
        assert!(largest_distance(&again.positions, &wanted) <= 3e-6 * size, "{path}");
        let is_skinned = |row: &&Primitive| !file.json["nodes"][row.node as usize]["skin"].is_null();
        for row in rest.iter().filter(is_skinned) {
            for name in ["POSITION", "NORMAL", "JOINTS_0", "WEIGHTS_0"] {
                let stored = |file: &Parsed| {
                    let primitive = &file.json["meshes"][row.mesh as usize]["primitives"][row.primitive as usize];
                    numbers(file, &primitive["attributes"][name])
                };
                assert_eq!(stored(&file), stored(&after), "{path}: {path}");
            }
        }
    }
}

#[test]
fn a_skeleton_follows_through_an_edit_of_the_topology() {
    for (path, model, file) in skinned_models("edited rigs") {
        // Every primitive loses its last triangle, unless it is its only one.
        let (mut runs, mut triangles) = (Vec::new(), Vec::new());
        for (p, row) in model.primitives.iter().enumerate() {
            let range = row.first_vertex..row.first_vertex + row.vertex_count;
            let own = model.triangles.iter().filter(|t| range.contains(&t[0]));
            let own: Vec<[u32; 3]> = own.copied().collect();
            let left = (own.len() - 1).max(1);
            runs.push(PrimitiveRun {
                base: 0,
                primitive: p as u32,
                first_vertex: row.first_vertex,
                vertex_count: row.vertex_count,
                first_triangle: triangles.len() as u32,
                triangle_count: left as u32,
            });
            triangles.extend_from_slice(&own[..left]);
        }
        let blends = VertexBlends::identity(model.positions.len() as u32);
        let bases = [BaseModel {
            model: &model,
            world_from_model: DAffine3::IDENTITY,
        }];
        let edited = EditedModel {
            bases: &bases,
            runs: &runs,
            blends: &blends,
            triangles: &triangles,
            origins: &[],
            bare: &[],
            caps: Default::default(),
        };
        let wanted = Reshaping::Turned.of(&model.positions);
        let written = write_edited_model(&edited, &wanted, model.format).expect("writable");
        let (again, after) = read_back(&written, model.format);
        let size = diagonal(&wanted);
        let off = largest_distance(&again.positions, &wanted);
        assert!(off <= 1e-5 * size, "{path}: off by {off} of {size}");
        assert_ne!(file.json["nodes"], after.json["nodes"], "{path}: no joint moved");
        if let (Some(before), Some(stretched)) = (stretches(&model, &file), stretches(&again, &after)) {
            let (before, after) = (largest(&before)[1], largest(&stretched)[1]);
            assert!(after <= 1.35 * before, "{path}: {after} times as long, it was {before}");
        }
    }
}
