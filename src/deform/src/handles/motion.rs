//! How nodes follow handles: before a solve, from one pose to the next, and after it, from solving coordinates to positions.
//!
//! A drag starts from the last solution, moved by what the handles did since. A harmonic field is how much each node
//! follows a handle. Every node moves by its share of each handle's motion. For translations this is exactly the solution
//! of the second pass, where the fields' handles are those that hold positions; for small rotations it leaves an error of
//! second order. It costs one pass over the nodes.
//!
//! After a solve, unmoved nodes keep their bits, handles set the nodes they hold, loose parts are placed, and rigid regions
//! keep their shape.

use crate::body::DeformableBody;
use crate::field_terms::FieldTerms;
use crate::first_pass::blend::{LocalFrame, pack_frame};
use crate::handles::ownership::UNHELD;
use crate::handles::system::HandleSystem;
use crate::rotation::{Transform, fit_rigid_motion};
use glam::{DAffine3, DVec3};
use pliant_exec::pool::Pool;
use pliant_mesh::rotation::exp_rotation;
use rayon::prelude::*;

/// How one handle moved, and how much each node follows it.
#[derive(Debug, Clone, Copy)]
pub struct HandleMotion<'a> {
    /// One value in 0 … 1 per node.
    pub field: &'a [f32],
    /// From where the handle's nodes were to where they are, in the coordinates of what is carried.
    pub map: DAffine3,
}

/// Adds to every position its share of all motions: x_i += Σ_k u_k(i) (D_k(x_i) − x_i). `x` holds three numbers a node.
pub fn carry(x: &mut [f64], motions: &[HandleMotion<'_>], pool: &Pool) {
    let terms = motions.iter().map(|motion| (motion.field, motion.map));
    carry_along(x, &FieldTerms::Whole(terms.collect()), pool);
}

fn carry_along(x: &mut [f64], motions: &FieldTerms<'_, DAffine3>, pool: &Pool) {
    if motions.is_empty() {
        return;
    }
    pool.install(|| {
        x.as_chunks_mut::<3>()
            .0
            .par_iter_mut()
            .with_min_len(4096)
            .enumerate()
            .for_each(|(i, x)| {
                let here = DVec3::from_array(*x);
                let mut there = here;
                motions.each_at(i, |share, map| there += moved_by(map, share, here));
                *x = there.to_array();
            });
    });
}

impl HandleSystem {
    /// Carries solving coordinates from one pose to the next with all handles that constrain rotations, by the few that have
    /// a say at each node.
    pub(crate) fn carry_by_shares(
        &self,
        body: &DeformableBody,
        from: &[Transform],
        to: &[Transform],
        x: &mut [f64],
        pool: &Pool,
    ) {
        let into = solving_to_model(body);
        let mut maps: Vec<DAffine3> = (from.iter().zip(to))
            .map(|(from, to)| match from == to {
                true => DAffine3::IDENTITY,
                false => way_between(from, to, into),
            })
            .collect();
        maps.push(DAffine3::IDENTITY);
        let shares = self.sparse_shares(pool);
        pool.install(|| {
            let nodes = x.as_chunks_mut::<3>().0.par_iter_mut().with_min_len(4096);
            nodes.enumerate().for_each(|(i, x)| {
                let some = shares.at(i);
                let here = DVec3::from_array(*x);
                let there: DVec3 = (some.iter())
                    .map(|&(k, share)| maps[k as usize].transform_point3(here) * f64::from(share))
                    .sum();
                if !some.is_empty() && there.is_finite() {
                    *x = there.to_array();
                }
            });
        });
    }

    /// Carries solving coordinates from one pose to the next. Where a handle's scale was close to nothing, nodes stay.
    pub(crate) fn carry(
        &self,
        body: &DeformableBody,
        from: &[Transform],
        to: &[Transform],
        x: &mut [f64],
        pool: &Pool,
    ) {
        carry_along(x, &self.motions(body, from, to), pool);
    }

    /// How handles that hold positions moved from one pose to the next, in solving coordinates; those whose scale was close to
    /// nothing are left out.
    pub(crate) fn motions(
        &self,
        body: &DeformableBody,
        from: &[Transform],
        to: &[Transform],
    ) -> FieldTerms<'_, DAffine3> {
        let into = solving_to_model(body);
        let moved = (from.iter().zip(to).enumerate())
            .filter(|(k, (from, to))| from != to && self.setup.handles[*k].position)
            .map(|(k, (from, to))| (k, way_between(from, to, into)))
            .filter(|(k, map)| map.is_finite() && self.rotation_fields.has_say(*k));
        FieldTerms::new(&self.rotation_fields, moved)
    }
}

/// What a place moves by with its share of a handle's motion.
#[inline]
fn moved_by(map: &DAffine3, share: f32, here: DVec3) -> DVec3 {
    (map.transform_point3(here) - here) * f64::from(share)
}

/// From where a handle's nodes were to where they are, in the coordinates that `into` takes to the model's.
fn way_between(from: &Transform, to: &Transform, into: DAffine3) -> DAffine3 {
    into.inverse() * affine(to) * affine(from).inverse() * into
}

fn solving_to_model(body: &DeformableBody) -> DAffine3 {
    DAffine3::from_scale_rotation_translation(
        DVec3::splat(body.unit()),
        glam::DQuat::IDENTITY,
        body.model_from_solving(DVec3::ZERO),
    )
}

fn affine(transform: &Transform) -> DAffine3 {
    let linear = transform.linear();
    DAffine3::from_mat3_translation(
        linear,
        transform.pivot + transform.translation - linear * transform.pivot,
    )
}

/// Brings nodes from solving coordinates around `center` to model space.
pub(crate) struct NodePlacement<'a, M> {
    handles: &'a HandleSystem,
    body: &'a DeformableBody,
    moved_parts: &'a [bool],
    /// By hold: from rest to where the pose has it, model space.
    maps: Vec<M>,
    center: DVec3,
}

impl<M: Fn(DVec3) -> DVec3 + Sync> NodePlacement<'_, M> {
    /// The position of a node that was solved to `x`.
    #[inline]
    pub fn of(&self, node: usize, x: &[f64]) -> DVec3 {
        let Self { handles, body, .. } = *self;
        let rest = body.graph.positions[node];
        if !self.moved_parts[body.graph.component[node] as usize] {
            return rest;
        }
        match handles.position.hard[node] {
            UNHELD if handles.positions.fixed[node] => rest,
            UNHELD => body.model_from_solving(DVec3::from_slice(x) + self.center),
            k => self.maps.get(k as usize).map_or(rest, |map| map(rest)),
        }
    }

    /// The positions of all nodes from solving coordinates `x`: nodes of unmoved parts and nodes held by handles are exact,
    /// loose parts are placed.
    pub fn of_all(&self, x: &[f64], pool: &Pool) -> Vec<DVec3> {
        let mut positions: Vec<DVec3> = pool.install(|| {
            let nodes = x.as_chunks::<3>().0.par_iter().enumerate().with_min_len(4096);
            nodes.map(|(node, x)| self.of(node, x)).collect()
        });
        self.handles.parts.place(self.body, &mut positions);
        positions
    }
}

impl HandleSystem {
    /// By component: whether any hold that has moved has a say in it.
    pub(crate) fn moved_parts(&self, body: &DeformableBody, transforms: &[Transform]) -> Vec<bool> {
        let mut moved = vec![false; body.graph.components];
        for (hold, _) in self
            .setup
            .handles
            .iter()
            .zip(transforms)
            .filter(|(_, t)| !t.is_identity())
        {
            let nodes = hold.nodes.iter().copied().chain(hold.pulls.iter().map(|p| p.0));
            nodes.for_each(|n| moved[body.graph.component[n as usize] as usize] = true);
        }
        self.places.mark_moved(&mut moved);
        moved
    }

    /// Where single nodes are, loose parts aside.
    pub(crate) fn placement<'a>(
        &'a self,
        body: &'a DeformableBody,
        moved_parts: &'a [bool],
        transforms: &[Transform],
        center: DVec3,
    ) -> NodePlacement<'a, impl Fn(DVec3) -> DVec3 + Send + Sync + use<>> {
        NodePlacement {
            handles: self,
            body,
            moved_parts,
            maps: transforms.iter().map(Transform::map).collect(),
            center,
        }
    }

    /// Replaces the solution on rigid regions that no hard handle puts in place by the rigid motion that fits it best. Where the
    /// handle gives the rotation, only the translation is fitted. The `frames` of the region, where there are any, turn with it,
    /// so that what lies around follows.
    pub fn make_regions_rigid(
        &self,
        body: &DeformableBody,
        transforms: &[Transform],
        frames: &mut [LocalFrame],
        x: &mut [f64],
    ) {
        let holds = self.setup.handles.iter().zip(transforms);
        for (hold, transform) in holds.filter(|(hold, _)| hold.is_loosely_rigid()) {
            let at = |n: &u32| DVec3::from_slice(&x[*n as usize * 3..*n as usize * 3 + 3]);
            let rest: Vec<_> = hold.nodes.iter().map(|n| body.rest(*n as usize)).collect();
            let now: Vec<_> = hold.nodes.iter().map(at).collect();
            let fitted = fit_rigid_motion(&rest, &now);
            let motion = match hold.rotation && hold.stiffness.is_none() {
                true => Transform {
                    rotation: transform.rotation,
                    ..fitted
                },
                false => fitted,
            };
            let (map, frame) = (motion.map(), pack_frame(exp_rotation(motion.rotation), None));
            for (n, p) in hold.nodes.iter().zip(&rest) {
                let n = *n as usize;
                if self.position.hard[n] == UNHELD {
                    x[n * 3..n * 3 + 3].copy_from_slice(&map(*p).to_array());
                    if let Some(own) = frames.get_mut(n) {
                        *own = frame;
                    }
                }
            }
        }
    }
}

/// What handles have to say at a place: the number of each that has any, rising, and its field there, above 0.
pub type HandleShares = Vec<(u32, f32)>;

impl HandleSystem {
    /// What the handles have to say at a node, from their rotation fields; where none constrains rotation, who holds it.
    pub fn shares_at(&self, node: usize) -> HandleShares {
        let mut shares = HandleShares::new();
        self.rotation_fields.each_at(node, |k, u| shares.push((k as u32, u)));
        match self.position.hard[node] {
            hold if shares.is_empty() && hold != UNHELD => vec![(hold, 1.0)],
            _ => shares,
        }
    }

    /// What part of the way between handles lies between two nodes, 0 to 1: half of what their shares differ by.
    pub fn way_between(&self, a: usize, b: usize) -> f64 {
        match self.rotation_fields.sparse() {
            Some(shares) if !shares.at(a).is_empty() && !shares.at(b).is_empty() => {
                shares_difference(shares.at(a), shares.at(b))
            }
            _ => shares_difference(&self.shares_at(a), &self.shares_at(b)),
        }
    }
}

/// Half the sum of the differences of two places' shares. Where handles have a say in one place alone, that is half of the
/// way as well.
pub fn shares_difference(a: &[(u32, f32)], b: &[(u32, f32)]) -> f64 {
    let (mut i, mut j, mut sum) = (0, 0, 0.0);
    while i < a.len() || j < b.len() {
        let next = |list: &[(u32, f32)], at: usize| list.get(at).map_or(u32::MAX, |s| s.0);
        let (ka, kb) = (next(a, i), next(b, j));
        let mut difference = 0.0;
        if ka <= kb {
            difference += f64::from(a[i].1);
            i += 1;
        }
        if kb <= ka {
            difference -= f64::from(b[j].1);
            j += 1;
        }
        sum += difference.abs();
    }
    0.5 * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_follow_by_their_share() {
        let field = [0.0f32, 0.5, 1.0];
        let mut x = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0];
        let map = DAffine3::from_translation(DVec3::new(0.0, 4.0, 0.0));
        let pool = Pool::new(1).unwrap();
        carry(&mut x, &[HandleMotion { field: &field, map }], &pool);
        assert_eq!(x, [0.0, 0.0, 0.0, 1.0, 2.0, 0.0, 2.0, 4.0, 0.0]);
        let again = x;
        carry(&mut x, &[], &pool);
        assert_eq!(x, again);
    }

    #[test]
    fn the_affine_map_is_that_of_the_transform() {
        let transform = Transform {
            translation: DVec3::new(1.0, -2.0, 0.5),
            rotation: DVec3::new(0.3, 0.2, -0.9),
            pivot: DVec3::new(0.1, 5.0, 2.0),
            ..Transform::IDENTITY
        };
        let p = DVec3::new(0.7, -0.2, 3.0);
        let far = (affine(&transform).transform_point3(p) - transform.map()(p)).length();
        assert!(far < 1e-12, "{far}");
    }
}
