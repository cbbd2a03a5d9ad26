//! The graph of an edited mesh from the graph before: only what the edit reaches is sampled again.
//!
//! Vertices follow the mesh. Copies of vertices whose faces are as they were stay where they are, as long as they have
//! room there. Lattice nodes stay unless they are outside now, or too near to a new face; places of the grid that became
//! deep enough inside get nodes. What lies inside is told as for a new graph, by the faces beyond a place along one axis.
//! All rows that no changed face is near to are copied, with nodes renumbered.
//!
//! Nodes may have been moved since they were placed, as by a deformation that has become the rest shape. Moved lattice
//! nodes keep their edges to each other, and new ones fill the gaps between them on the grid of old.

mod components;
mod edges;
mod grid;
mod hull;
mod interior;
mod local;
mod places;
mod renumber;
mod rows;
mod zone;

use super::recipe::{Inside, Recipe};
use super::{Error, Graph, Stats};
use crate::exec::Exec;
use crate::mesh::query::TriangleBvh;
use crate::mesh::{Bounds, NONE, signed_volume};
use crate::pool::Pool;
use glam::DVec3;
use hull::{Hull, fan};
use interior::Interior;
use local::{Faces, Local};
use zone::{Spread, Zone};

/// An edit of a mesh, from the solver vertices (points) and triangles before to those after.
///
/// Old points that are left keep their order and come first; new ones follow.
#[derive(Debug, Clone, Copy)]
pub struct Change<'a> {
    /// All points after the edit.
    pub positions: &'a [DVec3],
    /// All triangles after the edit, over these points.
    pub triangles: &'a [[u32; 3]],
    /// For each point its number before the edit, rising; [`NONE`] from the first new one on.
    pub old_from_new: &'a [u32],
    /// Triangles that are gone, over the points before the edit.
    pub removed: &'a [[u32; 3]],
    /// Triangles that are new, by number, rising.
    pub added: &'a [u32],
    /// Old points with a new position, by new number, rising.
    pub moved: &'a [u32],
}

/// A graph after an edit, and which of its nodes are which.
#[derive(Debug, Clone, PartialEq)]
pub struct Resampled {
    /// The graph of the mesh after the edit.
    pub graph: Graph,
    /// For each old node its number now, or [`NONE`]. Of each kind (surface, shell, lattice) old nodes keep their order,
    /// and new ones follow them.
    pub new_from_old: Vec<u32>,
    /// For each node its number before, or [`NONE`].
    pub old_from_new: Vec<u32>,
    /// Nodes that are new, or whose position, neighbours or weights changed; rising.
    pub touched: Vec<u32>,
}

/// The graph before an edit, with its nodes where they are by now.
#[derive(Clone, Copy)]
struct Before<'a> {
    graph: &'a Graph,
    /// Hides those of the graph.
    positions: &'a [DVec3],
}

impl std::ops::Deref for Before<'_> {
    type Target = Graph;

    fn deref(&self) -> &Graph {
        self.graph
    }
}

/// An edit that changes more points than this part of them is for a new graph.
const MOST_CHANGED: f64 = 0.25;

/// Which points an edit changes.
struct Points {
    /// How many old points are left.
    kept: usize,
    new_from_old: Vec<u32>,
    /// Old points that are gone, rising.
    gone: Vec<u32>,
    /// By new number: whether an old point has a new place.
    moved: Vec<bool>,
    /// New numbers of points that are new, moved, or have a face that is new, gone or of another shape; rising.
    fans: Vec<u32>,
}

/// Numbers of nodes while an edit is followed: old nodes have their own; new ones are numbered on from there, points,
/// then shell nodes, then lattice nodes.
struct Numbers {
    old: u32,
    points: u32,
    shells: u32,
    lattice: u32,
}

impl Numbers {
    /// A new shell node.
    fn shell(&mut self) -> u32 {
        self.shells += 1;
        self.old + self.points + self.shells - 1
    }

    /// A new lattice node; no shell nodes may follow.
    fn lattice(&mut self) -> u32 {
        self.lattice += 1;
        self.old + self.points + self.shells + self.lattice - 1
    }
}

/// An edge between two nodes, numbered as in [`Numbers`].
#[derive(Debug, Clone, Copy)]
struct Link {
    ends: [u32; 2],
    weight: f32,
}

impl Link {
    fn new(a: u32, b: u32) -> Self {
        Self {
            ends: [a, b],
            weight: 1.0,
        }
    }
}

/// The graph after `change` from the graph before; `None` where a new graph has to be built: when the edit changes more than a
/// quarter of the points, opens a part widely, joins what encloses space with what does not, or touches a mesh so torn
/// that all of it is needed to tell what lies inside.
///
/// Parts that were surfaces only stay so. `positions` has all nodes of `old` where they are by now: at rest as it was built, or
/// as a deformation left them; points that `change` does not name must lie there. Edges keep their weights but where faces
/// changed. Flat passes over all nodes, edges and triangles, and work in proportion to the edit.
///
/// # Errors
/// [`Error::Cancelled`].
///
/// # Panics
/// When numbers in `change` are out of range, or `positions` is not as long as the graph.
pub fn resample(
    old: &Graph,
    positions: &[DVec3],
    change: &Change,
    exec: &Exec<'_>,
) -> Result<Option<Resampled>, Error> {
    exec.check()?;
    assert_eq!(positions.len(), old.nodes(), "a position for every node");
    let old = &Before { graph: old, positions };
    let Some(points) = Points::of(old, change) else {
        return Ok(None);
    };
    match &old.recipe.inside {
        // The graph of parts that are told apart does not know how each was made.
        None if old.surface < old.nodes() => Ok(None),
        None => surface(old, change, &points, exec.pool).map(Some),
        Some(inside) if inside.soups => Ok(None),
        Some(inside) => volume(old, inside, change, &points, exec),
    }
}

impl Points {
    /// `None` when the numbers do not fit together, or too much changed.
    fn of(old: &Before<'_>, change: &Change) -> Option<Self> {
        let kept = change.old_from_new.partition_point(|&o| o != NONE);
        let mut new_from_old = vec![NONE; old.surface];
        for (new, &o) in (0u32..).zip(&change.old_from_new[..kept]) {
            new_from_old[o as usize] = new;
        }
        let gone: Vec<u32> = (0u32..)
            .zip(&new_from_old)
            .filter(|n| *n.1 == NONE)
            .map(|n| n.0)
            .collect();
        if change.old_from_new.len() != change.positions.len()
            || !change.old_from_new[..kept].is_sorted()
            || old.surface - gone.len() != kept
        {
            return None;
        }
        let mut fans: Vec<u32> = (kept as u32..change.positions.len() as u32).collect();
        let added = change.added.iter().flat_map(|&t| change.triangles[t as usize]);
        fans.extend(added);
        let removed = change.removed.iter().flatten().map(|&o| new_from_old[o as usize]);
        fans.extend(removed.filter(|&n| n != NONE));
        let mut moved = vec![false; change.positions.len()];
        for &p in change.moved {
            moved[p as usize] = true;
            fans.push(p);
            let around = old.row(change.old_from_new[p as usize]).iter();
            let around = around.take_while(|&&o| (o as usize) < old.surface);
            fans.extend(around.map(|&o| new_from_old[o as usize]).filter(|&n| n != NONE));
        }
        fans.sort_unstable();
        fans.dedup();
        let most = MOST_CHANGED * old.surface.max(change.positions.len()) as f64;
        let changed = fans.len().max(gone.len());
        (changed as f64 <= most).then_some(Self {
            kept,
            new_from_old,
            gone,
            moved,
            fans,
        })
    }
}

/// Follows an edit of a mesh without interior nodes.
fn surface(old: &Before<'_>, change: &Change, points: &Points, pool: &Pool) -> Result<Resampled, Error> {
    let found = local::find(change, points, None, pool);
    let local = Local::gather(change, points, &found, None, pool);
    let numbers = Numbers::of(old, change, points);
    let copies = places::bare(&local);
    let name = |v: u32| numbers.point(change, local.points[v as usize]);
    let links = copies.links(&local, name, old.recipe.cotangent_scale);
    let edit = rows::Edit {
        old,
        change,
        points,
        numbers: &numbers,
        gone: points.gone.clone(),
        outer: copies
            .again()
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
    Ok(rows::write(&edit, stats, old.recipe.clone(), pool).0)
}

impl Numbers {
    fn of(old: &Before<'_>, change: &Change, points: &Points) -> Self {
        Self {
            old: old.nodes() as u32,
            points: (change.positions.len() - points.kept) as u32,
            shells: 0,
            lattice: 0,
        }
    }

    /// The number of a point.
    fn point(&self, change: &Change, new: u32) -> u32 {
        match change.old_from_new[new as usize] {
            NONE => self.old + new - (change.positions.len() as u32 - self.points),
            o => o,
        }
    }
}

/// Follows an edit of a mesh with interior nodes.
fn volume(
    old: &Before<'_>,
    inside: &Inside,
    change: &Change,
    points: &Points,
    exec: &Exec<'_>,
) -> Result<Option<Resampled>, Error> {
    let Some(mut hull) = hull::follow(old, inside, change, points, exec.pool) else {
        return Ok(None);
    };
    let spread = Spread {
        near: inside.depth,
        core: inside.depth + 1.05 * inside.interval,
        rim: inside.depth + 1.05 * inside.interval,
    };
    let (faces, boxes) = changed_places(old, change, points, &hull);
    let Some(mut zone) = Zone::around(&faces, &boxes, inside.origin, inside.interval, &spread) else {
        // Without any change the graph is as it was; where changes lie too far apart, it is built anew.
        let none = faces.is_empty() && boxes.is_empty() && points.gone.is_empty() && points.fans.is_empty();
        return Ok(none.then(|| unchanged(old)));
    };
    let found = local::find(change, points, Some(&zone), exec.pool);
    exec.check()?;
    let between = Faces::between(old, change, points, &hull, &found);
    let enclosed = between.columns(0, exec.pool);
    zone.fill(&spread, |p| enclosed.contains(p));
    let local = Local::gather(change, points, &found, Some(&zone), exec.pool);
    let surface = TriangleBvh::build(&local.positions, &local.triangles, exec.pool);
    let around = Faces::around(change, &hull, &found);
    let columns = around.columns(found.along(), exec.pool);
    let site = places::Site {
        local: &local,
        surface: &surface,
        zone: &zone,
        columns: &columns,
        exec,
    };
    let unsided = std::mem::take(&mut hull.unsided);
    places::sides(&site, &unsided, &mut hull.reach);

    let mut old_shell = vec![NONE; old.surface];
    let shell = old.surface as u32..(old.surface + old.stats.shell_nodes) as u32;
    shell
        .clone()
        .for_each(|s| old_shell[old.nearest_surface[s as usize] as usize] = s);
    let mut numbers = Numbers::of(old, change, points);
    let copies = places::place(&site, old, change, &hull.reach, &old_shell, &mut numbers)?;
    let followed = interior::follow(&site, old, inside, change, points, &copies, &old_shell, &mut numbers)?;
    let Some(interior) = followed else {
        return Ok(None);
    };
    exec.check()?;
    let volume = old.stats.enclosed_volume + gained(&between, inside);
    let recipe = Recipe {
        inside: Some(Inside {
            reach: hull.reach,
            open: hull.open,
            ..*inside
        }),
        ..old.recipe
    };
    let edit = edit(old, change, points, &numbers, &local, &copies, interior, &old_shell);
    let stats = Stats {
        enclosed_volume: volume.max(0.0),
        ..old.stats.clone()
    };
    let (mut resampled, asked) = rows::write(&edit, stats, recipe, exec.pool);
    interior::spread_nearest(&mut resampled.graph, &local, asked);
    Ok(Some(resampled))
}

/// Where the surface changed: faces that came and went, and boxes around those whose points moved.
fn changed_places(old: &Before<'_>, change: &Change, points: &Points, hull: &Hull) -> (Vec<[DVec3; 3]>, Vec<Bounds>) {
    let (now, before) = (
        |v: u32| change.positions[v as usize],
        |v: u32| old.positions[v as usize],
    );
    let mut faces: Vec<[DVec3; 3]> = change.removed.iter().map(|t| t.map(before)).collect();
    faces.extend(change.added.iter().map(|&t| change.triangles[t as usize].map(now)));
    for ring in &hull.new_loops {
        let (middle, edges) = fan(ring, now);
        faces.extend(edges.map(|[a, b]| [now(a), now(b), middle]));
    }
    for ring in &hull.lost_loops {
        let (middle, edges) = fan(ring, before);
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
        Bounds::of(&star)
    });
    (faces, boxes.collect())
}

/// The graph itself.
fn unchanged(old: &Before<'_>) -> Resampled {
    let all: Vec<u32> = (0..old.nodes() as u32).collect();
    Resampled {
        graph: Graph {
            positions: old.positions.to_vec(),
            ..old.graph.clone()
        },
        new_from_old: all.clone(),
        old_from_new: all,
        touched: Vec::new(),
    }
}

/// The volume that an edit adds, from the closed surface between before and after.
fn gained(between: &Faces, inside: &Inside) -> f64 {
    let turn = inside
        .reach
        .iter()
        .find(|r| **r != 0.0)
        .map_or(1.0, |r| f64::from(r.signum()));
    signed_volume(&between.positions, &between.triangles) * turn
}

/// Collects what changes.
fn edit<'a>(
    old: &'a Before<'a>,
    change: &'a Change<'a>,
    points: &'a Points,
    numbers: &'a Numbers,
    local: &Local,
    copies: &places::Copies,
    interior: Interior,
    old_shell: &[u32],
) -> rows::Edit<'a> {
    let name = |v: u32| numbers.point(change, local.points[v as usize]);
    let mut links = copies.links(local, name, old.recipe.cotangent_scale);
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
    for v in copies.again() {
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
    rows::Edit {
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
