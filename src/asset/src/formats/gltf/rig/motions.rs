//! How joints move with the body.
//!
//! A joint moves and turns as the surface around it: the vertices of it and of the joint above it, weighted by
//! influence and nearness, so that the joint stays the hinge between them. A joint without vertices follows all of the
//! surface around it in the same way. A joint keeps its scale. One whose vertices have not moved stays bit for bit.

use super::super::placement::{Placement, SkinPose, VertexInfluences};
use super::super::scene::PlacedScene;
use crate::NodeMotions;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use pliant_mesh::BoundingBox;
use pliant_mesh::rotation::{fit_rotation, outer_product};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

/// A new shape of a model, and the vertices of joints.
pub(in super::super) struct SkinnedShape<'a> {
    /// Where vertices were.
    pub(in super::super) before: Cow<'a, [DVec3]>,
    /// Where they are now.
    pub(in super::super) now: &'a [DVec3],
    /// Vertices that joints place.
    pub(in super::super) held: Vec<JointHeldVertices>,
    /// Vertices that a node places, with the node.
    pub(in super::super) fixed: Vec<(usize, Range<usize>)>,
}

/// The vertices of one placed primitive that joints hold.
pub(in super::super) struct JointHeldVertices {
    pub(in super::super) skin: usize,
    /// The first of them in the shape.
    pub(in super::super) first: usize,
    pub(in super::super) influences: VertexInfluences,
    /// How they are written back.
    pub(in super::super) placement: Placement,
}

/// A motion by less than this, relative to the model's diagonal and as half an angle, is none.
const STILL: f64 = 1e-6;

/// How far around a place the surface is looked at, as a multiple of the distance of the nearest vertex.
const REACH: f64 = 4.0;

/// The most pairs of joints and vertices that are looked at beyond those that hold each other. Beyond it, joints that hold
/// nothing look at every n-th vertex, and others only at their own.
const MOST_PAIRS: u64 = 400_000_000;

/// How many nodes that are no joints are passed between two joints.
const MOST_BETWEEN: usize = 64;

/// How vertices around a place count by their distance: smoothly down to nothing.
#[derive(Clone, Copy)]
struct Nearness {
    nearest: f64,
}

impl Nearness {
    fn of_nearest(squared: f64, size: f64) -> Option<Self> {
        let nearest = squared.sqrt().max(1e-3 * size);
        nearest.is_finite().then_some(Self { nearest })
    }

    fn weight(self, squared: f64) -> f64 {
        let reach = REACH * self.nearest;
        let left = 1.0 - squared.sqrt() / reach;
        if left <= 0.0 {
            return 0.0;
        }
        left * left / (1.0 + squared / (self.nearest * self.nearest))
    }
}

/// What is known of one joint.
struct JointFit {
    place: DVec3,
    /// The surface around it.
    around: MotionMoments,
    /// Square of the distance of the nearest vertex; one that it holds little of counts as further away.
    nearest: f64,
    /// How many vertices it holds.
    held: u64,
    is_moved: bool,
    /// The joints right below it.
    below: Vec<usize>,
}

impl JointFit {
    fn at(place: DVec3) -> Self {
        Self {
            place,
            around: MotionMoments::default(),
            nearest: f64::INFINITY,
            held: 0,
            is_moved: false,
            below: Vec::new(),
        }
    }

    /// Counts a vertex by how near it is.
    fn look_at(&mut self, weight: f64, before: DVec3, now: DVec3, size: f64) {
        if let Some(nearness) = Nearness::of_nearest(self.nearest, size) {
            let near = weight * nearness.weight(before.distance_squared(self.place));
            if near > 0.0 {
                self.around.add(near, before - self.place, now - before);
            }
        }
    }

    /// Looks at every n-th vertex of the surface around it.
    fn look_around(&mut self, shape: &SkinnedShape<'_>, step: usize, size: f64) {
        let vertices = || shape.before.iter().zip(shape.now).step_by(step);
        let distances = vertices().map(|(p, _)| p.distance_squared(self.place));
        self.nearest = distances.fold(f64::INFINITY, f64::min);
        let Some(nearness) = Nearness::of_nearest(self.nearest, size) else {
            return;
        };
        for (&p, &q) in vertices() {
            self.is_moved |= p != q && nearness.weight(p.distance_squared(self.place)) > 0.0;
            self.look_at(1.0, p, q, size);
        }
    }

    /// How the surface around it moves and grows.
    fn local(&self, size: f64) -> LocalFit {
        let still = LocalFit {
            shift: DVec3::ZERO,
            growth: 1.0,
        };
        if !self.is_moved || self.around.is_empty() {
            return still;
        }
        let rotation = DMat3::from_quat(self.around.rotation(&DMat3::IDENTITY));
        let shift = self.around.shift_of_place(&rotation);
        let growth = self.around.growth(&rotation).filter(|growth| growth.is_finite());
        let is_still = !shift.is_finite() || shift.length() <= STILL * size;
        LocalFit {
            shift: if is_still { still.shift } else { shift },
            growth: growth.unwrap_or(still.growth),
        }
    }

    fn motion(&self, whole: &DMat3, size: f64, may_turn: bool) -> Option<DAffine3> {
        if !self.is_moved || self.around.is_empty() {
            return None;
        }
        let mut rotation = self.around.rotation(whole);
        let mut turn = DMat3::from_quat(rotation);
        let shift = self.around.shift_of_place(&turn);
        if !may_turn {
            (rotation, turn) = (DQuat::IDENTITY, DMat3::IDENTITY);
        }
        let is_still = shift.length() <= STILL * size && rotation.xyz().length() <= STILL;
        (!is_still && shift.is_finite() && turn.is_finite()).then(|| DAffine3 {
            matrix3: turn,
            translation: self.place + shift - turn * self.place,
        })
    }
}

/// The joints of some skins, numbered from 0.
struct JointFits<'a> {
    numbers: BTreeMap<usize, usize>,
    list: Vec<JointFit>,
    poses: &'a BTreeMap<usize, Arc<SkinPose>>,
    size: f64,
}

/// How the joints of these skins move in a scene, and turn where they `may_turn`. `bones` are nodes that move like joints without
/// vertices where they are none.
pub(super) fn joint_motions(
    shape: &SkinnedShape<'_>,
    poses: &BTreeMap<usize, Arc<SkinPose>>,
    bones: &BTreeSet<usize>,
    scene: &PlacedScene,
    may_turn: bool,
) -> NodeMotions {
    let nodes: BTreeSet<usize> = poses.values().flat_map(|pose| &pose.joints).copied().collect();
    let bones: Vec<usize> = bones.difference(&nodes).copied().collect();
    let place = |node: &usize| JointFit::at(scene.world_from_node[*node].translation);
    let mut fits = JointFits {
        list: nodes.iter().map(place).collect(),
        numbers: nodes.into_iter().zip(0..).collect(),
        poses,
        size: BoundingBox::of(&shape.before).diagonal(),
    };
    fits.find_below(&scene.parents);
    fits.find_nearest(shape);
    fits.look_at_held(shape);
    let mut loose: Vec<JointFit> = bones.iter().map(place).collect();
    look_at_surface(fits.list.iter_mut().chain(&mut loose), shape, fits.size);
    let mut all = MotionMoments::default();
    for (&p, &q) in shape.before.iter().zip(shape.now) {
        all.add(1.0, p - shape.before[0], q - p);
    }
    // Twice, so that the hint of the first, that nothing has turned, leaves no trace.
    let roughly = DMat3::from_quat(all.rotation(&DMat3::IDENTITY));
    let whole = DMat3::from_quat(all.rotation(&roughly));
    let all = fits.list.iter().chain(&loose);
    let motions = all.map(|fit| fit.motion(&whole, fits.size, may_turn));
    fits.numbers.into_keys().chain(bones).zip(motions).collect()
}

/// Looks at the surface around joints that hold nothing.
fn look_at_surface<'f>(fits: impl Iterator<Item = &'f mut JointFit>, shape: &SkinnedShape<'_>, size: f64) {
    let mut loose: Vec<&mut JointFit> = fits.filter(|fit| fit.held == 0).collect();
    let pairs = (loose.len() as u64).saturating_mul(shape.before.len() as u64);
    let step = 1 + usize::try_from(pairs / MOST_PAIRS).unwrap_or(usize::MAX - 1);
    loose.iter_mut().for_each(|fit| fit.look_around(shape, step, size));
}

impl JointFits<'_> {
    fn find_below(&mut self, parents: &[Option<usize>]) {
        for (&node, &number) in &self.numbers {
            // Nodes that are no joints may lie between, but not without end: then the joints above are left out.
            let mut above = parents[node];
            for _ in 0..MOST_BETWEEN {
                let Some(parent) = above else { break };
                if let Some(&parent) = self.numbers.get(&parent) {
                    self.list[parent].below.push(number);
                    break;
                }
                above = parents[parent];
            }
        }
    }

    /// The numbers of the joints of a skin.
    fn joints(&self, held: &JointHeldVertices) -> Vec<usize> {
        let joints = self.poses.get(&held.skin).map_or(&[][..], |pose| &pose.joints);
        joints.iter().map(|node| self.numbers[node]).collect()
    }

    fn find_nearest(&mut self, shape: &SkinnedShape<'_>) {
        for held in &shape.held {
            let joints = self.joints(held);
            for i in 0..held.influences.len() {
                let (p, q) = (shape.before[held.first + i], shape.now[held.first + i]);
                for &(joint, weight) in held.influences.of(i) {
                    let fit = &mut self.list[joints[joint as usize]];
                    fit.held += 1;
                    fit.is_moved |= p != q;
                    fit.nearest = fit.nearest.min(p.distance_squared(fit.place) / (weight * weight));
                }
            }
        }
    }

    /// Looks at the vertices that joints hold, for themselves and for the joints right below them.
    fn look_at_held(&mut self, shape: &SkinnedShape<'_>) {
        let pairs = self
            .list
            .iter()
            .map(|fit| fit.held.saturating_mul(fit.below.len() as u64));
        let looks_up = pairs.fold(0, u64::saturating_add) <= MOST_PAIRS;
        let below: Vec<Vec<usize>> = self.list.iter_mut().map(|fit| std::mem::take(&mut fit.below)).collect();
        for held in &shape.held {
            let joints = self.joints(held);
            for i in 0..held.influences.len() {
                let (p, q) = (shape.before[held.first + i], shape.now[held.first + i]);
                for &(joint, weight) in held.influences.of(i) {
                    let joint = joints[joint as usize];
                    self.list[joint].look_at(weight, p, q, self.size);
                    for &child in below[joint].iter().filter(|_| looks_up) {
                        if self.list[child].held > 0 {
                            self.list[child].look_at(weight, p, q, self.size);
                        }
                    }
                }
            }
        }
    }
}

/// How the surface around a place moves.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalFit {
    /// By how much the place itself does.
    pub(super) shift: DVec3,
    /// How much larger lengths are.
    pub(super) growth: f64,
}

/// How the surface around places moves, each of which belongs to a node: by the vertices that the node holds as a joint, else
/// by all around.
pub(super) fn fits_at(
    places: &[(usize, DVec3)],
    shape: &SkinnedShape<'_>,
    poses: &BTreeMap<usize, Arc<SkinPose>>,
) -> Vec<LocalFit> {
    let mut fits: Vec<JointFit> = places.iter().map(|(_, place)| JointFit::at(*place)).collect();
    // How far away what a node holds is, in the mean: half as far is looked, so that a single vertex at the place itself does
    // not hide how the rest grows.
    let mut mean_distance = vec![[0.0_f64; 2]; places.len()];
    let mut of_node: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (number, (node, _)) in places.iter().enumerate() {
        of_node.entry(*node).or_default().push(number);
    }
    let size = BoundingBox::of(&shape.before).diagonal();
    let pairs = (places.len() as u64).saturating_mul(shape.before.len() as u64);
    let step = 1 + usize::try_from(pairs / MOST_PAIRS).unwrap_or(usize::MAX - 1);
    // First how near the nearest is, then what lies around.
    for looks in [false, true] {
        if looks {
            for (fit, [sum, weight]) in fits
                .iter_mut()
                .zip(&mean_distance)
                .filter(|(_, [_, weight])| *weight > 0.0)
            {
                fit.nearest = fit.nearest.max((0.5 * sum / weight).powi(2));
            }
        }
        for held in &shape.held {
            let joints = poses.get(&held.skin).map_or(&[][..], |pose| &pose.joints);
            let numbers: Vec<&[usize]> = joints
                .iter()
                .map(|j| of_node.get(j).map_or(&[][..], Vec::as_slice))
                .collect();
            for i in (0..held.influences.len()).step_by(step) {
                let (p, q) = (shape.before[held.first + i], shape.now[held.first + i]);
                for &(joint, weight) in held.influences.of(i) {
                    for &number in numbers.get(joint as usize).copied().unwrap_or_default() {
                        let fit = &mut fits[number];
                        if looks {
                            fit.look_at(weight, p, q, size);
                            continue;
                        }
                        fit.held += 1;
                        fit.is_moved |= p != q;
                        let squared = p.distance_squared(fit.place);
                        fit.nearest = fit.nearest.min(squared / (weight * weight));
                        mean_distance[number][0] += weight * squared.sqrt();
                        mean_distance[number][1] += weight;
                    }
                }
            }
        }
    }
    let loose = fits.iter_mut().filter(|fit| fit.held == 0);
    loose.for_each(|fit| fit.look_around(shape, step, size));
    fits.iter().map(|fit| fit.local(size)).collect()
}

/// How much of a rotation that is known from elsewhere is mixed into a fit, so that points in a line or in one place, which
/// leave their rotation open, take that one. Far below what a shape says, far above rounding.
const HINT: f64 = 1e-6;

/// How stiff the neighbourhood of a place is beyond its rotation and scale, relative to how far it reaches in each direction:
/// along directions in which no points lie it keeps to them.
const STIFFNESS: f64 = 1e-2;

/// Sums over vertices, relative to the first of them, so that few vertices far from the place lose no digits.
#[derive(Debug, Clone, Copy)]
pub(super) struct MotionMoments {
    weight: f64,
    /// The first vertex: rest offset from the place, and displacement.
    first: [DVec3; 2],
    /// Sum of rest offsets.
    offset: DVec3,
    /// Sum of displacements.
    shift: DVec3,
    /// Sum of offset times offset, transposed.
    spread: DMat3,
    /// Sum of displacement times offset, transposed.
    turned: DMat3,
}

impl Default for MotionMoments {
    fn default() -> Self {
        Self {
            weight: 0.0,
            first: [DVec3::ZERO; 2],
            offset: DVec3::ZERO,
            shift: DVec3::ZERO,
            spread: DMat3::ZERO,
            turned: DMat3::ZERO,
        }
    }
}

/// The mean offset and displacement, and the sums about them.
struct CentredMoments {
    offset: DVec3,
    shift: DVec3,
    spread: DMat3,
    turned: DMat3,
}

impl MotionMoments {
    /// Adds a vertex at `offset` from the place, which has moved by `shift`.
    pub(super) fn add(&mut self, weight: f64, offset: DVec3, shift: DVec3) {
        if self.is_empty() {
            self.first = [offset, shift];
        }
        let (offset, shift) = (offset - self.first[0], shift - self.first[1]);
        self.weight += weight;
        self.offset += offset * weight;
        self.shift += shift * weight;
        self.spread += outer_product(offset, offset) * weight;
        self.turned += outer_product(shift, offset) * weight;
    }

    /// Whether they say anything.
    pub(super) fn is_empty(&self) -> bool {
        self.weight <= 0.0
    }

    fn centred(&self) -> CentredMoments {
        let offset = self.offset / self.weight;
        let shift = self.shift / self.weight;
        CentredMoments {
            offset: self.first[0] + offset,
            shift: self.first[1] + shift,
            spread: self.spread - outer_product(self.offset, offset),
            turned: self.turned - outer_product(self.shift, offset),
        }
    }

    /// The rotation that fits best (Kabsch 1976, never a reflection); what the vertices leave open is as in `hint`.
    pub(super) fn rotation(&self, hint: &DMat3) -> DQuat {
        if self.is_empty() {
            return fit_rotation(*hint);
        }
        let CentredMoments { spread, turned, .. } = self.centred();
        let size = trace(&spread);
        if size.is_nan() || size <= 0.0 {
            return fit_rotation(*hint);
        }
        fit_rotation(spread + turned + *hint * (HINT * size))
    }

    /// How much larger lengths are once the neighbourhood has turned by `rotation`; `None` where all lies in one place.
    fn growth(&self, rotation: &DMat3) -> Option<f64> {
        let CentredMoments { spread, turned, .. } = self.centred();
        let size = trace(&spread);
        (size > 0.0).then(|| (trace(&(rotation.transpose() * (spread + turned))) / size).max(0.0))
    }

    /// By how much the place itself moves, when the neighbourhood turns by `rotation`: the affine map that fits best in the
    /// sense of least squares, which keeps to that rotation and a uniform scale where the vertices leave it open.
    pub(super) fn shift_of_place(&self, rotation: &DMat3) -> DVec3 {
        let CentredMoments {
            offset,
            shift,
            spread,
            turned,
        } = self.centred();
        let size = trace(&spread);
        if size.is_nan() || size <= 0.0 {
            return shift - (*rotation - DMat3::IDENTITY) * offset;
        }
        let grown = trace(&(rotation.transpose() * (spread + turned))) / size;
        let similarity = *rotation * grown.max(0.0) - DMat3::IDENTITY;
        let stiff = spread + DMat3::from_diagonal(DVec3::splat(STIFFNESS * size / 3.0));
        let rest = (turned - similarity * spread) * stiff.inverse();
        let at_place = shift - (similarity + rest) * offset;
        if at_place.is_finite() { at_place } else { shift }
    }
}

fn trace(m: &DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_mesh::rotation::exp_rotation;

    fn moments(points: &[DVec3], place: DVec3, map: impl Fn(DVec3) -> DVec3) -> MotionMoments {
        let mut all = MotionMoments::default();
        points.iter().for_each(|&p| all.add(0.5, p - place, map(p) - p));
        all
    }

    #[test]
    fn a_place_moves_with_an_affine_map_of_what_is_around() {
        let points: Vec<DVec3> = (0..60)
            .map(|i| DVec3::new(f64::from(i % 3), f64::from(i % 5), f64::from(i % 4)))
            .collect();
        let place = DVec3::new(0.7, 2.1, 1.9);
        let turn = exp_rotation(DVec3::new(0.3, 2.9, -0.4));
        let moved = |p: DVec3| turn * (p * 1.5) + DVec3::new(4.0, 0.0, 1.0);
        let sums = moments(&points, place, moved);
        let found = sums.rotation(&DMat3::IDENTITY);
        assert!(found.dot(turn).abs() > 1.0 - 1e-9);
        let to = place + sums.shift_of_place(&DMat3::from_quat(found));
        assert!((to - moved(place)).length() < 1e-4, "{to} {}", moved(place));
        // Longer along one axis alone: up to the stiffness.
        let stretched = |p: DVec3| DVec3::new(p.x, p.y * 1.5, p.z);
        let sums = moments(&points, place, stretched);
        let to = place + sums.shift_of_place(&DMat3::from_quat(sums.rotation(&DMat3::IDENTITY)));
        assert!((to - stretched(place)).length() < 3e-3, "{to} {}", stretched(place));
    }

    #[test]
    fn what_points_leave_open_is_taken_from_the_hint() {
        let hint = exp_rotation(DVec3::X * 1.25);
        let one = moments(&[DVec3::Y], DVec3::ZERO, |p| p + DVec3::Z);
        assert!(one.rotation(&DMat3::from_quat(hint)).dot(hint).abs() > 1.0 - 1e-12);
        // A single vertex takes the place along, turned about it.
        let to = one.shift_of_place(&DMat3::from_quat(hint));
        assert!((to - (DVec3::Y + DVec3::Z - hint * DVec3::Y)).length() < 1e-12, "{to}");
        // A line along x does not say how it turned about itself.
        let line = moments(&[DVec3::ZERO, DVec3::X, DVec3::X * 2.0], DVec3::ZERO, |p| p);
        assert!(line.rotation(&DMat3::from_quat(hint)).dot(hint).abs() > 1.0 - 1e-9);
    }
}
