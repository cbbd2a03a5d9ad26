//! Objects of a 3MF that come from models of other formats, and packages of nothing else.

use super::model_text::{MATERIALS, MeshText, PartText, WrittenProperty, bytes_of, name_attribute};
use super::package::{FORMAT, pack};
use crate::formats::text::{NumberPrecision, push_number};
use crate::look::MaterialPicture;
use crate::neutral::{CAP_COLOUR, NeutralModel, NeutralPrimitive};
use crate::{Error, WrittenFiles, WrittenWarning};
use pliant_mesh::NONE;
use std::collections::BTreeMap;

const CORE: &str = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02";
const RELATIONS: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
const MODEL: &str = "3D/3dmodel.model";
const WHITE: [f32; 4] = [1.0; 4];

/// Adds the objects of a neutral model. `with_pictures`: whether the package is a fresh one, which pictures are added to.
pub(super) fn push_neutral(text: &mut PartText, neutral: &NeutralModel, with_pictures: bool) -> Result<(), Error> {
    let mut table = NeutralLooks::default();
    let filled = neutral.primitives().filter(|own| !own.triangles.is_empty());
    // Parts of one surface are one object, which is closed where the surface is.
    let mut objects: Vec<Vec<NeutralPrimitive<'_>>> = Vec::new();
    let mut place_of = BTreeMap::new();
    for own in filled {
        let place = *place_of.entry(own.attributes.of_object).or_insert(objects.len());
        objects.resize_with(objects.len().max(place + 1), Vec::new);
        objects[place].push(own);
    }
    for parts in &objects {
        push_object(text, neutral, parts, &mut table, with_pictures)?;
    }
    table.finish(text);
    Ok(())
}

/// Adds the object of some primitives, with vertices and triangles in the order of the model.
fn push_object(
    text: &mut PartText,
    neutral: &NeutralModel,
    parts: &[NeutralPrimitive<'_>],
    table: &mut NeutralLooks,
    with_pictures: bool,
) -> Result<(), Error> {
    let mut mesh = MeshText::default();
    let mut vertices: Vec<usize> = parts.iter().flat_map(|own| own.vertices.clone()).collect();
    vertices.sort_by_key(|v| neutral.copy_of.get(*v));
    for vertex in vertices {
        mesh.vertex(neutral.geometry.positions[vertex], NONE);
    }
    let mut properties = Vec::with_capacity(parts.len());
    for own in parts {
        properties.push(table.of_primitive(text, neutral, own, with_pictures)?);
    }
    if properties.iter().any(|property| !property.is_none()) {
        // Triangles that name none would have the property of the object.
        for property in properties.iter_mut().filter(|property| property.is_none()) {
            *property = table.material(text, (String::new(), [1.0; 4]))?;
        }
    }
    let of_part = |(own, k): (&NeutralPrimitive<'_>, usize)| (0..own.triangles.len()).map(move |i| (k, i));
    let mut triangles: Vec<(usize, usize)> = parts.iter().zip(0..).flat_map(of_part).collect();
    triangles.sort_by_key(|(k, i)| neutral.source_triangles.get(parts[*k].first_triangle + i));
    for (k, i) in triangles {
        let own = &parts[k];
        let corners = own.triangles[i].map(|v| mesh.vertex(neutral.geometry.positions[v as usize], NONE));
        mesh.triangle(corners, properties[k].of_triangle(neutral, own, i, table));
    }
    if let Some(first) = parts.first().filter(|_| !mesh.is_empty()) {
        let id = text.take_id()?;
        text.push_mesh(id, &name_attribute(&first.primitive.name), &mesh);
        text.push_item(id, "");
    }
    Ok(())
}

/// Whether vertices of triangles have a colour that shows; white leaves materials as they are.
fn has_colours(neutral: &NeutralModel, own: &NeutralPrimitive<'_>) -> bool {
    let colour = |v: &u32| neutral.colours.get(*v as usize).copied().unwrap_or(WHITE);
    let mut corners = own.triangles.as_flattened().iter();
    own.attributes.has_colours && corners.any(|v| bytes_of(colour(v)) != bytes_of(WHITE))
}

/// What the triangles of a neutral primitive have.
enum NeutralProperty {
    None,
    /// A place in the table of materials.
    Material(u32, u32),
    /// Colours by vertex, in the group of that number, each times the colour of the material.
    Colours(u32, [f32; 4]),
    /// Texture coordinates, in the group of that number at that place of the list of groups.
    Picture(u32, usize),
}

/// Groups of properties of neutral primitives.
#[derive(Default)]
struct NeutralLooks {
    materials: Option<u32>,
    of_materials: Vec<(String, [f32; 4])>,
    colours: Option<u32>,
    of_colours: BTreeMap<[u8; 4], u32>,
    /// For each picture the number of its group and the coordinates in it.
    pictures: Vec<PictureGroup>,
}

struct PictureGroup {
    picture: MaterialPicture,
    /// The numbers of the picture and of the group.
    ids: [u32; 2],
    part: String,
    coordinates: BTreeMap<[u32; 2], u32>,
}

impl NeutralLooks {
    fn of_primitive(
        &mut self,
        text: &mut PartText,
        neutral: &NeutralModel,
        own: &NeutralPrimitive<'_>,
        with_pictures: bool,
    ) -> Result<NeutralProperty, Error> {
        let look = own.attributes.material.as_ref();
        let picture = look.and_then(|m| m.look.as_ref()?.picture.as_ref());
        let colour = look.and_then(|m| m.look.as_ref()).map_or(WHITE, |look| look.colour);
        let has_uv = neutral.uv_at(own, 0).is_some();
        let has_colours = has_colours(neutral, own);
        if let Some(picture) = picture.filter(|_| has_uv) {
            if let Some(kind) = picture_kind(picture).filter(|_| with_pictures) {
                if has_colours {
                    text.lost.insert("colours of vertices under a picture".into());
                }
                if bytes_of(colour) != bytes_of(WHITE) {
                    text.lost.insert("colours of materials under a picture".into());
                }
                return self.picture(text, picture, kind);
            }
            text.lost
                .insert("pictures (PNG and JPEG that came along go into a fresh 3mf)".into());
        } else if has_uv {
            text.lost.insert("texture coordinates without a picture".into());
        }
        if has_colours {
            if look.is_some() {
                text.lost
                    .insert("materials of vertices with colours (their colours are multiplied)".into());
            }
            let id = match self.colours {
                Some(id) => id,
                None => text.take_id()?,
            };
            self.colours = Some(id);
            return Ok(NeutralProperty::Colours(id, colour));
        }
        let Some(material) = look else {
            return Ok(NeutralProperty::None);
        };
        let colour = material.look.as_ref().map_or(CAP_COLOUR, |look| look.colour);
        self.material(text, (material.name.clone(), colour))
    }

    /// A row of the table of materials: a name and a colour.
    fn material(&mut self, text: &mut PartText, row: (String, [f32; 4])) -> Result<NeutralProperty, Error> {
        let id = match self.materials {
            Some(id) => id,
            None => text.take_id()?,
        };
        self.materials = Some(id);
        let place = self
            .of_materials
            .iter()
            .position(|known| *known == row)
            .unwrap_or_else(|| {
                self.of_materials.push(row);
                self.of_materials.len() - 1
            });
        Ok(NeutralProperty::Material(id, place as u32))
    }

    fn picture(
        &mut self,
        text: &mut PartText,
        picture: &MaterialPicture,
        kind: &'static str,
    ) -> Result<NeutralProperty, Error> {
        let known = self.pictures.iter().position(|group| group.picture == *picture);
        let place = match known {
            Some(place) => place,
            None => {
                let part = format!("3D/Textures/{}.{kind}", self.pictures.len() + 1);
                let bytes = picture.bytes.as_ref().map(|bytes| bytes.to_vec());
                text.pictures.push((part.clone(), bytes.unwrap_or_default()));
                self.pictures.push(PictureGroup {
                    picture: picture.clone(),
                    ids: [text.take_id()?, text.take_id()?],
                    part,
                    coordinates: BTreeMap::new(),
                });
                self.pictures.len() - 1
            }
        };
        Ok(NeutralProperty::Picture(self.pictures[place].ids[1], place))
    }

    /// Writes the groups.
    fn finish(self, text: &mut PartText) {
        if let Some(id) = self.materials {
            text.push_materials(
                id,
                self.of_materials.iter().map(|(name, colour)| (name.as_str(), *colour)),
            );
        }
        if let Some(id) = self.colours {
            let mut all: Vec<([u8; 4], u32)> = self.of_colours.into_iter().collect();
            all.sort_by_key(|(_, place)| *place);
            text.push_colours(id, all.into_iter().map(|(c, _)| c.map(|v| f32::from(v) / 255.0)));
        }
        for group in self.pictures {
            let [picture, id] = group.ids;
            let kind = if group.part.ends_with("png") {
                "image/png"
            } else {
                "image/jpeg"
            };
            let out = &mut text.groups;
            out.extend(
                format!(
                    "<m:texture2d xmlns:m=\"{MATERIALS}\" id=\"{picture}\" path=\"/{}\" contenttype=\"{kind}\"/>\n",
                    group.part
                )
                .bytes(),
            );
            out.extend(format!("<m:texture2dgroup xmlns:m=\"{MATERIALS}\" id=\"{id}\" texid=\"{picture}\">").bytes());
            let mut all: Vec<([u32; 2], u32)> = group.coordinates.into_iter().collect();
            all.sort_by_key(|(_, place)| *place);
            for ([u, v], _) in all {
                out.extend_from_slice(b"<m:tex2coord u=\"");
                push_number(out, f32::from_bits(u).into(), NumberPrecision::Single);
                out.extend_from_slice(b"\" v=\"");
                push_number(out, (1.0 - f32::from_bits(v)).into(), NumberPrecision::Single);
                out.extend_from_slice(b"\"/>");
            }
            out.extend_from_slice(b"</m:texture2dgroup>\n");
        }
    }
}

impl NeutralProperty {
    fn is_none(&self) -> bool {
        matches!(self, Self::None)
    }

    fn of_triangle(
        &self,
        neutral: &NeutralModel,
        own: &NeutralPrimitive<'_>,
        triangle: usize,
        table: &mut NeutralLooks,
    ) -> WrittenProperty {
        match *self {
            Self::None => None,
            Self::Material(id, place) => Some((id, [place; 3])),
            Self::Colours(id, material) => {
                let of = |v: u32| {
                    let own = neutral.colours.get(v as usize).copied().unwrap_or(WHITE);
                    let colour: [f32; 4] = std::array::from_fn(|k| own[k] * material[k]);
                    let next = table.of_colours.len() as u32;
                    *table.of_colours.entry(bytes_of(colour)).or_insert(next)
                };
                Some((id, own.triangles[triangle].map(of)))
            }
            Self::Picture(id, place) => {
                let all = &mut table.pictures[place].coordinates;
                let of = |k: u32| {
                    let uv = neutral.uv_at(own, 3 * triangle as u32 + k).unwrap_or_default();
                    let next = all.len() as u32;
                    *all.entry(uv.map(f32::to_bits)).or_insert(next)
                };
                Some((id, [0, 1, 2].map(of)))
            }
        }
    }
}

/// A fresh package of a model that came in another format.
pub(super) fn build(neutral: &NeutralModel) -> Result<WrittenFiles, Error> {
    let mut text = PartText::new(1);
    push_neutral(&mut text, neutral, true)?;
    let unit = if neutral.in_metres { "meter" } else { "millimeter" };
    let mut model = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<model unit=\"{unit}\" xml:lang=\"en-US\" xmlns=\"{CORE}\" xmlns:m=\"{MATERIALS}\">\n\
         <metadata name=\"Application\">pliant</metadata>\n<resources>\n"
    )
    .into_bytes();
    model.extend_from_slice(&text.groups);
    model.extend_from_slice(&text.objects);
    model.extend_from_slice(b"</resources>\n<build>\n");
    model.extend_from_slice(&text.items);
    model.extend_from_slice(b"</build>\n</model>\n");
    let mut parts = vec![
        ("[Content_Types].xml".to_owned(), CONTENT_TYPES.as_bytes().to_vec()),
        (
            "_rels/.rels".to_owned(),
            relations([(
                "/3D/3dmodel.model",
                "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel",
            )]),
        ),
        (MODEL.to_owned(), model),
    ];
    if !text.pictures.is_empty() {
        let names: Vec<String> = text.pictures.iter().map(|(name, _)| format!("/{name}")).collect();
        let kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dtexture";
        parts.push((
            "3D/_rels/3dmodel.model.rels".to_owned(),
            relations(names.iter().map(|name| (name.as_str(), kind))),
        ));
    }
    parts.append(&mut text.pictures);
    let lost: Vec<String> = text.lost.into_iter().collect();
    Ok(WrittenFiles {
        warnings: WrittenWarning::left_out(&lost, FORMAT, "").into_iter().collect(),
        ..WrittenFiles::single(pack(&parts)?)
    })
}

const CONTENT_TYPES: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
    <Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\
    <Default Extension=\"rels\" ContentType=\"application/vnd.openxmlformats-package.relationships+xml\"/>\
    <Default Extension=\"model\" ContentType=\"application/vnd.ms-package.3dmanufacturing-3dmodel+xml\"/>\
    <Default Extension=\"png\" ContentType=\"image/png\"/><Default Extension=\"jpg\" ContentType=\"image/jpeg\"/></Types>\n";

fn relations<'a>(all: impl IntoIterator<Item = (&'a str, &'a str)>) -> Vec<u8> {
    let mut text = format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Relationships xmlns=\"{RELATIONS}\">");
    for (i, (target, kind)) in all.into_iter().enumerate() {
        text.push_str(&format!(
            "<Relationship Target=\"{target}\" Id=\"rel{i}\" Type=\"{kind}\"/>"
        ));
    }
    text.push_str("</Relationships>\n");
    text.into_bytes()
}

/// The kind of a picture that came along, as its part is named.
fn picture_kind(picture: &MaterialPicture) -> Option<&'static str> {
    let bytes = picture.bytes.as_ref()?;
    match &bytes[..] {
        [0x89, b'P', b'N', b'G', ..] => Some("png"),
        [0xff, 0xd8, ..] => Some("jpg"),
        _ => None,
    }
}
