//! A set of handles as requested, resolved to what the engine takes.

use super::region::{MirrorPlane, RegionContext, ResolvedRegion, resolve};
use crate::deform::{DeformableBody, FreePartPolicy, HandleConstraint, HandleSetup, Transform};
use crate::mesh::NONE;
use crate::wire::check::{enumerated, number, optional_within, plane, positive, transform};
use crate::wire::{Error, pb};
use glam::{DMat3, DVec3};
use std::cmp::Ordering;
use std::collections::{BTreeSet, BinaryHeap};

/// The handles in force beside the rig: their places and what the engine does not see.
#[derive(Debug, Clone, Default)]
pub(super) struct ResolvedHandles {
    /// The request as it came.
    pub request: pb::SetHandlesRequest,
    /// Default pivot by handle.
    pub centroids: Vec<DVec3>,
    /// Render vertices by handle, after overlaps.
    pub counts: Vec<u32>,
    /// With a symmetry plane: the plane; hold `handles + k` is then the mirror image of handle k.
    pub mirror: Option<MirrorPlane>,
    /// Render vertices in no face that a hard handle holds, with its hold.
    pub strays: Vec<(u32, u32)>,
    /// What the user should know.
    pub warnings: Vec<pb::Warning>,
}

/// What handles held before an edit that carried them over.
#[derive(Debug, Clone, Copy)]
pub(super) struct HandlesBeforeEdit<'a> {
    pub rigging: &'a HandleSetup,
    /// For each node its number before the edit, or [`NONE`].
    pub old_from_new: &'a [u32],
}

impl HandlesBeforeEdit<'_> {
    /// For each node before the edit its number now.
    fn new_from_old(&self) -> Vec<u32> {
        let most = self.old_from_new.iter().filter(|o| **o != NONE).max();
        let mut new = vec![NONE; most.map_or(0, |&m| m as usize + 1)];
        for (n, &old) in (0u32..).zip(self.old_from_new).filter(|n| *n.1 != NONE) {
            new[old as usize] = n;
        }
        new
    }
}

/// Checks a request and resolves it. `most` bounds the number of handles. With `before` handles go on to hold the nodes
/// inside that they held: a list of vertices, as which they come back, does not tell them.
pub(super) fn resolve_handles(
    ground: &RegionContext<'_>,
    body: &DeformableBody,
    request: &pb::SetHandlesRequest,
    policy: FreePartPolicy,
    before: Option<HandlesBeforeEdit<'_>>,
    most: usize,
) -> Result<(ResolvedHandles, HandleSetup), Error> {
    if request.handles.len() > most {
        return Err(Error::TooLarge {
            what: "handles",
            seen: request.handles.len() as u64,
            limit: most as u64,
        });
    }
    let mirror = request
        .symmetry_plane
        .as_ref()
        .map(|p| plane(p, "symmetryPlane"))
        .transpose()?;
    // MirrorPlane images are found from what handles hold, so those stay as they are listed.
    let before = before.filter(|b| mirror.is_none() && b.rigging.handles.len() == request.handles.len());
    let numbers = before.map(|b| b.new_from_old()).unwrap_or_default();
    let mut ids = BTreeSet::new();
    let mut set = ResolvedHandles {
        request: request.clone(),
        mirror,
        ..Default::default()
    };
    let mut holds = Vec::new();
    let mut images = Vec::new();
    let mut strays = Vec::new();
    for (k, handle) in request.handles.iter().enumerate() {
        let field = format!("handles[{k}]");
        if handle.id.is_empty() || handle.id.len() > 128 {
            let problem = format!("has {} bytes, allowed are 1 to 128", handle.id.len());
            return Err(Error::invalid(format!("{field}.id"), problem));
        }
        if !ids.insert(handle.id.as_str()) {
            return Err(Error::invalid(
                format!("{field}.id"),
                format!("\"{}\" is used twice", handle.id),
            ));
        }
        let region_field = format!("{field}.region");
        let mut region = resolve(ground, handle.region.as_ref(), None, &region_field)?;
        if let Some(before) = before.filter(|_| region.weights.is_none()) {
            let surface = ground.graph.surface as u32;
            let is_new = |n: &u32| before.old_from_new.get(*n as usize).is_none_or(|o| *o == NONE);
            region.nodes.retain(|n| *n < surface || is_new(n));
            let held = before.rigging.handles[k].nodes.iter();
            let still = held.filter_map(|&old| numbers.get(old as usize).copied());
            region.nodes.extend(still.filter(|&n| n != NONE && n >= surface));
            region.nodes.sort_unstable();
        }
        let centroid = region.centroid(ground);
        if let Some(pose) = &handle.pose {
            transform(pose, centroid, &format!("{field}.pose"))?;
        }
        set.centroids.push(centroid);
        let hold = hold(body, handle, &region, &field)?;
        if hold.stiffness.is_none() && hold.position {
            strays.extend(stray_vertices(ground, &region, k as u32));
        }
        if mirror.is_some() {
            let image = resolve(ground, handle.region.as_ref(), mirror, &region_field)?;
            let mut image = self::hold(body, handle, &image, &field)?;
            // A node of both belongs to the handle itself, not to its mirror image.
            image.nodes.retain(|n| hold.nodes.binary_search(n).is_err());
            image.pulls.retain(|(n, _)| hold.nodes.binary_search(n).is_err());
            images.push(image);
        }
        holds.push(hold);
    }
    let frozen = frozen_nodes(ground, request)?;
    set.warnings = overlaps(request, &holds, &images, &frozen);
    holds.extend(images);
    strays.sort_by_key(|&(vertex, hold)| (vertex, hold));
    // The last handle that names a vertex has it.
    strays.reverse();
    strays.dedup_by_key(|s| s.0);
    strays.reverse();
    set.strays = strays;
    set.counts = render_counts(ground, &holds, request.handles.len(), &frozen);
    for (k, _) in set
        .counts
        .iter()
        .enumerate()
        .filter(|(k, c)| **c == 0 && !holds[*k].nodes.is_empty())
    {
        set.warnings.push(pb::Warning {
            code: "empty-handle".into(),
            message: format!("handle \"{}\" holds no vertex after overlaps", request.handles[k].id),
            r#where: format!("handles[{k}]"),
        });
    }
    Ok((
        set,
        HandleSetup {
            handles: holds,
            frozen,
            policy,
        },
    ))
}

impl ResolvedHandles {
    /// The transforms of all holds for poses by handle. Handles that keep their shape are not scaled.
    pub fn transforms(&self, poses: &[pb::HandlePose]) -> Result<Vec<Transform>, Error> {
        let mut all = Vec::with_capacity(poses.len() * 2);
        for (k, (pose, handle)) in poses.iter().zip(&self.request.handles).enumerate() {
            let mut t = transform(pose, self.centroids[k], &format!("handles[{k}].pose"))?;
            if handle.rigid {
                t.log_scale = DMat3::ZERO;
            }
            all.push(t);
        }
        if let Some((normal, point)) = self.mirror {
            let images: Vec<_> = all.iter().map(|t| t.mirrored(normal, point)).collect();
            all.extend(images);
        }
        Ok(all)
    }
}

fn hold(
    body: &DeformableBody,
    handle: &pb::Handle,
    region: &ResolvedRegion,
    field: &str,
) -> Result<HandleConstraint, Error> {
    let (mut position, mut rotation, mut scale) = (false, false, false);
    for (k, &c) in handle.constrains.iter().enumerate() {
        match enumerated(c, &format!("{field}.constrains[{k}]"))? {
            pb::handle::Constrains::Position => position = true,
            pb::handle::Constrains::Rotation => rotation = true,
            pb::handle::Constrains::Scale => scale = true,
        }
    }
    if handle.constrains.is_empty() {
        (position, rotation, scale) = (true, true, true);
    }
    let stiffness = match handle.stiffness {
        None => None,
        Some(s) => {
            let at = format!("{field}.stiffness");
            positive(s, &at)?;
            let bounded = optional_within(s, 1e-6, 1e6, &at)?;
            Some(bounded.unwrap_or(s))
        }
    };
    let falloff = match &handle.falloff {
        None => None,
        Some(falloff) => {
            let at = format!("{field}.falloff");
            let kind: pb::falloff::Kind = enumerated(falloff.kind, &format!("{at}.kind"))?;
            number(falloff.radius, &format!("{at}.radius"))?;
            if kind == pb::falloff::Kind::None {
                None
            } else if stiffness.is_none() {
                return Err(Error::invalid(at, "needs stiffness: a hard handle cannot fade out"));
            } else {
                Some((positive(falloff.radius, &format!("{at}.radius"))?, kind))
            }
        }
    };
    let mut pulls = Vec::new();
    if stiffness.is_some() {
        let ones = vec![1.0; region.nodes.len()];
        let weights = region.weights.as_deref().unwrap_or(&ones);
        pulls = region.nodes.iter().copied().zip(weights.iter().copied()).collect();
        if let Some((radius, kind)) = falloff {
            pulls.extend(fade(body, &region.nodes, radius, kind));
            pulls.sort_by_key(|p| p.0);
        }
    }
    Ok(HandleConstraint {
        nodes: region.nodes.clone(),
        pulls,
        stiffness,
        position,
        rotation,
        scale,
        rigid: handle.rigid,
    })
}

/// Weights around a region by distance along the graph's edges, so that a falloff does not jump between fingers.
fn fade(body: &DeformableBody, core: &[u32], radius: f64, kind: pb::falloff::Kind) -> Vec<(u32, f64)> {
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
    while let Some(Reached(d, n)) = heap.pop() {
        if d > distance[n as usize] {
            continue;
        }
        if d > 0.0 {
            let t = d / radius;
            let weight = match kind {
                pb::falloff::Kind::Smooth => 1.0 - t * t * (3.0 - 2.0 * t),
                _ => 1.0 - t,
            };
            found.push((n, weight));
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
    found
}

fn frozen_nodes(ground: &RegionContext<'_>, request: &pb::SetHandlesRequest) -> Result<Vec<bool>, Error> {
    let Some(region) = &request.region_of_interest else {
        return Ok(Vec::new());
    };
    let inside = resolve(ground, Some(region), None, "regionOfInterest")?;
    let mut frozen = vec![true; ground.graph.positions.len()];
    inside.nodes.iter().for_each(|&n| frozen[n as usize] = false);
    Ok(frozen)
}

fn stray_vertices(ground: &RegionContext<'_>, region: &ResolvedRegion, hold: u32) -> Vec<(u32, u32)> {
    (0u32..)
        .zip(&region.render)
        .zip(&ground.mesh.solver_from_render)
        .filter(|((_, held), solver)| **held && **solver == NONE)
        .map(|((vertex, _), _)| (vertex, hold))
        .collect()
}

/// Who holds each node in the end; the frozen surroundings count as nobody.
fn last_holders(holds: &[HandleConstraint], nodes: usize, frozen: &[bool]) -> Vec<u32> {
    let mut owner = vec![u32::MAX; nodes];
    for (k, hold) in holds.iter().enumerate() {
        hold.nodes.iter().for_each(|&n| owner[n as usize] = k as u32);
    }
    owner
        .iter_mut()
        .zip(frozen)
        .filter(|(_, f)| **f)
        .for_each(|(o, _)| *o = u32::MAX);
    owner
}

fn render_counts(ground: &RegionContext<'_>, holds: &[HandleConstraint], handles: usize, frozen: &[bool]) -> Vec<u32> {
    let owner = last_holders(holds, ground.graph.positions.len(), frozen);
    let mut counts = vec![0; handles];
    for &solver in ground.mesh.solver_from_render.iter().filter(|s| **s != NONE) {
        let k = owner[solver as usize] as usize;
        // A mirror image counts for its handle.
        if let Some(count) = k
            .checked_rem(handles.max(1))
            .filter(|_| k < holds.len())
            .and_then(|k| counts.get_mut(k))
        {
            *count += 1;
        }
    }
    counts
}

fn overlaps(
    request: &pb::SetHandlesRequest,
    holds: &[HandleConstraint],
    images: &[HandleConstraint],
    frozen: &[bool],
) -> Vec<pb::Warning> {
    let mut warnings = Vec::new();
    let name = |k: usize| &request.handles[k % request.handles.len()].id;
    let all: Vec<&HandleConstraint> = holds.iter().chain(images).collect();
    let same_kind = |a: &HandleConstraint, b: &HandleConstraint| {
        (a.position && b.position) || (a.rotation && b.rotation) || (a.scale && b.scale)
    };
    let most = all
        .iter()
        .flat_map(|h| h.nodes.last())
        .max()
        .map_or(0, |n| *n as usize + 1);
    let mut holder = vec![u32::MAX; most];
    let mut shared = std::collections::BTreeMap::<(u32, u32), usize>::new();
    for (k, hold) in all.iter().enumerate() {
        for &n in &hold.nodes {
            let before = holder[n as usize];
            if before != u32::MAX && same_kind(all[before as usize], hold) {
                *shared.entry((before, k as u32)).or_default() += 1;
            }
            holder[n as usize] = k as u32;
        }
    }
    for ((a, b), count) in shared {
        let (a, b) = (a as usize, b as usize);
        warnings.push(pb::Warning {
            code: "overlapping-handles".into(),
            message: format!(
                "handles \"{}\" and \"{}\" share {count} graph nodes; the later one holds them",
                name(a),
                name(b)
            ),
            r#where: format!(
                "handles[{}], handles[{}]",
                a % request.handles.len(),
                b % request.handles.len()
            ),
        });
    }
    if !frozen.is_empty() {
        for (k, hold) in holds.iter().enumerate() {
            let outside = hold.nodes.iter().filter(|n| frozen[**n as usize]).count();
            if outside > 0 {
                warnings.push(pb::Warning {
                    code: "handle-outside-region".into(),
                    message: format!(
                        "{outside} graph nodes of handle \"{}\" lie outside the region of interest and stay fixed",
                        name(k)
                    ),
                    r#where: format!("handles[{k}]"),
                });
            }
        }
    }
    warnings
}
