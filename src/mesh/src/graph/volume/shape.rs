//! The interior that follows the shape: a lattice as wide as parts are thick, whatever their triangles.
//!
//! A uniform lattice of interval a and weight w is an energy of the volume of weight w ÷ a. Weights are in proportion to the
//! interval, so that this is a constant of each part, and its volume is as stiff beside its surface whatever the interval.
//!
//! How thick parts are, and how wide the lattice inside of each is to be.
//!
//! The thickness of a part is its volume divided by its area, which says nothing of its triangles. Parts of about one thickness
//! share a lattice, and thinner ones have a finer one.

use crate::graph::assemble::InteriorNodes;
use crate::graph::mesh_graph::{GraphStats, MeshGraph};
use crate::graph::volume::VolumeOptions;
use crate::graph::volume::caps::HullFaces;
use crate::graph::volume::lattice::{self, LatticeBody};
use crate::graph::volume::lattice_grid::NONE;
use crate::graph::volume::placing::{
    NodeRoom, SiteFacts, enclosed_volume, fitting_lattice, join_nodes, nearest_vertices, sort_rows,
};
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::solid::PartKind;
use crate::graph::volume::spread::{SurfaceTie, ThinPlaces, spread_ties, struts, vertex_areas};
use crate::{BoundingBox, Error};
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
    let JoinedLattices {
        mut inner,
        stats,
        intervals,
        ..
    } = lattices;
    inner.struts = struts(site, &thin)?;
    let stiffness = options.stiffness as f32;
    inner.struts.iter_mut().for_each(|(_, weight)| *weight *= stiffness);
    inner.ties = spread.ties;
    inner.tie_weights = spread.weights;
    if inner.positions.is_empty() && inner.struts.is_empty() {
        return Ok(None);
    }
    let smallest = intervals.iter().copied().reduce(f64::min);
    inner.recipe.shape_interval = smallest.filter(|_| options.follows_edits);
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
        let weight = STIFFNESS * options.stiffness * share * grid.interval / class.thickness;
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

/// Parts whose thickness differs by less than this factor share a lattice.
const ALIKE: f64 = 2.0;
/// Parts thinner than this share of the largest one are taken for as thick: lattices of more sizes cost more than they are worth.
const THINNEST: i32 = 8;

/// Hollows look for their solids among so many, the largest ones.
const MOST_SOLIDS: usize = 256;

/// Parts that share a lattice.
struct LatticeClass {
    /// Volume ÷ area.
    pub(in crate::graph) thickness: f64,
    pub(in crate::graph) volume: f64,
    /// The faces of closed parts and those whose holes have been closed.
    pub(in crate::graph) faces: Vec<[u32; 3]>,
    /// Whether soups belong to it.
    pub(in crate::graph) soup: bool,
    /// The box around all.
    pub(in crate::graph) bounds: BoundingBox,
}

/// Parts that belong together: a solid and its hollows.
#[derive(Clone, Copy, Default)]
struct MeasuredBody {
    volume: f64,
    area: f64,
}

impl MeasuredBody {
    fn thickness(&self) -> f64 {
        if self.volume > 0.0 && self.area > 0.0 {
            self.volume / self.area
        } else {
            0.0
        }
    }
}

/// How parts share lattices.
#[derive(Default)]
struct PartClasses {
    pub(in crate::graph) classes: Vec<LatticeClass>,
    /// For each part the number of its class.
    pub(in crate::graph) of_part: Vec<Option<usize>>,
}

/// The classes of all parts that enclose space, from that of the part with the most volume to thinner and to thicker ones.
/// `soup_volume` is what soups enclose.
fn lattice_classes(site: &VolumeSite, facts: &SiteFacts, soup_volume: f64) -> PartClasses {
    let turns = &facts.turns;
    let count = site.parts.components.count;
    let mut bodies = vec![MeasuredBody::default(); count + 1];
    let part = |t: &[u32; 3]| site.parts.components.of_vertex[t[0] as usize] as usize;
    let mut measured = vec![MeasuredBody::default(); count];
    let nothing = BoundingBox {
        min: DVec3::INFINITY,
        max: DVec3::NEG_INFINITY,
    };
    let mut boxes = vec![nothing; count];
    let hull = site.hull.unwrap_or(HullFaces {
        positions: &[],
        faces: &[],
    });
    for t in hull.faces {
        let [a, b, c] = t.map(|v| hull.positions[v as usize]);
        let middle = hull.positions[hull.faces[0][0] as usize];
        let own = &mut measured[part(t)];
        own.area += 0.5 * (b - a).cross(c - a).length();
        own.volume += (a - middle).cross(b - middle).dot(c - middle) / 6.0 * turns[part(t)];
        let around = &mut boxes[part(t)];
        *around = [a, b, c].into_iter().fold(*around, widened);
    }
    let body_of = solids_of_hollows(&measured, &boxes);
    for (own, &body) in measured.iter().zip(&body_of) {
        bodies[body].volume += own.volume;
        bodies[body].area += own.area;
    }
    if let Some(soup) = site.large_soup() {
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| site.mesh.positions[v as usize]);
            0.5 * (b - a).cross(c - a).length()
        };
        bodies[count] = MeasuredBody {
            volume: soup_volume,
            // Soups are no thinner than their faces are long: more area than that lies inside of them.
            area: (soup.bvh().triangles().iter().map(area).sum::<f64>()).min(soup_volume / facts.mean_edge),
        };
    }
    let largest = bodies
        .iter()
        .copied()
        .reduce(|a, b| if b.volume > a.volume { b } else { a });
    let whole = largest.map_or(0.0, |b| b.thickness());
    if whole == 0.0 {
        return PartClasses {
            classes: Vec::new(),
            of_part: vec![None; count],
        };
    }
    let step = |body: &MeasuredBody| match body.thickness() {
        0.0 => 0,
        own => (libm::log2(whole / own) / libm::log2(ALIKE))
            .round()
            .clamp(-f64::from(THINNEST), f64::from(THINNEST)) as i32,
    };
    let mut steps: Vec<i32> = bodies.iter().filter(|b| b.area > 0.0).map(step).collect();
    steps.sort_unstable_by_key(|s| (s.abs(), *s));
    steps.dedup();
    let class = |&wanted: &i32| {
        let own = |body: usize| bodies[body].area > 0.0 && step(&bodies[body]) == wanted;
        let faces: Vec<[u32; 3]> = hull.faces.iter().filter(|t| own(body_of[part(t)])).copied().collect();
        let soup = site.large_soup().filter(|_| own(count));
        let in_soup = soup.iter().flat_map(|s| s.bvh().triangles()).flatten();
        let corners = faces.iter().flatten().map(|&v| hull.positions[v as usize]);
        let corners = corners.chain(in_soup.map(|&v| site.mesh.positions[v as usize]));
        LatticeClass {
            thickness: whole / libm::exp2(f64::from(wanted) * libm::log2(ALIKE)),
            volume: (0..=count).filter(|&b| own(b)).map(|b| bodies[b].volume.max(0.0)).sum(),
            soup: soup.is_some(),
            bounds: corners.fold(nothing, widened),
            faces,
        }
    };
    let body = |part: usize| match site.parts.kinds[part] {
        PartKind::Closed | PartKind::Holed => Some(body_of[part]),
        PartKind::Soup => Some(count),
        PartKind::Sheet => None,
    };
    let number = |part: usize| {
        let own = step(&bodies[body(part)?]);
        steps.iter().position(|s| *s == own)
    };
    PartClasses {
        classes: steps.iter().map(class).collect(),
        of_part: (0..count).map(number).collect(),
    }
}

fn widened(around: BoundingBox, p: DVec3) -> BoundingBox {
    BoundingBox {
        min: around.min.min(p),
        max: around.max.max(p),
    }
}

/// For each part the one that it belongs to: a hollow, whose normals lead out of it, to the smallest solid around it; any other to
/// itself.
fn solids_of_hollows(measured: &[MeasuredBody], boxes: &[BoundingBox]) -> Vec<usize> {
    let mut solids: Vec<usize> = (0..measured.len()).filter(|&p| measured[p].volume > 0.0).collect();
    solids.sort_by(|&a, &b| measured[b].volume.total_cmp(&measured[a].volume).then(a.cmp(&b)));
    solids.truncate(MOST_SOLIDS);
    let of = |part: usize| {
        let holds = |&&solid: &&usize| {
            let (outer, inner) = (&boxes[solid], &boxes[part]);
            outer.min.cmple(inner.min).all() && outer.max.cmpge(inner.max).all()
        };
        let is_hollow = measured[part].volume < 0.0;
        let around = is_hollow.then(|| solids.iter().rev().find(holds)).flatten();
        around.copied().unwrap_or(part)
    };
    (0..measured.len()).map(of).collect()
}
