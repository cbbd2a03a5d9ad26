//! How a clip drives a session's model, and the summary of the frames.

use super::check::{enumerated, number, optional_within};
use super::frames::FrameOutput;
use super::options::DeformOptions;
use super::rig::motion_rig;
use super::{Error, json, pb};
use bytes::Bytes;
use pb::animate_options::{PlayedAs, Root, SkipFirst, Source};
use pb::animation_report::foot::Contact as FootContact;
use pb::animation_report::{Foot, HeldNodes, Totals};
use pliant_core::engine::{
    ANIMATION_QUALITY, ClipRequest, ClipSource, Contact, FootFacts, FrameChoice, FrameSums, PlayedForm, Quality,
    RigHandleFacts,
};
use pliant_motion::rig::MotionRig;
use serde_json::Value;
use std::collections::BTreeMap;

/// Most fits of rotations in one frame.
const MOST_REFINE: u32 = 32;
/// Morph targets of a GLB: how many may be asked for, and how many there are otherwise.
const TARGETS: std::ops::RangeInclusive<usize> = 2..=4096;
const USUAL_TARGETS: usize = 64;
/// Bones of a GLB that is a skin: how many may be asked for, and how many there are otherwise.
const BONES: std::ops::RangeInclusive<usize> = 1..=256;
const USUAL_BONES: usize = 40;

/// Where the motion of the root bone goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RootMotion {
    /// Beside the positions.
    Apart,
    /// Into the positions.
    Baked,
    /// Nowhere.
    Dropped,
}

/// How a clip drives a model, and how its frames are sent. Made by [`animate_order`].
#[derive(Debug, Clone)]
pub struct AnimateOrder {
    /// The clip, its rig and its frames.
    pub request: ClipRequest,
    /// Bytes of a BVH file that are still to come, in place of those in the request.
    pub bvh_size: Option<u64>,
    /// Where the motion of the root bone goes.
    pub root: RootMotion,
    /// What frames carry.
    pub output: FrameOutput,
    /// Unacknowledged frames in flight.
    pub window: u32,
    /// How a GLB holds frames.
    pub played: PlayedForm,
}

/// Reads options from JSON, where the rig may be written in its short forms.
///
/// # Errors
/// [`Error::Malformed`] with the field.
pub fn animate_options_from_json(text: &[u8]) -> Result<pb::AnimateOptions, Error> {
    // Bytes that are not JSON are refused by the reader that names the place.
    match serde_json::from_slice::<Value>(text) {
        Ok(mut value) => {
            if let Some(rig) = value.get_mut("rig") {
                super::rig::spell_out(rig);
            }
            json::from_json(value.to_string().as_bytes())
        }
        Err(_) => json::from_json(text),
    }
}

/// Reads how a clip drives a model; `max_window` frames may be in flight, and a clip may have `clip_bytes`.
///
/// # Errors
/// [`Error::Invalid`] with the field, [`Error::TooLarge`] for an announced clip.
pub fn animate_order(options: &pb::AnimateOptions, max_window: u32, clip_bytes: u64) -> Result<AnimateOrder, Error> {
    let bvh = |bytes: &Bytes| ClipSource::Bvh {
        name: String::new(),
        bytes: bytes.clone(),
    };
    let (clip, size) = match &options.source {
        // The model's first clip.
        None => (ClipSource::OfModel("0".into()), 0),
        Some(Source::Clip(name)) => (ClipSource::OfModel(name.clone()), 0),
        Some(Source::Bvh(bytes)) => (bvh(bytes), bytes.len() as u64),
        Some(Source::BvhSize(size)) => (bvh(&Bytes::new()), *size),
    };
    let bvh_size = matches!(options.source, Some(Source::BvhSize(_))).then_some(size);
    if size > clip_bytes {
        return Err(Error::TooLarge {
            what: "the size of the clip in bytes",
            seen: size,
            limit: clip_bytes,
        });
    }
    let rig = options.rig.as_ref().map(motion_rig).transpose();
    let stream = pb::Options {
        output: options.output,
        window: options.window,
        ..Default::default()
    };
    let stream =
        DeformOptions::check(&stream, "", max_window).map_err(|e| renamed(e, |f| f.trim_matches('.').into()))?;
    let request = ClipRequest {
        clip,
        rig: rig.map_err(of_rig)?,
        frames: frame_choice(options)?,
        scale: optional_within(
            options.scale,
            *MotionRig::SCALES.start(),
            *MotionRig::SCALES.end(),
            "scale",
        )?,
        plant_feet: options.plant_feet,
        quality: quality(options)?,
        counts_crossings: stream.output.self_intersections || contact(options)? != Contact::Ignored,
        contact: contact(options)?,
    };
    Ok(AnimateOrder {
        request,
        bvh_size,
        root: match enumerated::<Root>(options.root, "root")? {
            Root::Node => RootMotion::Apart,
            Root::Baked => RootMotion::Baked,
            Root::None => RootMotion::Dropped,
        },
        output: stream.output,
        window: stream.window,
        played: played_form(options)?,
    })
}

/// What frames do about surfaces that cross.
fn contact(options: &pb::AnimateOptions) -> Result<Contact, Error> {
    Ok(match enumerated::<pb::options::Contact>(options.contact, "contact")? {
        pb::options::Contact::Ignore => Contact::Ignored,
        pb::options::Contact::Avoid => Contact::Avoided { clearance: None },
    })
}

/// Which frames are wanted.
fn frame_choice(options: &pb::AnimateOptions) -> Result<FrameChoice, Error> {
    let skip_first = match enumerated::<SkipFirst>(options.skip_first, "skipFirst")? {
        SkipFirst::Auto => None,
        SkipFirst::Yes => Some(true),
        SkipFirst::No => Some(false),
    };
    number(options.fps, "fps")?;
    if !(0.0..=FrameChoice::FASTEST).contains(&options.fps) {
        let (seen, fastest) = (options.fps, FrameChoice::FASTEST);
        let problem = format!("is {seen}, allowed are numbers above 0 and up to {fastest}, or 0 for the clip's own");
        return Err(Error::invalid("fps", problem));
    }
    Ok(FrameChoice {
        fps: (options.fps > 0.0).then_some(options.fps),
        skip_first,
        first: options.first as usize,
        count: (options.count > 0).then_some(options.count as usize),
    })
}

/// How exactly frames are solved.
fn quality(options: &pb::AnimateOptions) -> Result<Quality, Error> {
    if let Some(steps) = options.refine.filter(|steps| *steps > MOST_REFINE) {
        let problem = format!("is {steps}, allowed are 0 to {MOST_REFINE}; absent is carried");
        return Err(Error::invalid("refine", problem));
    }
    let usual = Quality {
        refine: options.refine,
        ..ANIMATION_QUALITY
    };
    Ok(match optional_within(options.tolerance, 1e-12, 1.0, "tolerance")? {
        None => usual,
        tolerance => Quality {
            tolerance,
            max_error: None,
            ..usual
        },
    })
}

/// How a GLB holds frames.
fn played_form(options: &pb::AnimateOptions) -> Result<PlayedForm, Error> {
    let chosen = |seen: u32, allowed: &std::ops::RangeInclusive<usize>, usual: usize, field: &str| match seen as usize {
        0 => Ok(usual),
        count if allowed.contains(&count) => Ok(count),
        count => {
            let (low, high) = (allowed.start(), allowed.end());
            let problem = format!("is {count}, allowed are {low} to {high}, or 0 for {usual}");
            Err(Error::invalid(field, problem))
        }
    };
    let targets = chosen(options.max_targets, &TARGETS, USUAL_TARGETS, "maxTargets")?;
    let bones = chosen(options.bones, &BONES, USUAL_BONES, "bones")?;
    Ok(match enumerated::<PlayedAs>(options.played_as, "as")? {
        PlayedAs::Morph => PlayedForm::Morphs(targets),
        PlayedAs::Skin => PlayedForm::Bones(bones),
    })
}

/// An error of a rig, with its field of the options.
pub fn of_rig(error: Error) -> Error {
    renamed(error, |field| match field {
        "rig" | "clip" | "first" | "plantFeet" => field.into(),
        _ => format!("rig.{field}"),
    })
}

fn renamed(error: Error, name: impl Fn(&str) -> String) -> Error {
    match error {
        Error::Invalid { field, problem } => Error::Invalid {
            field: name(&field),
            problem,
        },
        other => other,
    }
}

/// The summary of an animation after its last frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AnimationSummary {
    /// Sums over the frames.
    pub sums: FrameSums,
    /// Milliseconds from the first to the last.
    pub ms: f64,
    /// What the handles of the rig came to hold.
    pub handles: Vec<RigHandleFacts>,
    /// What planted feet do.
    pub feet: Vec<FootFacts>,
    /// What was noticed, one line each.
    pub warnings: Vec<String>,
    /// Model units for one unit of the clip.
    pub scale: f64,
    /// Milliseconds by stage before the first frame.
    pub build_ms: BTreeMap<String, f64>,
}

/// The message of a stage before the first frame.
pub fn stage_frame(stage: &str, fraction: f64) -> pb::Frame {
    let animated = pb::Animated {
        stage: stage.into(),
        fraction,
        ..Default::default()
    };
    pb::Frame {
        animated: Some(animated),
        ..Default::default()
    }
}

/// The message after all frames; `seq` is that of the last one.
pub fn summary_frame(summary: &AnimationSummary, seq: u64) -> pb::Frame {
    let report = pb::AnimationReport {
        totals: Some(animation_totals(&summary.sums, summary.ms)),
        handles: held_nodes_message(&summary.handles),
        feet: feet_message(&summary.feet),
        warnings: summary.warnings.clone(),
        scale: summary.scale,
        build_ms: summary.build_ms.clone(),
        ..Default::default()
    };
    let animated = pb::Animated {
        report: Some(report),
        ..Default::default()
    };
    pb::Frame {
        seq,
        r#final: true,
        animated: Some(animated),
        ..Default::default()
    }
}

/// Writes sums over frames that took so many milliseconds together.
pub fn animation_totals(sums: &FrameSums, ms: f64) -> Totals {
    let narrow = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    Totals {
        frames: narrow(sums.frames),
        ms,
        frames_per_second: if ms > 0.0 { 1e3 * sums.frames as f64 / ms } else { 0.0 },
        volume_change_mean: sums.volume_change_mean(),
        volume_change_worst: sums.volume_change_worst,
        flipped_triangles_mean: sums.flipped_triangles_mean(),
        flipped_triangles_worst: sums.flipped_triangles_worst,
        max_stretch: sums.max_stretch,
        edge_rms_mean: sums.edge_rms_mean(),
        new_self_intersections_mean: sums.new_self_intersections_mean(),
        new_self_intersections_worst: sums.new_self_intersections_worst,
        crossing_frames: sums.crossing_frames.map(narrow),
        worst_crossing_frame: sums.worst_crossing_frame.map(narrow),
    }
}

/// Writes what the handles of a rig came to hold.
pub fn held_nodes_message(handles: &[RigHandleFacts]) -> Vec<HeldNodes> {
    let message = |held: &RigHandleFacts| HeldNodes {
        name: held.name.clone(),
        nodes: u32::try_from(held.nodes).unwrap_or(u32::MAX),
        widened: held.widened,
    };
    handles.iter().map(message).collect()
}

/// Writes what planted feet do.
pub fn feet_message(feet: &[FootFacts]) -> Vec<Foot> {
    let message = |foot: &FootFacts| Foot {
        bone: foot.bone.clone(),
        contacts: foot
            .contacts
            .iter()
            .map(|&[from, to]| FootContact { from, to })
            .collect(),
        planted_frames: u32::try_from(foot.planted).unwrap_or(u32::MAX),
        drift_before: foot.drift[0],
        drift_after: foot.drift[1],
    };
    feet.iter().map(message).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(options: pb::AnimateOptions) -> String {
        animate_order(&options, 8, 100).expect_err("refused").to_string()
    }

    #[test]
    fn what_is_not_given_has_its_default() {
        let order = animate_order(&pb::AnimateOptions::default(), 8, 100).expect("all defaults");
        let request = &order.request;
        assert_eq!(request.clip, ClipSource::OfModel("0".into()));
        assert_eq!((&request.frames, request.scale), (&FrameChoice::default(), None));
        assert_eq!(
            (request.quality, request.contact),
            (ANIMATION_QUALITY, Contact::Ignored)
        );
        assert_eq!((order.root, order.window), (RootMotion::Apart, 2));
        assert_eq!(order.played, PlayedForm::Morphs(64));
    }

    #[test]
    fn wrong_values_are_refused_with_field_and_what_is_allowed() {
        let options = pb::AnimateOptions::default;
        let rig = pb::Rig {
            version: 7,
            ..Default::default()
        };
        for (wrong, reported) in [
            (pb::AnimateOptions { fps: -1.0, ..options() }, "fps: is -1, "),
            (
                pb::AnimateOptions {
                    fps: f64::NAN,
                    ..options()
                },
                "fps: is NaN",
            ),
            (
                pb::AnimateOptions {
                    scale: -2.0,
                    ..options()
                },
                "scale: is -2",
            ),
            (
                pb::AnimateOptions {
                    scale: 1e20,
                    ..options()
                },
                "scale: is 1e20, allowed are 1e-12 to 1e12, or 0",
            ),
            (
                pb::AnimateOptions {
                    refine: Some(33),
                    ..options()
                },
                "refine: is 33, allowed are 0 to 32",
            ),
            (
                pb::AnimateOptions {
                    tolerance: 2.0,
                    ..options()
                },
                "tolerance: is 2",
            ),
            (
                pb::AnimateOptions { window: 9, ..options() },
                "window: is 9, allowed are 1 to 8",
            ),
            (pb::AnimateOptions { root: 5, ..options() }, "root: is 5"),
            (
                pb::AnimateOptions {
                    contact: 5,
                    ..options()
                },
                "contact: is 5",
            ),
            (
                pb::AnimateOptions {
                    skip_first: 5,
                    ..options()
                },
                "skipFirst: is 5",
            ),
            (
                pb::AnimateOptions {
                    played_as: 5,
                    ..options()
                },
                "as: is 5",
            ),
            (
                pb::AnimateOptions {
                    max_targets: 1,
                    ..options()
                },
                "maxTargets: is 1, allowed are 2 to 4096",
            ),
            (
                pb::AnimateOptions {
                    bones: 300,
                    ..options()
                },
                "bones: is 300, allowed are 1 to 256",
            ),
            (
                pb::AnimateOptions {
                    rig: Some(rig),
                    ..options()
                },
                "rig.version: is 7",
            ),
            (
                pb::AnimateOptions {
                    source: Some(Source::BvhSize(101)),
                    ..options()
                },
                "the size of the clip in bytes is 101, at most 100 is allowed",
            ),
        ] {
            let seen = refused(wrong);
            assert!(seen.starts_with(reported), "{seen:?} is not {reported:?}");
        }
    }

    #[test]
    fn rigs_in_json_have_their_short_forms() {
        let text = br#"{"as": "SKIN", "rig": {"version": 1, "joints": {"a": [0, 1, 2]}, "reference": {"frame": 3}}}"#;
        let options = animate_options_from_json(text).expect("reads");
        let rig = options.rig.clone().expect("a rig");
        assert_eq!(
            (rig.joints["a"].at.as_slice(), rig.reference_frame),
            (&[0.0, 1.0, 2.0][..], Some(3))
        );
        assert_eq!(options.played_as(), PlayedAs::Skin);
        let wrong = animate_options_from_json(b"{\"rig\": 5}")
            .expect_err("no rig")
            .to_string();
        assert!(wrong.starts_with("rig: "), "{wrong}");
    }
}
