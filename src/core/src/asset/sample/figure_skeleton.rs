//! The figure's skeleton: joints where a body has them, named as VRM names a humanoid's, and how much each of them holds of a
//! place on the skin.

use glam::DVec3;

/// A rest joint; its axes are the world's.
pub(super) struct FigureJoint {
    pub name: String,
    /// Number of its parent.
    pub parent: Option<usize>,
    /// Where it is, in the world.
    pub place: DVec3,
    /// Axes of what it moves, from one end to the other, in the world.
    axes: Vec<[DVec3; 2]>,
}

/// What is known of a joint; one whose name begins with "left" has a twin at the right.
struct JointRow {
    name: &'static str,
    parent: &'static str,
    place: [f64; 3],
    axes: &'static [[[f64; 3]; 2]],
}

const fn row(name: &'static str, parent: &'static str, place: [f64; 3], axes: &'static [[[f64; 3]; 2]]) -> JointRow {
    JointRow {
        name,
        parent,
        place,
        axes,
    }
}

const ROWS: [JointRow; 11] = [
    row(
        "hips",
        "",
        [0.0, 0.95, 0.0],
        &[
            [[-0.05, 0.95, 0.0], [0.05, 0.95, 0.0]],
            [[0.0, 0.93, 0.0], [0.0, 1.03, 0.0]],
        ],
    ),
    row(
        "spine",
        "hips",
        [0.0, 1.07, 0.0],
        &[[[0.0, 1.09, 0.0], [0.0, 1.2, 0.0]]],
    ),
    row(
        "chest",
        "spine",
        [0.0, 1.24, 0.0],
        &[
            [[0.0, 1.25, 0.0], [0.0, 1.38, 0.0]],
            [[-0.1, 1.36, 0.0], [0.1, 1.36, 0.0]],
        ],
    ),
    row(
        "neck",
        "chest",
        [0.0, 1.45, -0.01],
        &[[[0.0, 1.46, -0.01], [0.0, 1.52, 0.0]]],
    ),
    row(
        "head",
        "neck",
        [0.0, 1.54, 0.0],
        &[[[0.0, 1.58, 0.01], [0.0, 1.68, 0.0]]],
    ),
    row(
        "leftUpperArm",
        "chest",
        [0.18, 1.40, 0.0],
        &[[[0.2, 1.4, 0.0], [0.43, 1.41, 0.0]]],
    ),
    row(
        "leftLowerArm",
        "leftUpperArm",
        [0.45, 1.41, 0.0],
        &[[[0.47, 1.41, 0.0], [0.67, 1.41, 0.0]]],
    ),
    row(
        "leftHand",
        "leftLowerArm",
        [0.70, 1.41, 0.0],
        &[
            [[0.72, 1.41, 0.0], [0.85, 1.405, 0.0]],
            [[0.74, 1.41, 0.03], [0.8, 1.41, 0.075]],
        ],
    ),
    row(
        "leftUpperLeg",
        "hips",
        [0.10, 0.90, 0.0],
        &[[[0.105, 0.86, 0.0], [0.11, 0.52, 0.01]]],
    ),
    row(
        "leftLowerLeg",
        "leftUpperLeg",
        [0.11, 0.49, 0.0],
        &[[[0.11, 0.46, 0.0], [0.11, 0.12, -0.01]]],
    ),
    row(
        "leftFoot",
        "leftLowerLeg",
        [0.11, 0.09, -0.01],
        &[[[0.11, 0.06, -0.04], [0.115, 0.04, 0.15]]],
    ),
];

/// All joints, parents first.
pub(super) fn skeleton() -> Vec<FigureJoint> {
    let mut joints: Vec<FigureJoint> = Vec::new();
    for side in ["left", "right"] {
        let mirror = if side == "left" { 1.0 } else { -1.0 };
        let across = DVec3::new(mirror, 1.0, 1.0);
        for row in &ROWS {
            // What lies in the middle is there once.
            if side == "right" && !row.name.starts_with("left") {
                continue;
            }
            let parent = row.parent.replace("left", side);
            let joint = FigureJoint {
                name: row.name.replace("left", side),
                parent: joints.iter().position(|joint| joint.name == parent),
                place: DVec3::from_array(row.place) * across,
                axes: row
                    .axes
                    .iter()
                    .map(|ends| ends.map(|end| DVec3::from_array(end) * across))
                    .collect(),
            };
            joints.push(joint);
        }
    }
    joints
}

/// The joints that hold a place, at most four, and how much each of them does: the nearer, the more. What all but the nearest four
/// have is taken from everyone, so that weights go to zero before a joint is left out.
pub(super) fn joint_weights(joints: &[FigureJoint], place: DVec3) -> ([u8; 4], [f32; 4]) {
    let mut shares: Vec<(f64, usize)> = joints
        .iter()
        .map(|joint| joint.axes.iter().map(|&ends| distance_to(ends, place)))
        .map(|distances| distances.fold(f64::INFINITY, f64::min).max(1e-3))
        .map(|distance| 1.0 / (distance * distance * distance * distance))
        .zip(0..)
        .collect();
    shares.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let spare = shares[4].0;
    let sum: f64 = shares[..4].iter().map(|(share, _)| share - spare).sum();
    let of = |k: usize| ((shares[k].0 - spare) / sum) as f32;
    (
        std::array::from_fn(|k| if of(k) > 0.0 { shares[k].1 as u8 } else { 0 }),
        std::array::from_fn(of),
    )
}

fn distance_to([start, end]: [DVec3; 2], place: DVec3) -> f64 {
    let axis = end - start;
    let along = ((place - start).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
    place.distance(start + axis * along)
}
