//! Primitives and nodes of a model's file that ride along: which they are, and where they go in a shape.

use crate::asset::{Model, ModelNode, NodeMotions, Primitive};
use crate::engine::error::Error;
use crate::engine::facts::DeformerWarning;
use crate::engine::settings::{Passenger, PassengerKind};
use crate::exec::Exec;
use crate::mesh::carry::{CarriedFrame, CarriedPoints, CarrySurface, PackedPoints, SurfaceCarrier, SurfaceMotion};
use crate::mesh::rotation::fit_rotation;
use crate::mesh::{Mesh, NONE};
use crate::pool::Pool;
use crate::progress::Cancelled;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::collections::BTreeMap;
use std::ops::Range;

/// What finding what one vertex of a passenger follows may look at on average: some tens of microseconds. Where faces are of about
/// one size it looks at a hundredth of it.
const VISITS_PER_VERTEX: u64 = 8192;
/// The same for any passengers: some seconds.
const LEAST_VISITS: u64 = 1 << 31;
/// The same for vertices in no triangle, which ride along without being asked to: a few seconds at most.
pub(super) const VISITS_PER_LOOSE_VERTEX: u64 = 128;
pub(super) const LEAST_LOOSE_VISITS: u64 = 1 << 24;
/// Vertices after which what was looked at and what is held are counted: the first time, and at most, because those near each other
/// are found faster together.
const FIRST_BLOCK: usize = 512;
const LARGEST_BLOCK: u64 = 1 << 16;
/// About what one block after that looks at: some tenths of a second.
const VISITS_PER_BLOCK: u64 = 1 << 23;

/// How many vertices are bound before what was looked at is counted again, where `visits` were made for `bound` vertices.
fn next_block(bound: usize, visits: u64) -> usize {
    let block = VISITS_PER_BLOCK * bound as u64 / visits.max(1);
    block.clamp(FIRST_BLOCK as u64, LARGEST_BLOCK) as usize
}

/// Marks the primitives that ride along.
///
/// # Errors
/// [`Error::Invalid`] with the passenger's index for a primitive that is not there or marked twice, and when nothing is left to
/// be solved.
pub(super) fn mark_passengers(primitives: &mut [Primitive], passengers: &[Passenger]) -> Result<(), Error> {
    for (k, passenger) in passengers.iter().enumerate() {
        let refuse = |problem: String| Err(Error::invalid(format!("passengers[{k}]"), problem));
        let count = primitives.len();
        let meant: Vec<usize> = match &passenger.kind {
            PassengerKind::Primitive(index) if (*index as usize) < count => vec![*index as usize],
            PassengerKind::Primitive(index) => {
                return refuse(format!(
                    "is primitive {index}, the model has {}, counted from 0",
                    number_of_primitives(count)
                ));
            }
            PassengerKind::PrimitivesNamed(name) => {
                let is_named = |p: &usize| primitives[*p].name == *name;
                let named: Vec<usize> = (0..count).filter(is_named).collect();
                if named.is_empty() {
                    let shown = clip_name(name);
                    let names: Vec<String> = primitives.iter().take(8).map(|p| format!("\"{}\"", p.name)).collect();
                    let names = names.join(", ");
                    return refuse(format!("no primitive is named \"{shown}\", there are {names}"));
                }
                named
            }
            PassengerKind::Node(_)
            | PassengerKind::NodesNamed(_)
            | PassengerKind::Points { .. }
            | PassengerKind::Model(_) => continue,
        };
        for index in meant {
            let primitive = &mut primitives[index];
            // Points and lines are passengers without being named.
            if std::mem::replace(&mut primitive.is_passenger, true) && primitive.index_count > 0 {
                return refuse(format!("primitive {index} is a passenger already"));
            }
        }
        if primitives.iter().all(|p| p.is_passenger || p.index_count == 0) {
            return refuse("nothing is left to be solved: every primitive with triangles is a passenger".into());
        }
    }
    Ok(())
}

/// So many primitives, in words.
pub(super) fn number_of_primitives(count: usize) -> String {
    match count {
        1 => "1 primitive".into(),
        _ => format!("{count} primitives"),
    }
}

/// As much of a name as a refusal repeats.
pub(super) fn clip_name(name: &str) -> String {
    name.chars().take(64).collect()
}

/// The render vertices that ride along, with what they follow: those of passengers, and those in no triangle.
#[derive(Debug, Clone)]
pub(super) struct RidingVertices {
    vertices: Vec<u32>,
    points: CarriedPoints,
    /// Vertices that lie where a vertex of the surface is, each with that one: they go with it, bit for bit.
    on_vertices: Vec<(u32, u32)>,
    /// How many vertices in no triangle stay where they are, because finding what they follow would take too long.
    left_behind: usize,
}

/// A model of which vertices ride along.
#[derive(Clone, Copy)]
pub(super) struct RidingModel<'a> {
    pub mesh: &'a Mesh,
    pub primitives: &'a [Primitive],
    /// Where the render vertices are in the rest pose.
    pub rest: &'a [DVec3],
    /// Whether those in no triangle do, of primitives that are no passengers.
    pub loose: bool,
    /// Whether it is of splats, which ride along because they were asked for.
    pub of_splats: bool,
}

impl RidingModel<'_> {
    /// Vertices of passengers with triangles, which are carried as bodies of their own.
    fn of_bodies(self) -> Vec<u32> {
        let bodies = self.primitives.iter().filter(|p| p.is_passenger && p.index_count > 0);
        bodies.flat_map(Primitive::vertices).map(|v| v as u32).collect()
    }

    /// Vertices of points and lines, and others in no triangle.
    pub fn loose(self) -> Vec<u32> {
        let own = self.primitives.iter().filter(|p| match p.is_passenger {
            true => p.index_count == 0,
            false => self.loose,
        });
        let vertices = own.flat_map(Primitive::vertices);
        let is_loose = |v: &usize| self.mesh.solver_from_render[*v] == NONE;
        vertices.filter(is_loose).map(|v| v as u32).collect()
    }

    /// Divides loose vertices into those at a vertex of the surface, with that one, and the others.
    pub fn part_by_place(self, loose: Vec<u32>) -> (Vec<(u32, u32)>, Vec<u32>) {
        if loose.is_empty() {
            return Default::default();
        }
        // Adding zero makes of minus zero plain zero.
        let place = |v: u32| (self.rest[v as usize] + DVec3::ZERO).to_array().map(f64::to_bits);
        let surface = (0u32..).zip(&self.mesh.solver_from_render).filter(|(_, s)| **s != NONE);
        let mut places: Vec<([u64; 3], u32)> = surface.map(|(v, _)| (place(v), v)).collect();
        places.sort_unstable();
        places.dedup_by_key(|(place, _)| *place);
        let (mut there, mut others) = (Vec::new(), Vec::new());
        for vertex in loose {
            match places.binary_search_by_key(&place(vertex), |(place, _)| *place) {
                Ok(at) => there.push((vertex, places[at].1)),
                Err(_) => others.push(vertex),
            }
        }
        (there, others)
    }
}

impl RidingVertices {
    /// Finds what every vertex that rides along follows. `admit` says whether so many bytes may be held.
    ///
    /// # Errors
    /// [`Error::Precondition`] when that looks at too much for vertices of passengers, [`Error::Cancelled`], and those of `admit`.
    pub fn bind(
        surface: &CarrySurface,
        model: RidingModel<'_>,
        admit: impl Fn(u64) -> Result<(), Error>,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let mut vertices = model.of_bodies();
        let bodies = vertices.len();
        let (on_vertices, loose) = model.part_by_place(model.loose());
        vertices.extend(loose);
        let mut riders = Self {
            points: CarriedPoints::default(),
            vertices,
            on_vertices,
            left_behind: 0,
        };
        let limit = LEAST_VISITS + VISITS_PER_VERTEX * bodies as u64;
        let bind_all = |riders: &mut Self, range: Range<usize>, limit: u64| -> Result<bool, Error> {
            let (mut at, mut visits) = (range.start, 0);
            while at < range.end {
                let end = range.end.min(at + next_block(at - range.start, visits));
                let places: Vec<DVec3> = riders.vertices[at..end]
                    .iter()
                    .map(|&v| model.rest[v as usize])
                    .collect();
                visits += riders.points.bind_more(surface, &places, exec)?;
                if visits > limit {
                    return Ok(false);
                }
                admit(riders.byte_size() as u64)?;
                at = end;
            }
            Ok(true)
        };
        if !bind_all(&mut riders, 0..bodies, limit)? {
            return Err(Error::Precondition(format!(
                "finding what the vertices of passengers follow takes more than {limit} comparisons, because faces are as \
                 long as the model; remesh the model to give it faces of about one size, or open it without these passengers"
            )));
        }
        let all = riders.vertices.len();
        let loose = all - bodies;
        let limit = match model.of_splats {
            true => LEAST_VISITS + VISITS_PER_VERTEX * loose as u64,
            false => LEAST_LOOSE_VISITS + VISITS_PER_LOOSE_VERTEX * loose as u64,
        };
        let bound = riders.points.clone();
        if !bind_all(&mut riders, bodies..all, limit)? {
            // All of them stay: a cloud is not torn.
            riders.points = bound;
            riders.left_behind = loose;
        }
        Ok(riders)
    }

    /// What is to be said of vertices that could not be bound.
    pub fn warning(&self) -> Option<DeformerWarning> {
        (self.left_behind > 0).then(|| {
            let message = format!(
                "{} vertices in no triangle stay where they are, because faces are as long as the model and finding what they \
                 follow takes too long; remesh the model to give it faces of about one size",
                self.left_behind
            );
            DeformerWarning::new("loose-vertices-stay", message, "")
        })
    }

    /// Writes where they are when the surface is at `current`, among the positions of all render vertices.
    pub fn place(&self, surface: &CarrySurface, current: &[DVec3], positions: &mut [DVec3], pool: &Pool) {
        let motion = SurfaceMotion::between(surface, current, pool);
        let carried = self.points.carried_by(&motion, pool);
        for (&vertex, frame) in self.vertices.iter().zip(&carried) {
            positions[vertex as usize] = frame.position;
        }
        for &(vertex, like) in &self.on_vertices {
            positions[vertex as usize] = positions[like as usize];
        }
    }

    /// Those with what they follow, packed for frames.
    pub fn packed(&self, surface: &CarrySurface, pool: &Pool) -> PackedPoints {
        PackedPoints::pack(&self.points, &self.vertices, surface, pool)
    }

    /// Vertices that lie where a vertex of the surface is, each with that one.
    pub fn on_vertices(&self) -> &[(u32, u32)] {
        &self.on_vertices
    }

    /// The points of `count` vertices from 0 on, where all of those ride along, each bound, and no others do.
    pub fn points_of_first(&self, count: usize) -> Option<&CarriedPoints> {
        let all = self.vertices.iter().zip(0..).all(|(vertex, k)| *vertex == k);
        (all && self.vertices.len() == count && self.points.len() == count).then_some(&self.points)
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        (self.vertices.capacity() + 2 * self.on_vertices.capacity()) * 4 + self.points.byte_size()
    }
}

/// How many names a refusal lists.
const NAMES_LISTED: usize = 8;

/// A node of the model's file that rode along, where it is in a shape.
#[derive(Debug, Clone, PartialEq)]
pub struct CarriedNode {
    /// The passenger that it is or belongs to, by its index in [`OpenOptions::passengers`](super::OpenOptions::passengers).
    pub passenger: usize,
    /// Its index in the file.
    pub node: usize,
    /// Its name; empty without one.
    pub name: String,
    /// Where its origin is, how its axes are turned in world space, and how many times as large lengths around it are. Its own
    /// scale stays as it is.
    pub frame: CarriedFrame,
}

/// The nodes of a model that ride along, in the order of passengers and then of the file.
#[derive(Debug, Clone, Default)]
pub(super) struct RidingNodes(Vec<RidingNode>);

#[derive(Debug, Clone)]
struct RidingNode {
    passenger: usize,
    node: usize,
    name: String,
    /// Where its origin is in the file.
    origin: DVec3,
    /// How its axes are turned there.
    axes: DQuat,
    /// Where the rest pose in force has carried it: an edit of the current shape makes that shape the rest pose.
    carried: CarriedFrame,
}

impl RidingNodes {
    /// Finds the nodes that ride along.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the passenger's index for a node that is not there, is named twice, or is a joint.
    pub fn find(model: &Model, passengers: &[Passenger]) -> Result<Self, Error> {
        let is_node = |p: &Passenger| matches!(p.kind, PassengerKind::Node(_) | PassengerKind::NodesNamed(_));
        let Some(first) = passengers.iter().position(is_node) else {
            return Ok(Self::default());
        };
        let Some(nodes) = model.nodes()? else {
            let problem = format!("is a node, but the model is {}; only glTF has nodes", model.format);
            return Err(Error::invalid(format!("passengers[{first}]"), problem));
        };
        let mut named: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (index, node) in nodes.iter().enumerate() {
            named.entry(&node.name).or_default().push(index);
        }
        let mut riding = Vec::new();
        let mut taken = vec![false; nodes.len()];
        for (k, passenger) in passengers.iter().enumerate() {
            let refuse = |problem: String| Error::invalid(format!("passengers[{k}]"), problem);
            let meant = match &passenger.kind {
                PassengerKind::Node(index) if (*index as usize) < nodes.len() => vec![*index as usize],
                PassengerKind::Node(index) => {
                    let count = nodes.len();
                    return Err(refuse(format!(
                        "is node {index}, the model has {count} nodes, counted from 0"
                    )));
                }
                PassengerKind::NodesNamed(name) => match named.get(name.as_str()) {
                    Some(meant) => meant.clone(),
                    None => return Err(refuse(no_node_named(name, &nodes))),
                },
                PassengerKind::Primitive(_)
                | PassengerKind::PrimitivesNamed(_)
                | PassengerKind::Points { .. }
                | PassengerKind::Model(_) => continue,
            };
            for index in meant {
                let node = &nodes[index];
                if node.is_joint {
                    let problem = format!(
                        "node {index} \"{}\" is a joint of a skin; what joints do is said by rig, name others alone",
                        clip_name(&node.name)
                    );
                    return Err(refuse(problem));
                }
                if std::mem::replace(&mut taken[index], true) {
                    return Err(refuse(format!("node {index} is a passenger already")));
                }
                riding.push(RidingNode::at_rest(k, index, node));
            }
        }
        Ok(Self(riding))
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Carries all from the rest pose in force to a shape.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn carried_along(&self, carrier: &SurfaceCarrier, exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let places: Vec<DVec3> = self.0.iter().map(|node| node.carried.position).collect();
        let moved = carrier.carry_points(&places, exec)?;
        let carry_on = |(node, moved): (&RidingNode, CarriedFrame)| RidingNode {
            carried: CarriedFrame {
                position: moved.position,
                rotation: moved.rotation * node.carried.rotation,
                scale: moved.scale * node.carried.scale,
            },
            ..node.clone()
        };
        Ok(Self(self.0.iter().zip(moved).map(carry_on).collect()))
    }

    /// The rigid motions from where the file has them.
    pub fn motions(&self) -> NodeMotions {
        self.0.iter().map(|node| (node.node, node.motion())).collect()
    }

    /// Where they are.
    pub fn places(&self) -> Vec<CarriedNode> {
        let carried = |node: &RidingNode| CarriedNode {
            passenger: node.passenger,
            node: node.node,
            name: node.name.clone(),
            frame: CarriedFrame {
                rotation: (node.carried.rotation * node.axes).normalize(),
                ..node.carried
            },
        };
        self.0.iter().map(carried).collect()
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let names: usize = self.0.iter().map(|node| node.name.capacity()).sum();
        names + self.0.capacity() * size_of::<RidingNode>()
    }
}

impl RidingNode {
    fn at_rest(passenger: usize, index: usize, node: &ModelNode) -> Self {
        let DAffine3 { matrix3, translation } = node.world_from_node;
        // Of what is mirrored the axes without the mirror, which is taken to be across x as engines do.
        let side = matrix3.determinant().signum();
        let unmirrored = DMat3::from_cols(matrix3.x_axis * side, matrix3.y_axis, matrix3.z_axis);
        Self {
            passenger,
            node: index,
            name: node.name.clone(),
            origin: translation,
            axes: fit_rotation(unmirrored),
            carried: CarriedFrame::resting(translation),
        }
    }

    /// `None` where nothing around it has moved.
    fn motion(&self) -> Option<DAffine3> {
        let CarriedFrame { position, rotation, .. } = self.carried;
        if position == self.origin && rotation == DQuat::IDENTITY {
            return None;
        }
        let turn = DMat3::from_quat(rotation.normalize());
        let motion = DAffine3 {
            matrix3: turn,
            translation: position - turn * self.origin,
        };
        motion.is_finite().then_some(motion)
    }
}

/// Why a name means no node, with names that would.
fn no_node_named(name: &str, nodes: &[ModelNode]) -> String {
    let can_ride = nodes.iter().filter(|node| !node.is_joint && !node.name.is_empty());
    let names: Vec<String> = can_ride
        .take(NAMES_LISTED)
        .map(|node| format!("\"{}\"", clip_name(&node.name)))
        .collect();
    let there = match names.is_empty() {
        true => "and none that could ride along has a name; name it by its index".into(),
        false => format!("there are {}", names.join(", ")),
    };
    format!("no node is named \"{}\", {there}", clip_name(name))
}
