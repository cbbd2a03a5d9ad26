//! What a deformer reports about its model, solver, handles and shapes.
//!
//! Warnings about the interior name what did not fit into the memory that there is. Those about ties name what holds the
//! parts of a model together, and what a pose would tear.

use crate::asset::{Format, Primitive};
use crate::deform::{DeformableBody, HandleSystem, Transform, VolumeMode};
use crate::engine::handle::HandleSet;
use crate::engine::settings::DeformerLimits;
use crate::graph::TieAnchor;
use crate::mesh::{Components, Mesh, brief_number, brief_point};
use glam::DVec3;

/// What a deformer reports about model, solver and handles.
#[derive(Debug, Clone, PartialEq)]
pub struct DeformerFacts {
    /// The model as it was read, and its sizes now.
    pub model: ModelFacts,
    /// The runs of render vertices.
    pub primitives: Vec<Primitive>,
    /// What the solver works on.
    pub solver: SolverFacts,
    /// The handles in force.
    pub handles: Vec<HandleFacts>,
    /// What was noticed about model and handles.
    pub warnings: Vec<DeformerWarning>,
    /// What positions are relative to where they become 32-bit numbers ([`BoundingBox::origin`](crate::mesh::BoundingBox::origin)):
    /// that of the model as it was read, whatever edits do.
    pub origin: DVec3,
}

/// The model as it was read, and its sizes now.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelFacts {
    /// Its format.
    pub format: Format,
    /// Bytes of its files.
    pub file_bytes: u64,
    /// SHA-256 of the main file, lower-case hexadecimal.
    pub sha256: String,
    /// Vertices and triangles.
    pub counts: MeshCounts,
}

/// The sizes of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MeshCounts {
    /// Render vertices.
    pub vertices: u32,
    /// Triangles.
    pub faces: u32,
}

/// What the solver works on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SolverFacts {
    /// Vertices after welding.
    pub solver_vertices: u32,
    /// Vertices of the graph: solver vertices, shell and lattice.
    pub graph_vertices: u32,
    /// Edges of the graph, each counted once.
    pub graph_edges: u64,
    /// Connected parts of the mesh.
    pub components: u32,
    /// What holds them together.
    pub ties: TieFacts,
    /// Vertices and edges of each level of the hierarchy, finest first.
    pub levels: Vec<(u32, u64)>,
    /// Bytes held by the deformer.
    pub byte_size: u64,
    /// Parts that move as rigid bodies with no handle.
    pub stiff_parts: u32,
}

/// What holds the connected parts of a model together.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TieFacts {
    /// Edges that tie parts to each other, each counted once.
    pub ties: u64,
    /// Parts that neither ties nor a common inside join to any other, where there are several parts.
    pub loose_parts: u32,
    /// The largest of them, by falling number of vertices.
    pub loose: Vec<LoosePart>,
}

/// A connected part that nothing joins to any other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LoosePart {
    /// Its number among the connected parts.
    pub component: u32,
    /// Its render vertices.
    pub vertices: u32,
    /// The primitive that its first vertex belongs to.
    pub primitive: u32,
    /// The name of that primitive.
    pub name: String,
}

/// A handle in force.
#[derive(Debug, Clone, PartialEq)]
pub struct HandleFacts {
    /// Its name.
    pub id: String,
    /// Render vertices that it holds, after later handles took theirs.
    pub vertices: u32,
    /// Nodes inside the model that it holds, likewise.
    pub interior_nodes: u32,
    /// The mean rest position of its solver vertices; of its inside nodes when it holds no vertex.
    pub centroid: DVec3,
    /// The default pivot: the joint between it and what is free, the middle of where its rotation field falls near its border; the centroid
    /// where nothing is free around it, or it constrains no rotation.
    pub pivot: DVec3,
}

/// Something that a user should know; nothing was refused for it.
#[derive(Debug, Clone, PartialEq)]
pub struct DeformerWarning {
    /// A stable kebab-case code, such as "non-manifold-edges".
    pub code: String,
    /// What it is, for people.
    pub message: String,
    /// Where it is.
    pub place: WarningPlace,
}

/// Where the thing is that a warning is about.
#[derive(Debug, Clone, PartialEq)]
pub enum WarningPlace {
    /// Vertices, positions or a place in a file, in words; empty where there is nothing to say.
    Text(String),
    /// Places of the surface, with a render vertex at each.
    Vertices {
        /// The places in words.
        text: String,
        /// A render vertex at each place, in their order.
        vertices: Vec<u32>,
    },
    /// Places on the rest shape, model space.
    Points {
        /// The places in words.
        text: String,
        /// Where they are.
        points: Vec<DVec3>,
    },
    /// The handles with these indices.
    Handles(Vec<usize>),
    /// The region of interest.
    RegionOfInterest,
}

/// A shape against the rest shape, over the model's triangles.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct QualityReport {
    /// Root of the mean square of (length / rest length - 1) over edges.
    pub edge_rms: f64,
    /// Relative change of the enclosed volume; 0 for models without an inside.
    pub volume_change: f64,
    /// Whether the surface is open, so that it encloses no volume that could change.
    pub open_surface: bool,
    /// Relative change of the area.
    pub area_change: f64,
    /// Triangles whose normal opposes the rest normal as carried by the local rotation.
    pub flipped_triangles: u32,
    /// Largest singular value of any triangle's Jacobian.
    pub max_stretch: f64,
    /// Triangles with an edge, longer than 2 % of the diagonal, whose ends are turned against each other by more than 30°:
    /// they are too large to show the bend.
    pub faces_too_large: u32,
    /// Pairs of triangles that cross, when asked for.
    pub self_intersections: Option<u32>,
    /// Those of them that do not cross in the rest pose.
    pub new_self_intersections: Option<u32>,
    /// With stiff parts: the largest distance of a vertex of one from a rigid motion of its rest shape, as a share of the part's
    /// diagonal.
    pub off_rigid: Option<f64>,
}

impl MeshCounts {
    /// Counts as reports have them.
    pub(super) fn of(vertices: usize, faces: usize) -> Self {
        Self {
            vertices: count_u32(vertices),
            faces: count_u32(faces),
        }
    }
}

impl DeformerWarning {
    /// Makes a warning about a place described in words.
    pub fn new(code: impl Into<String>, message: impl Into<String>, place: impl Into<String>) -> Self {
        Self {
            code: code.into(),
            message: message.into(),
            place: WarningPlace::Text(place.into()),
        }
    }

    /// Makes a warning about handles.
    pub(super) fn about_handles(code: &str, message: String, handles: impl Into<Vec<usize>>) -> Self {
        Self {
            code: code.into(),
            message,
            place: WarningPlace::Handles(handles.into()),
        }
    }
}

/// Turns a count into the number that reports carry.
pub(super) fn count_u32(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

/// Bytes that a graph node costs a session at its most, which is while a commit is looked at for folds: graph, hierarchy, systems,
/// the fields of two handles, solutions and scratch, also where it is solved again because it folds. `tests/memory_estimate.rs` measures it, for both kinds of graph.
pub(super) const BYTES_PER_NODE: u64 = 880;

/// What a budget is divided by to find how many nodes it has room for. More than nodes take, for the fields of many handles and for
/// commits; stored sessions that were limited by it are rebuilt with it.
const ROOM_PER_NODE: u64 = 1750;

/// How many places one warning spells out.
const PLACES: usize = 16;

/// The most nodes that a graph may have to fit into `limits` beside `other` bytes.
pub(super) fn most_nodes(other: u64, limits: &DeformerLimits) -> usize {
    let bytes = limits.graph_bytes.unwrap_or(limits.memory_bytes);
    let nodes = bytes.saturating_sub(other) / ROOM_PER_NODE;
    usize::try_from(nodes).unwrap_or(usize::MAX)
}

/// What is unusual about the interior of a body that was built in `mode`.
pub(super) fn interior_warnings(body: &DeformableBody, mode: VolumeMode) -> Vec<DeformerWarning> {
    let warning = |code: &str, message: String, place: String| DeformerWarning::new(code, message, place);
    if mode == VolumeMode::Off {
        return Vec::new();
    }
    let (graph, stats) = (&body.graph, &body.graph.stats);
    if let Some(reason) = &body.too_large {
        let message = format!("{reason}; the model deforms as a surface");
        return vec![warning("volume-graph-too-large", message, String::new())];
    }
    if graph.surface == body.nodes() && stats.struts == 0 {
        let message = "the model encloses no volume, so it deforms as a surface";
        return vec![warning("no-volume-graph", message.into(), String::new())];
    }
    let mut warnings = Vec::new();
    // A lattice is widened by more than rounding, or not at all.
    if stats.interval > stats.wanted_interval * 1.001 {
        let message = format!(
            "interior nodes are {} apart instead of {}, because more of them do not fit",
            brief_number(stats.interval),
            brief_number(stats.wanted_interval)
        );
        warnings.push(warning("volume-graph-coarse", message, String::new()));
    }
    // Ties make one component of several parts.
    let (component, has_volume) = match &graph.ties {
        Some(ties) => (ties.untied_component(), ties.component_has_volume()),
        None => (&graph.component[..], &stats.component_has_volume[..]),
    };
    let sheets = has_volume.iter().filter(|has| !**has).count();
    if sheets > 0 {
        let mut first = vec![None; has_volume.len()];
        for (node, &c) in component[..graph.surface].iter().enumerate().rev() {
            first[c as usize] = Some(graph.positions[node]);
        }
        let points: Vec<DVec3> = first
            .iter()
            .zip(has_volume)
            .filter_map(|(p, has)| p.filter(|_| !has))
            .take(PLACES)
            .collect();
        let places: Vec<String> = points.iter().map(|&p| format!("at {}", brief_point(p))).collect();
        let message = match has_volume.len() {
            1 => "its only part encloses no volume or too little, so it deforms as a surface".into(),
            parts => format!("{sheets} of {parts} parts enclose no volume or too little, so they deform as surfaces"),
        };
        let more = sheets.saturating_sub(PLACES);
        let more = if more > 0 {
            format!("; and {more} more")
        } else {
            String::new()
        };
        let text = places.join("; ") + &more;
        warnings.push(DeformerWarning {
            place: WarningPlace::Points { text, points },
            ..warning("surface-parts", message, String::new())
        });
    }
    warnings
}

/// How many loose parts are listed.
const MOST_LISTED: usize = 16;
/// Parts are pulled apart where two handles take one place further apart than this part of the diagonal.
const PULLED: f64 = 0.01;
/// How many pairs of handles one warning is made for.
const MOST_PAIRS: usize = 8;

/// Counts ties, and parts that nothing joins to others.
pub(super) fn tie_facts(mesh: &Mesh, parts: &Components, body: &DeformableBody, primitives: &[Primitive]) -> TieFacts {
    let graph = &body.graph;
    let ties = graph.ties.as_ref().map_or(0, |ties| ties.edge_count() as u64);
    if parts.count < 2 {
        return TieFacts::default();
    }
    // Parts that share their inside are joined by it.
    let mut parts_of = vec![0u32; graph.components];
    let firsts = parts.first_vertices();
    let whole = |part: usize| graph.component[firsts[part] as usize] as usize;
    (0..parts.count).for_each(|part| parts_of[whole(part)] += 1);
    let mut vertices = vec![0u32; parts.count];
    for (point, &part) in (0u32..).zip(&parts.of_vertex) {
        vertices[part as usize] += mesh.render_vertices_of(point).len() as u32;
    }
    let mut loose: Vec<usize> = (0..parts.count).filter(|&part| parts_of[whole(part)] == 1).collect();
    let count = loose.len();
    loose.sort_by_key(|&part| (std::cmp::Reverse(vertices[part]), part));
    loose.truncate(MOST_LISTED);
    let listed = |part: usize| {
        let vertex = mesh.render_vertices_of(firsts[part])[0];
        let primitive = primitive_at(primitives, vertex);
        LoosePart {
            component: part as u32,
            vertices: vertices[part],
            primitive: primitive as u32,
            name: primitives.get(primitive).map_or_else(String::new, |p| p.name.clone()),
        }
    };
    TieFacts {
        ties,
        loose_parts: count_u32(count),
        loose: loose.into_iter().map(listed).collect(),
    }
}

/// The primitive that a render vertex belongs to.
fn primitive_at(primitives: &[Primitive], vertex: u32) -> usize {
    primitives
        .partition_point(|p| p.first_vertex <= vertex)
        .saturating_sub(1)
}

/// A pose that pulls apart what ties hold together.
pub(super) struct PulledTies<'a> {
    pub body: &'a DeformableBody,
    pub system: &'a HandleSystem,
    pub mesh: &'a Mesh,
    pub primitives: &'a [Primitive],
    pub handles: &'a HandleSet,
}

/// Tied places that one pair of handles takes apart.
struct PulledPair {
    holders: [usize; 2],
    /// How far the worst place comes apart, and the vertices of its tie.
    gap: f64,
    ends: [u32; 2],
    places: usize,
}

impl PulledTies<'_> {
    /// One warning for each pair of handles that hold tied places of two parts and take them apart.
    pub fn pull_warnings(&self, transforms: &[Transform]) -> Vec<DeformerWarning> {
        let Some(ties) = &self.body.graph.ties else {
            return Vec::new();
        };
        let maps: Vec<_> = transforms.iter().map(Transform::map).collect();
        let mut pulled: Vec<PulledPair> = Vec::new();
        for anchor in ties.anchors() {
            let Some(pull) = self.pull_of(anchor, &maps) else {
                continue;
            };
            match pulled.iter().position(|p| p.holders == pull.holders) {
                Some(known) => {
                    let known = &mut pulled[known];
                    known.places += 1;
                    if pull.gap > known.gap {
                        (known.gap, known.ends) = (pull.gap, pull.ends);
                    }
                }
                None if pulled.len() < MOST_PAIRS => pulled.push(pull),
                None => {}
            }
        }
        pulled.sort_by_key(|p| p.holders);
        pulled.iter().map(|p| self.describe_pull(p)).collect()
    }

    /// How far the ends of a tie, held by two handles, come apart, if that is far.
    fn pull_of(&self, anchor: &TieAnchor, maps: &[impl Fn(DVec3) -> DVec3]) -> Option<PulledPair> {
        let rest = &self.body.graph.positions;
        let held = |v: u32| self.system.hard_holder(v as usize);
        let first = held(anchor.vertex)?;
        let (corner, _) = anchor.weighted_corners().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let second = held(corner)?;
        if first == second {
            return None;
        }
        let at = rest[anchor.vertex as usize];
        // Where each of the two handles would take the same place.
        let gap = maps.get(first)?(at).distance(maps.get(second)?(at));
        let far = gap > PULLED * self.body.diagonal;
        far.then_some(PulledPair {
            holders: [first.min(second), first.max(second)],
            gap,
            ends: [anchor.vertex, corner],
            places: 1,
        })
    }

    fn describe_pull(&self, pull: &PulledPair) -> DeformerWarning {
        let PulledPair {
            holders,
            gap,
            ends,
            places,
        } = *pull;
        let name = |v: u32| {
            let vertex = self.mesh.render_vertices_of(v)[0];
            let index = primitive_at(self.primitives, vertex);
            match self.primitives.get(index).map(|p| p.name.as_str()) {
                Some("") | None => format!("primitive {index}"),
                Some(name) => format!("\"{name}\""),
            }
        };
        // Mirror images of handles come after them all.
        let handles = &self.handles.handles;
        let id = |k: usize| &handles[k % handles.len()].id;
        let message = format!(
            "handles \"{}\" and \"{}\" take tied places of {} and {} apart, by up to {:.3} ({:.1} % of the diagonal) at {places} \
             of them; give the parts one pose, or keep one apart (keepApart)",
            id(holders[0]),
            id(holders[1]),
            name(ends[0]),
            name(ends[1]),
            gap,
            100.0 * gap / self.body.diagonal,
        );
        DeformerWarning::about_handles("parts-pulled-apart", message, holders)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::{FileSet, shapes};
    use crate::engine::{Deformer, Error, OpenOptions};
    use crate::exec::Exec;
    use crate::graph::InteriorKind;
    use crate::pool::Pool;
    use crate::progress::Silent;

    /// A cube of 1,538 vertices, with an open square beside it when asked for.
    fn open(memory_bytes: u64, mode: VolumeMode, sheet: bool) -> Result<Deformer, Error> {
        open_as(InteriorKind::Shape, memory_bytes, mode, sheet)
    }

    fn open_as(kind: InteriorKind, memory_bytes: u64, mode: VolumeMode, sheet: bool) -> Result<Deformer, Error> {
        let (positions, triangles) = shapes::box_with_cells(DVec3::ONE, [16; 3]);
        let mut text = String::new();
        positions
            .iter()
            .for_each(|p| text += &format!("v {} {} {}\n", p.x, p.y, p.z));
        triangles
            .iter()
            .for_each(|t| text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
        if sheet {
            text += "v 3 0 0\nv 4 0 0\nv 4 1 0\nv 3 1 0\nf -4 -3 -2 -1\n";
        }
        let mut options = OpenOptions::default();
        options.body.volume = mode;
        options.body.graph.kind = kind;
        let limits = DeformerLimits {
            memory_bytes,
            ..Default::default()
        };
        let pool = Pool::new(1).unwrap();
        Deformer::open(
            FileSet::single("cube.obj", text),
            &options,
            &limits,
            &Exec::new(&pool, &Silent),
        )
    }

    fn codes(bench: &Deformer) -> Vec<String> {
        bench.facts().warnings.into_iter().map(|w| w.code).collect()
    }

    #[test]
    fn what_does_not_fit_gets_a_wider_lattice_then_none_and_says_so() {
        let whole = open(1 << 30, VolumeMode::Auto, false).unwrap();
        assert!(codes(&whole).is_empty(), "{:?}", codes(&whole));
        let open = |bytes: u64, mode: VolumeMode, sheet: bool| open_as(InteriorKind::Paper, bytes, mode, sheet);
        let surface = whole.body().graph.surface as u64;
        // What files, vertices and so many nodes take.
        let room = |nodes: u64| {
            let beside = whole.estimate() - whole.body().nodes() as u64 * BYTES_PER_NODE;
            beside + nodes * ROOM_PER_NODE
        };
        let coarse = open_as(InteriorKind::Shape, room(surface * 5 / 4), VolumeMode::Auto, false).unwrap();
        assert_eq!(codes(&coarse), ["volume-graph-coarse"]);
        assert!(coarse.body().nodes() < whole.body().nodes() && coarse.body().graph.stats.lattice_nodes > 0);
        let whole = open(1 << 30, VolumeMode::Auto, false).unwrap();
        let coarse = open(room(surface * 5 / 2), VolumeMode::Auto, false).unwrap();
        assert_eq!(codes(&coarse), ["volume-graph-coarse"]);
        assert!(coarse.body().nodes() < whole.body().nodes() && coarse.body().graph.stats.lattice_nodes > 0);
        let none = open(room(surface * 3 / 2), VolumeMode::Auto, false).unwrap();
        assert_eq!(codes(&none), ["volume-graph-too-large"]);
        assert_eq!(none.body().nodes() as u64, surface);
        assert!(open(room(surface * 3 / 2), VolumeMode::Required, false).is_err());
        assert!(matches!(
            open(room(surface / 2), VolumeMode::Auto, false),
            Err(Error::TooLarge { .. })
        ));
    }

    #[test]
    fn parts_without_an_inside_are_counted_and_placed() {
        let bench = open(1 << 30, VolumeMode::Auto, true).unwrap();
        let facts = bench.facts();
        let warning = facts.warnings.iter().find(|w| w.code == "surface-parts").unwrap();
        assert_eq!(
            warning.message,
            "1 of 2 parts enclose no volume or too little, so they deform as surfaces"
        );
        let place = WarningPlace::Points {
            text: "at (3, 0, 0)".into(),
            points: vec![DVec3::X * 3.0],
        };
        assert_eq!(warning.place, place);
        assert!(!codes(&open(1 << 30, VolumeMode::Off, true).unwrap()).contains(&"surface-parts".into()));
    }
}
