//! How a session's model was opened: the options as a message that reads as the same options, and the files by name.

use super::messages::{FileReferences, ModelMessage};
use crate::pb::create_options::Weights;
use crate::{Error, open_options, pb};
use pliant_asset::Format;
use pliant_core::engine::OpenOptions;
use pliant_deform::EdgeWeights;
use pliant_mesh::graph::InteriorKind;
use prost::Message as _;

/// What a session begins with.
#[derive(Debug, Clone)]
pub struct RecordedModel {
    /// Its files, by the names of their objects.
    pub files: FileReferences,
    /// How it was opened, as it was asked for, with defaults made explicit.
    pub options: pb::CreateOptions,
    /// Whether `options` have today's defaults and weights. Records of before have the paper's graph, and weights of their time.
    pub of_today: bool,
    /// Whether vertices in no triangle ride along, as they do today.
    pub loose_vertices_ride: bool,
    /// Whether a model far from the origin has the graph that it has near the origin, as it has today.
    pub near_origin: bool,
    /// Whether every cut ends lines beside the surface, as it does today.
    pub every_cut_ends_lines: bool,
    /// Whether what rides along follows one side of a cut alone, as it does today.
    pub riders_keep_sides: bool,
    /// Whether a graph that follows the shape follows edits, as it does today. Records of before have a new one after each edit.
    pub follows_edits: bool,
    /// Whether fields of many handles are solved each around its handle, as they are today. Records of before have whole ones.
    pub local_fields: bool,
    /// The session's label.
    pub label: String,
    /// The format of its files.
    pub format: Format,
    /// Bytes that its volume graph was fitted into; `None` in records of the time before that was noted.
    pub graph_bytes: Option<u64>,
}

impl RecordedModel {
    /// Writes the record.
    pub fn write(&self) -> Vec<u8> {
        let message = ModelMessage {
            files: Some(self.files.clone()),
            options: Some(self.options.clone()),
            label: self.label.clone(),
            format: self.format.name().into(),
            graph_bytes: self.graph_bytes,
            of_today: self.of_today,
            loose_vertices_ride: self.loose_vertices_ride,
            near_origin: self.near_origin,
            every_cut_ends_lines: self.every_cut_ends_lines,
            riders_keep_sides: self.riders_keep_sides,
            follows_edits: self.follows_edits,
            local_fields: self.local_fields,
        };
        message.encode_to_vec()
    }

    /// Reads a record.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(bytes: &[u8]) -> Result<Self, Error> {
        let message = ModelMessage::decode(bytes).map_err(|e| Error::invalid("model", e.to_string()))?;
        let record = Self {
            files: (message.files).ok_or_else(|| Error::invalid("model.files", "is missing"))?,
            options: message.options.unwrap_or_default(),
            of_today: message.of_today,
            loose_vertices_ride: message.loose_vertices_ride,
            near_origin: message.near_origin,
            every_cut_ends_lines: message.every_cut_ends_lines,
            riders_keep_sides: message.riders_keep_sides,
            follows_edits: message.follows_edits,
            local_fields: message.local_fields,
            label: message.label,
            format: Format::from_name(&message.format)
                .ok_or_else(|| Error::invalid("model.format", "is not a format"))?,
            graph_bytes: message.graph_bytes,
        };
        record.open_options()?;
        Ok(record)
    }

    /// How its model is opened.
    ///
    /// # Errors
    /// What is wrong with the options.
    pub fn open_options(&self) -> Result<OpenOptions, Error> {
        let mut options = open_options(&self.options)?;
        options.loose_vertices_ride = self.loose_vertices_ride;
        options.body.near_origin = self.near_origin;
        options.every_cut_ends_lines = self.every_cut_ends_lines;
        options.riders_keep_sides = self.riders_keep_sides;
        options.body.graph.follows_edits = self.follows_edits;
        options.body.local_fields = self.local_fields;
        if !self.of_today {
            let graph = &mut options.body.graph;
            graph.kind = InteriorKind::Paper;
            graph.weights = match self.options.weights() {
                Weights::Uniform => EdgeWeights::Uniform,
                Weights::Cotangent => EdgeWeights::CotangentOfMean,
            };
        }
        Ok(options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SessionOptions, session_options};
    use std::time::Duration;

    fn reads_again(options: &SessionOptions) {
        let record = RecordedModel {
            files: FileReferences {
                name: "a.obj".into(),
                main: "00".into(),
                companions: [("b.mtl".to_owned(), "01".to_owned())].into(),
            },
            options: options.create.clone(),
            of_today: true,
            loose_vertices_ride: true,
            near_origin: true,
            every_cut_ends_lines: true,
            riders_keep_sides: true,
            follows_edits: true,
            local_fields: true,
            label: "a label".into(),
            format: Format::OBJ,
            graph_bytes: Some(1 << 40),
        };
        let again = RecordedModel::read(&record.write()).expect("it was written");
        assert_eq!(format!("{again:?}"), format!("{record:?}"));
        let opened = again.open_options().expect("it was read");
        assert_eq!(format!("{opened:?}"), format!("{:?}", options.open));
        // Records of before say nothing of it, and have the graph that they had.
        let before = RecordedModel {
            near_origin: false,
            follows_edits: false,
            local_fields: false,
            ..again
        };
        let opened = before.open_options().expect("it was read");
        assert!(!opened.body.near_origin && !opened.body.graph.follows_edits && !opened.body.local_fields);
    }

    #[test]
    fn options_come_back_as_they_were_written() {
        reads_again(&SessionOptions::default());
        for text in [
            r#"{"format": "glb", "weld": {"tolerance": 0.25}, "components": "HOLD", "parts": "SEPARATE"}"#,
            r#"{"components": "FREE", "weights": "COTANGENT", "operators": "PAPER", "tieDistance": 0.1}"#,
            r#"{"volumeGraph": {"mode": "REQUIRED", "interval": 0.1, "valence": 8, "shellOffset": 0.3, "kind": "PAPER"}}"#,
            r#"{"volumeGraph": {"stiffness": 0.1}}"#,
            r#"{"volumeGraph": {"mode": "OFF"}, "keepApart": {"primitives": [1], "components": [2, 3]}}"#,
            r#"{"morphTargets": "KEEP", "rig": "KEEP"}"#,
            r#"{"boneLengths": "KEEP"}"#,
            r#"{"largeSplats": "KEEP", "cageTriangles": 4000}"#,
            r#"{"rigidChains": ["arm", "leg"]}"#,
            r#"{"passengers": [{"name": "a", "primitive": 1}, {"primitivesNamed": "b"}, {"node": 2}, {"nodesNamed": "c"}]}"#,
        ] {
            let message = crate::json::from_json(text.as_bytes()).expect(text);
            reads_again(&session_options(&message, Duration::ZERO..=Duration::MAX).expect(text));
        }
    }

    #[test]
    fn bytes_that_are_no_record_are_refused() {
        for bytes in [&b"\xff\xff"[..], b"", &[10, 0], &[10, 2, 8, 1]] {
            assert!(RecordedModel::read(bytes).is_err(), "{bytes:?}");
        }
    }
}
