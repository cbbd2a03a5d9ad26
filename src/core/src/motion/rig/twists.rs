//! Bones that a clip twists nearly half around.

use super::bones::MotionRig;
use super::drive::RigDriver;
use super::swing_twist::twist_angle;

/// From how many degrees on a twist is reported: near half a turn, the next frame may turn the other way round.
const LARGEST_TWIST: f64 = 170.0;
/// The twist of a bone that swings by more than 160 degrees is ignored: the square of the cosine of half of that.
const LEAST_TOLD: f64 = 0.03;
/// How many bones are reported.
const MOST_TOLD: usize = 8;

impl RigDriver {
    /// Warns of bones that are twisted about their own axes by more than 170 degrees against their parents, from how they stand in
    /// the reference pose: once of each, of the frame where it is most. `frames` are numbers and times in seconds.
    pub fn warn_of_twists(&mut self, rig: &MotionRig, frames: impl Iterator<Item = (usize, f64)>) {
        let mut worst: Vec<Option<(f64, usize)>> = vec![None; rig.bones.len()];
        for (frame, seconds) in frames {
            let turns = self.turns_from_reference(seconds);
            for ((bone, turn), worst) in rig.bones.iter().zip(turns).zip(&mut worst) {
                let Some((turn, axis)) = turn.zip(bone.direction()) else {
                    continue;
                };
                let along = turn.xyz().dot(axis);
                if along * along + turn.w * turn.w < LEAST_TOLD {
                    continue;
                }
                let degrees = twist_angle(turn, axis).to_degrees().abs();
                if degrees > LARGEST_TWIST && worst.is_none_or(|(most, _)| degrees > most) {
                    *worst = Some((degrees, frame));
                }
            }
        }
        let told = rig.bones.iter().zip(worst);
        let twisted: Vec<_> = told.filter_map(|(bone, worst)| Some((&bone.id, worst?))).collect();
        for (bone, (degrees, frame)) in twisted.iter().take(MOST_TOLD) {
            self.warn(format!(
                "bone \"{bone}\" is twisted by {degrees:.0} degrees about its own axis in frame {frame}, against how it stands in \
                 the reference pose; near half a turn it may flip to the other side"
            ));
        }
        if let Some(more @ 1..) = twisted.len().checked_sub(MOST_TOLD) {
            self.warn(format!(
                "{more} more bones are twisted by more than {LARGEST_TWIST} degrees"
            ));
        }
    }
}
