//! What of a file's own clip goes on beside what is played: channels of everything that is still there.

use super::super::builder::AccessorKind;
use super::super::document::GltfDocument;
use super::super::edited::JsonSections;
use super::super::text::{index_of, list_of, parse_index, quoted, value_of, with_member};
use super::channels::{NewClip, add_root};
use super::cut_keys::{KeyKind, SamplerKeys};
use super::document::PlayedDocument;
use super::primitives::PlayedNode;
use super::scene::{parents, scene_sections, top_nodes};
use crate::asset::Error;
use crate::asset::played_clip::ClipBeside;
use std::collections::{BTreeMap, BTreeSet};

/// Puts `own`, what is played, into the scene, and lets everything else move as its clip says.
pub(super) fn go_on_beside(
    played: &mut PlayedDocument<'_, '_>,
    new: &mut NewClip,
    (nodes, beside): (&[PlayedNode<'_>], Option<&ClipBeside<'_>>),
    own: &[usize],
    sections: &mut JsonSections,
) -> Result<(), Error> {
    let doc = played.doc;
    let Some(beside) = beside else {
        scene_sections(doc, own, None, sections);
        return Ok(());
    };
    add_channels(played, new, nodes, beside)?;
    let Some(keys) = &beside.around else {
        scene_sections(doc, own, None, sections);
        return Ok(());
    };
    let top = top_nodes(doc);
    let around = add_root(played, new, keys, &top);
    let added: Vec<usize> = own.iter().copied().chain([around]).collect();
    scene_sections(doc, &added, Some((around, &top)), sections);
    Ok(())
}

/// The nodes that still do something: that draw, see or light, or that carry what does.
fn living_nodes(doc: &GltfDocument<'_>, nodes: &[PlayedNode<'_>]) -> BTreeSet<usize> {
    let parents = parents(doc);
    let played: BTreeSet<usize> = nodes.iter().map(|n| n.node).collect();
    let mut living = BTreeSet::new();
    for (node, text) in doc.nodes.items.iter().enumerate() {
        let draws = doc.nodes.values[node].mesh.is_some() && !played.contains(&node);
        if !draws && value_of(text, "camera").is_none() && value_of(text, "extensions").is_none() {
            continue;
        }
        let mut next = Some(node);
        while let Some(node) = next.filter(|node| living.insert(*node)) {
            next = parents[node];
        }
    }
    living
}

/// Adds the channels of a clip that move what still does something, cut to the time of what is played.
fn add_channels(
    played: &mut PlayedDocument<'_, '_>,
    new: &mut NewClip,
    nodes: &[PlayedNode<'_>],
    beside: &ClipBeside<'_>,
) -> Result<(), Error> {
    let doc = played.doc;
    let Some(clip) = doc.animations.get(beside.clip).copied() else {
        return Ok(());
    };
    let living = living_nodes(doc, nodes);
    let list = |key: &str| list_of(clip, key);
    let samplers = list("samplers");
    let played_nodes: BTreeSet<usize> = nodes.iter().map(|n| n.node).collect();
    // Channels may share samplers, and still do; a turn is cut otherwise than numbers.
    let mut added: BTreeMap<(usize, bool), usize> = BTreeMap::new();
    for channel in list("channels") {
        let Some(target) = value_of(channel, "target") else {
            continue;
        };
        let path = value_of(target, "path").unwrap_or_default();
        let Some(node) = index_of(target, "node") else {
            continue;
        };
        let moves = living.contains(&node) && !(path == "\"weights\"" && played_nodes.contains(&node));
        let Some(sampler) = index_of(channel, "sampler").filter(|_| moves) else {
            continue;
        };
        let is_turn = path == "\"rotation\"";
        let number = match added.get(&(sampler, is_turn)) {
            Some(number) => *number,
            None => {
                let Some(text) = samplers.get(sampler) else { continue };
                let Some(text) = cut_sampler(played, text, is_turn, beside.seconds)? else {
                    continue;
                };
                let number = new.add_sampler_text(text);
                added.insert((sampler, is_turn), number);
                number
            }
        };
        new.add_channel_text(with_member(channel, "sampler", number));
    }
    Ok(())
}

/// The text of a sampler for a part of its time; `None` for one that says nothing.
fn cut_sampler(
    played: &mut PlayedDocument<'_, '_>,
    sampler: &str,
    is_turn: bool,
    seconds: [f64; 2],
) -> Result<Option<String>, Error> {
    let accessor = |key: &str| value_of(sampler, key).and_then(parse_index);
    let Some((input, output)) = accessor("input").zip(accessor("output")) else {
        return Ok(None);
    };
    let (Some((times, 1)), Some((values, lanes))) = (played.read_numbers(input)?, played.read_numbers(output)?) else {
        return Ok(None);
    };
    let kind = match value_of(sampler, "interpolation") {
        Some("\"STEP\"") => KeyKind::Step,
        Some("\"CUBICSPLINE\"") => KeyKind::Spline,
        _ if is_turn => KeyKind::Turn,
        _ => KeyKind::Straight,
    };
    let Some(keys) = SamplerKeys::of(times, values, kind) else {
        return Ok(None);
    };
    if keys.lie_within(seconds) {
        return Ok(Some(sampler.to_owned()));
    }
    let cut = keys.cut(seconds);
    let shape = match lanes {
        1 => "SCALAR",
        3 => "VEC3",
        _ => "VEC4",
    };
    let input = played.add_floats(&cut.times, "SCALAR", AccessorKind::Times);
    let output = played.add_floats(&cut.values, shape, AccessorKind::Numbers);
    let name = match kind {
        KeyKind::Step => "STEP",
        KeyKind::Spline => "CUBICSPLINE",
        KeyKind::Straight | KeyKind::Turn => "LINEAR",
    };
    let name = quoted(name);
    Ok(Some(format!(
        r#"{{"input":{input},"interpolation":{name},"output":{output}}}"#
    )))
}
