//! Options of a solve or a stream: checked, and split into what the engine takes and what a stream does with frames.

use super::check::{enumerated, number, optional_within};
use super::frames::{FrameEncoding, FrameOutput};
use super::{Error, pb};
use pliant_core::engine::{Contact, Method, Quality, SolveSettings};

/// Most fits of rotations in one solve.
const MOST_REFINE: u32 = 1000;
/// Largest weight of neighbours in such a fit.
const MOST_SMOOTHING: f64 = 1e6;

/// Checked options of a solve or a stream. Made by [`DeformOptions::check`].
#[derive(Debug, Clone, PartialEq)]
pub struct DeformOptions {
    /// How poses are solved.
    pub solve: SolveSettings,
    /// Milliseconds after which the best result so far is taken; the caller's watch enforces it.
    pub budget_ms: Option<f64>,
    /// Whether intermediate results are wanted.
    pub progressive: bool,
    /// Whether poses of a stream are solved from nothing, fits from the coarse levels on, as commits are.
    pub fits_coarse_first: bool,
    /// The commit from whose shape fits go on.
    pub from_revision: Option<u64>,
    /// What frames carry.
    pub output: FrameOutput,
    /// Unacknowledged frames in flight.
    pub window: u32,
}

impl DeformOptions {
    /// Returns the options in force where none are given.
    pub fn with_defaults(max_window: u32) -> Self {
        Self {
            solve: SolveSettings::default(),
            budget_ms: None,
            progressive: false,
            fits_coarse_first: false,
            from_revision: None,
            output: FrameOutput::default(),
            window: 2.min(max_window.max(1)),
        }
    }

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
        let volume: pb::options::Volume = enumerated(options.volume, &at("volume"))?;
        let contact = checked_contact(options, prefix)?;
        let fit: pb::options::Fit = enumerated(options.fit, &at("fit"))?;
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
        let encoding = enumerated(output.encoding, &at("output.encoding"))?;
        if let Some(threshold) = output.changed_only.filter(|t| !(0.0..=1.0).contains(t)) {
            let problem = format!("is {threshold}, allowed are 0 to 1 (fraction of the diagonal)");
            return Err(Error::invalid(at("output.changedOnly"), problem));
        }
        let encoding = FrameEncoding::from_message(encoding);
        if output.changed_only.is_some() && encoding == FrameEncoding::Delta {
            let problem = "stands beside encoding DELTA, in whose frames what has not moved takes next to nothing; allowed are one of \
                           the two, or changedOnly with F32, U16 or MESHOPT";
            return Err(Error::invalid(at("output.changedOnly"), problem));
        }
        if output.changed_only.is_some() && output.gradients {
            let problem = "stands beside changedOnly, which lists vertices by how far they have moved and not by how they have turned; \
                           allowed are one of the two, or gradients with DELTA";
            return Err(Error::invalid(at("output.gradients"), problem));
        }
        let quality = Quality {
            tolerance: if tolerance.is_none() && max_error.is_none() {
                Quality::DEFAULT.tolerance
            } else {
                tolerance
            },
            max_error,
            refine: options.refine,
            smoothing: options.rotation_smoothing,
            keeps_volume: volume == pb::options::Volume::Keep,
        };
        let method = match (method, first_pass) {
            (pb::options::Method::SpatialRbf, _) => Method::SpatialRbf,
            (_, pb::options::FirstPass::Harmonic) => Method::Harmonic,
            (_, pb::options::FirstPass::Diffusion) => Method::Diffusion,
            (_, pb::options::FirstPass::LinearFrames) => Method::LinearFrames,
        };
        Ok(Self {
            solve: SolveSettings {
                method,
                gradients: output.gradients,
                contact,
                ..quality.into()
            },
            budget_ms,
            progressive: options.progressive,
            fits_coarse_first: fit == pb::options::Fit::CoarseFirst,
            from_revision: options.from_revision,
            output: FrameOutput {
                normals: output.normals,
                tangents: output.tangents,
                changed_only: output.changed_only,
                encoding,
                self_intersections: output.self_intersections,
                gradients: output.gradients,
                asked: 0,
            },
            window: if options.window == 0 {
                2.min(max_window.max(1))
            } else {
                options.window
            },
        })
    }
}

/// What is asked for about surfaces that cross.
fn checked_contact(options: &pb::Options, prefix: &str) -> Result<Contact, Error> {
    let contact: pb::options::Contact = enumerated(options.contact, &format!("{prefix}.contact"))?;
    let field = format!("{prefix}.clearance");
    number(options.clearance, &field)?;
    if options.clearance < 0.0 {
        let problem = format!("is {}, it must not be negative", options.clearance);
        return Err(Error::invalid(field, problem));
    }
    match contact {
        pb::options::Contact::Ignore if options.clearance > 0.0 => {
            let problem = "stands without contact AVOID, which alone keeps a distance; allowed is 0 without it";
            Err(Error::invalid(field, problem))
        }
        pb::options::Contact::Ignore => Ok(Contact::Ignored),
        pb::options::Contact::Avoid => Ok(Contact::Avoided {
            clearance: Some(options.clearance).filter(|clearance| *clearance > 0.0),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_passes_and_methods_are_taken_as_named() {
        let check = |options: &pb::Options| DeformOptions::check(options, "options", 8);
        let options = pb::Options::default;
        for (first_pass, expected) in [
            (pb::options::FirstPass::Harmonic, Method::Harmonic),
            (pb::options::FirstPass::Diffusion, Method::Diffusion),
            (pb::options::FirstPass::LinearFrames, Method::LinearFrames),
        ] {
            let first_pass = first_pass as i32;
            for (method, expected) in [(0, expected), (1, Method::SpatialRbf)] {
                let options = pb::Options {
                    first_pass,
                    method,
                    ..options()
                };
                assert_eq!(check(&options).expect("valid").solve.method, expected);
            }
        }
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
        assert_eq!((fine.solve.quality.tolerance, fine.window), (Some(1e-4), 2));
        assert_eq!(check(&pb::Options::default()), DeformOptions::with_defaults(8));
        let by_error = check(&pb::Options {
            max_error: 1e-3,
            ..Default::default()
        });
        assert_eq!(
            (by_error.solve.quality.tolerance, by_error.solve.quality.max_error),
            (None, Some(1e-3))
        );
    }
}
