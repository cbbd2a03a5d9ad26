//! A figure that stands one way, and its joints in a space where its head is up and its face along z.

use super::arms::{Arm, Judged, between};
use super::body_axes::BodyAxes;
use super::body_lattice::BodyLattice;
use super::body_search::{BodySearch, Legs, median};
use super::joint_chain::{ChainJoint, bend_of, place_chain};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use std::collections::BTreeMap;

/// Where a wrist and an elbow are on the way from a finger's tip to the shoulder, and a knee on that from ankle to hip.
pub(super) const WRIST: f64 = 0.25;
pub(super) const ELBOW: f64 = 0.58;
pub(super) const KNEE: f64 = 0.53;
/// Steps along a bone that have to lie inside.
pub(super) const BONE_STEPS: u32 = 12;
/// Names of one side's joints.
pub(super) struct SideNames {
    pub(super) side: &'static str,
    pub(super) other: &'static str,
    pub(super) sign: i8,
    pub(super) arm: [&'static str; 4],
    pub(super) clavicle: &'static str,
    pub(super) leg: [&'static str; 4],
}

pub(super) const SIDES: [SideNames; 2] = [
    SideNames {
        side: "left",
        other: "right",
        sign: 1,
        arm: ["lHandEnd", "lWrist", "lElbow", "lShoulder"],
        clavicle: "lClav",
        leg: ["lHip", "lKnee", "lAnkle", "lToe"],
    },
    SideNames {
        side: "right",
        other: "left",
        sign: -1,
        arm: ["rHandEnd", "rWrist", "rElbow", "rShoulder"],
        clavicle: "rClav",
        leg: ["rHip", "rKnee", "rAnkle", "rToe"],
    },
];
const TRUNK: [&str; 6] = ["hips", "spine", "chest", "neck", "head", "headEnd"];

/// A figure that stands one way.
pub(super) struct StandingFigure {
    pub(super) axes: BodyAxes,
    pub(super) search: BodySearch,
    pub(super) legs: Legs,
    pub(super) is_up_known: bool,
    /// In the figure's own space.
    pub(super) given: BTreeMap<&'static str, DVec3>,
}

/// Joints in the figure's own space.
#[derive(Default)]
pub(super) struct PlacedBody {
    pub(super) joints: BTreeMap<&'static str, (DVec3, Judged)>,
}

impl PlacedBody {
    pub(super) fn at(&self, name: &str) -> DVec3 {
        self.joints[name].0
    }

    pub(super) fn put(&mut self, name: &'static str, at: DVec3, judged: &Judged) {
        self.joints.insert(name, (at, judged.clone()));
    }

    pub(super) fn lower(&mut self, name: &str, factor: f64, reason: impl FnOnce() -> String) {
        if let Some((_, judged)) = self.joints.get_mut(name) {
            judged.lower(factor, reason);
        }
    }
}

/// An arm of each side, with what is wrong with it.
pub(super) type JudgedArms = [Option<(Arm, Judged)>; 2];

impl StandingFigure {
    pub(super) fn standing(lattice: &BodyLattice, axes: BodyAxes, given: &BTreeMap<&'static str, DVec3>) -> Self {
        let turn = axes.upright_from_model();
        let search = BodySearch::of_lattice(lattice.turned(turn));
        let mut legs = search.legs();
        let given: BTreeMap<&'static str, DVec3> = given.iter().map(|(name, at)| (*name, turn * *at)).collect();
        let hips: Vec<f64> = ["lHip", "rHip"]
            .iter()
            .filter_map(|name| given.get(name))
            .map(|at| search.share_of(at.y))
            .collect();
        if !hips.is_empty() {
            legs.crotch = (hips.iter().sum::<f64>() / hips.len() as f64 / 1.07).clamp(0.05, 0.9);
        }
        Self {
            axes,
            search,
            legs,
            is_up_known: true,
            given,
        }
    }

    /// All joints.
    pub(super) fn joints(&self, exec: &Exec<'_>) -> Result<PlacedBody, Cancelled> {
        let mut placed = PlacedBody::default();
        let leg_radius = SIDES.each_ref().map(|side| self.place_leg(side, &mut placed));
        let arms = self.chosen_arms(exec)?;
        for (side, own) in SIDES.iter().zip(&arms) {
            self.place_arm(side, own.as_ref(), leg_radius, &mut placed);
        }
        self.place_even_shoulders(&mut placed);
        self.place_trunk(&mut placed);
        self.judge_stance(&arms, &mut placed);
        self.judge_places(&mut placed);
        for (name, (_, judged)) in &mut placed.joints {
            if self.is_trusted(name) {
                *judged = Judged::GOOD;
            }
        }
        Ok(placed)
    }

    /// Whether a joint is given, or lies at the end of a limb or along the trunk next to those that are.
    fn is_trusted(&self, name: &str) -> bool {
        let given = |name: &str| self.given.contains_key(name);
        let (side, joint) = name.split_at(1);
        let of_side = |joint: &str| given(&format!("{side}{joint}"));
        given(name)
            || match joint {
                "HandEnd" => of_side("Wrist"),
                "Toe" => of_side("Ankle"),
                "Clav" => of_side("Shoulder"),
                _ => match name {
                    "hips" => given("lHip") && given("rHip"),
                    "spine" | "chest" => (given("hips") || given("lHip")) && (given("neck") || given("lShoulder")),
                    "neck" | "head" => given("lShoulder") && given("rShoulder"),
                    "headEnd" => given("head"),
                    _ => false,
                },
            }
    }

    /// The line of a leg from just above the ankle to just below where legs part, and half its thickness.
    fn leg_line(&self, side: &SideNames) -> (Vec<DVec3>, f64) {
        let (search, crotch) = (&self.search, self.legs.crotch);
        let is_own = |cell: usize| self.legs.side_of[cell] == side.sign;
        let rows = 24;
        let from = self.ankle_share();
        let shares = (0..=rows).map(|k| from + (0.95 * crotch - from) * f64::from(k) / f64::from(rows));
        let line = shares.filter_map(|share| search.middle_of_row(share, is_own)).collect();
        let counts = (search.row_at(from)..search.row_at(0.9 * crotch))
            .map(|row| search.rows[row].iter().filter(|cell| is_own(**cell)).count() as f64);
        let radius = search.lattice.side * (median(counts.collect()) / std::f64::consts::PI).sqrt();
        (line, radius)
    }

    fn ankle_share(&self) -> f64 {
        0.115 * 1.07 * self.legs.crotch
    }

    /// Cells of a foot around an ankle.
    fn sole(&self, side: &SideNames, ankle: DVec3) -> Vec<DVec3> {
        let top = self.search.row_at(0.6 * self.ankle_share());
        let cells = self.search.rows[..=top].iter().flatten();
        let own = cells.filter(|cell| self.legs.side_of[**cell] == side.sign);
        own.map(|cell| self.search.lattice.places[*cell])
            .filter(|p| (p.x - ankle.x).abs() < 0.12 * self.search.extent.y)
            .collect()
    }

    /// How much farther feet reach to the front than to the back, over the height.
    pub(super) fn toes_ahead(&self) -> f64 {
        let ahead = SIDES.iter().filter_map(|side| {
            let ankle = *self.leg_line(side).0.first()?;
            let sole = self.sole(side, ankle);
            let front = sole.iter().map(|p| p.z - ankle.z).fold(0.0, f64::max);
            let back = sole.iter().map(|p| ankle.z - p.z).fold(0.0, f64::max);
            Some(front - back)
        });
        0.5 * ahead.sum::<f64>() / self.search.extent.y
    }

    /// Places a leg; half its thickness.
    fn place_leg(&self, side: &SideNames, placed: &mut PlacedBody) -> f64 {
        let search = &self.search;
        let (mut line, radius) = self.leg_line(side);
        let given = |name: &str| self.given.get(name).copied();
        let hip_share = self.legs.crotch * 1.07;
        let mut judged = Judged::GOOD;
        if line.len() < 2 {
            judged.lower(0.0, || format!("there is no {} leg", side.side));
            let x = search.middle + f64::from(side.sign) * 0.1 * search.extent.x;
            line = [0.1, 0.9]
                .map(|t| {
                    DVec3::new(
                        x,
                        search.height_at(t * self.legs.crotch),
                        search.low.z + 0.5 * search.extent.z,
                    )
                })
                .to_vec();
        }
        let (ankle, top) = (line[0], line[line.len() - 1]);
        let hip = DVec3::new(
            search.middle + 0.85 * (top.x - search.middle),
            search.height_at(hip_share),
            top.z,
        );
        line.push(hip);
        let [hip_name, knee_name, ankle_name, toe_name] = side.leg;
        let knee = bend_of(&line, KNEE).unwrap_or(KNEE);
        let chain = [(ankle_name, 0.0), (knee_name, knee), (hip_name, 1.0)];
        let joints = chain.map(|(name, share)| ChainJoint {
            share,
            given: given(name),
        });
        for ((name, _), at) in chain.iter().zip(place_chain(&line, &joints)) {
            placed.put(name, at, &judged);
        }
        let toe = given(toe_name).unwrap_or_else(|| self.toe(side, ankle) + placed.at(ankle_name) - ankle);
        placed.put(toe_name, toe, &judged);
        radius
    }

    fn toe(&self, side: &SideNames, ankle: DVec3) -> DVec3 {
        let sole = self.sole(side, ankle);
        let front = sole.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
        let ahead: Vec<DVec3> = sole
            .into_iter()
            .filter(|p| p.z > ankle.z + 0.6 * (front - ankle.z))
            .collect();
        if ahead.is_empty() {
            return ankle - DVec3::Y * (0.5 * self.ankle_share() * self.search.extent.y);
        }
        let mean = ahead.iter().sum::<DVec3>() / ahead.len() as f64;
        DVec3::new(mean.x, mean.y, ankle.z + 0.85 * (front - ankle.z))
    }

    fn place_arm(&self, side: &SideNames, own: Option<&(Arm, Judged)>, legs: [f64; 2], placed: &mut PlacedBody) {
        let search = &self.search;
        let height = search.extent.y;
        let (line, mut judged) = match own {
            Some((arm, judged)) => {
                let mut judged = judged.clone();
                let leg = legs[0].max(legs[1]);
                judged.lower(between(arm.radius / leg.max(f64::MIN_POSITIVE), 2.4, 1.4), || {
                    "the arm is thicker than a leg".into()
                });
                (arm.line.clone(), judged)
            }
            None => {
                let mut judged = Judged::GOOD;
                judged.lower(0.0, || {
                    format!("no limb at the {} side ends where a trunk begins", side.side)
                });
                let shoulder = DVec3::new(
                    search.middle + f64::from(side.sign) * 0.12 * height,
                    search.height_at(0.8),
                    search.low.z + 0.5 * search.extent.z,
                );
                let tip = shoulder + DVec3::X * (f64::from(side.sign) * 0.4 * height);
                (vec![tip, shoulder], judged)
            }
        };
        if side.arm.iter().all(|name| self.given.contains_key(name)) {
            judged = Judged::GOOD;
        }
        let elbow = bend_of(&line, ELBOW).unwrap_or(ELBOW);
        let joints = [0.0, WRIST, elbow, 1.0];
        let chain: Vec<ChainJoint> = (side.arm.iter().zip(joints))
            .map(|(name, share)| ChainJoint {
                share,
                given: self.given.get(name).copied(),
            })
            .collect();
        for (name, at) in side.arm.iter().zip(place_chain(&line, &chain)) {
            placed.put(name, at, &judged);
        }
        placed.put(side.clavicle, self.clavicle(side, placed), &judged);
    }

    fn clavicle(&self, side: &SideNames, placed: &PlacedBody) -> DVec3 {
        let shoulder = placed.at(side.arm[3]);
        let x = self.search.middle + 0.2 * (shoulder.x - self.search.middle);
        let found = DVec3::new(x, shoulder.y, shoulder.z);
        self.given.get(side.clavicle).copied().unwrap_or(found)
    }

    /// Brings shoulders at about one height to one height, as far from the middle as each other.
    fn place_even_shoulders(&self, placed: &mut PlacedBody) {
        let [left, right] = SIDES.each_ref().map(|side| placed.at(side.arm[3]));
        let is_given = SIDES.each_ref().map(|side| self.given.contains_key(side.arm[3]));
        let (height, away) = match is_given {
            [true, true] => return,
            [true, false] => (left.y, (left.x - self.search.middle).abs()),
            [false, true] => (right.y, (right.x - self.search.middle).abs()),
            [false, false] => (0.5 * (left.y + right.y), 0.5 * (left.x - right.x).abs()),
        };
        if (left.y - right.y).abs() > 0.15 * self.search.extent.y {
            return;
        }
        for (side, own) in SIDES.iter().zip([left, right]) {
            if !self.given.contains_key(side.arm[3]) {
                let x = self.search.middle + f64::from(side.sign) * away;
                if let Some(joint) = placed.joints.get_mut(side.arm[3]) {
                    joint.0 = DVec3::new(x, height, own.z);
                }
            }
            let clavicle = self.clavicle(side, placed);
            if let Some(joint) = placed.joints.get_mut(side.clavicle) {
                joint.0 = clavicle;
            }
        }
    }

    fn place_trunk(&self, placed: &mut PlacedBody) {
        let search = &self.search;
        let places = &search.lattice.places;
        let shoulder = SIDES
            .iter()
            .map(|side| search.share_of(placed.at(side.arm[3]).y))
            .sum::<f64>()
            / 2.0;
        let hips = (self.legs.crotch + 0.06).min(shoulder - 0.1);
        let near = 0.1 * search.extent.x.min(search.extent.y);
        let at = |share: f64| {
            let place = search.middle_of_row(share, |c| (places[c].x - search.middle).abs() < near);
            let z = place.map_or(search.low.z + 0.5 * search.extent.z, |place| place.z);
            DVec3::new(search.middle, search.height_at(share), z)
        };
        let way = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let shares = [
            hips,
            way(hips, shoulder, 0.25),
            way(hips, shoulder, 0.55),
            way(shoulder, 1.0, 0.12),
            way(shoulder, 1.0, 0.35),
            0.985,
        ];
        let mut line = shares.map(at);
        // Ears and horns are no way for a head to go.
        let most = 0.5 * (line[5].y - line[4].y).abs();
        line[5].z = line[4].z + (line[5].z - line[4].z).clamp(-most, most);
        let steps = line.windows(2).map(|w| w[0].distance(w[1]));
        let sums = std::iter::once(0.0).chain(steps.scan(0.0, |sum, step| {
            *sum += step;
            Some(*sum)
        }));
        let sums: Vec<f64> = sums.collect();
        let chain: Vec<ChainJoint> = (TRUNK.iter().zip(&sums))
            .map(|(name, sum)| ChainJoint {
                share: sum / sums[5].max(f64::MIN_POSITIVE),
                given: self.given.get(name).copied(),
            })
            .collect();
        let mut judged = Judged::GOOD;
        judged.lower(between(shoulder - self.legs.crotch, 0.15, 0.25), || {
            "there is little trunk between hips and shoulders".into()
        });
        for (name, at) in TRUNK.iter().zip(place_chain(&line, &chain)) {
            placed.put(name, at, &judged);
        }
    }
}
