//! Parts of a model that keep their shape and are moved by the solve, with no handle each: which they are, and how far a shape
//! is from that.

use super::error::Error;
use super::handle::Stiff;
use super::region_context::{RegionContext, vertices_in_region};
use crate::deform::{DeformableBody, HandleConstraint, HandleSystem, StiffNodes, UNHELD, fit_rigid_motion};
use crate::mesh::{BoundingBox, Components, Mesh, NONE};
use glam::DVec3;

/// Which part each solver vertex is of, or [`UNHELD`].
pub(super) fn stiff_vertices(context: &RegionContext<'_>, stiff: &Stiff) -> Result<Vec<u32>, Error> {
    let (mesh, parts) = (context.mesh, context.parts);
    // What each vertex is listed by; components have numbers of their own before those of the list.
    let mut listed_by = vec![UNHELD; mesh.positions.len()];
    let mut is_stiff = vec![stiff.all; parts.count];
    if stiff.auto {
        find_hard_parts(mesh, parts)
            .iter()
            .for_each(|&part| is_stiff[part as usize] = true);
    }
    for (by, &part) in listed_by.iter_mut().zip(&parts.of_vertex) {
        if is_stiff[part as usize] {
            *by = part;
        }
    }
    for (k, (field, region)) in stiff.listed().iter().enumerate() {
        context.exec.check()?;
        let vertices = vertices_in_region(context, region, None).map_err(|e| below_listed(e, field))?;
        let solver = mesh.solver_from_render.iter().zip(&vertices);
        for (&s, _) in solver.filter(|(s, is_in)| **is_in && **s != NONE) {
            listed_by[s as usize] = (parts.count + k) as u32;
        }
    }
    Ok(pieces(mesh, &listed_by))
}

/// Puts the field of a number or region before that of an error; a number has nothing below it.
fn below_listed(error: Error, field: &str) -> Error {
    match error {
        Error::Invalid { problem, .. } if !field.contains("regions") => Error::invalid(field, problem),
        other => other.below(field),
    }
}

/// What hangs together by triangles of the vertices with one number each; [`UNHELD`] stays.
fn pieces(mesh: &Mesh, number: &[u32]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..number.len() as u32).collect();
    fn root(parent: &mut [u32], mut v: u32) -> u32 {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    }
    for &[a, b, c] in &mesh.triangles {
        for (a, b) in [(a, b), (b, c), (c, a)] {
            if number[a as usize] != UNHELD && number[a as usize] == number[b as usize] {
                let (a, b) = (root(&mut parent, a), root(&mut parent, b));
                parent[a.max(b) as usize] = a.min(b);
            }
        }
    }
    let mut named = vec![UNHELD; number.len()];
    let mut count = 0;
    let mut piece = vec![UNHELD; number.len()];
    for v in (0..number.len() as u32).filter(|v| number[*v as usize] != UNHELD) {
        let root = root(&mut parent, v) as usize;
        if named[root] == UNHELD {
            named[root] = count;
            count += 1;
        }
        piece[v as usize] = named[root];
    }
    piece
}

/// The stiff nodes of a body, for the part of each solver vertex. A part that one hard handle holds any node of, after overlaps,
/// joins that handle; returns the places of parts that several hold, which bend. `frozen` nodes are held as by one handle more.
pub(super) fn stiff_nodes(
    body: &DeformableBody,
    part_of_vertex: &[u32],
    strength: f64,
    holds: &mut [HandleConstraint],
    frozen: &[bool],
) -> (StiffNodes, Vec<DVec3>) {
    let part_of: Vec<u32> = (body.graph.nearest_surface.iter())
        .map(|&v| part_of_vertex[v as usize])
        .collect();
    let count = part_of
        .iter()
        .filter(|k| **k != UNHELD)
        .max()
        .map_or(0, |k| *k as usize + 1);
    // By part: the hold that has it, or `SEVERAL`.
    const SEVERAL: u32 = UNHELD - 1;
    let mut holder = vec![UNHELD; count];
    let mut owner = vec![UNHELD; part_of.len()];
    let is_hard = |hold: &HandleConstraint| hold.position && hold.stiffness.is_none();
    for (k, hold) in (0u32..).zip(holds.iter()).filter(|(_, hold)| is_hard(hold)) {
        hold.nodes.iter().for_each(|&node| owner[node as usize] = k);
    }
    let frozen = owner.iter_mut().zip(frozen).filter(|(_, frozen)| **frozen);
    frozen.for_each(|(owner, _)| *owner = holds.len() as u32);
    for (&k, &part) in owner.iter().zip(&part_of).filter(|(k, _)| **k != UNHELD) {
        if let Some(holder) = holder.get_mut(part as usize) {
            *holder = if *holder == UNHELD || *holder == k { k } else { SEVERAL };
        }
    }
    let mut joined = vec![Vec::new(); holds.len()];
    let mut bent = vec![None; count];
    for (node, &part) in (0u32..).zip(&part_of).filter(|(_, k)| **k != UNHELD) {
        match holder[part as usize] {
            UNHELD => {}
            // One that is partly frozen, and not held otherwise, cannot move without bending.
            k if k as usize == joined.len() => {
                _ = bent[part as usize].get_or_insert(body.graph.positions[node as usize])
            }
            SEVERAL => _ = bent[part as usize].get_or_insert(body.graph.positions[node as usize]),
            k => joined[k as usize].push(node),
        }
    }
    for (hold, joined) in holds.iter_mut().zip(joined).filter(|(_, joined)| !joined.is_empty()) {
        hold.nodes.extend(joined);
        hold.nodes.sort_unstable();
        hold.nodes.dedup();
    }
    (StiffNodes { part_of, strength }, bent.into_iter().flatten().collect())
}

/// Parts of at most this share of the model's diagonal are hard, and up to the second those with sharp edges.
const SMALL: [f64; 2] = [0.25, 0.5];
/// Edges are sharp where faces meet at more than 30°; a part has sharp edges where this share of its length of edges is.
const SHARP: f64 = 0.866;
const SHARP_SHARE: f64 = 0.1;
/// Parts of fewer vertices are splinters: nothing of them would bend.
const FEWEST: usize = 8;

/// The connected components of a model of several that look like hard parts, such as bolts, buttons, bones and eyes: those that
/// are small beside the model, and somewhat larger ones with sharp edges.
pub fn find_hard_parts(mesh: &Mesh, parts: &Components) -> Vec<u32> {
    if parts.count < 2 {
        return Vec::new();
    }
    let mut boxes: Vec<(DVec3, DVec3, usize)> = vec![(DVec3::INFINITY, DVec3::NEG_INFINITY, 0); parts.count];
    for (p, &part) in mesh.positions.iter().zip(&parts.of_vertex) {
        let (low, high, count) = &mut boxes[part as usize];
        (*low, *high, *count) = (low.min(*p), high.max(*p), *count + 1);
    }
    let normal = |t: u32| {
        let [a, b, c] = mesh.triangles[t as usize].map(|v| mesh.positions[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * mesh.triangles.len());
    for (t, &[a, b, c]) in (0u32..).zip(&mesh.triangles) {
        edges.extend([(a, b), (b, c), (c, a)].map(|(a, b)| (a.min(b), a.max(b), t)));
    }
    edges.sort_unstable();
    let mut lengths = vec![(0.0, 0.0); parts.count];
    for pair in edges
        .windows(2)
        .filter(|pair| (pair[0].0, pair[0].1) == (pair[1].0, pair[1].1))
    {
        let (a, b, t) = pair[0];
        let length = mesh.positions[a as usize].distance(mesh.positions[b as usize]);
        let (all, sharp) = &mut lengths[parts.of_vertex[a as usize] as usize];
        *all += length;
        if normal(t).dot(normal(pair[1].2)) < SHARP {
            *sharp += length;
        }
    }
    let model = BoundingBox::of(&mesh.positions);
    let diagonal = (model.max - model.min).length();
    let is_hard = |part: usize| {
        let (low, high, count) = boxes[part];
        let size = (high - low).length();
        let (all, sharp) = lengths[part];
        count >= FEWEST && (size <= SMALL[0] * diagonal || (size <= SMALL[1] * diagonal && sharp >= SHARP_SHARE * all))
    };
    (0..parts.count)
        .filter(|&part| is_hard(part))
        .map(|part| part as u32)
        .collect()
}

/// How far the stiff part that is least so is from a rigid motion of its rest shape: the largest distance of a vertex, as a part of
/// the part's diagonal. `now` returns where a solver vertex is. `None` without stiff parts.
pub(super) fn farthest_off_rigid(
    system: &HandleSystem,
    body: &DeformableBody,
    now: impl Fn(usize) -> DVec3,
) -> Option<f64> {
    let off = |nodes: &[u32]| {
        let rest: Vec<DVec3> = nodes.iter().map(|&n| body.graph.positions[n as usize]).collect();
        let there: Vec<DVec3> = nodes.iter().map(|&n| now(n as usize)).collect();
        let map = fit_rigid_motion(&rest, &there).map();
        let bounds = BoundingBox::of(&rest);
        let size = (bounds.max - bounds.min).length();
        let far = rest
            .iter()
            .zip(&there)
            .map(|(p, x)| map(*p).distance(*x))
            .fold(0.0, f64::max);
        if size > 0.0 { far / size } else { 0.0 }
    };
    let parts = system.stiff_parts(body).filter(|nodes| nodes.len() > 1);
    parts
        .map(off)
        .fold(None, |most: Option<f64>, off| Some(most.map_or(off, |m| m.max(off))))
}
