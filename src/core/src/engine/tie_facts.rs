//! What holds the parts of a model together, and what a pose would tear: as facts and warnings.

use super::facts::{DeformerWarning, LoosePart, TieFacts, count_u32};
use super::handle::HandleSet;
use crate::asset::Primitive;
use crate::deform::{DeformableBody, HandleSystem, Transform};
use crate::graph::TieAnchor;
use crate::mesh::{Components, Mesh};
use glam::DVec3;

/// How many loose parts are listed.
const MOST_TOLD: usize = 16;
/// Parts are pulled apart where two handles take one place further apart than this part of the diagonal.
const PULLED: f64 = 0.01;
/// How many pairs of handles one warning is made for.
const MOST_PAIRS: usize = 8;

/// Counts ties, and parts that nothing joins to others.
pub(super) fn tie_facts(mesh: &Mesh, parts: &Components, body: &DeformableBody, primitives: &[Primitive]) -> TieFacts {
    let graph = &body.graph;
    let ties = graph.ties.as_ref().map_or(0, |ties| ties.edge_count() as u64);
    if parts.count < 2 {
        return TieFacts::default();
    }
    // Parts that share their inside are joined by it.
    let mut parts_of = vec![0u32; graph.components];
    let firsts = parts.first_vertices();
    let whole = |part: usize| graph.component[firsts[part] as usize] as usize;
    (0..parts.count).for_each(|part| parts_of[whole(part)] += 1);
    let mut vertices = vec![0u32; parts.count];
    for (point, &part) in (0u32..).zip(&parts.of_vertex) {
        vertices[part as usize] += mesh.render_vertices_of(point).len() as u32;
    }
    let mut loose: Vec<usize> = (0..parts.count).filter(|&part| parts_of[whole(part)] == 1).collect();
    let count = loose.len();
    loose.sort_by_key(|&part| (std::cmp::Reverse(vertices[part]), part));
    loose.truncate(MOST_TOLD);
    let told = |part: usize| {
        let vertex = mesh.render_vertices_of(firsts[part])[0];
        let primitive = primitive_at(primitives, vertex);
        LoosePart {
            component: part as u32,
            vertices: vertices[part],
            primitive: primitive as u32,
            name: primitives.get(primitive).map_or_else(String::new, |p| p.name.clone()),
        }
    };
    TieFacts {
        ties,
        loose_parts: count_u32(count),
        loose: loose.into_iter().map(told).collect(),
    }
}

/// The primitive that a render vertex belongs to.
fn primitive_at(primitives: &[Primitive], vertex: u32) -> usize {
    primitives
        .partition_point(|p| p.first_vertex <= vertex)
        .saturating_sub(1)
}

/// A pose that pulls apart what ties hold together.
pub(super) struct PulledTies<'a> {
    pub body: &'a DeformableBody,
    pub rig: &'a HandleSystem,
    pub mesh: &'a Mesh,
    pub primitives: &'a [Primitive],
    pub handles: &'a HandleSet,
}

impl PulledTies<'_> {
    /// One warning for each pair of handles that hold tied places of two parts and take them apart.
    pub fn pull_warnings(&self, transforms: &[Transform]) -> Vec<DeformerWarning> {
        let Some(ties) = &self.body.graph.ties else {
            return Vec::new();
        };
        let maps: Vec<_> = transforms.iter().map(Transform::map).collect();
        // By pair of handles: how far, how many places, and the vertices of the worst.
        let mut pulled: Vec<([usize; 2], f64, usize, [u32; 2])> = Vec::new();
        for anchor in ties.anchors() {
            let Some((holders, gap, ends)) = self.gap_of(anchor, &maps) else {
                continue;
            };
            match pulled.iter().position(|p| p.0 == holders) {
                Some(known) => {
                    let known = &mut pulled[known];
                    known.2 += 1;
                    if gap > known.1 {
                        (known.1, known.3) = (gap, ends);
                    }
                }
                None if pulled.len() < MOST_PAIRS => pulled.push((holders, gap, 1, ends)),
                None => {}
            }
        }
        pulled.sort_by_key(|p| p.0);
        pulled.into_iter().map(|p| self.describe_pull(p)).collect()
    }

    /// How far the ends of a tie, held by two handles, come apart, if that is far.
    fn gap_of(&self, anchor: &TieAnchor, maps: &[impl Fn(DVec3) -> DVec3]) -> Option<([usize; 2], f64, [u32; 2])> {
        let rest = &self.body.graph.positions;
        let held = |v: u32| self.rig.hard_holder(v as usize);
        let first = held(anchor.vertex)?;
        let (corner, _) = anchor.weighted_corners().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let second = held(corner)?;
        if first == second {
            return None;
        }
        let at = rest[anchor.vertex as usize];
        // Where each of the two handles would take the same place.
        let gap = maps.get(first)?(at).distance(maps.get(second)?(at));
        let far = gap > PULLED * self.body.diagonal;
        far.then_some(([first.min(second), first.max(second)], gap, [anchor.vertex, corner]))
    }

    fn describe_pull(&self, (holders, gap, places, ends): ([usize; 2], f64, usize, [u32; 2])) -> DeformerWarning {
        let name = |v: u32| {
            let vertex = self.mesh.render_vertices_of(v)[0];
            let index = primitive_at(self.primitives, vertex);
            match self.primitives.get(index).map(|p| p.name.as_str()) {
                Some("") | None => format!("primitive {index}"),
                Some(name) => format!("\"{name}\""),
            }
        };
        // Mirror images of handles come after them all.
        let handles = &self.handles.handles;
        let id = |k: usize| &handles[k % handles.len()].id;
        let message = format!(
            "handles \"{}\" and \"{}\" take tied places of {} and {} apart, by up to {:.3} ({:.1} % of the diagonal) at {places} \
             of them; give the parts one pose, or keep one apart (keepApart)",
            id(holders[0]),
            id(holders[1]),
            name(ends[0]),
            name(ends[1]),
            gap,
            100.0 * gap / self.body.diagonal,
        );
        DeformerWarning::about_handles("parts-pulled-apart", message, holders)
    }
}
