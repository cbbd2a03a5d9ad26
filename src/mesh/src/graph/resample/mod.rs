//! The graph of an edited mesh from the graph before: only what the edit reaches is sampled again.
//!
//! Vertices follow the mesh. Copies of vertices whose faces are as they were stay where they are, as long as they have
//! room there. Lattice nodes stay unless they are outside now, or too near to a new face; places of the grid that became
//! deep enough inside get nodes. What lies inside is found as for a new graph, by the faces beyond a place along one
//! axis. Rows without a changed face nearby are copied, with nodes renumbered.
//!
//! Nodes may have been moved since they were placed, as by a deformation that has become the rest shape. Moved lattice
//! nodes keep their edges to each other, and new ones fill the gaps between them on the grid of old.

mod change;
mod edges;
mod hull;
mod interior;
mod rows;
mod shape;
mod zone;

use crate::graph::mesh_graph::{GraphRecipe, GraphStats, InteriorRecipe, MeshGraph};
use crate::graph::volume::build::most_visits;
use crate::query::{TriangleBvh, VisitBudget, VisitCount};
use crate::{BoundingBox, Error, NONE, signed_volume};
pub use change::{MeshChange, ResampledGraph};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;

use crate::graph::resample::change::GraphEdit;
use crate::graph::resample::change::{ChangedPoints, GraphBefore, NodeNumbers};
use crate::graph::resample::hull::{HullChange, fan_over_loop};
use crate::graph::resample::interior::{EditedShell, InteriorChange};
use crate::graph::resample::zone::{ChangeZone, SpreadLengths};
use crate::graph::resample::zone::{LocalFaces, LocalMesh};

/// The graph after `change` from the graph before; `None` where a new graph has to be built: when the edit changes more than a
/// quarter of the points, opens a part widely, joins what encloses space with what does not, or touches a mesh so torn
/// that all of it is needed to find what lies inside. Where interior nodes follow the shape
/// ([`InteriorKind::Shape`](crate::graph::InteriorKind)) also when the edit opens a part at all, grows it by more than a few cells,
/// or changes a place that struts hold.
///
/// Parts that were surfaces only stay so. `positions` has all nodes of `old` where they are now: as built, or as a
/// deformation left them; points that `change` does not name must lie there. Edges keep their weights but where faces
/// changed. Flat passes over all nodes, edges and triangles, and work in proportion to the edit.
///
/// # Errors
/// [`Error::Cancelled`].
///
/// # Panics
/// When numbers in `change` are out of range, or `positions` is not as long as the graph.
pub fn resample(
    old: &MeshGraph,
    positions: &[DVec3],
    change: &MeshChange,
    exec: &Exec<'_>,
) -> Result<Option<ResampledGraph>, Error> {
    exec.check()?;
    assert_eq!(positions.len(), old.nodes(), "a position for every node");
    let old = &GraphBefore { graph: old, positions };
    let Some(points) = ChangedPoints::from_change(old, change) else {
        return Ok(None);
    };
    if !old.follows_edits() {
        return Ok(None);
    }
    match &old.recipe.inside {
        None if old.recipe.shape_interval.is_some() => shape::resample_shape(old, change, &points, exec),
        None => resample_surface(old, change, &points, exec.pool).map(Some),
        Some(inside) if inside.soups => Ok(None),
        Some(inside) => match resample_volume(old, inside, change, &points, exec) {
            // What takes too long here is reported when the graph is built from the beginning.
            Err(Error::FacesTooLong { .. }) => Ok(None),
            followed => followed,
        },
    }
}

/// Follows an edit of a mesh without interior nodes.
fn resample_surface(
    old: &GraphBefore<'_>,
    change: &MeshChange,
    points: &ChangedPoints,
    pool: &Pool,
) -> Result<ResampledGraph, Error> {
    let found = zone::find_local(change, points, None, pool);
    let local = LocalMesh::gather_faces(change, points, &found, None, pool);
    let numbers = NodeNumbers::from_change(old, change, points);
    let copies = edges::without_copies(&local);
    let name = |v: u32| numbers.point_number(change, local.points[v as usize]);
    let links = copies.find_links(&local, name, old.recipe.cotangents);
    let edit = GraphEdit {
        old,
        change,
        points,
        numbers: &numbers,
        gone: points.gone.clone(),
        outer: copies
            .refound_vertices()
            .map(|v| change.old_from_new[local.points[v as usize] as usize])
            .filter(|&o| o != NONE)
            .collect(),
        lattice: Vec::new(),
        untied: Vec::new(),
        links,
        placed: Vec::new(),
        nearest: Vec::new(),
    };
    let stats = old.stats.clone();
    Ok(rows::write_rows(&edit, stats, old.recipe.clone(), pool).0)
}

/// Follows an edit of a mesh with interior nodes.
fn resample_volume(
    old: &GraphBefore<'_>,
    inside: &InteriorRecipe,
    change: &MeshChange,
    points: &ChangedPoints,
    exec: &Exec<'_>,
) -> Result<Option<ResampledGraph>, Error> {
    let Some(mut hull) = hull::follow_hull(old, inside, change, points, exec.pool) else {
        return Ok(None);
    };
    let spread = SpreadLengths {
        near: inside.depth,
        core: inside.depth + 1.05 * inside.interval,
        rim: inside.depth + 1.05 * inside.interval,
    };
    let (faces, boxes) = changed_places(old, change, points, &hull);
    let Some(mut zone) = ChangeZone::around_changes(&faces, &boxes, inside.origin, inside.interval, &spread) else {
        // Without any change the graph is as it was; where changes lie too far apart, it is rebuilt.
        let none = faces.is_empty() && boxes.is_empty() && points.gone.is_empty() && points.fans.is_empty();
        return Ok(none.then(|| unchanged_graph(old)));
    };
    let found = zone::find_local(change, points, Some(&zone), exec.pool);
    exec.check()?;
    let between = LocalFaces::between_hulls(old, change, points, &hull, &found);
    let enclosed = between.sort_columns(0, exec.pool);
    zone.mark_enclosed(&spread, |p| enclosed.contains(p));
    let local = LocalMesh::gather_faces(change, points, &found, Some(&zone), exec.pool);
    let surface = TriangleBvh::build(&local.positions, &local.triangles, exec.pool);
    let around = LocalFaces::around_zone(change, &hull, &found);
    let columns = around.sort_columns(found.best_axis(), exec.pool);
    let looked = VisitCount::default();
    let seen = || surface.visits.total() + columns.visits() + looked.total();
    let budget = VisitBudget::new(most_visits(change.positions.len()), &seen, exec);
    let site = edges::ShellSite {
        local: &local,
        surface: &surface,
        zone: &zone,
        columns: &columns,
        budget: &budget,
        looked: &looked,
    };
    let unsided = std::mem::take(&mut hull.unsided);
    edges::orient_parts(&site, &unsided, &mut hull.reach);

    let mut old_shell = vec![NONE; old.surface];
    let shell = old.surface as u32..(old.surface + old.stats.shell_nodes) as u32;
    shell
        .clone()
        .for_each(|s| old_shell[old.nearest_surface[s as usize] as usize] = s);
    let mut numbers = NodeNumbers::from_change(old, change, points);
    let copies = edges::place_copies(&site, old, change, &hull.reach, &old_shell, &mut numbers)?;
    let edited = EditedShell {
        old,
        change,
        points,
        copies: &copies,
        old_shell: &old_shell,
    };
    let followed = interior::follow_interior(&site, inside, &edited, &mut numbers)?;
    let Some(interior) = followed else {
        return Ok(None);
    };
    exec.check()?;
    let volume = old.stats.enclosed_volume + gained_volume(&between, inside);
    let recipe = GraphRecipe {
        inside: Some(InteriorRecipe {
            reach: hull.reach,
            open: hull.open,
            ..*inside
        }),
        ..old.recipe
    };
    let edit = collect_changes(&edited, &numbers, &local, interior);
    let stats = GraphStats {
        enclosed_volume: volume.max(0.0),
        ..old.stats.clone()
    };
    let (mut resampled, asked) = rows::write_rows(&edit, stats, recipe, exec.pool);
    interior::spread_nearest(&mut resampled.graph, &local, asked);
    Ok(Some(resampled))
}

/// Where the surface changed: faces that came and went, and boxes around those whose points moved.
fn changed_places(
    old: &GraphBefore<'_>,
    change: &MeshChange,
    points: &ChangedPoints,
    hull: &HullChange,
) -> (Vec<[DVec3; 3]>, Vec<BoundingBox>) {
    let (now, before) = (
        |v: u32| change.positions[v as usize],
        |v: u32| old.positions[v as usize],
    );
    let mut faces: Vec<[DVec3; 3]> = change.removed.iter().map(|t| t.map(before)).collect();
    faces.extend(change.added.iter().map(|&t| change.triangles[t as usize].map(now)));
    for ring in &hull.new_loops {
        let (middle, edges) = fan_over_loop(ring, now);
        faces.extend(edges.map(|[a, b]| [now(a), now(b), middle]));
    }
    for ring in &hull.lost_loops {
        let (middle, edges) = fan_over_loop(ring, before);
        faces.extend(edges.map(|[a, b]| [before(a), before(b), middle]));
    }
    let boxes = change.moved.iter().map(|&p| {
        let own = change.old_from_new[p as usize];
        let around = old.row(own).iter().take_while(|&&o| (o as usize) < old.surface);
        let mut star = vec![now(p), before(own)];
        for &o in around {
            star.push(before(o));
            let new = points.new_from_old[o as usize];
            star.extend((new != NONE).then(|| now(new)));
        }
        BoundingBox::of(&star)
    });
    (faces, boxes.collect())
}

/// The graph itself.
fn unchanged_graph(old: &GraphBefore<'_>) -> ResampledGraph {
    let all: Vec<u32> = (0..old.nodes() as u32).collect();
    ResampledGraph {
        graph: MeshGraph {
            positions: old.positions.to_vec(),
            ..old.graph.clone()
        },
        new_from_old: all.clone(),
        old_from_new: all,
        touched: Vec::new(),
    }
}

/// The volume that an edit adds, from the closed surface between before and after.
fn gained_volume(between: &LocalFaces, inside: &InteriorRecipe) -> f64 {
    let turn = inside
        .reach
        .iter()
        .find(|r| **r != 0.0)
        .map_or(1.0, |r| f64::from(r.signum()));
    signed_volume(&between.positions, &between.triangles) * turn
}

/// Collects what changes.
fn collect_changes<'a>(
    edited: &EditedShell<'a>,
    numbers: &'a NodeNumbers,
    local: &LocalMesh,
    interior: InteriorChange,
) -> GraphEdit<'a> {
    let EditedShell {
        old,
        change,
        points,
        copies,
        old_shell,
    } = *edited;
    let name = |v: u32| numbers.point_number(change, local.points[v as usize]);
    let mut links = copies.find_links(local, name, old.recipe.cotangents);
    links.extend_from_slice(&interior.links);
    let mut gone = points.gone.clone();
    gone.extend(
        points
            .gone
            .iter()
            .map(|&o| old_shell[o as usize])
            .filter(|&s| s != NONE),
    );
    gone.extend_from_slice(&copies.lost);
    gone.extend_from_slice(&interior.gone);
    gone.sort_unstable();
    let mut outer = Vec::new();
    for v in copies.refound_vertices() {
        let o = change.old_from_new[local.points[v as usize] as usize];
        if o != NONE {
            outer.push(o);
            outer.extend(Some(old_shell[o as usize]).filter(|&s| s != NONE));
        }
    }
    let shells = numbers.old + numbers.points;
    let lattice = shells + numbers.shells;
    let mut placed = copies.moved.clone();
    placed.extend((shells..).zip(&copies.born).map(|(s, b)| (s, b.1)));
    placed.extend((lattice..).zip(&interior.born).map(|(n, &p)| (n, p)));
    let mut nearest = interior.nearest;
    nearest.extend((shells..).zip(&copies.born).map(|(s, b)| (s, b.0)));
    GraphEdit {
        old,
        change,
        points,
        numbers,
        gone,
        outer,
        lattice: interior.again,
        untied: interior.retied,
        links,
        placed,
        nearest,
    }
}
