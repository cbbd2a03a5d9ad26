//! What of a file's own clip goes on beside what is played: channels of everything that is still there, cut to their time.

use super::super::builder::AccessorKind;
use super::super::document::GltfDocument;
use super::super::text::{JsonSections, WEIGHTS, channel_target, index_of, list_of, value_of, with_member};
use super::document::{
    NewClip, PlayedDocument, PlayedNode, add_root, parents, sampler_text, scene_sections, top_nodes,
};
use crate::Error;
use crate::moving_scene::ClipBeside;
use glam::DQuat;
use std::collections::{BTreeMap, BTreeSet};

/// Puts `own`, what is played, into the scene, and lets everything else move as its clip says.
pub(super) fn go_on_beside(
    played: &mut PlayedDocument<'_, '_>,
    new: &mut NewClip,
    nodes: &[PlayedNode<'_>],
    beside: Option<&ClipBeside<'_>>,
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
    for (node, text) in doc.items(&doc.nodes).enumerate() {
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
    let clip = doc.item(&doc.animations, beside.clip);
    let living = living_nodes(doc, nodes);
    let list = |key: &str| list_of(clip, key);
    let samplers = list("samplers");
    let played_nodes: BTreeSet<usize> = nodes.iter().map(|n| n.node).collect();
    // Channels may share samplers, and still do; a turn is cut otherwise than numbers.
    let mut added: BTreeMap<(usize, bool), usize> = BTreeMap::new();
    for channel in list("channels") {
        let Some((node, path)) = channel_target(channel) else {
            continue;
        };
        let moves = living.contains(&node) && !(path == WEIGHTS && played_nodes.contains(&node));
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
        new.channels.push(with_member(channel, "sampler", number));
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
    let Some((input, output)) = index_of(sampler, "input").zip(index_of(sampler, "output")) else {
        return Ok(None);
    };
    let doc = played.doc;
    let (Some(of_times), Some(of_values)) = (doc.layout(input), doc.layout(output)) else {
        return Ok(None);
    };
    let (times, values) = (doc.read_values(input, of_times)?, doc.read_values(output, of_values)?);
    if of_times.lanes != 1 {
        return Ok(None);
    }
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
    let shape = match of_values.lanes {
        1 => "SCALAR",
        3 => "VEC3",
        _ => "VEC4",
    };
    let input = played.fresh.add_floats(&cut.times, "SCALAR", AccessorKind::Times);
    let output = played.fresh.add_floats(&cut.values, shape, AccessorKind::Numbers);
    let name = match kind {
        KeyKind::Step => "STEP",
        KeyKind::Spline => "CUBICSPLINE",
        KeyKind::Straight | KeyKind::Turn => "LINEAR",
    };
    Ok(Some(sampler_text(input, name, output)))
}

/// How values run from key to key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum KeyKind {
    /// The value of the key before.
    Step,
    /// Straight.
    Straight,
    /// Four numbers, along the shorter great circle.
    Turn,
    /// By a cubic Hermite spline; each key has the tangent that leads to it, its value and the tangent that leads away.
    Spline,
}

/// Times and values.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SamplerKeys {
    /// Seconds, rising.
    pub(super) times: Vec<f32>,
    /// So many of each key, or three times so many.
    pub(super) values: Vec<f32>,
    width: usize,
    kind: KeyKind,
}

impl SamplerKeys {
    /// Keys, as many values each as there are; `None` where their numbers do not fit.
    pub(super) fn of(times: Vec<f32>, values: Vec<f32>, kind: KeyKind) -> Option<Self> {
        let parts = if kind == KeyKind::Spline { 3 } else { 1 };
        let width = values.len() / (parts * times.len()).max(1);
        let fits = width > 0 && values.len() == parts * width * times.len() && times.is_sorted();
        let fits = fits && (kind != KeyKind::Turn || width == 4);
        fits.then_some(Self {
            times,
            values,
            width,
            kind,
        })
    }

    /// Whether nothing is to be cut off, nor anything to be shifted.
    pub(super) fn lie_within(&self, [from, until]: [f64; 2]) -> bool {
        // The time of a last frame is rounded to another number than a key at its place.
        let last = self.times.last().map_or(0.0, |t| f64::from(*t));
        from == 0.0 && last <= until + 1e-6 * until.abs().max(1e-3)
    }

    /// The keys of a part of the time, which begins at 0 then: what they say between its ends is what these do.
    pub(super) fn cut(&self, [from, until]: [f64; 2]) -> Self {
        let mut cut = Self {
            times: Vec::new(),
            values: Vec::new(),
            ..*self
        };
        let seconds = |key: usize| f64::from(self.times[key]);
        let count = self.times.len();
        if seconds(0) < from || seconds(0) >= until {
            cut.push(0.0, &self.key_at(from));
        }
        for key in (0..count).filter(|k| (from..until).contains(&seconds(*k))) {
            let at = (seconds(key) - from) as f32;
            if cut.times.last().is_none_or(|last| *last < at) && at < (until - from) as f32 {
                let each = self.values.len() / count;
                cut.push(at, &self.values[key * each..(key + 1) * each]);
            }
        }
        let end = (until - from) as f32;
        if seconds(count - 1) >= until && cut.times.last().is_none_or(|last| *last < end) {
            cut.push(end, &self.key_at(until));
        }
        cut
    }

    fn push(&mut self, time: f32, key: &[f32]) {
        self.times.push(time);
        self.values.extend(key);
    }

    /// A key for a time between others, as it would be stored.
    fn key_at(&self, seconds: f64) -> Vec<f32> {
        let after = self.times.partition_point(|t| f64::from(*t) <= seconds);
        let before = after.saturating_sub(1);
        let is_spline = self.kind == KeyKind::Spline;
        if is_spline && self.times.get(before).is_some_and(|t| f64::from(*t) == seconds) {
            // The slopes to it and from it differ.
            return self.values[3 * before * self.width..3 * (before + 1) * self.width].to_vec();
        }
        let part = |key: usize, part: usize| {
            let at = self.width * if is_spline { 3 * key + part } else { key };
            &self.values[at..at + self.width]
        };
        if after == 0 || after == self.times.len() || self.kind == KeyKind::Step {
            let value = part(before, 1);
            let still = vec![0.0; if is_spline { self.width } else { 0 }];
            return [&still, value, &still].concat();
        }
        let span = f64::from(self.times[after]) - f64::from(self.times[before]);
        let t = ((seconds - f64::from(self.times[before])) / span).clamp(0.0, 1.0);
        let (a, b) = (part(before, 1), part(after, 1));
        match self.kind {
            KeyKind::Turn => turn_between(a, b, t),
            KeyKind::Spline => spline_key([a, part(before, 2), part(after, 0), b], t, span),
            _ => {
                let pairs = a.iter().zip(b);
                pairs
                    .map(|(a, b)| (f64::from(*a) * (1.0 - t) + f64::from(*b) * t) as f32)
                    .collect()
            }
        }
    }
}

/// A turn a share of the way from one to another.
fn turn_between(a: &[f32], b: &[f32], t: f64) -> Vec<f32> {
    let turn = |v: &[f32]| DQuat::from_xyzw(v[0].into(), v[1].into(), v[2].into(), v[3].into());
    let (a, b) = (turn(a), turn(b));
    let cosine = a.dot(b);
    let (b, cosine) = if cosine < 0.0 { (-b, -cosine) } else { (b, cosine) };
    let mixed = if cosine > 1.0 - 1e-9 {
        a * (1.0 - t) + b * t
    } else {
        let angle = libm::acos(cosine);
        a * libm::sin((1.0 - t) * angle) + b * libm::sin(t * angle)
    };
    let length = mixed.length();
    let mixed = if length > 0.0 { mixed * (1.0 / length) } else { a };
    mixed.to_array().map(|v| v as f32).to_vec()
}

/// Tangent, value and tangent on a spline: a part of a cubic is a cubic with the same slopes.
fn spline_key([a, leaving, arriving, b]: [&[f32]; 4], t: f64, span: f64) -> Vec<f32> {
    let (t2, t3) = (t * t, t * t * t);
    let value = [
        2.0 * t3 - 3.0 * t2 + 1.0,
        span * (t3 - 2.0 * t2 + t),
        span * (t3 - t2),
        3.0 * t2 - 2.0 * t3,
    ];
    let slope = [
        (6.0 * t2 - 6.0 * t) / span,
        3.0 * t2 - 4.0 * t + 1.0,
        3.0 * t2 - 2.0 * t,
        (6.0 * t - 6.0 * t2) / span,
    ];
    let sum = |shares: &[f64; 4], lane: usize| {
        let parts = [a[lane], leaving[lane], arriving[lane], b[lane]];
        let parts = parts.iter().zip(shares);
        parts.map(|(v, share)| f64::from(*v) * share).sum::<f64>() as f32
    };
    let slopes: Vec<f32> = (0..a.len()).map(|lane| sum(&slope, lane)).collect();
    let values: Vec<f32> = (0..a.len()).map(|lane| sum(&value, lane)).collect();
    [&slopes[..], &values, &slopes].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The value at a time.
    fn value_at(keys: &SamplerKeys, seconds: f64) -> Vec<f32> {
        let key = keys.key_at(seconds);
        match keys.kind {
            KeyKind::Spline => key[keys.width..2 * keys.width].to_vec(),
            _ => key,
        }
    }

    #[test]
    fn a_part_says_what_the_whole_does() {
        let times = vec![0.5, 1.0, 2.0, 4.0];
        let straight = vec![0.0, 3.0, 1.0, -1.0, 5.0, 2.0, 2.0, 2.0];
        let turns = vec![
            0.0, 0.0, 0.0, 1.0, 0.6, 0.0, 0.0, 0.8, 0.0, -0.8, 0.0, -0.6, 0.0, 0.0, 1.0, 0.0,
        ];
        let splines = (0..12).map(|i| ((i * 7) % 5) as f32 - 2.0).collect();
        for (kind, values) in [
            (KeyKind::Straight, straight.clone()),
            (KeyKind::Step, straight),
            (KeyKind::Turn, turns),
            (KeyKind::Spline, splines),
        ] {
            let whole = SamplerKeys::of(times.clone(), values, kind).expect("keys");
            for part in [[0.0, 9.0], [0.75, 3.0], [1.0, 2.0], [0.0, 0.25], [5.0, 6.0], [1.5, 1.5]] {
                let cut = whole.cut(part);
                assert!(cut.times.windows(2).all(|t| t[0] < t[1]), "{kind:?} {part:?}: {cut:?}");
                assert!(!cut.times.is_empty() && cut.times[0] >= 0.0);
                for k in 0..=20 {
                    let at = part[0] + (part[1] - part[0]) * f64::from(k) / 20.0;
                    let (seen, wanted) = (value_at(&cut, at - part[0]), value_at(&whole, at));
                    for (a, b) in seen.iter().zip(&wanted) {
                        assert!(
                            (a - b).abs() < 1e-5,
                            "{kind:?} {part:?} at {at}: {seen:?}, not {wanted:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_no_sampler() {
        assert_eq!(SamplerKeys::of(vec![], vec![], KeyKind::Step), None);
        assert_eq!(SamplerKeys::of(vec![0.0, 1.0], vec![1.0], KeyKind::Straight), None);
        assert_eq!(SamplerKeys::of(vec![1.0, 0.0], vec![1.0, 2.0], KeyKind::Straight), None);
        assert_eq!(SamplerKeys::of(vec![0.0], vec![1.0; 3], KeyKind::Turn), None);
    }
}
