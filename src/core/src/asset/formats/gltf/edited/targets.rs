//! Morph targets of edited primitives: blended from those of the old vertices, and carried along with the surface.

use super::super::accessors::ShapeAttribute;
use super::super::buffers::BufferBytes;
use super::super::builder::{AccessorKind, BufferBuilder};
use super::super::document::GltfDocument;
use super::super::placement::{Placement, VertexTransforms};
use super::super::schema::Attributes;
use super::super::targets::{TargetTally, displacement_map};
use super::channels::{AttributeBlender, AttributeValues, read, shape_of};
use super::handles::AccessorHandle;
use crate::asset::edited::{CarriedAttributes, EditedModel, PrimitiveRun};
use crate::asset::{Error, MorphTargetRule};
use crate::mesh::local_turns::{LocalTurn, local_turns};
use glam::{DAffine3, DMat3, DVec3};
use std::cell::OnceCell;
use std::collections::BTreeMap;

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
    mixer: &'a AttributeBlender<'a>,
    turns: Vec<Option<LocalTurn>>,
    /// The linear part of where the base was put.
    placing: DMat3,
    /// How displacements of old vertices get into the space of their base, when their joints place them one by one.
    world_from_old: VertexTransforms,
    /// Whether each vertex has a space of its own, old or new.
    is_skinned: bool,
    new_from_world: VertexTransforms,
}

impl<'a> TargetBlender<'a> {
    pub(super) fn new(
        turns: &EditedTurns<'_>,
        run: &PrimitiveRun,
        mixer: &'a AttributeBlender<'a>,
        (placement, world_from_old): (&Placement, VertexTransforms),
        world_from_new: &VertexTransforms,
    ) -> Self {
        let new_from_world = world_from_new.inverse();
        Self {
            mixer,
            turns: turns.of_run(run),
            placing: turns.edited.base(run).world_from_model.matrix3,
            world_from_old,
            is_skinned: matches!(placement, Placement::Blended(_)),
            new_from_world: new_from_world.unwrap_or(VertexTransforms::Whole(DAffine3::IDENTITY)),
        }
    }

    /// One target, and whether displacements turned or grew with the surface. Those attributes that stay as they are stored
    /// have their old accessors, when these `may_stay`.
    pub(super) fn blend_target(
        &self,
        target: &Attributes,
        (doc, buffers): (&GltfDocument<'_>, &BufferBytes),
        fresh: &mut BufferBuilder,
        may_stay: bool,
        tally: &mut TargetTally,
    ) -> Result<(BTreeMap<String, AccessorHandle>, bool), Error> {
        let mut made = BTreeMap::new();
        let mut is_carried = false;
        for (name, accessor) in target {
            let channel = read(doc, buffers, accessor.index())?;
            let role = ShapeAttribute::ALL.into_iter().find(|role| role.name() == name);
            let role = role.filter(|_| channel.lanes == 3);
            tally.spend(self.mixer.len())?;
            let values = self.carried(role, &channel);
            is_carried |= role.is_some() && self.has_turned(&values);
            let is_stored = || {
                values
                    .iter()
                    .map(|v| v.to_bits())
                    .eq(channel.values.iter().map(|v| v.to_bits()))
            };
            let at = if may_stay && is_stored() {
                AccessorHandle::Old(accessor.index())
            } else {
                let kind = match role {
                    Some(ShapeAttribute::Position) => AccessorKind::Positions,
                    _ => AccessorKind::Floats,
                };
                let shape = shape_of(&doc.accessors.values[accessor.index()].shape);
                AccessorHandle::New(fresh.add_floats(&values, channel.lanes, shape, kind))
            };
            made.insert(name.clone(), at);
        }
        Ok((made, is_carried))
    }

    /// Whether the surface has turned or grown anywhere where a target displaces it.
    fn has_turned(&self, values: &[f32]) -> bool {
        let mut vertices = values.as_chunks::<3>().0.iter().zip(&self.turns);
        vertices.any(|(value, turn)| turn.is_some() && *value != [0.0; 3])
    }

    fn carried(&self, role: Option<ShapeAttribute>, channel: &AttributeValues) -> Vec<f32> {
        let mut values = self.mixer.blend_linearly(channel);
        let Some(role) = role else { return values };
        for (i, place) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let turn = self.turns[i];
            let blend = self.mixer.old_vertices(i);
            // Stored numbers of vertices that each have their own space cannot be blended as they are.
            let is_mixed = self.is_skinned && (blend.len() > 1 || self.placing != DMat3::IDENTITY);
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
