//! Joints of figures that are made of capsules.

use super::found_body::{BodyOrder, FoundBody, find_body};
use crate::signed_axis::SignedAxis;
use glam::{DMat3, DVec3};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Silent;

/// A figure made of capsules, facing along z, 1.8 high, and where its joints are.
struct CapsulePerson {
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    truth: Vec<(&'static str, DVec3)>,
}

/// How the left arm hangs.
#[derive(Clone, Copy, PartialEq)]
enum LeftArm {
    /// As the right one.
    Spread,
    /// Its hand touches the leg.
    AtTheLeg,
    /// As the right one, with a ball around the elbow.
    WithBall,
    /// There is none.
    Missing,
}

impl CapsulePerson {
    fn with(left: LeftArm) -> Self {
        let mut made = Self {
            positions: Vec::new(),
            triangles: Vec::new(),
            truth: Vec::new(),
        };
        let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        made.add(at(0.0, 0.98, 0.0), at(0.0, 1.38, 0.0), 0.15);
        made.add(at(0.0, 1.4, 0.0), at(0.0, 1.69, 0.0), 0.1);
        for (sign, [hip, knee, ankle, shoulder, elbow, wrist]) in [
            (1.0, ["lHip", "lKnee", "lAnkle", "lShoulder", "lElbow", "lWrist"]),
            (-1.0, ["rHip", "rKnee", "rAnkle", "rShoulder", "rElbow", "rWrist"]),
        ] {
            let own = |x: f64, y: f64, z: f64| DVec3::new(sign * x, y, z);
            made.truth.extend([
                (hip, own(0.1, 0.92, 0.0)),
                (knee, own(0.12, 0.5, 0.0)),
                (ankle, own(0.13, 0.1, 0.0)),
            ]);
            made.add(own(0.1, 0.92, 0.0), own(0.13, 0.08, 0.0), 0.07);
            made.add(own(0.13, 0.05, 0.0), own(0.13, 0.05, 0.18), 0.05);
            let hangs = if sign > 0.0 { left } else { LeftArm::Spread };
            let hand = match hangs {
                LeftArm::Spread | LeftArm::WithBall => own(0.62, 0.95, 0.0),
                LeftArm::AtTheLeg => own(0.24, 0.78, 0.0),
                LeftArm::Missing => continue,
            };
            let top = own(0.18, 1.42, 0.0);
            made.add(top, hand, 0.045);
            if hangs == LeftArm::WithBall {
                made.add(top.lerp(hand, 0.4), top.lerp(hand, 0.45), 0.13);
            }
            if hangs != LeftArm::AtTheLeg {
                made.truth.extend([
                    (shoulder, top),
                    (elbow, top.lerp(hand, 0.42)),
                    (wrist, top.lerp(hand, 0.76)),
                ]);
            }
        }
        made
    }

    /// A horse: a trunk along z on four legs, with a neck.
    fn horse() -> Self {
        let mut made = Self {
            positions: Vec::new(),
            triangles: Vec::new(),
            truth: Vec::new(),
        };
        made.add(DVec3::new(0.0, 1.0, -0.6), DVec3::new(0.0, 1.0, 0.6), 0.24);
        made.add(DVec3::new(0.0, 1.1, 0.6), DVec3::new(0.0, 1.6, 1.0), 0.12);
        made.add(DVec3::new(0.0, 1.6, 1.0), DVec3::new(0.0, 1.45, 1.35), 0.1);
        for (x, z) in [(0.15, -0.6), (-0.15, -0.6), (0.15, 0.6), (-0.15, 0.6)] {
            made.add(DVec3::new(x, 0.9, z), DVec3::new(x, 0.05, z), 0.07);
        }
        made
    }

    fn add(&mut self, from: DVec3, to: DVec3, radius: f64) {
        const SIDES: usize = 20;
        const RINGS: usize = 14;
        let axis = (to - from).normalize();
        let side = axis.any_orthonormal_vector();
        let other = axis.cross(side);
        let base = self.positions.len() as u32;
        for ring in 0..=RINGS {
            let angle = std::f64::consts::PI * ring as f64 / RINGS as f64;
            let (sin, cos) = (libm::sin(angle), libm::cos(angle));
            let middle = if 2 * ring < RINGS { from } else { to };
            for k in 0..SIDES {
                let turn = std::f64::consts::TAU * k as f64 / SIDES as f64;
                let way = side * libm::cos(turn) + other * libm::sin(turn);
                self.positions.push(middle + (way * sin - axis * cos) * radius);
            }
        }
        for ring in 0..RINGS as u32 {
            for k in 0..SIDES as u32 {
                let next = (k + 1) % SIDES as u32;
                let [a, b] = [ring, ring + 1].map(|ring| base + ring * SIDES as u32);
                self.triangles
                    .extend([[a + k, a + next, b + next], [a + k, b + next, b + k]]);
            }
        }
    }

    fn turned(mut self, turn: DMat3) -> Self {
        self.positions.iter_mut().for_each(|p| *p = turn * *p);
        self.truth.iter_mut().for_each(|joint| joint.1 = turn * joint.1);
        self
    }

    fn found(&self, order: &BodyOrder<'_>) -> FoundBody {
        let pool = Pool::new(1).expect("a pool");
        find_body(&self.positions, &self.triangles, order, &Exec::new(&pool, &Silent)).expect("not cancelled")
    }
}

/// Half a hand of a figure that is 1.8 high.
const NEAR: f64 = 0.11;

fn assert_joints_near(person: &CapsulePerson, found: &FoundBody) {
    for (name, at) in &person.truth {
        let joint = &found.joints[name];
        assert!(
            joint.at.distance(*at) < NEAR,
            "{name}: {joint:?} is to be near {at} in {found:?}"
        );
    }
}

#[test]
fn joints_of_a_person_are_in_order_and_near_where_they_are() {
    let person = CapsulePerson::with(LeftArm::Spread);
    let found = person.found(&BodyOrder::default());
    assert!(found.score() > 0.9, "{found:?}");
    assert_joints_near(&person, &found);
    let height = |name: &str| found.joints[name].at.y;
    for order in [
        ["lAnkle", "lKnee", "lHip", "lShoulder"],
        ["hips", "spine", "chest", "neck"],
        ["lHandEnd", "lWrist", "lElbow", "lShoulder"],
    ] {
        assert!(
            order.windows(2).all(|pair| height(pair[0]) < height(pair[1])),
            "{order:?}: {found:?}"
        );
    }
}

#[test]
fn a_person_that_stands_along_another_axis_has_the_same_joints() {
    let upright = CapsulePerson::with(LeftArm::Spread).found(&BodyOrder::default());
    for (turn, [up, front]) in [
        (DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y), ["z", "-y"]),
        (DMat3::from_cols(DVec3::NEG_Y, DVec3::X, DVec3::Z), ["x", "z"]),
        (DMat3::from_cols(DVec3::Z, DVec3::Y, DVec3::NEG_X), ["y", "-x"]),
    ] {
        let person = CapsulePerson::with(LeftArm::Spread).turned(turn);
        let given = BodyOrder {
            up: SignedAxis::named(up),
            front: SignedAxis::named(front),
            given: None,
        };
        for order in [BodyOrder::default(), given] {
            let found = person.found(&order);
            assert_eq!((found.axes.up.name(), found.axes.front.name()), (up, front));
            assert!(found.score() > 0.9, "{up}: {found:?}");
            for (name, joint) in &upright.joints {
                let off = found.joints[name].at.distance(turn * joint.at);
                assert!(off < 0.03, "{up}: {name} is off by {off}");
            }
        }
    }
}

#[test]
fn an_arm_that_is_not_clear_is_mirrored_and_says_so() {
    let person = CapsulePerson::with(LeftArm::WithBall);
    let found = person.found(&BodyOrder::default());
    assert_joints_near(&person, &found);
    for name in ["lShoulder", "lElbow", "lWrist"] {
        let joint = &found.joints[name];
        assert!(
            joint.score > 0.5 && joint.score < 0.9 && joint.reason.contains("mirrored"),
            "{name}: {joint:?}"
        );
    }
    assert!(found.joints["rElbow"].score > 0.9, "{found:?}");
}

#[test]
fn a_hand_at_the_leg_is_no_arm_in_the_leg() {
    let found = CapsulePerson::with(LeftArm::AtTheLeg).found(&BodyOrder::default());
    let is_in_leg = |name: &str| found.joints[name].at.y < 0.7;
    assert!(
        found.score() < 0.5 || !["lShoulder", "lElbow", "lWrist"].into_iter().any(is_in_leg),
        "{found:?}"
    );
}

#[test]
fn what_is_no_person_scores_low_and_says_why() {
    let horse = CapsulePerson::horse();
    let one_armed = CapsulePerson::with(LeftArm::Missing);
    for figure in [horse, one_armed] {
        let found = figure.found(&BodyOrder::default());
        let worst = found
            .joints
            .values()
            .min_by(|a, b| a.score.total_cmp(&b.score))
            .expect("joints");
        assert!(worst.score < 0.5 && !worst.reason.is_empty(), "{found:?}");
    }
}

#[test]
fn joints_that_are_given_stay_and_take_others_with_them() {
    let person = CapsulePerson::with(LeftArm::Spread);
    let plain = person.found(&BodyOrder::default());
    let moved = plain.joints["lShoulder"].at + DVec3::new(0.0, 0.06, 0.04);
    let given = [("lShoulder", moved)].into();
    let order = BodyOrder {
        given: Some(&given),
        ..BodyOrder::default()
    };
    let found = person.found(&order);
    let shift = |name: &str| found.joints[name].at - plain.joints[name].at;
    assert_eq!(
        (found.joints["lShoulder"].at, found.joints["lShoulder"].score),
        (moved, 1.0)
    );
    assert!(
        shift("lElbow").z > 0.01 && shift("lElbow").z < 0.04,
        "{}",
        shift("lElbow")
    );
    assert!(shift("lClav").y > 0.03, "{}", shift("lClav"));
    assert!(shift("lHandEnd").length() < 1e-9 && shift("lKnee").length() < 1e-9);
    // What no limb shows is trusted where it is given.
    let one_armed = CapsulePerson::with(LeftArm::Missing);
    let given = [
        ("lShoulder", DVec3::new(0.15, 1.42, 0.0)),
        ("lElbow", DVec3::new(0.3, 1.2, 0.0)),
        ("lWrist", DVec3::new(0.4, 1.0, 0.0)),
    ]
    .into();
    let order = BodyOrder {
        given: Some(&given),
        ..BodyOrder::default()
    };
    let found = one_armed.found(&order);
    assert!(
        ["lShoulder", "lElbow", "lWrist", "lHandEnd"]
            .iter()
            .all(|name| found.joints[name].score == 1.0),
        "{found:?}"
    );
    assert!(found.joints["lHandEnd"].at.distance(given["lWrist"]) > 0.03);
}
