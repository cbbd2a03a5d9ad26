//! What triangles of a 3MF look like: materials, colours and pictures by the properties of their corners.

use super::part::PropertyGroup;
use super::scene::{MeshUse, PrintNotes, PrintScene};
use crate::Model;
use crate::edited::{EditedModel, PrimitiveRun, TriangleOrigins};
use crate::look::{AlphaMode, BaseLook, MaterialPicture, NamedMaterial, inside_folder};
use crate::neutral::{RunAttributes, RunPart};
use pliant_mesh::NONE;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The property of a triangle: its group in a part, and a place in it for each corner.
pub(super) type TriangleProperty = (usize, u32, [u32; 3]);

/// What gives a triangle its material; triangles without one, and those of colours alone, come first.
type MaterialKey = Option<(u32, u32)>;

/// The properties of the old triangles of a primitive.
pub(super) struct UseProperties<'a> {
    scene: &'a PrintScene,
    of: &'a MeshUse,
    /// Its first triangle in the geometry of the model.
    first: u32,
    is_mirrored: bool,
}

impl<'a> UseProperties<'a> {
    /// Those of a primitive.
    pub fn new(notes: &'a PrintNotes, model: &Model, primitive: u32) -> Option<Self> {
        let of = notes.uses.get(primitive as usize)?;
        let before = model.geometry.primitives.iter().take(primitive as usize);
        Some(Self {
            scene: &notes.scene,
            of,
            first: before.map(|p| p.index_count / 3).sum(),
            is_mirrored: of.world_from_object.matrix3.determinant() < 0.0,
        })
    }

    /// Whether no triangle has any.
    pub fn are_none(&self) -> bool {
        let object = self.scene.object(self.of);
        object.is_none_or(|object| {
            object.property.is_none() && object.mesh.as_ref().is_none_or(|m| m.properties.is_empty())
        })
    }

    /// The property of an old triangle of the model, its places in the order of the triangle's corners there.
    pub fn of_triangle(&self, triangle: u32) -> Option<TriangleProperty> {
        let object = self.scene.object(self.of)?;
        let own = object
            .mesh
            .as_ref()?
            .properties
            .get(triangle.checked_sub(self.first)? as usize);
        let default = || object.property.map(|(group, place)| (group, [place; 3]));
        let (group, [a, b, c]) = own.copied().flatten().or_else(default)?;
        Some((
            self.of.part,
            group,
            if self.is_mirrored { [a, c, b] } else { [a, b, c] },
        ))
    }
}

/// A number that differs where properties of corners differ.
fn seam_of((_, group, places): TriangleProperty, corner: usize) -> u32 {
    group.wrapping_mul(0x9e37_79b1) ^ places[corner]
}

/// Where triangles of a run come from.
pub(super) enum RunOrigins<'a> {
    /// They are those of its primitive, of which this is the first.
    Untouched(u32),
    /// They were traced, with a number for each old corner that differs across seams.
    Traced(TriangleOrigins<'a>, Vec<u32>),
}

impl<'a> RunOrigins<'a> {
    pub fn new(edited: &'a EditedModel<'a>, run: &'a PrimitiveRun, properties: &UseProperties<'_>) -> Self {
        let old = &edited.base(run).model.geometry.triangles;
        let count = edited.primitive(run).index_count as usize / 3;
        let first = properties.first as usize;
        if old
            .get(first..first + count)
            .is_some_and(|own| edited.is_untouched(run, own))
        {
            return Self::Untouched(properties.first);
        }
        let mut seam = vec![0; 3 * old.len()];
        for (t, corners) in seam.chunks_exact_mut(3).enumerate() {
            if let Some(property) = properties.of_triangle(t as u32) {
                (0..3).for_each(|k| corners[k] = seam_of(property, k));
            }
        }
        Self::Traced(TriangleOrigins::new(edited, run, old), seam)
    }

    /// The old triangle that a triangle of the run lies on.
    pub fn of(&self, triangle: usize) -> Option<u32> {
        match self {
            Self::Untouched(first) => Some(first + triangle as u32),
            Self::Traced(origins, _) => origins.old_triangles().get(triangle).copied().filter(|t| *t != NONE),
        }
    }

    /// The old corners that a corner of a triangle of the run is blended from.
    pub fn corner(&self, triangle: usize, corner: usize) -> Vec<(u32, f64)> {
        match self {
            Self::Untouched(first) => vec![(3 * (first + triangle as u32) + corner as u32, 1.0)],
            Self::Traced(origins, seam) => origins.corner(triangle, corner, seam),
        }
    }
}

/// Colours and texture coordinates of the corners of a run.
#[derive(Default)]
struct CornerLooks {
    /// For each triangle its material.
    keys: Vec<MaterialKey>,
    /// For each corner of a triangle, white where it has none.
    colours: Vec<[f32; 4]>,
    uv: Vec<[f32; 2]>,
    has_colours: Vec<bool>,
    has_uv: Vec<bool>,
}

fn corner_looks(edited: &EditedModel<'_>, run: &PrimitiveRun, properties: &UseProperties<'_>) -> CornerLooks {
    let count = run.triangle_count as usize;
    if properties.are_none() {
        return CornerLooks {
            keys: vec![None; count],
            colours: vec![[1.0; 4]; 3 * count],
            uv: vec![[0.0; 2]; 3 * count],
            has_colours: vec![false; count],
            has_uv: vec![false; count],
        };
    }
    let origins = RunOrigins::new(edited, run, properties);
    let mut looks = CornerLooks::default();
    for i in 0..count {
        let property = origins.of(i).and_then(|t| properties.of_triangle(t));
        let group = property.and_then(|(part, id, _)| properties.scene.group(part, id));
        let mut has_colours = false;
        let key = match (group, property) {
            (Some(PropertyGroup::Materials(_)), Some((_, id, places))) => Some((id, places[0])),
            (Some(PropertyGroup::Picture(..)), Some((_, id, _))) => Some((id, 0)),
            (Some(PropertyGroup::Colours(_)), _) => {
                has_colours = true;
                None
            }
            _ => None,
        };
        for k in 0..3 {
            let (mut colour, mut uv, mut total) = ([0.0; 4], [0.0; 2], 0.0);
            for (corner, weight) in origins.corner(i, k) {
                let Some((part, id, places)) = properties.of_triangle(corner / 3) else {
                    continue;
                };
                let place = places[corner as usize % 3] as usize;
                match properties.scene.group(part, id) {
                    Some(PropertyGroup::Colours(all)) if has_colours => {
                        let Some(own) = all.get(place) else { continue };
                        (0..4).for_each(|l| colour[l] += f64::from(own[l]) * weight);
                    }
                    Some(PropertyGroup::Picture(_, all)) if key == Some((id, 0)) => {
                        let Some(own) = all.get(place) else { continue };
                        (0..2).for_each(|l| uv[l] += f64::from(own[l]) * weight);
                    }
                    _ => continue,
                }
                total += weight;
            }
            let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
            let blended = colour.map(|v| (v * scale) as f32);
            looks
                .colours
                .push(if has_colours && total > 0.0 { blended } else { [1.0; 4] });
            looks.uv.push([(uv[0] * scale) as f32, (1.0 - uv[1] * scale) as f32]);
        }
        looks.keys.push(key);
        looks.has_colours.push(has_colours);
        looks.has_uv.push(matches!(group, Some(PropertyGroup::Picture(..))));
    }
    looks
}

/// A run divided so that every part has one material and every vertex one colour and texture coordinate.
pub(super) fn seam_parts(edited: &EditedModel<'_>, run: &PrimitiveRun) -> Option<Vec<RunPart>> {
    let model = edited.base(run).model;
    let properties = UseProperties::new(model.notes()?, model, run.primitive)?;
    let looks = corner_looks(edited, run, &properties);
    let mut of_key: BTreeMap<MaterialKey, Vec<u32>> = BTreeMap::new();
    for (key, i) in looks.keys.iter().zip(0..) {
        of_key.entry(*key).or_default().push(i);
    }
    // In the order in which triangles first have them.
    let mut groups: Vec<_> = of_key.into_iter().collect();
    groups.sort_by_key(|(_, triangles)| triangles.first().copied());
    let local = edited.local_triangles(run);
    let is_whole = groups.len() == 1;
    let one = |(key, triangles): (MaterialKey, Vec<u32>)| {
        let mut used: Vec<u32> = match is_whole {
            true => (0..run.vertex_count).collect(),
            false => triangles.iter().flat_map(|&t| local[t as usize]).collect(),
        };
        used.sort_unstable();
        used.dedup();
        let mut part = part_of(&local, &looks, used, triangles);
        part.attributes.material = key.and_then(|key| material_of(&properties, key)).map(Arc::new);
        part
    };
    Some(groups.into_iter().map(one).collect())
}

/// The part that has these triangles; `used` are its vertices in rising order. Copies for further colours and coordinates follow them.
fn part_of(local: &[[u32; 3]], looks: &CornerLooks, used: Vec<u32>, triangles: Vec<u32>) -> RunPart {
    let with_uv = triangles.iter().any(|&t| looks.has_uv[t as usize]);
    let with_colours = triangles.iter().any(|&t| looks.has_colours[t as usize]);
    let first = used.len();
    let mut taken: Vec<Option<[u32; 6]>> = vec![None; first];
    let mut copies: BTreeMap<(u32, [u32; 6]), u32> = BTreeMap::new();
    let mut part = RunPart {
        copy_of: used,
        ..RunPart::default()
    };
    let (mut uv, mut colours) = (vec![[0.0; 2]; first], vec![[1.0; 4]; first]);
    for &t in &triangles {
        part.triangles.push(std::array::from_fn(|k| {
            let vertex = local[t as usize][k];
            let own = part.copy_of[..first].binary_search(&vertex).unwrap_or_default();
            let corner = 3 * t as usize + k;
            let (u, c) = (looks.uv[corner], looks.colours[corner]);
            let here = [u[0], u[1], c[0], c[1], c[2], c[3]].map(f32::to_bits);
            let known = taken[own].get_or_insert_with(|| {
                (uv[own], colours[own]) = (u, c);
                here
            });
            if *known == here {
                return own as u32;
            }
            *copies.entry((own as u32, here)).or_insert_with(|| {
                part.copy_of.push(vertex);
                uv.push(u);
                colours.push(c);
                part.copy_of.len() as u32 - 1
            })
        }));
    }
    if with_uv {
        part.attributes = RunAttributes {
            uv,
            ..RunAttributes::default()
        };
    }
    if with_colours {
        part.attributes.colours = colours;
    }
    part.source_triangles = triangles;
    part
}

/// The material of a key, with its picture.
fn material_of(properties: &UseProperties<'_>, (group, place): (u32, u32)) -> Option<NamedMaterial> {
    let part = properties.scene.parts.get(properties.of.part)?;
    let (name, look) = match part.groups.get(&group)? {
        PropertyGroup::Materials(all) => {
            let (name, colour) = all.get(place as usize)?;
            let coverage = if colour[3] < 1.0 {
                AlphaMode::Blend
            } else {
                AlphaMode::Opaque
            };
            let look = BaseLook {
                colour: *colour,
                coverage,
                ..BaseLook::default()
            };
            (name.clone(), look)
        }
        PropertyGroup::Picture(id, _) => {
            let own = part.pictures.get(id)?;
            let last = own.path.rsplit('/').next().and_then(inside_folder)?;
            let look = BaseLook {
                picture: Some(MaterialPicture {
                    name: last.clone(),
                    bytes: own.bytes.clone(),
                }),
                ..BaseLook::default()
            };
            (last, look)
        }
        PropertyGroup::Colours(_) => return None,
    };
    Some(NamedMaterial { name, look: Some(look) })
}
