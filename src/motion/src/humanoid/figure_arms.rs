//! Which limbs of a figure are its arms, and what stands in for one that is not clear.

use super::arms::{Arm, Judged};
use super::figure::{BONE_STEPS, ELBOW, JudgedArms, SIDES, SideNames, StandingFigure, WRIST};
use super::joint_chain::{bend_of, place_along};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;

/// What a joint gets that was mirrored from the other side.
const MIRRORED: f64 = 0.8;
/// What a pair counts, of which one is mirrored, against one that is found.
const BAD_PAIR: f64 = 0.6;
impl StandingFigure {
    /// The pair of limbs that looks most like arms. Where only one of them does, it is mirrored.
    pub(super) fn chosen_arms(&self, exec: &Exec<'_>) -> Result<JudgedArms, Cancelled> {
        let search = &self.search;
        let found = search.arms(&self.legs, exec)?;
        let mut sides = found.map(|arms| {
            let judged = arms.into_iter().map(|arm| {
                let judged = search.judge_arm(&arm, self.legs.crotch);
                (arm, judged)
            });
            judged.collect::<Vec<_>>()
        });
        for (side, arms) in SIDES.iter().zip(&mut sides) {
            self.trust_given_arm(side, arms);
        }
        let clear = sides.iter().flatten().filter(|(_, judged)| judged.score > BAD_PAIR);
        let longest = clear.map(|(arm, _)| arm.length()).fold(f64::MIN_POSITIVE, f64::max);
        // Of two limbs the one that was followed farther is the likelier arm: ears are shorter.
        let followed = |arm: &Arm| (arm.length() / longest).min(1.0);
        let [left, right] = &sides;
        let mut best: Option<(f64, JudgedArms)> = None;
        let mut keep = |rank: f64, arms: JudgedArms| {
            if best.as_ref().is_none_or(|best| rank > best.0) {
                best = Some((rank, arms));
            }
        };
        for l in left {
            for r in right {
                let pair = search.judge_pair([&l.0, &r.0]);
                let mut both = [l.clone(), r.clone()];
                both.iter_mut().for_each(|(_, judged)| judged.lower_as(&pair));
                let rank = both[0].1.score.min(both[1].1.score) * followed(&l.0).max(followed(&r.0));
                keep(rank, both.map(Some));
            }
        }
        for (k, arms) in sides.iter().enumerate() {
            for own in arms {
                let others = sides[1 - k].iter().map(|other| &other.0);
                let completed = others.filter_map(|other| self.completed_arm(&SIDES[1 - k], own, other));
                for mut other in completed.chain(self.mirrored_arm(&SIDES[1 - k], own)) {
                    let pair = search.judge_pair([&own.0, &other.0]);
                    other.1.lower_as(&pair);
                    let reach = followed(&own.0);
                    let mut own = own.clone();
                    own.1.lower_as(&pair);
                    let rank = BAD_PAIR * own.1.score.min(other.1.score) * reach;
                    let both = [Some(own), Some(other)];
                    let [a, b] = both;
                    keep(rank, if k == 0 { [a, b] } else { [b, a] });
                }
            }
        }
        if let Some((_, arms)) = best {
            return Ok(arms);
        }
        let first = |arms: &Vec<(Arm, Judged)>| arms.first().cloned();
        Ok([first(left), first(right)])
    }

    /// Where joints of an arm are given, only limbs that pass near them count; without one, a line through them is the arm.
    fn trust_given_arm(&self, side: &SideNames, arms: &mut Vec<(Arm, Judged)>) {
        let given: Vec<DVec3> = side
            .arm
            .iter()
            .filter_map(|name| self.given.get(name))
            .copied()
            .collect();
        if given.is_empty() {
            return;
        }
        let height = self.search.extent.y;
        let off = |line: &[DVec3], p: DVec3| {
            let places = (0..=50).map(|k| place_along(line, f64::from(k) / 50.0));
            places.map(|q| q.distance(p)).fold(f64::INFINITY, f64::min)
        };
        arms.retain(|(arm, _)| given.iter().all(|p| off(&arm.line, *p) < 0.07 * height));
        if arms.is_empty() && given.len() > 1 {
            let mut line = given;
            if !self.given.contains_key(side.arm[0]) {
                line.insert(0, line[0] + (line[0] - line[1]) * 0.4);
            }
            let arm = Arm {
                line,
                radius: 0.0,
                bulge: 1.0,
            };
            arms.push((arm, Judged::GOOD));
        }
    }

    /// A limb that could not be followed up to its shoulder, with the mirrored shoulder of the other side's arm; `None` where that is
    /// not as long as the other one, or leaves the body.
    fn completed_arm(&self, side: &SideNames, (arm, judged): &(Arm, Judged), limb: &Arm) -> Option<(Arm, Judged)> {
        let search = &self.search;
        let shoulder = search.mirrored(arm.shoulder());
        let end = limb.shoulder();
        let is_inside = (0..=BONE_STEPS).filter(|k| {
            let t = f64::from(*k) / f64::from(BONE_STEPS);
            search.lattice.is_near(end.lerp(shoulder, t))
        });
        let is_inside = is_inside.count() as f64 > 0.6 * f64::from(BONE_STEPS + 1);
        let mut completed = limb.clone();
        completed.line.push(shoulder);
        // A bulge of the trunk is not a limb.
        let is_limb = limb.radius < 1.4 * arm.radius && limb.length() > 0.4 * arm.length();
        let ratio = completed.length() / arm.length();
        let mut judged = judged.clone();
        judged.lower(MIRRORED, || {
            format!(
                "the {} arm was not clear; its shoulder is mirrored from the {} one",
                side.side, side.other
            )
        });
        let is_arm = is_limb && is_inside && (0.8..1.25).contains(&ratio);
        is_arm.then_some((completed, judged))
    }

    /// The arm of the other side mirrored to this one; `None` where this side's shoulder, elbow or wrist then is not inside.
    fn mirrored_arm(&self, side: &SideNames, (arm, judged): &(Arm, Judged)) -> Option<(Arm, Judged)> {
        let search = &self.search;
        let line: Vec<DVec3> = arm.line.iter().map(|p| search.mirrored(*p)).collect();
        let elbow = bend_of(&line, ELBOW).unwrap_or(ELBOW);
        let is_body = [1.0, elbow, WRIST]
            .iter()
            .all(|share| search.lattice.is_near(place_along(&line, *share)));
        let mut judged = judged.clone();
        judged.lower(MIRRORED, || {
            format!(
                "mirrored from the {} arm, as the {} one was not clear",
                side.other, side.side
            )
        });
        is_body.then(|| (Arm { line, ..arm.clone() }, judged))
    }
}
