//! Attributes of a primitive as numbers, and how each kind is blended.

use super::super::accessors::{AccessorLayout, ComponentType, ShapeAttribute, check_unbacked, read_values};
use super::super::buffers::BufferBytes;
use super::super::document::GltfDocument;
use super::super::read::GltfNotes;
use crate::asset::edited::{EditedModel, PrimitiveRun, VertexBlend};
use crate::asset::vertex_attributes::AttributeKeys;
use crate::asset::{Error, Model};
use std::collections::BTreeMap;

/// One attribute of all vertices of a primitive.
pub(super) struct AttributeValues {
    /// Numbers per vertex.
    pub(super) lanes: usize,
    /// Whether its stored numbers are whole and mean themselves, such as joints and identifiers.
    pub(super) is_whole: bool,
    /// Lane by lane.
    pub(super) values: Vec<f32>,
}

/// The name of the accessor type with so many numbers; matrices are kept as such.
pub(super) fn shape_of(stored: &str) -> &'static str {
    match stored {
        "VEC2" => "VEC2",
        "VEC3" => "VEC3",
        "VEC4" => "VEC4",
        "MAT2" => "MAT2",
        "MAT3" => "MAT3",
        "MAT4" => "MAT4",
        _ => "SCALAR",
    }
}

/// Reads an attribute, whatever it is stored as. Compressed views must be decoded.
pub(super) fn read(doc: &GltfDocument<'_>, buffers: &BufferBytes, index: usize) -> Result<AttributeValues, Error> {
    let place = || format!("accessors/{index}");
    let Some(accessor) = doc.accessors.get(index) else {
        return Err(doc.fault.malformed(place(), "does not exist"));
    };
    let Some(layout) = AccessorLayout::of(accessor, doc.views.values) else {
        let problem = format!(
            "component type {} with type {:?} is none that glTF knows",
            accessor.component_type.0, accessor.shape
        );
        return Err(doc.fault.malformed(place(), problem));
    };
    check_unbacked(doc, index, layout)?;
    Ok(AttributeValues {
        lanes: layout.lanes,
        is_whole: layout.component != ComponentType::F32 && !accessor.normalized,
        values: read_values(doc, buffers, index, layout)?,
    })
}

/// Hands out all attributes of the vertices of a model but their shape, those of morph targets included.
pub(in super::super) fn tell_apart(
    model: &Model,
    notes: &GltfNotes,
    keys: &mut AttributeKeys<'_>,
) -> Result<(), Error> {
    let (doc, mut buffers) = notes.document_and_bytes(model)?;
    for row in &notes.rows {
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let shape = |name: &str| ShapeAttribute::ALL.iter().any(|own| own.name() == name);
        let own = primitive.attributes.iter().filter(|(name, _)| !shape(name));
        let targets = primitive.targets.iter().flatten();
        let all: Vec<usize> = own.chain(targets).map(|(_, accessor)| accessor.index()).collect();
        buffers.decode_for(&doc, &all.iter().copied().collect())?;
        for accessor in all {
            // What only an extension can read is not written again either.
            let stored = doc.accessors.get(accessor);
            let Some(layout) = stored.and_then(|a| AccessorLayout::of(a, doc.views.values)) else {
                continue;
            };
            keys.spend(row.vertices.len() as u64 * layout.lanes as u64)?;
            let channel = read(&doc, &buffers, accessor)?;
            keys.add_values(row.vertices.start, channel.lanes, &channel.values);
        }
    }
    Ok(())
}

/// The vertices of one run, by what they are made of among the vertices of its primitive.
pub(super) struct AttributeBlender<'a> {
    edited: &'a EditedModel<'a>,
    run: &'a PrimitiveRun,
    first: usize,
}

impl<'a> AttributeBlender<'a> {
    pub(super) fn new(edited: &'a EditedModel<'a>, run: &'a PrimitiveRun) -> Self {
        let first = edited.primitive(run).first_vertex as usize;
        Self { edited, run, first }
    }

    /// How many vertices the run has.
    pub(super) fn len(&self) -> usize {
        self.run.vertex_count as usize
    }

    /// The blends over the primitive's own vertices, which count from 0.
    fn blends(&self) -> impl Iterator<Item = VertexBlend<'a>> + '_ {
        self.run.vertices().map(|vertex| self.edited.blend(vertex))
    }

    /// The vertices of the primitive, counted from 0, that a vertex of the run is made of, with their weights.
    pub(super) fn old_vertices(&self, vertex: usize) -> Vec<(usize, f64)> {
        let blend = self.edited.blend(self.run.first_vertex as usize + vertex);
        blend
            .iter()
            .map(|(old, weight)| (old as usize - self.first, weight))
            .collect()
    }

    fn vertex_values<'c>(&self, channel: &'c AttributeValues, vertex: u32) -> &'c [f32] {
        // The blend was checked to lie in the primitive, and the accessor to have an element for each of its vertices.
        let first = (vertex as usize - self.first) * channel.lanes;
        channel.values.get(first..first + channel.lanes).unwrap_or(&[])
    }

    /// Linear in every number; what is not finite counts as zero where it would spread.
    pub(super) fn blend_linearly(&self, channel: &AttributeValues) -> Vec<f32> {
        let mut out = Vec::with_capacity(self.run.vertex_count as usize * channel.lanes);
        let mut sums = vec![0.0_f64; channel.lanes];
        for blend in self.blends() {
            if let VertexBlend::Vertex(vertex) = blend {
                out.extend_from_slice(self.vertex_values(channel, vertex));
                continue;
            }
            sums.fill(0.0);
            for (vertex, weight) in blend.iter() {
                let finite = self
                    .vertex_values(channel, vertex)
                    .iter()
                    .map(|&v| if v.is_finite() { f64::from(v) } else { 0.0 });
                sums.iter_mut().zip(finite).for_each(|(sum, v)| *sum += v * weight);
            }
            out.extend(sums.iter().map(|&v| v as f32));
        }
        out
    }

    /// The value of the heaviest vertex, for what cannot be blended.
    pub(super) fn take_heaviest(&self, channel: &AttributeValues) -> Vec<f32> {
        let elements = self
            .blends()
            .flat_map(|blend| self.vertex_values(channel, blend.heaviest()));
        elements.copied().collect()
    }

    /// Joints and weights of all sets of a primitive: the union of the influences, the heaviest of them scaled to a sum
    /// of 1. Vertices that the edit left alone keep theirs as they are stored.
    pub(super) fn blend_skin(
        &self,
        joints: &[AttributeValues],
        weights: &[AttributeValues],
    ) -> (Vec<Vec<f32>>, Vec<Vec<f32>>) {
        let sets = joints.len();
        let count = self.run.vertex_count as usize;
        let mut out = (
            vec![Vec::with_capacity(count * 4); sets],
            vec![Vec::with_capacity(count * 4); sets],
        );
        let mut sums = BTreeMap::new();
        for blend in self.blends() {
            if let VertexBlend::Vertex(vertex) = blend {
                for set in 0..sets {
                    out.0[set].extend_from_slice(self.vertex_values(&joints[set], vertex));
                    out.1[set].extend_from_slice(self.vertex_values(&weights[set], vertex));
                }
                continue;
            }
            sums.clear();
            for (vertex, share) in blend.iter() {
                for set in 0..sets {
                    let joints = self.vertex_values(&joints[set], vertex).iter();
                    for (&joint, &weight) in joints.zip(self.vertex_values(&weights[set], vertex)) {
                        if weight > 0.0 && weight.is_finite() {
                            *sums.entry(joint as u32).or_insert(0.0) += f64::from(weight) * share;
                        }
                    }
                }
            }
            let influences = heaviest_influences(&sums, 4 * sets);
            for slot in 0..4 * sets {
                let (joint, weight) = influences.get(slot).copied().unwrap_or((0, 0.0));
                out.0[slot / 4].push(joint as f32);
                out.1[slot / 4].push(weight as f32);
            }
        }
        out
    }
}

/// The heaviest influences, heaviest first, scaled to a sum of 1.
fn heaviest_influences(sums: &BTreeMap<u32, f64>, most: usize) -> Vec<(u32, f64)> {
    let mut list: Vec<(u32, f64)> = sums.iter().map(|(&joint, &weight)| (joint, weight)).collect();
    list.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    list.truncate(most);
    let total: f64 = list.iter().map(|(_, weight)| weight).sum();
    list.iter_mut().for_each(|(_, weight)| *weight /= total);
    // What rounds to nothing would be a joint without weight, which files should not name.
    list.retain(|(_, weight)| *weight as f32 > 0.0);
    list
}
