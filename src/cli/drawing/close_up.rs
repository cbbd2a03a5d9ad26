//! `--close-up`: a place of a shape that pictures show from near by.

use crate::asset::Primitive;
use crate::cli::terminal::{CliFailure, listed};
use crate::mesh::{BoundingBox, brief_number, brief_point};
use crate::render::CloseView;
use glam::DVec3;
use std::collections::BTreeSet;

/// How far a close-up reaches without a radius, in diagonals of the shape.
const USUAL_REACH: f64 = 0.1;
/// The largest radius, in diagonals of all that the picture is of: the model is a dot then.
const LARGEST_REACH: f64 = 100.0;
/// How much of a box or primitive's surroundings is seen too.
const MARGIN: f64 = 1.1;

/// What is seen from near by, and how far the picture reaches in model units.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::cli) struct CloseUp {
    target: NearTarget,
    radius: Option<f64>,
}

/// What can be seen from near by.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::cli) enum NearTarget {
    Point(DVec3),
    Box(BoundingBox),
    Vertex(usize),
    /// Where the picture's colours stand for the most.
    Worst,
    /// A primitive, a bone or a node.
    Named(String),
}

fn is_radius(radius: &f64) -> bool {
    *radius > 0.0
}

/// What may be asked for, in words.
const ALLOWED: &str = "allowed are worst, vertex:N, X,Y,Z, box:X,Y,Z,X,Y,Z and the name of a bone, node or primitive; \
    behind it (but not a box) a comma and a radius above 0 may stand, such as leftHand,0.3";

/// Reads what `--close-up` asks for.
pub(in crate::cli) fn parse_close_up(text: &str) -> Result<CloseUp, String> {
    let numbers = |text: &str| -> Option<Vec<f64>> {
        let words = text
            .split(',')
            .map(|word| word.trim().parse::<f64>().ok().filter(|x| x.is_finite()));
        words.collect()
    };
    let point = |n: &[f64]| DVec3::new(n[0], n[1], n[2]);
    if let Some(corners) = text.strip_prefix("box:") {
        return match numbers(corners).as_deref() {
            Some(n @ [_, _, _, _, _, _]) => Ok(CloseUp {
                target: NearTarget::Box(BoundingBox::of(&[point(n), point(&n[3..])])),
                radius: None,
            }),
            _ => Err(ALLOWED.into()),
        };
    }
    match numbers(text).as_deref() {
        Some(n @ ([_, _, _] | [_, _, _, _])) if n.get(3).is_none_or(is_radius) => {
            return Ok(CloseUp {
                target: NearTarget::Point(point(n)),
                radius: n.get(3).copied(),
            });
        }
        Some(_) => return Err(ALLOWED.into()),
        None => {}
    }
    let (name, radius) = match text.rsplit_once(',') {
        Some((name, radius)) => match radius.trim().parse::<f64>().ok().filter(|r| r.is_finite()) {
            Some(radius) if is_radius(&radius) => (name, Some(radius)),
            _ => return Err(ALLOWED.into()),
        },
        None => (text, None),
    };
    let target = match name.strip_prefix("vertex:") {
        _ if name.is_empty() => return Err(ALLOWED.into()),
        _ if name == "worst" => NearTarget::Worst,
        Some(number) => NearTarget::Vertex(number.parse().map_err(|_| ALLOWED.to_owned())?),
        None => NearTarget::Named(name.into()),
    };
    Ok(CloseUp { target, radius })
}

/// A shape in which something is looked for.
pub(in crate::cli) struct SeenShape<'a> {
    /// Where the model's vertices are.
    pub(in crate::cli) positions: &'a [DVec3],
    pub(in crate::cli) primitives: &'a [Primitive],
    /// How bad each vertex is; empty without a measure.
    pub(in crate::cli) values: &'a [f64],
    /// Names of bones or nodes, and where they are.
    pub(in crate::cli) marks: &'a [(String, DVec3)],
    /// The box of all that the picture is of, which a place has to reach.
    pub(in crate::cli) bounds: BoundingBox,
}

impl CloseUp {
    /// What is asked for, with the worst place replaced by its vertex in `shape`.
    pub(in crate::cli) fn settled_in(&self, shape: &SeenShape<'_>) -> Result<Self, CliFailure> {
        let target = match &self.target {
            NearTarget::Worst => {
                let largest = shape.values.iter().enumerate().filter(|(_, x)| x.abs() > 0.0);
                // Of equal ones the first.
                let found = largest.min_by(|(_, a), (_, b)| b.abs().total_cmp(&a.abs()));
                let Some((vertex, _)) = found else {
                    let problem = "worst is where colours stand for the most: it needs --color stretch, difference or crossings, and \
                        a shape in which something has changed";
                    return Err(refusal(problem));
                };
                NearTarget::Vertex(vertex)
            }
            other => other.clone(),
        };
        Ok(Self {
            target,
            radius: self.radius,
        })
    }

    /// The place in a shape.
    pub(in crate::cli) fn place_in(&self, shape: &SeenShape<'_>) -> Result<CloseView, CliFailure> {
        let usual = USUAL_REACH * BoundingBox::of(shape.positions).diagonal();
        let around = |bounds: BoundingBox| (bounds.center(), 0.5 * MARGIN * bounds.diagonal());
        let (at, reach) = match &self.settled_in(shape)?.target {
            NearTarget::Point(at) => (*at, usual),
            NearTarget::Box(bounds) => around(*bounds),
            NearTarget::Vertex(vertex) => match shape.positions.get(*vertex) {
                Some(at) => (*at, usual),
                None => {
                    let count = shape.positions.len();
                    return Err(refusal(&format!(
                        "vertex {vertex} does not exist, there are {count}, from 0"
                    )));
                }
            },
            NearTarget::Named(name) => {
                let mark = shape.marks.iter().find(|(own, _)| own == name);
                let own = shape.primitives.iter().find(|p| p.name == *name);
                let vertices = own.and_then(|p| shape.positions.get(p.vertices()));
                match (mark, vertices) {
                    (Some((_, at)), _) => (*at, usual),
                    (None, Some(vertices)) => around(BoundingBox::of(vertices)),
                    (None, None) => return Err(unknown_name(name, shape)),
                }
            }
            NearTarget::Worst => (DVec3::ZERO, usual),
        };
        let radius = self.radius.unwrap_or(reach);
        let most = LARGEST_REACH * shape.bounds.diagonal();
        if most > 0.0 && radius > most {
            let [radius, most] = [radius, most].map(brief_number);
            let problem = format!(
                "a radius of {radius} shows nothing of the model; at most {most} is allowed, {LARGEST_REACH} times its diagonal"
            );
            return Err(refusal(&problem));
        }
        let BoundingBox { min, max } = shape.bounds;
        let is_reached = match &self.target {
            NearTarget::Box(asked) => asked.overlaps(&shape.bounds),
            _ => at.clamp(min, max).distance(at) <= radius,
        };
        if !is_reached {
            let [at, min, max] = [at, min, max].map(brief_point);
            let reach = brief_number(radius);
            let problem =
                format!("{at} with {reach} around it is outside the model, which reaches from {min} to {max}");
            return Err(refusal(&problem));
        }
        Ok(CloseView { at, radius })
    }
}

/// The box of several shapes.
pub(in crate::cli) fn bounds_of<'a>(shapes: impl Iterator<Item = &'a [DVec3]>) -> BoundingBox {
    let corners = shapes.map(BoundingBox::of).flat_map(|own| [own.min, own.max]);
    BoundingBox::of(&corners.collect::<Vec<_>>())
}

fn refusal(problem: &str) -> CliFailure {
    CliFailure::Input(format!("--close-up: {problem}"))
}

fn unknown_name(name: &str, shape: &SeenShape<'_>) -> CliFailure {
    let primitives = shape.primitives.iter().map(|p| p.name.as_str());
    let marks = shape.marks.iter().map(|(own, _)| own.as_str());
    // A bone and its node often share a name.
    let mut seen = BTreeSet::from([""]);
    let names: Vec<&str> = marks.chain(primitives).filter(|own| seen.insert(*own)).collect();
    let there = match names.is_empty() {
        true => "nothing here has a name".to_owned(),
        false => listed(names.into_iter(), ""),
    };
    refusal(&format!("\"{name}\" is not a bone, node or primitive; {there}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_way_to_name_a_place_is_read() {
        let read = |text: &str| parse_close_up(text).map(|c| (c.target, c.radius));
        let hand = NearTarget::Named("leftHand".into());
        assert_eq!(read("leftHand,0.3"), Ok((hand.clone(), Some(0.3))));
        assert_eq!(read("leftHand"), Ok((hand, None)));
        assert_eq!(
            read("1,-2,3"),
            Ok((NearTarget::Point(DVec3::new(1.0, -2.0, 3.0)), None))
        );
        assert_eq!(read("1,2,3,0.5").map(|c| c.1), Ok(Some(0.5)));
        assert_eq!(read("vertex:7,2"), Ok((NearTarget::Vertex(7), Some(2.0))));
        assert_eq!(read("worst"), Ok((NearTarget::Worst, None)));
        let bounds = BoundingBox::of(&[DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0)]);
        assert_eq!(read("box:1,2,3,0,0,0"), Ok((NearTarget::Box(bounds), None)));
        for text in [
            "",
            ",1",
            "hand,0",
            "hand,x",
            "1,2",
            "1,2,3,-1",
            "1,2,3,4,5",
            "vertex:x",
            "box:1,2,3",
        ] {
            assert!(read(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn the_worst_place_is_the_first_of_the_largest_values() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let shape = |values| SeenShape {
            positions: &positions,
            primitives: &[],
            values,
            marks: &[],
            bounds: BoundingBox::of(&positions),
        };
        let worst = parse_close_up("worst,0.5").expect("allowed");
        let place = worst.place_in(&shape(&[0.5, -2.0, 2.0])).expect("one is worst");
        assert_eq!((place.at, place.radius), (DVec3::X, 0.5));
        assert!(worst.place_in(&shape(&[0.0; 3])).is_err() && worst.place_in(&shape(&[])).is_err());
        let wide = |text: &str| parse_close_up(text).expect("allowed").place_in(&shape(&[])).is_ok();
        assert_eq!(
            [wide("vertex:0,100"), wide("vertex:0,1e9"), wide("0,0,0,1e300")],
            [true, false, false]
        );
        // A place has to be near the model.
        for (text, is_near) in [
            ("0.5,0.5,0", true),
            ("3,0,0,2", true),
            ("3,0,0,1.9", false),
            ("3,0,0", false),
            ("box:0,0,-1,9,9,9", true),
            ("box:2,2,0,9,9,9", false),
        ] {
            let place = parse_close_up(text).expect("allowed").place_in(&shape(&[]));
            assert_eq!(place.is_ok(), is_near, "{text}");
            let is_refused = |e| match e {
                CliFailure::Input(message) => {
                    message.contains("outside the model, which reaches from (0, 0, 0) to (1, 1, 0)")
                }
                _ => false,
            };
            assert!(place.is_ok() || place.is_err_and(is_refused), "{text}");
        }
    }
}
