//! Feet that lie flat on the floor, without trembling.
//!
//! Skeletons have feet of other shapes than figures: what lies flat in a recording may dig its toes into the floor when a figure's foot is
//! turned as much. A figure's sole is flat as in its rest pose where the recorded foot is flat.
//!
//! Markers on toes are recorded less exactly than those on ankles: a foot that stands still turns to and fro by twenty degrees in some
//! recordings, and a figure with long feet shows it. While a foot stands and its ankle is still, its attitude is
//! evened out over time.

use super::contacts::runs;
use glam::{DQuat, DVec3};

/// The most by which a foot is tilted to lie flat, in radians.
const STEEPEST: f64 = std::f64::consts::FRAC_PI_4;

/// How a foot is tilted in its rest pose, so that its sole is as level as there in the mean of the frames in which it lies flat.
pub(super) fn levelling_tilt(attitudes: &[DQuat], is_flat: &[bool], up: DVec3) -> DQuat {
    let flat = attitudes.iter().zip(is_flat).filter(|(_, flat)| **flat);
    let above: DVec3 = flat.map(|(attitude, _)| attitude.inverse() * up).sum();
    let is_steep = |above: DVec3| above.dot(up) < libm::cos(STEEPEST);
    match above.try_normalize() {
        Some(above) if !is_steep(above) => DQuat::from_rotation_arc(up, above),
        _ => DQuat::IDENTITY,
    }
}

/// By frame, the turn that takes a foot's attitude to an evened one where it is still, and less in the frames before and after.
/// `half` is half the time over which attitudes are evened out, in frames.
pub(super) fn evening_turns(attitudes: &[DQuat], is_still: &[bool], half: usize) -> Vec<DQuat> {
    let mut aligned = attitudes.to_vec();
    for k in 1..aligned.len() {
        if aligned[k].dot(aligned[k - 1]) < 0.0 {
            aligned[k] = -aligned[k];
        }
    }
    let evened = means(&means(&aligned, half), half);
    let mut shares: Vec<f64> = is_still.iter().map(|still| if *still { 1.0 } else { 0.0 }).collect();
    let blend = 2 * half + 1;
    for gap in runs(is_still, |still| !still) {
        for k in gap.clone() {
            let since = if gap.start > 0 { k + 1 - gap.start } else { blend };
            let until = if gap.end < attitudes.len() { gap.end - k } else { blend };
            let t = 1.0 - since.min(until).min(blend) as f64 / blend as f64;
            shares[k] = t * t * (3.0 - 2.0 * t);
        }
    }
    let turn = |((own, evened), share): ((&DQuat, &DQuat), f64)| {
        let turn = (*evened * own.inverse()).normalize();
        DQuat::IDENTITY.lerp(turn, share).normalize()
    };
    aligned.iter().zip(&evened).zip(shares).map(turn).collect()
}

/// Means over the frames around each one, as many on one side as on the other.
fn means(values: &[DQuat], half: usize) -> Vec<DQuat> {
    let mean = |k: usize| {
        let half = half.min(k).min(values.len() - 1 - k);
        let sum = values[k - half..=k + half]
            .iter()
            .fold(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), |a, b| a + *b);
        // Attitudes all around have no mean.
        if sum.length_squared() > 1e-12 {
            sum.normalize()
        } else {
            values[k]
        }
    };
    (0..values.len()).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_foot_trembles_less_and_follows_slow_turns() {
        let angle = |k: usize| 0.01 * k as f64 + if k.is_multiple_of(2) { 0.15 } else { -0.15 };
        let attitudes: Vec<DQuat> = (0..60)
            .map(|k| DQuat::from_rotation_y(angle(k)) * if k % 3 == 0 { -1.0 } else { 1.0 })
            .collect();
        let flat: Vec<bool> = (0..60).map(|k| (10..50).contains(&k)).collect();
        let turns = evening_turns(&attitudes, &flat, 3);
        for k in 0..60 {
            let expected = DQuat::from_rotation_y(0.01 * k as f64);
            let apart = 2.0 * (turns[k] * attitudes[k]).dot(expected).abs().min(1.0).acos();
            match k {
                10..50 => assert!(apart < 0.01, "{k}: {apart}"),
                ..3 | 57.. => assert_eq!(turns[k], DQuat::IDENTITY),
                _ => {}
            }
        }
    }

    #[test]
    fn a_sole_is_level_where_the_recorded_foot_is_flat() {
        let heading = |k: usize| DQuat::from_rotation_y(0.1 * k as f64);
        let attitudes: Vec<DQuat> = (0..20).map(|k| heading(k) * DQuat::from_rotation_x(0.3)).collect();
        let tilt = levelling_tilt(&attitudes, &[true; 20], DVec3::Y);
        for (k, attitude) in attitudes.iter().enumerate() {
            assert!((*attitude * tilt).dot(heading(k)).abs() > 1.0 - 1e-12);
        }
        assert_eq!(levelling_tilt(&attitudes, &[false; 20], DVec3::Y), DQuat::IDENTITY);
    }
}
