//! The poses of the built-in recordings, as directions of limbs.
//!
//! Directions are those of the left side, of arms relative to the chest and of legs to the hips: x outward, y up, z
//! ahead. The right side mirrors x.

/// Where a limb points: above its elbow or knee, and below.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LimbPose {
    pub upper: [f64; 3],
    pub lower: [f64; 3],
}

/// A pose. Angles in degrees: leaned forward, turned to the left, tilted to the right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RecordedPose {
    pub hips: [f64; 3],
    /// Against the hips.
    pub chest: [f64; 3],
    /// Against the chest.
    pub head: [f64; 3],
    /// Left and right.
    pub arms: [LimbPose; 2],
    pub legs: [LimbPose; 2],
    /// How far each foot points, 0 to 1.
    pub points: [f64; 2],
    /// How high above the ground the lower sole is.
    pub lift: f64,
}

const fn limb_pose(upper: [f64; 3], lower: [f64; 3]) -> LimbPose {
    LimbPose { upper, lower }
}

/// Arms hang.
const HANGING: LimbPose = limb_pose([0.18, -1.0, 0.02], [0.10, -1.0, 0.15]);
/// A leg that stands.
const STRAIGHT: LimbPose = limb_pose([0.03, -1.0, 0.0], [0.0, -1.0, -0.02]);

const STANDING: RecordedPose = RecordedPose {
    hips: [0.0; 3],
    chest: [0.0; 3],
    head: [0.0; 3],
    arms: [HANGING; 2],
    legs: [STRAIGHT; 2],
    points: [0.0; 2],
    lift: 0.0,
};

/// The pose at a time: smoothly from each key to the next, and still beyond the last.
pub(super) fn pose_between(keys: &[(f64, RecordedPose)], seconds: f64) -> RecordedPose {
    let next = keys.iter().position(|key| key.0 > seconds).unwrap_or(keys.len());
    let Some(((begun, from), (ends, to))) = next.checked_sub(1).and_then(|k| Some((keys[k], *keys.get(next)?))) else {
        return keys.last().map_or(STANDING, |key| key.1);
    };
    let share = (seconds - begun) / (ends - begun);
    let share = share * share * (3.0 - 2.0 * share);
    let mix = |a: f64, b: f64| a + (b - a) * share;
    let three = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|k| mix(a[k], b[k]));
    let limbs = |a: [LimbPose; 2], b: [LimbPose; 2]| {
        std::array::from_fn(|k| limb_pose(three(a[k].upper, b[k].upper), three(a[k].lower, b[k].lower)))
    };
    RecordedPose {
        hips: three(from.hips, to.hips),
        chest: three(from.chest, to.chest),
        head: three(from.head, to.head),
        arms: limbs(from.arms, to.arms),
        legs: limbs(from.legs, to.legs),
        points: std::array::from_fn(|k| mix(from.points[k], to.points[k])),
        lift: mix(from.lift, to.lift),
    }
}

/// A fist before the chin.
const GUARDED: LimbPose = limb_pose([0.22, -0.85, 0.45], [-0.22, 0.80, 0.60]);
/// An arm that strikes straight ahead.
const STRUCK: LimbPose = limb_pose([-0.05, 0.02, 1.0], [-0.12, 0.05, 1.0]);

/// A boxer, a key each third of a second.
pub(super) fn boxing_keys() -> Vec<(f64, RecordedPose)> {
    let guard = RecordedPose {
        hips: [0.0, -22.0, 0.0],
        chest: [14.0, 4.0, 0.0],
        head: [-2.0, 14.0, 0.0],
        arms: [GUARDED; 2],
        legs: [
            limb_pose([0.16, -0.86, 0.46], [0.06, -0.98, -0.12]),
            limb_pose([0.22, -0.95, 0.02], [0.12, -0.90, -0.40]),
        ],
        ..STANDING
    };
    let jab = RecordedPose {
        chest: [12.0, -22.0, 0.0],
        head: [-2.0, 38.0, 0.0],
        arms: [STRUCK, GUARDED],
        ..guard
    };
    let cross = RecordedPose {
        hips: [2.0, 8.0, 0.0],
        chest: [14.0, 34.0, 0.0],
        head: [-2.0, -34.0, 0.0],
        arms: [GUARDED, STRUCK],
        ..guard
    };
    let hook = RecordedPose {
        hips: [0.0, -40.0, 0.0],
        chest: [8.0, -30.0, 4.0],
        head: [0.0, 50.0, 0.0],
        arms: [limb_pose([0.95, -0.05, 0.45], [-0.75, 0.05, 0.75]), GUARDED],
        ..guard
    };
    let duck = RecordedPose {
        hips: [12.0, -14.0, -6.0],
        chest: [34.0, 16.0, -8.0],
        head: [-30.0, 6.0, 0.0],
        legs: [
            limb_pose([0.24, -0.62, 0.74], [0.08, -0.88, -0.46]),
            limb_pose([0.30, -0.70, 0.34], [0.14, -0.74, -0.66]),
        ],
        ..guard
    };
    let uppercut = RecordedPose {
        hips: [0.0, 10.0, 0.0],
        chest: [-6.0, 34.0, 0.0],
        head: [2.0, -30.0, 0.0],
        arms: [GUARDED, limb_pose([0.12, 0.05, 0.95], [-0.10, 0.98, 0.30])],
        ..guard
    };
    let poses = [
        STANDING, guard, jab, guard, cross, hook, duck, uppercut, guard, STANDING,
    ];
    (0..).map(|k| f64::from(k) / 3.0).zip(poses).collect()
}

/// Arms of a dancer: low, rounded ahead, stretched aside, raised; and a leg that stands turned out.
const LOW: LimbPose = limb_pose([0.55, -0.95, 0.30], [-0.10, -0.95, 0.40]);
const AHEAD: LimbPose = limb_pose([0.42, -0.42, 0.80], [-0.50, 0.02, 0.85]);
const ASIDE: LimbPose = limb_pose([1.0, -0.10, 0.18], [0.95, -0.02, 0.35]);
const ABOVE: LimbPose = limb_pose([0.52, 0.95, 0.16], [-0.32, 1.0, 0.16]);
const TURNED_OUT: LimbPose = limb_pose([0.10, -1.0, 0.0], [0.0, -1.0, 0.0]);

/// How a dance begins.
const FIRST: RecordedPose = RecordedPose {
    arms: [LOW; 2],
    legs: [TURNED_OUT; 2],
    ..STANDING
};

/// On one toe, the other foot at the knee, turned so far.
fn turning_pose(yaw: f64) -> RecordedPose {
    RecordedPose {
        hips: [0.0, yaw, 0.0],
        arms: [AHEAD; 2],
        legs: [TURNED_OUT, limb_pose([0.80, -0.42, 0.42], [-0.72, -0.66, -0.26])],
        points: [1.0; 2],
        ..FIRST
    }
}

/// Leaned over one leg, the other one far behind.
fn arabesque_pose() -> RecordedPose {
    RecordedPose {
        hips: [38.0, 300.0, 0.0],
        chest: [-30.0, 0.0, 0.0],
        head: [-14.0, 0.0, 0.0],
        arms: [
            limb_pose([0.25, 0.28, 1.0], [0.05, 0.22, 1.0]),
            limb_pose([0.9, -0.1, -0.5], [0.9, -0.1, -0.5]),
        ],
        // The leg that stands is upright though the hips are leaned.
        legs: [
            limb_pose([0.06, -0.79, 0.62], [0.0, -0.79, 0.60]),
            limb_pose([0.14, -0.42, -0.90], [0.04, -0.34, -0.95]),
        ],
        points: [0.0, 1.0],
        ..FIRST
    }
}

/// High above the ground, the legs apart.
fn leaping_pose() -> RecordedPose {
    RecordedPose {
        hips: [6.0, 430.0, 0.0],
        chest: [-14.0, 0.0, 0.0],
        arms: [ABOVE, ASIDE],
        legs: [
            limb_pose([0.10, 0.02, 1.0], [0.05, 0.02, 1.0]),
            limb_pose([0.16, -0.16, -1.0], [0.06, 0.02, -1.0]),
        ],
        points: [1.0; 2],
        lift: 60.0,
        ..FIRST
    }
}

/// A dancer, a key each half of a second.
pub(super) fn ballet_keys() -> Vec<(f64, RecordedPose)> {
    let plie = RecordedPose {
        arms: [AHEAD; 2],
        legs: [limb_pose([0.62, -0.78, 0.20], [-0.46, -0.88, -0.12]); 2],
        ..FIRST
    };
    let rise = RecordedPose {
        chest: [-5.0, 0.0, 0.0],
        arms: [ABOVE; 2],
        points: [1.0; 2],
        ..FIRST
    };
    let unfolded = RecordedPose {
        chest: [0.0, 0.0, -8.0],
        head: [0.0, 16.0, 0.0],
        arms: [ABOVE, ASIDE],
        legs: [TURNED_OUT, limb_pose([0.90, 0.12, 0.30], [0.95, 0.22, 0.20])],
        points: [0.0, 1.0],
        ..FIRST
    };
    let pointed = RecordedPose {
        head: [0.0, -12.0, 0.0],
        arms: [ASIDE, LOW],
        legs: [TURNED_OUT, limb_pose([0.16, -0.86, 0.50], [0.10, -0.86, 0.50])],
        points: [0.0, 1.0],
        ..FIRST
    };
    let mirrored = RecordedPose {
        hips: [0.0, 360.0, 0.0],
        chest: [0.0, 0.0, 8.0],
        head: [0.0, -16.0, 0.0],
        arms: [ASIDE, ABOVE],
        legs: [unfolded.legs[1], TURNED_OUT],
        points: [1.0, 0.0],
        ..FIRST
    };
    let facing = |pose: RecordedPose| RecordedPose {
        hips: [pose.hips[0], 360.0, pose.hips[2]],
        ..pose
    };
    let bow = RecordedPose {
        hips: [0.0, 360.0, 0.0],
        chest: [36.0, 0.0, 0.0],
        head: [18.0, 0.0, 0.0],
        arms: [ASIDE, LOW],
        legs: [STRAIGHT, limb_pose([0.16, -0.94, -0.34], [0.02, -0.90, -0.46])],
        points: [0.0, 1.0],
        ..FIRST
    };
    let poses = [
        FIRST,
        plie,
        rise,
        unfolded,
        pointed,
        turning_pose(120.0),
        turning_pose(240.0),
        turning_pose(360.0),
        facing(pointed),
        arabesque_pose(),
        facing(plie),
        leaping_pose(),
        facing(plie),
        mirrored,
        bow,
    ];
    (0..).map(|k| f64::from(k) / 2.0).zip(poses).collect()
}
