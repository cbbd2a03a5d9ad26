//! Sides: "left half", "top quarter", "upper third", "front", "bottom 10 %".

use super::figure::RestFigure;
use super::vertex_set::VertexSet;

/// A side of something: along which axis of the upright figure, from which end, and how much of its length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Side {
    axis: usize,
    /// 1: the end where the axis rises, -1 the other, 0 the middle.
    end: i8,
    share: f64,
}

/// Directions by their words.
const DIRECTIONS: [(&[&str], usize, i8); 7] = [
    (&["left", "leftmost"], 0, 1),
    (&["right", "rightmost"], 0, -1),
    (&["top", "upper", "uppermost", "topmost", "highest"], 1, 1),
    (&["bottom", "lower", "lowermost", "lowest", "bottommost"], 1, -1),
    (&["front", "frontmost", "foremost"], 2, 1),
    (&["back", "rear", "backmost", "hindmost"], 2, -1),
    (&["middle", "center", "centre", "central"], 1, 0),
];
const SHARES: [(&str, f64); 6] = [
    ("half", 0.5),
    ("third", 1.0 / 3.0),
    ("quarter", 0.25),
    ("fifth", 0.2),
    ("tenth", 0.1),
    ("end", 0.1),
];
/// Words that say nothing more.
const FILLING: [&str; 6] = ["side", "part", "region", "area", "most", "percent"];

/// The direction that a word is: an axis of the upright figure, and which end of it.
pub(crate) fn direction_of(word: &str) -> Option<(usize, i8)> {
    let found = DIRECTIONS.iter().find(|(words, ..)| words.contains(&word));
    found.map(|(_, axis, end)| (*axis, *end))
}

/// The sides that words name, where they name nothing else.
pub(crate) fn sides_of(words: &[&str]) -> Option<Vec<Side>> {
    let mut ends: Vec<(usize, i8)> = Vec::new();
    let mut share = None;
    let mut is_side = false;
    for word in words {
        let number = word.trim_end_matches('%').parse::<f64>().ok();
        if let Some(end) = direction_of(word) {
            ends.push(end);
        } else if let Some((_, own)) = SHARES.iter().find(|(name, _)| name == word) {
            share = Some(*own);
        } else if let Some(percent) = number.filter(|n| *n > 0.0 && *n < 100.0) {
            share = Some(percent / 100.0);
        } else if FILLING.contains(word) {
            is_side |= *word == "side";
        } else {
            return None;
        }
    }
    let usual = match &ends[..] {
        [] => return None,
        [(0, _)] => 0.5,
        [(_, 0)] => 1.0 / 3.0,
        [_] if is_side => 0.5,
        [_] => 0.25,
        _ => 0.5,
    };
    let share = share.unwrap_or(usual);
    Some(ends.into_iter().map(|(axis, end)| Side { axis, end, share }).collect())
}

/// What lies on these sides of a set, measured by its box in the rest shape, and words for it.
pub(crate) fn cut(figure: &RestFigure<'_>, whole: &VertexSet, sides: &[Side]) -> (VertexSet, String) {
    let upright = figure.upright();
    let rest = figure.deformer.rest();
    let mut set = whole.clone();
    let mut told = Vec::new();
    for side in sides {
        let along = |v: usize| (upright * rest[v])[side.axis];
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in whole.list() {
            (low, high) = (low.min(along(v as usize)), high.max(along(v as usize)));
        }
        let length = (high - low) * side.share;
        let (from, to) = match side.end {
            1 => (high - length, high),
            -1 => (low, low + length),
            _ => (0.5 * (low + high - length), 0.5 * (low + high + length)),
        };
        set = set.and(&VertexSet::of(figure.count(), |v| (from..=to).contains(&along(v))));
        let name = match (side.axis, side.end) {
            (0, 1) => "left",
            (0, _) => "right",
            (1, 1) => "top",
            (1, -1) => "bottom",
            (1, _) => "middle",
            (_, 1) => "front",
            _ => "back",
        };
        told.push(format!("the {name} {:.0} % of its length that way", 100.0 * side.share));
    }
    (set, told.join(" and "))
}
