//! When feet stand on the floor, found in how a recording moves them.

use glam::DVec3;

/// How high above its floor a point that stands may be, and how fast it may be there, in leg lengths and in leg lengths a second:
/// until it stands, and while it does.
const HEIGHT: [f64; 2] = [0.06, 0.12];
const SPEED: [f64; 2] = [0.35, 0.8];
/// Half the time over which speed is measured, in seconds.
const HALF_SPAN: f64 = 1.0 / 30.0;
/// The part of all frames in which a point is below its floor.
const BELOW: f64 = 0.05;
/// A contact is at least so long, in seconds; a longer pause ends it.
pub(super) const SHORTEST: f64 = 0.1;
const PAUSE: f64 = 0.05;

/// What of a foot stands in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// The ball of the foot and the heel.
    Flat,
    /// The ball of the foot alone.
    Toe,
    /// The heel alone.
    Ankle,
}

/// Where the toe and the ankle of a foot are in each frame.
pub(super) struct FootTrack {
    pub(super) toe: Vec<DVec3>,
    pub(super) ankle: Vec<DVec3>,
    /// Length of the leg.
    pub(super) leg: f64,
}

impl FootTrack {
    /// By frame, whether the ankle is still, however high: its foot then turns no more than it trembles.
    pub(super) fn ankle_rests(&self, interval: f64) -> Vec<bool> {
        let is_slow = |k: usize| speed_at(&self.ankle, k, interval) <= SPEED[0] * self.leg;
        (0..self.ankle.len()).map(is_slow).collect()
    }

    /// By frame, whether the foot stands; frames are `interval` seconds apart, `up` is the vertical.
    pub(super) fn standing(&self, up: DVec3, interval: f64) -> Vec<Option<Standing>> {
        let toe = contacts_of(&self.toe, up, self.leg, interval);
        let ankle = contacts_of(&self.ankle, up, self.leg, interval);
        let pairs = toe.iter().zip(&ankle);
        let mut standing: Vec<Option<Standing>> = pairs
            .map(|pair| match pair {
                (true, true) => Some(Standing::Flat),
                (true, false) => Some(Standing::Toe),
                (false, true) => Some(Standing::Ankle),
                _ => None,
            })
            .collect();
        let frames = |seconds: f64| (seconds / interval).round() as usize;
        let is_pause =
            |run: &std::ops::Range<usize>| run.start > 0 && run.end < toe.len() && run.len() <= frames(PAUSE);
        for pause in runs(&standing, |s| s.is_none()).into_iter().filter(is_pause) {
            let before = standing[pause.start - 1];
            standing[pause].fill(before);
        }
        for run in runs(&standing, |s| s.is_some()) {
            if run.len() <= frames(SHORTEST) {
                standing[run].fill(None);
            }
        }
        standing
    }
}

/// Runs of entries for which something holds.
pub(super) fn runs<T>(entries: &[T], holds: impl Fn(&T) -> bool) -> Vec<std::ops::Range<usize>> {
    let mut found: Vec<std::ops::Range<usize>> = Vec::new();
    for (k, _) in entries.iter().enumerate().filter(|entry| holds(entry.1)) {
        match found.last_mut() {
            Some(last) if last.end == k => last.end += 1,
            _ => found.push(k..k + 1),
        }
    }
    found
}

/// How fast a point is in a frame, in its units a second.
fn speed_at(places: &[DVec3], frame: usize, interval: f64) -> f64 {
    let half = ((HALF_SPAN / interval).round() as usize).max(1);
    let (from, to) = (frame.saturating_sub(half), (frame + half).min(places.len() - 1));
    let seconds = ((to - from).max(1)) as f64 * interval;
    places[to].distance(places[from]) / seconds
}

/// By frame, whether a point stands: it begins to where it is low and slow, and goes on until it is clearly higher or faster.
fn contacts_of(places: &[DVec3], up: DVec3, leg: f64, interval: f64) -> Vec<bool> {
    let mut heights: Vec<f64> = places.iter().map(|p| p.dot(up)).collect();
    heights.sort_unstable_by(f64::total_cmp);
    let floor = heights[(BELOW * heights.len() as f64) as usize];
    let mut stands = false;
    let contact = |k: usize| {
        let speed = speed_at(places, k, interval);
        let allowed = usize::from(stands);
        stands = places[k].dot(up) - floor <= HEIGHT[allowed] * leg && speed <= SPEED[allowed] * leg;
        stands
    };
    (0..places.len()).map(contact).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A point that is lifted by `height` and carried along for a third of a second, again and again, noisy by `noise`.
    fn track(height: f64, noise: f64) -> Vec<DVec3> {
        let place = |k: usize| {
            let (step, within) = (k / 20, k % 20);
            let share = (within as f64 - 10.0).max(0.0) / 10.0;
            let lift = height * (std::f64::consts::PI * share).sin();
            let shake = noise * if k.is_multiple_of(2) { 1.0 } else { -1.0 };
            DVec3::new(shake, lift + shake, step as f64 + share)
        };
        (0..100).map(place).collect()
    }

    #[test]
    fn a_point_stands_between_lifts_and_noise_does_not_part_it() {
        for noise in [0.0, 0.004] {
            let toe = track(0.2, noise);
            let foot = FootTrack {
                ankle: track(0.3, noise),
                toe,
                leg: 1.0,
            };
            let found = runs(&foot.standing(DVec3::Y, 1.0 / 30.0), |s| s.is_some());
            assert_eq!(found.len(), 5, "{found:?}");
            for (k, run) in found.iter().enumerate() {
                assert!(
                    run.start.abs_diff(20 * k) <= 2 && run.end.abs_diff(20 * k + 11) <= 2,
                    "{found:?}"
                );
            }
        }
    }

    #[test]
    fn a_foot_that_slides_or_hangs_does_not_stand() {
        let slides: Vec<DVec3> = (0..90).map(|k| DVec3::Z * (0.1 * f64::from(k))).collect();
        let foot = FootTrack {
            toe: slides.clone(),
            ankle: slides,
            leg: 1.0,
        };
        assert!(foot.standing(DVec3::Y, 1.0 / 30.0).iter().all(Option::is_none));
    }
}
