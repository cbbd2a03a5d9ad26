//! How a session's model was opened: the options as a message that reads as the same options, and the files by name.

use super::commit::FileReferences;
use super::messages::ModelMessage;
use crate::asset::{BoneLengthRule, Following, Format, MorphTargetRule, RigRule};
use crate::deform::{CoarseOperators, EdgeWeights, FreePartPolicy, VolumeMode};
use crate::engine::{OpenOptions, Passenger, PassengerKind};
use crate::graph::InteriorKind;
use crate::mesh::Weld;
use crate::wire::{Error, open_options, pb};
use pb::create_options as message;
use prost::Message as _;

/// What a session begins with.
#[derive(Debug, Clone)]
pub struct RecordedModel {
    /// Its files, by the names of their objects.
    pub files: FileReferences,
    /// How it was opened.
    pub options: OpenOptions,
    /// The session's label.
    pub label: String,
    /// The format of its files.
    pub format: Format,
    /// Bytes that its volume graph was fitted into; `None` in records of the time before that was noted.
    pub graph_bytes: Option<u64>,
}

impl RecordedModel {
    /// Writes the record.
    ///
    /// # Errors
    /// [`Error::Unimplemented`] for a passenger that is a model of its own: it has no place in a record.
    pub fn write(&self) -> Result<Vec<u8>, Error> {
        let message = ModelMessage {
            files: Some(self.files.to_message()),
            options: Some(create_message(&self.options)?),
            label: self.label.clone(),
            format: self.format.name().into(),
            graph_bytes: self.graph_bytes,
            of_today: self.options.body.graph.weights != EdgeWeights::CotangentOfMean,
        };
        Ok(message.encode_to_vec())
    }

    /// Reads a record.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(bytes: &[u8]) -> Result<Self, Error> {
        let message = ModelMessage::decode(bytes).map_err(|e| Error::invalid("model", e.to_string()))?;
        let files = message
            .files
            .ok_or_else(|| Error::invalid("model.files", "is missing"))?;
        let create = message.options.unwrap_or_default();
        let mut options = open_options(&create)?;
        if !message.of_today {
            let graph = &mut options.body.graph;
            graph.kind = InteriorKind::Paper;
            graph.weights = match create.weights() {
                message::Weights::Uniform => EdgeWeights::Uniform,
                message::Weights::Cotangent => EdgeWeights::CotangentOfMean,
            };
        }
        Ok(Self {
            files: FileReferences::from_message(files),
            options,
            label: message.label,
            format: Format::from_name(&message.format)
                .ok_or_else(|| Error::invalid("model.format", "is not a format"))?,
            graph_bytes: message.graph_bytes,
        })
    }
}

/// Writes how a model is opened; reading it again gives the same options.
fn create_message(options: &OpenOptions) -> Result<pb::CreateOptions, Error> {
    let body = &options.body;
    let (rig, bone_lengths, rigid_chains) = following_rules(&options.following);
    let kept = &options.kept_apart;
    Ok(pb::CreateOptions {
        format: options.format.map_or_else(String::new, |f| f.name().into()),
        volume_graph: Some(message::VolumeGraph {
            mode: match body.volume {
                VolumeMode::Auto => message::volume_graph::Mode::Auto,
                VolumeMode::Off => message::volume_graph::Mode::Off,
                VolumeMode::Required => message::volume_graph::Mode::Required,
            }
            .into(),
            interval: body.graph.interval.unwrap_or(0.0),
            valence: body.graph.valence,
            shell_offset: body.graph.shell_offset.unwrap_or(0.0),
            kind: match body.graph.kind {
                InteriorKind::Shape => message::volume_graph::Kind::Shape,
                InteriorKind::Paper => message::volume_graph::Kind::Paper,
            }
            .into(),
        }),
        components: match options.policy {
            FreePartPolicy::Follow => message::Components::Follow,
            FreePartPolicy::Hold => message::Components::Hold,
            FreePartPolicy::Free => message::Components::Free,
        }
        .into(),
        weights: Some(
            match body.graph.weights {
                EdgeWeights::Uniform => message::Weights::Uniform,
                EdgeWeights::Cotangent | EdgeWeights::CotangentOfMean => message::Weights::Cotangent,
            }
            .into(),
        ),
        weld: match options.weld {
            Weld::Rounding => None,
            Weld::Exact => Some(message::Weld { tolerance: 0.0 }),
            Weld::Tolerance(tolerance) => Some(message::Weld { tolerance }),
        },
        operators: match body.operators {
            CoarseOperators::FiniteVolume => message::Operators::FiniteVolume,
            CoarseOperators::Paper => message::Operators::Paper,
        }
        .into(),
        morph_targets: match options.following.morph_targets {
            MorphTargetRule::Follow => message::morph_targets::Rule::Follow,
            MorphTargetRule::Keep => message::morph_targets::Rule::Keep,
        }
        .into(),
        rig: rig.into(),
        bone_lengths: bone_lengths.into(),
        rigid_chains,
        parts: match body.ties {
            Some(_) => message::Parts::Tied,
            None => message::Parts::Separate,
        }
        .into(),
        tie_distance: body.ties.as_ref().and_then(|t| t.distance).unwrap_or(0.0),
        keep_apart: (body.ties.is_some() && !(kept.primitives.is_empty() && kept.components.is_empty())).then(|| {
            message::KeepApart {
                primitives: kept.primitives.clone(),
                components: kept.components.clone(),
            }
        }),
        passengers: (options.passengers.iter().enumerate())
            .map(|(k, p)| passenger_message(p, k))
            .collect::<Result<_, _>>()?,
        ..Default::default()
    })
}

fn following_rules(following: &Following) -> (message::rig::Rule, message::bone_lengths::Rule, Vec<String>) {
    let rig = match following.rig {
        RigRule::Follow => message::rig::Rule::Follow,
        RigRule::Keep => message::rig::Rule::Keep,
    };
    let (lengths, chains) = match &following.bone_lengths {
        BoneLengthRule::Follow => (message::bone_lengths::Rule::Follow, Vec::new()),
        BoneLengthRule::Keep => (message::bone_lengths::Rule::Keep, Vec::new()),
        BoneLengthRule::KeepBelow(names) => (message::bone_lengths::Rule::Follow, names.clone()),
    };
    (rig, lengths, chains)
}

fn passenger_message(passenger: &Passenger, k: usize) -> Result<pb::Passenger, Error> {
    use pb::passenger::Passenger as Kind;
    let kind = match &passenger.kind {
        PassengerKind::Primitive(index) => Kind::Primitive(*index),
        PassengerKind::PrimitivesNamed(name) => Kind::PrimitivesNamed(name.clone()),
        PassengerKind::Node(index) => Kind::Node(*index),
        PassengerKind::NodesNamed(name) => Kind::NodesNamed(name.clone()),
        PassengerKind::Points { .. } | PassengerKind::Model(_) => {
            return Err(Error::Unimplemented(format!(
                "keeping passengers[{k}], which is not a part of the model"
            )));
        }
    };
    Ok(pb::Passenger {
        name: passenger.name.clone(),
        passenger: Some(kind),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reads_again(options: &OpenOptions) {
        let record = RecordedModel {
            files: FileReferences {
                name: "a.obj".into(),
                main: "00".into(),
                companions: [("b.mtl".to_owned(), "01".to_owned())].into(),
            },
            options: options.clone(),
            label: "a label".into(),
            format: Format::OBJ,
            graph_bytes: Some(1 << 40),
        };
        let again = RecordedModel::read(&record.write().expect("no model rides along")).expect("it was written");
        assert_eq!(format!("{again:?}"), format!("{record:?}"));
    }

    #[test]
    fn options_come_back_as_they_were_written() {
        reads_again(&OpenOptions::default());
        for text in [
            r#"{"format": "glb", "weld": {"tolerance": 0.25}, "components": "HOLD", "parts": "SEPARATE"}"#,
            r#"{"components": "FREE", "weights": "COTANGENT", "operators": "PAPER", "tieDistance": 0.1}"#,
            r#"{"volumeGraph": {"mode": "REQUIRED", "interval": 0.1, "valence": 8, "shellOffset": 0.3, "kind": "PAPER"}}"#,
            r#"{"volumeGraph": {"mode": "OFF"}, "keepApart": {"primitives": [1], "components": [2, 3]}}"#,
            r#"{"morphTargets": "KEEP", "rig": "KEEP"}"#,
            r#"{"boneLengths": "KEEP"}"#,
            r#"{"rigidChains": ["arm", "leg"]}"#,
            r#"{"passengers": [{"name": "a", "primitive": 1}, {"primitivesNamed": "b"}, {"node": 2}, {"nodesNamed": "c"}]}"#,
        ] {
            let message = crate::wire::json::from_json(text.as_bytes()).expect(text);
            reads_again(&open_options(&message).expect(text));
        }
    }

    #[test]
    fn bytes_that_are_no_record_are_refused() {
        for bytes in [&b"\xff\xff"[..], b"", &[10, 0], &[10, 2, 8, 1]] {
            assert!(RecordedModel::read(bytes).is_err(), "{bytes:?}");
        }
    }
}
