//! Joints along a limb: where they lie by default, and where those go that depend on a joint that is given.

use glam::DVec3;

/// How far off the straight way a joint has to be to show where the limb bends, over its length.
const BEND: f64 = 0.04;
/// Steps of a line in which the point nearest to a given joint is looked for.
const STEPS: u32 = 100;

/// The place at a share of a line's length.
pub(super) fn place_along(line: &[DVec3], share: f64) -> DVec3 {
    let all: f64 = line.windows(2).map(|w| w[0].distance(w[1])).sum();
    let mut left = share * all;
    for w in line.windows(2) {
        let length = w[0].distance(w[1]);
        if left <= length && length > 0.0 {
            return w[0].lerp(w[1], left / length);
        }
        left -= length;
    }
    line.last().copied().unwrap_or_default()
}

/// Where a line bends most near a share of its length, as a share; `None` where it is straight there.
pub(super) fn bend_of(line: &[DVec3], near: f64) -> Option<f64> {
    let (from, to) = (*line.first()?, *line.last()?);
    let length: f64 = line.windows(2).map(|w| w[0].distance(w[1])).sum();
    let way = (to - from).try_normalize()?;
    let off = |p: DVec3| ((p - from) - way * (p - from).dot(way)).length();
    let shares = (0..=20).map(|k| near - 0.12 + 0.012 * f64::from(k));
    let ranked = shares.map(|share| (off(place_along(line, share)), share));
    let best = ranked.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 > BEND * length).then_some(best.1)
}

/// A joint of a chain.
#[derive(Debug, Clone, Copy)]
pub(super) struct ChainJoint {
    /// Where it lies along the line, as a share of its length, where nothing is given.
    pub(super) share: f64,
    /// Where it is, if that is given.
    pub(super) given: Option<DVec3>,
}

/// A given joint: its default share, where the line is nearest to it, and how far off the line it is.
struct ChainAnchor {
    share: f64,
    along: f64,
    off: DVec3,
}

/// The places of joints along a line, whose shares rise. Joints that are given stay; those between them are spread over what the
/// line has between them, and go with them where they lie beside the line.
pub(super) fn place_chain(line: &[DVec3], joints: &[ChainJoint]) -> Vec<DVec3> {
    let free_end = |share: f64| ChainAnchor {
        share,
        along: share,
        off: DVec3::ZERO,
    };
    let mut anchors = vec![free_end(0.0)];
    for joint in joints {
        let Some(given) = joint.given else { continue };
        let shares = (0..=STEPS).map(|k| f64::from(k) / f64::from(STEPS));
        let ranked = shares.map(|share| (place_along(line, share).distance_squared(given), share));
        let nearest = ranked
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map_or(joint.share, |best| best.1);
        let least = anchors.last().map_or(0.0, |before| before.along);
        let along = nearest.max(least);
        let off = given - place_along(line, along);
        if joint.share <= 0.0 {
            anchors.clear();
        }
        anchors.push(ChainAnchor {
            share: joint.share,
            along,
            off,
        });
    }
    if anchors.last().is_some_and(|last| last.share < 1.0) {
        anchors.push(free_end(1.0));
    }
    let place = |joint: &ChainJoint| {
        let after = anchors
            .iter()
            .position(|a| a.share >= joint.share)
            .unwrap_or(anchors.len() - 1);
        let (before, after) = (&anchors[after.saturating_sub(1)], &anchors[after]);
        let width = after.share - before.share;
        let t = if width > 0.0 {
            ((joint.share - before.share) / width).clamp(0.0, 1.0)
        } else {
            0.0
        };
        place_along(line, before.along + (after.along - before.along) * t) + before.off.lerp(after.off, t)
    };
    joints
        .iter()
        .map(|joint| joint.given.unwrap_or_else(|| place(joint)))
        .collect()
}
