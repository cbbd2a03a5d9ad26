//! What a rig is made of, and whether it holds together.

use crate::signed_axis::SignedAxis;
use glam::DVec3;
use std::collections::BTreeMap;

/// How many characters of a name are shown.
const LONGEST_SHOWN: usize = 64;

/// How a bone of the model stands when the clip is in its reference pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RestAttitude {
    /// It points where the clip's bone points, reached by the least turn.
    #[default]
    Direction,
    /// As in the model: the trunk, a head, feet.
    Orientation,
    /// As its parent carries it: hands and fingers.
    Parent,
}

/// The pose of the clip that the model's bones are fitted to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReferencePose {
    /// The skeleton as the file lists it, before any frame.
    Rest,
    /// A frame, from 0.
    Frame(usize),
}

/// A bone of a model, and the joint of a clip that turns it.
#[derive(Debug, Clone, PartialEq)]
pub struct RigBone {
    /// The name, unique in the rig.
    pub id: String,
    /// Number of the bone that it hangs on; `None` for the root.
    pub parent: Option<usize>,
    /// Where it begins in the rest pose, model space: it turns about this point.
    pub from: DVec3,
    /// Where it ends.
    pub to: DVec3,
    /// Name of the clip's joint that turns it.
    pub joint: String,
    /// Name of the clip's joint that it points at; `None`: the first below `joint` that lies elsewhere.
    pub aim: Option<String>,
    /// How it stands in the reference pose.
    pub rest: RestAttitude,
    /// How far the model's surface is around it, about, in model units.
    pub radius: f64,
    /// Into how many slices the rotations along it are parted; with 1 it is turned as one.
    pub slices: usize,
    /// From where to where along it rotations are held, as shares of its length.
    pub span: [f64; 2],
    /// The radius of the sphere that holds its beginning in place, in model units; `None`: by `radius`.
    pub joint_radius: Option<f64>,
    /// By how much it may be turned against its parent, beyond how it stands in the reference pose, in degrees.
    pub limit_degrees: Option<f64>,
}

impl RigBone {
    /// A bone from one point to another, turned as one by the joint of its name.
    pub fn along(id: impl Into<String>, from: DVec3, to: DVec3, radius: f64) -> Self {
        let id = id.into();
        Self {
            joint: id.clone(),
            id,
            parent: None,
            from,
            to,
            aim: None,
            rest: RestAttitude::default(),
            radius,
            slices: 1,
            span: [0.15, 0.85],
            joint_radius: None,
            limit_degrees: None,
        }
    }

    /// Its direction in the rest pose, of unit length; `None` for a bone without length.
    pub fn direction(&self) -> Option<DVec3> {
        (self.to - self.from).try_normalize()
    }
}

/// Which bones of a model a clip's joints drive.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionRig {
    /// The bones; parents come before their children, and the first is the root.
    pub bones: Vec<RigBone>,
    /// What the model's bones are fitted to.
    pub reference: ReferencePose,
    /// Model units for one unit of the clip; `None`: by the lengths of the legs, without legs by those of all bones.
    pub scale: Option<f64>,
    /// The vertical of the model.
    pub up: SignedAxis,
}

/// Why a rig cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RigError {
    /// A bone is not what it may be.
    #[error("bones[{bone}].{field}: {problem}")]
    Bone {
        /// Its number.
        bone: usize,
        /// What of it.
        field: &'static str,
        /// What is wrong, and what is allowed.
        problem: String,
    },
    /// The rig as a whole, or the clip that is to drive it.
    #[error("{field}: {problem}")]
    Field {
        /// What of it.
        field: &'static str,
        /// What is wrong, and what is allowed.
        problem: String,
    },
}

impl RigError {
    /// Makes the error of a field of the rig as a whole, or of the clip.
    pub fn field(field: &'static str, problem: impl Into<String>) -> Self {
        let problem = problem.into();
        Self::Field { field, problem }
    }
}

impl MotionRig {
    /// The bone in one piece that continues a limb: what it twists runs back into the bone that it hangs on.
    pub(super) fn continued_by(&self, bone: usize) -> Option<usize> {
        self.bones.iter().position(|b| b.parent == Some(bone) && b.slices < 2)
    }

    /// The most bones of a rig.
    pub const MOST_BONES: usize = 1024;
    /// The largest coordinate and the largest scale: what is computed from such numbers is far from the end of doubles.
    pub const FARTHEST: f64 = 1e12;
    /// The scales that are allowed.
    pub const SCALES: std::ops::RangeInclusive<f64> = 1.0 / Self::FARTHEST..=Self::FARTHEST;
    /// The most slices of a bone.
    pub const MOST_SLICES: usize = 16;

    /// Puts parents before their children and checks that there is one root, that nothing hangs on itself and that all
    /// numbers are what they may be. `parents` has, by bone, the name of the one that it hangs on.
    ///
    /// # Errors
    /// [`RigError`] with the bone and field.
    pub fn from_named_parents(
        bones: Vec<RigBone>,
        parents: &[Option<String>],
        reference: ReferencePose,
        scale: Option<f64>,
    ) -> Result<Self, RigError> {
        if bones.is_empty() || bones.len() > Self::MOST_BONES {
            let (count, most) = (bones.len(), Self::MOST_BONES);
            return Err(RigError::field(
                "bones",
                format!("has {count} entries, allowed are 1 to {most}"),
            ));
        }
        if let Some(scale) = scale.filter(|s| !Self::SCALES.contains(s)) {
            let most = Self::FARTHEST;
            return Err(RigError::field(
                "scale",
                format!("is {scale}, a number from 1 / {most:e} to {most:e} is needed"),
            ));
        }
        let mut number = BTreeMap::new();
        for (bone, own) in bones.iter().enumerate() {
            check_bone(bone, own)?;
            if number.insert(own.id.as_str(), bone).is_some() {
                let problem = format!("is \"{}\", as another bone is called", own.id);
                return Err(RigError::Bone {
                    bone,
                    field: "id",
                    problem,
                });
            }
        }
        let mut above = Vec::with_capacity(bones.len());
        for (bone, parent) in parents.iter().enumerate().take(bones.len()) {
            let found = parent.as_deref().map(|name| number.get(name).copied().ok_or(name));
            above.push(found.transpose().map_err(|name| {
                let problem = format!(
                    "is \"{name}\", there is no such bone; there are {}",
                    listed_names(number.keys())
                );
                RigError::Bone {
                    bone,
                    field: "parent",
                    problem,
                }
            })?);
        }
        above.resize(bones.len(), None);
        let order = parents_first(&bones, &above)?;
        let mut place = vec![0; bones.len()];
        order.iter().enumerate().for_each(|(at, &bone)| place[bone] = at);
        let sorted = order.iter().map(|&bone| RigBone {
            parent: above[bone].map(|p| place[p]),
            ..bones[bone].clone()
        });
        Ok(Self {
            bones: sorted.collect(),
            reference,
            scale,
            up: SignedAxis::Y,
        })
    }
}

/// Up to eight names, in quotes.
pub(crate) fn listed_names<S: AsRef<str>>(names: impl Iterator<Item = S>) -> String {
    let mut names = names;
    let shown = names
        .by_ref()
        .take(8)
        .map(|n| format!("\"{}\"", name_in_line(n.as_ref())));
    let shown: Vec<String> = shown.collect();
    let more = names.count();
    match more {
        0 => shown.join(", "),
        _ => format!("{} and {more} more", shown.join(", ")),
    }
}

/// A name of a file as it can stand in a line: no longer than is needed, and without control characters.
fn name_in_line(name: &str) -> String {
    let printed = |c: char| {
        if c.is_control() {
            c.escape_default().to_string()
        } else {
            c.into()
        }
    };
    let shown: String = name.chars().take(LONGEST_SHOWN).map(printed).collect();
    match name.chars().nth(LONGEST_SHOWN) {
        Some(_) => format!("{shown}…"),
        None => shown,
    }
}

fn check_bone(bone: usize, own: &RigBone) -> Result<(), RigError> {
    let refuse = |field, problem| Err(RigError::Bone { bone, field, problem });
    if own.id.is_empty() {
        return refuse("id", "is empty, a name is needed".into());
    }
    if own.joint.is_empty() {
        return refuse("joint", "is empty, the name of a joint of the clip is needed".into());
    }
    for (field, point) in [("from", own.from), ("to", own.to)] {
        if !point.is_finite() {
            return refuse(field, "is not a point of finite numbers".into());
        }
        if point.abs().max_element() > MotionRig::FARTHEST {
            let most = MotionRig::FARTHEST;
            return refuse(
                field,
                format!("is {point}, coordinates from -{most:e} to {most:e} are allowed"),
            );
        }
    }
    let is_length = |r: f64| r > 0.0 && r <= MotionRig::FARTHEST;
    let needed = |r: f64| match r > 0.0 {
        true => format!("is {r}, at most {:e} is allowed", MotionRig::FARTHEST),
        false => format!("is {r}, a number above 0 is needed"),
    };
    if !is_length(own.radius) {
        return refuse("radius", needed(own.radius));
    }
    if let Some(radius) = own.joint_radius.filter(|r| !is_length(*r)) {
        return refuse("jointRadius", needed(radius));
    }
    if own.slices == 0 || own.slices > MotionRig::MOST_SLICES {
        let most = MotionRig::MOST_SLICES;
        return refuse("slices", format!("is {}, allowed are 1 to {most}", own.slices));
    }
    let [low, high] = own.span;
    if !(0.0 <= low && low < high && high <= 1.0) {
        let problem = format!("is [{low}, {high}], two rising shares from 0 to 1 are needed");
        return refuse("span", problem);
    }
    match own.limit_degrees {
        Some(limit) if !(0.0..=180.0).contains(&limit) => {
            refuse("limitDegrees", format!("is {limit}, allowed are 0 to 180"))
        }
        _ => Ok(()),
    }
}

/// All bones, each after its parent, the root first; else in the order given.
fn parents_first(bones: &[RigBone], above: &[Option<usize>]) -> Result<Vec<usize>, RigError> {
    let mut children = vec![Vec::new(); bones.len()];
    let mut roots = Vec::new();
    for (bone, parent) in above.iter().enumerate() {
        match parent {
            Some(parent) => children[*parent].push(bone),
            None => roots.push(bone),
        }
    }
    if roots.len() > 1 {
        let names = listed_names(roots.iter().map(|&b| bones[b].id.as_str()));
        return Err(RigError::field(
            "bones",
            format!("{names} have no parent; all but one bone need one"),
        ));
    }
    let mut order = Vec::with_capacity(bones.len());
    let mut open = roots;
    while let Some(bone) = open.pop() {
        order.push(bone);
        open.extend(children[bone].iter().rev());
    }
    if order.len() == bones.len() {
        return Ok(order);
    }
    let mut reached = vec![false; bones.len()];
    order.iter().for_each(|&bone| reached[bone] = true);
    let caught = (0..bones.len()).filter(|&b| !reached[b]);
    let names = listed_names(caught.map(|b| bones[b].id.as_str()));
    Err(RigError::field("bones", format!("the parents of {names} form a cycle")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bone(id: &str) -> RigBone {
        RigBone::along(id, DVec3::ZERO, DVec3::Y, 0.1)
    }

    fn rig(bones: Vec<RigBone>, parents: &[Option<&str>]) -> Result<MotionRig, RigError> {
        let parents: Vec<Option<String>> = parents.iter().map(|p| p.map(str::to_owned)).collect();
        MotionRig::from_named_parents(bones, &parents, ReferencePose::Rest, None)
    }

    #[test]
    fn bones_come_after_their_parents_in_any_order_given() {
        let found = rig(
            vec![bone("hand"), bone("arm"), bone("trunk")],
            &[Some("arm"), Some("trunk"), None],
        );
        let bones = found.expect("a rig").bones;
        let reported: Vec<_> = bones.iter().map(|b| (b.id.as_str(), b.parent)).collect();
        assert_eq!(reported, [("trunk", None), ("arm", Some(0)), ("hand", Some(1))]);
    }

    #[test]
    fn rigs_that_do_not_hold_together_are_refused_with_the_bone() {
        let refused =
            |bones: Vec<RigBone>, parents: &[Option<&str>]| rig(bones, parents).expect_err("refused").to_string();
        let reported = refused(vec![bone("a"), bone("b")], &[None, None]);
        assert_eq!(
            reported,
            "bones: \"a\", \"b\" have no parent; all but one bone need one"
        );
        let reported = refused(vec![bone("a"), bone("b"), bone("c")], &[None, Some("c"), Some("b")]);
        assert_eq!(reported, "bones: the parents of \"b\", \"c\" form a cycle");
        let reported = refused(vec![bone("a")], &[Some("x")]);
        assert_eq!(
            reported,
            "bones[0].parent: is \"x\", there is no such bone; there are \"a\""
        );
        assert_eq!(refused(vec![], &[]), "bones: has 0 entries, allowed are 1 to 1024");
        let wrong = |change: &dyn Fn(&mut RigBone)| {
            let mut one = bone("a");
            change(&mut one);
            refused(vec![one], &[None])
        };
        assert_eq!(
            wrong(&|b| b.radius = 0.0),
            "bones[0].radius: is 0, a number above 0 is needed"
        );
        assert_eq!(
            wrong(&|b| b.to.x = f64::NAN),
            "bones[0].to: is not a point of finite numbers"
        );
        assert!(wrong(&|b| b.span = [0.9, 0.1]).starts_with("bones[0].span: is [0.9, 0.1]"));
        assert!(wrong(&|b| b.slices = 0).starts_with("bones[0].slices: is 0"));
        assert!(wrong(&|b| b.limit_degrees = Some(-1.0)).starts_with("bones[0].limitDegrees"));
    }
}
