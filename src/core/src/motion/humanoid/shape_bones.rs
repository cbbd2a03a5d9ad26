//! Which joints of a clip turn the bones of a body, by how its skeleton branches.

use super::clip_bones::{ClipBones, add_trunk};
use crate::motion::skeleton::Skeleton;
use glam::DVec3;

/// Finds bones by shape alone: legs are the two branches that reach lowest, the head the one that reaches highest, arms
/// those that reach farthest to both sides. Left is where x rises. `None` where there are no such branches.
pub fn bones_of_shape(skeleton: &Skeleton) -> Option<ClipBones> {
    let world = skeleton.world_transforms(&skeleton.rest_pose());
    let places: Vec<DVec3> = world.iter().map(|w| w.translation).collect();
    let joints = &skeleton.joints;
    let mut is_leaf = vec![true; joints.len()];
    joints.iter().filter_map(|j| j.parent).for_each(|p| is_leaf[p] = false);
    let leaves: Vec<usize> = (0..joints.len()).filter(|j| is_leaf[*j]).collect();
    let low = places.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
    let high = places.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
    let tall = if high.z - low.z > 1.2 * (high.y - low.y) {
        DVec3::Z
    } else {
        DVec3::Y
    };
    let way = |joint: usize| {
        let up = std::iter::successors(Some(joint), |j| joints[*j].parent);
        let mut path: Vec<usize> = up.collect();
        path.reverse();
        path
    };
    let best = |score: &dyn Fn(usize) -> f64| {
        let ranked = leaves.iter().copied().map(|leaf| (score(leaf), leaf));
        ranked
            .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
            .map(|best| best.1)
    };
    let side_of = |leaf: usize| places[leaf].x - places[0].x;
    let on_side = |sign: f64, leaf: usize| {
        if side_of(leaf) * sign > 0.0 {
            0.0
        } else {
            f64::NEG_INFINITY
        }
    };
    let head = best(&|leaf| places[leaf].dot(tall) - side_of(leaf).abs())?;
    let mut bones = ClipBones::new();
    let mut hips = None;
    for (sign, arm, leg) in [
        (1.0, ["lUpper", "lFore", "lHand"], ["lThigh", "lShin", "lFoot"]),
        (-1.0, ["rUpper", "rFore", "rHand"], ["rThigh", "rShin", "rFoot"]),
    ] {
        let foot = best(&|leaf| on_side(sign, leaf) - places[leaf].dot(tall))?;
        let hand = best(&|leaf| on_side(sign, leaf) + side_of(leaf).abs() + 0.25 * places[leaf].dot(tall))?;
        for (leaf, ids) in [(foot, leg), (hand, arm)] {
            let path = way(leaf);
            let trunk = way(head);
            let shared = path.iter().zip(&trunk).take_while(|(a, b)| a == b).count();
            let first = two_longest(&path[shared..], &places)?;
            let chosen = path[shared..].iter().skip(first);
            ids.iter()
                .zip(chosen)
                .for_each(|(id, joint)| _ = bones.insert(id, *joint));
            if leaf == foot {
                hips = path.get(shared.checked_sub(1)?).copied();
            }
        }
    }
    bones.insert("pelvis", hips?);
    // The head's own joint has its end below it.
    let head_joint = if joints[head].parent.is_some() {
        head
    } else {
        return None;
    };
    add_trunk(skeleton, Some(head_joint), &mut bones);
    ["lShin", "rShin", "lFore", "rFore"]
        .iter()
        .all(|b| bones.contains_key(b))
        .then_some(bones)
}

/// Where the two bones begin that are longest together, one after the other.
fn two_longest(path: &[usize], places: &[DVec3]) -> Option<usize> {
    let length = |k: usize| places[path[k]].distance(places[path[k + 1]]);
    let starts = 0..path.len().checked_sub(2)?;
    let ranked = starts.map(|k| (length(k).min(length(k + 1)), k));
    ranked
        .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
        .map(|best| best.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::skeleton::{JointPose, SkeletonJoint};

    #[test]
    fn a_figure_without_names_is_told_by_its_branches() {
        let mut joints: Vec<SkeletonJoint> = Vec::new();
        let mut add = |parent: Option<usize>, x: f64, y: f64| {
            joints.push(SkeletonJoint {
                name: String::new(),
                parent,
                rest: JointPose::at(DVec3::new(x, y, 0.0)),
            });
            joints.len() - 1
        };
        let hips = add(None, 0.0, 10.0);
        let spine = add(Some(hips), 0.0, 3.0);
        let chest = add(Some(spine), 0.0, 3.0);
        let neck = add(Some(chest), 0.0, 2.0);
        add(Some(neck), 0.0, 2.0);
        let mut expected = Vec::new();
        for (sign, ids) in [
            (1.0, ["lUpper", "lFore", "lThigh", "lShin"]),
            (-1.0, ["rUpper", "rFore", "rThigh", "rShin"]),
        ] {
            let collar = add(Some(chest), 0.5 * sign, 1.5);
            let upper = add(Some(collar), 1.0 * sign, 0.0);
            let fore = add(Some(upper), 3.0 * sign, 0.0);
            let hand = add(Some(fore), 3.0 * sign, 0.0);
            add(Some(hand), 1.0 * sign, 0.0);
            let thigh = add(Some(hips), 1.0 * sign, -0.5);
            let shin = add(Some(thigh), 0.0, -4.5);
            let foot = add(Some(shin), 0.0, -4.5);
            add(Some(foot), 0.0, -0.4);
            expected.extend(ids.into_iter().zip([upper, fore, thigh, shin]));
        }
        let bones = bones_of_shape(&Skeleton { joints }).expect("a figure");
        for (bone, joint) in expected {
            assert_eq!(bones[bone], joint, "{bone}");
        }
        assert_eq!((bones["pelvis"], bones["chest"]), (hips, chest));
        let one = Skeleton {
            joints: vec![SkeletonJoint {
                name: String::new(),
                parent: None,
                rest: JointPose::at(DVec3::ZERO),
            }],
        };
        assert!(bones_of_shape(&one).is_none());
    }
}
