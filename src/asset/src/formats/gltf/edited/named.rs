//! Extensions of a primitive that name its vertices or triangles by number, after an edit.

use super::super::builder::AccessorKind;
use super::super::document::GltfDocument;
use super::super::elements::{segments_between, stored_elements};
use super::super::extensions::{FEATURES, OUTLINE};
use super::super::read::{GltfNotes, PlacedPrimitive};
use super::super::schema::MeshPrimitive;
use super::super::text::{index_of, json_array, list_of, value_of, with_member, without_extensions};
use super::blended::AccessorNumbers;
use super::primitives::PrimitiveMaker;
use crate::Error;
use crate::edited::{FollowedLines, PrimitiveRun, VertexBlend};

impl PrimitiveMaker<'_, '_> {
    /// Writes which of the new vertices points and lines are drawn between, and in which mode: lines that an edit has divided or
    /// cut are pairs.
    pub(super) fn followed_elements(
        &mut self,
        run: &PrimitiveRun,
        row: &PlacedPrimitive,
        primitive: &MeshPrimitive,
    ) -> Result<(usize, u64), Error> {
        let stored = stored_elements(self.doc, primitive, row.vertices.clone())?;
        let followed = FollowedLines::of_runs(self.edited, std::iter::once(run));
        let there: Option<Vec<u32>> = stored.iter().map(|old| followed.vertex(*old)).collect();
        let is_new = |vertex: usize| matches!(self.edited.blend(vertex), VertexBlend::Blend(_));
        let is_whole = run.vertex_count as usize == row.vertices.len() && !run.vertices().any(is_new);
        let (numbers, mode) = match (there, primitive.mode()) {
            (Some(there), mode) if is_whole || mode == 0 => (there, mode),
            (_, 0) => (stored.iter().filter_map(|old| followed.vertex(*old)).collect(), 0),
            (_, mode) => {
                let segments = segments_between(&stored, mode).into_iter();
                (
                    segments
                        .flat_map(|[from, to]| followed.segment(from, to))
                        .flatten()
                        .collect(),
                    1,
                )
            }
        };
        let own: Vec<u32> = numbers.iter().map(|v| v - run.first_vertex).collect();
        Ok((
            self.fresh.add_numbers_of_vertices(&own, run.vertex_count as usize),
            mode,
        ))
    }

    /// A primitive or mesh without an extension, which is noted where it was there.
    pub(super) fn without_extension(&mut self, text: &str, name: &'static str) -> String {
        let left = without_extensions(text, &[name]);
        if left.len() != text.len() {
            self.dropped.insert(name);
        }
        left
    }

    /// A primitive with the outline of its new vertices, where all of the old one is still there; else without.
    pub(super) fn with_outline(&mut self, run: &PrimitiveRun, text: &str) -> Result<String, Error> {
        let Some(outline) = extension_of(text, OUTLINE) else {
            return Ok(text.to_owned());
        };
        let indices = index_of(outline, "indices").filter(|i| self.doc.accessors.get(*i).is_some());
        let Some(indices) = indices else {
            return Ok(self.without_extension(text, OUTLINE));
        };
        self.doc.decode_for([indices])?;
        let Ok(pairs) = self.doc.read_indices(indices) else {
            return Ok(self.without_extension(text, OUTLINE));
        };
        let first = self.edited.primitive(run).first_vertex;
        let lines = FollowedLines::of_runs(self.edited, std::iter::once(run));
        let mut ends: Vec<u32> = Vec::new();
        for &[a, b] in pairs.as_chunks::<2>().0 {
            let Some(edges) = lines.edges_along(first.saturating_add(a), first.saturating_add(b)) else {
                return Ok(self.without_extension(text, OUTLINE));
            };
            ends.extend(edges.into_iter().flatten().map(|v| v - run.first_vertex));
        }
        if ends.is_empty() {
            return Ok(without_extensions(text, &[OUTLINE]));
        }
        let at = self.fresh.add_numbers_of_vertices(&ends, run.vertex_count as usize);
        Ok(with_extension(text, OUTLINE, &with_member(outline, "indices", at)))
    }

    /// A primitive with its features by an attribute where they were numbered as its vertices are.
    pub(super) fn with_feature_numbers(
        &mut self,
        run: &PrimitiveRun,
        text: &str,
        attributes: &mut AccessorNumbers,
    ) -> String {
        let Some(features) = extension_of(text, FEATURES) else {
            return text.to_owned();
        };
        let mut sets: Vec<String> = list_of(features, "featureIds").into_iter().map(str::to_owned).collect();
        let by_vertex = |set: &&mut String| value_of(set, "attribute").is_none() && value_of(set, "texture").is_none();
        for set in sets.iter_mut().filter(by_vertex) {
            let first = self.edited.primitive(run).first_vertex;
            let number = |vertex: usize| self.edited.blend(vertex).heaviest().saturating_sub(first) as f32;
            let numbers: Vec<f32> = run.vertices().map(number).collect();
            let mut free = 0;
            while attributes.contains_key(&format!("_FEATURE_ID_{free}")) {
                free += 1;
            }
            let at = self.fresh.add_floats(&numbers, "SCALAR", AccessorKind::Floats);
            attributes.insert(format!("_FEATURE_ID_{free}"), at);
            *set = with_member(set, "attribute", free);
        }
        with_extension(text, FEATURES, &with_member(features, "featureIds", json_array(&sets)))
    }
}

/// The segments of the lines of a document, by the vertices of its model; of points both ends are one.
pub(in super::super) fn segments(doc: &GltfDocument<'_>, notes: &GltfNotes) -> Result<Vec<[u32; 2]>, Error> {
    let mut found = Vec::new();
    for row in &notes.rows {
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let mode = primitive.mode();
        if mode < 4 {
            let stored = stored_elements(doc, primitive, row.vertices.clone())?;
            found.extend(match mode {
                0 => stored.iter().map(|v| [*v; 2]).collect(),
                _ => segments_between(&stored, mode),
            });
        }
    }
    Ok(found)
}

fn extension_of<'t>(text: &'t str, name: &str) -> Option<&'t str> {
    value_of(value_of(text, "extensions")?, name)
}

fn with_extension(text: &str, name: &str, value: &str) -> String {
    let own = value_of(text, "extensions").unwrap_or("{}");
    with_member(text, "extensions", with_member(own, name, value))
}
