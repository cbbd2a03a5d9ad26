//! How sure the joints of a figure are: what is known of bodies, and where the joints lie.

use super::arms::{Judged, between};
use super::body_search::{LegGap, PERSON};
use super::figure::{BONE_STEPS, JudgedArms, PlacedBody, SIDES, StandingFigure};
use glam::DVec3;

/// No arm is above the neck this near to the middle, over how far its shoulder is from there.
const OVER_NECK: f64 = 0.6;

impl StandingFigure {
    /// Lowers the scores of all joints, or those of legs, by how the whole stands.
    pub(super) fn judge_stance(&self, arms: &JudgedArms, placed: &mut PlacedBody) {
        let (search, legs) = (&self.search, &self.legs);
        let mut whole = Judged::GOOD;
        whole.lower(between(search.symmetry, 0.3, 0.55), || {
            "left and right do not mirror each other".into()
        });
        let [width, depth] = [search.extent.x, search.extent.z].map(|extent| extent / search.extent.y);
        whole.lower(between(depth, 1.2, 0.9), || "it is as deep as it is high".into());
        if depth > 0.55 {
            whole.lower(between(width / depth, 0.35, 0.9), || {
                "it is long and narrow, as an animal on four legs is".into()
            });
        }
        let neck = self.neck_below(placed);
        whole.lower(between(neck, 0.15, 0.33), || {
            "its arms begin above a neck, as ears do".into()
        });
        if self.axes.up.is_negative() && !self.is_up_known {
            whole.lower(0.6, || "it stands on its head in the file".into());
        }
        let mut stance = whole.clone();
        if legs.feet > 2 || self.stands_apart() {
            stance.lower(0.1, || "it stands on more than two feet".into());
        }
        let has_arms =
            arms.iter().flatten().all(|(_, judged)| judged.score > 0.6) && arms.iter().flatten().count() == 2;
        let shoulder = search.share_of(placed.at("lShoulder").y);
        let is_person = has_arms && between(shoulder, 0.7, 0.75) * between(shoulder, 0.92, 0.88) > 0.5;
        let apart = legs.crotch < PERSON + 0.2;
        match legs.gap {
            LegGap::Open if apart => {}
            LegGap::Thin if apart => {
                stance.lower(0.85 * between(search.symmetry, 0.5, 0.8), || "the legs touch".into())
            }
            LegGap::Missing if is_person && neck > 0.8 => stance.lower(0.6, || {
                "no gap parts the legs; hips and knees are where those of a person are".into()
            }),
            _ => stance.lower(0.15, || "no gap parts the legs".into()),
        }
        stance.lower(between(legs.crotch, 0.1, 0.22), || "the legs are very short".into());
        for (name, (_, judged)) in &mut placed.joints {
            let is_leg = SIDES.iter().any(|side| side.leg.contains(name)) || *name == "hips";
            judged.lower_as(if is_leg { &stance } else { &whole });
        }
    }

    /// Lowers the scores of joints by where they lie.
    pub(super) fn judge_places(&self, placed: &mut PlacedBody) {
        let lattice = &self.search.lattice;
        let height = self.search.extent.y;
        let names: Vec<&'static str> = placed.joints.keys().copied().collect();
        for name in names {
            let at = placed.at(name);
            if !name.ends_with("End") && !name.ends_with("Toe") && !lattice.is_near(at) {
                placed.lower(name, 0.4, || "it lies outside of the model".into());
            }
        }
        let neck = placed.at("neck").y;
        for side in &SIDES {
            let [hand, wrist, elbow, shoulder] = side.arm;
            let [hip, knee, ankle, _] = side.leg;
            let out = (placed.at(shoulder).x - self.search.middle).abs();
            for name in [hand, wrist, elbow] {
                let at = placed.at(name);
                if at.y > neck && (at.x - self.search.middle).abs() < OVER_NECK * out {
                    placed.lower(name, 0.3, || "it lies in the neck or the head".into());
                }
            }
            for name in [hand, wrist, elbow, shoulder] {
                let cell = lattice.cell_near(placed.at(name));
                let is_deep =
                    self.legs.side_of[cell] != 0 && lattice.places[cell].distance(placed.at(name)) < 2.0 * lattice.side;
                if is_deep {
                    placed.lower(name, 0.1, || "it lies in a leg".into());
                }
            }
            for [from, to] in [[shoulder, elbow], [elbow, wrist], [hip, knee], [knee, ankle]] {
                let inside = (1..BONE_STEPS).filter(|k| {
                    let t = f64::from(*k) / f64::from(BONE_STEPS);
                    lattice.is_near(placed.at(from).lerp(placed.at(to), t))
                });
                let share = inside.count() as f64 / f64::from(BONE_STEPS - 1);
                placed.lower(to, between(share, 0.1, 0.85), || {
                    format!("the bone from {from} to {to} leaves the model")
                });
            }
            for [above, below] in [
                [shoulder, hip],
                [hip, knee],
                [knee, ankle],
                ["chest", "hips"],
                ["head", "neck"],
            ] {
                let by = (placed.at(above).y - placed.at(below).y) / height;
                placed.lower(above, between(by, 0.0, 0.04), || format!("it is not above {below}"));
            }
        }
    }

    /// The least thickness from the hips to the shoulders over the most above it: small below a head.
    fn neck_below(&self, placed: &PlacedBody) -> f64 {
        let search = &self.search;
        let [left, right] = SIDES.each_ref().map(|side| placed.at(side.arm[3]));
        let half = 0.5 * (left.x - right.x).abs();
        let shoulder = search.share_of(0.5 * (left.y + right.y));
        let from = self.legs.crotch + 0.05;
        let rows = search.row_at(from)..search.row_at(shoulder + 0.05);
        let counts: Vec<usize> = rows
            .map(|row| {
                let xs = search.rows[row].iter().map(|cell| search.lattice.places[*cell].x);
                xs.filter(|x| (x - search.middle).abs() <= half).count()
            })
            .collect();
        let mut worst: f64 = 1.0;
        let mut above = 0;
        for count in counts.iter().rev() {
            above = above.max(*count);
            worst = worst.min(*count as f64 / above.max(1) as f64);
        }
        worst
    }

    /// Whether what touches the ground at one side lies far apart.
    fn stands_apart(&self) -> bool {
        let search = &self.search;
        let sole = search.rows[..=search.row_at(0.04)].iter().flatten();
        let sole: Vec<DVec3> = sole.map(|cell| search.lattice.places[*cell]).collect();
        [1.0, -1.0].iter().any(|sign| {
            let own = sole.iter().filter(|p| (p.x - search.middle) * sign > 0.0);
            let mut along: Vec<f64> = own.map(|p| p.z).collect();
            along.sort_by(f64::total_cmp);
            along.windows(2).any(|w| w[1] - w[0] > 0.1 * search.extent.y)
        })
    }
}
