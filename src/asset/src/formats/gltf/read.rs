//! From a document to world-space triangles.

use super::accessors::{ComponentType, ShapeAttribute};
use super::document::{GltfDocument, ParsedDocument};
use super::draco;
use super::elements::{indices_beyond, to_triangles};
use super::placement::{Placement, SkinPose, SkinSeams, VertexInfluences, VertexTransforms};
use super::scene::{self, MeshPlacement, PlacedScene};
use super::schema::{DRACO, MeshPrimitive};
use super::stored::ViewDecoding;
use crate::files::{ReadWatch, within};
use crate::model::FileNotes;
use crate::{Error, FileSet, Format, Geometry, Limits, Model, Primitive};
use glam::{DMat3, DVec3, Vec3, Vec4};
use pliant_exec::progress::{Progress, Silent};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Placed primitives. A node costs a dozen bytes in a file and places a whole mesh, so their number is not bounded by
/// the file's size, and each costs far more here than its vertices do.
const MOST_ROWS: u64 = 1 << 18;

/// One row of the primitive table, as the writer needs it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlacedPrimitive {
    pub(super) node: usize,
    pub(super) mesh: usize,
    pub(super) primitive: usize,
    /// The skin of its node.
    pub(super) skin: Option<usize>,
    /// Whether the joints of that skin place it.
    pub(super) follows_joints: bool,
    /// How its stored vertices get into the world.
    pub(super) placement: Placement,
    /// Whether that turns it inside out, so that its triangles are wound the other way round than its indices.
    pub(super) is_mirrored: bool,
    /// Its first render vertex, and one past its last.
    pub(super) vertices: std::ops::Range<usize>,
    /// Its first triangle, and one past its last.
    pub(super) triangles: std::ops::Range<usize>,
}

/// What the writers have to remember of a file: its parsed document, and where the rows of the primitive table came from.
#[derive(Debug)]
pub(super) struct GltfNotes {
    document: Arc<ParsedDocument>,
    pub(super) rows: Vec<PlacedPrimitive>,
    /// Nodes of the scene that have a mesh, ascending.
    pub(super) placed: Vec<usize>,
    /// The files without Draco, where they were uploaded with it.
    pub(super) uncompressed: Option<FileSet>,
}

impl GltfNotes {
    /// The files that the model was read from: those uploaded, or their form without Draco.
    pub(super) fn files<'a>(&'a self, model: &'a Model) -> &'a FileSet {
        self.uncompressed.as_ref().unwrap_or(&model.files)
    }

    /// The document of the model, as it was parsed when the model was read.
    pub(super) fn document<'a>(&'a self, model: &'a Model) -> Result<GltfDocument<'a>, Error> {
        self.document.of(self.files(model))
    }

    /// The document of the model with the bytes of its buffers.
    pub(super) fn loaded_document<'a>(&'a self, model: &'a Model) -> Result<GltfDocument<'a>, Error> {
        self.document_to_write(model, None)
    }

    /// As [`GltfNotes::loaded_document`], for work that may be cancelled.
    pub(super) fn document_to_write<'a>(
        &'a self,
        model: &'a Model,
        progress: Option<&'a dyn Progress>,
    ) -> Result<GltfDocument<'a>, Error> {
        let mut document = self.document(model)?;
        document.bytes.decoding = ViewDecoding {
            apart: model.apart,
            progress,
        };
        document.load_bytes(self.files(model), None)
    }
}

impl FileNotes for GltfNotes {
    fn bytes_held(&self) -> u64 {
        self.document.bytes_held() + self.uncompressed.as_ref().map_or(0, FileSet::total_bytes)
    }
}

/// Parses a document and checks its references.
fn parse(files: &FileSet, format: Format, watch: &ReadWatch<'_>) -> Result<ParsedDocument, Error> {
    let parsed = ParsedDocument::parse(files, format, watch)?;
    super::references::check(&parsed.of(files)?)?;
    Ok(parsed)
}

/// Parses a document that was just written, and so is within limits.
pub(super) fn parse_written(files: &FileSet, format: Format) -> Result<ParsedDocument, Error> {
    parse(files, format, &ReadWatch::new(&Limits::UNLIMITED, &Silent, 0))
}

/// Reads a model, checking everything it relies on.
pub(super) fn read(files: &FileSet, format: Format, watch: &ReadWatch<'_>) -> Result<(Geometry, GltfNotes), Error> {
    let parsed = Arc::new(parse(files, format, watch)?);
    if parsed.uses(DRACO) {
        let doc = parsed.of(files)?.load_bytes(files, Some(watch))?;
        if let Some((plain, count)) = draco::uncompress(&doc, files, watch)? {
            drop(doc);
            let parsed = Arc::new(parse(&plain, format, watch)?);
            let (mut geometry, mut notes) = read_document(&parsed, &plain, format, watch)?;
            let were = if count == 1 { "primitive was" } else { "primitives were" };
            let message = format!("{count} {were} compressed with Draco; a changed model comes back without it");
            geometry.warn("draco-decoded", message, "meshes");
            notes.uncompressed = Some(plain);
            return Ok((geometry, notes));
        }
    }
    read_document(&parsed, files, format, watch)
}

/// Reads a document without Draco, or with what it holds uncompressed beside it.
fn read_document(
    parsed: &Arc<ParsedDocument>,
    files: &FileSet,
    format: Format,
    watch: &ReadWatch<'_>,
) -> Result<(Geometry, GltfNotes), Error> {
    let doc = &parsed.of(files)?.load_bytes(files, Some(watch))?;
    let mut reader = GltfReader {
        doc,
        watch,
        geometry: Geometry::default(),
        rows: Vec::new(),
        examined: 0,
        skins: BTreeMap::new(),
        seams: SkinSeams::default(),
    };
    let scene = scene::place_meshes(doc, &mut reader.geometry.warnings)?;
    if let Some((at, length)) = doc.container.as_ref().and_then(|c| c.uneven) {
        let message = format!("its length of {length} is not a multiple of 4; what is written has padding");
        reader.warn("chunk-length", message, format!("chunk at byte {at}"));
    }
    super::package::warn_of_missing(doc, files, &mut reader.geometry.warnings);
    if let Some(message) = super::rig::avatar::places_beyond(doc) {
        reader.warn("avatar-too-large", message, "extensions");
    }
    let placements = &scene.placements;
    reader.add_placements(&scene, PrimitiveClass::Triangles)?;
    if watch.points_and_lines {
        // After all others, whose numbers are the same in a file without these.
        reader.add_placements(&scene, PrimitiveClass::PointsAndLines)?;
    }
    let GltfReader { mut geometry, rows, .. } = reader;
    if geometry.positions.is_empty() {
        return Err(Error::NoMesh {
            format,
            problem: what_is_there(doc, placements),
        });
    }
    fill_up(&mut geometry);
    let mut placed: Vec<usize> = placements.iter().map(|p| p.node).collect();
    placed.sort_unstable();
    let notes = GltfNotes {
        document: Arc::clone(parsed),
        rows,
        placed,
        uncompressed: None,
    };
    Ok((geometry, notes))
}

fn what_is_there(doc: &GltfDocument<'_>, placements: &[MeshPlacement]) -> String {
    if doc.meshes.len() == 0 {
        "the file has no meshes".into()
    } else if placements.is_empty() {
        format!("no node of the scene places any of the {} meshes", doc.meshes.len())
    } else {
        "the meshes of the scene have no triangles".into()
    }
}

/// Normals and tangents are empty, or one per vertex.
fn fill_up(geometry: &mut Geometry) {
    let count = geometry.positions.len();
    if !geometry.normals.is_empty() {
        geometry.normals.resize(count, Vec3::ZERO);
    }
    if !geometry.tangents.is_empty() {
        geometry.tangents.resize(count, Vec4::ZERO);
    }
}

struct GltfReader<'d, 'f> {
    doc: &'d GltfDocument<'f>,
    watch: &'d ReadWatch<'d>,
    geometry: Geometry,
    rows: Vec<PlacedPrimitive>,
    /// Triangles that were or could have been made of the indices read so far.
    examined: u64,
    /// The skins that were needed so far, or why they place nothing.
    skins: BTreeMap<usize, Result<Arc<SkinPose>, String>>,
    seams: SkinSeams,
}

/// A primitive on its way into the world.
struct PlacedVertices<'a> {
    primitive: &'a MeshPrimitive,
    node: usize,
    transforms: VertexTransforms,
    /// Where it is in the file.
    place: String,
}

/// What a primitive draws.
#[derive(Clone, Copy, PartialEq, Eq)]
enum PrimitiveClass {
    Triangles,
    PointsAndLines,
}

impl PrimitiveClass {
    fn of(primitive: &MeshPrimitive) -> Self {
        match primitive.mode() {
            ..4 => Self::PointsAndLines,
            _ => Self::Triangles,
        }
    }
}

impl GltfReader<'_, '_> {
    /// Adds the primitives of a class under every node of the scene.
    fn add_placements(&mut self, scene: &PlacedScene, class: PrimitiveClass) -> Result<(), Error> {
        let meshes = &self.doc.meshes.values;
        let of_class = |mesh: usize| -> Vec<usize> {
            let primitives = meshes[mesh].primitives.iter().enumerate();
            primitives
                .filter(|(_, p)| PrimitiveClass::of(p) == class)
                .map(|(p, _)| p)
                .collect()
        };
        // What draws nothing under one node draws nothing under any other, and must not cost anything there.
        let mut drawn: Vec<Option<Vec<usize>>> = vec![None; meshes.len()];
        for placement in &scene.placements {
            let mut kept = Vec::new();
            for p in drawn[placement.mesh].take().unwrap_or_else(|| of_class(placement.mesh)) {
                let is_there = match class {
                    PrimitiveClass::Triangles => self.add_placement(scene, placement, p)?,
                    PrimitiveClass::PointsAndLines => self.add_readable(scene, placement, p)?,
                };
                if is_there {
                    kept.push(p);
                }
            }
            drawn[placement.mesh] = Some(kept);
        }
        Ok(())
    }

    /// As [`GltfReader::add_placement`], for a primitive without which the model can be used.
    fn add_readable(&mut self, scene: &PlacedScene, placement: &MeshPlacement, p: usize) -> Result<bool, Error> {
        let Geometry {
            positions,
            normals,
            tangents,
            ..
        } = &self.geometry;
        let counts = [positions.len(), normals.len(), tangents.len()];
        let unreadable = match self.add_placement(scene, placement, p) {
            Err(e @ Error::Malformed { .. }) => e,
            found => return found,
        };
        self.geometry.positions.truncate(counts[0]);
        self.geometry.normals.truncate(counts[1]);
        self.geometry.tangents.truncate(counts[2]);
        let message = format!("the points or lines of a primitive stay as they are stored: {unreadable}");
        self.warn(
            "points-not-read",
            message,
            format!("meshes/{}/primitives/{p}", placement.mesh),
        );
        Ok(false)
    }

    /// Adds a primitive under a node; `false` when it draws nothing.
    fn add_placement(&mut self, scene: &PlacedScene, placement: &MeshPlacement, p: usize) -> Result<bool, Error> {
        let doc = self.doc;
        let mesh = &doc.meshes.values[placement.mesh];
        let primitive = &mesh.primitives[p];
        let place = || format!("meshes/{}/primitives/{p}", placement.mesh);
        let class = PrimitiveClass::of(primitive);
        let rows = self.rows.len() as u64 + 1;
        within("number of placed primitives", rows, MOST_ROWS)?;
        let Some(positions) = primitive.attribute("POSITION") else {
            self.warn("no-position", "has no POSITION; it is passed through", place());
            return Ok(false);
        };
        if primitive.has_draco() {
            let message = "the uncompressed copy is used; where it is deformed, the Draco copy is dropped";
            self.warn("draco-fallback", message, place());
        }
        let layout = doc.check_role(positions, ShapeAttribute::Position)?;
        doc.check_unbacked(positions, layout)?;

        let count = doc.accessors.values[positions].count.0;
        let first_vertex = self.geometry.positions.len();
        let most = self.count_primitive(primitive, count)?;

        let used = ShapeAttribute::ALL.iter().filter_map(|r| primitive.attribute(r.name()));
        let named = primitive.attributes.iter();
        let named = named.filter(|(name, _)| name.starts_with("TEXCOORD_"));
        let coordinates: Vec<usize> = named.map(|(_, accessor)| accessor.index()).collect();
        let used = used.chain(primitive.indices.map(|i| i.index()));
        doc.decode_for(used.chain(coordinates.iter().copied()))?;

        if class == PrimitiveClass::PointsAndLines {
            let beyond = indices_beyond(doc, primitive, count, self.watch)?;
            self.geometry
                .warnings
                .extend(beyond.map(|message| ("bad-line-index".into(), message, place())));
        }
        let triangles = if most > 0 {
            self.read_triangles(primitive, count as usize, &place())?
        } else {
            Vec::new()
        };
        if triangles.is_empty() && class == PrimitiveClass::Triangles {
            self.warn("no-triangles", "has no triangles; it is passed through", place());
            return Ok(false);
        }
        let stored = doc.read_floats(positions, ShapeAttribute::Position)?;
        let by_joints = self.find_transforms(scene, placement, primitive, &stored, &place())?;
        let follows_joints = by_joints.is_some();
        let of_node = placement.world_from_mesh;
        let by_node = (Placement::Whole(of_node), VertexTransforms::Whole(of_node));
        let (how, transforms) = by_joints.unwrap_or(by_node);
        let placed = PlacedVertices {
            primitive,
            node: placement.node,
            transforms,
            place: place(),
        };
        self.place_positions(&placed, &stored)?;
        if let Placement::Blended(pose) = &how {
            let placed = &mut self.geometry.positions[first_vertex..];
            self.seams.close(Arc::as_ptr(pose) as usize, &stored, placed);
        }
        let has_normals = self.read_normals(&placed, first_vertex)?;
        let has_tangents = self.read_tangents(&placed, first_vertex)?;
        self.check_coordinates(&coordinates, &placed.place);

        let first_triangle = self.geometry.triangles.len();
        let mirrored = placed.transforms.is_mirrored();
        self.geometry.triangles.extend(triangles.iter().map(|t| {
            let [a, b, c] = t.map(|v| v + first_vertex as u32);
            // A mirrored mesh is drawn with its winding turned round, so that its outside stays outside.
            if mirrored { [a, c, b] } else { [a, b, c] }
        }));
        let node_name = doc.nodes.values[placement.node].name.as_ref().filter(|n| !n.is_empty());
        self.geometry.primitives.push(Primitive {
            node: placement.node as u32,
            mesh: placement.mesh as u32,
            primitive: p as u32,
            name: node_name.or(mesh.name.as_ref()).cloned().unwrap_or_default(),
            first_vertex: first_vertex as u32,
            vertex_count: count as u32,
            index_count: (triangles.len() * 3) as u32,
            has_normals,
            has_tangents,
            is_passenger: class == PrimitiveClass::PointsAndLines,
        });
        self.rows.push(PlacedPrimitive {
            node: placement.node,
            mesh: placement.mesh,
            primitive: p,
            skin: placement.skin,
            follows_joints,
            placement: how,
            is_mirrored: mirrored,
            vertices: first_vertex..self.geometry.positions.len(),
            triangles: first_triangle..self.geometry.triangles.len(),
        });
        Ok(true)
    }

    /// Counts a primitive of so many vertices against the limits, before anything is allocated for it; returns the most
    /// triangles that it may have.
    fn count_primitive(&mut self, primitive: &MeshPrimitive, vertices: u64) -> Result<u64, Error> {
        let before = self.geometry.positions.len() as u64;
        self.watch.check_vertices(before.saturating_add(vertices))?;
        let indexed = primitive.indices.map(|i| self.doc.accessors.values[i.index()].count.0);
        let corners = indexed.unwrap_or(vertices);
        let most = match primitive.mode() {
            ..4 => 0,
            4 => corners / 3,
            _ => corners.saturating_sub(2),
        };
        self.examined = self.examined.saturating_add(most);
        self.watch.check_triangles(self.examined)?;
        Ok(most)
    }

    fn warn(&mut self, code: &str, message: impl Into<String>, place: impl Into<String>) {
        self.geometry.warnings.push((code.into(), message.into(), place.into()));
    }

    /// Triangles over the primitive's own vertices, every index in range.
    fn read_triangles(
        &mut self,
        primitive: &MeshPrimitive,
        vertices: usize,
        place: &str,
    ) -> Result<Vec<[u32; 3]>, Error> {
        let corners: Vec<u32> = match primitive.indices {
            Some(indices) => {
                let corners = self.doc.read_indices(indices.index())?;
                if let Some(i) = corners.iter().position(|&c| c as usize >= vertices) {
                    let problem = format!("index {} at {i}, there are {vertices} vertices", corners[i]);
                    return Err(self.doc.fault.malformed(format!("accessors/{}", indices.0), problem));
                }
                corners
            }
            None => (0..vertices as u32).collect(),
        };
        if primitive.mode() == 4 && !corners.len().is_multiple_of(3) {
            let message = format!(
                "{} corners do not make whole triangles; the last ones are left out",
                corners.len()
            );
            self.warn("incomplete-triangle", message, place);
        }
        Ok(to_triangles(&corners, primitive.mode()))
    }

    /// How joints put the vertices of a primitive into the world; `None` where its node does. A skin that cannot say leaves
    /// them where they were bound.
    fn find_transforms(
        &mut self,
        scene: &PlacedScene,
        placement: &MeshPlacement,
        primitive: &MeshPrimitive,
        stored: &[f32],
        place: &str,
    ) -> Result<Option<(Placement, VertexTransforms)>, Error> {
        let Some(skin) = placement.skin else {
            return Ok(None);
        };
        let by_joints = match self.skin_pose(scene, skin) {
            Ok(pose) => self.place_by_joints(&pose, primitive, stored, place)?,
            Err(problem) => Err(problem),
        };
        if let Err(problem) = &by_joints {
            let message = format!(
                "skin {skin} of node {} does not say where it stands ({problem}); it is taken in bind coordinates",
                placement.node
            );
            self.warn("skin-not-applied", message, place);
        }
        Ok(by_joints.ok())
    }

    /// The joints of a skin in the rest pose.
    fn skin_pose(&mut self, scene: &PlacedScene, skin: usize) -> Result<Arc<SkinPose>, String> {
        if let Some(known) = self.skins.get(&skin) {
            return known.clone();
        }
        let pose = SkinPose::read(self.doc, skin, &scene.world_from_node);
        if let Ok(pose) = &pose
            && let Some(joint) = pose.joints.iter().find(|&&j| !scene.is_reached[j])
        {
            let message =
                format!("node {joint} is a joint and not in the scene; its own parents place it all the same");
            self.warn("joint-outside-scene", message, format!("skins/{skin}"));
        }
        let pose = pose.map(Arc::new);
        self.skins.insert(skin, pose.clone());
        pose
    }

    /// How a skin places a primitive; or, for a warning, why it does not.
    fn place_by_joints(
        &mut self,
        pose: &Arc<SkinPose>,
        primitive: &MeshPrimitive,
        stored: &[f32],
        place: &str,
    ) -> Result<Result<(Placement, VertexTransforms), String>, Error> {
        let used = super::placement::influence_accessors(primitive);
        self.doc
            .decode_for(used.into_iter().flat_map(|(joints, weights)| [joints, weights]))?;
        let influences = match VertexInfluences::read(self.doc, primitive, pose.joints.len()) {
            Ok(influences) => influences,
            Err(problem) => return Ok(Err(problem)),
        };
        let placed = Placement::of_skin(pose, &influences, stored);
        let (weightless, uneven) = (influences.weightless, influences.uneven);
        if placed.is_ok() && weightless + uneven > 0 {
            let message = format!(
                "the weights of {uneven} vertices do not sum to 1 and are scaled, {weightless} vertices have none and \
                 follow the first joint that they name"
            );
            self.warn("skin-weights", message, place);
        }
        Ok(placed)
    }

    fn place_positions(&mut self, placed: &PlacedVertices<'_>, stored: &[f32]) -> Result<(), Error> {
        if placed.transforms.inverse().is_none() {
            let message = format!(
                "node {} flattens its mesh (a scale of zero), so it cannot be deformed",
                placed.node
            );
            self.warn("singular-transform", message, &placed.place);
        }
        self.geometry.positions.reserve(stored.len() / 3);
        for (i, &p) in stored.as_chunks::<3>().0.iter().enumerate() {
            let in_world = placed.transforms.at(i).transform_point3(Vec3::from_array(p).as_dvec3());
            if !in_world.is_finite() {
                let problem = format!("POSITION of vertex {i} is {p:?}, in the world {in_world}; it must be finite");
                return Err(self.doc.fault.malformed(&placed.place, problem));
            }
            self.geometry.positions.push(in_world);
        }
        Ok(())
    }

    fn read_normals(&mut self, placed: &PlacedVertices<'_>, first: usize) -> Result<bool, Error> {
        let Some(values) = self.doc.read_attribute(placed.primitive, ShapeAttribute::Normal)? else {
            return Ok(false);
        };
        self.geometry.normals.resize(first, Vec3::ZERO);
        let mut odd = 0;
        for (i, &n) in values.as_chunks::<3>().0.iter().enumerate() {
            let world_from_normal = normal_matrix(&placed.transforms.at(i).matrix3);
            let unit = (world_from_normal * Vec3::from_array(n).as_dvec3()).try_normalize();
            odd += usize::from(unit.is_none());
            self.geometry.normals.push(unit.map_or(Vec3::ZERO, |n| n.as_vec3()));
        }
        self.warn_odd("normal", odd, &placed.place);
        Ok(true)
    }

    fn read_tangents(&mut self, placed: &PlacedVertices<'_>, first: usize) -> Result<bool, Error> {
        let Some(values) = self.doc.read_attribute(placed.primitive, ShapeAttribute::Tangent)? else {
            return Ok(false);
        };
        // Mirroring turns the side on which the bitangent lies.
        let side = if placed.transforms.is_mirrored() { -1.0 } else { 1.0 };
        self.geometry.tangents.resize(first, Vec4::ZERO);
        let mut odd = 0;
        for (i, &[x, y, z, w]) in values.as_chunks::<4>().0.iter().enumerate() {
            let unit = (placed.transforms.at(i).matrix3 * DVec3::new(x.into(), y.into(), z.into()))
                .try_normalize()
                .filter(|_| w.is_finite());
            odd += usize::from(unit.is_none());
            self.geometry
                .tangents
                .push(unit.map_or(Vec4::ZERO, |t| t.as_vec3().extend(w * side)));
        }
        self.warn_odd("tangent", odd, &placed.place);
        Ok(true)
    }

    /// Warns of texture coordinates that are not finite. They stay in patched files.
    fn check_coordinates(&mut self, accessors: &[usize], place: &str) {
        let mut odd = 0;
        for &index in accessors {
            let layout = self.doc.layout(index);
            let floats = layout.filter(|layout| layout.component == ComponentType::F32);
            let values = floats.and_then(|layout| self.doc.read_values(index, layout).ok());
            let values = values.iter().flat_map(|values| values.as_chunks::<2>().0);
            odd += values.filter(|pair| !pair.iter().all(|v| v.is_finite())).count();
        }
        if odd > 0 {
            let message = format!("{odd} texture coordinates are not finite; where they are rewritten they become 0");
            self.warn("bad-texture-coordinate", message, place);
        }
    }

    fn warn_odd(&mut self, what: &str, count: usize, place: &str) {
        if count > 0 {
            let message = format!("{count} {what}s have no direction; they are taken as absent");
            self.warn(&format!("bad-{what}"), message, place);
        }
    }
}

/// Takes normals along with the points: the inverse transpose up to a positive factor, also for singular matrices.
pub(super) fn normal_matrix(m: &DMat3) -> DMat3 {
    let cofactor = DMat3::from_cols(
        m.y_axis.cross(m.z_axis),
        m.z_axis.cross(m.x_axis),
        m.x_axis.cross(m.y_axis),
    );
    if m.determinant() < 0.0 {
        cofactor * -1.0
    } else {
        cofactor
    }
}
