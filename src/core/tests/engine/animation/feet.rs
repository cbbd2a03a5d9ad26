//! Feet of figures with other proportions than those of who was recorded.

use super::walker::{FRAMES, RATE, RecordedFeet, STEP, figure_rig, walk, walk_of};
use glam::DVec3;
use pliant_core::motion::rig::{DriveOptions, MotionRig, RigDriver};

#[test]
fn a_figure_with_long_arms_takes_steps_as_long_as_its_legs() {
    let scale = |arms: f64, legs: [f64; 2]| {
        let driver = RigDriver::new(&figure_rig(arms, legs), walk(), &DriveOptions::default());
        driver.expect("a driver").scale()
    };
    for arms in [0.3, 1.0, 4.0] {
        assert!((scale(arms, [0.45, 0.40]) - 0.01).abs() < 1e-12);
        // What counts is the whole leg.
        assert!((scale(arms, [0.20, 0.225]) - 0.005).abs() < 1e-12);
    }
}

/// Times of the walk's frames, and the driver of a figure with these legs.
fn walker(legs: [f64; 2], plants: bool) -> (Vec<f64>, RigDriver) {
    walker_of(legs, plants, RecordedFeet::default())
}

fn walker_of(legs: [f64; 2], plants: bool, feet: RecordedFeet) -> (Vec<f64>, RigDriver) {
    let (rig, clip) = (figure_rig(1.0, legs), walk_of(feet));
    let start = 1.0 / RATE;
    let options = DriveOptions {
        start,
        ..Default::default()
    };
    let times = (0..FRAMES).map(|frame| start + frame as f64 / RATE).collect();
    let mut driver = RigDriver::new(&rig, clip, &options).expect("a driver");
    if plants {
        assert!(driver.plant_feet(&rig, &[], start));
    }
    (times, driver)
}

/// The joints of a figure in each frame: by bone where it begins, then where it ends.
fn joints(driver: &RigDriver, legs: [f64; 2], times: &[f64]) -> Vec<Vec<DVec3>> {
    let rig = figure_rig(1.0, legs);
    let pose = |seconds: &f64| {
        let pose = driver.pose_at(*seconds);
        let bones = rig.bones.iter().zip(&pose.bones);
        bones
            .flat_map(|(bone, motion)| {
                let whole = motion.followed_by(&pose.root);
                [whole.place(bone.from), whole.place(bone.to)]
            })
            .collect()
    };
    times.iter().map(pose).collect()
}

/// The largest second difference of any joint.
fn largest_jerk(frames: &[Vec<DVec3>]) -> f64 {
    let jerk = |w: &[Vec<DVec3>]| {
        let all = w[0].iter().zip(&w[1]).zip(&w[2]);
        all.map(|((a, b), c)| (*a - *b * 2.0 + *c).length()).fold(0.0, f64::max)
    };
    frames.windows(3).map(jerk).fold(0.0, f64::max)
}

#[test]
fn feet_that_stand_in_the_recording_stand_on_figures_with_other_legs() {
    for legs in [[0.45, 0.40], [0.30, 0.55], [0.55, 0.25]] {
        let height = legs[0] + legs[1] + 0.8;
        let (times, planted) = walker(legs, true);
        let feet = planted.foot_contacts(&times);
        assert_eq!(feet.len(), 2);
        for foot in &feet {
            // Each foot stands three times, for most of a step.
            assert!((3..=4).contains(&foot.contacts.len()), "{:?}", foot.contacts);
            assert!(foot.planted >= 2 * STEP && foot.planted <= 4 * STEP, "{}", foot.planted);
            assert!(foot.drift[1] <= 1e-3 * height, "{legs:?}: {:?}", foot.drift);
        }
        let (_, free) = walker(legs, false);
        assert!(free.foot_contacts(&times).is_empty());
        let slides = feet.iter().map(|foot| foot.drift[0]).fold(0.0, f64::max);
        assert!(
            legs[0] == 0.45 || slides > 1.5e-3 * height,
            "{legs:?}: as driven it slides, by {slides}"
        );
        // Nothing jumps where a contact begins or ends, and bones keep their lengths.
        let [before, after] = [&free, &planted].map(|driver| joints(driver, legs, &times));
        let (jerk, usual) = (largest_jerk(&after), largest_jerk(&before));
        assert!(jerk <= 1.5 * usual, "{legs:?}: {jerk} against {usual}");
        for (a, b) in before.iter().zip(&after) {
            for (a, b) in a.chunks(2).zip(b.chunks(2)) {
                assert!((a[0].distance(a[1]) - b[0].distance(b[1])).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn a_figure_that_has_no_legs_is_driven_as_it_is() {
    let mut rig = figure_rig(1.0, [0.45, 0.40]);
    rig.bones
        .retain(|bone| !bone.id.contains("Leg") && !bone.id.contains("Foot"));
    let parents: Vec<Option<String>> = ["", "pelvis", "spine", "LeftArm", "spine", "RightArm"]
        .map(|name| (!name.is_empty()).then(|| name.to_owned()))
        .to_vec();
    let rig = MotionRig::from_named_parents(rig.bones, &parents, rig.reference, None).expect("a rig");
    let mut driver = RigDriver::new(&rig, walk(), &DriveOptions::default()).expect("a driver");
    let before = driver.pose_at(0.7);
    assert!(!driver.plant_feet(&rig, &[], 0.0));
    assert_eq!(driver.pose_at(0.7), before);
}

#[test]
fn soles_that_stand_lie_level_on_the_floor_whatever_feet_were_recorded() {
    for (legs, steeper) in [([0.45, 0.40], 20.0), ([0.9, 0.8], 0.0), ([0.2, 0.3], -15.0)] {
        let (times, driver) = walker_of(legs, true, RecordedFeet { steeper, tremble: 0.0 });
        let feet = driver.foot_contacts(&times);
        let (rig, frames) = (figure_rig(1.0, legs), joints(&driver, legs, &times));
        let mut seen = 0;
        for foot in &feet {
            let rest = &rig.bones[foot.bone];
            for (seconds, frame) in times.iter().zip(&frames) {
                let stands = |c: &[f64; 2]| c[0] - 1e-9 <= *seconds && *seconds <= c[1] + 1e-9;
                if !foot.contacts.iter().any(stands) {
                    continue;
                }
                seen += 1;
                let [ankle, ball] = [frame[2 * foot.bone], frame[2 * foot.bone + 1]];
                assert!(ball.y.abs() < 2e-3, "{legs:?}: the ball of the foot is at {}", ball.y);
                let level = (rest.from - rest.to).y;
                assert!(
                    (ankle.y - ball.y - level).abs() < 2e-3,
                    "{legs:?}: {} {level}",
                    ankle.y - ball.y
                );
            }
        }
        assert!(seen >= 4 * STEP, "{seen}");
    }
}

#[test]
fn feet_that_tremble_in_the_recording_shake_no_leg() {
    for legs in [[0.45, 0.40], [0.2, 0.2]] {
        let jerk = |tremble: f64| {
            let (times, driver) = walker_of(legs, true, RecordedFeet { steeper: 0.0, tremble });
            largest_jerk(&joints(&driver, legs, &times))
        };
        let (calm, trembling) = (jerk(0.0), jerk(12.0));
        assert!(trembling <= 1.5 * calm, "{legs:?}: {trembling} against {calm}");
    }
}
