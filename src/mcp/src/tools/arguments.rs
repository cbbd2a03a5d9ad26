//! Arguments of tools, read strictly: an unknown field, or one of a wrong type, is refused with its path.

use crate::picture::{PictureOrder, SIDES, View};
use glam::DVec3;
use pliant_session::Error;
use prost::Message;
use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeOwned, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};
use std::fmt;

/// Views of a picture, at most.
const MOST_VIEWS: usize = 4;
/// Pixels along each side of a view, unless asked for.
const USUAL_SIZE: u32 = 480;

/// Reads the arguments of a tool.
///
/// # Errors
/// `INVALID_ARGUMENT` with the path of the field.
pub(crate) fn read<T: DeserializeOwned>(arguments: Option<Map<String, Value>>) -> Result<T, Error> {
    let value = Value::Object(arguments.unwrap_or_default());
    serde_path_to_error::deserialize(value).map_err(|e| {
        let (path, problem) = (e.path().to_string(), e.inner().to_string());
        let problem: String = problem.chars().take(400).collect();
        match path.as_str() {
            "." | "?" | "" => Error::malformed(problem),
            path => Error {
                field: Some(path.to_owned()),
                ..Error::malformed(format!("{path}: {problem}"))
            },
        }
    })
}

/// An error about a field of a part of a request.
pub(super) fn below(error: Error, part: &str) -> Error {
    match &error.field {
        Some(field) if !field.starts_with(part) => Error {
            message: format!("{part}.{}", error.message),
            field: Some(format!("{part}.{field}")),
            ..error
        },
        _ => error,
    }
}

/// A message of the schema in its JSON form, as HTTP takes it.
pub(super) fn message_of<M: Message + Default + prost::Name>(
    fields: Map<String, Value>,
    part: &str,
) -> Result<M, Error> {
    let text = Value::Object(fields).to_string();
    pliant_wire::json::from_json(text.as_bytes()).map_err(|e| below(e.into(), part))
}

/// How a picture is asked for, in every tool that returns one.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct PictureArguments {
    pub views: Option<Vec<View>>,
    pub width: Option<u32>,
    pub height: Option<u32>,
}

impl PictureArguments {
    /// The picture.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` for none or too many views, or sides out of range.
    pub fn order(self) -> Result<PictureOrder, Error> {
        let views = self.views.unwrap_or_else(|| vec![View::Front, View::Left]);
        if views.is_empty() || views.len() > MOST_VIEWS {
            let problem = format!("has {} views, 1 to {MOST_VIEWS} are allowed", views.len());
            return Err(Error::invalid("picture.views", problem));
        }
        let mut size = [USUAL_SIZE; 2];
        for (own, (asked, name)) in size.iter_mut().zip([(self.width, "width"), (self.height, "height")]) {
            *own = asked.unwrap_or(USUAL_SIZE);
            if !SIDES.contains(own) {
                let (least, most) = (SIDES.start(), SIDES.end());
                let problem = format!("is {own} pixels, {least} to {most} are allowed");
                return Err(Error::invalid(format!("picture.{name}"), problem));
            }
        }
        Ok(PictureOrder { views, size })
    }
}

/// `open`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct OpenArguments {
    pub path: Option<String>,
    pub data: Option<String>,
    pub name: Option<String>,
    pub sample: Option<String>,
    pub options: Option<Map<String, Value>>,
    pub up: Option<String>,
    pub front: Option<String>,
    #[serde(default)]
    pub picture: PictureArguments,
}

/// `look`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct LookArguments {
    pub session: String,
    #[serde(default)]
    pub highlight: Vec<String>,
    #[serde(default)]
    pub picture: PictureArguments,
}

/// `region`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct RegionArguments {
    pub session: String,
    pub words: String,
    pub name: Option<String>,
    #[serde(default)]
    pub picture: PictureArguments,
}

/// A direction: by its word, or as a vector in model space.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged, expecting = "a direction is allowed, such as \"up\", \"-x\" or [0, 1, 0]")]
pub(crate) enum Direction {
    Word(String),
    Vector([f64; 3]),
}

impl Direction {
    /// The unit vector, in model space; words are those of the figure.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` about `field`.
    pub fn vector(&self, model_from_upright: glam::DMat3, field: &str) -> Result<DVec3, Error> {
        let allowed =
            "allowed are left, right, up, down, front, back, x, y, z, -x, -y, -z or three numbers, not all zero";
        let vector = match self {
            Self::Vector(numbers) => DVec3::from_array(*numbers),
            Self::Word(word) => match word.as_str() {
                "left" => model_from_upright * DVec3::X,
                "right" => model_from_upright * DVec3::NEG_X,
                "up" => model_from_upright * DVec3::Y,
                "down" => model_from_upright * DVec3::NEG_Y,
                "front" => model_from_upright * DVec3::Z,
                "back" => model_from_upright * DVec3::NEG_Z,
                "x" => DVec3::X,
                "y" => DVec3::Y,
                "z" => DVec3::Z,
                "-x" => DVec3::NEG_X,
                "-y" => DVec3::NEG_Y,
                "-z" => DVec3::NEG_Z,
                other => {
                    let shown: String = other.chars().take(40).collect();
                    return Err(Error::invalid(field, format!("is \"{shown}\"; {allowed}")));
                }
            },
        };
        let unit = vector.try_normalize();
        unit.ok_or_else(|| Error::invalid(field, format!("has no direction; {allowed}")))
    }
}

/// A rotation about an axis.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct AxisTurn {
    pub axis: Direction,
    pub degrees: f64,
}

/// Reads a rotation from an object alone: the fields of a struct may also come as a list, and three angles would be an axis.
fn axis_turn<'de, D: Deserializer<'de>>(from: D) -> Result<Option<AxisTurn>, D::Error> {
    struct Object;
    impl<'de> Visitor<'de> for Object {
        type Value = Option<AxisTurn>;

        fn expecting(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
            to.write_str("an axis and degrees, such as {\"axis\": \"z\", \"degrees\": 40}")
        }

        fn visit_unit<E>(self) -> Result<Self::Value, E> {
            Ok(None)
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
            AxisTurn::deserialize(MapAccessDeserializer::new(map)).map(Some)
        }
    }
    from.deserialize_any(Object)
}

/// One number for all axes, or three.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged, expecting = "a number or [x, y, z] is allowed")]
pub(crate) enum Scale {
    Uniform(f64),
    Axes([f64; 3]),
}

/// A region of a pose that moves.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct MovedArguments {
    pub region: String,
    pub translation: Option<[f64; 3]>,
    pub to: Option<[f64; 3]>,
    #[serde(default, deserialize_with = "axis_turn")]
    pub rotation: Option<AxisTurn>,
    pub aim: Option<Direction>,
    pub scale: Option<Scale>,
    pub pivot: Option<[f64; 3]>,
    #[serde(default)]
    pub turn_freely: bool,
}

/// `pose`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct PoseArguments {
    pub session: String,
    pub moved: Vec<MovedArguments>,
    pub held: Option<Vec<String>>,
    pub blend: Option<f64>,
    #[serde(default)]
    pub fresh: bool,
    pub options: Option<Map<String, Value>>,
    #[serde(default)]
    pub picture: PictureArguments,
}

/// `edit`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct EditArguments {
    pub session: String,
    pub operation: Map<String, Value>,
    #[serde(default)]
    pub picture: PictureArguments,
}

/// `undo` and `redo`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct StepArguments {
    pub session: String,
    #[serde(default)]
    pub picture: PictureArguments,
}

/// `export`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct ExportArguments {
    pub session: String,
    pub path: Option<String>,
    pub format: Option<String>,
    #[serde(default)]
    pub overwrite: bool,
}

/// `close`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct CloseArguments {
    pub session: String,
}

/// `sessions`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub(crate) struct SessionsArguments {
    pub page_token: Option<String>,
}
