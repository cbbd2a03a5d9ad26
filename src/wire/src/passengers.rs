//! Passengers of a model, and points and models that are carried once.

use super::check::{number, points};
use super::{Error, pb};
use glam::{DQuat, DVec3};
use pliant_asset::{FileSet, Format};
use pliant_core::engine::{CarriedModel, Passenger, PassengerKind};

/// The most passengers of one model.
const MOST_PASSENGERS: usize = 1024;
/// The most points that are carried at once.
const MOST_POINTS: usize = 1 << 24;
/// The longest name, in bytes.
const LONGEST_NAME: usize = 256;
/// How far a quaternion's length may be from 1.
const UNIT: f64 = 0.01;
/// How far it may be by rounding alone.
const ROUNDED: f64 = 1e-12;

/// What one call carries along with a session's shape. Made by [`carry_order`].
#[derive(Debug, Clone)]
pub struct CarryOrder {
    /// Points of the rest pose.
    pub points: Vec<DVec3>,
    /// The rest rotations of axes at the points, one for each.
    pub rotations: Vec<DQuat>,
    /// Another model that stands in the rest space.
    pub model: Option<CarriedModel>,
}

/// Reads what is to be carried.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn carry_order(request: &pb::CarryRequest) -> Result<CarryOrder, Error> {
    if request.points.is_empty() && request.model.is_empty() {
        let problem = "is empty, and so is model; give points to carry, or a model, or both";
        return Err(Error::invalid("points", problem));
    }
    let points = rest_points(&request.points, "points")?;
    let rotations = rest_rotations(&request.rotations, points.len(), "rotations")?;
    let model = match request.model.is_empty() {
        true if !request.format.is_empty() => {
            return Err(Error::invalid("format", "is that of a model, and there is none"));
        }
        true => None,
        false => Some(CarriedModel {
            format: named_format(&request.format, "format")?,
            files: FileSet::single(String::new(), request.model.clone()),
            output: None,
            path: String::new(),
        }),
    };
    Ok(CarryOrder {
        points,
        rotations,
        model,
    })
}

/// Reads the passengers of a model.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub(super) fn passengers(messages: &[pb::Passenger]) -> Result<Vec<Passenger>, Error> {
    if messages.len() > MOST_PASSENGERS {
        let problem = format!("has {} entries, at most {MOST_PASSENGERS} are allowed", messages.len());
        return Err(Error::invalid("passengers", problem));
    }
    let read = messages.iter().enumerate();
    read.map(|(k, message)| passenger(message, &format!("passengers[{k}]")))
        .collect()
}

/// Refuses passengers that a session does not hold.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub(super) fn require_own_passengers(passengers: &[Passenger]) -> Result<(), Error> {
    for (k, passenger) in passengers.iter().enumerate() {
        let field = match passenger.kind {
            PassengerKind::Points { .. } => "points",
            PassengerKind::Model(_) => "file",
            PassengerKind::Primitive(_)
            | PassengerKind::PrimitivesNamed(_)
            | PassengerKind::Node(_)
            | PassengerKind::NodesNamed(_) => continue,
        };
        let problem = "is for jobs; a session carries points and models when Carry is called";
        return Err(Error::invalid(format!("passengers[{k}].{field}"), problem));
    }
    Ok(())
}

fn passenger(message: &pb::Passenger, at: &str) -> Result<Passenger, Error> {
    use pb::passenger::Passenger as Kind;
    if message.name.len() > LONGEST_NAME {
        let problem = format!("is {} bytes, at most {LONGEST_NAME} are allowed", message.name.len());
        return Err(Error::invalid(format!("{at}.name"), problem));
    }
    let kind = match &message.passenger {
        Some(Kind::Primitive(index)) => PassengerKind::Primitive(*index),
        Some(Kind::PrimitivesNamed(name)) => {
            PassengerKind::PrimitivesNamed(given_name(name, || format!("{at}.primitivesNamed"))?)
        }
        Some(Kind::Node(index)) => PassengerKind::Node(*index),
        Some(Kind::NodesNamed(name)) => PassengerKind::NodesNamed(given_name(name, || format!("{at}.nodesNamed"))?),
        Some(Kind::Points(given)) => {
            let positions = rest_points(&given.positions, &format!("{at}.points.positions"))?;
            let field = format!("{at}.points.rotations");
            PassengerKind::Points {
                rotations: rest_rotations(&given.rotations, positions.len(), &field)?,
                positions,
            }
        }
        Some(Kind::File(file)) => PassengerKind::Model(passenger_file(file, &format!("{at}.file"))?),
        None => {
            let problem = "is empty, allowed is one of primitive, primitivesNamed, node, nodesNamed, points or file";
            return Err(Error::invalid(at, problem));
        }
    };
    Ok(Passenger {
        name: message.name.clone(),
        kind,
    })
}

fn given_name(name: &str, field: impl Fn() -> String) -> Result<String, Error> {
    if name.len() > LONGEST_NAME {
        let problem = format!("is {} bytes, at most {LONGEST_NAME} are allowed", name.len());
        return Err(Error::invalid(field(), problem));
    }
    match name.is_empty() {
        true => Err(Error::invalid(field(), "is empty, a name is needed")),
        false => Ok(name.to_owned()),
    }
}

fn passenger_file(file: &pb::passenger::File, at: &str) -> Result<CarriedModel, Error> {
    use pb::passenger::file::Source;
    let bytes = match &file.source {
        Some(Source::Model(bytes)) => bytes.clone(),
        Some(Source::File(name)) => {
            let problem = format!("names \"{name}\", but files are read where a job file is run; give the model");
            return Err(Error::invalid(format!("{at}.file"), problem));
        }
        None => {
            return Err(Error::invalid(
                at,
                "names no model, allowed is one of model or, in a job, file",
            ));
        }
    };
    let field = format!("{at}.output");
    let plain = |part: &str| !part.is_empty() && part != "." && part != "..";
    if file.output.contains(['\\', ':', '\0']) || !file.output.split('/').all(plain) {
        let problem = format!(
            "is \"{}\", a path of plain names below the folder of the result is needed, such as \"hull.obj\"",
            file.output
        );
        return Err(Error::invalid(field, problem));
    }
    let Some(output) = Format::from_file_name(&file.output) else {
        let allowed = Format::name_list("and");
        let problem = format!("is \"{}\", its extension must be one of {allowed}", file.output);
        return Err(Error::invalid(field, problem));
    };
    if let Some(problem) = output.refusal_to_write() {
        return Err(Error::invalid(field, format!("is \"{}\": {problem}", file.output)));
    }
    Ok(CarriedModel {
        format: named_format(&file.format, &format!("{at}.format"))?,
        files: FileSet::single(String::new(), bytes),
        output: Some(output),
        path: file.output.clone(),
    })
}

fn named_format(name: &str, field: &str) -> Result<Option<Format>, Error> {
    if name.is_empty() {
        return Ok(None);
    }
    let problem = || format!("is \"{name}\", allowed are {}", Format::read_name_list("and"));
    let format = Format::from_name(name);
    format.map(Some).ok_or_else(|| Error::invalid(field, problem()))
}

fn rest_points(values: &[f64], field: &str) -> Result<Vec<DVec3>, Error> {
    points(values, 0..=MOST_POINTS, field, |count| {
        format!("has {count} numbers, three for each point and at most {MOST_POINTS} points are allowed")
    })
}

/// Unit quaternions, one for each of `count` points; the identity where none are given.
fn rest_rotations(values: &[f64], count: usize, field: &str) -> Result<Vec<DQuat>, Error> {
    if values.is_empty() {
        return Ok(vec![DQuat::IDENTITY; count]);
    }
    if values.len() != 4 * count {
        let problem = format!(
            "has {} numbers, four for each of {count} points are needed, or none",
            values.len()
        );
        return Err(Error::invalid(field, problem));
    }
    for (k, v) in values.iter().enumerate() {
        number(*v, &format!("{field}[{k}]"))?;
    }
    let quaternions = values.chunks_exact(4).map(DQuat::from_slice).enumerate();
    quaternions
        .map(|(k, q)| {
            let length = q.length();
            let from_unit = (length - 1.0).abs();
            if from_unit <= UNIT {
                // What an earlier answer gave is carried on with the same bits.
                return Ok(if from_unit <= ROUNDED { q } else { q.normalize() });
            }
            let problem = format!("is of length {length}, a rotation is a unit quaternion [x, y, z, w]");
            Err(Error::invalid(format!("{field}[{}]", 4 * k), problem))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(request: &pb::CarryRequest) -> String {
        carry_order(request).expect_err("refused").to_string()
    }

    #[test]
    fn what_cannot_be_carried_is_refused_with_its_field() {
        let empty = pb::CarryRequest::default();
        assert!(refusal(&empty).starts_with("points: is empty"));
        let request = |points: &[f64], rotations: &[f64]| pb::CarryRequest {
            points: points.to_vec(),
            rotations: rotations.to_vec(),
            ..Default::default()
        };
        for (points, rotations, field) in [
            (&[1.0, 2.0][..], &[][..], "points: has 2 numbers"),
            (&[0.0, f64::NAN, 0.0], &[], "points[1]: is NaN"),
            (&[0.0; 3], &[0.0, 0.0, 1.0], "rotations: has 3 numbers"),
            (&[0.0; 3], &[0.0, 0.0, 0.0, 2.0], "rotations[0]: is of length 2"),
        ] {
            let reported = refusal(&request(points, rotations));
            assert!(reported.starts_with(field), "{reported}");
        }
        let read = carry_order(&request(&[1.0, 2.0, 3.0], &[])).expect("a point");
        assert_eq!(
            (read.points, read.rotations),
            (vec![DVec3::new(1.0, 2.0, 3.0)], vec![DQuat::IDENTITY])
        );
    }

    #[test]
    fn the_name_of_what_rides_along_is_given_and_of_sane_length() {
        use pb::passenger::Passenger as Kind;
        type Named = (fn(String) -> Kind, &'static str);
        let kinds: [Named; 2] = [
            (Kind::NodesNamed, "nodesNamed"),
            (Kind::PrimitivesNamed, "primitivesNamed"),
        ];
        for (kind, field) in kinds {
            let read = |name: String| {
                let message = pb::Passenger {
                    passenger: Some(kind(name)),
                    ..Default::default()
                };
                passengers(&[message]).map_err(|e| e.to_string())
            };
            assert!(read("n".repeat(256)).is_ok());
            let reported = read("n".repeat(257)).expect_err("too long");
            assert_eq!(
                reported,
                format!("passengers[0].{field}: is 257 bytes, at most 256 are allowed")
            );
            assert!(read(String::new()).expect_err("empty").contains("is empty"));
        }
    }

    #[test]
    fn a_passenger_file_stays_below_the_folder_of_the_result() {
        let file = |output: &str| pb::passenger::File {
            source: Some(pb::passenger::file::Source::Model(vec![1].into())),
            output: output.into(),
            ..Default::default()
        };
        for wrong in [
            "",
            "/tmp/x.obj",
            "../x.obj",
            "a//x.obj",
            "a/../x.obj",
            "C:x.obj",
            "a\\x.obj",
            "hull",
            "hull.txt",
        ] {
            let reported = passenger_file(&file(wrong), "passengers[2].file")
                .expect_err(wrong)
                .to_string();
            assert!(reported.starts_with("passengers[2].file.output: is "), "{reported}");
        }
        let read = passenger_file(&file("lods/one.ply"), "file").expect("right");
        assert_eq!((read.output, read.path.as_str()), (Some(Format::PLY), "lods/one.ply"));
    }
}
