//! Which way leads inwards from each vertex.

use crate::graph::error::Error;
use crate::graph::parallel::{map, map_in_space};
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::solid::{InwardDirections, PartKind, normal, sample, turn};
use glam::DVec3;

/// The unit vector that leads inwards from each vertex; zero where the vertex has no normal, and on parts that
/// enclose nothing; `order` has all vertices in the order in which they are best looked at. Normals of a part that is wound
/// inside out are turned round. With it for each part 1, −1 when its normals were turned, or 0 when it has no inside.
pub(in crate::graph) fn inward_directions(
    site: &VolumeSite,
    order: &[u32],
    step: f64,
) -> Result<(InwardDirections, Vec<f64>), Error> {
    let VolumeSite { parts, budget, .. } = *site;
    let (positions, triangles) = (&site.mesh.positions, &site.mesh.triangles);
    let found = map(order, budget, |&v| {
        if parts.kind(v) != PartKind::Sheet {
            -normal(positions, triangles, site.adjacency, v)
        } else {
            DVec3::ZERO
        }
    })?;
    let mut inward = vec![DVec3::ZERO; positions.len()];
    order.iter().zip(found).for_each(|(&v, d)| inward[v as usize] = d);
    let part = |v: u32| parts.components.of_vertex[v as usize] as usize;
    let candidates = (0..positions.len() as u32)
        .filter(|&v| inward[v as usize] != DVec3::ZERO)
        .collect();
    let asked = sample(candidates, parts.kinds.len(), part);
    let space = || order.to_vec();
    let sides = map_in_space(&asked, space, budget, |&v| {
        let (p, d) = (positions[v as usize], inward[v as usize] * step);
        (site.contains(p + d), site.contains(p - d))
    })?;
    let mut votes = vec![(0usize, 0usize); parts.kinds.len()];
    for (&v, (ahead, behind)) in asked.iter().zip(sides) {
        let vote = &mut votes[part(v)];
        vote.0 += usize::from(ahead);
        vote.1 += usize::from(behind);
    }
    let turns: Vec<f64> = votes.into_iter().map(turn).collect();
    for (d, v) in inward.iter_mut().zip(0u32..) {
        let turn = turns[part(v)];
        if turn <= 0.0 {
            *d = if turn < 0.0 { -*d } else { DVec3::ZERO };
        }
    }
    Ok((inward, turns))
}
