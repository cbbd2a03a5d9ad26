//! The interior that follows the shape: a lattice as wide as parts are thick, whatever their triangles.
//!
//! A uniform lattice of interval a and weight w is an energy of the volume of weight w ÷ a. Weights are in proportion to the
//! interval, so that this is a constant of each part, and its volume is as stiff beside its surface whatever the interval.
//!
//! The inner shell: a copy of each vertex moved inwards, wherever there is room inside (Zhou et al. 2005).
//!
//! A copy is accepted only where it lies inside, at least half its offset away from the whole surface, and reached from
//! its vertex without crossing the surface; the offset is halved up to six times until that holds. A vertex without
//! such a place has no copy.

use crate::exec::Exec;
use crate::graph::assemble::InteriorNodes;
use crate::graph::error::Error;
use crate::graph::mesh_graph::{GraphStats, MeshGraph};
use crate::graph::parallel::map;
use crate::graph::volume::lattice;
use crate::graph::volume::lattice::LatticeBody;
use crate::graph::volume::neighbours::{NONE, NearSurface, RoomQueries, nearest_vertices};
use crate::graph::volume::options::VolumeOptions;
use crate::graph::volume::placing::{NodeRoom, SiteFacts, enclosed_volume, fitting_lattice, join_nodes, sort_rows};
use crate::graph::volume::scan::FaceColumns;
use crate::graph::volume::solid::ClassifiedParts;
use crate::graph::volume::spread::{SurfaceTie, spread_ties, vertex_areas};
use crate::graph::volume::spread::{ThinPlaces, struts};
use crate::graph::volume::thickness::{HullFaces, LatticeClass, lattice_classes};
use crate::graph::winding::tree::WindingTree;
use crate::mesh::query::{VisitBudget, VisitCount};
use crate::mesh::{Adjacency, Mesh};
use crate::pool::Pool;
use glam::DVec3;

/// The interval in thicknesses (volume ÷ area): a long round bar has more than five cells across.
const INTERVAL: f64 = 0.75;
/// Lattice nodes lie deeper than this many intervals.
const DEPTH: f64 = 0.6;
/// What an edge of the lattice weighs that is as long as the part is thick; edges of the surface weigh 1.
const STIFFNESS: f64 = 3.0;
/// What a tie weighs beside an edge of the lattice.
const TIE: f64 = 0.3;
/// Struts are no longer than this many intervals.
const ACROSS: f64 = 4.0;
/// About the part of a volume that lies deep enough for lattice nodes.
const DEEP: f64 = 0.7;

/// Lattice nodes for each vertex that a coarse mesh has at most, and that any mesh may have.
const MOST_PER_VERTEX: [f64; 2] = [3.0, 0.2];
/// Meshes between the two have at most so many.
const PLENTY: f64 = 8400.0;

/// The most lattice nodes that a mesh with so many vertices gets; no fewer for more vertices.
pub(in crate::graph) fn most_lattice_nodes(vertices: usize) -> f64 {
    let [coarse, any] = MOST_PER_VERTEX.map(|share| share * vertices as f64);
    coarse.min(PLENTY.max(any))
}

/// A lattice and its nodes, joined.
#[derive(Default)]
struct JoinedLattices {
    inner: InteriorNodes,
    ties: Vec<SurfaceTie>,
    /// By class.
    intervals: Vec<f64>,
    stats: GraphStats,
}

/// Places a lattice in each part, and struts where a part is too thin for it.
pub(in crate::graph) fn shape_interior(
    site: &VolumeSite,
    facts: SiteFacts,
    options: &VolumeOptions,
    room: &NodeRoom,
) -> Result<Option<MeshGraph>, Error> {
    let surface = site.mesh.positions.len();
    site.exec.progress.report("graph", 0.2);
    let volume = enclosed_volume(site)?;
    let parts = lattice_classes(site, &facts, volume.by_soups);
    let mut vertices = vec![0usize; parts.classes.len()];
    for &part in &site.parts.components.of_vertex {
        if let Some(class) = parts.of_part[part as usize] {
            vertices[class] += 1;
        }
    }
    let intervals = wanted_intervals(&parts.classes, &vertices, options);
    let mut lattices = JoinedLattices::default();
    for ((class, wanted), &vertices) in parts.classes.iter().zip(intervals).zip(&vertices) {
        let left = room.beyond(surface + lattices.inner.positions.len())?;
        let most = match options.interval {
            None => most_lattice_nodes(vertices) as usize,
            Some(_) => usize::MAX,
        };
        let interval = lattices.add_class(site, class, wanted, options, left.min(most))?;
        // Warnings name the lattice that lack of room widened most.
        let stats = &mut lattices.stats;
        let widened = |interval: f64, wanted: f64| if wanted > 0.0 { interval / wanted } else { 0.0 };
        let wanted = if left < most { wanted } else { interval };
        if widened(interval, wanted) > widened(stats.interval, stats.wanted_interval) {
            stats.interval = interval;
            stats.wanted_interval = wanted;
        }
    }
    let areas = vertex_areas(site);
    let spread = spread_ties(site, &lattices.ties, &lattices.inner.positions, &areas)?;
    site.exec.progress.report("graph", 0.6);
    let reach: Vec<f64> = parts
        .of_part
        .iter()
        .map(|class| class.map_or(0.0, |c| ACROSS * lattices.intervals[c]))
        .collect();
    let vertices = (0..surface as u32).filter(|&v| !spread.reached[v as usize]);
    let thin = ThinPlaces {
        vertices: vertices.collect(),
        inward: &facts.inward,
        reach: &reach,
        areas: &areas,
    };
    let JoinedLattices { mut inner, stats, .. } = lattices;
    inner.struts = struts(site, &thin)?;
    inner.ties = spread.ties;
    inner.tie_weights = spread.weights;
    if inner.positions.is_empty() && inner.struts.is_empty() {
        return Ok(None);
    }
    inner.stats = GraphStats {
        lattice_nodes: inner.lattice.len(),
        struts: inner.struts.len(),
        enclosed_volume: volume.whole,
        ..stats
    };
    join_nodes(site, inner, options).map(Some)
}

/// The interval of each class: what its thickness asks for, wider where it would get too many nodes for its `vertices`, or the mesh
/// for its own.
fn wanted_intervals(classes: &[LatticeClass], vertices: &[usize], options: &VolumeOptions) -> Vec<f64> {
    if let Some(interval) = options.interval {
        return vec![interval; classes.len()];
    }
    let wanted = classes.iter().zip(vertices).map(|(class, &vertices)| {
        let interval = INTERVAL * class.thickness;
        let count = 2.0 * DEEP * class.volume / (interval * interval * interval);
        count.min(most_lattice_nodes(vertices))
    });
    let wanted: Vec<f64> = wanted.collect();
    let mut counts = wanted.clone();
    counts.sort_by(f64::total_cmp);
    // The classes with the most nodes share what the others leave.
    let (mut left, mut most) = (most_lattice_nodes(vertices.iter().sum()), f64::INFINITY);
    for (k, &own) in counts.iter().enumerate() {
        let share = left / (counts.len() - k) as f64;
        if own > share {
            most = share;
            break;
        }
        left -= own;
    }
    let interval = |(c, wanted): (&LatticeClass, &f64)| {
        (INTERVAL * c.thickness).max(libm::cbrt(2.0 * DEEP * c.volume / wanted.min(most)))
    };
    classes.iter().zip(&wanted).map(interval).collect()
}

impl JoinedLattices {
    /// Adds the lattice of a class, of at most `room` nodes; its interval.
    fn add_class(
        &mut self,
        site: &VolumeSite,
        class: &LatticeClass,
        wanted: f64,
        options: &VolumeOptions,
        room: usize,
    ) -> Result<f64, Error> {
        let body = LatticeBody {
            hull: site.hull.filter(|_| !class.faces.is_empty()).map(|hull| HullFaces {
                faces: if class.faces.len() == hull.faces.len() {
                    hull.faces
                } else {
                    &class.faces
                },
                ..hull
            }),
            soup: site.large_soup().filter(|_| class.soup),
            bounds: class.bounds,
        };
        let deep = |interval: f64| DEPTH * interval;
        let (grid, nodes) = fitting_lattice(site, body, wanted, deep, [class.volume, room as f64])?;
        let mut edges = lattice::edges(site, &grid, &nodes, options.valence)?;
        let inner = &mut self.inner;
        inner
            .nearest_surface
            .extend(nearest_vertices(site, &grid, &nodes, &edges)?);
        let first = inner.positions.len() as u32;
        inner.positions.extend(nodes.keys.iter().map(|&k| grid.position(k)));
        sort_rows(&mut edges.rows, &nodes.keys, site.exec.pool);
        for row in &mut edges.rows {
            row.iter_mut().filter(|n| **n != NONE).for_each(|n| *n += first);
        }
        inner.lattice.append(&mut edges.rows);
        // A lattice without edges along the axes has half the energy.
        let share = if options.valence == 8 { 2.0 } else { 1.0 };
        let weight = STIFFNESS * share * grid.interval / class.thickness;
        inner.lattice_weights.resize(inner.positions.len(), weight as f32);
        self.intervals.push(grid.interval);
        self.ties.extend(edges.exits.into_iter().map(|mut exit| {
            exit.node += first;
            SurfaceTie {
                exit,
                weight: TIE * weight,
                interval: grid.interval,
            }
        }));
        Ok(grid.interval)
    }
}

/// How often the offset may be halved.
const HALVINGS: i32 = 6;

/// For each vertex its copy, or `None`.
pub(in crate::graph) type ShellNodes = Vec<Option<DVec3>>;

/// What shell and lattice are built from.
pub(in crate::graph) struct VolumeSite<'a> {
    pub(in crate::graph) mesh: &'a Mesh,
    pub(in crate::graph) adjacency: &'a Adjacency,
    /// The whole surface, for distances and crossings.
    pub(in crate::graph) surface: &'a NearSurface<'a>,
    pub(in crate::graph) parts: &'a ClassifiedParts,
    /// Closed parts and those whose holes have been closed, if there are any.
    pub(in crate::graph) hull: Option<HullFaces<'a>>,
    /// The same, to test what lies inside.
    pub(in crate::graph) inside_hull: &'a InsideHull<'a>,
    /// Soups that enclose space, if there are any.
    pub(in crate::graph) soup: Option<&'a WindingTree<'a>>,
    pub(in crate::graph) exec: &'a Exec<'a>,
    /// What queries may look at in all.
    pub(in crate::graph) budget: &'a VisitBudget<'a>,
    /// What is looked at without asking any structure.
    pub(in crate::graph) looked: &'a VisitCount,
}

/// What decides whether a place is inside a hull.
pub(in crate::graph) enum InsideHull<'a> {
    /// There is no hull.
    Nothing,
    Columns(Box<FaceColumns<'a>>),
    Tree(&'a WindingTree<'a>),
}

impl<'a> InsideHull<'a> {
    /// Sorts the faces of a hull into columns; where these are of no help, the `tree` over the same faces is asked.
    pub(in crate::graph) fn of_faces(
        hull: Option<HullFaces<'a>>,
        tree: impl FnOnce() -> &'a WindingTree<'a>,
        pool: &Pool,
    ) -> Self {
        let Some(hull) = hull else {
            return Self::Nothing;
        };
        match FaceColumns::sort(hull.positions, hull.faces, pool) {
            Some(columns) => Self::Columns(Box::new(columns)),
            None => Self::Tree(tree()),
        }
    }

    /// What long queries of the columns have looked at; a tree counts for itself.
    pub(in crate::graph) fn visits(&self) -> u64 {
        match self {
            Self::Columns(columns) => columns.visits(),
            Self::Nothing | Self::Tree(_) => 0,
        }
    }
}

impl VolumeSite<'_> {
    /// The vertex where a walk along the mesh from `start` comes no nearer to `p`.
    pub(in crate::graph) fn walk(&self, start: u32, p: DVec3) -> u32 {
        walk(&self.mesh.positions, self.adjacency, start, p, self.looked)
    }

    /// Soups that are worth a lattice; beside a hull of many more faces they have a shell only.
    pub(in crate::graph) fn large_soup(&self) -> Option<&WindingTree<'_>> {
        let is_large = |soup: &&WindingTree| {
            let faces = soup.bvh().triangles().len();
            self.hull.is_none_or(|hull| faces >= hull.faces.len() / 4)
        };
        self.soup.filter(is_large)
    }

    /// Lists all vertices, so that those next to each other in the list are close in space, and their columns are the same.
    pub(in crate::graph) fn vertices_in_space_order(&self) -> Vec<u32> {
        let InsideHull::Columns(columns) = self.inside_hull else {
            return self.surface.vertices_in_space_order();
        };
        // A hull may have more vertices than the mesh, or lack some.
        let mut order = columns.vertices_in_space_order();
        let count = self.mesh.positions.len();
        order.retain(|&v| (v as usize) < count);
        if order.len() < count {
            let mut seen = vec![false; count];
            order.iter().for_each(|&v| seen[v as usize] = true);
            order.extend((0..count as u32).filter(|&v| !seen[v as usize]));
        }
        order
    }

    /// Whether a place lies inside the hull, or inside soups.
    pub(in crate::graph) fn contains(&self, p: DVec3) -> bool {
        let in_hull = match self.inside_hull {
            InsideHull::Nothing => false,
            InsideHull::Columns(columns) => columns.contains(p),
            InsideHull::Tree(tree) => tree.contains(p),
        };
        in_hull || self.soup.is_some_and(|soup| soup.contains(p))
    }
}

/// Moves each vertex along its `inward` direction by the offset of its part, or by less where there is less room;
/// vertices whose direction is zero have no copy. `order` has all vertices in the order in which they are best looked at.
pub(in crate::graph) fn shell(
    site: &VolumeSite,
    order: Vec<u32>,
    inward: &[DVec3],
    offsets: &[f64],
) -> Result<ShellNodes, Error> {
    let mut placed: ShellNodes = vec![None; site.mesh.positions.len()];
    // In the order of space, so that one query finds in the cache what the last one read.
    let mut waiting = order;
    waiting.retain(|&v| inward[v as usize] != DVec3::ZERO);
    let found = map(&waiting, site.budget, |&v| {
        let offset = offsets[site.parts.components.of_vertex[v as usize] as usize];
        let p = site.mesh.positions[v as usize];
        copy(site.surface, v, p, inward[v as usize], offset, |p| site.contains(p))
    })?;
    for (v, copy) in waiting.into_iter().zip(found) {
        placed[v as usize] = copy;
    }
    Ok(placed)
}

/// Where the copy of vertex `v`, at `p`, is put: `offset` along `inward`, or less where there is less room.
pub(in crate::graph) fn copy(
    surface: &impl RoomQueries,
    v: u32,
    p: DVec3,
    inward: DVec3,
    offset: f64,
    contains: impl Fn(DVec3) -> bool,
) -> Option<DVec3> {
    let at = |by: f64| p + inward * by;
    let mut by = offset;
    for halving in 0..=HALVINGS {
        if has_room(surface, v, at(0.0), at(0.5 * by), at(by), 0.5 * by) && contains(at(by)) {
            return Some(at(by));
        }
        // Where not even the smallest offset leads inside, those between need not be tried.
        let smallest = offset * 0.5f64.powi(HALVINGS);
        if halving == 0 && !contains(at(smallest)) {
            return None;
        }
        by *= 0.5;
    }
    None
}

/// Whether no face is nearer to `end` than `half`, and none but those around vertex `v` crosses the way from `start` to
/// `middle`; only this half of the way, outside the clear ball, can meet the surface.
pub(in crate::graph) fn has_room(
    surface: &impl RoomQueries,
    v: u32,
    start: DVec3,
    middle: DVec3,
    end: DVec3,
    half: f64,
) -> bool {
    !surface.has_face_within(end, half) && !surface.is_way_crossed(start, middle, Some(v))
}

/// The vertex where a walk along the mesh from `start` comes no nearer to `p`.
pub(in crate::graph) fn walk(
    positions: &[DVec3],
    adjacency: &Adjacency,
    start: u32,
    p: DVec3,
    looked: &VisitCount,
) -> u32 {
    let distance = |v: u32| positions[v as usize].distance_squared(p);
    let nearer = |a: u32, b: u32| if distance(b) < distance(a) { b } else { a };
    let mut here = start;
    loop {
        let around = adjacency.neighbours.of(here);
        looked.add(around.len() as u64);
        let next = around.iter().copied().fold(here, nearer);
        if next == here {
            return here;
        }
        here = next;
    }
}
