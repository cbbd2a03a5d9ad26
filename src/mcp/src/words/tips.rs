//! Extremities: where the surface reaches farthest along itself from its middle.

use super::figure::RestFigure;
use super::sides::direction_of;
use super::vertex_set::VertexSet;
use glam::DVec3;
use pliant_core::engine::Error;

/// A tip's share of the longest way from the middle of the surface, at least.
const FAR: f64 = 0.35;
/// Tips are this far apart, as a share of the longest way.
const APART: f64 = 0.2;
/// What belongs to a tip: what is nearer to it than this share of the longest way.
const REACH: f64 = 0.12;
/// The same of something that is as long as a tail.
const TAIL: f64 = 0.35;
/// Most tips, and most places that are looked at.
const MOST: usize = 16;
const MOST_LOOKED_AT: usize = 48;

/// An extremity of the largest part.
pub(crate) struct Tip {
    /// Its end, among the welded vertices.
    pub end: u32,
    /// Where that is, in the upright figure, from the middle of the tips.
    pub place: DVec3,
    /// The longest way from the middle of the surface.
    longest: f64,
}

/// The extremities of the largest part, the farthest first.
pub(crate) fn find_tips(figure: &RestFigure<'_>) -> Result<Vec<Tip>, Error> {
    let mesh = figure.mesh();
    let largest = figure.parts().first().and_then(|part| figure.part(part.0));
    let Some(own) = largest.map(|part| figure.welded(&part)).filter(|own| !own.is_empty()) else {
        return Ok(Vec::new());
    };
    let middle = own.iter().map(|s| mesh.positions[*s as usize]).sum::<DVec3>() / own.len() as f64;
    let nearest = own.iter().copied().min_by(|a, b| {
        let to = |s: u32| mesh.positions[s as usize].distance_squared(middle);
        to(*a).total_cmp(&to(*b)).then(a.cmp(b))
    });
    let Some(start) = nearest else { return Ok(Vec::new()) };
    let far = figure.distances(&[start], None, f64::INFINITY)?;
    let way = |s: u32| far[s as usize];
    let longest = own
        .iter()
        .map(|s| way(*s))
        .filter(|d| d.is_finite())
        .fold(0.0, f64::max);
    let is_top = |s: &u32| way(*s).is_finite() && figure.neighbours(*s).iter().all(|n| way(*n) <= way(*s));
    let mut tops: Vec<u32> = own.iter().copied().filter(is_top).collect();
    tops.retain(|s| way(*s) > FAR * longest);
    tops.sort_by(|a, b| way(*b).total_cmp(&way(*a)).then(a.cmp(b)));
    tops.truncate(MOST_LOOKED_AT);
    let mut taken = vec![false; mesh.positions.len()];
    let mut ends: Vec<u32> = Vec::new();
    for top in tops {
        if taken[top as usize] || ends.len() == MOST {
            continue;
        }
        let around = figure.distances(&[top], None, APART * longest)?;
        // Around a tip the ways are shorter; beside a bump of a flank some are longer.
        let is_near = |s: &u32| around[*s as usize].is_finite();
        let is_tip = own.iter().filter(|s| is_near(s)).all(|s| way(*s) <= way(top));
        own.iter()
            .filter(|s| around[**s as usize].is_finite())
            .for_each(|s| taken[*s as usize] = true);
        if is_tip {
            ends.push(top);
        }
    }
    let upright = figure.upright();
    let places: Vec<DVec3> = ends.iter().map(|s| upright * mesh.positions[*s as usize]).collect();
    let between = places.iter().copied().sum::<DVec3>() / places.len().max(1) as f64;
    let tip = |(end, place): (&u32, &DVec3)| Tip {
        end: *end,
        place: *place - between,
        longest,
    };
    Ok(ends.iter().zip(&places).map(tip).collect())
}

impl Tip {
    /// What belongs to it.
    pub fn region(&self, figure: &RestFigure<'_>, is_tail: bool) -> Result<VertexSet, Error> {
        let reach = self.longest * if is_tail { TAIL } else { REACH };
        let around = figure.distances(&[self.end], None, reach)?;
        Ok(figure.rendered(|s| around[s as usize].is_finite()))
    }

    /// How it can be asked for.
    pub fn name(&self, number: usize) -> String {
        let way = self.place.abs().max_position();
        let names = [["right", "left"], ["bottom", "top"], ["back", "front"]];
        format!(
            "tip {} ({})",
            number + 1,
            names[way][usize::from(self.place[way] > 0.0)]
        )
    }
}

/// The tips that words ask for; `None` where they ask for no tip.
pub(crate) fn chosen_tips(tips: &[Tip], words: &[&str]) -> Option<Vec<usize>> {
    let is_tail = words.contains(&"tail");
    let is_tip = |w: &&str| {
        matches!(
            *w,
            "tip" | "tips" | "extremity" | "extremities" | "end" | "ends" | "tail"
        )
    };
    words.iter().find(|w| is_tip(w))?;
    let mut ways: Vec<(usize, i8)> = Vec::new();
    let mut number = None;
    for word in words.iter().filter(|w| !is_tip(w)) {
        match (direction_of(word), word.parse::<usize>()) {
            (Some(way), _) => ways.push(way),
            (None, Ok(n)) => number = Some(n),
            _ => return None,
        }
    }
    if is_tail && ways.is_empty() {
        ways.push((2, -1));
    }
    if let Some(number) = number {
        return Some(number.checked_sub(1).filter(|n| *n < tips.len()).into_iter().collect());
    }
    if ways.is_empty() {
        return Some((0..tips.len()).collect());
    }
    let score = |tip: &Tip| {
        ways.iter()
            .map(|(axis, end)| tip.place[*axis] * f64::from(*end))
            .sum::<f64>()
    };
    let ranked = (0..tips.len()).max_by(|a, b| score(&tips[*a]).total_cmp(&score(&tips[*b])).then(b.cmp(a)));
    Some(ranked.into_iter().collect())
}
