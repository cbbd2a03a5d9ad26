//! Words for a region, resolved on the rest shape: by names given before and in the file, sides, joints, parts and tips.
//!
//! `A and B`, `A but B` and `A of B` put regions together. What is resolved depends on model and words alone.

use super::figure::RestFigure;
use super::file_names::FileNames;
use super::joints::Joints;
use super::sides::{cut, sides_of};
use super::tips::{Tip, chosen_tips, find_tips};
use super::vertex_set::VertexSet;
use glam::DVec3;
use pliant_core::engine::Error;
use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The longest words, in bytes.
pub(crate) const LONGEST_WORDS: usize = 256;
/// Names that an answer lists of each kind.
const LISTED: usize = 12;
/// What is called the tip or the base of something: the farthest from, or nearest to, where it hangs on the rest.
const OUTERMOST: f64 = 0.75;
const INNERMOST: f64 = 0.2;

/// A region that words were resolved to.
#[derive(Debug, Clone)]
pub(crate) struct Found {
    pub set: VertexSet,
    /// What it turns about, in model space: a joint, or the middle of its border.
    pub pivot: Option<DVec3>,
    /// How it was resolved.
    pub how: String,
    /// What else the words may have meant, or could be asked for near it.
    pub others: Vec<String>,
}

impl Found {
    fn plain(set: VertexSet, how: impl Into<String>) -> Self {
        Self {
            set,
            pivot: None,
            how: how.into(),
            others: Vec::new(),
        }
    }
}

/// What words are resolved with: the figure, the names given before, and what is found on the way.
pub(crate) struct Resolver<'a> {
    pub figure: &'a RestFigure<'a>,
    /// Regions that were named before, with their vertices and what they turn about.
    pub named: BTreeMap<String, (VertexSet, Option<DVec3>)>,
    /// The joints, once looked for; the inner value is `None` where there are none.
    pub joints: OnceCell<Option<Arc<Joints>>>,
    names: OnceCell<FileNames>,
    tips: OnceCell<Vec<Tip>>,
}

/// Words in small letters, without marks and articles.
pub(crate) fn plain_words(text: &str) -> Vec<String> {
    let small = text.to_lowercase();
    let words = small.split(|c: char| !(c.is_alphanumeric() || c == '%' || c == '.'));
    words
        .map(|w| w.trim_matches('.'))
        .filter(|w| !w.is_empty() && !["the", "a", "an", "its", "his", "her", "whole", "entire", "please"].contains(w))
        .map(|w| match w {
            "l" => "left".to_owned(),
            "r" => "right".to_owned(),
            w => w.to_owned(),
        })
        .collect()
}

impl<'a> Resolver<'a> {
    /// Resolves on a figure.
    pub fn new(figure: &'a RestFigure<'a>, joints: Option<Option<Arc<Joints>>>) -> Self {
        let known = OnceCell::new();
        if let Some(joints) = joints {
            let _ = known.set(joints);
        }
        Self {
            figure,
            named: BTreeMap::new(),
            joints: known,
            names: OnceCell::new(),
            tips: OnceCell::new(),
        }
    }

    fn names(&self) -> Result<&FileNames, Error> {
        if self.names.get().is_none() {
            let _ = self.names.set(FileNames::of(self.figure)?);
        }
        Ok(self.names.get_or_init(|| FileNames(Vec::new())))
    }

    /// The joints; `None` where there are none.
    pub fn joints(&self) -> Result<Option<&Joints>, Error> {
        if self.joints.get().is_none() {
            let _ = self.joints.set(Joints::of(self.figure)?.map(Arc::new));
        }
        Ok(self.joints.get_or_init(|| None).as_deref())
    }

    fn tips(&self) -> Result<&[Tip], Error> {
        if self.tips.get().is_none() {
            let _ = self.tips.set(find_tips(self.figure)?);
        }
        Ok(self.tips.get_or_init(Vec::new))
    }

    /// Resolves words.
    ///
    /// # Errors
    /// [`Error::Invalid`] about `field` with what can be asked for, where nothing is meant.
    pub fn resolve(&self, text: &str, field: &str) -> Result<Found, Error> {
        let text = text.trim();
        if text.is_empty() || text.len() > LONGEST_WORDS {
            let problem = format!("has {} bytes, words of 1 to {LONGEST_WORDS} are allowed", text.len());
            return Err(Error::invalid(field, problem));
        }
        let mut found = self.put_together(text, field)?;
        if found.set.count() == 0 {
            return Err(Error::invalid(
                field,
                format!("\"{text}\" has no vertex ({})", found.how),
            ));
        }
        if found.pivot.is_none() {
            found.pivot = self.figure.border_middle(&found.set);
        }
        Ok(found)
    }

    fn put_together(&self, text: &str, field: &str) -> Result<Found, Error> {
        if let Some(found) = self.by_name(text)? {
            return Ok(found);
        }
        let lower = text.to_lowercase();
        let lower = if lower.len() == text.len() {
            lower
        } else {
            text.to_owned()
        };
        for word in [" but not ", " except ", " but ", " without ", " minus "] {
            if let Some(at) = lower.find(word) {
                let (kept, less) = (&text[..at], &text[at + word.len()..]);
                let kept = self.put_together(kept, field)?;
                let less = self.put_together(less.trim_start_matches("for "), field)?;
                return Ok(Found {
                    how: format!("{}, without {}", kept.how, less.how),
                    ..Found::plain(kept.set.minus(&less.set), "")
                });
            }
        }
        for word in [" and ", " plus ", ",", "+", "&"] {
            if let Some(at) = lower.find(word) {
                let one = self.put_together(text[..at].trim(), field)?;
                let other = self.put_together(text[at + word.len()..].trim(), field)?;
                return Ok(Found {
                    how: format!("{}; and {}", one.how, other.how),
                    others: [one.others, other.others].concat(),
                    ..Found::plain(one.set.or(&other.set), "")
                });
            }
        }
        for word in [" of ", " on "] {
            if let Some(at) = lower.find(word) {
                let whole = self.put_together(text[at + word.len()..].trim(), field)?;
                return self.inside(text[..at].trim(), &whole, field);
            }
        }
        match self.single(text)? {
            Some(found) => Ok(found),
            None => Err(self.unknown(text, field)?),
        }
    }

    /// What has exactly this name: given before, or in the file.
    fn by_name(&self, text: &str) -> Result<Option<Found>, Error> {
        let plain = plain_words(text).join(" ");
        if let Some((set, pivot)) = self.named.get(&plain) {
            return Ok(Some(Found {
                pivot: *pivot,
                ..Found::plain(set.clone(), format!("the region named \"{plain}\" before"))
            }));
        }
        let quoted = text.trim_matches(['"', '\'']);
        let found = self.names()?.exact(quoted);
        Ok(found.map(|own| {
            Found::plain(
                own.set.clone(),
                format!("the {} \"{}\" of the file", own.kind, own.name),
            )
        }))
    }

    fn single(&self, text: &str) -> Result<Option<Found>, Error> {
        let owned = plain_words(text);
        let words: Vec<&str> = owned.iter().map(String::as_str).collect();
        let plain = words.join(" ");
        if matches!(plain.as_str(), "all" | "everything" | "model" | "object" | "shape" | "") {
            return Ok(Some(Found::plain(self.figure.all.clone(), "the whole model")));
        }
        if let Some(sides) = sides_of(&words) {
            let (set, how) = cut(self.figure, &self.figure.all, &sides);
            return Ok(Some(Found::plain(set, format!("{how} of the whole model"))));
        }
        let of_file = self
            .figure
            .deformer
            .model()
            .joint_names()
            .is_ok_and(|names| !names.is_empty());
        if of_file && let Some(found) = self.by_joint(&words)? {
            return Ok(Some(found));
        }
        let named = self.names()?.with_words(&words);
        if !named.is_empty() {
            let set = (named.iter()).fold(VertexSet::none(self.figure.count()), |set, own| set.or(&own.set));
            let list: Vec<String> = named
                .iter()
                .take(LISTED)
                .map(|own| format!("\"{}\"", own.name))
                .collect();
            let mut found = Found::plain(set, format!("the {} {} of the file", named[0].kind, list.join(", ")));
            if list.len() > 1 {
                found.others = list;
            }
            return Ok(Some(found));
        }
        if let Some(found) = self.by_part(&words) {
            return Ok(Some(found));
        }
        if let Some(found) = self.by_tip(&words)? {
            return Ok(Some(found));
        }
        if !of_file && let Some(found) = self.by_joint(&words)? {
            return Ok(Some(found));
        }
        Ok(None)
    }

    fn by_joint(&self, words: &[&str]) -> Result<Option<Found>, Error> {
        let Some(joints) = self.joints()? else { return Ok(None) };
        let body = joints.body_part(self.figure, words);
        let found = match body {
            Some(found) if found.0.count() > 0 => Some(found),
            _ => joints.named(self.figure, words).filter(|found| found.0.count() > 0),
        };
        Ok(found.map(|(set, pivot, how)| Found {
            pivot,
            ..Found::plain(set, how)
        }))
    }

    /// "largest part", "second largest part", "smallest part", "part 3".
    fn by_part(&self, words: &[&str]) -> Option<Found> {
        let is_part = |w: &&str| matches!(*w, "part" | "piece" | "component");
        words.iter().find(|w| is_part(w))?;
        let parts = self.figure.parts();
        let mut place = None;
        let mut is_rank = false;
        for word in words.iter().filter(|w| !is_part(w)) {
            match *word {
                "largest" | "biggest" | "main" => (place, is_rank) = (place.or(Some(0)), true),
                "smallest" => (place, is_rank) = (Some(parts.len().checked_sub(1)?), true),
                "second" => place = Some(1),
                "third" => place = Some(2),
                "fourth" => place = Some(3),
                number => place = Some(number.parse::<usize>().ok()?.checked_sub(1)?),
            }
        }
        let place = place.or((parts.len() == 1).then_some(0))?;
        let (number, area) = *parts.get(place)?;
        let set = self.figure.part(number)?;
        let ranked = if is_rank { "by size " } else { "" };
        let how = format!(
            "connected part {} of {} {ranked}(largest first), area {area:.4}",
            place + 1,
            parts.len()
        );
        Some(Found {
            others: (0..parts.len().min(LISTED))
                .filter(|k| *k != place)
                .map(|k| format!("part {}", k + 1))
                .collect(),
            ..Found::plain(set, how)
        })
    }

    fn by_tip(&self, words: &[&str]) -> Result<Option<Found>, Error> {
        if !words.iter().any(|w| {
            matches!(
                *w,
                "tip" | "tips" | "tail" | "extremity" | "extremities" | "end" | "ends"
            )
        }) {
            return Ok(None);
        }
        let tips = self.tips()?;
        let Some(chosen) = chosen_tips(tips, words).filter(|chosen| !chosen.is_empty()) else {
            return Ok(None);
        };
        let is_tail = words.contains(&"tail");
        let mut set = VertexSet::none(self.figure.count());
        for tip in &chosen {
            set = set.or(&tips[*tip].region(self.figure, is_tail)?);
        }
        let names: Vec<String> = chosen.iter().map(|tip| tips[*tip].name(*tip)).collect();
        let all = tips
            .iter()
            .enumerate()
            .filter(|(k, _)| !chosen.contains(k))
            .map(|(k, tip)| tip.name(k));
        Ok(Some(Found {
            others: all.take(LISTED).collect(),
            ..Found::plain(
                set,
                format!("{}, where the surface reaches far from its middle", names.join(", ")),
            )
        }))
    }

    /// What words mean inside of something: a side of it, its tip, its base, or what both have.
    fn inside(&self, part: &str, whole: &Found, field: &str) -> Result<Found, Error> {
        let owned = plain_words(part);
        let words: Vec<&str> = owned.iter().map(String::as_str).collect();
        if let Some(sides) = sides_of(&words) {
            let (set, how) = cut(self.figure, &whole.set, &sides);
            return Ok(Found::plain(set, format!("{how} of {}", whole.how)));
        }
        let is_base = matches!(words[..], ["base" | "root"]);
        if is_base || matches!(words[..], ["tip" | "tips" | "end" | "ends"]) {
            let border = self.figure.border(&whole.set);
            if !border.is_empty() {
                return self.along(whole, &border, is_base);
            }
        }
        let other = match self.single(part)? {
            Some(found) => found,
            None => return Err(self.unknown(part, field)?),
        };
        let how = format!("what {} and {} share", other.how, whole.how);
        Ok(Found::plain(whole.set.clone().and(&other.set), how))
    }

    /// The end of a region that is farthest from where it hangs on the rest, or nearest to it.
    fn along(&self, whole: &Found, border: &[u32], is_base: bool) -> Result<Found, Error> {
        let own = self.figure.welded(&whole.set);
        let mut within = vec![false; self.figure.mesh().positions.len()];
        own.iter().for_each(|s| within[*s as usize] = true);
        let far = self.figure.distances(border, Some(&within), f64::INFINITY)?;
        let way = |s: u32| far[s as usize];
        let longest = own
            .iter()
            .map(|s| way(*s))
            .filter(|d| d.is_finite())
            .fold(0.0, f64::max);
        let fits = |s: u32| {
            within[s as usize]
                && match is_base {
                    true => way(s) <= INNERMOST * longest,
                    false => way(s).is_finite() && way(s) >= OUTERMOST * longest,
                }
        };
        let what = if is_base { "nearest to" } else { "farthest from" };
        let how = format!("what is {what} its border, of {}", whole.how);
        Ok(Found::plain(self.figure.rendered(fits).and(&whole.set), how))
    }

    /// The error that lists what can be asked for.
    fn unknown(&self, text: &str, field: &str) -> Result<Error, Error> {
        let shown: String = text.chars().take(80).collect();
        let mut problem = format!("\"{shown}\" is nothing of this model; {}", self.what_there_is()?);
        let has_body = (self.joints()?).is_some_and(|joints| !joints.words().is_empty());
        if !has_body && Joints::is_body_part(&plain_words(text)) {
            let axes = self.figure.axes;
            let (up, front) = (axes.up.name(), axes.front.name());
            problem += &format!(
                "; no body was found that stands along {up} and faces {front}: if it is one, `open` it with its \"up\" and \"front\""
            );
        }
        Ok(Error::invalid(field, problem))
    }

    /// What can be asked for, in a sentence.
    pub fn what_there_is(&self) -> Result<String, Error> {
        let mut kinds: Vec<String> = Vec::new();
        let mut list = |what: &str, all: Vec<String>| {
            if !all.is_empty() {
                let more = if all.len() > LISTED { " and more" } else { "" };
                let shown: Vec<String> = all.into_iter().take(LISTED).collect();
                kinds.push(format!("{what} {}{more}", shown.join(", ")));
            }
        };
        list(
            "named before:",
            self.named.keys().map(|name| format!("\"{name}\"")).collect(),
        );
        let names = self
            .names()?
            .0
            .iter()
            .map(|own| format!("\"{}\" ({})", own.name, own.kind));
        list("names of the file:", names.collect());
        if let Some(joints) = self.joints()? {
            list("parts of the body:", joints.words());
            if joints.of_file {
                list(
                    "joints:",
                    joints
                        .joints
                        .iter()
                        .map(|j| j.name.clone())
                        .filter(|n| !n.is_empty())
                        .collect(),
                );
            }
        }
        let parts = self.figure.parts().len();
        if parts > 1 {
            list(
                "connected parts:",
                vec![format!("\"largest part\", \"part 2\" to \"part {parts}\", by size")],
            );
        }
        let tips = self.tips()?;
        list("tips:", tips.iter().enumerate().map(|(k, tip)| tip.name(k)).collect());
        let sides = "sides: \"left half\", \"top quarter\", \"front\", \"bottom 10%\"";
        kinds.push(format!(
            "{sides}; and \"A and B\", \"A but B\", \"top of A\", \"tip of A\""
        ));
        Ok(format!("there are {}", kinds.join("; ")))
    }
}
