//! Joints: those of a model's skin, or those that are found in the shape of a body; and the words for them.

use super::figure::RestFigure;
use super::vertex_set::VertexSet;
use glam::DVec3;
use pliant_asset::{Model, MovingScene};
use pliant_core::engine::{Error, RigOrder};
use pliant_motion::humanoid::bones_of_names;
use pliant_motion::{JointPose, Skeleton, SkeletonJoint};
use std::collections::{BTreeMap, BTreeSet};

/// A vertex that no joint holds.
const HELD_BY_NONE: u16 = u16::MAX;
/// What lies near a joint, as a share of the length of the bone that begins there.
const NEAR: f64 = 0.35;

/// Joints, and which of them holds each render vertex most.
#[derive(Debug, Clone)]
pub(crate) struct Joints {
    /// Whether the file has them; else they were found in the shape.
    pub of_file: bool,
    /// By number: name, the joint above, where it is in model space.
    pub joints: Vec<Joint>,
    holder: Vec<u16>,
    /// The bones of a body that are known, by their ids, such as `lUpper`.
    bones: BTreeMap<&'static str, usize>,
}

/// One of them.
#[derive(Debug, Clone)]
pub(crate) struct Joint {
    pub name: String,
    pub parent: Option<usize>,
    pub at: DVec3,
}

/// How much of a limb words mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LimbExtent {
    /// From the joint on to the ends.
    Onwards,
    /// What the bone itself holds.
    Own,
    /// What lies near the joint.
    Near,
}

/// Words for limbs, and the bone of a body without its side.
const LIMBS: [(&[&str], &str, LimbExtent); 16] = [
    (&["arm"], "Upper", LimbExtent::Onwards),
    (&["upper arm", "upperarm", "biceps"], "Upper", LimbExtent::Own),
    (&["shoulder", "clavicle", "collar"], "Clav", LimbExtent::Own),
    (&["forearm", "lower arm", "lowerarm"], "Fore", LimbExtent::Own),
    (&["elbow"], "Fore", LimbExtent::Near),
    (&["hand", "palm", "fist"], "Hand", LimbExtent::Onwards),
    (&["wrist"], "Hand", LimbExtent::Near),
    (&["leg"], "Thigh", LimbExtent::Onwards),
    (&["thigh", "upper leg", "upperleg"], "Thigh", LimbExtent::Own),
    (&["knee"], "Shin", LimbExtent::Near),
    (
        &["shin", "calf", "calve", "lower leg", "lowerleg"],
        "Shin",
        LimbExtent::Own,
    ),
    (&["foot"], "Foot", LimbExtent::Onwards),
    (&["ankle"], "Foot", LimbExtent::Near),
    (&["paw"], "Foot", LimbExtent::Onwards),
    (&["hip joint"], "Thigh", LimbExtent::Near),
    (&["armpit"], "Upper", LimbExtent::Near),
];
/// Words for the trunk, and its bones.
const TRUNK: [(&[&str], &[&str], LimbExtent); 6] = [
    (&["head", "skull", "face"], &["head"], LimbExtent::Onwards),
    (&["neck", "throat"], &["neck"], LimbExtent::Own),
    (
        &["chest", "upper body", "ribs"],
        &["chest", "lClav", "rClav"],
        LimbExtent::Own,
    ),
    (&["hips", "hip", "pelvis", "waist"], &["pelvis"], LimbExtent::Own),
    (
        &["spine", "belly", "abdomen", "stomach"],
        &["abdomen", "chest"],
        LimbExtent::Own,
    ),
    (
        &["torso", "trunk", "body"],
        &["pelvis", "abdomen", "chest", "lClav", "rClav"],
        LimbExtent::Own,
    ),
];
/// Names of fingers in files.
const FINGERS: [&str; 7] = ["finger", "thumb", "index", "middle", "ring", "pinky", "little"];

impl Joints {
    /// The joints of a model: of its skin, else of the body that its shape is. `None` where it is none.
    pub fn of(figure: &RestFigure<'_>) -> Result<Option<Self>, Error> {
        let model = figure.deformer.model();
        if let Some(scene) = model.moving_scene()?
            && scene.is_joint.contains(&true)
            && !figure.deformer.is_edited()
        {
            let own = Self::of_scene(model, &scene)?;
            // Joints without names can be asked for by none; those of a body are found in the shape then.
            let is_named = own.joints.iter().any(|joint| !joint.name.is_empty());
            return match is_named {
                true => Ok(Some(own)),
                false => Ok(Self::of_rig(figure, Some("cmu"))?.or(Some(own))),
            };
        }
        Self::of_rig(figure, None)
    }

    fn of_scene(model: &Model, scene: &MovingScene) -> Result<Self, Error> {
        let nodes = model.nodes()?.unwrap_or_default();
        let mut number: Vec<Option<usize>> = vec![None; scene.nodes.len()];
        let mut joints: Vec<Joint> = Vec::new();
        // A joint comes after those above it: roots first, then level by level.
        let mut waiting: Vec<usize> = (0..scene.nodes.len())
            .filter(|n| scene.nodes[*n].parent.is_none())
            .collect();
        let mut below: Vec<Vec<usize>> = vec![Vec::new(); scene.nodes.len()];
        for (n, node) in scene.nodes.iter().enumerate() {
            if let Some(parent) = node.parent.and_then(|p| below.get_mut(p)) {
                parent.push(n);
            }
        }
        let mut above: Vec<Option<usize>> = vec![None; scene.nodes.len()];
        while let Some(n) = waiting.pop() {
            let mut nearest = above[n];
            if scene.is_joint.get(n) == Some(&true) {
                number[n] = Some(joints.len());
                joints.push(Joint {
                    name: scene.nodes[n].name.clone(),
                    parent: nearest,
                    at: nodes
                        .get(n)
                        .map_or(DVec3::ZERO, |node| node.world_from_node.translation),
                });
                nearest = number[n];
            }
            for &next in below[n].iter().rev() {
                above[next] = nearest;
                waiting.push(next);
            }
        }
        let of_vertex = |vertex: usize| {
            let own = scene.influences.of(vertex).iter();
            let heaviest = own.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
            let joint = heaviest.and_then(|(node, _)| number.get(*node as usize).copied().flatten());
            joint.and_then(|j| u16::try_from(j).ok()).unwrap_or(HELD_BY_NONE)
        };
        let skeleton = Skeleton {
            joints: (joints.iter())
                .map(|joint| SkeletonJoint {
                    name: joint.name.clone(),
                    parent: joint.parent,
                    rest: JointPose::at(DVec3::ZERO),
                })
                .collect(),
        };
        Ok(Self {
            of_file: true,
            holder: (0..model.positions.len()).map(of_vertex).collect(),
            bones: bones_of_names(&skeleton).unwrap_or_default(),
            joints,
        })
    }

    /// The joints of the rig that the model's skin or its shape makes.
    fn of_rig(figure: &RestFigure<'_>, preset: Option<&str>) -> Result<Option<Self>, Error> {
        let order = RigOrder {
            up: Some(figure.axes.up),
            front: Some(figure.axes.front),
            preset,
            ..RigOrder::default()
        };
        let made = match figure.deformer.make_rig(&order, figure.exec) {
            Ok(made) => made,
            Err(Error::Cancelled) => return Err(Error::Cancelled),
            Err(_) => return Ok(None),
        };
        if made.check().is_err() {
            return Ok(None);
        }
        let bound = figure.deformer.bind(&made.rig, 4, figure.exec)?;
        let of_file = made.source == "skin";
        let joint = |bone: &pliant_motion::rig::RigBone| Joint {
            name: if of_file { bone.joint.clone() } else { bone.id.clone() },
            parent: bone.parent,
            at: bone.from,
        };
        let joints: Vec<Joint> = made.rig.bones.iter().map(joint).collect();
        let ids = pliant_motion::humanoid::BODY_BONES.iter().map(|bone| bone.id);
        let bones = match of_file {
            false => ids
                .filter_map(|id| Some((id, joints.iter().position(|j| j.name == id)?)))
                .collect(),
            true => {
                let skeleton = Skeleton {
                    joints: (joints.iter())
                        .map(|joint| SkeletonJoint {
                            name: joint.name.clone(),
                            parent: joint.parent,
                            rest: JointPose::at(DVec3::ZERO),
                        })
                        .collect(),
                };
                bones_of_names(&skeleton).unwrap_or_default()
            }
        };
        Ok(Some(Self {
            of_file,
            holder: bound
                .iter()
                .map(|own| own.iter().next().map_or(HELD_BY_NONE, |(bone, _)| bone as u16))
                .collect(),
            bones,
            joints,
        }))
    }

    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        let names: usize = self
            .joints
            .iter()
            .map(|joint| size_of::<Joint>() + joint.name.len())
            .sum();
        (names + 2 * self.holder.len()) as u64
    }

    /// Whether words name a part that bodies have.
    pub fn is_body_part(words: &[String]) -> bool {
        let limbs = LIMBS.iter().flat_map(|limb| limb.0);
        let mut names = limbs.chain(TRUNK.iter().flat_map(|part| part.0));
        names.any(|name| {
            name.split(' ')
                .all(|own| words.iter().any(|w| singular(w) == own || w == own))
        })
    }

    /// What can be asked for, for a sentence.
    pub fn words(&self) -> Vec<String> {
        let mut words: Vec<String> = Vec::new();
        for (own, bone, _) in &LIMBS {
            if ["l", "r"]
                .iter()
                .all(|side| self.bones.contains_key(format!("{side}{bone}").as_str()))
            {
                words.extend(own.first().map(|word| format!("left/right {word}")));
            }
        }
        for (own, bones, _) in &TRUNK {
            if bones.iter().any(|bone| self.bones.contains_key(bone)) {
                words.extend(own.first().map(|word| (*word).to_owned()));
            }
        }
        words
    }

    /// What holds these joints, and the joints below them where `onwards`.
    fn held(&self, figure: &RestFigure<'_>, roots: &[usize], onwards: bool) -> VertexSet {
        let mut is_in = vec![false; self.joints.len()];
        for (j, joint) in self.joints.iter().enumerate() {
            is_in[j] = roots.contains(&j) || onwards && joint.parent.is_some_and(|p| is_in[p]);
        }
        let own = VertexSet::of(figure.count(), |v| {
            let holder = self.holder.get(v).copied().unwrap_or(HELD_BY_NONE);
            is_in.get(usize::from(holder)).copied().unwrap_or(false)
        });
        own.and(&figure.all)
    }

    /// What lies near where a joint is, of what it and the joint above hold.
    fn near(&self, figure: &RestFigure<'_>, joint: usize) -> VertexSet {
        let own = &self.joints[joint];
        let ends = self
            .joints
            .iter()
            .filter(|j| j.parent == Some(joint))
            .map(|j| j.at.distance(own.at));
        let above = own.parent.map_or(0.0, |p| self.joints[p].at.distance(own.at));
        let length = ends.fold(above, f64::max);
        let around: Vec<usize> = own.parent.into_iter().chain([joint]).collect();
        let rest = figure.deformer.rest();
        let is_near = VertexSet::of(figure.count(), |v| rest[v].distance(own.at) < NEAR * length);
        self.held(figure, &around, false).and(&is_near)
    }

    /// What words for parts of a body mean: the vertices, the joint that they turn about, and what it is called.
    pub fn body_part(&self, figure: &RestFigure<'_>, words: &[&str]) -> Option<(VertexSet, Option<DVec3>, String)> {
        let sides: Vec<&str> = match words.iter().find(|w| matches!(**w, "left" | "right")) {
            Some(&"left") => vec!["l"],
            Some(_) => vec!["r"],
            None => vec!["l", "r"],
        };
        let rest: Vec<String> = words
            .iter()
            .filter(|w| !matches!(**w, "left" | "right" | "both"))
            .map(|w| singular(w))
            .collect();
        let name = rest.join(" ");
        let (roots, reach) = if let Some((_, bone, reach)) = LIMBS.iter().find(|(own, ..)| own.contains(&name.as_str()))
        {
            let found = sides
                .iter()
                .filter_map(|side| self.bones.get(format!("{side}{bone}").as_str()).copied());
            (found.collect::<Vec<usize>>(), *reach)
        } else {
            let plain = words.join(" ");
            let (_, bones, reach) = TRUNK.iter().find(|(own, ..)| own.contains(&plain.as_str()))?;
            (
                bones.iter().filter_map(|bone| self.bones.get(bone).copied()).collect(),
                *reach,
            )
        };
        let first = *roots.first()?;
        let set = match reach {
            LimbExtent::Near => {
                (roots.iter()).fold(VertexSet::none(figure.count()), |set, j| set.or(&self.near(figure, *j)))
            }
            reach => self.held(figure, &roots, reach == LimbExtent::Onwards),
        };
        let names: Vec<&str> = roots.iter().map(|j| self.joints[*j].name.as_str()).collect();
        let pivot =
            (roots.len() == 1 || matches!(reach, LimbExtent::Own) && sides.len() == 2).then(|| self.joints[first].at);
        let what = if self.of_file {
            "the file's joint"
        } else {
            "a joint found in the shape,"
        };
        Some((set, pivot, format!("{what} {}{}", names.join(", "), told(reach))))
    }

    /// What joints hold whose names have all of the words: from the topmost of them on.
    pub fn named(&self, figure: &RestFigure<'_>, words: &[&str]) -> Option<(VertexSet, Option<DVec3>, String)> {
        let wanted: BTreeSet<String> = words.iter().map(|w| singular(w)).collect();
        let fits = |joint: &Joint| {
            let own = name_words(&joint.name);
            let is_finger = own.iter().any(|w| FINGERS.contains(&w.as_str()));
            wanted.iter().all(|w| own.contains(w) || w == "finger" && is_finger)
        };
        let is_fit: Vec<bool> = self.joints.iter().map(fits).collect();
        let mut roots: Vec<usize> = Vec::new();
        for (j, joint) in self.joints.iter().enumerate() {
            let mut above = joint.parent;
            while let Some(p) = above.filter(|p| !is_fit[*p]) {
                above = self.joints[p].parent;
            }
            if is_fit[j] && above.is_none() {
                roots.push(j);
            }
        }
        let first = *roots.first()?;
        let names: Vec<&str> = roots.iter().take(6).map(|j| self.joints[*j].name.as_str()).collect();
        let how = format!("the file's joint {} and all below", names.join(", "));
        let pivot = (roots.len() == 1).then(|| self.joints[first].at);
        Some((self.held(figure, &roots, true), pivot, how))
    }
}

fn told(reach: LimbExtent) -> &'static str {
    match reach {
        LimbExtent::Onwards => " and all beyond it",
        LimbExtent::Own => " alone",
        LimbExtent::Near => ", and what lies near it",
    }
}

/// A word that names one of what it names several of.
fn singular(word: &str) -> String {
    match word {
        "feet" => "foot".to_owned(),
        "calves" => "calf".to_owned(),
        _ if word.len() > 3 && word.ends_with('s') && !word.ends_with("ss") => word[..word.len() - 1].to_owned(),
        _ => word.to_owned(),
    }
}

/// The words of a name in a file, one for several of a kind, with sides written out.
pub(crate) fn name_words(name: &str) -> Vec<String> {
    let mut words = pliant_asset::name_words(name);
    for word in &mut words {
        match word.as_str() {
            "l" | "lft" | "lf" => *word = "left".to_owned(),
            "r" | "rgt" | "rt" => *word = "right".to_owned(),
            _ => *word = singular(word),
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_parted_into_words_with_sides() {
        for (name, words) in [
            ("mixamorig:LeftForeArm", vec!["mixamorig", "left", "fore", "arm"]),
            ("hand_l", vec!["hand", "left"]),
            ("UpperArm.R", vec!["upper", "arm", "right"]),
            ("Tail_03", vec!["tail", "03"]),
            ("Pot Lid", vec!["pot", "lid"]),
        ] {
            assert_eq!(name_words(name), words, "{name}");
        }
    }
}
