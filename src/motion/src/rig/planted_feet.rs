//! Feet that stay where they stand, in spite of other proportions than those of who was recorded.
//!
//! While a foot stands, the point on which it does is to stay where it is. What this takes is known of the whole recording before the
//! first frame (`contacts`): by frame of the recording, a shift of each ankle and of the root. A shift goes against the drift of the
//! point that stands, is nothing in the mean over a contact and passes smoothly to the next one or to nothing, so that nothing jumps
//! where a contact begins or ends. The root moves with the feet that stand, so that legs keep their attitude where one foot stands
//! alone, and is lowered where a leg would be too short. Legs are then turned for the rest (`leg_reach`). Soles stand on the floor on which
//! the figure stands in its rest pose, where a contact is not on another one. A foot that lies flat is level, and kept
//! from trembling (`foot_attitudes`).

use super::bones::MotionRig;
use super::contacts::{FootTrack, SHORTEST, Standing, runs};
use super::foot_attitudes::{evening_turns, levelling_tilt};
use super::leg_reach::ReachingLeg;
use super::legs::Leg;
use super::rigid_motion::RigidMotion;
use super::soles::sole_points;
use glam::{DQuat, DVec3};
use std::ops::Range;

/// How long a shift lasts before and after a contact, in seconds.
const BLEND: f64 = 0.2;
/// A leg is at most as straight as this share of its length, unless the recording has it so.
const STRAIGHTEST: f64 = 0.99;
/// The root is lowered by no more than this share of a leg.
const LOWEST: f64 = 0.15;
/// An ankle is shifted by no more than this share of a leg; where it would be, a contact is ended sooner or begun later.
const FARTHEST: f64 = 0.12;
/// What stands at most this share of a leg above or below the floor stands on it.
const SAME_FLOOR: f64 = 0.06;
/// Half the time over which the lowering of the root and the attitudes of flat feet are evened out, in seconds.
const EVENED: f64 = 0.1;

/// The same in frames, at most.
const MOST_EVENED: usize = 64;

/// When the frames of a recording are, in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RecordedTimes {
    pub(super) start: f64,
    pub(super) interval: f64,
    /// How many there are, at least one.
    pub(super) count: usize,
}

impl RecordedTimes {
    /// Half the time over which something is evened out, in frames.
    fn evened(&self) -> usize {
        ((EVENED / self.interval).round() as usize).clamp(1, MOST_EVENED)
    }
}

/// A foot, when it stands, and how far its ankle is shifted.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlantedFoot {
    reaching: ReachingLeg,
    /// The ball of the foot in the rest pose.
    toe: DVec3,
    /// Points of the sole in the rest pose, one at least.
    sole: Vec<DVec3>,
    /// By frame of the recording.
    standing: Vec<Option<Standing>>,
    shifts: Vec<DVec3>,
    /// How the foot is tilted in its rest pose.
    tilt: DQuat,
    /// How it is turned then beside the recording; empty for a leg without a foot.
    turns: Vec<DQuat>,
}

/// Joints of a leg of a recording, in its units, the vertical along y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RecordedLeg {
    pub(super) hip: DVec3,
    pub(super) knee: DVec3,
    pub(super) ankle: DVec3,
    pub(super) toe: DVec3,
}

/// Where a leg is in the frames of a recording, as it is driven.
struct DrivenLeg {
    hips: Vec<DVec3>,
    /// The foot's attitudes.
    attitudes: Vec<DQuat>,
    track: FootTrack,
    /// How high the lowest point of the sole is.
    lowest: Vec<f64>,
    /// The same foot in the recording.
    recorded: FootTrack,
    /// The sum over frames of the axis about which the knee is bent, in the thigh's rest pose.
    bent: DVec3,
}

/// The feet of a driven rig.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantedFeet {
    feet: Vec<PlantedFoot>,
    /// By frame of the recording, how far the root is shifted.
    roots: Vec<DVec3>,
    parents: Vec<Option<usize>>,
    times: RecordedTimes,
}

/// What a foot does in some frames.
#[derive(Debug, Clone, PartialEq)]
pub struct FootContacts {
    /// Number of its bone in the rig; that of the shin where the rig has no foot.
    pub bone: usize,
    /// From when to when it stands, in seconds of the clip.
    pub contacts: Vec<[f64; 2]>,
    /// Frames in which it stands.
    pub planted: usize,
    /// How far the point that stands moves from such a frame to the next, in the mean, in model units: as the bones are driven, and
    /// with feet that are planted.
    pub drift: [f64; 2],
}

impl PlantedFeet {
    /// Finds when feet stand; `None` for a rig without legs, or a motion that is not finite. `driven` has the bones at a time as they
    /// are driven, `recorded` a leg of the recording, in the model's space.
    pub(super) fn of(
        rig: &MotionRig,
        mut feet: Vec<PlantedFoot>,
        times: RecordedTimes,
        driven: impl Fn(f64) -> Vec<RigidMotion>,
        recorded: impl Fn(f64, &Leg) -> RecordedLeg,
    ) -> Option<Self> {
        let up = rig.up.direction();
        if feet.is_empty() {
            return None;
        }
        let mut moved: Vec<DrivenLeg> = Vec::with_capacity(feet.len());
        for foot in &feet {
            let leg = recorded(times.start, &foot.reaching.leg);
            let length = leg.hip.distance(leg.knee) + leg.knee.distance(leg.ankle);
            moved.push(DrivenLeg::of(foot.reaching.length(), length));
        }
        for frame in 0..times.count {
            let seconds = times.start + frame as f64 * times.interval;
            let world = driven(seconds);
            for (foot, leg) in feet.iter().zip(&mut moved) {
                leg.push(foot, &world, &recorded(seconds, &foot.reaching.leg));
            }
        }
        let half = times.evened();
        for (foot, leg) in feet.iter_mut().zip(&mut moved) {
            foot.reaching.hinge = leg.bent.normalize_or(foot.reaching.hinge);
            foot.standing = leg.recorded.standing(up, times.interval);
            let is_flat: Vec<bool> = foot.standing.iter().map(|s| *s == Some(Standing::Flat)).collect();
            foot.tilt = levelling_tilt(&leg.attitudes, &is_flat, up);
            let rests = leg.recorded.ankle_rests(times.interval);
            let is_still = rests.iter().zip(&foot.standing).map(|(rests, s)| *rests && s.is_some());
            foot.turns = evening_turns(&leg.attitudes, &is_still.collect::<Vec<bool>>(), half);
            leg.turn_foot(foot, up);
        }
        let floor = feet.iter().flat_map(|foot| &foot.sole).map(|p| p.dot(up));
        let floor = floor.fold(f64::INFINITY, f64::min);
        let above = height_of_feet(&feet, &moved).map_or(0.0, |height| height - floor);
        for (foot, leg) in feet.iter_mut().zip(&moved) {
            foot.release(&leg.track, (SHORTEST / times.interval).round() as usize);
            foot.shifts = foot.shifts_of(leg, [up, up * (floor + above)], times.interval);
        }
        let mut roots = carried_roots(&feet, times.interval);
        let lowered = lowered(up, &feet, &moved, &roots, half);
        for (root, lowered) in roots.iter_mut().zip(lowered) {
            *root -= up * (lowered + above);
        }
        let shifts = feet.iter_mut().flat_map(|foot| &mut foot.shifts);
        shifts.for_each(|shift| *shift -= up * above);
        let shifts = feet.iter().flat_map(|foot| &foot.shifts).chain(&roots);
        let is_finite = shifts.into_iter().all(|shift| shift.is_finite());
        is_finite.then(|| Self {
            roots,
            feet,
            parents: rig.bones.iter().map(|bone| bone.parent).collect(),
            times,
        })
    }

    /// Two frames of the recording around a time, and how far it is from the first to the second.
    fn around(&self, seconds: f64) -> (usize, usize, f64) {
        let last = self.roots.len() - 1;
        let at = ((seconds - self.times.start) / self.times.interval).clamp(0.0, last as f64);
        let before = (at as usize).min(last);
        // Times of frames are not exact.
        let share = at - before as f64;
        (before, (before + 1).min(last), if share < 1e-6 { 0.0 } else { share })
    }

    /// Moves the bones to where feet are planted.
    pub(super) fn plant(&self, seconds: f64, world: &mut [RigidMotion]) {
        let (before, after, share) = self.around(seconds);
        let root = self.roots[before].lerp(self.roots[after], share);
        let shift = |foot: &PlantedFoot| foot.shifts[before].lerp(foot.shifts[after], share);
        let turn = |foot: &PlantedFoot| match (foot.turns.get(before), foot.turns.get(after)) {
            (Some(before), Some(after)) => before.lerp(*after, share).normalize(),
            _ => DQuat::IDENTITY,
        };
        let is_moved = |foot: &PlantedFoot| {
            shift(foot) != DVec3::ZERO || turn(foot) != DQuat::IDENTITY || foot.tilt != DQuat::IDENTITY
        };
        if root == DVec3::ZERO && !self.feet.iter().any(is_moved) {
            return;
        }
        let targets: Vec<DVec3> = (self.feet.iter())
            .map(|foot| foot.reaching.joints(world)[2] + shift(foot))
            .collect();
        world.iter_mut().for_each(|motion| motion.to += root);
        for (foot, target) in self.feet.iter().zip(targets) {
            let attitude = foot
                .reaching
                .leg
                .foot
                .map_or(DQuat::IDENTITY, |foot| world[foot].rotation);
            let turn = turn(foot) * attitude * foot.tilt * attitude.inverse();
            foot.reaching.reach(world, &self.parents, target, turn.normalize());
        }
    }

    /// What feet do at some times. `driven` has the bones as they are driven.
    pub(super) fn contacts(&self, times: &[f64], driven: impl Fn(f64) -> Vec<RigidMotion>) -> Vec<FootContacts> {
        let both = [Standing::Flat, Standing::Ankle];
        let mut found: Vec<FootContacts> = self.feet.iter().map(PlantedFoot::no_contacts).collect();
        let mut steps = vec![0u32; self.feet.len()];
        let mut before: Vec<Option<(Standing, [[DVec3; 2]; 2])>> = vec![None; self.feet.len()];
        for seconds in times {
            let driven = driven(*seconds);
            let mut planted = driven.clone();
            self.plant(*seconds, &mut planted);
            let (first, _, share) = self.around(*seconds);
            let frame = if share < 0.5 {
                first
            } else {
                (first + 1).min(self.roots.len() - 1)
            };
            for (k, foot) in self.feet.iter().enumerate() {
                let Some(standing) = foot.standing[frame] else {
                    before[k] = None;
                    continue;
                };
                let now = [&driven, &planted].map(|world| both.map(|point| foot.point(world, point)));
                found[k].planted += 1;
                if let Some((stood, was)) = before[k] {
                    let point = usize::from(stood == standing && standing == Standing::Ankle);
                    steps[k] += 1;
                    for (which, drift) in found[k].drift.iter_mut().enumerate() {
                        *drift += now[which][point].distance(was[which][point]);
                    }
                } else {
                    found[k].contacts.push([*seconds; 2]);
                }
                if let Some(contact) = found[k].contacts.last_mut() {
                    contact[1] = *seconds;
                }
                before[k] = Some((standing, now));
            }
        }
        for (found, steps) in found.iter_mut().zip(steps) {
            found.drift = found.drift.map(|sum| sum / f64::from(steps.max(1)));
        }
        found
    }
}

impl DrivenLeg {
    /// No frame yet of a leg that is so long, and so long in the recording.
    fn of(length: f64, recorded: f64) -> Self {
        let track = |leg: f64| FootTrack {
            toe: Vec::new(),
            ankle: Vec::new(),
            leg,
        };
        Self {
            hips: Vec::new(),
            attitudes: Vec::new(),
            lowest: Vec::new(),
            track: track(length),
            recorded: track(recorded),
            bent: DVec3::ZERO,
        }
    }

    fn push(&mut self, foot: &PlantedFoot, world: &[RigidMotion], recorded: &RecordedLeg) {
        self.recorded.ankle.push(recorded.ankle);
        self.recorded.toe.push(recorded.toe);
        let [hip, knee, ankle] = foot.reaching.joints(world);
        self.hips.push(hip);
        self.track.ankle.push(ankle);
        self.track.toe.push(foot.point(world, Standing::Toe));
        if let Some(foot) = foot.reaching.leg.foot {
            self.attitudes.push(world[foot].rotation);
        }
        let back = world[foot.reaching.leg.thigh].rotation.inverse();
        self.bent += back * (knee - hip).cross(ankle - knee);
    }

    /// Turns and tilts the foot in each frame about its ankle.
    fn turn_foot(&mut self, foot: &PlantedFoot, up: DVec3) {
        let below = |p: DVec3| foot.tilt * (p - foot.reaching.rest[2]);
        let (ball, sole): (DVec3, Vec<DVec3>) = (below(foot.toe), foot.sole.iter().map(|p| below(*p)).collect());
        let ends = self.track.toe.iter_mut().zip(&self.track.ankle);
        for ((toe, ankle), (turn, attitude)) in ends.zip(foot.turns.iter().zip(&self.attitudes)) {
            let attitude = *turn * *attitude;
            *toe = *ankle + attitude * ball;
            let height = |p: &DVec3| (*ankle + attitude * *p).dot(up);
            self.lowest.push(sole.iter().map(height).fold(f64::INFINITY, f64::min));
        }
        if self.lowest.is_empty() {
            self.lowest = self.track.toe.iter().map(|toe| toe.dot(up)).collect();
        }
    }
}

impl PlantedFoot {
    /// A foot that stands nowhere yet; `None` for a leg with a bone without length.
    pub(super) fn at_rest(leg: Leg, rig: &MotionRig, rest_vertices: &[DVec3]) -> Option<Self> {
        let rest = leg.rest_joints(rig);
        let toe = leg.foot.map_or(rest[2], |foot| rig.bones[foot].to);
        let mut sole = sole_points(rig, &leg, rest_vertices);
        if sole.is_empty() {
            sole.push(toe);
        }
        // Knees bend so that shins go back from where feet point.
        let hinge = rig.up.direction().cross(toe - rest[2]).normalize_or(DVec3::X);
        (rest[0] != rest[1] && rest[1] != rest[2]).then(|| Self {
            reaching: ReachingLeg { leg, rest, hinge },
            toe,
            sole,
            standing: Vec::new(),
            shifts: Vec::new(),
            tilt: DQuat::IDENTITY,
            turns: Vec::new(),
        })
    }

    fn no_contacts(&self) -> FootContacts {
        FootContacts {
            bone: self.reaching.leg.foot.unwrap_or(self.reaching.leg.shin),
            contacts: Vec::new(),
            planted: 0,
            drift: [0.0; 2],
        }
    }

    /// Where a point of the foot is.
    fn point(&self, world: &[RigidMotion], point: Standing) -> DVec3 {
        match point {
            Standing::Ankle => self.reaching.joints(world)[2],
            Standing::Toe | Standing::Flat => {
                world[self.reaching.leg.foot.unwrap_or(self.reaching.leg.shin)].place(self.toe)
            }
        }
    }

    /// Ends contacts sooner, or begins them later, where they would shift the ankle too far; those that become no longer than so many
    /// frames are none.
    fn release(&mut self, track: &FootTrack, shortest: usize) {
        let farthest = FARTHEST * self.reaching.length();
        let mut shifts = vec![DVec3::ZERO; self.standing.len()];
        for run in runs(&self.standing, Option::is_some) {
            self.fill_contact(track, run.clone(), &mut shifts);
            let mut kept = run.clone();
            let mut sum: DVec3 = shifts[run.clone()].iter().sum();
            while !kept.is_empty() {
                let mean = sum / kept.len() as f64;
                let [first, last] = [kept.start, kept.end - 1].map(|k| shifts[k].distance(mean));
                if first.max(last) <= farthest {
                    break;
                }
                if first > last {
                    sum -= shifts[kept.start];
                    kept.start += 1;
                } else {
                    kept.end -= 1;
                    sum -= shifts[kept.end];
                }
            }
            if kept.len() <= shortest {
                kept = run.start..run.start;
            }
            self.standing[run.start..kept.start].fill(None);
            self.standing[kept.end..run.end].fill(None);
        }
    }

    /// By frame, by how much the ankle is shifted. `up` is the vertical, `floor` a point on the floor.
    fn shifts_of(&self, leg: &DrivenLeg, [up, floor]: [DVec3; 2], interval: f64) -> Vec<DVec3> {
        let mut shifts = vec![DVec3::ZERO; self.standing.len()];
        let contacts = runs(&self.standing, Option::is_some);
        for run in &contacts {
            self.fill_contact(&leg.track, run.clone(), &mut shifts);
            let is_flat = |k: &usize| self.standing[*k] == Some(Standing::Flat);
            let on_sole: Vec<usize> = match run.clone().any(|k| is_flat(&k)) {
                true => run.clone().filter(is_flat).collect(),
                false => run.clone().collect(),
            };
            let sum: f64 = on_sole
                .iter()
                .map(|k| leg.lowest[*k] + (shifts[*k] - floor).dot(up))
                .sum();
            let above = sum / on_sole.len() as f64;
            if above.abs() <= SAME_FLOOR * self.reaching.length() {
                shifts[run.clone()].iter_mut().for_each(|shift| *shift -= up * above);
            }
        }
        let blend = ((BLEND / interval).round() as usize).max(1);
        let gaps = runs(&self.standing, Option::is_none);
        for gap in gaps {
            let before = (gap.start > 0).then(|| EdgeOfContact::leaving(&shifts, &contacts, gap.start));
            let after = (gap.end < shifts.len()).then(|| EdgeOfContact::arriving(&shifts, &contacts, gap.end));
            let steps = gap.len() + 1;
            for k in gap.clone() {
                let (since, until) = (k + 1 - gap.start, gap.end - k);
                shifts[k] = match (&before, &after) {
                    (Some(before), Some(after)) if steps <= 2 * blend => before.to(after, since, steps),
                    (Some(before), _) if since < blend => before.to(&EdgeOfContact::NOWHERE, since, blend),
                    (_, Some(after)) if until < blend => EdgeOfContact::NOWHERE.to(after, blend - until, blend),
                    _ => DVec3::ZERO,
                };
            }
        }
        shifts
    }

    /// Shifts that hold the point that stands, and are nothing in the mean.
    fn fill_contact(&self, track: &FootTrack, run: Range<usize>, shifts: &mut [DVec3]) {
        let mut shift = DVec3::ZERO;
        let mut sum = DVec3::ZERO;
        for k in run.clone() {
            if k > run.start {
                let (before, now) = (self.standing[k - 1], self.standing[k]);
                let holds_ankle = before == now && now == Some(Standing::Ankle);
                let path = if holds_ankle { &track.ankle } else { &track.toe };
                shift -= path[k] - path[k - 1];
            }
            shifts[k] = shift;
            sum += shift;
        }
        let mean = sum / run.len() as f64;
        shifts[run].iter_mut().for_each(|shift| *shift -= mean);
    }
}

/// The shift where a contact ends or begins, and how it changes from frame to frame there.
struct EdgeOfContact {
    shift: DVec3,
    step: DVec3,
}

impl EdgeOfContact {
    const NOWHERE: Self = Self {
        shift: DVec3::ZERO,
        step: DVec3::ZERO,
    };

    /// The end of the contact before a frame.
    fn leaving(shifts: &[DVec3], contacts: &[Range<usize>], frame: usize) -> Self {
        let is_long = contacts.iter().any(|run| run.end == frame && run.len() > 1);
        let shift = shifts[frame - 1];
        let step = if is_long {
            shift - shifts[frame - 2]
        } else {
            DVec3::ZERO
        };
        Self { shift, step }
    }

    /// The beginning of the contact at a frame.
    fn arriving(shifts: &[DVec3], contacts: &[Range<usize>], frame: usize) -> Self {
        let is_long = contacts.iter().any(|run| run.start == frame && run.len() > 1);
        let shift = shifts[frame];
        let step = if is_long {
            shifts[frame + 1] - shift
        } else {
            DVec3::ZERO
        };
        Self { shift, step }
    }

    /// The value so many of `steps` frames on the way to another, without a jump of place or speed.
    fn to(&self, other: &Self, since: usize, steps: usize) -> DVec3 {
        let span = steps as f64;
        let t = since as f64 / span;
        let back = 1.0 - t;
        self.shift * (1.0 + 2.0 * t) * back * back
            + self.step * (span * t * back * back)
            + other.shift * t * t * (1.0 + 2.0 * back)
            - other.step * (span * t * t * back)
    }
}

/// How high soles of feet that stand are, in the mean; `None` where none ever does.
fn height_of_feet(feet: &[PlantedFoot], moved: &[DrivenLeg]) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0usize);
    for (foot, leg) in feet.iter().zip(moved) {
        for (_, height) in foot
            .standing
            .iter()
            .zip(&leg.lowest)
            .filter(|(standing, _)| standing.is_some())
        {
            sum += height;
            count += 1;
        }
    }
    (count > 0).then(|| sum / count as f64)
}

/// By frame, the shift of the root that moves it with the feet that stand: the mean of theirs, each beginning and ending smoothly.
fn carried_roots(feet: &[PlantedFoot], interval: f64) -> Vec<DVec3> {
    let blend = ((BLEND / interval).round() as usize).max(1);
    let count = feet.first().map_or(0, |foot| foot.shifts.len());
    let mut sums = vec![(DVec3::ZERO, 0.0); count];
    for foot in feet {
        let mut shares: Vec<f64> = foot
            .standing
            .iter()
            .map(|s| if s.is_some() { 1.0 } else { 0.0 })
            .collect();
        for gap in runs(&foot.standing, Option::is_none) {
            for k in gap.clone() {
                let since = if gap.start > 0 { k + 1 - gap.start } else { blend };
                let until = if gap.end < count { gap.end - k } else { blend };
                let t = 1.0 - since.min(until).min(blend) as f64 / blend as f64;
                shares[k] = t * t * (3.0 - 2.0 * t);
            }
        }
        for ((sum, share), shift) in sums.iter_mut().zip(shares).zip(&foot.shifts) {
            *sum = (sum.0 + *shift * share, sum.1 + share);
        }
    }
    sums.into_iter()
        .map(|(sum, shares)| sum / f64::max(shares, 1.0))
        .collect()
}

/// By frame, how far the root is lowered, beside its own shift, so that all feet reach where they are shifted to.
fn lowered(up: DVec3, feet: &[PlantedFoot], moved: &[DrivenLeg], roots: &[DVec3], half: usize) -> Vec<f64> {
    let count = feet.first().map_or(0, |foot| foot.shifts.len());
    let needed = |k: usize| {
        let of_foot = |(foot, leg): (&PlantedFoot, &DrivenLeg)| {
            let (hip, ankle) = (leg.hips[k], leg.track.ankle[k]);
            let length = foot.reaching.length();
            let longest = hip.distance(ankle).max(STRAIGHTEST * length);
            let way = hip + roots[k] - (ankle + foot.shifts[k]);
            if way.length() <= longest {
                return 0.0;
            }
            let height = way.dot(up);
            let across = (way - up * height).length();
            let down = (longest * longest - across * across).max(0.0).sqrt();
            (height - down).clamp(0.0, LOWEST * length)
        };
        feet.iter().zip(moved).map(of_foot).fold(0.0, f64::max)
    };
    let needed: Vec<f64> = (0..count).map(needed).collect();
    let window = |k: usize, half: usize| k.saturating_sub(half)..(k + half + 1).min(count);
    let most: Vec<f64> = (0..count)
        .map(|k| needed[window(k, 2 * half)].iter().copied().fold(0.0, f64::max))
        .collect();
    // Means of what is enough all around are enough.
    let even = |values: &[f64]| -> Vec<f64> {
        (0..count)
            .map(|k| values[window(k, half)].iter().sum::<f64>() / window(k, half).len() as f64)
            .collect()
    };
    even(&even(&most))
}
