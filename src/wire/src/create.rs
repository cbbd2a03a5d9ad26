//! How a session is built: its options, checked.
//!
//! A session's options are those of its deformer, a label for people, and how long it outlives its last use.

use super::check::{enumerated, number, plain_text};
use super::facts::following;
use super::passengers::{passengers, require_own_passengers};
use super::{Error, pb};
use pliant_asset::{Format, Limits};
use pliant_core::engine::{KeptApart, OpenOptions};
use pliant_deform::{BodyOptions, CoarseOperators, EdgeWeights, FreePartPolicy, TieOptions, VolumeMode};
use pliant_mesh::Weld;
use pliant_mesh::graph::{InteriorKind, VolumeOptions};
use std::ops::RangeInclusive;
use std::time::Duration;

/// Most numbers in one list of parts to be kept apart.
const MOST_KEPT_APART: usize = 1 << 16;
/// How many triangles the surface around a model of splats may have.
const CAGE_TRIANGLES: RangeInclusive<u32> = 500..=200_000;
/// The longest label, in bytes.
const LONGEST_LABEL: usize = 256;

/// How a session is to be opened. Made by [`session_options`].
#[derive(Debug, Clone)]
pub struct SessionOptions {
    /// How its deformer is built.
    pub open: OpenOptions,
    /// The same as it was asked for, with defaults made explicit, so that they may change: read again it is `open`. Has neither
    /// label nor time to live.
    pub create: pb::CreateOptions,
    /// Free text for people, returned with the session.
    pub label: String,
    /// How long the session outlives its last use; `None` is the server's default.
    pub ttl: Option<Duration>,
}

impl Default for SessionOptions {
    fn default() -> Self {
        let open = OpenOptions::default();
        Self {
            create: with_defaults(&pb::CreateOptions::default(), &open),
            open,
            label: String::new(),
            ttl: None,
        }
    }
}

/// The request for `open` with its defaults made explicit.
fn with_defaults(create: &pb::CreateOptions, open: &OpenOptions) -> pb::CreateOptions {
    let graph = &open.body.graph;
    let weights = match graph.weights {
        EdgeWeights::Uniform => pb::create_options::Weights::Uniform,
        EdgeWeights::Cotangent | EdgeWeights::CotangentOfMean => pb::create_options::Weights::Cotangent,
    };
    pb::CreateOptions {
        volume_graph: Some(pb::create_options::VolumeGraph {
            valence: graph.valence,
            ..create.volume_graph.unwrap_or_default()
        }),
        weights: Some(weights.into()),
        label: String::new(),
        ttl: String::new(),
        ..create.clone()
    }
}

/// Reads how a session is to be opened; `ttl` are the times to live that it may ask for.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn session_options(create: &pb::CreateOptions, ttl: RangeInclusive<Duration>) -> Result<SessionOptions, Error> {
    if create.label.len() > LONGEST_LABEL {
        let problem = format!("is {} bytes, at most {LONGEST_LABEL} are allowed", create.label.len());
        return Err(Error::invalid("label", problem));
    }
    plain_text(&create.label, "label")?;
    let open = open_options(create)?;
    require_own_passengers(&open.passengers)?;
    Ok(SessionOptions {
        ttl: time_to_live(&create.ttl, ttl)?,
        create: with_defaults(create, &open),
        open,
        label: create.label.clone(),
    })
}

/// Reads a session's time to live; an empty text is the default.
fn time_to_live(text: &str, allowed: RangeInclusive<Duration>) -> Result<Option<Duration>, Error> {
    if text.is_empty() {
        return Ok(None);
    }
    let shown: String = text.chars().take(64).collect();
    let ttl = humantime::parse_duration(text).map_err(|e| {
        let problem = format!("\"{shown}\" is not a duration such as \"15m\" or \"1h 30m\": {e}");
        Error::invalid("ttl", problem)
    })?;
    if !allowed.contains(&ttl) {
        let [shortest, longest] = [*allowed.start(), *allowed.end()].map(humantime::format_duration);
        let problem = format!("\"{shown}\" is out of range, {shortest} to {longest} is allowed");
        return Err(Error::invalid("ttl", problem));
    }
    Ok(Some(ttl))
}

/// Reads how a model is to be opened.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn open_options(create: &pb::CreateOptions) -> Result<OpenOptions, Error> {
    let format = read_format(&create.format)?;
    let length = |value: f64, field: &str| match number(value, field)? {
        v if v < 0.0 => Err(Error::invalid(field, format!("is {v}, it must not be negative"))),
        0.0 => Ok(None),
        v => Ok(Some(v)),
    };
    let weld = match &create.weld {
        Some(weld) => length(weld.tolerance, "weld.tolerance")?.map_or(Weld::Exact, Weld::Tolerance),
        None => Weld::Rounding,
    };
    let policy = match enumerated(create.components, "components")? {
        pb::create_options::Components::Follow => FreePartPolicy::Follow,
        pb::create_options::Components::Hold => FreePartPolicy::Hold,
        pb::create_options::Components::Free => FreePartPolicy::Free,
    };
    let operators = match enumerated(create.operators, "operators")? {
        pb::create_options::Operators::FiniteVolume => CoarseOperators::FiniteVolume,
        pb::create_options::Operators::Paper => CoarseOperators::Paper,
    };
    let volume = create.volume_graph.unwrap_or_default();
    let mode = match enumerated(volume.mode, "volumeGraph.mode")? {
        pb::create_options::volume_graph::Mode::Auto => VolumeMode::Auto,
        pb::create_options::volume_graph::Mode::Off => VolumeMode::Off,
        pb::create_options::volume_graph::Mode::Required => VolumeMode::Required,
    };
    let of_kind = match enumerated(volume.kind, "volumeGraph.kind")? {
        pb::create_options::volume_graph::Kind::Shape => VolumeOptions::default(),
        pb::create_options::volume_graph::Kind::Paper => VolumeOptions::paper(),
    };
    let weights = match create.weights.map(|w| enumerated(w, "weights")).transpose()? {
        None => of_kind.weights,
        Some(pb::create_options::Weights::Uniform) => EdgeWeights::Uniform,
        Some(pb::create_options::Weights::Cotangent) => EdgeWeights::Cotangent,
    };
    let valence = match volume.valence {
        0 | 14 => 14,
        8 => 8,
        other => {
            return Err(Error::invalid(
                "volumeGraph.valence",
                format!("is {other}, allowed are 14 and 8, or 0 for 14"),
            ));
        }
    };
    let stiffness = match volume.stiffness {
        0.0 => 1.0,
        _ if of_kind.kind == InteriorKind::Paper => {
            let problem = "is given, it belongs to kind SHAPE: edges of the paper's graph all weigh the same";
            return Err(Error::invalid("volumeGraph.stiffness", problem));
        }
        v if (1e-3..=1e3).contains(&v) => v,
        v => {
            let problem = format!("is {v}, allowed are 1e-3 to 1e3, or 0 for 1");
            return Err(Error::invalid("volumeGraph.stiffness", problem));
        }
    };
    let ties = match enumerated(create.parts, "parts")? {
        pb::create_options::Parts::Tied => Some(TieOptions {
            distance: length(create.tie_distance, "tieDistance")?,
            ..TieOptions::default()
        }),
        pb::create_options::Parts::Separate => {
            refuse_without_ties(create)?;
            None
        }
    };
    let graph = VolumeOptions {
        interval: length(volume.interval, "volumeGraph.interval")?,
        valence,
        shell_offset: length(volume.shell_offset, "volumeGraph.shellOffset")?,
        weights,
        stiffness,
        ..of_kind
    };
    Ok(OpenOptions {
        format,
        weld,
        policy,
        body: BodyOptions {
            volume: mode,
            graph,
            operators,
            apart: false,
            ties,
            near_origin: true,
            local_fields: true,
        },
        passengers: passengers(&create.passengers)?,
        following: following(create)?,
        kept_apart: kept_apart(create.keep_apart.as_ref())?,
        cage_triangles: cage_triangles(create.cage_triangles)?,
        ..OpenOptions::default()
    })
}

/// How many triangles the surface around splats has.
fn cage_triangles(given: u32) -> Result<u32, Error> {
    match given {
        0 => Ok(Limits::CAGE_TRIANGLES),
        _ if CAGE_TRIANGLES.contains(&given) => Ok(given),
        _ => {
            let (least, most) = (CAGE_TRIANGLES.start(), CAGE_TRIANGLES.end());
            let problem = format!(
                "is {given}, allowed are {least} to {most}, or 0 for {}",
                Limits::CAGE_TRIANGLES
            );
            Err(Error::invalid("cageTriangles", problem))
        }
    }
}

/// The format of that name; `None` of no name.
fn read_format(name: &str) -> Result<Option<Format>, Error> {
    let unknown = || {
        let allowed = Format::read_name_list("and");
        Error::invalid("format", format!("is \"{name}\", allowed are {allowed}"))
    };
    let given = (!name.is_empty()).then(|| Format::from_name(name).ok_or_else(unknown));
    given.transpose()
}

/// Refuses what says how parts are tied where none are.
fn refuse_without_ties(create: &pb::CreateOptions) -> Result<(), Error> {
    let given = [
        ("tieDistance", create.tie_distance != 0.0),
        ("keepApart", create.keep_apart.is_some()),
    ];
    match given.into_iter().find(|g| g.1) {
        Some((field, _)) => Err(Error::invalid(
            field,
            "is given, but parts SEPARATE have no ties; leave one out",
        )),
        None => Ok(()),
    }
}

/// Reads which parts get no ties.
fn kept_apart(message: Option<&pb::create_options::KeepApart>) -> Result<KeptApart, Error> {
    let Some(message) = message else {
        return Ok(KeptApart::default());
    };
    let lists = [
        ("keepApart.primitives", &message.primitives),
        ("keepApart.components", &message.components),
    ];
    if let Some((field, list)) = lists.into_iter().find(|(_, list)| list.len() > MOST_KEPT_APART) {
        let problem = format!("has {} entries, at most {MOST_KEPT_APART} are allowed", list.len());
        return Err(Error::invalid(field, problem));
    }
    Ok(KeptApart {
        primitives: message.primitives.clone(),
        components: message.components.clone(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_to_live_is_a_duration_within_the_limits() {
        let hours = |n: u64| Duration::from_secs(3600 * n);
        let read = |text: &str| time_to_live(text, Duration::from_secs(1)..=hours(2));
        assert_eq!(read(""), Ok(None));
        assert_eq!(read("1h 30m"), Ok(Some(Duration::from_secs(5400))));
        for text in ["10ms", "3h", "soon", "-5s", "1", "99999999999999999999y"] {
            assert!(
                matches!(read(text), Err(Error::Invalid { field, .. }) if field == "ttl"),
                "{text}"
            );
        }
        let reported = read("3h").expect_err("too long").to_string();
        assert_eq!(reported, "ttl: \"3h\" is out of range, 1s to 2h is allowed");
    }

    #[test]
    fn parts_are_tied_unless_asked_otherwise() {
        let read = |text: &str| open_options(&crate::json::from_json(text.as_bytes()).expect("options"));
        let ties = |text: &str| read(text).expect("allowed").body.ties;
        assert_eq!(ties("{}"), Some(TieOptions::default()));
        assert_eq!(ties(r#"{"parts": "SEPARATE"}"#), None);
        assert_eq!(ties(r#"{"tieDistance": 0.5}"#).and_then(|t| t.distance), Some(0.5));
        let kept = read(r#"{"keepApart": {"primitives": [1], "components": [2, 3]}}"#).expect("allowed");
        assert_eq!(kept.kept_apart.components, [2, 3]);
        for (text, field) in [
            (r#"{"tieDistance": -1}"#, "tieDistance"),
            (r#"{"tieDistance": "NaN"}"#, "tieDistance"),
            (r#"{"parts": "SEPARATE", "tieDistance": 1}"#, "tieDistance"),
            (r#"{"parts": "SEPARATE", "keepApart": {}}"#, "keepApart"),
            (r#"{"parts": 7}"#, "parts"),
        ] {
            let reported = read(text).expect_err(text);
            assert!(
                matches!(&reported, Error::Invalid { field: at, .. } if at == field),
                "{text}: {reported}"
            );
        }
    }

    #[test]
    fn the_surface_around_splats_has_as_many_triangles_as_asked_for_within_limits() {
        let read = |text: &str| open_options(&crate::json::from_json(text.as_bytes()).expect("options"));
        let triangles = |text: &str| read(text).expect("allowed").cage_triangles;
        assert_eq!(triangles("{}"), 20_000);
        assert_eq!(triangles(r#"{"cageTriangles": 500}"#), 500);
        for text in [r#"{"cageTriangles": 499}"#, r#"{"cageTriangles": 200001}"#] {
            let refused = read(text).expect_err(text).to_string();
            assert!(
                refused.starts_with("cageTriangles: is ") && refused.contains("500 to 200000"),
                "{refused}"
            );
        }
    }

    #[test]
    fn all_operators_can_be_chosen() {
        use pb::create_options::Operators as Wanted;
        for (wanted, chosen) in [
            (Wanted::FiniteVolume, CoarseOperators::FiniteVolume),
            (Wanted::Paper, CoarseOperators::Paper),
        ] {
            let create = pb::CreateOptions {
                operators: wanted.into(),
                ..Default::default()
            };
            let options = open_options(&create).ok();
            assert_eq!(options.map(|c| c.body.operators), Some(chosen));
        }
        let unknown = pb::CreateOptions {
            operators: 7,
            ..Default::default()
        };
        assert!(open_options(&unknown).is_err());
    }
}
