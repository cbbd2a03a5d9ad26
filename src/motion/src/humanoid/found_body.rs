//! Where the joints of a body lie in a mesh, and how sure that is.
//!
//! A figure is looked for in each way that it may stand and face. Its joints get scores from what is known of bodies:
//! shoulders are above hips, arms are thin and in no leg, left and right mirror each other, and bones lie inside.

use super::body_axes::BodyAxes;
use super::body_lattice::BodyLattice;
use super::body_search::LegGap;
use super::figure::StandingFigure;
use crate::signed_axis::SignedAxis;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use std::collections::BTreeMap;

/// How far toes have to point backwards for a figure to face the other way, over the height.
const BACKWARDS: f64 = 0.015;

/// What is known of a figure.
#[derive(Debug, Clone, Copy, Default)]
pub struct BodyOrder<'a> {
    /// Joints whose places are known, by name. They stay, and joints that depend on them follow.
    pub given: Option<&'a BTreeMap<&'static str, DVec3>>,
    /// From its feet to its head; `None`: what fits best.
    pub up: Option<SignedAxis>,
    /// Where it faces; `None`: what fits best.
    pub front: Option<SignedAxis>,
}

/// A joint that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundJoint {
    /// Where it lies, in model space.
    pub at: DVec3,
    /// How sure that is, 0 to 1.
    pub score: f64,
    /// What speaks against it; empty where nothing does.
    pub reason: String,
}

/// What was found of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundBody {
    /// All joints by name.
    pub joints: BTreeMap<&'static str, FoundJoint>,
    /// How it stands.
    pub axes: BodyAxes,
}

impl FoundBody {
    fn of_figure(figure: &StandingFigure, exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let model_from_upright = figure.axes.upright_from_model().transpose();
        let joints = figure.joints(exec)?.joints.into_iter().map(|(name, (at, judged))| {
            let joint = FoundJoint {
                at: model_from_upright * at,
                score: judged.score,
                reason: judged.reason,
            };
            (name, joint)
        });
        Ok(Self {
            joints: joints.collect(),
            axes: figure.axes,
        })
    }

    /// The score of the worst joint.
    pub fn score(&self) -> f64 {
        self.joints.values().map(|joint| joint.score).fold(1.0, f64::min)
    }

    /// How well it fits, compared with how else it may stand.
    fn rank(&self) -> f64 {
        let mean = self.joints.values().map(|joint| joint.score).sum::<f64>() / self.joints.len() as f64;
        0.5 * (self.score() + mean)
    }
}

/// How much less a figure counts that stands along the next of the verticals, y, z, x, -y and so on.
const UNUSUAL: f64 = 0.02;
/// From which rank on a figure that stands as usual is not looked for otherwise.
const CERTAIN: f64 = 0.95;

/// Looks for all joints of a body, in each way that it may stand.
///
/// # Errors
/// [`Cancelled`] when the caller cancels.
pub fn find_body(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    order: &BodyOrder<'_>,
    exec: &Exec<'_>,
) -> Result<FoundBody, Cancelled> {
    let lattice = BodyLattice::of_mesh(positions, triangles, exec)?;
    let none = BTreeMap::new();
    let given = order.given.unwrap_or(&none);
    let known = axes_of_joints(given);
    let is_up_known = order.up.is_some() || known.is_some();
    let candidates = match known {
        Some(known) if order.up.is_none() && order.front.is_none() => vec![(known, true)],
        _ => {
            let all = BodyAxes::candidates(order.up, order.front).into_iter();
            all.map(|axes| (axes, order.front.is_some())).collect()
        }
    };
    let mut best: Option<(f64, FoundBody)> = None;
    let keep = |found: FoundBody, place: usize, best: &mut Option<(f64, FoundBody)>| {
        let rank = found.rank() - UNUSUAL * place as f64;
        if best.as_ref().is_none_or(|best| rank > best.0) {
            *best = Some((rank, found));
        }
    };
    for (place, (axes, is_front_known)) in candidates.into_iter().enumerate() {
        exec.check()?;
        let standing = |axes: BodyAxes| StandingFigure {
            is_up_known,
            ..StandingFigure::standing(&lattice, axes, given)
        };
        let figure = standing(axes);
        // What has no legs is not a figure, however it may stand otherwise.
        if place > 1 && figure.legs.gap == LegGap::Missing {
            continue;
        }
        let ahead = figure.toes_ahead();
        match ahead < -BACKWARDS && !is_front_known {
            true => keep(
                FoundBody::of_figure(&standing(axes.reversed()), exec)?,
                place,
                &mut best,
            ),
            false => keep(FoundBody::of_figure(&figure, exec)?, place, &mut best),
        }
        if place == 0 && best.as_ref().is_some_and(|best| best.0 > CERTAIN) {
            break;
        }
    }
    Ok(best.map_or_else(
        || FoundBody {
            joints: BTreeMap::new(),
            axes: BodyAxes::USUAL,
        },
        |best| best.1,
    ))
}

/// How a figure stands whose shoulders and ankles, or hips and head, are known.
fn axes_of_joints(given: &BTreeMap<&'static str, DVec3>) -> Option<BodyAxes> {
    let middle = |names: [&str; 2]| Some(0.5 * (*given.get(names[0])? + *given.get(names[1])?));
    let top = middle(["lShoulder", "rShoulder"]).or_else(|| given.get("head").copied())?;
    let bottom = middle(["lAnkle", "rAnkle"])
        .or_else(|| middle(["lHip", "rHip"]))
        .or_else(|| given.get("hips").copied())?;
    let pairs = [["lShoulder", "rShoulder"], ["lHip", "rHip"], ["lAnkle", "rAnkle"]];
    let left = pairs.iter().find_map(|[l, r]| Some(*given.get(l)? - *given.get(r)?))?;
    BodyAxes::of_directions(top - bottom, left)
}
