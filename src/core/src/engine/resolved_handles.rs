//! A set of handles resolved to what the deformation takes: nodes, weights and transforms.

use super::error::Error;
use super::facts::DeformerWarning;
use super::handle::{Falloff, FalloffCurve, Handle, HandlePose, HandleSet};
use super::region::Region;
use super::region_context::{
    MirrorPlane, RegionContext, RegionNodes, holds_nothing, nodes_in_region, region_centroid, vertices_in_region,
    vertices_of_handle,
};
use super::shape::FoundTurn;
use super::stiff::{stiff_nodes, stiff_vertices};
use super::target_vertices::{HeldBytesAdmission, TargetVertices, check_targets_alone};
use crate::deform::{DeformableBody, FreePartPolicy, HandleConstraint, HandleSetup, StiffNodes, Transform};
use crate::exec::Exec;
use crate::mesh::NONE;
use crate::progress::Cancelled;
use glam::{DMat3, DVec3};
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::sync::Arc;

/// Nodes that a falloff reaches between two looks at the progress.
const CHECKED: u64 = 4096;

/// How much a handle holds.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HeldCounts {
    /// Render vertices.
    pub vertices: u32,
    /// Nodes inside the model.
    pub interior_nodes: u32,
}

/// The handles in force beside the system: their places and what the deformation does not see.
#[derive(Debug, Clone, Default)]
pub(super) struct ResolvedHandles {
    /// The handles as they were set.
    pub set: HandleSet,
    /// The middle of each handle's region.
    pub centroids: Vec<DVec3>,
    /// Default pivot by handle: the joint between it and what is free, or else the middle of its region.
    pub pivots: Vec<DVec3>,
    /// What each handle holds, after overlaps.
    pub counts: Vec<HeldCounts>,
    /// With a symmetry plane: the plane; hold `handles + k` is then the mirror image of handle k.
    pub mirror: Option<MirrorPlane>,
    /// By handle, what it pulls where it has targets.
    pub targets: Vec<Option<TargetVertices>>,
    /// Render vertices in no face that a hard handle holds, with its hold.
    pub unreferenced: Vec<(u32, u32)>,
    /// What the user should know.
    pub warnings: Vec<DeformerWarning>,
}

/// Resolves handles to what they hold in the model as it is; nothing else decides it, so that no shape depends on when its
/// handles were set.
pub(super) fn resolve_handles(
    context: &RegionContext<'_>,
    body: &DeformableBody,
    mut set: HandleSet,
    policy: FreePartPolicy,
    admit: &HeldBytesAdmission<'_>,
) -> Result<(ResolvedHandles, HandleSetup), Error> {
    let mirror = set.symmetry_plane.map(|p| p.unit_normal_and_point());
    let graph = &body.graph;
    let mut resolved = ResolvedHandles {
        mirror,
        ..Default::default()
    };
    let (mut holds, mut images, mut unreferenced) = (Vec::new(), Vec::new(), Vec::new());
    let mut held_bytes = 0;
    let lists = differing_lists(&set.handles);
    for (k, handle) in set.handles.iter().enumerate() {
        admit(held_bytes)?;
        check_handle(&set, handle, &format!("handles[{k}]"))?;
        let in_region = |e: Error| e.below(&format!("handles[{k}].region"));
        let vertices = vertices_of_handle(context, &handle.region).map_err(in_region)?;
        let mut held = nodes_in_region(context, graph, &handle.region, None).map_err(in_region)?;
        if handle.targets.is_some() {
            held.keep_surface(graph);
        }
        if held.nodes.is_empty() && !vertices.contains(&true) {
            return Err(in_region(holds_nothing(context)));
        }
        (resolved.centroids).push(region_centroid(context, graph, &vertices, &held.nodes));
        let at = format!("handles[{k}]");
        let mut hold = hold_nodes(body, handle, held, &at, context.exec)?;
        let targets = handle
            .targets
            .map(|_| TargetVertices::of(context, &vertices, handle, &mut hold.pulls));
        let mut targets = targets.transpose().map_err(in_region)?;
        if let Some(targets) = &mut targets {
            let admit_guide = |bytes| admit(held_bytes + bytes);
            targets.bind_guide(handle, context.positions, &at, &admit_guide, context.exec)?;
            // As in a falloff: they take no node from a hard handle.
            hold.nodes = Vec::new();
        }
        held_bytes += targets.as_ref().map_or(0, |targets| targets.byte_size() as u64);
        resolved.targets.push(targets);
        if hold.stiffness.is_none() && hold.position {
            unreferenced.extend(unreferenced_vertices(context, &vertices, k as u32));
        }
        if mirror.is_some() {
            let image = nodes_in_region(context, graph, &handle.region, mirror).map_err(in_region)?;
            let mut image = hold_nodes(body, handle, image, &at, context.exec)?;
            // A node of both belongs to the handle itself, not to its mirror image.
            image.nodes.retain(|n| hold.nodes.binary_search(n).is_err());
            image.pulls.retain(|(n, _)| hold.nodes.binary_search(n).is_err());
            held_bytes += constraint_bytes(&image, lists);
            images.push(image);
        }
        held_bytes += constraint_bytes(&hold, lists);
        holds.push(hold);
    }
    admit(held_bytes)?;
    let frozen = frozen_nodes(context, body, set.region_of_interest.as_ref())?;
    resolved.warnings = overlap_warnings(&set.handles, &holds, &images, &frozen);
    holds.extend(images);
    let mut stiff_parts = StiffNodes::default();
    if let Some(stiff) = &set.stiff {
        let part_of_vertex = stiff_vertices(context, stiff)?;
        let (nodes, bent) = stiff_nodes(body, &part_of_vertex, stiff.strength, &mut holds, &frozen);
        stiff_parts = nodes;
        resolved.warnings.extend(warn_of_bent_parts(&bent));
    }
    unreferenced.sort_by_key(|&(vertex, hold)| (vertex, hold));
    // The last handle that names a vertex has it.
    unreferenced.reverse();
    unreferenced.dedup_by_key(|s| s.0);
    unreferenced.reverse();
    resolved.unreferenced = unreferenced;
    resolved.counts = count_held(context, body, &holds, set.handles.len(), &frozen);
    let with_targets = resolved.targets.iter().enumerate();
    for (k, targets) in with_targets.filter_map(|(k, targets)| Some((k, targets.as_ref()?))) {
        // By their corners anchors outlive an edit.
        targets.name_corners(&mut set.handles[k].region);
        resolved.counts[k].vertices = targets.count();
    }
    for (k, held) in resolved.counts.iter().enumerate() {
        if held.vertices + held.interior_nodes == 0 && !holds[k].nodes.is_empty() {
            let message = format!("handle \"{}\" holds nothing after overlaps", set.handles[k].id);
            (resolved.warnings).push(DeformerWarning::about_handles("empty-handle", message, [k]));
        }
    }
    resolved.set = set;
    resolved.complete_targets(context.positions)?;
    Ok((
        resolved,
        HandleSetup {
            handles: holds,
            frozen,
            policy,
            stiff: stiff_parts,
        },
    ))
}

/// Warns of stiff parts that cannot be rigid, for where they are.
fn warn_of_bent_parts(bent: &[DVec3]) -> Option<DeformerWarning> {
    let first = bent.first()?;
    let several = "held by several hard handles, or cut by the region of interest,";
    let message = match bent.len() {
        1 => format!("a stiff part is {several} and bends"),
        count => format!("{count} stiff parts are {several} and bend"),
    };
    let place = format!("the first at ({}, {}, {})", first.x, first.y, first.z);
    Some(DeformerWarning::new("stiff-part-held", message, place))
}

impl ResolvedHandles {
    /// The transforms of all holds for poses by handle. Handles that keep their shape are not scaled.
    pub fn transforms(&self, poses: &[HandlePose]) -> Vec<Transform> {
        let mut all = Vec::with_capacity(poses.len() * 2);
        for (k, (pose, handle)) in poses.iter().zip(&self.set.handles).enumerate() {
            let mut t = pose.to_transform(self.default_pivot(k, pose));
            if handle.rigid {
                t.log_scale = DMat3::ZERO;
            }
            all.push(t);
        }
        if let Some((normal, point)) = self.mirror {
            let images: Vec<_> = all.iter().map(|t| t.mirrored(normal, point)).collect();
            all.extend(images);
        }
        all
    }

    /// The point that a handle turns about where its pose names none. What turns freely is held by its middle.
    pub fn default_pivot(&self, handle: usize, pose: &HandlePose) -> DVec3 {
        match pose.free_rotation {
            true => self.centroids[handle],
            false => self.pivots[handle],
        }
    }

    /// The rotations in `transforms` of the handles among the holds that turn freely; images turn as their handles do.
    pub fn found_turns(&self, free: &[usize], transforms: &[Transform]) -> Arc<[FoundTurn]> {
        let turn = |&hold: &usize| {
            let handle = self.set.handles.get(hold)?;
            let rotation = transforms[hold].rotation;
            let id = handle.id.clone();
            Some(FoundTurn { id, rotation })
        };
        free.iter().filter_map(turn).collect()
    }

    /// The holds whose rotation is found by the solve, for poses by handle.
    pub fn turning_freely(&self, poses: &[HandlePose]) -> Vec<usize> {
        let images = if self.mirror.is_some() { 2 } else { 1 };
        let all = poses.iter().cycle().take(images * poses.len()).enumerate();
        all.filter(|(_, pose)| pose.free_rotation)
            .map(|(hold, _)| hold)
            .collect()
    }
}

/// Refuses a handle that asks for what does not go together, whatever its region.
fn check_handle(set: &HandleSet, handle: &Handle, field: &str) -> Result<(), Error> {
    check_targets_alone(set, handle, field)?;
    if handle.rigid && handle.falloff.is_some() && handle.stiffness.is_none() {
        let problem =
            "makes the edge of a hard handle's region give way, but the region is rigid: one of both is allowed";
        return Err(Error::invalid(format!("{field}.falloff"), problem));
    }
    match &handle.pose {
        Some(pose) => check_free_rotation(handle, pose, &format!("{field}.pose")),
        None => Ok(()),
    }
}

/// Refuses a free rotation of a handle that has no say in rotations, or in where it turns; `field` is the pose's.
pub(super) fn check_free_rotation(handle: &Handle, pose: &HandlePose, field: &str) -> Result<(), Error> {
    if !pose.free_rotation || (handle.constrains.position && handle.constrains.rotation) {
        return Ok(());
    }
    let problem = format!(
        "is set, but handle \"{}\" does not constrain both POSITION and ROTATION",
        handle.id
    );
    Err(Error::invalid(format!("{field}.freeRotation"), problem))
}

/// How many lists of pulls the system makes: one where each handle constrains all kinds of quantities or none, else one for each kind.
fn differing_lists(handles: &[Handle]) -> usize {
    let is_alike = |h: &Handle| {
        let kinds = &h.constrains;
        kinds.position == kinds.rotation && kinds.rotation == kinds.scale
    };
    if handles.iter().all(is_alike) { 1 } else { 3 }
}

/// Bytes of what a handle does, in the lists of nodes here and in those that the system makes of them.
fn constraint_bytes(hold: &HandleConstraint, lists: usize) -> u64 {
    const PULL: usize = size_of::<(u32, u32, f64)>();
    let own = size_of_val(&hold.nodes[..]) + size_of_val(&hold.pulls[..]);
    (own + lists * PULL * hold.pulls.len()) as u64
}

/// What a handle does to the nodes that it holds.
fn hold_nodes(
    body: &DeformableBody,
    handle: &Handle,
    held: RegionNodes,
    field: &str,
    exec: &Exec<'_>,
) -> Result<HandleConstraint, Error> {
    let mut pulls = Vec::new();
    let mut nodes = held.nodes;
    if handle.stiffness.is_some() {
        let ones = vec![1.0; nodes.len()];
        let weights = held.weights.as_deref().unwrap_or(&ones);
        pulls = nodes.iter().copied().zip(weights.iter().copied()).collect();
        if let Some(falloff) = handle.falloff {
            pulls.extend(fading_weights(body, &nodes, falloff, exec)?);
            pulls.sort_by_key(|p| p.0);
            pulls.shrink_to_fit();
        }
    } else if let Some(falloff) = handle.falloff {
        (nodes, pulls) = hard_core(body, &nodes, falloff, exec)?.map_err(|depth| {
            let problem = format!(
                "is {}, but no vertex of the region is that far from its border: below {depth} is allowed",
                falloff.radius
            );
            Error::invalid(format!("{field}.falloff.radius"), problem)
        })?;
    }
    Ok(HandleConstraint {
        nodes,
        pulls,
        stiffness: handle.stiffness,
        position: handle.constrains.position,
        rotation: handle.constrains.rotation,
        scale: handle.constrains.scale,
        rigid: handle.rigid,
    })
}

/// How many times its distance from the border a pull in the middle of the band lets a disturbance reach, squared: it is gone
/// after a quarter of the radius.
const BAND_STIFFNESS: f64 = 16.0;
/// A pull that is stiffer than any soft handle's may be is as good as hard.
const HARDEST: f64 = 1e6;
/// Directions of an edge in space, twice: what turns the mean square of a node's edges into the scale of its Laplacian.
const TWICE_DIRECTIONS: f64 = 6.0;

/// Of the nodes of a hard handle's region, those that stay hard, and the pulls of the band that its falloff makes soft: what is nearer
/// than the radius to a node outside, along the graph's edges. With weight f by the curve, 0 at the border and 1 at the core, the pull is
/// as f / (1 − f), in units that let a disturbance reach as far on fine meshes as on coarse ones. A region without a border is
/// all core. `Err` with the largest distance where there is no core.
#[expect(clippy::type_complexity, reason = "nodes and pulls, as in HandleConstraint")]
fn hard_core(
    body: &DeformableBody,
    region: &[u32],
    falloff: Falloff,
    exec: &Exec<'_>,
) -> Result<Result<(Vec<u32>, Vec<(u32, f64)>), f64>, Cancelled> {
    let mut outside = vec![true; body.nodes()];
    region.iter().for_each(|&n| outside[n as usize] = false);
    let outside: Vec<u32> = (0u32..).zip(outside).filter(|(_, out)| *out).map(|(n, _)| n).collect();
    let mut pulls = fading_weights(body, &outside, falloff, exec)?;
    if pulls.len() == region.len() {
        let far = distances_around(body, &outside, f64::MAX, exec)?;
        return Ok(Err(far.iter().map(|(_, d)| *d).fold(0.0, f64::max)));
    }
    pulls.sort_by_key(|p| p.0);
    let per_square = BAND_STIFFNESS / (TWICE_DIRECTIONS * falloff.radius * falloff.radius);
    for (node, weight) in &mut pulls {
        let here = body.graph.positions[*node as usize];
        let square = |(other, w): (usize, f64)| w * here.distance_squared(body.graph.positions[other]);
        let squares: f64 = body.edges(*node as usize).map(square).sum();
        *weight = per_square * squares * (1.0 - *weight) / weight.max(f64::MIN_POSITIVE);
    }
    let core = |n: &u32| match pulls.binary_search_by_key(n, |p| p.0) {
        Ok(at) => pulls[at].1 > HARDEST,
        Err(_) => true,
    };
    let nodes = region.iter().copied().filter(core).collect();
    pulls.retain(|p| p.1 <= HARDEST);
    pulls.shrink_to_fit();
    Ok(Ok((nodes, pulls)))
}

/// Weights around a region by distance along the graph's edges, so that a falloff does not jump between fingers.
pub(super) fn fading_weights(
    body: &DeformableBody,
    core: &[u32],
    Falloff { radius, curve }: Falloff,
    exec: &Exec<'_>,
) -> Result<Vec<(u32, f64)>, Cancelled> {
    let mut found = distances_around(body, core, radius, exec)?;
    for (_, value) in &mut found {
        let t = *value / radius;
        *value = match curve {
            FalloffCurve::Smooth => 1.0 - t * t * (3.0 - 2.0 * t),
            FalloffCurve::Linear => 1.0 - t,
        };
    }
    Ok(found)
}

/// Distances from a region along the graph's edges, of nodes around it that are nearer than `radius`.
fn distances_around(
    body: &DeformableBody,
    core: &[u32],
    radius: f64,
    exec: &Exec<'_>,
) -> Result<Vec<(u32, f64)>, Cancelled> {
    #[derive(PartialEq)]
    struct Reached(f64, u32);
    impl Eq for Reached {}
    impl PartialOrd for Reached {
        fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
            Some(self.cmp(other))
        }
    }
    impl Ord for Reached {
        fn cmp(&self, other: &Self) -> Ordering {
            other.0.total_cmp(&self.0).then(other.1.cmp(&self.1))
        }
    }
    let graph = &body.graph;
    let mut distance = vec![f64::INFINITY; body.nodes()];
    let mut heap = BinaryHeap::new();
    for &n in core {
        distance[n as usize] = 0.0;
        heap.push(Reached(0.0, n));
    }
    let mut found = Vec::new();
    let mut reached = 0u64;
    while let Some(Reached(d, n)) = heap.pop() {
        if reached.is_multiple_of(CHECKED) {
            exec.check()?;
        }
        reached += 1;
        if d > distance[n as usize] {
            continue;
        }
        if d > 0.0 {
            found.push((n, d));
        }
        for e in graph.offsets[n as usize] as usize..graph.offsets[n as usize + 1] as usize {
            let j = graph.neighbours[e];
            let next = d + graph.positions[n as usize].distance(graph.positions[j as usize]);
            if next < radius && next < distance[j as usize] {
                distance[j as usize] = next;
                heap.push(Reached(next, j));
            }
        }
    }
    Ok(found)
}

fn frozen_nodes(
    context: &RegionContext<'_>,
    body: &DeformableBody,
    interest: Option<&Region>,
) -> Result<Vec<bool>, Error> {
    let Some(region) = interest else {
        return Ok(Vec::new());
    };
    vertices_in_region(context, region, None).map_err(|e| e.below("regionOfInterest"))?;
    let inside = nodes_in_region(context, &body.graph, region, None).map_err(|e| e.below("regionOfInterest"))?;
    let mut frozen = vec![true; body.nodes()];
    inside.nodes.iter().for_each(|&n| frozen[n as usize] = false);
    Ok(frozen)
}

fn unreferenced_vertices(context: &RegionContext<'_>, vertices: &[bool], hold: u32) -> Vec<(u32, u32)> {
    let vertices = (0u32..).zip(vertices).zip(&context.mesh.solver_from_render);
    (vertices.filter(|((_, held), solver)| **held && **solver == NONE))
        .map(|((vertex, _), _)| (vertex, hold))
        .collect()
}

/// What each handle holds in the end. Frozen nodes count for none; a node that several handles pull counts for each.
fn count_held(
    context: &RegionContext<'_>,
    body: &DeformableBody,
    holds: &[HandleConstraint],
    handles: usize,
    frozen: &[bool],
) -> Vec<HeldCounts> {
    let mut counts = vec![HeldCounts::default(); handles];
    let mut copies = vec![0u32; body.graph.surface];
    let drawn = context.mesh.solver_from_render.iter().filter(|s| **s != NONE);
    drawn.for_each(|&solver| copies[solver as usize] += 1);
    // The last hold of a node that is hard keeps it from those before.
    let mut cut_off = vec![0u32; body.nodes()];
    let mut last = vec![u32::MAX; body.nodes()];
    for (k, hold) in (0u32..).zip(holds) {
        for &n in &hold.nodes {
            last[n as usize] = k;
            if hold.stiffness.is_none() {
                cut_off[n as usize] = k;
            }
        }
    }
    for (k, hold) in (0u32..).zip(holds) {
        // A mirror image counts for its handle.
        let count = &mut counts[k as usize % handles];
        for &n in &hold.nodes {
            let n = n as usize;
            let is_pulled = holds[last[n] as usize].stiffness.is_some() && hold.stiffness.is_some() && k >= cut_off[n];
            if frozen.get(n) == Some(&true) || !(last[n] == k || is_pulled) {
                continue;
            }
            match copies.get(n) {
                Some(copies) => count.vertices += copies,
                None => count.interior_nodes += 1,
            }
        }
    }
    counts
}

/// How many overlaps of handles, with each other and with what is frozen, have a warning of their own.
const MOST_OVERLAPS: usize = 64;

fn overlap_warnings(
    handles: &[Handle],
    holds: &[HandleConstraint],
    images: &[HandleConstraint],
    frozen: &[bool],
) -> Vec<DeformerWarning> {
    let mut warnings = Vec::new();
    let name = |k: usize| &handles[k % handles.len()].id;
    let all: Vec<&HandleConstraint> = holds.iter().chain(images).collect();
    let same_kind = |a: &HandleConstraint, b: &HandleConstraint| {
        (a.position && b.position) || (a.rotation && b.rotation) || (a.scale && b.scale)
    };
    let last = all.iter().flat_map(|h| h.nodes.last()).max();
    let mut holder = vec![u32::MAX; last.map_or(0, |n| *n as usize + 1)];
    let mut shared = std::collections::BTreeMap::<(u32, u32), usize>::new();
    for (k, hold) in all.iter().enumerate() {
        for &n in &hold.nodes {
            let before = holder[n as usize];
            let adds_up = |before: &HandleConstraint| before.stiffness.is_some() && hold.stiffness.is_some();
            let taken_from = all.get(before as usize).filter(|before| !adds_up(before));
            if taken_from.is_some_and(|before| same_kind(before, hold)) {
                *shared.entry((before, k as u32)).or_default() += 1;
            }
            holder[n as usize] = k as u32;
        }
    }
    let more = shared.len().saturating_sub(MOST_OVERLAPS);
    for ((a, b), count) in shared.into_iter().take(MOST_OVERLAPS) {
        let (a, b) = (a as usize, b as usize);
        let message = format!(
            "handles \"{}\" and \"{}\" share {count} graph nodes; the later one holds them",
            name(a),
            name(b)
        );
        let both = [a % handles.len(), b % handles.len()];
        warnings.push(DeformerWarning::about_handles("overlapping-handles", message, both));
    }
    if more > 0 {
        let message = format!("{more} more pairs of handles share graph nodes; the later one of each holds them");
        warnings.push(DeformerWarning::about_handles("overlapping-handles", message, []));
    }
    let outside = |hold: &HandleConstraint| hold.nodes.iter().filter(|n| frozen[**n as usize]).count();
    let beyond = holds.iter().enumerate().filter(|_| !frozen.is_empty());
    let mut beyond = beyond
        .map(|(k, hold)| (k, outside(hold)))
        .filter(|(_, count)| *count > 0);
    for (k, count) in beyond.by_ref().take(MOST_OVERLAPS) {
        let message = format!(
            "{count} graph nodes of handle \"{}\" lie outside the region of interest and stay fixed",
            name(k)
        );
        warnings.push(DeformerWarning::about_handles("handle-outside-region", message, [k]));
    }
    let more = beyond.count();
    if more > 0 {
        let message = format!("nodes of {more} more handles lie outside the region of interest and stay fixed");
        warnings.push(DeformerWarning::about_handles("handle-outside-region", message, []));
    }
    warnings
}
