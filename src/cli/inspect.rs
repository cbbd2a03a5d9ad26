//! `pliant inspect`: what the solver sees in a model.

use super::input_files::{in_file, is_bvh, read_file, with_companions};
use super::terminal::{CliFailure, ComputeArgs, print_text, print_value};
use crate::batch::{self, ModelContents};
use crate::engine::DeformerLimits;
use crate::exec::Exec;
use crate::mesh::{brief_number, grouped_count};
use crate::motion::MotionClip;
use crate::motion::bvh::{ClipLimits, read_bvh};
use crate::wire::{json, pb};
use clap::Args;
use glam::DVec3;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Primitives that the text lists.
const NAMED_PRIMITIVES: usize = 32;
/// Clips, skins, materials and images that the text lists, of each.
const NAMED_CONTENTS: usize = 16;
/// Joints of a recording that the text lists.
const NAMED_JOINTS: usize = 40;

/// Arguments of `pliant inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Model file: glb (or vrm), gltf, obj, ply, off, stl, 3mf, fbx, splat or spz; or a recording: bvh
    model: PathBuf,
    /// Print the statistics as JSON on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    compute: ComputeArgs,
}

pub(super) fn run_inspect(args: &InspectArgs) -> Result<(), CliFailure> {
    let pool = args.compute.threads.start_pool()?;
    let main = read_file(&args.model)?;
    if is_bvh(&main) {
        let clip = read_bvh(&main, &ClipLimits::default()).map_err(|e| in_file(&args.model, e))?;
        return if args.json {
            print_value(&clip_facts(&clip, main.len()))
        } else {
            print_text(&describe_clip(&clip, main.len()))
        };
    }
    let files = with_companions(&args.model, main)?;
    let spinner = args.compute.show_stages(args.json);
    let (found, contents) = batch::inspect(
        files,
        &pb::CreateOptions::default(),
        &DeformerLimits::default(),
        &Exec::new(&pool, &spinner),
    )?;
    spinner.finish();
    if args.json {
        let mut value = json::to_json(&found)?;
        let contents = serde_json::to_value(&contents).map_err(|e| CliFailure::Internal(e.to_string()))?;
        if let (Value::Object(all), Value::Object(contents)) = (&mut value, contents) {
            all.extend(contents);
        }
        return print_value(&value);
    }
    let contents = contents.as_ref().map(describe_contents).unwrap_or_default();
    print_text(&describe_inspection(&found, contents))
}

/// The box of a recording's rest pose, in units of the clip.
fn rest_size(clip: &MotionClip) -> DVec3 {
    let places = clip.skeleton.world_transforms(&clip.skeleton.rest_pose());
    let places = || places.iter().map(|place| place.translation);
    places().fold(DVec3::NEG_INFINITY, DVec3::max) - places().fold(DVec3::INFINITY, DVec3::min)
}

/// How far the first joint goes from the beginning to the end, in units of the clip.
fn root_travel(clip: &MotionClip) -> DVec3 {
    let root = |seconds: f64| {
        clip.pose_at(seconds)
            .first()
            .map_or(DVec3::ZERO, |pose| pose.translation)
    };
    root(clip.duration) - root(0.0)
}

/// What a recording holds, for programs.
fn clip_facts(clip: &MotionClip, bytes: usize) -> Value {
    let joints = clip.skeleton.joints.iter();
    json!({"clip": {
        "format": "bvh",
        "bytes": bytes,
        "frames": clip.recorded.map(|r| r.count),
        "frameSeconds": clip.recorded.map(|r| r.interval),
        "seconds": clip.duration,
        "joints": joints.map(|joint| json!({"name": joint.name, "parent": joint.parent})).collect::<Vec<_>>(),
        "restSize": rest_size(clip).to_array(),
        "rootTravel": root_travel(clip).to_array(),
        "warnings": clip.warnings,
    }})
}

/// What a recording holds, for people.
fn describe_clip(clip: &MotionClip, bytes: usize) -> String {
    let count = |n: usize| grouped_count(n as u64);
    let numbers = |v: DVec3, between: &str| v.to_array().map(brief_number).join(between);
    let named: Vec<&str> = (clip.skeleton.joints.iter().map(|joint| joint.name.as_str()))
        .filter(|name| !name.is_empty())
        .collect();
    let shown = named.len().min(NAMED_JOINTS);
    let more = match named.len() - shown {
        0 => String::new(),
        more => format!(" and {more} more, which --json lists"),
    };
    let mut text = String::new();
    let mut line = |name: &str, value: String| text.push_str(&format!("{name:<22}{value}\n"));
    line(
        "format",
        format!("bvh, {} bytes; `pliant animate --bvh` plays it", count(bytes)),
    );
    if let Some(recorded) = clip.recorded {
        let rate = brief_number(1.0 / recorded.interval);
        line("frames", format!("{} at {rate} a second", count(recorded.count)));
    }
    line("seconds", brief_number(clip.duration));
    line(
        "joints",
        format!("{}: {}{more}", named.len(), named[..shown].join(", ")),
    );
    line("size of rest pose", numbers(rest_size(clip), " × "));
    line("root moves by", format!("({})", numbers(root_travel(clip), ", ")));
    clip.warnings
        .iter()
        .for_each(|warning| line("warning", warning.clone()));
    text
}

/// What handles name a primitive by, and its size.
fn describe_primitive(primitive: &pb::Primitive) -> String {
    let name = match primitive.name.as_str() {
        "" => "without a name".into(),
        name => format!("\"{name}\""),
    };
    format!(
        "{name}: {} vertices from {}, {} triangles",
        grouped_count(primitive.vertex_count.into()),
        grouped_count(primitive.first_vertex.into()),
        grouped_count((primitive.index_count / 3).into())
    )
}

/// How many parts nothing joins to others, and the largest of them.
fn describe_loose_parts(solver: &pb::SolverFacts) -> String {
    let reported: Vec<String> = (solver.loose.iter())
        .map(|part| {
            let name = match part.name.as_str() {
                "" => String::new(),
                name => format!(" of \"{name}\""),
            };
            format!("part {}{name} ({} vertices)", part.component, part.vertices)
        })
        .collect();
    let more = (solver.loose_parts as usize).saturating_sub(reported.len());
    match (reported.is_empty(), more) {
        (true, _) => solver.loose_parts.to_string(),
        (false, 0) => format!("{}: {}", solver.loose_parts, reported.join(", ")),
        (false, more) => format!("{}: {} and {more} more", solver.loose_parts, reported.join(", ")),
    }
}

/// What the file holds beside its mesh, by kind of thing.
fn describe_contents(contents: &ModelContents) -> Vec<(&'static str, String)> {
    let clips = contents.clips.iter().map(|clip| match clip.seconds {
        Some(seconds) => format!("{:?} ({} s)", clip.name, brief_number(seconds)),
        None => format!("{:?} (unreadable)", clip.name),
    });
    let skins = contents.skins.iter().map(|skin| {
        let joints = if skin.joints == 1 { "joint" } else { "joints" };
        format!("{:?} ({} {joints})", skin.name, skin.joints)
    });
    let quoted = |names: &[String]| names.iter().map(|name| format!("{name:?}")).collect();
    let lists: [(&'static str, Vec<String>); 4] = [
        ("clips", clips.collect()),
        ("skins", skins.collect()),
        ("materials", quoted(&contents.materials)),
        ("images", quoted(&contents.images)),
    ];
    let reported = lists.into_iter().map(|(name, list)| {
        let shown = list.len().min(NAMED_CONTENTS);
        let more = match list.len() - shown {
            0 => String::new(),
            more => format!(" and {more} more, which --json lists"),
        };
        let colon = if list.is_empty() { "" } else { ": " };
        let reported = list[..shown].join(", ");
        (name, format!("{}{colon}{reported}{more}", list.len()))
    });
    reported.collect()
}

fn describe_inspection(found: &pb::Inspection, contents: Vec<(&str, String)>) -> String {
    let model = found.model.clone().unwrap_or_default();
    let solver = found.solver.clone().unwrap_or_default();
    let count = |n: u32| grouped_count(n.into());
    let levels: Vec<String> = solver.levels.iter().map(|l| count(l.vertices)).collect();
    let yes_no = |b: bool| if b { "yes" } else { "no" };
    let mut text = String::new();
    let mut line = |name: &str, value: String| text.push_str(&format!("{name:<22}{value}\n"));
    line(
        "format",
        format!(
            "{}, {} bytes, sha256 {}",
            model.format,
            grouped_count(model.bytes),
            model.sha256
        ),
    );
    line(
        "render vertices",
        format!(
            "{} in {} {}",
            count(model.vertices),
            grouped_count(found.primitives.len() as u64),
            if found.primitives.len() == 1 {
                "primitive"
            } else {
                "primitives"
            }
        ),
    );
    line("triangles", count(model.triangles));
    let named = found.primitives.iter().take(NAMED_PRIMITIVES).enumerate();
    named.for_each(|(k, primitive)| line(&format!("primitive {k}"), describe_primitive(primitive)));
    if found.primitives.len() > NAMED_PRIMITIVES {
        let more = grouped_count((found.primitives.len() - NAMED_PRIMITIVES) as u64);
        line("", format!("and {more} more, which --json lists"));
    }
    contents.into_iter().for_each(|(name, reported)| line(name, reported));
    line("solver vertices", count(solver.solver_vertices));
    line("seam vertices", count(found.seam_vertices));
    line(
        "graph",
        format!(
            "{} vertices, {} edges",
            count(solver.graph_vertices),
            grouped_count(solver.graph_edges)
        ),
    );
    line("hierarchy", levels.join(" > "));
    line("parts", count(found.components));
    if found.components > 1 {
        line("ties", grouped_count(solver.ties));
        line("loose parts", describe_loose_parts(&solver));
    }
    line("closed", yes_no(found.closed).into());
    line("holes", count(found.boundary_loops));
    line(
        "non-manifold",
        format!(
            "{} edges, {} vertices",
            count(found.non_manifold_edges),
            count(found.non_manifold_vertices)
        ),
    );
    line("degenerate faces", count(found.degenerate_faces));
    line("duplicate faces", count(found.duplicate_faces));
    line("unreferenced", count(found.unreferenced_vertices));
    let corner = |p: &[f64]| p.iter().map(|&x| brief_number(x)).collect::<Vec<_>>().join(", ");
    line(
        "box",
        format!("({}) to ({})", corner(&found.box_min), corner(&found.box_max)),
    );
    line("area", brief_number(found.area));
    // What an open surface encloses depends on where the origin is.
    let volume = match found.closed {
        true => brief_number(found.volume),
        false => "n/a, the surface is open".into(),
    };
    line("volume", volume);
    line(
        "memory estimate",
        format!("{} MiB", grouped_count(found.memory_estimate >> 20)),
    );
    for w in &found.warnings {
        line(&format!("warning {}", w.code), format!(" {}", w.message));
    }
    text
}
