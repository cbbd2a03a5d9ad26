//! Regions to vertices: which render vertices and which graph nodes a handle holds.

use crate::asset::Primitive;
use crate::graph::MeshGraph;
use crate::mesh::query::NearestPoints;
use crate::mesh::query::closest_point::closest_point_on_segment;
use crate::mesh::{Components, Mesh, NONE};
use crate::wire::check::{number, plane, positive, vector};
use crate::wire::{Error, pb};
use glam::DVec3;

/// What regions are resolved against; all in the rest pose, or in the shape that is edited.
pub(super) struct RegionContext<'a> {
    /// Which of these, in words.
    pub pose: &'static str,
    pub positions: &'a [DVec3],
    pub primitives: &'a [Primitive],
    pub mesh: &'a Mesh,
    pub parts: &'a Components,
    pub graph: &'a MeshGraph,
}

/// A mirror: unit normal and a point of the plane.
pub(super) type MirrorPlane = (DVec3, DVec3);

/// The vertices of a region.
#[derive(Debug, Clone, Default)]
pub(super) struct ResolvedRegion {
    /// By render vertex.
    pub render: Vec<bool>,
    /// Graph nodes, rising. Inside nodes belong to a volume region by where they are, to a listed one by their nearest
    /// surface vertex.
    pub nodes: Vec<u32>,
    /// Weight of each of `nodes`, for regions that give weights.
    pub weights: Option<Vec<f64>>,
}

impl ResolvedRegion {
    /// Mean of the region's solver vertices at rest; of its render vertices when none of them is in a face.
    pub fn centroid(&self, ground: &RegionContext<'_>) -> DVec3 {
        let surface = ground.graph.surface as u32;
        let solver: Vec<DVec3> = self
            .nodes
            .iter()
            .filter(|n| **n < surface)
            .map(|n| ground.graph.positions[*n as usize])
            .collect();
        let points = match solver.is_empty() {
            false => solver,
            true => ground
                .positions
                .iter()
                .zip(&self.render)
                .filter(|(_, r)| **r)
                .map(|(p, _)| *p)
                .collect(),
        };
        points.iter().map(|p| *p / points.len().max(1) as f64).sum()
    }
}

/// Resolves a region, as it stands or seen in a mirror.
///
/// # Errors
/// [`Error::Invalid`] with the field below `field`, also for a region that holds no render vertex.
pub(super) fn resolve(
    ground: &RegionContext<'_>,
    region: Option<&pb::Region>,
    mirror: Option<MirrorPlane>,
    field: &str,
) -> Result<ResolvedRegion, Error> {
    use pb::region::Region;
    const KINDS: &str = "vertices, halfSpace, sphere, box, capsule, tube, component, primitive or weights";
    let Some(region) = region.and_then(|r| r.region.as_ref()) else {
        return Err(Error::invalid(field, format!("is missing, allowed is one of {KINDS}")));
    };
    let resolved = match region {
        Region::Vertices(list) => listed(ground, &mark(ground, list, field)?, mirror),
        Region::Component(part) => {
            let at = format!("{field}.component.index");
            in_range(part.index, ground.parts.count, &at, "parts")?;
            let of = |v: &u32| *v != NONE && ground.parts.of_vertex[*v as usize] == part.index;
            listed(
                ground,
                &ground.mesh.solver_from_render.iter().map(of).collect::<Vec<_>>(),
                mirror,
            )
        }
        Region::Primitive(part) => {
            let at = format!("{field}.primitive.index");
            in_range(part.index, ground.primitives.len(), &at, "primitives")?;
            let primitive = &ground.primitives[part.index as usize];
            let first = primitive.first_vertex as usize;
            let mut marks = vec![false; ground.positions.len()];
            marks
                .iter_mut()
                .skip(first)
                .take(primitive.vertex_count as usize)
                .for_each(|m| *m = true);
            listed(ground, &marks, mirror)
        }
        Region::Weights(weights) => weighted(ground, &weights.values, mirror, field)?,
        Region::HalfSpace(half) => {
            let plane = plane(
                &pb::Plane {
                    normal: half.normal.clone(),
                    offset: half.offset,
                },
                &format!("{field}.halfSpace"),
            )?;
            inside(ground, mirror, |p| (p - plane.1).dot(plane.0) >= 0.0)
        }
        Region::Sphere(sphere) => {
            let center = vector(&sphere.center, &format!("{field}.sphere.center"))?;
            let radius = positive(sphere.radius, &format!("{field}.sphere.radius"))?;
            inside(ground, mirror, |p| p.distance(center) <= radius)
        }
        Region::Box(corners) => {
            let min = vector(&corners.min, &format!("{field}.box.min"))?;
            let max = vector(&corners.max, &format!("{field}.box.max"))?;
            if !min.cmple(max).all() {
                return Err(Error::invalid(
                    format!("{field}.box"),
                    format!("min {min} is above max {max}"),
                ));
            }
            inside(ground, mirror, |p| p.cmpge(min).all() && p.cmple(max).all())
        }
        Region::Capsule(capsule) => {
            let from = vector(&capsule.from, &format!("{field}.capsule.from"))?;
            let to = vector(&capsule.to, &format!("{field}.capsule.to"))?;
            let radius = positive(capsule.radius, &format!("{field}.capsule.radius"))?;
            inside(ground, mirror, |p| distance_to_segment(p, from, to) <= radius)
        }
        Region::Tube(tube) => {
            let points = polyline(&tube.points, &format!("{field}.tube.points"))?;
            let radius = positive(tube.radius, &format!("{field}.tube.radius"))?;
            inside(ground, mirror, |p| {
                points.windows(2).any(|s| distance_to_segment(p, s[0], s[1]) <= radius)
            })
        }
    };
    // A mirror image may hold nothing: not every model is symmetric.
    if mirror.is_none() && !resolved.render.contains(&true) {
        return Err(Error::invalid(
            field,
            format!(
                "holds no vertex; regions are taken in {} and in model space",
                ground.pose
            ),
        ));
    }
    Ok(resolved)
}

fn in_range(index: u32, count: usize, field: &str, what: &str) -> Result<(), Error> {
    if (index as usize) < count {
        Ok(())
    } else {
        Err(Error::invalid(
            field,
            format!("is {index}, the model has {count} {what}, counted from 0"),
        ))
    }
}

fn mark(ground: &RegionContext<'_>, list: &pb::region::Vertices, field: &str) -> Result<Vec<bool>, Error> {
    let count = ground.positions.len();
    let mut marks = vec![false; count];
    for (k, &index) in list.indices.iter().enumerate() {
        in_range(
            index,
            count,
            &format!("{field}.vertices.indices[{k}]"),
            "render vertices",
        )?;
        marks[index as usize] = true;
    }
    for (k, range) in list.ranges.iter().enumerate() {
        let end = u64::from(range.first) + u64::from(range.count);
        if end > count as u64 {
            let problem = format!("ends at {end}, the model has {count} render vertices, counted from 0");
            return Err(Error::invalid(format!("{field}.vertices.ranges[{k}]"), problem));
        }
        marks[range.first as usize..end as usize].fill(true);
    }
    Ok(marks)
}

/// FollowedNodes of listed render vertices: their solver vertices, and the inside nodes nearest to those.
fn listed(ground: &RegionContext<'_>, marks: &[bool], mirror: Option<MirrorPlane>) -> ResolvedRegion {
    let mut surface = vec![false; ground.graph.surface];
    for (&solver, _) in ground
        .mesh
        .solver_from_render
        .iter()
        .zip(marks)
        .filter(|(s, m)| **m && **s != NONE)
    {
        surface[solver as usize] = true;
    }
    match mirror {
        None => from_surface(ground, &surface, marks.to_vec()),
        Some(mirror) => {
            let images = images(ground, mirror);
            let seen: Vec<bool> = images.iter().map(|o| o.is_some_and(|o| surface[o as usize])).collect();
            let render = render_of(ground, &seen);
            from_surface(ground, &seen, render)
        }
    }
}

/// The nodes whose nearest surface vertex is marked.
fn from_surface(ground: &RegionContext<'_>, surface: &[bool], render: Vec<bool>) -> ResolvedRegion {
    let nodes = (0u32..)
        .zip(&ground.graph.nearest_surface)
        .filter(|(_, s)| surface[**s as usize])
        .map(|(n, _)| n)
        .collect();
    ResolvedRegion {
        render,
        nodes,
        weights: None,
    }
}

fn render_of(ground: &RegionContext<'_>, surface: &[bool]) -> Vec<bool> {
    ground
        .mesh
        .solver_from_render
        .iter()
        .map(|s| *s != NONE && surface[*s as usize])
        .collect()
}

/// For every solver vertex the one whose mirror image it is: the nearest within half a mean edge of the exact place.
fn images(ground: &RegionContext<'_>, (normal, point): MirrorPlane) -> Vec<Option<u32>> {
    let tree = NearestPoints::new(ground.mesh.positions.iter().copied().zip(0u32..));
    let edge = 0.5 * mean_edge(ground.mesh);
    let reflect = |p: DVec3| p - normal * (2.0 * normal.dot(p - point));
    ground
        .mesh
        .positions
        .iter()
        .map(|&p| {
            tree.nearest(reflect(p))
                .filter(|(_, d)| *d <= edge * edge)
                .map(|(n, _)| n)
        })
        .collect()
}

fn mean_edge(mesh: &Mesh) -> f64 {
    let sum: f64 = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            (a.distance(b) + b.distance(c) + c.distance(a)) / 3.0
        })
        .sum();
    sum / mesh.triangles.len().max(1) as f64
}

fn weighted(
    ground: &RegionContext<'_>,
    values: &[f32],
    mirror: Option<MirrorPlane>,
    field: &str,
) -> Result<ResolvedRegion, Error> {
    let at = format!("{field}.weights.values");
    let count = ground.positions.len();
    if values.len() != count {
        return Err(Error::invalid(
            at,
            format!("has {} numbers, the model has {count} render vertices", values.len()),
        ));
    }
    if let Some(k) = values.iter().position(|w| !(0.0..=1.0).contains(w)) {
        return Err(Error::invalid(
            format!("{at}[{k}]"),
            format!("is {}, allowed are 0 to 1", values[k]),
        ));
    }
    let mut by_solver = vec![0f32; ground.graph.surface];
    for (&solver, &w) in ground
        .mesh
        .solver_from_render
        .iter()
        .zip(values)
        .filter(|(s, _)| **s != NONE)
    {
        by_solver[solver as usize] = by_solver[solver as usize].max(w);
    }
    let (by_solver, render) = match mirror {
        None => (by_solver, values.iter().map(|w| *w > 0.0).collect()),
        Some(mirror) => {
            let seen: Vec<f32> = images(ground, mirror)
                .iter()
                .map(|o| o.map_or(0.0, |o| by_solver[o as usize]))
                .collect();
            let marks: Vec<bool> = seen.iter().map(|w| *w > 0.0).collect();
            let render = render_of(ground, &marks);
            (seen, render)
        }
    };
    let marks: Vec<bool> = by_solver.iter().map(|w| *w > 0.0).collect();
    let mut resolved = from_surface(ground, &marks, render);
    let weight = |n: &u32| f64::from(by_solver[ground.graph.nearest_surface[*n as usize] as usize]);
    resolved.weights = Some(resolved.nodes.iter().map(weight).collect());
    Ok(resolved)
}

/// FollowedNodes and render vertices inside a solid.
fn inside(ground: &RegionContext<'_>, mirror: Option<MirrorPlane>, contains: impl Fn(DVec3) -> bool) -> ResolvedRegion {
    let seen = |p: DVec3| match mirror {
        None => contains(p),
        Some((normal, point)) => contains(p - normal * (2.0 * normal.dot(p - point))),
    };
    ResolvedRegion {
        render: ground.positions.iter().map(|&p| seen(p)).collect(),
        nodes: (0u32..)
            .zip(&ground.graph.positions)
            .filter(|(_, p)| seen(**p))
            .map(|(n, _)| n)
            .collect(),
        weights: None,
    }
}

fn polyline(values: &[f64], field: &str) -> Result<Vec<DVec3>, Error> {
    if values.len() < 6 || !values.len().is_multiple_of(3) {
        let problem = format!(
            "has {} numbers, a polyline has three for each of at least two points",
            values.len()
        );
        return Err(Error::invalid(field, problem));
    }
    for (k, v) in values.iter().enumerate() {
        number(*v, &format!("{field}[{k}]"))?;
    }
    Ok(values.chunks_exact(3).map(DVec3::from_slice).collect())
}

fn distance_to_segment(p: DVec3, from: DVec3, to: DVec3) -> f64 {
    p.distance(closest_point_on_segment(p, from, to))
}
