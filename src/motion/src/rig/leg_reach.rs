//! A leg that is turned so that its ankle comes to a place: inverse kinematics of two bones.

use super::legs::Leg;
use super::rigid_motion::{RigidMotion, rotation_about};
use glam::{DQuat, DVec3};

/// The sine of the bend from which on the axis about which the knee is bent counts more than its usual one, which decides where the
/// leg is straight.
const USUAL: f64 = 0.1;

/// A leg of a driven rig.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ReachingLeg {
    pub(super) leg: Leg,
    /// Hip, knee and ankle in the rest pose.
    pub(super) rest: [DVec3; 3],
    /// The axis about which the knee bends, in the thigh's rest pose, of unit length.
    pub(super) hinge: DVec3,
}

impl ReachingLeg {
    /// Hip, knee and ankle.
    pub(super) fn joints(&self, world: &[RigidMotion]) -> [DVec3; 3] {
        let [hip, knee, ankle] = self.rest;
        let thigh = &world[self.leg.thigh];
        [thigh.place(hip), thigh.place(knee), world[self.leg.shin].place(ankle)]
    }

    /// Its length when it is straight.
    pub(super) fn length(&self) -> f64 {
        let [hip, knee, ankle] = self.rest;
        hip.distance(knee) + knee.distance(ankle)
    }

    /// Turns thigh and shin so that the ankle comes to `target`, or as near as the leg is long. The foot is turned by `foot`
    /// beside its attitude, and what hangs on the bones follows them. `parents` has the bone that each hangs on. A knee that is
    /// overstretched comes to the side to which it usually bends, so that it does not change sides where the leg is straight.
    pub(super) fn reach(&self, world: &mut [RigidMotion], parents: &[Option<usize>], target: DVec3, foot: DQuat) {
        let [hip, knee, ankle] = self.joints(world);
        let (thigh, shin) = (knee - hip, ankle - knee);
        let (long, wanted) = (thigh.length() * shin.length(), target - hip);
        let hinge = world[self.leg.thigh].rotation * self.hinge;
        let bent = thigh.cross(shin) / long;
        // Its part along the hinge is never less than that of the hinge alone, so that it neither vanishes nor turns around.
        let axis = (bent * bent.dot(hinge) + hinge * (USUAL * USUAL)).normalize_or(hinge);
        let bend = rotation_about(axis, bend_for(thigh, shin, axis, wanted.length()));
        let reached = thigh + bend * shin;
        let (Some(from), Some(to)) = (reached.try_normalize(), wanted.try_normalize()) else {
            return;
        };
        let swing = DQuat::from_rotation_arc(from, to);
        self.turn(world, parents, [swing, (swing * bend).normalize(), foot]);
    }

    /// Turns the thigh, the shin and the foot by these, and takes along what hangs on them.
    fn turn(&self, world: &mut [RigidMotion], parents: &[Option<usize>], [thigh, shin, foot]: [DQuat; 3]) {
        let mut turns: Vec<Option<DQuat>> = vec![None; world.len()];
        for bone in self.leg.thigh..world.len() {
            let above = parents[bone].and_then(|parent| turns[parent]);
            let own = match bone {
                _ if bone == self.leg.thigh => Some(thigh),
                _ if bone == self.leg.shin => Some(shin),
                _ if Some(bone) == self.leg.foot => Some(foot),
                _ => above,
            };
            let Some(turn) = own else { continue };
            turns[bone] = own;
            if let Some(parent) = parents[bone].filter(|_| above.is_some()) {
                world[bone].to = world[parent].place(world[bone].from);
            }
            world[bone].rotation = (turn * world[bone].rotation).normalize();
        }
    }
}

/// The angle about `axis` by which the shin has to be turned so that hip and ankle are `apart`; the knee is bent about `axis` then.
fn bend_for(thigh: DVec3, shin: DVec3, axis: DVec3, apart: f64) -> f64 {
    let along = thigh.dot(axis) * shin.dot(axis);
    let across = thigh.dot(shin) - along;
    let beside = thigh.dot(axis.cross(shin));
    let most = libm::hypot(across, beside);
    if most <= 0.0 {
        return 0.0;
    }
    let wanted = 0.5 * (apart * apart - thigh.length_squared() - shin.length_squared()) - along;
    let straight = libm::atan2(beside, across);
    straight + libm::acos((wanted / most).clamp(-1.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARENTS: [Option<usize>; 6] = [None, Some(0), Some(1), Some(2), Some(3), Some(1)];

    fn reaching() -> ReachingLeg {
        ReachingLeg {
            leg: Leg {
                thigh: 1,
                shin: 2,
                foot: Some(3),
            },
            rest: [DVec3::Y, DVec3::new(0.0, 0.55, 0.0), DVec3::new(0.0, 0.15, 0.0)],
            hinge: DVec3::X,
        }
    }

    /// Bones whose thigh points forward, with the shin turned so beside it.
    fn posed(reaching: &ReachingLeg, shin: DQuat) -> Vec<RigidMotion> {
        let rest = reaching.rest;
        let bent = DQuat::from_rotation_x(-0.4);
        let mut world = vec![RigidMotion::IDENTITY; 6];
        let froms = [DVec3::Y, rest[0], rest[1], rest[2], DVec3::new(0.0, 0.0, 0.2), rest[1]];
        for (bone, from) in froms.into_iter().enumerate() {
            let to = PARENTS[bone].map_or(from, |p: usize| world[p].place(from));
            let rotation = [DQuat::IDENTITY, bent, bent * shin, DQuat::IDENTITY][bone.min(3)];
            world[bone] = RigidMotion { rotation, from, to };
        }
        world
    }

    #[test]
    fn a_knee_that_is_overstretched_does_not_jump() {
        let reaching = reaching();
        const STEP: f64 = 0.005;
        // Beside the bend, the shin is turned aside a little; the foot is planted so far above and beside its place.
        for (aside, shift) in [
            (0.02, DVec3::ZERO),
            (0.02, DVec3::new(0.0, 0.003, 0.0)),
            (-0.05, DVec3::new(0.01, 0.02, -0.01)),
        ] {
            let knees: Vec<DVec3> = (0..=100)
                .map(|step| {
                    let bend = f64::from(step) * STEP - 0.2;
                    let mut world = posed(&reaching, DQuat::from_rotation_z(aside) * DQuat::from_rotation_x(bend));
                    let target = reaching.joints(&world)[2] + shift;
                    reaching.reach(&mut world, &PARENTS, target, DQuat::IDENTITY);
                    let [hip, knee, ankle] = reaching.joints(&world);
                    assert!(ankle.distance(target) < 1e-6, "{bend} {ankle} {target}");
                    assert!(
                        (ankle - hip).cross(knee - hip).x <= 1e-9,
                        "it bends forward: {bend} {knee}"
                    );
                    knee
                })
                .collect();
            let jump = knees.windows(2).map(|w| w[0].distance(w[1])).fold(0.0, f64::max);
            assert!(jump < 0.85 * STEP, "{aside} {shift}: {jump}");
            let kink = knees.windows(3).map(|w| (w[0] - w[1] * 2.0 + w[2]).length());
            let kink = kink.fold(0.0, f64::max);
            assert!(kink < 0.45 * STEP, "{aside} {shift}: {kink}");
        }
    }

    #[test]
    fn the_ankle_comes_to_its_place_and_bones_keep_their_lengths() {
        let reaching = reaching();
        for shin in [0.0, 1e-4, 0.5, 1.2] {
            for target in [
                DVec3::new(0.05, 0.25, 0.3),
                DVec3::new(-0.1, 0.4, -0.1),
                DVec3::new(0.0, -9.0, 0.0),
            ] {
                let mut world = posed(&reaching, DQuat::from_rotation_x(shin));
                reaching.reach(&mut world, &PARENTS, target, DQuat::IDENTITY);
                let [hip, knee, ankle] = reaching.joints(&world);
                assert!((hip.distance(knee) - 0.45).abs() < 1e-12 && (knee.distance(ankle) - 0.40).abs() < 1e-12);
                let way = target - hip;
                let nearest = hip + way.normalize() * way.length().min(0.85);
                assert!(ankle.distance(nearest) < 1e-6, "{ankle} {nearest}");
                // Knees bend forward, feet stay level, and what hangs on a bone hangs on it still.
                assert!((ankle - hip).cross(knee - hip).x <= 1e-9, "{knee}");
                assert!(
                    world[3].rotation.dot(DQuat::IDENTITY).abs() > 1.0 - 1e-12 && world[3].to.distance(ankle) < 1e-12
                );
                assert!(world[4].to.distance(world[3].place(world[4].from)) < 1e-12);
                assert!(world[5].to.distance(knee) < 1e-12);
            }
            let same = posed(&reaching, DQuat::from_rotation_x(shin));
            let mut world = posed(&reaching, DQuat::from_rotation_x(shin));
            let here = reaching.joints(&world)[2];
            reaching.reach(&mut world, &PARENTS, here, DQuat::IDENTITY);
            let worst = same
                .iter()
                .zip(&world)
                .map(|(a, b)| a.place(DVec3::ONE).distance(b.place(DVec3::ONE)));
            assert!(worst.fold(0.0, f64::max) < 1e-6, "{shin}");
        }
    }
}
