//! Checks of numbers and options, with the field's path in every refusal.

use super::{Error, pb};
use crate::deform::{FirstPass, Transform};
use glam::{DMat3, DQuat, DVec3};

/// Largest coordinate, translation, radius and rotation that a request may hold.
const LARGEST: f64 = 1e30;

/// Exactly three finite numbers.
pub(crate) fn vector(values: &[f64], field: &str) -> Result<DVec3, Error> {
    if values.len() != 3 {
        return Err(Error::invalid(
            field,
            format!("has {} numbers, a vector has 3 [x, y, z]", values.len()),
        ));
    }
    for (k, v) in values.iter().enumerate() {
        number(*v, &format!("{field}[{k}]"))?;
    }
    Ok(DVec3::from_slice(values))
}

/// A finite number of sane size.
pub(crate) fn number(value: f64, field: &str) -> Result<f64, Error> {
    if value.abs() <= LARGEST {
        Ok(value)
    } else {
        Err(Error::invalid(
            field,
            format!("is {value:?}, allowed are finite numbers up to {LARGEST:e}"),
        ))
    }
}

/// A finite number above 0.
pub(crate) fn positive(value: f64, field: &str) -> Result<f64, Error> {
    number(value, field)?;
    if value > 0.0 {
        Ok(value)
    } else {
        Err(Error::invalid(field, format!("is {value}, it must be above 0")))
    }
}

/// 0 for "not given", else a number in `range`.
pub(crate) fn optional_within(value: f64, low: f64, high: f64, field: &str) -> Result<Option<f64>, Error> {
    if value == 0.0 {
        return Ok(None);
    }
    if (low..=high).contains(&value) {
        Ok(Some(value))
    } else {
        Err(Error::invalid(
            field,
            format!("is {value}, allowed are {low:e} to {high:e}, or 0 for the default"),
        ))
    }
}

/// A known enum value.
pub(crate) fn enumerated<E: TryFrom<i32>>(value: i32, field: &str) -> Result<E, Error> {
    E::try_from(value).map_err(|_| Error::invalid(field, format!("is {value}, no value of this enum")))
}

/// A plane with a unit normal: (normal, a point on it).
pub(crate) fn plane(plane: &pb::Plane, field: &str) -> Result<(DVec3, DVec3), Error> {
    let normal = vector(&plane.normal, &format!("{field}.normal"))?;
    let offset = number(plane.offset, &format!("{field}.offset"))?;
    let length = normal.length();
    if !(length > 0.0 && length.is_finite()) {
        return Err(Error::invalid(
            format!("{field}.normal"),
            "is zero, a plane needs a direction",
        ));
    }
    let unit = normal / length;
    Ok((unit, unit * (offset / length)))
}

/// A pose as a transform; `pivot` is used when the pose names none.
pub(crate) fn transform(pose: &pb::HandlePose, pivot: DVec3, field: &str) -> Result<Transform, Error> {
    let optional = |values: &[f64], name: &str| match values {
        [] => Ok(None),
        values => vector(values, &format!("{field}.{name}")).map(Some),
    };
    let translation = optional(&pose.translation, "translation")?.unwrap_or(DVec3::ZERO);
    let pivot = optional(&pose.pivot, "pivot")?.unwrap_or(pivot);
    let turned = optional(&pose.rotation_vector, "rotationVector")?;
    if turned.is_some_and(|v| v.length() > 1e6) {
        return Err(Error::invalid(
            format!("{field}.rotationVector"),
            "is longer than 1e6 radians",
        ));
    }
    let rotation = match (quaternion(&pose.rotation, &format!("{field}.rotation"))?, turned) {
        (Some(_), Some(_)) => {
            return Err(Error::invalid(
                field,
                "has both rotation and rotationVector, only one of them is allowed",
            ));
        }
        (Some(q), None) => crate::deform::log_rotation(q),
        (None, v) => v.unwrap_or(DVec3::ZERO),
    };
    let log_scale = log_scale(&pose.scale, &format!("{field}.scale"))?;
    Ok(Transform {
        translation,
        rotation,
        log_scale,
        pivot,
    })
}

fn quaternion(values: &[f64], field: &str) -> Result<Option<DQuat>, Error> {
    if values.is_empty() {
        return Ok(None);
    }
    let [x, y, z, w] = values else {
        let problem = format!("has {} numbers, a quaternion has 4 [x, y, z, w]", values.len());
        return Err(Error::invalid(field, problem));
    };
    let q = DQuat::from_xyzw(*x, *y, *z, *w);
    let length = q.length();
    if !(0.99..=1.01).contains(&length) {
        let problem = format!("has length {length}, a rotation needs a unit quaternion [x, y, z, w]");
        return Err(Error::invalid(field, problem));
    }
    Ok(Some(q.normalize()))
}

fn log_scale(values: &[f64], field: &str) -> Result<DMat3, Error> {
    let factors = match values {
        [] => return Ok(DMat3::ZERO),
        [s] => [*s; 3],
        [x, y, z] => [*x, *y, *z],
        more => {
            return Err(Error::invalid(
                field,
                format!("has {} numbers, allowed are 1 or 3", more.len()),
            ));
        }
    };
    for (k, s) in factors.iter().enumerate() {
        if !(1e-6..=1e6).contains(s) {
            let place = if values.len() == 1 {
                field.to_owned()
            } else {
                format!("{field}[{k}]")
            };
            return Err(Error::invalid(place, format!("is {s}, allowed are 1e-6 to 1e6")));
        }
    }
    Ok(DMat3::from_diagonal(DVec3::from_array(factors.map(libm::log))))
}

/// How often a commit fits rotations unless asked otherwise.
pub const COMMIT_REFINE: u32 = 4;
/// Most fits of rotations in one solve.
const MOST_REFINE: u32 = 1000;
/// Largest weight of neighbours in such a fit.
const MOST_SMOOTHING: f64 = 1e6;

/// Checked options of a solve. Made by [`DeformOptions::check`].
#[derive(Debug, Clone, PartialEq)]
pub struct DeformOptions {
    /// Relative residual to reach, when asked for.
    pub tolerance: Option<f64>,
    /// Largest missing displacement as a fraction of the diagonal, when asked for.
    pub max_error: Option<f64>,
    /// How often rotations are fitted after the second pass; `None`: [`COMMIT_REFINE`] on commit, not at all in a drag.
    pub refine: Option<u32>,
    /// What the neighbours weigh in such a fit.
    pub rotation_smoothing: f64,
    /// How rotations are spread from the handles.
    pub first_pass: FirstPass,
    /// Whether space is deformed instead of the graph.
    pub spatial_rbf: bool,
    /// Milliseconds after which the best result so far is taken; the caller's watch enforces it.
    pub budget_ms: Option<f64>,
    /// Whether intermediate results are wanted.
    pub progressive: bool,
    /// What frames carry.
    pub output: pb::Output,
    /// Unacknowledged frames in flight.
    pub window: u32,
}

impl DeformOptions {
    /// Checks `options`; wrong values are [`Error::Invalid`] with the field's path below `prefix` (such as `options`).
    pub fn check(options: &pb::Options, prefix: &str, max_window: u32) -> Result<Self, Error> {
        let at = |name: &str| format!("{prefix}.{name}");
        let max_error = optional_within(options.max_error, 1e-9, 1.0, &at("maxError"))?;
        let tolerance = optional_within(options.tolerance, 1e-12, 1.0, &at("tolerance"))?;
        let budget_ms = optional_within(options.budget_ms, 1e-3, 3.6e6, &at("budgetMs"))?;
        number(options.rotation_smoothing, &at("rotationSmoothing"))?;
        if options.rotation_smoothing < 0.0 {
            let problem = format!("is {}, it must not be negative", options.rotation_smoothing);
            return Err(Error::invalid(at("rotationSmoothing"), problem));
        }
        let first_pass: pb::options::FirstPass = enumerated(options.first_pass, &at("firstPass"))?;
        let method: pb::options::Method = enumerated(options.method, &at("method"))?;
        if let Some(seen) = options.refine.filter(|n| *n > MOST_REFINE) {
            return Err(Error::invalid(
                at("refine"),
                format!("is {seen}, allowed are 0 to {MOST_REFINE}"),
            ));
        }
        if options.rotation_smoothing > MOST_SMOOTHING {
            let problem = format!("is {}, allowed are 0 to {MOST_SMOOTHING}", options.rotation_smoothing);
            return Err(Error::invalid(at("rotationSmoothing"), problem));
        }
        if options.window > max_window {
            let problem = format!("is {}, allowed are 1 to {max_window}, or 0 for 2", options.window);
            return Err(Error::invalid(at("window"), problem));
        }
        let output = options.output.unwrap_or_default();
        let _: pb::frame::Encoding = enumerated(output.encoding, &at("output.encoding"))?;
        if let Some(threshold) = output.changed_only.filter(|t| !(0.0..=1.0).contains(t)) {
            let problem = format!("is {threshold}, allowed are 0 to 1 (fraction of the diagonal)");
            return Err(Error::invalid(at("output.changedOnly"), problem));
        }
        Ok(Self {
            tolerance: if tolerance.is_none() && max_error.is_none() {
                Some(1e-4)
            } else {
                tolerance
            },
            max_error,
            refine: options.refine,
            rotation_smoothing: options.rotation_smoothing,
            first_pass: match first_pass {
                pb::options::FirstPass::Harmonic => FirstPass::Harmonic,
                pb::options::FirstPass::Diffusion => FirstPass::Diffusion,
                pb::options::FirstPass::LinearFrames => FirstPass::LinearFrames,
            },
            spatial_rbf: method == pb::options::Method::SpatialRbf,
            budget_ms,
            progressive: options.progressive,
            output,
            window: if options.window == 0 {
                2.min(max_window.max(1))
            } else {
                options.window
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_poses_are_refused_with_their_field() {
        let refused = |pose: pb::HandlePose, field: &str| match transform(&pose, DVec3::ZERO, "p") {
            Err(Error::Invalid { field: f, .. }) => assert_eq!(f, field),
            other => panic!("{field}: {other:?}"),
        };
        let pose = pb::HandlePose::default;
        refused(
            pb::HandlePose {
                translation: vec![1.0],
                ..pose()
            },
            "p.translation",
        );
        refused(
            pb::HandlePose {
                translation: vec![1.0, f64::NAN, 0.0],
                ..pose()
            },
            "p.translation[1]",
        );
        refused(
            pb::HandlePose {
                rotation: vec![0.0, 0.0, 0.0, 2.0],
                ..pose()
            },
            "p.rotation",
        );
        refused(
            pb::HandlePose {
                rotation: vec![f64::NAN, 0.0, 0.0, 1.0],
                ..pose()
            },
            "p.rotation",
        );
        refused(
            pb::HandlePose {
                scale: vec![1.0, 2.0],
                ..pose()
            },
            "p.scale",
        );
        refused(
            pb::HandlePose {
                scale: vec![0.0],
                ..pose()
            },
            "p.scale",
        );
        refused(
            pb::HandlePose {
                scale: vec![1.0, -1.0, 1.0],
                ..pose()
            },
            "p.scale[1]",
        );
        let both = pb::HandlePose {
            rotation: vec![0., 0., 0., 1.],
            rotation_vector: vec![0., 0., 0.],
            ..pose()
        };
        refused(both, "p");
    }

    #[test]
    fn first_passes_and_methods_are_taken_as_named() {
        let check = |options: &pb::Options| DeformOptions::check(options, "options", 8);
        let options = pb::Options::default;
        for (first_pass, expected) in [
            (pb::options::FirstPass::Harmonic, FirstPass::Harmonic),
            (pb::options::FirstPass::Diffusion, FirstPass::Diffusion),
            (pb::options::FirstPass::LinearFrames, FirstPass::LinearFrames),
        ] {
            let first_pass = first_pass as i32;
            let settings = check(&pb::Options {
                first_pass,
                ..options()
            })
            .expect("valid");
            assert_eq!((settings.first_pass, settings.spatial_rbf), (expected, false));
        }
        assert!(
            check(&pb::Options { method: 1, ..options() })
                .expect("valid")
                .spatial_rbf
        );
        for (wrong, field) in [
            (pb::Options { method: 7, ..options() }, "options.method"),
            (
                pb::Options {
                    first_pass: -1,
                    ..options()
                },
                "options.firstPass",
            ),
        ] {
            assert!(matches!(check(&wrong), Err(Error::Invalid { field: f, .. }) if f == field));
        }
    }

    #[test]
    fn what_is_not_given_has_its_default() {
        let check = |options: &pb::Options| DeformOptions::check(options, "options", 8).expect("valid");
        let fine = check(&pb::Options {
            refine: Some(0),
            ..Default::default()
        });
        assert_eq!((fine.tolerance, fine.window), (Some(1e-4), 2));
        let by_error = check(&pb::Options {
            max_error: 1e-3,
            ..Default::default()
        });
        assert_eq!((by_error.tolerance, by_error.max_error), (None, Some(1e-3)));
    }
}
