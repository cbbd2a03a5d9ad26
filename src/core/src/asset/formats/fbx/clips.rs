//! Animation stacks as clips: curves of any kind, layers and rotation orders sampled to keys that are joined by lines.

use super::super::gltf::GlbWriter;
use super::fault::place_of;
use super::nodes::{MorphedNode, SceneNodes};
use super::notes::TranslationNotes;
use super::scene::within_reserve;
use crate::asset::Error;
use crate::asset::files::ReadWatch;
use serde_json::{Value, json};
use ufbx::{BakedAnim, BakedNode, BakedProp, BakedVec3, Scene};

/// The longest clip that is sampled, in seconds: a day.
const LONGEST: f64 = 86_400.0;

/// The animations of the asset.
pub(super) struct AddedClips {
    pub animations: Vec<Value>,
}

impl AddedClips {
    /// Samples every animation stack that moves something. Failed ones are left out with a warning.
    pub(super) fn build(
        scene: &Scene,
        nodes: &SceneNodes,
        buffer: &mut GlbWriter<'_>,
        notes: &mut TranslationNotes,
        watch: &ReadWatch<'_>,
    ) -> Result<Self, Error> {
        let mut animations = Vec::new();
        for stack in &scene.anim_stacks {
            let place = place_of("animation", &stack.element);
            let length = stack.time_end - stack.time_begin;
            if !(length.is_finite() && length <= LONGEST) {
                let message = format!("lasts {length} s, at most {LONGEST} s are sampled: it is left out");
                notes.warn("fbx-clip", message, place);
                continue;
            }
            let (baked, reserved) = within_reserve(watch, 0, |allocator| {
                let options = ufbx::BakeOpts {
                    temp_allocator: allocator(),
                    result_allocator: allocator(),
                    trim_start_time: true,
                    key_reduction_enabled: true,
                    key_reduction_rotation: true,
                    ..Default::default()
                };
                ufbx::bake_anim(scene, &stack.anim, options).map_err(Box::new)
            })?;
            let baked = match baked {
                Ok(baked) => baked,
                Err(error) => {
                    let message = format!("cannot be sampled ({}): it is left out", &*error.description).to_lowercase();
                    notes.warn("fbx-clip", message, place);
                    watch.release(reserved);
                    continue;
                }
            };
            let mut clip = ClipBuilder {
                buffer,
                place: &place,
                samplers: Vec::new(),
                channels: Vec::new(),
            };
            for node in &baked.nodes {
                if let Some(number) = nodes.number_of.get(node.typed_id as usize).copied().flatten() {
                    clip.add_node(node, number)?;
                }
            }
            for morphed in &nodes.morphed {
                clip.add_weights(&baked, morphed)?;
            }
            if !clip.channels.is_empty() {
                let mut json = json!({"samplers": clip.samplers, "channels": clip.channels});
                if !stack.element.name.is_empty() {
                    json["name"] = json!(&*stack.element.name);
                }
                animations.push(json);
            }
            watch.release(reserved);
        }
        Ok(Self { animations })
    }
}

/// One clip in the making.
struct ClipBuilder<'a, 'w> {
    buffer: &'a mut GlbWriter<'w>,
    place: &'a str,
    samplers: Vec<Value>,
    channels: Vec<Value>,
}

impl ClipBuilder<'_, '_> {
    fn add_node(&mut self, baked: &BakedNode, node: u32) -> Result<(), Error> {
        let vectors = |keys: &[BakedVec3]| -> Vec<(f64, [f32; 3])> {
            let value = |key: &BakedVec3| [key.value.x, key.value.y, key.value.z].map(|x| x as f32);
            keys.iter().map(|key| (key.time, value(key))).collect()
        };
        self.add_channel(node, "translation", &vectors(&baked.translation_keys))?;
        let mut last = [0.0f32; 4];
        let rotations: Vec<(f64, [f32; 4])> = baked
            .rotation_keys
            .iter()
            .map(|key| {
                let q = [key.value.x, key.value.y, key.value.z, key.value.w].map(|x| x as f32);
                // Neighbours on one side of the sphere, so that the way between them is the short one.
                let dot: f32 = q.iter().zip(last).map(|(a, b)| a * b).sum();
                last = if dot < 0.0 { q.map(|x| -x) } else { q };
                (key.time, last)
            })
            .collect();
        self.add_channel(node, "rotation", &rotations)?;
        self.add_channel(node, "scale", &vectors(&baked.scale_keys))
    }

    /// Adds a channel; none without keys.
    fn add_channel<const N: usize>(&mut self, node: u32, path: &str, keys: &[(f64, [f32; N])]) -> Result<(), Error> {
        let (times, values) = ascending(keys);
        if times.is_empty() {
            return Ok(());
        }
        let output = self.buffer.add_floats(&values, self.place)?;
        self.push_channel(node, path, &times, output)
    }

    fn push_channel(&mut self, node: u32, path: &str, times: &[[f32; 1]], output: usize) -> Result<(), Error> {
        let input = self.buffer.add_bounded(times, self.place)?;
        self.samplers
            .push(json!({"input": input, "interpolation": "LINEAR", "output": output}));
        let sampler = self.samplers.len() - 1;
        self.channels
            .push(json!({"sampler": sampler, "target": {"node": node, "path": path}}));
        Ok(())
    }

    /// Adds the weights of a node's morph targets: all of them at every time at which one has a key.
    fn add_weights(&mut self, baked: &BakedAnim, morphed: &MorphedNode) -> Result<(), Error> {
        let tracks: Vec<Option<&BakedProp>> = morphed.channels.iter().map(|id| weight_track(baked, *id)).collect();
        let mut times: Vec<f64> = tracks
            .iter()
            .flatten()
            .flat_map(|track| track.keys.iter().map(|key| key.time))
            .collect();
        times.sort_by(f64::total_cmp);
        let keys: Vec<(f64, [f32; 0])> = times.iter().map(|&time| (time, [])).collect();
        let (times, _) = ascending(&keys);
        if times.is_empty() {
            return Ok(());
        }
        let mut values: Vec<[f32; 1]> = Vec::with_capacity(times.len() * tracks.len());
        let mut cursors = vec![0; tracks.len()];
        for [time] in &times {
            for ((track, cursor), rest) in tracks.iter().zip(&mut cursors).zip(&morphed.weights) {
                let percent = track.and_then(|track| value_at(&track.keys, cursor, f64::from(*time)));
                values.push([percent.map_or(*rest, |percent| (percent / 100.0) as f32)]);
            }
        }
        let output = self.buffer.add_floats(&values, self.place)?;
        self.push_channel(morphed.node, "weights", &times, output)
    }
}

/// The keys of the weight of a channel, in percent.
fn weight_track(baked: &BakedAnim, channel: u32) -> Option<&BakedProp> {
    let element = baked.elements.iter().find(|element| element.element_id == channel)?;
    let track = element.props.iter().find(|prop| &*prop.name == "DeformPercent");
    track.filter(|track| !track.keys.is_empty())
}

/// The value of a track on the line between two keys; `cursor` is the last key that was before the time asked for last.
fn value_at(keys: &[BakedVec3], cursor: &mut usize, time: f64) -> Option<f64> {
    while keys.get(*cursor + 1).is_some_and(|next| next.time <= time) {
        *cursor += 1;
    }
    let here = keys.get(*cursor)?;
    let Some(next) = keys
        .get(*cursor + 1)
        .filter(|next| next.time > here.time && time > here.time)
    else {
        return Some(here.value.x);
    };
    let part = (time - here.time) / (next.time - here.time);
    Some(here.value.x + part * (next.value.x - here.value.x))
}

/// Times and values with times from 0 on that rise in 32 bits, as glTF demands.
fn ascending<const N: usize>(keys: &[(f64, [f32; N])]) -> (Vec<[f32; 1]>, Vec<[f32; N]>) {
    let mut last = f32::NEG_INFINITY;
    let rising = keys.iter().filter_map(|(time, value)| {
        let time = time.max(0.0) as f32;
        let rises = time > last;
        last = last.max(time);
        rises.then_some(([time], *value))
    });
    rising.unzip()
}
