//! The text of a clip.

use super::super::builder::AccessorKind;
use super::super::text::{json_array, quoted};
use super::document::PlayedDocument;
use crate::asset::played_clip::{NodeKeys, NodePlace};
use glam::DQuat;

/// A clip that is being written.
pub(super) struct NewClip {
    name: String,
    channels: Vec<String>,
    samplers: Vec<String>,
}

impl NewClip {
    /// A clip without channels.
    pub(super) fn new(name: &str) -> Self {
        Self {
            name: quoted(name),
            channels: Vec::new(),
            samplers: Vec::new(),
        }
    }

    /// Adds values over times, which are accessors, along straight lines; the number of the sampler.
    pub(super) fn add_sampler(&mut self, times: usize, values: usize) -> usize {
        self.add_sampler_text(format!(
            r#"{{"input":{times},"interpolation":"LINEAR","output":{values}}}"#
        ))
    }

    /// Adds a sampler; its number.
    pub(super) fn add_sampler_text(&mut self, text: String) -> usize {
        self.samplers.push(text);
        self.samplers.len() - 1
    }

    /// Adds a channel.
    pub(super) fn add_channel_text(&mut self, text: String) {
        self.channels.push(text);
    }

    /// Lets a sampler move a node.
    pub(super) fn add_channel(&mut self, sampler: usize, node: usize, path: &str) {
        self.channels.push(format!(
            r#"{{"sampler":{sampler},"target":{{"node":{node},"path":"{path}"}}}}"#
        ));
    }

    /// Lets a node go from place to place.
    pub(super) fn add_places(
        &mut self,
        played: &mut PlayedDocument<'_, '_>,
        node: usize,
        times: usize,
        places: impl Iterator<Item = NodePlace>,
    ) {
        let (mut shifts, mut turns): (Vec<f32>, Vec<f32>) = (Vec::new(), Vec::new());
        let mut before = DQuat::IDENTITY;
        for place in places {
            shifts.extend(place.translation.as_vec3().to_array());
            // Both signs are one turn, but blending takes the short way between equal signs only.
            let turn = if before.dot(place.rotation) < 0.0 {
                -place.rotation
            } else {
                place.rotation
            };
            before = turn;
            turns.extend(turn.to_array().map(|v| v as f32));
        }
        for (values, shape, path) in [(shifts, "VEC3", "translation"), (turns, "VEC4", "rotation")] {
            let values = played.add_floats(&values, shape, AccessorKind::Numbers);
            let sampler = self.add_sampler(times, values);
            self.add_channel(sampler, node, path);
        }
    }

    /// Lets a node follow keys.
    pub(super) fn add_keys(&mut self, played: &mut PlayedDocument<'_, '_>, node: usize, keys: &NodeKeys<'_>) {
        let times = add_times(played, keys.times);
        self.add_places(played, node, times, keys.places.iter().copied());
    }

    /// Its text.
    pub(super) fn text(&self) -> String {
        let Self {
            name,
            channels,
            samplers,
        } = self;
        format!(
            r#"{{"name":{name},"channels":[{}],"samplers":[{}]}}"#,
            channels.join(","),
            samplers.join(",")
        )
    }
}

/// Stores times; the number of their accessor.
pub(super) fn add_times(played: &mut PlayedDocument<'_, '_>, times: &[f64]) -> usize {
    let times: Vec<f32> = times.iter().map(|t| *t as f32).collect();
    played.add_floats(&times, "SCALAR", AccessorKind::Times)
}

/// Adds a node above others that follows keys; its number.
pub(super) fn add_root(
    played: &mut PlayedDocument<'_, '_>,
    clip: &mut NewClip,
    keys: &NodeKeys<'_>,
    below: &[usize],
) -> usize {
    let below = json_array(below);
    let root = played.add_node(format!(r#"{{"name":"root motion","children":{below}}}"#));
    clip.add_keys(played, root, keys);
    root
}
