//! Ties between surface and lattice, spread over the surface.
//!
//! Where an edge of the grid leaves the lattice, its node is tied to the place where the edge meets the surface. Where triangles
//! are smaller than cells, the vertices nearest to that place share the tie, each by its area, so that none is pulled
//! alone; where they are larger, the corners of the triangle do.
//!
//! Struts across places that are too thin for a lattice: each vertex is tied to the place that lies straight across, so that the two
//! sides keep their distance and turn together.

use crate::Error;
use crate::graph::parallel::map;
use crate::graph::volume::lattice::LatticeExit;
use crate::graph::volume::lattice_grid::NONE;
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::solid::PartKind;
use crate::query::NearestPoints;
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Triangles whose edges are all shorter than this many intervals are tied by their nearest corner.
const SMALL: f64 = 0.5;
/// Vertices further than this many intervals from any place with a tie have none.
const REACH: f64 = 2.0;

/// Corners that have less than this share in a place are not tied to it.
const LEAST: f64 = 0.05;
/// Lengths that differ by less than this share are equal: what lies between two places is shared by both, so that a symmetric
/// shape has symmetric ties. Wider than what single precision does to the places of vertices.
const EQUAL: f64 = 1e-5;
/// Of equal places at most so many share a vertex.
const MOST_EQUAL: usize = 8;
/// Vertices looked at between two looks at the progress.
const CHECKED: usize = 1 << 14;

/// An exit whose node is tied to the surface.
pub(in crate::graph) struct SurfaceTie {
    pub(in crate::graph) exit: LatticeExit,
    pub(in crate::graph) weight: f64,
    /// Side of a cell of its lattice.
    pub(in crate::graph) interval: f64,
}

/// Ties of single vertices.
pub(in crate::graph) struct SpreadTies {
    /// Lattice node and vertex; rising, each once.
    pub(in crate::graph) ties: Vec<[u32; 2]>,
    pub(in crate::graph) weights: Vec<f32>,
    /// For each vertex whether a tie is near.
    pub(in crate::graph) reached: Vec<bool>,
}

/// A vertex that ties begin from: some lattice nodes with the weights of their ties.
struct TieSeed {
    vertex: u32,
    reach: f64,
    nodes: std::ops::Range<usize>,
}

/// What one lattice node is tied to one seed with.
struct SeedTie {
    seed: u32,
    node: u32,
    weight: f64,
    interval: f64,
    /// Of the vertices that share it.
    area: f64,
}

/// The nearest of some places: several where they are equally near.
#[derive(Clone, Copy, Default)]
struct EqualPlaces {
    places: [u32; MOST_EQUAL],
    count: usize,
}

impl EqualPlaces {
    fn one(place: u32) -> Self {
        let mut own = Self::default();
        own.add(place);
        own
    }

    /// Takes a place, once, while there is room.
    fn add(&mut self, place: u32) {
        if self.count < MOST_EQUAL && !self.places[..self.count].contains(&place) {
            self.places[self.count] = place;
            self.count += 1;
        }
    }

    fn all(&self) -> impl Iterator<Item = u32> + Clone {
        self.places.into_iter().take(self.count)
    }
}

/// Spreads ties over the vertices around the places where they meet the surface. `nodes` are the places of lattice nodes, and
/// `areas` the area around each vertex.
pub(in crate::graph) fn spread_ties(
    site: &VolumeSite,
    exits: &[SurfaceTie],
    nodes: &[DVec3],
    areas: &[f64],
) -> Result<SpreadTies, Error> {
    let mut seed_ties: Vec<SeedTie> = exits.iter().flat_map(|tie| tied_corners(site, tie)).collect();
    site.exec
        .pool
        .install(|| seed_ties.par_sort_by_key(|t| (t.seed, t.node)));
    seed_ties.dedup_by(|next, kept| {
        let same = (next.seed, next.node) == (kept.seed, kept.node);
        if same {
            kept.weight += next.weight;
        }
        same
    });
    let mut seeds: Vec<TieSeed> = Vec::new();
    for (k, tie) in seed_ties.iter().enumerate() {
        let reach = REACH * tie.interval;
        match seeds.last_mut() {
            Some(seed) if seed.vertex == tie.seed => {
                seed.nodes.end = k + 1;
                seed.reach = seed.reach.max(reach);
            }
            _ => seeds.push(TieSeed {
                vertex: tie.seed,
                reach,
                nodes: k..k + 1,
            }),
        }
    }
    let seeds_of = nearest_seeds(site, &seeds)?;
    // Of the nodes of its seeds each vertex is tied to the nearest one.
    let positions = &site.mesh.positions;
    let ties_of = |v: usize| {
        let ways = seeds_of[v]
            .all()
            .flat_map(|s| seeds[s as usize].nodes.clone())
            .map(|k| {
                let way = nodes[seed_ties[k].node as usize].distance_squared(positions[v]);
                (way, k as u32)
            });
        let least = ways.clone().map(|w| w.0).fold(f64::INFINITY, f64::min);
        let mut nearest = EqualPlaces::default();
        let equal = ways.filter(|w| w.0 <= least * (1.0 + 2.0 * EQUAL));
        equal.for_each(|w| nearest.add(w.1));
        nearest
    };
    let ties_of: Vec<EqualPlaces> = site.exec.pool.install(|| {
        let vertices = (0..positions.len()).into_par_iter().with_min_len(1024);
        vertices.map(ties_of).collect()
    });
    let share_of = |v: usize| areas[v] / ties_of[v].count.max(1) as f64;
    for (v, ties) in ties_of.iter().enumerate() {
        ties.all().for_each(|k| seed_ties[k as usize].area += share_of(v));
    }
    let mut ties: Vec<([u32; 2], f32)> = Vec::with_capacity(ties_of.len());
    for (v, own) in (0u32..).zip(&ties_of) {
        let shared = own.all().map(|k| &seed_ties[k as usize]).filter(|tie| tie.area > 0.0);
        let share = |tie: &SeedTie| (tie.weight * (share_of(v as usize) / tie.area)) as f32;
        ties.extend(shared.map(|tie| ([tie.node, v], share(tie))));
    }
    // A node that is the nearest one of no vertex is tied to the seed.
    let alone = seed_ties.iter().filter(|tie| tie.area <= 0.0);
    ties.extend(alone.map(|tie| ([tie.node, tie.seed], tie.weight as f32)));
    ties.retain(|t| t.1 > 0.0);
    site.exec.pool.install(|| ties.par_sort_by_key(|t| t.0));
    // A seed that coincides with another one shares in the other's ties, and its own are left to it.
    ties.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    let (ties, weights) = ties.into_iter().unzip();
    Ok(SpreadTies {
        ties,
        weights,
        reached: seeds_of.iter().map(|s| s.count > 0).collect(),
    })
}

/// The vertices that an exit is tied to before ties are spread.
fn tied_corners(site: &VolumeSite, tie: &SurfaceTie) -> impl Iterator<Item = SeedTie> + use<> {
    let SurfaceTie { exit, weight, interval } = *tie;
    let face = site.mesh.triangles[exit.triangle as usize];
    let [a, b, c] = face.map(|v| site.mesh.positions[v as usize]);
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    let shares = if longest < SMALL * interval {
        nearest_vertices(site, exit.vertex, exit.point)
    } else {
        let [x, y, z] = barycentric([a, b, c], exit.point);
        [(face[0], x), (face[1], y), (face[2], z), (NONE, 0.0)]
    };
    // A place on an edge has nothing of the third corner, whatever rounding says.
    let some = shares.into_iter().filter(|s| s.1 > LEAST);
    let sum: f64 = some.clone().map(|s| s.1).sum();
    some.map(move |(seed, share)| SeedTie {
        seed,
        node: exit.node,
        weight: weight * share / sum,
        interval,
        area: 0.0,
    })
}

/// The vertex nearest to a point, and those of its neighbours that are as near; each with an equal share.
fn nearest_vertices(site: &VolumeSite, vertex: u32, point: DVec3) -> [(u32, f64); 4] {
    let way = |v: u32| site.mesh.positions[v as usize].distance(point);
    let within = way(vertex) * (1.0 + EQUAL);
    let equal = site
        .adjacency
        .neighbours
        .of(vertex)
        .iter()
        .filter(|&&v| way(v) <= within);
    let mut nearest = [(vertex, 1.0), (NONE, 0.0), (NONE, 0.0), (NONE, 0.0)];
    nearest[1..].iter_mut().zip(equal).for_each(|(to, &v)| *to = (v, 1.0));
    nearest
}

/// What each corner of a triangle has in a point of it: not below 0, and 1 in all.
pub(in crate::graph) fn barycentric([a, b, c]: [DVec3; 3], p: DVec3) -> [f64; 3] {
    let normal = (b - a).cross(c - a);
    let square = normal.length_squared();
    if square <= 0.0 {
        return [1.0 / 3.0; 3];
    }
    let share = |from: DVec3, to: DVec3| ((to - from).cross(p - from).dot(normal) / square).max(0.0);
    let [x, y, z] = [share(b, c), share(c, a), share(a, b)];
    let sum = x + y + z;
    [x / sum, y / sum, z / sum]
}

/// For each vertex the nearest seed by ways along edges, within the seed's reach; several where they are equally near, and none
/// where all are further. Faces of soups do not hang together, and have the nearest one in space.
fn nearest_seeds(site: &VolumeSite, seeds: &[TieSeed]) -> Result<Vec<EqualPlaces>, Error> {
    let positions = &site.mesh.positions;
    // Lengths are not negative, so their bits are in the same order.
    let mut nearest = vec![(u64::MAX, NONE); positions.len()];
    let mut waiting = BinaryHeap::new();
    for (k, seed) in (0u32..).zip(seeds) {
        nearest[seed.vertex as usize] = (0, k);
        waiting.push(Reverse((0u64, k, seed.vertex)));
    }
    let mut seeds_of = vec![EqualPlaces::default(); positions.len()];
    let mut looked = 0usize;
    while let Some(Reverse((bits, number, v))) = waiting.pop() {
        looked += 1;
        if looked.is_multiple_of(CHECKED) {
            site.exec.check()?;
        }
        if (bits, number) != nearest[v as usize] {
            continue;
        }
        let way = f64::from_bits(bits);
        let mut own = EqualPlaces::one(number);
        for &other in site.adjacency.neighbours.of(v) {
            let edge = positions[other as usize].distance(positions[v as usize]);
            let there = f64::from_bits(nearest[other as usize].0);
            // Ways that end here are all known: they came by vertices that are nearer.
            if there + edge <= way * (1.0 + EQUAL) {
                let equal = seeds_of[other as usize]
                    .all()
                    .filter(|&s| way <= seeds[s as usize].reach);
                equal.for_each(|s| own.add(s));
            }
            let way = way + edge;
            if way <= seeds[number as usize].reach && (way.to_bits(), number) < nearest[other as usize] {
                nearest[other as usize] = (way.to_bits(), number);
                waiting.push(Reverse((way.to_bits(), number, other)));
            }
        }
        seeds_of[v as usize] = own;
    }
    let is_loose = |v: &u32| seeds_of[*v as usize].count == 0 && site.parts.kind(*v) == PartKind::Soup;
    let loose: Vec<u32> = (0..positions.len() as u32).filter(is_loose).collect();
    if !loose.is_empty() {
        let in_soup = |s: &(u32, &TieSeed)| site.parts.kind(s.1.vertex) == PartKind::Soup;
        let in_soup = (0u32..).zip(seeds).filter(in_soup);
        let points = NearestPoints::new(in_soup.map(|(k, s)| (positions[s.vertex as usize], k)));
        let reach = seeds.iter().map(|s| s.reach).fold(0.0, f64::max);
        let found = map(&loose, site.budget, |&v| {
            points.nearest_within(positions[v as usize], reach * reach)
        })?;
        for (v, (seed, _)) in loose.into_iter().zip(found).filter_map(|(v, f)| Some((v, f?))) {
            seeds_of[v as usize] = EqualPlaces::one(seed);
        }
    }
    Ok(seeds_of)
}

/// A third of the area of the triangles around each vertex.
pub(in crate::graph) fn vertex_areas(site: &VolumeSite) -> Vec<f64> {
    let mut areas = vec![0.0; site.mesh.positions.len()];
    for t in &site.mesh.triangles {
        let [a, b, c] = t.map(|v| site.mesh.positions[v as usize]);
        let third = (b - a).cross(c - a).length() / 6.0;
        t.iter().for_each(|&v| areas[v as usize] += third);
    }
    areas
}

/// What a strut weighs that is as long as the square root of the area around its vertex, against edges of the surface, which
/// weigh 1: what a lattice would that fills the place.
const STIFFNESS: f64 = 10.0;
/// What one strut weighs at most.
const MOST: f64 = 8.0;
/// A strut meets the other side at no flatter angle than one with this sine.
const STEEP: f64 = 0.3;

/// An edge between two vertices that lie across from each other, the smaller one first, and its weight.
pub(in crate::graph) type Strut = ([u32; 2], f32);

/// The vertices that are to have struts, and how far across these may reach.
pub(in crate::graph) struct ThinPlaces<'a> {
    pub(in crate::graph) vertices: Vec<u32>,
    /// For each vertex of the mesh which way leads inwards.
    pub(in crate::graph) inward: &'a [DVec3],
    /// By part of the mesh.
    pub(in crate::graph) reach: &'a [f64],
    /// The area around each vertex of the mesh.
    pub(in crate::graph) areas: &'a [f64],
}

/// The struts of thin places; rising, each once. Edges of the mesh are none.
pub(in crate::graph) fn struts(site: &VolumeSite, thin: &ThinPlaces) -> Result<Vec<Strut>, Error> {
    if thin.vertices.is_empty() {
        return Ok(Vec::new());
    }
    // Built here, because that is never to be done by one of many in parallel.
    site.surface.tree();
    let found = map(&thin.vertices, site.budget, |&v| strut(site, thin, v))?;
    let mut all: Vec<Strut> = found.into_iter().flatten().flatten().filter(|s| s.1 > 0.0).collect();
    all.sort_by_key(|s| s.0);
    all.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    let neighbours = &site.adjacency.neighbours;
    all.retain(|&([a, b], _)| neighbours.of(a).binary_search(&b).is_err());
    Ok(all)
}

/// The edges from a vertex to the corners of the triangle straight across.
fn strut(site: &VolumeSite, thin: &ThinPlaces, v: u32) -> Option<[Strut; 3]> {
    let positions = &site.mesh.positions;
    let part = |v: u32| site.parts.components.of_vertex[v as usize];
    let (p, inward) = (positions[v as usize], thin.inward[v as usize]);
    let reach = thin.reach[part(v) as usize];
    if inward == DVec3::ZERO || reach == 0.0 {
        return None;
    }
    let tree = site.surface.tree().bvh();
    let hit = tree.first_hit(p, p + inward * reach, Some(v))?;
    let face = site.mesh.triangles[hit.triangle as usize];
    let corners = face.map(|v| positions[v as usize]);
    let normal = (corners[1] - corners[0])
        .cross(corners[2] - corners[0])
        .normalize_or_zero();
    let square = hit.point.distance_squared(p);
    if part(face[0]) != part(v) || normal.dot(inward).abs() < STEEP || square <= 0.0 {
        return None;
    }
    let shares = barycentric(corners, hit.point);
    // Edges to far corners are longer than the strut; together they have its energy.
    let squares = corners.map(|c| c.distance_squared(p));
    let longer: f64 = shares.iter().zip(squares).map(|(share, s)| share * s / square).sum();
    let weight = (STIFFNESS * thin.areas[v as usize] / square).min(MOST) / longer;
    Some([0, 1, 2].map(|k| {
        let other = face[k];
        ([v.min(other), v.max(other)], (weight * shares[k]) as f32)
    }))
}
