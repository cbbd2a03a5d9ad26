//! The text of a model part in the making: objects, groups of properties, and what is built.
//!
//! Printers want closed surfaces, so vertices of an object that lie at one place are one, and triangles that come to nothing are left out.

use super::identities::Identities;
use super::scene::unwritable;
use crate::Error;
use crate::formats::text::{NumberPrecision, push_number};
use crate::model::position_bits;
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// The namespace of colours and pictures.
pub(super) const MATERIALS: &str = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02";

/// A property of a triangle as it is written: the number of its group, and a place for each corner.
pub(super) type WrittenProperty = Option<(u32, [u32; 3])>;

/// The mesh of one object.
#[derive(Default)]
pub(super) struct MeshText {
    /// Vertices by their places and the old vertex that each is, [`NONE`] for new ones.
    known: BTreeMap<([u64; 3], u32), u32>,
    vertices: Vec<u8>,
    triangles: Vec<u8>,
    /// Those with a corner twice, which printers reject: they are written where there are no others, so that the file opens.
    collapsed: Vec<u8>,
    first_property: WrittenProperty,
}

impl MeshText {
    pub fn vertex(&mut self, place: DVec3, old: u32) -> u32 {
        let next = self.known.len() as u32;
        let key = (position_bits(place + 0.0), old);
        let number = *self.known.entry(key).or_insert(next);
        if number == next {
            self.vertices.extend_from_slice(b"<vertex");
            for (axis, value) in ["x", "y", "z"].into_iter().zip(place.to_array()) {
                self.vertices.extend(format!(" {axis}=\"").bytes());
                push_number(&mut self.vertices, value, NumberPrecision::Double);
                self.vertices.push(b'"');
            }
            self.vertices.extend_from_slice(b"/>\n");
        }
        number
    }

    pub fn triangle(&mut self, [a, b, c]: [u32; 3], property: WrittenProperty) {
        let text = match a == b || b == c || c == a {
            true => &mut self.collapsed,
            false => &mut self.triangles,
        };
        text.extend(format!("<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\"").bytes());
        if let Some((group, [p1, p2, p3])) = property {
            self.first_property = self.first_property.or(property);
            text.extend(format!(" pid=\"{group}\" p1=\"{p1}\"").bytes());
            if [p2, p3] != [p1; 2] {
                text.extend(format!(" p2=\"{p2}\" p3=\"{p3}\"").bytes());
            }
        }
        text.extend_from_slice(b"/>\n");
    }

    /// Whether there is no triangle.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty() && self.collapsed.is_empty()
    }
}

/// A model part in the making.
#[derive(Default)]
pub(super) struct PartText {
    pub groups: Vec<u8>,
    pub objects: Vec<u8>,
    pub items: Vec<u8>,
    next_id: u32,
    /// Pictures of a fresh package, by the names of their parts.
    pub pictures: Vec<(String, Vec<u8>)>,
    /// What cannot be said, each once.
    pub lost: BTreeSet<String>,
    /// What elements without a UUID get.
    pub identities: Identities,
}

impl PartText {
    pub fn new(first_id: u32) -> Self {
        Self {
            next_id: first_id,
            ..Self::default()
        }
    }

    /// A number that no resource has.
    pub fn take_id(&mut self) -> Result<u32, Error> {
        let id = self.next_id;
        // Numbers of resources are below 2^31.
        self.next_id = id
            .checked_add(1)
            .filter(|next| *next <= 1 << 31)
            .ok_or_else(|| unwritable("resources have no numbers left"))?;
        Ok(id)
    }

    /// Adds an object with a mesh; `attributes` as they are written.
    pub fn push_mesh(&mut self, id: u32, attributes: &str, mesh: &MeshText) {
        let attributes = self.identities.with_uuid(attributes);
        let out = &mut self.objects;
        out.extend(format!("<object id=\"{id}\"{attributes}").bytes());
        if let Some((group, [first, ..])) = mesh.first_property {
            out.extend(format!(" pid=\"{group}\" pindex=\"{first}\"").bytes());
        }
        out.extend_from_slice(b"><mesh><vertices>\n");
        out.extend_from_slice(&mesh.vertices);
        out.extend_from_slice(b"</vertices><triangles>\n");
        out.extend_from_slice(if mesh.triangles.is_empty() {
            &mesh.collapsed
        } else {
            &mesh.triangles
        });
        out.extend_from_slice(b"</triangles></mesh></object>\n");
    }

    pub fn push_item(&mut self, object: u32, attributes: &str) {
        let attributes = self.identities.with_uuid(attributes);
        self.items
            .extend(format!("<item objectid=\"{object}\"{attributes}/>\n").bytes());
    }

    pub fn push_materials<'n>(&mut self, id: u32, all: impl IntoIterator<Item = (&'n str, [f32; 4])>) {
        self.groups.extend(format!("<basematerials id=\"{id}\">").bytes());
        for (name, colour) in all {
            let name = match name {
                "" => "material".into(),
                name => escaped(name),
            };
            self.groups
                .extend(format!("<base name=\"{name}\" displaycolor=\"{}\"/>", hex(colour)).bytes());
        }
        self.groups.extend_from_slice(b"</basematerials>\n");
    }

    pub fn push_colours(&mut self, id: u32, all: impl IntoIterator<Item = [f32; 4]>) {
        self.groups
            .extend(format!("<m:colorgroup xmlns:m=\"{MATERIALS}\" id=\"{id}\">").bytes());
        for colour in all {
            self.groups
                .extend(format!("<m:color color=\"{}\"/>", hex(colour)).bytes());
        }
        self.groups.extend_from_slice(b"</m:colorgroup>\n");
    }
}

/// The attribute of a name; nothing for none.
pub(super) fn name_attribute(name: &str) -> String {
    match name {
        "" => String::new(),
        name => format!(" name=\"{}\"", escaped(name)),
    }
}

/// Text for an attribute, without letters that XML has not.
fn escaped(text: &str) -> String {
    let plain: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    quick_xml::escape::escape(plain).into_owned()
}

pub(super) fn bytes_of(colour: [f32; 4]) -> [u8; 4] {
    colour.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)
}

fn hex(colour: [f32; 4]) -> String {
    let [r, g, b, a] = bytes_of(colour);
    match a {
        255 => format!("#{r:02X}{g:02X}{b:02X}"),
        a => format!("#{r:02X}{g:02X}{b:02X}{a:02X}"),
    }
}
