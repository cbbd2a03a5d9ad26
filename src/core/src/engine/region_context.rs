//! Which vertices and which graph nodes a region holds.

use super::error::Error;
use super::region::{Anchor, AnchorCorners, Region, VertexRange};
use super::tube_region::Tube;
use crate::asset::Primitive;
use crate::exec::Exec;
use crate::graph::MeshGraph;
use crate::graph::parallel::map;
use crate::mesh::query::closest_point::closest_point_on_segment;
use crate::mesh::query::{NearestPoints, QueryStop, VisitBudget};
use crate::mesh::{Components, Mesh, NONE};
use glam::DVec3;
use std::cell::OnceCell;

/// The surface that regions are taken on: in the rest pose, or in the shape that is edited.
pub(super) struct RegionContext<'a> {
    /// Which of these, in words.
    pub pose: &'static str,
    pub positions: &'a [DVec3],
    pub primitives: &'a [Primitive],
    pub mesh: &'a Mesh,
    pub parts: &'a Components,
    /// What 32-bit positions are relative to.
    pub origin: DVec3,
    pub exec: &'a Exec<'a>,
    /// The mirror images of solver vertices, once a region asked for them.
    pub images: OnceCell<MirrorImages>,
}

/// For every solver vertex the one whose mirror image it is, and the mirror.
pub(super) type MirrorImages = (MirrorPlane, Vec<Option<u32>>);

/// A mirror: unit normal and a point of the plane.
pub(super) type MirrorPlane = (DVec3, DVec3);

/// The graph nodes of a region.
#[derive(Debug, Clone, Default)]
pub(super) struct RegionNodes {
    /// The nodes, rising. Inside nodes belong to a volume region by where they are, to a listed one by their nearest surface
    /// vertex.
    pub nodes: Vec<u32>,
    /// The weight of each of `nodes`, for regions that give weights.
    pub weights: Option<Vec<f64>>,
}

impl RegionNodes {
    /// Leaves out the nodes inside.
    pub fn keep_surface(&mut self, graph: &MeshGraph) {
        let count = self.nodes.partition_point(|n| (*n as usize) < graph.surface);
        self.nodes.truncate(count);
        if let Some(weights) = &mut self.weights {
            weights.truncate(count);
        }
    }
}

/// How a region gives its vertices.
enum Membership<'a> {
    /// By number: the render vertices.
    Listed(Vec<bool>),
    /// By the weight of each render vertex.
    Weighted(&'a [f32]),
    /// By where they are.
    Solid(Box<dyn Fn(DVec3) -> bool + 'a>),
    /// By how far they are from a polyline.
    Tube(Tube<'a>),
}

/// Points looked at between two looks at the progress; a few nanoseconds each.
const BLOCK: usize = 1 << 16;
/// What finding the mirror image of one vertex may look at on average, and finding all of them in any case.
const VISITS_PER_IMAGE: u64 = 256;
const LEAST_VISITS: u64 = 1 << 22;

/// Returns for each render vertex whether the region holds it, as the region stands or seen in a mirror.
///
/// # Errors
/// When the region does not fit the model, or holds no render vertex. A mirror image may hold none: not every model is
/// symmetric.
pub(super) fn vertices_in_region(
    context: &RegionContext<'_>,
    region: &Region,
    mirror: Option<MirrorPlane>,
) -> Result<Vec<bool>, Error> {
    let vertices = find_vertices(context, region, mirror)?;
    if mirror.is_none() && !vertices.contains(&true) {
        return Err(holds_nothing(context));
    }
    Ok(vertices)
}

/// Returns for each render vertex whether a handle's region contains it. A region given by place may contain only
/// inside nodes.
///
/// # Errors
/// When the region does not fit the model, or lists no vertex.
pub(super) fn vertices_of_handle(context: &RegionContext<'_>, region: &Region) -> Result<Vec<bool>, Error> {
    match region.is_solid() {
        true => find_vertices(context, region, None),
        false => vertices_in_region(context, region, None),
    }
}

/// What is said of a region that holds nothing: mostly it lies beside the model, or is in other units.
pub(super) fn holds_nothing(context: &RegionContext<'_>) -> Error {
    let (low, high) = (context.positions.iter()).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| {
        (low.min(*p), high.max(*p))
    });
    let problem = format!(
        "holds no vertex; regions are taken in {} and in model space, where the model's box is from {} to {}",
        context.pose,
        rounded_point(low, low.distance(high)),
        rounded_point(high, low.distance(high))
    );
    Error::invalid("", problem)
}

/// A point as people read it: with enough digits for places of a box with this diagonal.
fn rounded_point(point: DVec3, diagonal: f64) -> String {
    let magnitude = if diagonal > 0.0 {
        libm::floor(libm::log10(diagonal))
    } else {
        0.0
    };
    let digits = (3.0 - magnitude).clamp(0.0, 17.0) as usize;
    // Adding zero makes of minus zero plain zero.
    let [x, y, z] = point.to_array().map(|x| x + 0.0);
    format!("[{x:.digits$}, {y:.digits$}, {z:.digits$}]")
}

fn find_vertices(
    context: &RegionContext<'_>,
    region: &Region,
    mirror: Option<MirrorPlane>,
) -> Result<Vec<bool>, Error> {
    let vertices = match (membership(context, region)?, mirror) {
        (Membership::Listed(marks), None) => marks,
        (Membership::Listed(marks), Some(mirror)) => {
            let seen = mirrored_surface(context, &surface_of_vertices(context, &marks), mirror)?;
            vertices_of_surface(context, &seen)
        }
        (Membership::Weighted(values), None) => values.iter().map(|w| *w > 0.0).collect(),
        (Membership::Weighted(values), Some(_)) => {
            let weights = surface_weights(context, values, mirror)?;
            let marks: Vec<bool> = weights.iter().map(|w| *w > 0.0).collect();
            vertices_of_surface(context, &marks)
        }
        (Membership::Solid(contains), mirror) => points_inside(context, contains, context.positions, mirror)?,
        (Membership::Tube(tube), mirror) => {
            tube.find_inside(context.positions, |p| unmirrored(p, mirror), context.exec)?
        }
    };
    without_passengers(context, vertices, mirror)
}

/// Takes the vertices of passengers out: nothing holds what rides along.
fn without_passengers(
    context: &RegionContext<'_>,
    mut vertices: Vec<bool>,
    mirror: Option<MirrorPlane>,
) -> Result<Vec<bool>, Error> {
    let mut taken_from = None;
    for passenger in context.primitives.iter().filter(|p| p.is_passenger) {
        let held = &mut vertices[passenger.vertices()];
        if held.contains(&true) {
            held.fill(false);
            taken_from = Some(passenger);
        }
    }
    match taken_from {
        Some(passenger) if mirror.is_none() && !vertices.contains(&true) => {
            let problem = format!(
                "holds vertices of passengers alone, such as \"{}\"; what rides along cannot be held",
                passenger.name
            );
            Err(Error::invalid("", problem))
        }
        _ => Ok(vertices),
    }
}

/// Returns the nodes of the graph that the region holds, as the region stands or seen in a mirror.
///
/// # Errors
/// When the region does not fit the model.
pub(super) fn nodes_in_region(
    context: &RegionContext<'_>,
    graph: &MeshGraph,
    region: &Region,
    mirror: Option<MirrorPlane>,
) -> Result<RegionNodes, Error> {
    let nodes = match membership(context, region)? {
        Membership::Listed(marks) => {
            let own = surface_of_vertices(context, &marks);
            let surface = match mirror {
                None => own,
                Some(mirror) => mirrored_surface(context, &own, mirror)?,
            };
            nodes_nearest_to(graph, &surface)
        }
        Membership::Weighted(values) => {
            let by_solver = surface_weights(context, values, mirror)?;
            let marks: Vec<bool> = by_solver.iter().map(|w| *w > 0.0).collect();
            let nodes = nodes_nearest_to(graph, &marks);
            let weight = |n: &u32| f64::from(by_solver[graph.nearest_surface[*n as usize] as usize]);
            let weights = Some(nodes.iter().map(weight).collect());
            return Ok(RegionNodes { nodes, weights });
        }
        Membership::Solid(contains) => numbers_of(&points_inside(context, contains, &graph.positions, mirror)?),
        Membership::Tube(tube) => {
            numbers_of(&tube.find_inside(&graph.positions, |p| unmirrored(p, mirror), context.exec)?)
        }
    };
    Ok(RegionNodes { nodes, weights: None })
}

/// Which points a shape contains, as they stand or seen in a mirror.
fn points_inside(
    context: &RegionContext<'_>,
    contains: impl Fn(DVec3) -> bool,
    points: &[DVec3],
    mirror: Option<MirrorPlane>,
) -> Result<Vec<bool>, Error> {
    let mut inside = Vec::with_capacity(points.len());
    for block in points.chunks(BLOCK) {
        context.exec.check()?;
        inside.extend(block.iter().map(|&p| contains(unmirrored(p, mirror))));
    }
    Ok(inside)
}

fn numbers_of(marks: &[bool]) -> Vec<u32> {
    let marked = (0u32..).zip(marks).filter(|(_, is_marked)| **is_marked);
    marked.map(|(n, _)| n).collect()
}

/// The mean rest position of a region's solver vertices; of its render vertices when none of them is in a face; of its
/// inside nodes when it has no vertices.
pub(super) fn region_centroid(
    context: &RegionContext<'_>,
    graph: &MeshGraph,
    vertices: &[bool],
    nodes: &[u32],
) -> DVec3 {
    let surface = graph.surface as u32;
    let solver: Vec<DVec3> = (nodes.iter().filter(|n| **n < surface))
        .map(|n| graph.positions[*n as usize])
        .collect();
    let unreferenced = || (context.positions.iter().zip(vertices).filter(|(_, held)| **held)).map(|(p, _)| *p);
    let points: Vec<DVec3> = match solver.is_empty() {
        false => solver,
        true if vertices.contains(&true) => unreferenced().collect(),
        true => nodes.iter().map(|n| graph.positions[*n as usize]).collect(),
    };
    points.iter().map(|p| *p / points.len().max(1) as f64).sum()
}

fn membership<'a>(context: &RegionContext<'_>, region: &'a Region) -> Result<Membership<'a>, Error> {
    Ok(match region {
        Region::Vertices { indices, ranges } => Membership::Listed(listed_vertices(context, indices, ranges)?),
        &Region::Component(index) => {
            require_number(index, context.parts.count, || ".component.index".into(), "parts")?;
            let of = |v: &u32| *v != NONE && context.parts.of_vertex[*v as usize] == index;
            Membership::Listed(context.mesh.solver_from_render.iter().map(of).collect())
        }
        &Region::Primitive(index) => {
            require_number(
                index,
                context.primitives.len(),
                || ".primitive.index".into(),
                "primitives",
            )?;
            let primitive = &context.primitives[index as usize];
            let mut marks = vec![false; context.positions.len()];
            let (first, count) = (primitive.first_vertex as usize, primitive.vertex_count as usize);
            marks.iter_mut().skip(first).take(count).for_each(|m| *m = true);
            Membership::Listed(marks)
        }
        Region::Anchors(anchors) => {
            let mut marks = vec![false; context.positions.len()];
            for (k, anchor) in anchors.iter().enumerate() {
                let corners = anchor_corners(context, anchor, k)?;
                corners.iter().for_each(|v| marks[*v as usize] = true);
            }
            Membership::Listed(marks)
        }
        Region::Weights(values) => {
            require_weights(values, context.positions.len())?;
            Membership::Weighted(values)
        }
        Region::HalfSpace(plane) => {
            let (normal, point) = plane.unit_normal_and_point();
            Membership::Solid(Box::new(move |p| (p - point).dot(normal) >= 0.0))
        }
        &Region::Sphere { center, radius } => Membership::Solid(Box::new(move |p| p.distance(center) <= radius)),
        &Region::Box { min, max } => Membership::Solid(Box::new(move |p| p.cmpge(min).all() && p.cmple(max).all())),
        &Region::Capsule { from, to, radius } => {
            Membership::Solid(Box::new(move |p| distance_to_segment(p, from, to) <= radius))
        }
        Region::Tube { points, radius } => Membership::Tube(Tube::cut_pieces(points, *radius)?),
    })
}

/// The render vertices around an anchor, the `number`th of a region; each is in a face.
///
/// # Errors
/// When there are none such.
pub(super) fn anchor_corners(context: &RegionContext<'_>, anchor: &Anchor, number: usize) -> Result<[u32; 3], Error> {
    let mesh = context.mesh;
    match anchor.corners {
        AnchorCorners::Face(face) => match mesh.source_triangle.binary_search(&face) {
            Ok(at) => Ok(mesh.triangles[at].map(|v| mesh.render_vertices_of(v)[0])),
            Err(_) => {
                let field = || format!(".anchors.faces[{number}]");
                let count = (context.primitives.iter()).map(|p| p.index_count as usize / 3).sum();
                require_number(face, count, field, "triangles")?;
                let problem = format!("is {face}, a triangle that is not solved: of a passenger, or one without area");
                Err(Error::invalid(field(), problem))
            }
        },
        AnchorCorners::Vertices(corners) => {
            for (k, corner) in corners.into_iter().enumerate() {
                let field = || format!(".anchors.corners[{}]", 3 * number + k);
                require_number(corner, context.positions.len(), field, "render vertices")?;
                if mesh.solver_from_render[corner as usize] == NONE {
                    let problem = format!("is {corner}, a vertex that is in no solved triangle");
                    return Err(Error::invalid(field(), problem));
                }
            }
            Ok(corners)
        }
    }
}

fn require_number(index: u32, count: usize, field: impl Fn() -> String, what: &str) -> Result<(), Error> {
    if (index as usize) < count {
        return Ok(());
    }
    let problem = format!("is {index}, the model has {count} {what}, counted from 0");
    Err(Error::invalid(field(), problem))
}

fn require_weights(values: &[f32], count: usize) -> Result<(), Error> {
    if values.len() != count {
        let problem = format!("has {} numbers, the model has {count} render vertices", values.len());
        return Err(Error::invalid(".weights.values", problem));
    }
    if let Some(k) = values.iter().position(|w| !(0.0..=1.0).contains(w)) {
        let problem = format!("is {}, allowed are 0 to 1", values[k]);
        return Err(Error::invalid(format!(".weights.values[{k}]"), problem));
    }
    Ok(())
}

fn listed_vertices(context: &RegionContext<'_>, indices: &[u32], ranges: &[VertexRange]) -> Result<Vec<bool>, Error> {
    let count = context.positions.len();
    let mut marks = vec![false; count];
    for (k, &index) in indices.iter().enumerate() {
        require_number(index, count, || format!(".vertices.indices[{k}]"), "render vertices")?;
        marks[index as usize] = true;
    }
    // How many more ranges begin at a vertex than end there: ranges may overlap, and each is to cost the same however long it is.
    let mut begun = vec![0i32; if ranges.is_empty() { 0 } else { count + 1 }];
    for (k, range) in ranges.iter().enumerate() {
        let end = u64::from(range.first) + u64::from(range.count);
        if end > count as u64 {
            let problem = format!("ends at {end}, the model has {count} render vertices, counted from 0");
            return Err(Error::invalid(format!(".vertices.ranges[{k}]"), problem));
        }
        begun[range.first as usize] += 1;
        begun[end as usize] -= 1;
    }
    let mut open = 0;
    for (mark, begun) in marks.iter_mut().zip(begun) {
        open += begun;
        *mark |= open > 0;
    }
    Ok(marks)
}

/// The solver vertices of marked render vertices.
fn surface_of_vertices(context: &RegionContext<'_>, marks: &[bool]) -> Vec<bool> {
    let mut surface = vec![false; context.mesh.positions.len()];
    let held = context.mesh.solver_from_render.iter().zip(marks);
    for (&solver, _) in held.filter(|(s, m)| **m && **s != NONE) {
        surface[solver as usize] = true;
    }
    surface
}

/// The render vertices of marked solver vertices.
fn vertices_of_surface(context: &RegionContext<'_>, surface: &[bool]) -> Vec<bool> {
    let solver = context.mesh.solver_from_render.iter();
    solver.map(|s| *s != NONE && surface[*s as usize]).collect()
}

/// The solver vertices whose mirror images are marked.
fn mirrored_surface(context: &RegionContext<'_>, surface: &[bool], mirror: MirrorPlane) -> Result<Vec<bool>, Error> {
    let images = mirror_images(context, mirror)?;
    Ok(images.iter().map(|o| o.is_some_and(|o| surface[o as usize])).collect())
}

/// The weight of each solver vertex: the largest of its render vertices, or that of its mirror image.
fn surface_weights(
    context: &RegionContext<'_>,
    values: &[f32],
    mirror: Option<MirrorPlane>,
) -> Result<Vec<f32>, Error> {
    let mut by_solver = vec![0f32; context.mesh.positions.len()];
    let weighted = context.mesh.solver_from_render.iter().zip(values);
    for (&solver, &w) in weighted.filter(|(s, _)| **s != NONE) {
        by_solver[solver as usize] = by_solver[solver as usize].max(w);
    }
    let Some(mirror) = mirror else {
        return Ok(by_solver);
    };
    let images = mirror_images(context, mirror)?.iter();
    Ok(images.map(|o| o.map_or(0.0, |o| by_solver[o as usize])).collect())
}

/// The nodes whose nearest surface vertex is marked.
fn nodes_nearest_to(graph: &MeshGraph, surface: &[bool]) -> Vec<u32> {
    let nearest = (0u32..).zip(&graph.nearest_surface);
    nearest.filter(|(_, s)| surface[**s as usize]).map(|(n, _)| n).collect()
}

/// For every solver vertex the one whose mirror image it is: the nearest within half a mean edge of the exact place. All regions
/// of a context are seen in one mirror.
fn mirror_images<'a>(context: &'a RegionContext<'_>, mirror: MirrorPlane) -> Result<&'a [Option<u32>], Error> {
    if let Some((_, images)) = context.images.get().filter(|(plane, _)| *plane == mirror) {
        return Ok(images);
    }
    let (positions, exec) = (&context.mesh.positions, context.exec);
    let tree = NearestPoints::new(positions.iter().copied().zip(0u32..));
    let edge = 0.5 * mean_triangle_edge(context.mesh);
    let seen = || tree.visits.total();
    let budget = VisitBudget::new(LEAST_VISITS + VISITS_PER_IMAGE * positions.len() as u64, &seen, exec);
    let image = |&p: &DVec3| {
        let found = tree.nearest_within(unmirrored(p, Some(mirror)), edge * edge);
        found.map(|(n, _)| n)
    };
    let images = map(positions, &budget, image).map_err(|stop| match stop {
        QueryStop::Cancelled => Error::Cancelled,
        QueryStop::TooMany { limit } => Error::invalid(
            "",
            format!("is mirrored, and finding the mirror images of this model's vertices takes more than {limit} comparisons"),
        ),
    })?;
    Ok(&context.images.get_or_init(|| (mirror, images)).1)
}

/// The point that a mirror shows at `p`.
fn unmirrored(p: DVec3, mirror: Option<MirrorPlane>) -> DVec3 {
    match mirror {
        None => p,
        Some((normal, point)) => p - normal * (2.0 * normal.dot(p - point)),
    }
}

fn mean_triangle_edge(mesh: &Mesh) -> f64 {
    let mean = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        (a.distance(b) + b.distance(c) + c.distance(a)) / 3.0
    };
    let sum: f64 = mesh.triangles.iter().map(mean).sum();
    sum / mesh.triangles.len().max(1) as f64
}

fn distance_to_segment(p: DVec3, from: DVec3, to: DVec3) -> f64 {
    p.distance(closest_point_on_segment(p, from, to))
}
