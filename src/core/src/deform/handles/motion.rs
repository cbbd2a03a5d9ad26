//! The start of a drag: the last solution, moved by what the handles did since.
//!
//! A harmonic field is how much each node follows a handle. Every node moves by its share of each handle's motion. For
//! translations this is exactly the solution of the second pass, where the fields' handles are those that hold
//! positions; for small rotations it leaves an error of second order. It costs one pass over the nodes.

use crate::deform::body::DeformableBody;
use crate::deform::handles::system::HandleSystem;
use crate::deform::transform::Transform;
use crate::pool::Pool;
use glam::{DAffine3, DVec3};
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
                motions.iter().for_each(|motion| there += motion.share_of(i, here));
                *x = there.to_array();
            });
    });
}

impl HandleSystem {
    /// Carries solving coordinates from one pose to the next with all handles that constrain rotations, by the few that have
    /// a say at each node.
    pub(in crate::deform) fn carry_by_shares(
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
    pub(in crate::deform) fn carry(
        &self,
        body: &DeformableBody,
        from: &[Transform],
        to: &[Transform],
        x: &mut [f64],
        pool: &Pool,
    ) {
        carry(x, &self.motions(body, from, to), pool);
    }

    /// How handles that hold positions moved from one pose to the next, in solving coordinates; those whose scale was close to
    /// nothing are left out.
    pub(in crate::deform) fn motions(
        &self,
        body: &DeformableBody,
        from: &[Transform],
        to: &[Transform],
    ) -> Vec<HandleMotion<'_>> {
        let into = solving_to_model(body);
        from.iter()
            .zip(to)
            .enumerate()
            .filter(|(k, (from, to))| from != to && self.setup.handles[*k].position)
            .map(|(k, (from, to))| HandleMotion {
                field: self.rotation_fields.of(k),
                map: way_between(from, to, into),
            })
            .filter(|motion| motion.map.is_finite() && !motion.field.is_empty())
            .collect()
    }
}

impl HandleMotion<'_> {
    /// What a node at `here` moves by.
    pub(in crate::deform) fn share_of(&self, node: usize, here: DVec3) -> DVec3 {
        let share = self.field.get(node).map_or(0.0, |u| f64::from(*u));
        (self.map.transform_point3(here) - here) * share
    }
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
