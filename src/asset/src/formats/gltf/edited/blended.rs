//! Attributes of edited primitives, blended from those of old vertices: numbers, skins and morph targets.

use super::super::accessors::{ComponentType, ShapeAttribute};
use super::super::builder::{AccessorKind, BufferBuilder};
use super::super::container::GltfFault;
use super::super::document::GltfDocument;
use super::super::placement::{Placement, VertexInfluences, VertexTransforms, influence_accessors, is_writable};
use super::super::read::GltfNotes;
use super::super::schema::MeshPrimitive;
use super::super::targets::displacement_map;
use crate::edited::{CarriedAttributes, EditedModel, PrimitiveRun, VertexBlend};
use crate::vertex_attributes::AttributeKeys;
use crate::{Error, Model, MorphTargetRule};
use glam::{DAffine3, DMat3, DVec3};
use pliant_mesh::local_turns::{LocalTurn, local_turns};
use std::cell::OnceCell;
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

/// Reads an attribute, whatever it is stored as.
pub(super) fn read(doc: &GltfDocument<'_>, index: usize) -> Result<AttributeValues, Error> {
    let place = || format!("accessors/{index}");
    let Some(accessor) = doc.accessors.get(index) else {
        return Err(doc.fault.malformed(place(), "does not exist"));
    };
    let Some(layout) = doc.layout(index) else {
        let problem = format!(
            "component type {} with type {:?} is none that glTF knows",
            accessor.component_type.0, accessor.shape
        );
        return Err(doc.fault.malformed(place(), problem));
    };
    Ok(AttributeValues {
        lanes: layout.lanes,
        is_whole: layout.component != ComponentType::F32 && !accessor.normalized,
        values: doc.read_values(index, layout)?,
    })
}

/// Hands out all attributes of the vertices of a model but their shape, those of morph targets included.
pub(in super::super) fn distinguish_vertices(
    model: &Model,
    notes: &GltfNotes,
    keys: &mut AttributeKeys<'_>,
) -> Result<(), Error> {
    let doc = notes.loaded_document(model)?;
    for row in &notes.rows {
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let shape = |name: &str| ShapeAttribute::ALL.iter().any(|own| own.name() == name);
        let own = primitive.attributes.iter().filter(|(name, _)| !shape(name));
        let targets = primitive.targets.iter().flatten();
        for accessor in own.chain(targets).map(|(_, accessor)| accessor.index()) {
            // What only an extension can read is not written again either.
            let Some(layout) = doc.layout(accessor) else {
                continue;
            };
            keys.spend(row.vertices.len() as u64 * layout.lanes as u64)?;
            let channel = read(&doc, accessor)?;
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

    /// The texture coordinates of a run that is a cap with a material of its own.
    pub(super) fn cap_uv(&self) -> Option<&'a [[f32; 2]]> {
        self.edited.cap_material(self.run).map(|_| self.edited.cap_uv(self.run))
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

/// The numbers of accessors by attribute: those of the file that the primitive came from, and new ones behind them.
pub(super) type AccessorNumbers = BTreeMap<String, usize>;

/// The influences of a run's vertices as they are written: sets of four joints and four weights for each vertex.
pub(super) struct BlendedSkin {
    joints: Vec<Vec<f32>>,
    weights: Vec<Vec<f32>>,
}

impl BlendedSkin {
    /// Blends what a primitive has; `None` for one without joints.
    pub(super) fn read(
        doc: &GltfDocument<'_>,
        primitive: &MeshPrimitive,
        mixer: &AttributeBlender<'_>,
        placement: &Placement,
    ) -> Result<Option<Self>, Error> {
        let sets = influence_accessors(primitive);
        if sets.is_empty() {
            return Ok(None);
        }
        let (mut of_joints, mut of_weights) = (Vec::new(), Vec::new());
        for (joints, weights) in sets {
            of_joints.push(read_fours(doc, joints)?);
            of_weights.push(read_fours(doc, weights)?);
        }
        let (joints, weights) = mixer.blend_skin(&of_joints, &of_weights);
        let mut skin = Self { joints, weights };
        if let Placement::Blended(pose) = placement {
            // Joints that hold two vertices well may cancel each other half-way; the heavier vertex then lends its own.
            let transforms = skin.transforms(&pose.world_from_bind, doc.fault)?;
            let bad: Vec<bool> = (0..mixer.len()).map(|v| !is_writable(transforms.at(v))).collect();
            if bad.contains(&true) {
                let heaviest = |from: &[AttributeValues]| -> Vec<Vec<f32>> {
                    from.iter().map(|set| mixer.take_heaviest(set)).collect()
                };
                replace_where(&bad, &mut skin.joints, &heaviest(&of_joints));
                replace_where(&bad, &mut skin.weights, &heaviest(&of_weights));
            }
        }
        Ok(Some(skin))
    }

    /// Which of so many joints hold the vertices.
    pub(super) fn influences(&self, joints: usize, fault: GltfFault) -> Result<VertexInfluences, Error> {
        let influences = VertexInfluences::from_sets(&self.joints, &self.weights, joints);
        influences.map_err(|problem| fault.unwritable(problem))
    }

    /// Where joints at these transforms put the vertices.
    pub(super) fn transforms(&self, of_joint: &[DAffine3], fault: GltfFault) -> Result<VertexTransforms, Error> {
        let influences = self.influences(of_joint.len(), fault)?;
        Ok(VertexTransforms::of_influences(&influences, of_joint))
    }

    /// Scales the weights of each vertex to the sum 1, as they are drawn.
    pub(super) fn normalise(&mut self) {
        for first in (0..self.weights.first().map_or(0, Vec::len)).step_by(4) {
            let own = |set: &Vec<f32>| set[first..first + 4].iter().map(|w| f64::from(*w)).sum::<f64>();
            let sum: f64 = self.weights.iter().map(own).sum();
            if sum > 0.0 {
                let weights = self.weights.iter_mut().flat_map(|set| &mut set[first..first + 4]);
                weights.for_each(|weight| *weight = (f64::from(*weight) / sum) as f32);
            }
        }
    }

    /// Writes all sets.
    pub(super) fn write(&self, fresh: &mut BufferBuilder, attributes: &mut AccessorNumbers) {
        for (n, (joints, weights)) in self.joints.iter().zip(&self.weights).enumerate() {
            let joints = fresh.add_joints(joints);
            let weights = fresh.add_floats(weights, "VEC4", AccessorKind::Floats);
            attributes.insert(format!("JOINTS_{n}"), joints);
            attributes.insert(format!("WEIGHTS_{n}"), weights);
        }
    }
}

fn replace_where(bad: &[bool], sets: &mut [Vec<f32>], with: &[Vec<f32>]) {
    for (set, with) in sets.iter_mut().zip(with) {
        let vertices = set.as_chunks_mut::<4>().0.iter_mut().zip(with.as_chunks::<4>().0);
        for ((own, other), _) in vertices.zip(bad).filter(|(_, bad)| **bad) {
            *own = *other;
        }
    }
}

fn read_fours(doc: &GltfDocument<'_>, accessor: usize) -> Result<AttributeValues, Error> {
    let channel = read(doc, accessor)?;
    if channel.lanes != 4 {
        let problem = format!("{} numbers per element, 4 are needed", channel.lanes);
        return Err(doc.fault.malformed(format!("accessors/{accessor}/type"), problem));
    }
    Ok(channel)
}

/// How the surface of an edited model has turned since its bases were read; found when it is first needed.
pub(super) struct EditedTurns<'a> {
    edited: &'a EditedModel<'a>,
    positions: &'a [DVec3],
    rule: MorphTargetRule,
    found: OnceCell<Vec<Option<LocalTurn>>>,
}

impl<'a> EditedTurns<'a> {
    pub(super) fn new(edited: &'a EditedModel<'a>, positions: &'a [DVec3], rule: MorphTargetRule) -> Self {
        Self {
            edited,
            positions,
            rule,
            found: OnceCell::new(),
        }
    }

    /// Of the vertices of a run; none has turned where targets are to stay.
    fn of_run(&self, run: &PrimitiveRun) -> Vec<Option<LocalTurn>> {
        if self.rule == MorphTargetRule::Keep {
            return vec![None; run.vertex_count as usize];
        }
        let all = self.found.get_or_init(|| {
            let runs = self.edited.runs.iter();
            let before: Vec<DVec3> = runs
                .flat_map(|run| CarriedAttributes::before(self.edited, run))
                .collect();
            local_turns(&before, self.positions, self.edited.triangles)
        });
        all[run.vertices()].to_vec()
    }
}

/// The targets of one run on their way to a file.
pub(super) struct TargetBlender<'a> {
    pub(super) mixer: &'a AttributeBlender<'a>,
    turns: Vec<Option<LocalTurn>>,
    /// The linear part of where the base was put.
    placing: DMat3,
    /// How displacements of old vertices get into the space of their base, when their joints place them one by one.
    world_from_old: VertexTransforms,
    /// Whether each vertex has a space of its own, old or new.
    is_skinned: bool,
    /// Whether the space of displacements is another one than the stored one, even where nothing turned.
    pub(super) is_respaced: bool,
    new_from_world: VertexTransforms,
}

impl<'a> TargetBlender<'a> {
    pub(super) fn new(
        turns: &EditedTurns<'_>,
        run: &PrimitiveRun,
        mixer: &'a AttributeBlender<'a>,
        placement: &Placement,
        world_from_old: VertexTransforms,
        world_from_new: &VertexTransforms,
    ) -> Self {
        let new_from_world = world_from_new.inverse();
        Self {
            mixer,
            turns: turns.of_run(run),
            placing: turns.edited.base(run).world_from_model.matrix3,
            world_from_old,
            is_skinned: matches!(placement, Placement::Blended(_)),
            is_respaced: false,
            new_from_world: new_from_world.unwrap_or(VertexTransforms::Whole(DAffine3::IDENTITY)),
        }
    }

    /// Whether the surface has turned or grown anywhere where a target displaces it.
    pub(super) fn has_turned(&self, values: &[f32]) -> bool {
        let mut vertices = values.as_chunks::<3>().0.iter().zip(&self.turns);
        vertices.any(|(value, turn)| turn.is_some() && *value != [0.0; 3])
    }

    pub(super) fn carried(&self, role: Option<ShapeAttribute>, channel: &AttributeValues) -> Vec<f32> {
        let mut values = self.mixer.blend_linearly(channel);
        let Some(role) = role else { return values };
        for (i, place) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let turn = self.turns[i];
            let blend = self.mixer.old_vertices(i);
            // Stored numbers of vertices that each have their own space cannot be blended as they are.
            let is_mixed = self.is_respaced || self.is_skinned && (blend.len() > 1 || self.placing != DMat3::IDENTITY);
            if (turn.is_none() && !is_mixed) || *place == [0.0; 3] && blend.len() == 1 {
                continue;
            }
            let turn = turn.unwrap_or(LocalTurn {
                turn: DMat3::IDENTITY,
                growth: 1.0,
            });
            let new_from_world = &self.new_from_world.at(i).matrix3;
            let mut sum = DVec3::ZERO;
            for (old, weight) in blend {
                let world_from_old = self.placing * self.world_from_old.at(old).matrix3;
                let stored = channel.values[3 * old..3 * old + 3].iter().map(|&v| f64::from(v));
                let stored = DVec3::from_array(std::array::from_fn(|lane| stored.clone().nth(lane).unwrap_or(0.0)));
                sum += displacement_map(role, &turn, &world_from_old, new_from_world) * stored * weight;
            }
            if sum.as_vec3().is_finite() {
                *place = sum.as_vec3().to_array();
            }
        }
        values
    }
}
