//! Bones that turn by more than half a turn against each other, followed over time.
//!
//! Of two attitudes alone the shorter way between them is known: a wrist that is turned over by 170 and then by 190 degrees seems to be
//! turned back by 170, and all between it and the elbow would flip over. A recording is looked at once, frame after frame, and the times
//! are kept at which a turn passes half a turn, so that any time can be asked for alone.

use super::bones::MotionRig;
use super::rigid_motion::{RigidMotion, clear_twist, twist_angle};
use glam::{DQuat, DVec3};
use std::f64::consts::{PI, TAU};

/// So far a turn is followed, in radians: a limb that is wrung further is better turned the shorter way.
const FARTHEST: f64 = 1.5 * PI;

/// How a bone is turned against its neighbours.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BoneTurns {
    /// By how many radians the bone is twisted about its own axis against the one that it hangs on.
    pub(super) above: f64,
    /// The same of the one that hangs on it.
    pub(super) below: f64,
    /// Whether it is turned by more than half a turn against the one that it hangs on, in all.
    pub(super) is_far: bool,
}

impl BoneTurns {
    /// So much of the twists, 0 to 1.
    pub(super) fn part_way(self, part: f64) -> Self {
        Self {
            above: self.above * part,
            below: self.below * part,
            is_far: false,
        }
    }
}

/// What is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
enum TurnKind {
    /// A twist about an axis of the bone `of` against the bone `against`.
    Twist { of: usize, against: usize, axis: DVec3 },
    /// Any turn.
    Whole { of: usize, against: usize },
}

/// A time from which on a turn has another number of whole turns beside what is seen of it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Passing {
    /// The frame before, and how far the bone was turned there.
    after: f64,
    last: Seen,
    /// The first frame with the new number.
    from: f64,
    turns: f64,
}

/// How far a bone is turned: a twist with its whole turns, or a quaternion of the sign that follows on the one before.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Seen {
    Angle(f64),
    Whole(DQuat),
}

/// A turn with the times at which it passes half a turn.
#[derive(Debug, Clone, PartialEq)]
struct FollowedTurn {
    turn: TurnKind,
    passings: Vec<Passing>,
}

/// The turns of all bones of a rig that handles depend on.
#[derive(Debug, Clone, Default)]
pub(super) struct HalfTurns {
    /// By bone: above, below, whole.
    bones: Vec<[Option<FollowedTurn>; 3]>,
}

impl HalfTurns {
    /// Of a rig, nothing of which has been looked at.
    pub(super) fn of(rig: &MotionRig) -> Self {
        let followed = |turn: TurnKind| FollowedTurn {
            turn,
            passings: Vec::new(),
        };
        let bone = |(of, bone): (usize, &super::bones::RigBone)| {
            let axis = bone.direction().filter(|_| bone.slices > 1);
            let above = bone
                .parent
                .zip(axis)
                .map(|(against, axis)| TurnKind::Twist { of, against, axis });
            let below = rig.continued_by(of).zip(axis);
            let below = below.map(|(child, axis)| TurnKind::Twist {
                of: child,
                against: of,
                axis,
            });
            let whole = bone.parent.map(|against| TurnKind::Whole { of, against });
            [above, below, whole].map(|turn| turn.map(followed))
        };
        Self {
            bones: rig.bones.iter().enumerate().map(bone).collect(),
        }
    }

    /// Looks at frames one after another: their times, with what bones do then.
    pub(super) fn follow(&mut self, frames: impl Iterator<Item = (f64, Vec<RigidMotion>)>) {
        let mut before: Vec<[Option<(f64, Seen)>; 3]> = vec![[None; 3]; self.bones.len()];
        for (seconds, motions) in frames {
            let all = self.bones.iter_mut().flatten().zip(before.iter_mut().flatten());
            for (followed, before) in all.filter_map(|(followed, before)| Some((followed.as_mut()?, before))) {
                followed.look(seconds, &motions, before);
            }
        }
    }

    /// By bone, what is seen at a time.
    pub(super) fn at(&self, seconds: f64, motions: &[RigidMotion]) -> Vec<BoneTurns> {
        let turns = |[above, below, whole]: &[Option<FollowedTurn>; 3]| {
            let angle = |turn: &Option<FollowedTurn>| match turn.as_ref().map(|turn| turn.at(seconds, motions)) {
                Some(Seen::Angle(angle)) => angle,
                _ => 0.0,
            };
            let whole = whole.as_ref().map(|turn| turn.at(seconds, motions));
            BoneTurns {
                above: angle(above),
                below: angle(below),
                is_far: matches!(whole, Some(Seen::Whole(turn)) if turn.w < 0.0),
            }
        };
        self.bones.iter().map(turns).collect()
    }
}

impl FollowedTurn {
    /// Looks at the next frame. `before` is that of the frame before, as far as the turn was clear there.
    fn look(&mut self, seconds: f64, motions: &[RigidMotion], before: &mut Option<(f64, Seen)>) {
        let plain = self.turn.seen(motions);
        let seen = before.and_then(|(_, last)| self.turn.following(plain, last));
        let turns = seen.map_or(0.0, |seen| seen.turns_beside(plain));
        let current = self.passings.last().map_or(0.0, |passing| passing.turns);
        if turns != current {
            let (after, last) = before.unwrap_or((seconds, plain));
            self.passings.push(Passing {
                after,
                last,
                from: seconds,
                turns,
            });
        }
        *before = self.turn.is_clear(motions).then_some((seconds, plain.with(turns)));
    }

    fn at(&self, seconds: f64, motions: &[RigidMotion]) -> Seen {
        let plain = self.turn.seen(motions);
        let begun = self.passings.partition_point(|passing| passing.after < seconds);
        let Some(passing) = begun.checked_sub(1).map(|k| self.passings[k]) else {
            return plain;
        };
        if seconds >= passing.from {
            return plain.with(passing.turns);
        }
        self.turn.following(plain, passing.last).unwrap_or(plain)
    }
}

impl TurnKind {
    /// The shorter way.
    fn seen(&self, motions: &[RigidMotion]) -> Seen {
        match *self {
            Self::Twist { axis, .. } => Seen::Angle(twist_angle(self.relative(motions), axis)),
            Self::Whole { .. } => {
                let turn = self.relative(motions);
                Seen::Whole(if turn.w < 0.0 { -turn } else { turn })
            }
        }
    }

    fn relative(&self, motions: &[RigidMotion]) -> DQuat {
        let (Self::Twist { of, against, .. } | Self::Whole { of, against }) = *self;
        motions[against].rotation.inverse() * motions[of].rotation
    }

    fn is_clear(&self, motions: &[RigidMotion]) -> bool {
        match *self {
            Self::Twist { axis, .. } => clear_twist(self.relative(motions), axis).is_some(),
            Self::Whole { .. } => true,
        }
    }

    /// What follows on another; `None` where it would be turned too far.
    fn following(&self, plain: Seen, last: Seen) -> Option<Seen> {
        match (plain, last) {
            (Seen::Angle(angle), Seen::Angle(last)) => {
                let angle = angle + TAU * ((last - angle) / TAU).round();
                (angle.abs() <= FARTHEST).then_some(Seen::Angle(angle))
            }
            (Seen::Whole(turn), Seen::Whole(last)) => {
                let turn = if turn.dot(last) < 0.0 { -turn } else { turn };
                (turn.w >= libm::cos(0.5 * FARTHEST)).then_some(Seen::Whole(turn))
            }
            _ => None,
        }
    }
}

impl Seen {
    /// How many turns it has more than another that is the same but for these.
    fn turns_beside(self, plain: Self) -> f64 {
        match (self, plain) {
            (Self::Angle(angle), Self::Angle(plain)) => ((angle - plain) / TAU).round(),
            (Self::Whole(turn), Self::Whole(plain)) if turn.dot(plain) < 0.0 => 1.0,
            _ => 0.0,
        }
    }

    /// With so many turns more.
    fn with(self, turns: f64) -> Self {
        match self {
            Self::Angle(angle) => Self::Angle(angle + TAU * turns),
            Self::Whole(turn) if turns != 0.0 => Self::Whole(-turn),
            whole @ Self::Whole(_) => whole,
        }
    }
}
