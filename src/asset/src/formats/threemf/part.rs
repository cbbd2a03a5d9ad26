//! One model part of a 3MF: XML with objects, what colours them, and what is built of them.
//!
//! Follows the core specification 1.3 with the production extension (objects in other parts) and of the materials extension colour groups
//! and pictures. Elements of other extensions are skipped with a warning; a document type, and so entities, is refused as the specification asks.

use super::package::{attribute_of, refuse};
use super::words::{attributes_but, colour_of, optional_whole, position_of, transform_of, whole, whole_of};
use crate::Error;
use crate::files::ReadWatch;
use crate::formats::text::{NumberPrecision, coordinate};
use bytes::Bytes;
use glam::{DAffine3, DVec3};
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Kinds of foreign elements that are remembered.
const MOST_FOREIGN: usize = 16;
/// Objects, groups, components and items that one part may have.
const MOST_THINGS: usize = 1 << 20;
/// How deep elements are remembered by name: deeper than any that is read.
const DEEPEST_NAMED: usize = 8;

/// What a part says.
#[derive(Debug, Default)]
pub(super) struct ModelPart {
    /// Its name in the package.
    pub name: String,
    /// `millimeter` where it says nothing.
    pub unit: String,
    /// By their numbers.
    pub objects: BTreeMap<u32, PrintObject>,
    /// What is built, in order.
    pub items: Vec<BuildItem>,
    /// By their numbers.
    pub groups: BTreeMap<u32, PropertyGroup>,
    /// Pictures by the numbers of their resources.
    pub pictures: BTreeMap<u32, PartPicture>,
    /// Names of elements that are not read, and of extensions that the part says are needed.
    pub foreign: BTreeSet<String>,
    /// Where the element `model` begins its content: all before it is the head.
    pub head: usize,
    /// Metadata of the model, as written.
    pub metadata: Vec<Range<usize>>,
    /// Resources that are no objects, as written.
    pub resources: Vec<Range<usize>>,
    /// The largest number of a resource.
    pub largest_id: u32,
}

/// A picture.
#[derive(Debug, Clone)]
pub(super) struct PartPicture {
    /// The name of its part in the package.
    pub path: String,
    /// The file; `None` where the package has no such part.
    pub bytes: Option<Bytes>,
}

/// An object.
#[derive(Debug, Default)]
pub(super) struct PrintObject {
    pub name: String,
    /// Group and place of the property that triangles have which name none.
    pub property: Option<(u32, u32)>,
    /// All attributes but those that are written again, as written.
    pub attributes: String,
    pub mesh: Option<ObjectMesh>,
    pub components: Vec<Component>,
}

/// A mesh in the space of its object.
#[derive(Debug, Default)]
pub(super) struct ObjectMesh {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle with a property of its own the group and a place for each corner; empty where none has.
    pub properties: Vec<Option<(u32, [u32; 3])>>,
    /// How many triangles have attributes that are not read, such as paint of slicers.
    pub painted: usize,
}

/// An object in another one.
#[derive(Debug)]
pub(super) struct Component {
    /// The part that the object is in; of this one where it is empty.
    pub path: String,
    pub object: u32,
    pub transform: DAffine3,
}

/// An object on the plate.
#[derive(Debug)]
pub(super) struct BuildItem {
    pub of: Component,
    /// All attributes but object, part and transform, as written.
    pub attributes: String,
}

/// Properties that triangles name.
#[derive(Debug)]
pub(super) enum PropertyGroup {
    /// Materials with a name and a colour for screens.
    Materials(Vec<(String, [f32; 4])>),
    /// Colours.
    Colours(Vec<[f32; 4]>),
    /// Texture coordinates counted from the lower left corner, and the number of the picture.
    Picture(u32, Vec<[f32; 2]>),
}

/// What a prefix stands for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Space {
    Core,
    Materials,
    Production,
    Other,
}

struct PartReader<'a, 'w> {
    watch: &'a ReadWatch<'w>,
    part: ModelPart,
    spaces: BTreeMap<String, Space>,
    object: Option<(u32, PrintObject)>,
    group: Option<(u32, PropertyGroup)>,
    /// Vertices and triangles of all parts so far.
    counts: &'a mut [u64; 2],
    things: usize,
    /// Names of the elements around the one that is read.
    path: Vec<String>,
    /// How many elements are open, and how many of them are skipped.
    depth: usize,
    skipped: usize,
    /// An element that is kept as written.
    kept: Option<KeptElement>,
}

/// Where an element begins that is kept as written, and how deep it lies.
struct KeptElement {
    begin: usize,
    depth: usize,
    is_metadata: bool,
}

/// A vertex of a part: its object, its place there, and where its element stands.
pub(super) struct VertexPlace {
    pub object: u32,
    pub place: usize,
    pub bytes: Range<usize>,
}

/// Reads a part. `counts`: vertices and triangles of the parts before, to which its own are added. Every vertex is handed to `vertex`.
pub(super) fn read_part(
    bytes: &[u8],
    name: &str,
    counts: &mut [u64; 2],
    watch: &ReadWatch<'_>,
    vertex: &mut dyn FnMut(VertexPlace),
) -> Result<ModelPart, Error> {
    let begins_wide = |mark: &&[u8; 2]| bytes.starts_with(*mark);
    if [b"\xff\xfe", b"\xfe\xff", b"<\0", b"\0<"].iter().any(begins_wide) {
        return Err(refuse(
            name,
            "the text is in UTF-16 (two bytes a letter); save it as UTF-8",
        ));
    }
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let problem = format!("byte {} is not of UTF-8", error.valid_up_to());
        refuse(name, problem)
    })?;
    // The reader would skip a byte order mark and not count it.
    let unmarked = text.trim_start_matches('\u{feff}');
    let first = text.len() - unmarked.len();
    let mut reader = Reader::from_str(unmarked);
    let mut state = PartReader {
        watch,
        part: ModelPart {
            name: name.to_owned(),
            unit: "millimeter".into(),
            ..ModelPart::default()
        },
        spaces: BTreeMap::new(),
        object: None,
        group: None,
        counts,
        things: 0,
        path: Vec::new(),
        depth: 0,
        skipped: 0,
        kept: None,
    };
    let mut events = 0;
    loop {
        let begin = first + reader.buffer_position() as usize;
        watch.check_at(events)?;
        events += 1;
        let event = reader.read_event();
        let event = event.map_err(|error| refuse(place_at(name, begin), error.to_string()))?;
        let here = begin..first + reader.buffer_position() as usize;
        let (element, is_empty) = match &event {
            Event::Eof => break,
            Event::DocType(_) => {
                return Err(refuse(place_at(name, begin), "a document type is not allowed in a 3MF"));
            }
            Event::End(_) => {
                state.leave(here.end);
                continue;
            }
            Event::Start(element) => (element, false),
            Event::Empty(element) => (element, true),
            _ => continue,
        };
        state
            .enter(element, is_empty, here, vertex)
            .map_err(|fault| match fault {
                PartFault::Wrong(problem) => refuse(place_at(name, begin), problem),
                PartFault::Other(error) => error,
            })?;
    }
    if state.depth > 0 {
        return Err(refuse(place_at(name, bytes.len()), "the file ends inside an element"));
    }
    Ok(state.part)
}

fn place_at(name: &str, byte: usize) -> String {
    format!("{name}, byte {byte}")
}

/// What is wrong with an element: in words, or an error of the read itself.
enum PartFault {
    Wrong(String),
    Other(Error),
}

impl From<String> for PartFault {
    fn from(problem: String) -> Self {
        Self::Wrong(problem)
    }
}

impl From<Error> for PartFault {
    fn from(error: Error) -> Self {
        Self::Other(error)
    }
}

impl PartReader<'_, '_> {
    /// Reads the begin of an element, or all of one that is empty.
    fn enter(
        &mut self,
        element: &BytesStart<'_>,
        is_empty: bool,
        here: Range<usize>,
        vertex: &mut dyn FnMut(VertexPlace),
    ) -> Result<(), PartFault> {
        let depth = self.depth;
        self.depth += usize::from(!is_empty);
        if self.skipped > 0 {
            self.skipped += usize::from(!is_empty);
            return Ok(());
        }
        let local = element.local_name();
        let local = local.as_ref();
        if !matches!(local, "vertex" | "triangle") {
            self.declare(element);
        }
        let space = self.space_of(element);
        let is_metadata = depth == 1 && matches!(local, "metadata" | "metadatagroup");
        let is_resource = depth == 2 && self.path.get(1).is_some_and(|p| p == "resources");
        if is_metadata || (is_resource && !(local == "object" && space == Space::Core)) {
            if is_empty {
                self.keep(here.clone(), is_metadata);
            } else {
                self.kept = Some(KeptElement {
                    begin: here.start,
                    depth,
                    is_metadata,
                });
            }
        }
        if is_resource {
            let id = attribute_of(element, "id").and_then(|id| id.trim().parse().ok());
            self.part.largest_id = self.part.largest_id.max(id.unwrap_or(0));
        }
        if space == Space::Other {
            self.note_foreign(element);
            self.skipped += usize::from(!is_empty);
            return Ok(());
        }
        self.begin(element, local)?;
        if local == "model" && depth == 0 {
            self.part.head = here.end;
        }
        if local == "vertex"
            && let Some((object, mesh)) = self.mesh_in("vertices")
        {
            let place = mesh.positions.len() - 1;
            vertex(VertexPlace {
                object,
                place,
                bytes: here,
            });
        }
        if is_empty {
            self.end(depth);
        } else if self.path.len() == depth && depth < DEEPEST_NAMED {
            self.path.push(local.to_owned());
        }
        Ok(())
    }

    /// Reads the end of an element, which lies before that byte.
    fn leave(&mut self, end: usize) {
        self.depth = self.depth.saturating_sub(1);
        self.path.truncate(self.depth);
        if let Some(kept) = self.kept.take_if(|kept| kept.depth == self.depth) {
            self.keep(kept.begin..end, kept.is_metadata);
        }
        if self.skipped > 0 {
            self.skipped -= 1;
        } else {
            self.end(self.depth);
        }
    }

    /// Notes what prefixes stand for from here on.
    fn declare(&mut self, element: &BytesStart<'_>) {
        for attribute in element.attributes().with_checks(false).flatten() {
            let key = attribute.key.as_ref();
            let prefix = if key == "xmlns" {
                Some("")
            } else {
                key.strip_prefix("xmlns:")
            };
            let Some(prefix) = prefix else { continue };
            let uri = attribute.value.as_ref();
            // The preliminary version of 2013 has one namespace for all.
            let space = if uri.contains("/core/") || uri.ends_with("/3dmanufacturing/2013/01") {
                Space::Core
            } else if uri.contains("/material/") {
                Space::Materials
            } else if uri.contains("/production/") {
                Space::Production
            } else {
                Space::Other
            };
            if self.spaces.len() < MOST_FOREIGN || self.spaces.contains_key(prefix) {
                self.spaces.insert(prefix.to_owned(), space);
            }
        }
    }

    fn space_of(&self, element: &BytesStart<'_>) -> Space {
        let name = element.name();
        let prefix = name.as_ref().split_once(':').map_or("", |(prefix, _)| prefix);
        // Files without any namespace are taken for what they are named.
        let unknown = if prefix.is_empty() { Space::Core } else { Space::Other };
        self.spaces.get(prefix).copied().unwrap_or(unknown)
    }

    fn note_foreign(&mut self, element: &BytesStart<'_>) {
        if self.part.foreign.len() < MOST_FOREIGN {
            let name: String = element.name().as_ref().chars().take(60).collect();
            self.part.foreign.insert(name);
        }
    }

    fn keep(&mut self, range: Range<usize>, is_metadata: bool) {
        let list = match is_metadata {
            true => &mut self.part.metadata,
            false => &mut self.part.resources,
        };
        list.push(range);
    }

    fn count_thing(&mut self) -> Result<(), PartFault> {
        self.things += 1;
        match self.things > MOST_THINGS {
            true => Err(format!("more than {MOST_THINGS} objects, groups, components and items").into()),
            false => Ok(()),
        }
    }

    fn begin(&mut self, element: &BytesStart<'_>, local: &str) -> Result<(), PartFault> {
        match local {
            "vertex" => self.vertex(element),
            "triangle" => self.triangle(element),
            "model" => {
                if let Some(unit) = attribute_of(element, "unit") {
                    self.part.unit = unit.chars().take(40).collect();
                }
                let needed = attribute_of(element, "requiredextensions").unwrap_or_default();
                for prefix in needed.split_whitespace().take(MOST_FOREIGN) {
                    if self.spaces.get(prefix).copied().unwrap_or(Space::Other) == Space::Other {
                        self.part
                            .foreign
                            .insert(format!("the needed extension {prefix}").chars().take(60).collect());
                    }
                }
                Ok(())
            }
            "object" => self.begin_object(element),
            "mesh" => {
                if let Some((_, object)) = &mut self.object {
                    object.mesh.get_or_insert_default();
                }
                Ok(())
            }
            "component" => {
                self.count_thing()?;
                let component = component_of(element)?;
                if let Some((_, object)) = &mut self.object {
                    object.components.push(component);
                }
                Ok(())
            }
            "item" => {
                self.count_thing()?;
                let item = BuildItem {
                    of: component_of(element)?,
                    attributes: attributes_but(element, &["objectid", "path", "transform"]),
                };
                self.part.items.push(item);
                Ok(())
            }
            "basematerials" => self.begin_group(element, PropertyGroup::Materials(Vec::new())),
            "colorgroup" => self.begin_group(element, PropertyGroup::Colours(Vec::new())),
            "texture2dgroup" => {
                let picture = whole(element, "texid")?;
                self.begin_group(element, PropertyGroup::Picture(picture, Vec::new()))
            }
            "texture2d" => {
                self.count_thing()?;
                let path = attribute_of(element, "path").unwrap_or_default();
                let picture = PartPicture { path, bytes: None };
                self.part.pictures.insert(whole(element, "id")?, picture);
                Ok(())
            }
            "base" | "color" | "tex2coord" => self.property(element, local),
            // The last two are those of the preliminary version.
            "compositematerials" | "multiproperties" | "material" | "texture" => {
                self.note_foreign(element);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn begin_object(&mut self, element: &BytesStart<'_>) -> Result<(), PartFault> {
        self.count_thing()?;
        let id = whole(element, "id")?;
        if self.part.objects.contains_key(&id) {
            return Err(format!("object {id} is there twice").into());
        }
        let group = optional_whole(element, "pid")?;
        let place = optional_whole(element, "pindex")?.unwrap_or(0);
        let object = PrintObject {
            name: attribute_of(element, "name").unwrap_or_default(),
            property: group.map(|group| (group, place)),
            attributes: attributes_but(element, &["id", "pid", "pindex"]),
            ..PrintObject::default()
        };
        self.object = Some((id, object));
        Ok(())
    }

    fn begin_group(&mut self, element: &BytesStart<'_>, group: PropertyGroup) -> Result<(), PartFault> {
        self.count_thing()?;
        self.group = Some((whole(element, "id")?, group));
        Ok(())
    }

    fn property(&mut self, element: &BytesStart<'_>, local: &str) -> Result<(), PartFault> {
        let Some((_, group)) = &mut self.group else {
            self.note_foreign(element);
            return Ok(());
        };
        match (group, local) {
            (PropertyGroup::Materials(all), "base") => {
                let name = attribute_of(element, "name").unwrap_or_default();
                let colour = attribute_of(element, "displaycolor").unwrap_or_default();
                all.push((name, colour_of(&colour)?));
            }
            (PropertyGroup::Colours(all), "color") => {
                all.push(colour_of(&attribute_of(element, "color").unwrap_or_default())?);
            }
            (PropertyGroup::Picture(_, all), "tex2coord") => {
                let at = |name: &str| {
                    let word = attribute_of(element, name).unwrap_or_default();
                    coordinate(word.trim().as_bytes(), NumberPrecision::Single).map(|v| v as f32)
                };
                all.push([at("u")?, at("v")?]);
            }
            _ => {}
        }
        Ok(())
    }

    fn vertex(&mut self, element: &BytesStart<'_>) -> Result<(), PartFault> {
        if self.mesh_in("vertices").is_none() {
            return Ok(());
        }
        self.counts[0] += 1;
        self.watch.check_vertices(self.counts[0])?;
        let position = position_of(element)?;
        if let Some((_, mesh)) = self.mesh_in("vertices") {
            mesh.positions.push(position);
        }
        Ok(())
    }

    fn triangle(&mut self, element: &BytesStart<'_>) -> Result<(), PartFault> {
        if self.mesh_in("triangles").is_none() {
            return Ok(());
        }
        self.counts[1] += 1;
        self.watch.check_triangles(self.counts[1])?;
        let (mut corners, mut group, mut places) = ([None; 3], None, [None; 3]);
        let mut is_painted = false;
        for attribute in element.attributes().with_checks(false) {
            let attribute = attribute.map_err(|error| error.to_string())?;
            let number = || whole_of(attribute.key.as_ref(), &attribute.value);
            match attribute.key.as_ref() {
                "v1" => corners[0] = Some(number()?),
                "v2" => corners[1] = Some(number()?),
                "v3" => corners[2] = Some(number()?),
                "pid" => group = Some(number()?),
                "p1" => places[0] = Some(number()?),
                "p2" => places[1] = Some(number()?),
                "p3" => places[2] = Some(number()?),
                _ => is_painted = true,
            }
        }
        let [Some(a), Some(b), Some(c)] = corners else {
            return Err("a triangle needs v1, v2 and v3".to_owned().into());
        };
        let default = self.object.as_ref().and_then(|(_, object)| object.property);
        let own = match (group.or(default.map(|d| d.0)), places[0]) {
            (Some(group), Some(first)) => {
                Some((group, [first, places[1].unwrap_or(first), places[2].unwrap_or(first)]))
            }
            _ => None,
        };
        if let Some((_, mesh)) = self.mesh_in("triangles") {
            mesh.triangles.push([a, b, c]);
            mesh.painted += usize::from(is_painted);
            if own.is_some() || !mesh.properties.is_empty() {
                mesh.properties.resize(mesh.triangles.len() - 1, None);
                mesh.properties.push(own);
            }
        }
        Ok(())
    }

    /// The object and its mesh whose list of that name is read.
    fn mesh_in(&mut self, list: &str) -> Option<(u32, &mut ObjectMesh)> {
        let is_there = matches!(&self.path[..], [_, _, _, mesh, own] if mesh == "mesh" && own == list);
        let (id, object) = self.object.as_mut().filter(|_| is_there)?;
        Some((*id, object.mesh.as_mut()?))
    }

    /// Ends the element at that depth.
    fn end(&mut self, depth: usize) {
        if depth != 2 {
            return;
        }
        if let Some((id, object)) = self.object.take() {
            self.part.objects.insert(id, object);
        }
        if let Some((id, group)) = self.group.take() {
            self.part.groups.insert(id, group);
        }
    }
}

fn component_of(element: &BytesStart<'_>) -> Result<Component, PartFault> {
    let transform = match attribute_of(element, "transform") {
        Some(words) => transform_of(&words)?,
        None => DAffine3::IDENTITY,
    };
    Ok(Component {
        path: attribute_of(element, "path").unwrap_or_default(),
        object: whole(element, "objectid")?,
        transform,
    })
}
