//! How thick parts are, and how wide the lattice inside of each is to be.
//!
//! The thickness of a part is its volume divided by its area, which says nothing of its triangles. Parts of about one thickness
//! share a lattice, and thinner ones have a finer one.
//!
//! Faces that close the holes of open parts.
//!
//! What edges lack to be passed equally often both ways runs in loops, for any set of triangles: as much of it ends at a
//! vertex as begins there. A fan from the middle of each loop closes it, and then the winding number is whole
//! everywhere off the surface, which rows can be followed through.
//!
//! Graphs for meshes whose parts touch but do not belong together, such as the halves of a cut.
//!
//! A volume graph of touching parts shares one lattice, which ties them. Here every part gets a graph of its own.

use crate::exec::Exec;
use crate::graph::error::Error;
use crate::graph::mesh_graph::{GraphStats, MeshGraph};
use crate::graph::recipe::GraphRecipe;
use crate::graph::surface::surface;
use crate::graph::volume::build::volume;
use crate::graph::volume::options::VolumeOptions;
use crate::graph::volume::placing::SiteFacts;
use crate::graph::volume::shape::VolumeSite;
use crate::graph::volume::solid::PartKind;
use crate::mesh::{Adjacency, BoundingBox, Components, Mesh, MeshEdge};
use glam::DVec3;

/// Parts whose thickness differs by less than this factor share a lattice.
const ALIKE: f64 = 2.0;
/// Parts thinner than this share of the largest one are taken for as thick: lattices of more sizes cost more than they are worth.
const THINNEST: i32 = 8;

/// Hollows look for their solids among so many, the largest ones.
const MOST_SOLIDS: usize = 256;

/// Parts that share a lattice.
pub(in crate::graph) struct LatticeClass {
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
pub(in crate::graph) struct PartClasses {
    pub(in crate::graph) classes: Vec<LatticeClass>,
    /// For each part the number of its class.
    pub(in crate::graph) of_part: Vec<Option<usize>>,
}

/// The classes of all parts that enclose space, from that of the part with the most volume to thinner and to thicker ones.
/// `soup_volume` is what soups enclose.
pub(in crate::graph) fn lattice_classes(site: &VolumeSite, facts: &SiteFacts, soup_volume: f64) -> PartClasses {
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

/// Positions and faces of a closed surface.
#[derive(Debug, Default)]
pub(in crate::graph) struct ClosedHull {
    /// The mesh's positions, then the middles of loops.
    pub(in crate::graph) positions: Vec<DVec3>,
    pub(in crate::graph) faces: Vec<[u32; 3]>,
    /// For each loop one of its vertices, its length in edges and its middle.
    pub(in crate::graph) loops: Vec<(u32, usize, DVec3)>,
}

/// Positions and faces of a closed surface.
#[derive(Debug, Clone, Copy)]
pub(in crate::graph) struct HullFaces<'a> {
    pub(in crate::graph) positions: &'a [DVec3],
    pub(in crate::graph) faces: &'a [[u32; 3]],
}

impl<'a> HullFaces<'a> {
    /// Those of a mesh that is closed.
    pub(in crate::graph) fn of_mesh(mesh: &'a Mesh) -> Self {
        Self {
            positions: &mesh.positions,
            faces: &mesh.triangles,
        }
    }
}

impl ClosedHull {
    /// Its positions and faces.
    pub(in crate::graph) fn as_faces(&self) -> HullFaces<'_> {
        HullFaces {
            positions: &self.positions,
            faces: &self.faces,
        }
    }

    /// The faces of `triangles` whose vertices `wanted` says, closed by fans.
    pub(in crate::graph) fn close(
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        adjacency: &Adjacency,
        wanted: impl Fn(u32) -> bool,
    ) -> Self {
        let mut hull = Self {
            positions: positions.to_vec(),
            faces: triangles.iter().copied().filter(|t| wanted(t[0])).collect(),
            loops: Vec::new(),
        };
        let mut lacking: Vec<[u32; 2]> = Vec::new();
        for e in adjacency.edges.iter().filter(|e| wanted(e.vertices[0])) {
            lacking.extend(missing(e));
        }
        lacking.sort_unstable();
        for ring in rings(positions.len(), &lacking) {
            let middle = hull.positions.len() as u32;
            let sum: DVec3 = ring.iter().map(|&v| positions[v as usize]).sum();
            hull.positions.push(sum / ring.len() as f64);
            hull.loops.push((ring[0], ring.len(), sum / ring.len() as f64));
            let next = ring.iter().cycle().skip(1);
            hull.faces.extend(ring.iter().zip(next).map(|(&a, &b)| [a, b, middle]));
        }
        hull
    }
}

/// The passages that an edge lacks.
pub(in crate::graph) fn missing(e: &MeshEdge) -> impl Iterator<Item = [u32; 2]> + use<> {
    missing_of(e.vertices, i32::from(e.forward) - i32::from(e.backward))
}

/// The passages that an edge lacks which is passed `more` times more from its first end than from its second.
pub(in crate::graph) fn missing_of([a, b]: [u32; 2], more: i32) -> impl Iterator<Item = [u32; 2]> + use<> {
    let passage = if more > 0 { [b, a] } else { [a, b] };
    (0..more.unsigned_abs()).map(move |_| passage)
}

/// Loops without repeated vertices that use each of the sorted `passages` once.
pub(in crate::graph) fn rings(vertices: usize, passages: &[[u32; 2]]) -> Vec<Vec<u32>> {
    const OFF: u32 = u32::MAX;
    let mut place = vec![OFF; vertices];
    let mut used = vec![false; passages.len()];
    // By vertex: where the first passage from it stands that has not been looked at.
    let mut next = vec![passages.len(); vertices];
    (0..passages.len())
        .rev()
        .for_each(|k| next[passages[k][0] as usize] = k);
    let mut rings = Vec::new();
    for first in 0..passages.len() {
        // Passages from one vertex are used in order, so an unused one is the next from its vertex.
        if used[first] {
            continue;
        }
        let mut path = vec![passages[first][0]];
        place[path[0] as usize] = 0;
        while let Some(&here) = path.last() {
            let out = next[here as usize];
            if passages.get(out).is_none_or(|p| p[0] != here) {
                break;
            }
            next[here as usize] += 1;
            used[out] = true;
            let to = passages[out][1];
            if place[to as usize] == OFF {
                place[to as usize] = path.len() as u32;
                path.push(to);
                continue;
            }
            let ring = path.split_off(place[to as usize] as usize + 1);
            let whole: Vec<u32> = std::iter::once(to).chain(ring).collect();
            whole[1..].iter().for_each(|&v| place[v as usize] = OFF);
            rings.push(whole);
        }
        path.iter().for_each(|&v| place[v as usize] = OFF);
    }
    rings
}

#[cfg(test)]
mod caps_tests {
    use super::*;

    #[test]
    fn any_set_of_triangles_is_closed() {
        // A fan of three around an edge, two that share a corner only, and one wound against its neighbour.
        let faces = [
            [0, 1, 2],
            [0, 1, 3],
            [1, 0, 4],
            [4, 5, 6],
            [7, 8, 9],
            [8, 9, 10],
            [0, 1, 11],
        ];
        let positions: Vec<DVec3> = (0..12)
            .map(|k| DVec3::new(f64::from(k % 3), f64::from(k % 5), f64::from(k)))
            .collect();
        let adjacency = Adjacency::build(positions.len(), &faces);
        let hull = ClosedHull::close(&positions, &faces, &adjacency, |_| true);
        assert_eq!(hull.faces[..faces.len()], faces);
        assert!(Adjacency::build(hull.positions.len(), &hull.faces).is_balanced());
        let some = ClosedHull::close(&positions, &faces, &adjacency, |v| v >= 7);
        assert!(Adjacency::build(some.positions.len(), &some.faces).is_balanced());
        assert_eq!(some.faces[..2], faces[4..6]);
    }

    #[test]
    fn a_square_hole_gets_a_fan_of_four() {
        let corner = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
        let positions: Vec<DVec3> = (0..8).map(corner).collect();
        let quads = [[0, 2, 3, 1], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces: Vec<[u32; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let adjacency = Adjacency::build(8, &faces);
        let hull = ClosedHull::close(&positions, &faces, &adjacency, |_| true);
        assert_eq!((hull.positions.len(), hull.faces.len()), (9, faces.len() + 4));
        assert_eq!(hull.positions[8], DVec3::new(0.5, 0.5, 1.0));
        assert!((crate::mesh::signed_volume(&hull.positions, &hull.faces) - 1.0).abs() < 1e-12);
    }
}

/// As [`volume`], with nothing that ties one connected part of the mesh to another. Parts without an inside have the edges of
/// the mesh; `None` when no part has one.
///
/// # Errors
/// As [`volume`].
pub fn volume_apart(mesh: &Mesh, options: &VolumeOptions, exec: &Exec<'_>) -> Result<Option<MeshGraph>, Error> {
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    if parts.count < 2 {
        return volume(mesh, options, exec);
    }
    let mut graphs = Vec::with_capacity(parts.count);
    let mut any = false;
    for (points, part) in split_parts(mesh, &parts)? {
        let inner = volume(&part, options, exec)?;
        any |= inner.is_some();
        graphs.push((points, inner.unwrap_or_else(|| surface(&part, options.weights))));
    }
    let nodes: usize = graphs.iter().map(|(_, g)| g.nodes()).sum();
    if nodes > options.max_nodes {
        return Err(Error::TooManyNodes {
            nodes,
            limit: options.max_nodes,
            surface: mesh.positions.len(),
        });
    }
    Ok(any.then(|| unite_graphs(mesh, &graphs)))
}

/// Each part as a mesh of its own, with the numbers that its vertices have in the whole.
fn split_parts(mesh: &Mesh, parts: &Components) -> Result<Vec<(Vec<u32>, Mesh)>, Error> {
    let mut points = vec![Vec::new(); parts.count];
    let mut local = vec![0u32; mesh.positions.len()];
    for (v, &part) in (0u32..).zip(&parts.of_vertex) {
        local[v as usize] = points[part as usize].len() as u32;
        points[part as usize].push(v);
    }
    let mut triangles = vec![Vec::new(); parts.count];
    for t in &mesh.triangles {
        triangles[parts.of_vertex[t[0] as usize] as usize].push(t.map(|v| local[v as usize]));
    }
    let mut all = Vec::with_capacity(parts.count);
    for (points, triangles) in points.into_iter().zip(triangles) {
        let positions: Vec<_> = points.iter().map(|&v| mesh.positions[v as usize]).collect();
        let own = (0..positions.len() as u32).collect();
        // A part is made of triangles that the whole was checked with.
        if let Ok(part) = Mesh::of_points(&positions, &triangles, own, positions.len()) {
            all.push((points, part));
        }
    }
    Ok(all)
}

/// One graph of all: the surfaces in the order of the mesh, then the shells, then the lattices, part after part.
fn unite_graphs(mesh: &Mesh, graphs: &[(Vec<u32>, MeshGraph)]) -> MeshGraph {
    let surface = mesh.positions.len();
    let shells: usize = graphs.iter().map(|(_, g)| g.stats.shell_nodes).sum();
    let (mut next_shell, mut next_lattice) = (surface as u32, (surface + shells) as u32);
    // For each part the number of each of its nodes in the whole; rising, so that rows stay in order.
    let numbers: Vec<Vec<u32>> = (graphs.iter())
        .map(|(points, g)| {
            let mut numbers = points.clone();
            let shell = g.stats.shell_nodes as u32;
            let lattice = (g.nodes() - g.surface) as u32 - shell;
            numbers.extend(next_shell..next_shell + shell);
            numbers.extend(next_lattice..next_lattice + lattice);
            next_shell += shell;
            next_lattice += lattice;
            numbers
        })
        .collect();
    let nodes = next_lattice as usize;
    // Where each node comes from.
    let mut of = vec![(0u32, 0u32); nodes];
    for (part, numbers) in (0u32..).zip(&numbers) {
        for (node, &number) in (0u32..).zip(numbers) {
            of[number as usize] = (part, node);
        }
    }
    let weighted = graphs.iter().any(|(_, g)| g.weights.is_some());
    let mut whole = MeshGraph {
        offsets: Vec::with_capacity(nodes + 1),
        neighbours: Vec::new(),
        weights: weighted.then(Vec::new),
        positions: Vec::with_capacity(nodes),
        surface,
        nearest_surface: Vec::with_capacity(nodes),
        component: Vec::with_capacity(nodes),
        components: graphs.len(),
        stats: GraphStats::default(),
        recipe: GraphRecipe::default(),
        ties: None,
    };
    whole.offsets.push(0);
    for (part, node) in of {
        let (_, g) = &graphs[part as usize];
        let numbers = &numbers[part as usize];
        let row = g.offsets[node as usize] as usize..g.offsets[node as usize + 1] as usize;
        whole
            .neighbours
            .extend(g.neighbours[row.clone()].iter().map(|&j| numbers[j as usize]));
        if let Some(weights) = &mut whole.weights {
            match &g.weights {
                Some(w) => weights.extend_from_slice(&w[row]),
                None => weights.resize(whole.neighbours.len(), 1.0),
            }
        }
        whole.offsets.push(whole.neighbours.len() as u32);
        whole.positions.push(g.positions[node as usize]);
        whole
            .nearest_surface
            .push(numbers[g.nearest_surface[node as usize] as usize]);
        whole.component.push(part);
    }
    whole.stats = total_stats(graphs);
    whole
}

/// Counts and volumes added up; lengths of the part with the widest lattice.
fn total_stats(graphs: &[(Vec<u32>, MeshGraph)]) -> GraphStats {
    let mut all = GraphStats::default();
    for (_, g) in graphs {
        let s = &g.stats;
        all.shell_nodes += s.shell_nodes;
        all.lattice_nodes += s.lattice_nodes;
        all.struts += s.struts;
        all.interval = all.interval.max(s.interval);
        all.wanted_interval = all.wanted_interval.max(s.wanted_interval);
        all.shell_offset = all.shell_offset.max(s.shell_offset);
        all.enclosed_volume += s.enclosed_volume;
        all.component_has_volume
            .push(s.component_has_volume.first().copied().unwrap_or(false));
    }
    all
}

#[cfg(test)]
mod apart_tests {
    use super::*;
    use crate::asset::shapes;
    use crate::mesh::Weld;
    use crate::pool::Pool;
    use crate::progress::Silent;
    use glam::DVec3;

    #[test]
    fn touching_parts_are_not_tied() {
        let (positions, triangles) = shapes::box_with_cells(DVec3::splat(1.0), [6, 6, 6]);
        let count = positions.len() as u32;
        let mut both = positions.clone();
        both.extend(positions.iter().map(|p| *p + DVec3::X));
        let mut faces = triangles.clone();
        faces.extend(triangles.iter().map(|t| t.map(|v| v + count)));
        // Two boxes that share a side, told apart by number.
        let own: Vec<u32> = (0..2 * count).collect();
        let mesh = Mesh::of_points(&both, &faces, own, both.len()).expect("two boxes");
        let pool = Pool::new(2).expect("threads");
        let options = VolumeOptions::default();
        let graph = volume_apart(&mesh, &options, &Exec::new(&pool, &Silent))
            .expect("fits")
            .expect("inside");
        let alone = Mesh::build(&positions, &triangles, Weld::Exact).expect("a box");
        let alone = volume(&alone, &options, &Exec::new(&pool, &Silent))
            .expect("fits")
            .expect("inside");
        assert_eq!(
            (graph.components, graph.nodes(), graph.edges()),
            (2, 2 * alone.nodes(), 2 * alone.edges())
        );
        for node in 0..graph.nodes() as u32 {
            let part = graph.component[node as usize];
            assert!(graph.row(node).is_sorted());
            assert!(graph.row(node).iter().all(|&j| graph.component[j as usize] == part));
            assert_eq!(graph.component[graph.nearest_surface[node as usize] as usize], part);
        }
    }
}
