//! Rigs that are made of models: of their skins, or of the bodies that are found in their shapes.
//!
//! Bones of a rig carry the vertices of a model. What is not solved in a model that has a skin: what no skin places, such as hulls for collisions, props and floors, and coarser
//! levels of detail of what is solved. Rigs are found without it, and clips are solved without it.

use crate::asset::{CarryingJoints, Geometry, Model, MovingScene, PlayedJoint, Primitive};
use crate::engine::deformer::Deformer;
use crate::engine::error::Error;
use crate::engine::settings::{Passenger, PassengerKind};
use crate::exec::Exec;
use crate::graph::WindingTree;
use crate::motion::humanoid::{
    BODY_JOINTS, BodyAxes, BodyOrder, BodySkeleton, ClipBones, PlacedJoint, bones_of_names, bones_of_shape, find_body,
    preset_skeleton, rig_of_body,
};
use crate::motion::rig::{MotionRig, ReferencePose, RigError, rig_joints, rig_of_skin, skin_bones};
use crate::motion::skin_weights::{SkinWeightOptions, skin_weights};
use crate::motion::{BoneInfluences, MotionClip, NodeOrder, SignedAxis, Skeleton, clip_of_scene};
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
    /// Places of joints of a body, by name. They stay, and joints that depend on them follow.
    pub landmarks: BTreeMap<&'static str, DVec3>,
    /// From a figure's feet to its head; `None`: what fits best.
    pub up: Option<SignedAxis>,
    /// Where a figure faces; `None`: what fits best.
    pub front: Option<SignedAxis>,
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
    /// How its body stands; `None` for a rig of a skin.
    pub axes: Option<BodyAxes>,
    /// Its warnings, one line each.
    pub warnings: Vec<String>,
}

/// The score from which on a joint counts as found.
const LEAST_SCORE: f64 = 0.5;
/// Joints that an error describes.
const DESCRIBED: usize = 3;

impl MadeRig {
    /// The score of the worst joint, 0 to 1.
    pub fn score(&self) -> f64 {
        self.joints.iter().map(|joint| joint.score).fold(1.0, f64::min)
    }

    /// Whether a joint's place is not sure enough for a rig.
    pub fn is_doubtful(joint: &PlacedJoint) -> bool {
        joint.score < LEAST_SCORE
    }

    /// Checks that all joints are sure enough.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the joints that are not, why, and what to do.
    pub fn check(&self) -> Result<(), Error> {
        let mut doubtful: Vec<&PlacedJoint> = self.joints.iter().filter(|joint| Self::is_doubtful(joint)).collect();
        if doubtful.is_empty() {
            return Ok(());
        }
        doubtful.sort_by(|a, b| a.score.total_cmp(&b.score).then(a.name.cmp(&b.name)));
        let mut reasons: Vec<(&str, f64, Vec<&str>)> = Vec::new();
        for joint in &doubtful {
            match reasons.iter_mut().find(|known| known.0 == joint.reason) {
                Some(known) => known.2.push(&joint.name),
                None => reasons.push((&joint.reason, joint.score, vec![&joint.name])),
            }
        }
        let lines = reasons
            .iter()
            .take(DESCRIBED)
            .map(|(reason, score, names)| format!("{} {score:.2} ({reason})", names.join(", ")));
        let axes = self.axes.map_or_else(String::new, |axes| {
            format!(
                " as a figure with {} up that faces {}",
                axes.up.name(),
                axes.front.name()
            )
        });
        let problem = format!(
            "joints are not sure{axes}; scores below {LEAST_SCORE}: {}; in `pliant rig` give joints with --at \
             NAME=x,y,z or --landmarks FILE, or how the figure stands with --up and --front",
            lines.collect::<Vec<_>>().join("; ")
        );
        Err(RigError::field("model", problem).into())
    }
}

/// The surface that bones are found in: what a skin places where the model has a skin, else all of it.
struct BodySurface<'a> {
    positions: Cow<'a, [DVec3]>,
    triangles: Cow<'a, [[u32; 3]]>,
}

impl<'a> BodySurface<'a> {
    /// Of a model as it was read, or as edits have left it: its positions, and its triangles and primitives.
    fn of(model: &Model, all: &'a [DVec3], geometry: &'a Geometry) -> Result<Self, Error> {
        let left_out = left_out_primitives(model)?;
        if left_out.is_empty() {
            return Ok(Self {
                positions: Cow::Borrowed(all),
                triangles: Cow::Borrowed(&geometry.triangles),
            });
        }
        let mut positions = Vec::new();
        let mut number_of = vec![None; all.len()];
        for (_, primitive) in (0..)
            .zip(&geometry.primitives)
            .filter(|(number, _)| !left_out.contains(number))
        {
            for vertex in primitive.vertices() {
                number_of[vertex] = Some(positions.len() as u32);
                positions.push(all[vertex]);
            }
        }
        let renumbered = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|vertex| number_of[vertex as usize]);
            Some([a?, b?, c?])
        };
        Ok(Self {
            triangles: geometry.triangles.iter().filter_map(renumbered).collect(),
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
/// joints are given, named by the skin, or found in the shape. [`MadeRig::check`] says whether they are sure enough.
///
/// # Errors
/// [`Error::Invalid`] for a clip whose joints are no body's, or a model that has no place for some joint.
pub fn make_rig(model: &Model, order: &RigOrder<'_>, exec: &Exec<'_>) -> Result<MadeRig, Error> {
    let body = BodySurface::of(model, &model.positions, &model.geometry)?;
    make_rig_in(&body, model, order, exec)
}

impl Deformer {
    /// [`make_rig`] of the model's rest shape as edits have left it.
    ///
    /// # Errors
    /// Those of [`make_rig`].
    pub fn make_rig(&self, order: &RigOrder<'_>, exec: &Exec<'_>) -> Result<MadeRig, Error> {
        let body = BodySurface::of(self.model(), self.rest(), self.geometry())?;
        make_rig_in(&body, self.model(), order, exec)
    }

    /// The vertices of the rest shape that bones are found in.
    pub(super) fn body_vertices(&self) -> Result<Cow<'_, [DVec3]>, Error> {
        Ok(BodySurface::of(self.model(), self.rest(), self.geometry())?.positions)
    }
}

/// [`make_rig`], with bones in `body`; `model` has the skin.
fn make_rig_in(body: &BodySurface<'_>, model: &Model, order: &RigOrder<'_>, exec: &Exec<'_>) -> Result<MadeRig, Error> {
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
    check_landmarks(&order.landmarks)?;
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
    let found = match BODY_JOINTS.iter().all(|name| joints.contains_key(name)) && order.up.is_some() {
        true => None,
        false => {
            let known = BodyOrder {
                given: Some(&joints),
                up: order.up,
                front: order.front,
            };
            Some(find_body(&body.positions, &body.triangles, &known, exec).map_err(|_| Error::Cancelled)?)
        }
    };
    if fixed.is_empty() {
        source = "shape";
    }
    let places = found.iter().flat_map(|found| &found.joints);
    places.for_each(|(name, joint)| _ = joints.entry(name).or_insert(joint.at));
    let tree = WindingTree::build(&body.positions, &body.triangles, exec.pool);
    let clip = BodySkeleton {
        skeleton,
        bones: &bones,
    };
    let mut made = rig_of_body(&tree, &body.positions, &joints, &fixed, clip, reference)?;
    for joint in &mut made.joints {
        let found = found.as_ref().and_then(|found| found.joints.get(joint.name.as_str()));
        if let Some(found) = found.filter(|found| found.score < joint.score) {
            (joint.score, joint.reason) = (found.score, found.reason.clone());
        }
    }
    let axes = found.map(|found| found.axes);
    made.rig.up = axes.map(|axes| axes.up).or(order.up).unwrap_or_default();
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
            "{names} {lie} outside of the model; if that is wrong, give their places"
        ));
    }
    let unsure = made.joints.iter().filter(|joint| !joint.reason.is_empty());
    let mut reasons: Vec<(&str, Vec<&str>)> = Vec::new();
    for joint in unsure.filter(|joint| !MadeRig::is_doubtful(joint)) {
        match reasons.iter_mut().find(|known| known.0 == joint.reason) {
            Some(known) => known.1.push(&joint.name),
            None => reasons.push((&joint.reason, vec![&joint.name])),
        }
    }
    warnings.extend(
        reasons
            .iter()
            .map(|(reason, names)| format!("{}: {reason}", names.join(", "))),
    );
    Ok(MadeRig {
        rig: made.rig,
        joints: made.joints,
        source,
        axes,
        warnings,
    })
}

fn check_landmarks(landmarks: &BTreeMap<&'static str, DVec3>) -> Result<(), Error> {
    let most = MotionRig::FARTHEST;
    match landmarks.iter().find(|(_, at)| at.abs().max_element() > most) {
        Some((name, at)) => {
            let problem = format!("is {at}, coordinates from -{most:e} to {most:e} are allowed");
            Err(Error::invalid(format!("joints.{name}"), problem))
        }
        None => Ok(()),
    }
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
        score: 1.0,
        reason: String::new(),
    };
    MadeRig {
        rig: rig.clone(),
        joints: rig.bones.iter().map(joint).collect(),
        source: "skin",
        axes: None,
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

/// Joints, and which of them carry each vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct BoundModel {
    /// One for each bone of the rig.
    pub joints: Vec<PlayedJoint>,
    /// By render vertex.
    pub influences: Vec<BoneInfluences>,
}

/// Binds a model to the bones of a rig, each vertex to at most so many.
///
/// # Errors
/// [`Error::Invalid`] for a number of influences out of range or a model without vertices.
pub fn bind_model(model: &Model, rig: &MotionRig, influences: usize, exec: &Exec<'_>) -> Result<BoundModel, Error> {
    Ok(BoundModel {
        joints: rig_joints(rig),
        influences: bind_surface(&model.positions, &model.triangles, rig, influences, exec)?,
    })
}

fn bind_surface(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    rig: &MotionRig,
    influences: usize,
    exec: &Exec<'_>,
) -> Result<Vec<BoneInfluences>, Error> {
    let options = SkinWeightOptions {
        influences,
        ..SkinWeightOptions::default()
    };
    Ok(skin_weights(positions, triangles, &skin_bones(rig), &options, exec)?)
}

impl Deformer {
    /// Which bones of a rig carry each render vertex of the rest shape as edits have left it, by the shape alone.
    ///
    /// # Errors
    /// Those of [`bind_model`].
    pub fn bind(&self, rig: &MotionRig, influences: usize, exec: &Exec<'_>) -> Result<Vec<BoneInfluences>, Error> {
        bind_surface(self.rest(), &self.geometry().triangles, rig, influences, exec)
    }
}

/// Which bones of a rig that was made of a model's skin carry each of its vertices: what the skin says, each joint's share with
/// the bone of its name, or the nearest above it.
///
/// # Errors
/// What reading the model's scene fails with.
pub fn influences_of_skin(model: &Model, rig: &MotionRig) -> Result<Vec<BoneInfluences>, Error> {
    let Some(scene) = model.moving_scene()? else {
        return Ok(vec![BoneInfluences::one(0); model.positions.len()]);
    };
    let order = NodeOrder::of(&scene);
    let skeleton = clip_of_scene(&scene, &order, None).skeleton;
    let mut bones: Vec<u16> = Vec::with_capacity(skeleton.joints.len());
    for joint in &skeleton.joints {
        let own = rig.bones.iter().position(|bone| bone.joint == joint.name);
        let above = joint.parent.map_or(0, |parent| bones[parent]);
        bones.push(own.map_or(above, |bone| bone as u16));
    }
    let of_vertex = |vertex: usize| {
        let mut pairs: Vec<(u16, f64)> = Vec::new();
        for (node, weight) in scene.influences.of(vertex) {
            let bone = bones[order.joints[*node as usize]];
            match pairs.iter_mut().find(|pair| pair.0 == bone) {
                Some(pair) => pair.1 += f64::from(*weight),
                None => pairs.push((bone, f64::from(*weight))),
            }
        }
        BoneInfluences::from_pairs(&mut pairs).unwrap_or_else(|| BoneInfluences::one(0))
    };
    Ok((0..model.positions.len()).map(of_vertex).collect())
}

/// The joints of a vertex, as a file lists them.
pub fn carrying_joints(own: &BoneInfluences) -> CarryingJoints {
    let mut carrying = CarryingJoints::default();
    for (slot, (bone, weight)) in carrying.iter_mut().zip(own.iter()) {
        *slot = (bone as u32, weight as f32);
    }
    carrying
}

/// What is not solved where a clip moves a model that has a skin: primitives that no skin places, such as hulls for collisions, and
/// those whose names end in `lod1` or a higher number while others do not: coarser copies of what is solved. The model's own clip
/// moves them by their nodes and joints; with any other they ride along with the surface that is solved. Empty for a model without a
/// skin, or one whose skins place nothing.
///
/// # Errors
/// Those of [`Model::moving_scene`].
pub fn left_out_primitives(model: &Model) -> Result<Vec<usize>, Error> {
    let has_skin = |scene: &MovingScene| scene.is_joint.contains(&true) && scene.primitives.iter().any(|p| p.has_skin);
    let Some(scene) = model.moving_scene()?.filter(has_skin) else {
        return Ok(Vec::new());
    };
    let primitives = || scene.primitives.iter().map(|p| p.has_skin).zip(&model.primitives);
    let is_finest = |(has_skin, primitive): (bool, &Primitive)| has_skin && !is_coarser_level(primitive);
    let has_finest = primitives().any(is_finest);
    let left_out = primitives()
        .enumerate()
        .filter(|(_, (has_skin, primitive))| match has_finest {
            true => !is_finest((*has_skin, primitive)),
            false => !has_skin,
        });
    Ok(left_out.map(|(number, _)| number).collect())
}

/// Whether the name says that this is a coarser level of detail: `lod1`, `Body_LOD2`, `hair.lod-1`, but neither `lod0` nor `explod1`.
fn is_coarser_level(primitive: &Primitive) -> bool {
    let name = &primitive.name;
    let before = name.trim_end_matches(|c: char| c.is_ascii_digit());
    let is_coarser = name[before.len()..].bytes().any(|digit| digit != b'0');
    let word = before.strip_suffix(['_', '-', ' ', '.']).unwrap_or(before);
    let start = word.len().checked_sub(3).filter(|start| word.is_char_boundary(*start));
    let begins_a_word = |start: usize| !word[..start].ends_with(|c: char| c.is_alphabetic()) || word.ends_with("LOD");
    is_coarser && start.is_some_and(|start| word[start..].eq_ignore_ascii_case("lod") && begins_a_word(start))
}

/// Those primitives as what rides along when the model is opened.
///
/// # Errors
/// Those of [`Model::moving_scene`].
pub fn left_out_passengers(model: &Model) -> Result<Vec<Passenger>, Error> {
    let passenger = |number: usize| Passenger {
        name: model.primitives[number].name.clone(),
        kind: PassengerKind::Primitive(number as u32),
    };
    Ok(left_out_primitives(model)?.into_iter().map(passenger).collect())
}

/// Which primitives of a model with a skin are left out: one line for each reason, and one for those that are solved all the same,
/// because the session that has the model open does not have them as passengers. The model's own clip moves what is left out, so that
/// nothing is said of it then.
pub(super) fn left_out_warnings(
    model: &Model,
    primitives: &[Primitive],
    is_own_clip: bool,
) -> Result<Vec<String>, Error> {
    let numbers = left_out_primitives(model)?.into_iter();
    let (riding, solved): (Vec<usize>, Vec<usize>) =
        numbers.partition(|number| primitives.get(*number).is_some_and(|p| p.is_passenger));
    let mut lines = match is_own_clip {
        true => Vec::new(),
        false => reasons(model, riding, ["not solved"; 2]),
    };
    let consequences = [
        "solved with the body; a session that has it as a passenger leaves it out",
        "solved with the body; a session that has them as passengers leaves them out",
    ];
    lines.extend(reasons(model, solved, consequences));
    Ok(lines)
}

/// Why primitives are left out, one line for each reason, and what that means for one and for several.
fn reasons(model: &Model, numbers: Vec<usize>, consequences: [&str; 2]) -> Vec<String> {
    let (coarser, unskinned): (Vec<usize>, Vec<usize>) = numbers
        .into_iter()
        .partition(|number| is_coarser_level(&model.primitives[*number]));
    let reasons = [
        (unskinned, ["has no skin, and is", "have no skin, and are"]),
        (
            coarser,
            [
                "is a coarser level of detail, and is",
                "are coarser levels of detail, and are",
            ],
        ),
    ];
    let lines = reasons.into_iter().filter(|(numbers, _)| !numbers.is_empty());
    lines
        .map(|(numbers, [of_one, of_many])| {
            let (reason, consequence) = match numbers.len() {
                1 => (of_one, consequences[0]),
                _ => (of_many, consequences[1]),
            };
            format!("{} {reason} {consequence}", primitive_names(model, &numbers))
        })
        .collect()
}

/// The names of some primitives, or their numbers where they have none.
fn primitive_names(model: &Model, numbers: &[usize]) -> String {
    const LISTED: usize = 8;
    let name = |number: &usize| match model.primitives.get(*number) {
        Some(primitive) if !primitive.name.is_empty() => format!("\"{}\"", primitive.name),
        _ => format!("primitive {number}"),
    };
    let names: Vec<String> = numbers.iter().take(LISTED).map(name).collect();
    let more = numbers.len() - names.len();
    match more {
        0 => names.join(", "),
        _ => format!("{} and {more} more", names.join(", ")),
    }
}
