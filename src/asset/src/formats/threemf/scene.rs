//! The objects of a 3MF where they are built: one primitive for each use of a mesh.

use super::package::{FORMAT, Package, refuse};
use super::part::{BuildItem, Component, ModelPart, ObjectMesh, PrintObject, PropertyGroup, read_part};
use crate::files::ReadWatch;
use crate::model::FileNotes;
use crate::{Error, FileSet, Geometry, Primitive, WrittenWarning};
use bytes::Bytes;
use glam::DAffine3;
use std::collections::{BTreeMap, BTreeSet};

/// How deep objects may hang in each other.
const DEEPEST: usize = 64;
/// How many uses of objects are followed.
const MOST_USES: usize = 1 << 16;
/// Names that a warning lists.
const MOST_LISTED: usize = 8;
/// Letters of the name of a picture that a warning shows.
const LONGEST_NAME: usize = 80;

/// All parts of a package that objects are in; the first one is what the package names.
#[derive(Debug, Default)]
pub(super) struct PrintScene {
    pub parts: Vec<ModelPart>,
}

/// A mesh at a place.
#[derive(Debug, Clone)]
pub(super) struct MeshUse {
    pub part: usize,
    pub object: u32,
    /// The place of the build item; `None` where the file builds nothing and all objects are taken.
    pub item: Option<usize>,
    pub world_from_object: DAffine3,
    pub name: String,
}

/// What the writers remember: the uses that primitives are, in order, and the scene without positions and triangles.
#[derive(Debug)]
pub(super) struct PrintNotes {
    pub uses: Vec<MeshUse>,
    pub scene: PrintScene,
}

impl FileNotes for PrintNotes {
    fn bytes_held(&self) -> u64 {
        let names: usize = self.uses.iter().map(|one| one.name.len()).sum();
        let meshes = self.scene.parts.iter().flat_map(|part| part.objects.values());
        let meshes = meshes.filter_map(|object| object.mesh.as_ref());
        let properties: usize = meshes.map(|mesh| size_of_val(mesh.properties.as_slice())).sum();
        let pictures = self.scene.parts.iter().flat_map(|part| part.pictures.values());
        let pictures: usize = pictures.filter_map(|own| own.bytes.as_ref().map(Bytes::len)).sum();
        (size_of_val(self.uses.as_slice()) + names + properties + pictures) as u64
    }
}

impl PrintScene {
    /// Reads a package.
    pub fn read(bytes: &[u8], watch: &ReadWatch<'_>) -> Result<Self, Error> {
        let mut package = Package::open(bytes)?;
        let root = package.model_part(watch)?;
        let mut scene = Self::default();
        let mut open = vec![root];
        let mut known: BTreeSet<String> = open.iter().map(|name| key_of(name)).collect();
        let mut counts = [0; 2];
        while let Some(name) = open.pop() {
            let Some(bytes) = package.part(&name, watch)? else {
                return Err(refuse(name, "the part is named and is not in the archive"));
            };
            let part = read_part(&bytes, &name, &mut counts, watch, &mut |_| {})?;
            for path in part.paths() {
                if known.insert(key_of(path)) {
                    open.push(path.to_owned());
                }
            }
            watch.release(bytes.len() as u64);
            scene.parts.push(part);
        }
        scene.read_pictures(&mut package, watch)?;
        Ok(scene)
    }

    /// Reads the pictures that groups of texture coordinates name, each once. They stay reserved.
    fn read_pictures(&mut self, package: &mut Package<'_>, watch: &ReadWatch<'_>) -> Result<(), Error> {
        let mut known: BTreeMap<String, Option<Bytes>> = BTreeMap::new();
        for part in &mut self.parts {
            let groups = part.groups.values().filter_map(|group| match group {
                PropertyGroup::Picture(id, _) => Some(*id),
                _ => None,
            });
            for id in groups.collect::<BTreeSet<u32>>() {
                let Some(picture) = part.pictures.get_mut(&id) else {
                    continue;
                };
                let key = key_of(&picture.path);
                if !known.contains_key(&key) {
                    let bytes = package.part(&picture.path, watch)?;
                    known.insert(key.clone(), bytes.map(Into::into));
                }
                picture.bytes = known.get(&key).cloned().flatten();
            }
        }
        Ok(())
    }

    /// The part that a path in another part names.
    pub fn part_at(&self, path: &str, from: usize) -> Option<usize> {
        if path.is_empty() {
            return Some(from);
        }
        let key = key_of(path);
        self.parts.iter().position(|part| key_of(&part.name) == key)
    }

    /// The object of a use.
    pub fn object(&self, of: &MeshUse) -> Option<&PrintObject> {
        self.parts.get(of.part)?.objects.get(&of.object)
    }

    /// The build item of a use.
    pub fn item(&self, of: &MeshUse) -> Option<&BuildItem> {
        self.parts.first()?.items.get(of.item?)
    }

    /// A group of properties of a part.
    pub fn group(&self, part: usize, id: u32) -> Option<&PropertyGroup> {
        self.parts.get(part)?.groups.get(&id)
    }

    /// Names of elements that are not read.
    fn foreign(&self) -> BTreeSet<&str> {
        let all = self.parts.iter().flat_map(|part| &part.foreign);
        all.map(String::as_str).collect()
    }

    /// All uses of meshes, in the order of the build.
    fn uses(&self) -> Result<Vec<MeshUse>, Error> {
        let mut walk = UseWalk {
            scene: self,
            uses: Vec::new(),
            visits: 0,
        };
        let Some(root) = self.parts.first() else {
            return Ok(walk.uses);
        };
        for (i, item) in root.items.iter().enumerate() {
            walk.visit(&item.of, (0, Some(i)), DAffine3::IDENTITY, "", 0)?;
        }
        if root.items.is_empty() {
            let inner: BTreeSet<u32> = root
                .objects
                .values()
                .flat_map(|o| o.components.iter().map(|c| c.object))
                .collect();
            for &object in root.objects.keys().filter(|id| !inner.contains(id)) {
                let whole = Component {
                    path: String::new(),
                    object,
                    transform: DAffine3::IDENTITY,
                };
                walk.visit(&whole, (0, None), DAffine3::IDENTITY, "", 0)?;
            }
        }
        Ok(walk.uses)
    }
}

/// Follows components.
struct UseWalk<'a> {
    scene: &'a PrintScene,
    uses: Vec<MeshUse>,
    visits: usize,
}

impl UseWalk<'_> {
    /// Visits an object. `from`: the part that names it, and the item that it is built by.
    fn visit(
        &mut self,
        component: &Component,
        from: (usize, Option<usize>),
        world_from_here: DAffine3,
        name: &str,
        depth: usize,
    ) -> Result<(), Error> {
        self.visits += 1;
        let parts = &self.scene.parts;
        let place = || format!("{}, object {}", parts[from.0].name, component.object);
        if depth > DEEPEST || self.visits > MOST_USES {
            let problem =
                format!("objects hang more than {DEEPEST} deep in each other or are used more than {MOST_USES} times");
            return Err(refuse(place(), problem));
        }
        let part = self.scene.part_at(&component.path, from.0);
        let found = part.and_then(|part| Some((part, parts[part].objects.get(&component.object)?)));
        let Some((part, object)) = found else {
            return Err(refuse(place(), "the object is named and does not exist"));
        };
        let world = world_from_here * component.transform;
        let name = if object.name.is_empty() { name } else { &object.name };
        if object.mesh.is_some() {
            self.uses.push(MeshUse {
                part,
                object: component.object,
                item: from.1,
                world_from_object: world,
                name: name.to_owned(),
            });
        }
        for inner in &object.components {
            self.visit(inner, (part, from.1), world, name, depth + 1)?;
        }
        Ok(())
    }
}

/// Reads a model.
pub(super) fn read(files: &FileSet, watch: &ReadWatch<'_>) -> Result<(Geometry, PrintNotes), Error> {
    let scene = PrintScene::read(&files.main, watch)?;
    let uses = scene.uses()?;
    let mut geometry = Geometry::default();
    for one in &uses {
        let Some(mesh) = scene.object(one).and_then(|object| object.mesh.as_ref()) else {
            continue;
        };
        check_corners(&scene, one, mesh)?;
        let first = geometry.positions.len();
        watch.check_vertices((first + mesh.positions.len()) as u64)?;
        watch.check_triangles((geometry.triangles.len() + mesh.triangles.len()) as u64)?;
        watch.check()?;
        let places = mesh.positions.iter();
        // What lies where it was stored keeps its numbers.
        if one.world_from_object == DAffine3::IDENTITY {
            geometry.positions.extend(places);
        } else {
            geometry
                .positions
                .extend(places.map(|p| one.world_from_object.transform_point3(*p)));
        }
        let is_mirrored = one.world_from_object.matrix3.determinant() < 0.0;
        geometry.triangles.extend(mesh.triangles.iter().map(|t| {
            let [a, b, c] = t.map(|v| v + first as u32);
            if is_mirrored { [a, c, b] } else { [a, b, c] }
        }));
        geometry.primitives.push(Primitive {
            name: one.name.clone(),
            first_vertex: first as u32,
            vertex_count: mesh.positions.len() as u32,
            index_count: 3 * mesh.triangles.len() as u32,
            ..Primitive::default()
        });
    }
    let foreign = listed(scene.foreign());
    if geometry.triangles.is_empty() && !foreign.is_empty() {
        return Err(Error::NoMesh {
            format: FORMAT,
            problem: format!("what is built has no triangles of its own, and is not read: {foreign}"),
        });
    }
    add_warnings(&scene, &uses, &mut geometry);
    let mut scene = scene;
    let objects = scene.parts.iter_mut().flat_map(|part| part.objects.values_mut());
    for mesh in objects.filter_map(|object| object.mesh.as_mut()) {
        (mesh.positions, mesh.triangles) = (Vec::new(), Vec::new());
    }
    Ok((geometry, PrintNotes { uses, scene }))
}

fn check_corners(scene: &PrintScene, one: &MeshUse, mesh: &ObjectMesh) -> Result<(), Error> {
    let count = mesh.positions.len();
    let wrong = mesh
        .triangles
        .iter()
        .position(|t| t.iter().any(|&v| v as usize >= count));
    match wrong {
        Some(i) => {
            let place = format!("{}, object {}, triangle {i}", scene.parts[one.part].name, one.object);
            let problem = format!("vertices {:?} are named, the object has {count}", mesh.triangles[i]);
            Err(refuse(place, problem))
        }
        None => Ok(()),
    }
}

fn add_warnings(scene: &PrintScene, uses: &[MeshUse], geometry: &mut Geometry) {
    let Some(root) = scene.parts.first() else { return };
    if root.unit != "millimeter" {
        let message = format!(
            "numbers are in the unit of the file, {}; in other formats they stay as they are",
            root.unit
        );
        geometry.warn("unit", message, &root.name);
    }
    if root.items.is_empty() && !uses.is_empty() {
        geometry.warn(
            "nothing-built",
            "the file builds no object; all objects are taken",
            &root.name,
        );
    }
    let used: BTreeSet<(usize, u32)> = uses.iter().map(|one| (one.part, one.object)).collect();
    let meshes = scene.parts.iter().zip(0..).flat_map(|(part, i)| {
        let with_mesh = part.objects.iter().filter(|(_, object)| object.mesh.is_some());
        with_mesh.map(move |(id, _)| (i, *id))
    });
    let idle = meshes.filter(|mesh| !used.contains(mesh)).count();
    if idle > 0 {
        let message =
            format!("{idle} objects with meshes are not built; they stay in the file until an edit rewrites it");
        geometry.warn("objects-not-built", message, &root.name);
    }
    let missing = missing_pictures(scene);
    if !missing.is_empty() {
        let names = listed(missing.iter().map(String::as_str).collect());
        let message = format!("pictures that the package lacks, or that are neither PNG nor JPEG: {names}");
        geometry.warn("image-missing", message, &root.name);
    }
    let foreign = listed(scene.foreign());
    if !foreign.is_empty() {
        let message = format!("not read: {foreign}; they stay in the file as they are until an edit rewrites it");
        geometry.warn("extension-not-read", message, &root.name);
    }
}

/// The first of some names, with a word for the others.
fn listed<'n>(names: BTreeSet<&'n str>) -> String {
    let more = if names.len() > MOST_LISTED { " and others" } else { "" };
    let first: Vec<&'n str> = names.into_iter().take(MOST_LISTED).collect();
    format!("{}{more}", first.join(", "))
}

/// The pictures that groups of texture coordinates name and that are none, each by its part or the number of its resource.
fn missing_pictures(scene: &PrintScene) -> BTreeSet<String> {
    let mut missing = BTreeSet::new();
    for part in &scene.parts {
        for group in part.groups.values() {
            let PropertyGroup::Picture(id, _) = group else { continue };
            let own = part.pictures.get(id);
            let bytes = own.and_then(|own| own.bytes.as_deref()).unwrap_or_default();
            if !bytes.starts_with(b"\x89PNG") && !bytes.starts_with(b"\xff\xd8") {
                let name = own.map(|own| own.path.chars().take(LONGEST_NAME).collect());
                missing.insert(name.unwrap_or_else(|| format!("resource {id}")));
            }
        }
    }
    missing
}

/// Names of parts are compared in one case and without the root.
fn key_of(name: &str) -> String {
    name.trim_start_matches('/').to_ascii_lowercase()
}

impl ModelPart {
    /// The parts that its components and items name.
    fn paths(&self) -> impl Iterator<Item = &str> {
        let inner = self.objects.values().flat_map(|object| &object.components);
        let all = self.items.iter().map(|item| &item.of).chain(inner);
        all.map(|one| one.path.as_str()).filter(|path| !path.is_empty())
    }
}

/// How often each object is used.
pub(super) fn uses_of_objects(uses: &[MeshUse]) -> BTreeMap<(usize, u32), usize> {
    let mut counts = BTreeMap::new();
    for one in uses {
        *counts.entry((one.part, one.object)).or_insert(0) += 1;
    }
    counts
}

/// The refusal to write what a model is not.
pub(super) fn unwritable(problem: impl Into<String>) -> Error {
    Error::unwritable(FORMAT, problem)
}

/// Says which parts beside the model show or hold what it was.
pub(super) fn stale_parts(package: &Package<'_>, notes: &PrintNotes) -> Option<WrittenWarning> {
    let models = notes.scene.parts.iter().map(|part| part.name.clone()).collect();
    let textures = notes.scene.parts.iter().flat_map(|part| part.pictures.values());
    let textures: Vec<&str> = textures.map(|own| own.path.trim_start_matches('/')).collect();
    let is_stale = |name: &&str| {
        let lower = name.to_ascii_lowercase();
        let is_picture = [".png", ".jpg", ".jpeg", ".gcode"]
            .iter()
            .any(|end| lower.ends_with(end));
        is_picture && !textures.contains(name)
    };
    let names = listed(package.beside(&models).into_iter().filter(is_stale).collect());
    let message = format!("parts beside the model are as uploaded and may show what it was: {names}");
    (!names.is_empty()).then(|| WrittenWarning::new("extension-kept", message, ""))
}
