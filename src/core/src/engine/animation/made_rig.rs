//! Rigs that are made of models: of their skins, or of the bodies that are found in their shapes.

use super::left_out::{left_out_primitives, reasons};
use crate::asset::Model;
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::motion::humanoid::{
    BODY_JOINTS, ClipBones, PlacedJoint, bones_of_names, bones_of_shape, find_body, preset_skeleton, rig_of_body,
};
use crate::motion::rig::{MotionRig, ReferencePose, RigError, rig_of_skin};
use crate::motion::{MotionClip, NodeOrder, Skeleton, clip_of_scene};
use glam::DVec3;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// What a rig is to be made for, and what is known of the model.
#[derive(Debug, Default)]
pub struct RigOrder<'a> {
    /// The clip that is to drive it.
    pub clip: Option<&'a MotionClip>,
    /// Without a clip, whose names its joints have; `None`: those of the model's own skin where it has one, else `cmu`.
    pub preset: Option<&'a str>,
    /// Places of joints of a body, by name.
    pub landmarks: BTreeMap<&'static str, DVec3>,
}

/// A rig that was made.
#[derive(Debug, Clone, PartialEq)]
pub struct MadeRig {
    /// The rig.
    pub rig: MotionRig,
    /// Its joints.
    pub joints: Vec<PlacedJoint>,
    /// Where joints come from: `skin`, `names of the skin` or `shape`.
    pub source: &'static str,
    /// Its warnings, one line each.
    pub warnings: Vec<String>,
}

/// The surface that bones are found in: what a skin places where the model has a skin, else all of it.
struct BodySurface<'a> {
    positions: Cow<'a, [DVec3]>,
    triangles: Cow<'a, [[u32; 3]]>,
}

impl<'a> BodySurface<'a> {
    fn of(model: &'a Model) -> Result<Self, Error> {
        let left_out = left_out_primitives(model)?;
        if left_out.is_empty() {
            return Ok(Self {
                positions: Cow::Borrowed(&model.positions),
                triangles: Cow::Borrowed(&model.triangles),
            });
        }
        let mut positions = Vec::new();
        let mut number_of = vec![None; model.positions.len()];
        for (_, primitive) in (0..)
            .zip(&model.primitives)
            .filter(|(number, _)| !left_out.contains(number))
        {
            for vertex in primitive.vertices() {
                number_of[vertex] = Some(positions.len() as u32);
                positions.push(model.positions[vertex]);
            }
        }
        let renumbered = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|vertex| number_of[vertex as usize]);
            Some([a?, b?, c?])
        };
        Ok(Self {
            triangles: model.triangles.iter().filter_map(renumbered).collect(),
            positions: Cow::Owned(positions),
        })
    }
}

/// What [`make_rig`] leaves out of a model, one line for each reason.
///
/// # Errors
/// Those of [`Model::moving_scene`].
pub fn left_out_of_rig(model: &Model) -> Result<Vec<String>, Error> {
    Ok(reasons(model, left_out_primitives(model)?, ["left out"; 2]))
}

/// Makes a rig of a model: that of its own skin where neither a clip nor a preset asks for other names, else one of a body whose
/// joints are given, named by the skin, or found in the shape.
///
/// # Errors
/// [`Error::Invalid`] for a clip whose joints are no body's, or a model that has no place for some joint.
pub fn make_rig(model: &Model, order: &RigOrder<'_>, exec: &Exec<'_>) -> Result<MadeRig, Error> {
    let body = BodySurface::of(model)?;
    let own = own_skeleton(model)?;
    if let (Some((scene_rig, _)), None, None) = (&own, order.clip, order.preset) {
        return Ok(rig_of_own_skin(scene_rig));
    }
    let preset;
    let (skeleton, reference) = match order.clip {
        Some(clip) if clip.begins_apart() => (&clip.skeleton, ReferencePose::Frame(0)),
        Some(clip) => (&clip.skeleton, ReferencePose::Rest),
        None => {
            let name = order.preset.unwrap_or("cmu");
            preset = preset_skeleton(name)
                .ok_or_else(|| RigError::field("preset", format!("is \"{name}\", allowed are cmu and mixamo")))?;
            (&preset, ReferencePose::Frame(0))
        }
    };
    let mut warnings = Vec::new();
    let bones = match bones_of_names(skeleton) {
        Ok(bones) => bones,
        Err(unknown) => {
            let guessed = bones_of_shape(skeleton).ok_or(unknown)?;
            warnings.push("no joint's name is known; bones are found by how the clip's skeleton branches".into());
            guessed
        }
    };
    let (mut joints, mut source) = (order.landmarks.clone(), "landmarks");
    if let Some((_, skeleton)) = &own {
        joints_of_skin(skeleton, &mut joints);
        source = "names of the skin";
    }
    let fixed: Vec<&str> = joints.keys().copied().collect();
    if BODY_JOINTS.iter().any(|name| !joints.contains_key(name)) {
        let found = find_body(&body.positions, &body.triangles, exec).map_err(|_| Error::Cancelled)?;
        if fixed.is_empty() {
            source = "shape";
            if found.is_none {
                let turned = turn_to_a_figure((&body.positions[..], &body.triangles[..]), exec)?;
                return Err(not_upright(&found.doubts, turned));
            }
        }
        if fixed.len() < BODY_JOINTS.len() / 2 {
            warnings.extend(found.doubts);
        }
        found
            .joints
            .into_iter()
            .for_each(|(name, at)| _ = joints.entry(name).or_insert(at));
    }
    let made = rig_of_body(
        (&body.positions[..], &body.triangles[..]),
        &joints,
        &fixed,
        (skeleton, &bones),
        reference,
        exec.pool,
    )?;
    let outside = made.joints.iter().filter(|j| !j.inside).map(|j| j.name.as_str());
    let outside: Vec<&str> = outside
        .filter(|name| !name.ends_with("End") && !name.ends_with("Toe"))
        .collect();
    if 2 * outside.len() > made.joints.len() {
        warnings.push("most joints lie outside of the model; it may have no inside".into());
    } else if !outside.is_empty() {
        let names = outside.join(", ");
        let lie = if outside.len() == 1 { "lies" } else { "lie" };
        warnings.push(format!(
            "{names} {lie} outside of the model; --at puts a joint elsewhere"
        ));
    }
    Ok(MadeRig {
        rig: made.rig,
        joints: made.joints,
        source,
        warnings,
    })
}

/// Where a turn takes a point.
type PointTurn = fn(DVec3) -> DVec3;

/// Quarter turns, each with its name in words, for figures that were made for other axes.
const TURNS: [(&str, PointTurn); 4] = [
    ("90 degrees about y", |p| DVec3::new(p.z, p.y, -p.x)),
    ("-90 degrees about y", |p| DVec3::new(-p.z, p.y, p.x)),
    ("-90 degrees about x", |p| DVec3::new(p.x, p.z, -p.y)),
    ("90 degrees about x", |p| DVec3::new(p.x, -p.z, p.y)),
];

/// The turn by which a model that does not look like an upright figure does; `None` when none does.
fn turn_to_a_figure(
    (positions, triangles): (&[DVec3], &[[u32; 3]]),
    exec: &Exec<'_>,
) -> Result<Option<&'static str>, Error> {
    for (words, quarter) in TURNS {
        let turned: Vec<DVec3> = positions.iter().copied().map(quarter).collect();
        let found = find_body(&turned, triangles, exec).map_err(|_| Error::Cancelled)?;
        if !found.is_none {
            return Ok(Some(words));
        }
    }
    Ok(None)
}

fn not_upright(doubts: &[String], turned: Option<&str>) -> Error {
    let turned = turned.map_or_else(String::new, |turn| {
        format!("a turn by {turn} corrects that: turn the model in the program that it comes from, or ")
    });
    let problem = format!(
        "it does not look like a figure that stands upright and faces along z ({}); {turned}give joints with --at NAME=x,y,z or \
         --landmarks FILE: {}",
        doubts.join("; "),
        BODY_JOINTS.join(", ")
    );
    RigError::field("model", problem).into()
}

/// The rig of a model's skin and its rest skeleton; `None` without a skin.
fn own_skeleton(model: &Model) -> Result<Option<(MotionRig, MotionClip)>, Error> {
    let Some(scene) = model.moving_scene()? else {
        return Ok(None);
    };
    let order = NodeOrder::of(&scene);
    let skeleton = clip_of_scene(&scene, &order, None);
    match rig_of_skin(&scene, &order, &skeleton, &model.positions) {
        Ok(rig) => Ok(Some((rig, skeleton))),
        Err(RigError::Field { .. }) => Ok(None),
        Err(other) => Err(other.into()),
    }
}

fn rig_of_own_skin(rig: &MotionRig) -> MadeRig {
    let joint = |bone: &crate::motion::rig::RigBone| PlacedJoint {
        name: bone.id.clone(),
        at: bone.from,
        inside: true,
        moved: 0.0,
    };
    MadeRig {
        rig: rig.clone(),
        joints: rig.bones.iter().map(joint).collect(),
        source: "skin",
        warnings: Vec::new(),
    }
}

/// Joints of a body where a skin has joints of such names.
fn joints_of_skin(skin: &MotionClip, joints: &mut BTreeMap<&'static str, DVec3>) {
    let skeleton: &Skeleton = &skin.skeleton;
    let Ok(bones): Result<ClipBones, RigError> = bones_of_names(skeleton) else {
        return;
    };
    let world = skeleton.world_transforms(&skeleton.rest_pose());
    for bone in crate::motion::humanoid::BODY_BONES {
        if let Some(joint) = bones.get(bone.id) {
            joints.entry(bone.from).or_insert(world[*joint].translation);
        }
    }
}
