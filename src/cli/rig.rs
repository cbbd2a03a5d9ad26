//! `pliant rig`: where the bones of a model lie, and which joints of a clip turn them.
//!
//! `pliant skin`: a model bound to the bones of a rig, as a glTF that any engine poses.

use super::input_files::{in_file, open_model, read_file};
use super::output_files::{OutputPermission, check_ending, spare_companions};
use super::terminal::{CliFailure, ComputeArgs, pretty_text, print_value, say};
use crate::asset::{CarryingJoints, Model, SkinnedClip};
use crate::engine::{MadeRig, RigOrder, bind_model, carrying_joints, left_out_of_rig, left_out_primitives, make_rig};
use crate::exec::Exec;
use crate::motion::SignedAxis;
use crate::motion::bvh::{ClipLimits, read_bvh};
use crate::motion::humanoid::{BODY_JOINTS, BodyAxes};
use crate::motion::rig::ReferencePose;
use crate::pool::Pool;
use crate::render::{BoneMarks, Camera, Picture, PictureSize, ShadedSurface, UpAxis, ViewDirection, draw_surface};
use crate::wire;
use crate::wire::Error;
use clap::Args;
use glam::DVec3;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Pixels of each of the two views.
const VIEW: (u32, u32) = (640, 800);

/// Arguments of `pliant rig`.
#[derive(Debug, Args)]
pub struct RigArgs {
    /// Model file: glb (or vrm), gltf, obj, ply, off, stl, 3mf, fbx, splat or spz
    model: PathBuf,
    /// Clip that will drive the model, a BVH file; its joint names select the bones
    #[arg(long, conflicts_with = "preset")]
    bvh: Option<PathBuf>,
    /// Joint names of the clips, if you have no clip yet: cmu or mixamo
    #[arg(long)]
    preset: Option<String>,
    /// Position of a joint in the model; repeatable
    #[arg(long, value_name = "NAME=X,Y,Z", allow_hyphen_values = true)]
    at: Vec<String>,
    /// JSON file of joint positions, {"lElbow": [x, y, z], …}, or a rig with these joint names
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    /// Vertical of the model, from feet to head [default: the axis that fits best]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true, value_parser = SignedAxis::NAMES)]
    up: Option<String>,
    /// Axis that the figure faces, another one than that of --up [default: the axis that fits best]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true, value_parser = SignedAxis::NAMES)]
    front: Option<String>,
    /// Output file of the rig (.json)
    #[arg(short, long, value_name = "RIG")]
    output: PathBuf,
    /// Output picture of the joints (.png) [default: beside the rig]
    #[arg(long, value_name = "PICTURE", conflicts_with = "no_picture")]
    picture: Option<PathBuf>,
    /// Write no picture
    #[arg(long)]
    no_picture: bool,
    #[command(flatten)]
    permission: OutputPermission,
    /// Print a report as JSON on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    compute: ComputeArgs,
}

pub(super) fn run_rig(args: &RigArgs) -> Result<(), CliFailure> {
    let beside = args.output.with_extension("png");
    let picture = (!args.no_picture).then(|| args.picture.clone().unwrap_or(beside));
    for (path, ending, what) in [
        (Some(&args.output), "json", "a rig"),
        (picture.as_ref(), "png", "a picture"),
    ] {
        let Some(path) = path else { continue };
        check_ending(path, ending, what)?;
        args.permission.check_target(path)?;
    }
    let landmarks = args.joints()?;
    let [up, front] = [&args.up, &args.front].map(|name| name.as_deref().and_then(SignedAxis::named));
    if let (Some(up), Some(front)) = (up, front)
        && up.direction().dot(front.direction()) != 0.0
    {
        let problem = format!(
            "--front: is {}, the axis of --up; a figure faces along another one",
            front.name()
        );
        return Err(CliFailure::Input(problem));
    }
    let clip = args
        .bvh
        .as_ref()
        .map(|path| read_bvh(&read_file(path)?, &ClipLimits::default()).map_err(|e| in_file(path, e)));
    let clip = clip.transpose()?;
    let pool = args.compute.threads.start_pool()?;
    let model = open_model(&args.model)?;
    for path in [Some(&args.output), picture.as_ref()].into_iter().flatten() {
        spare_companions(path, &args.model, &model.files)?;
    }
    let spinner = args.compute.show_stages(args.json);
    let order = RigOrder {
        clip: clip.as_ref(),
        preset: args.preset.as_deref(),
        landmarks,
        up,
        front,
    };
    let mut made = make_rig(&model, &order, &Exec::new(&pool, &spinner))?;
    made.warnings.extend(left_out_of_rig(&model)?);
    spinner.finish();
    let names: Vec<(&str, DVec3)> = made.joints.iter().map(|j| (j.name.as_str(), j.at)).collect();
    let of = args.model.file_name().unwrap_or_default().to_string_lossy();
    let text = pretty_text(&wire::json::to_json(&wire::rig_message(&made.rig, &names, &of))?)?;
    let drawn = picture.as_ref().map(|_| draw_rig(&model, &made, &pool)).transpose()?;
    if let (Some(path), Some(drawn)) = (&picture, drawn) {
        args.permission.write_file(path, &drawn)?;
    }
    if let Err(error) = made.check() {
        let shown = picture.map_or_else(String::new, |path| format!("; {} shows them in red", path.display()));
        return Err(CliFailure::Input(format!("{error}{shown}")));
    }
    args.permission.write_file(&args.output, text.as_bytes())?;
    if args.json {
        return print_value(&report(&made, &args.output, picture.as_deref()));
    }
    for warning in &made.warnings {
        say!("warning: {warning}");
    }
    for joint in &made.joints {
        let [x, y, z] = joint.at.to_array();
        let place = if joint.inside { "inside" } else { "outside" };
        let moved = if joint.moved > 0.0 {
            format!(", moved {:.4}", joint.moved)
        } else {
            String::new()
        };
        let score = joint.score;
        say!("{:<12} {x:9.4} {y:9.4} {z:9.4}  {score:.2} {place}{moved}", joint.name);
    }
    let shown = picture.map_or_else(String::new, |p| format!(", drawn in {}", p.display()));
    say!(
        "{} -> {}: {} bones, joints by {}{shown}",
        args.model.display(),
        args.output.display(),
        made.rig.bones.len(),
        made.source
    );
    Ok(())
}

fn report(made: &MadeRig, output: &Path, picture: Option<&Path>) -> Value {
    let joints = made.joints.iter().map(|joint| {
        let mut value = json!({
            "name": joint.name,
            "at": joint.at.to_array(),
            "inside": joint.inside,
            "moved": joint.moved,
            "score": joint.score,
        });
        if !joint.reason.is_empty() {
            value["reason"] = joint.reason.as_str().into();
        }
        value
    });
    let bones = made
        .rig
        .bones
        .iter()
        .map(|bone| json!({"id": bone.id, "joint": bone.joint, "radius": bone.radius}));
    let mut report = json!({
        "source": made.source,
        "score": made.score(),
        "joints": joints.collect::<Vec<_>>(),
        "bones": bones.collect::<Vec<_>>(),
        "warnings": made.warnings,
        "output": output.display().to_string(),
    });
    if let Some(axes) = made.axes {
        report["up"] = axes.up.name().into();
        report["front"] = axes.front.name().into();
    }
    if let ReferencePose::Frame(frame) = made.rig.reference {
        report["referenceFrame"] = frame.into();
    }
    if let Some(picture) = picture {
        report["picture"] = picture.display().to_string().into();
    }
    report
}

/// The model as glass with the bones in it, from the front and from the side.
fn draw_rig(model: &Model, made: &MadeRig, pool: &Pool) -> Result<Vec<u8>, CliFailure> {
    let left_out = left_out_primitives(model)?;
    let mut is_drawn = vec![true; model.positions.len()];
    for primitive in left_out.iter().filter_map(|p| model.primitives.get(*p)) {
        is_drawn[primitive.vertices()].fill(false);
    }
    let triangles: Vec<[u32; 3]> = (model.triangles.iter().copied())
        .filter(|[corner, ..]| is_drawn[*corner as usize])
        .collect();
    // Pictures have y up and are seen from the front.
    let turn = made.axes.unwrap_or(BodyAxes::USUAL).upright_from_model();
    let positions: Vec<DVec3> = model.positions.iter().map(|p| turn * *p).collect();
    let surface = ShadedSurface::new(&positions, &triangles, pool)?;
    let views = [
        ViewDirection::new(0.0, 0.0, UpAxis::Y)?,
        ViewDirection::new(90.0, 0.0, UpAxis::Y)?,
    ];
    let size = PictureSize::new(VIEW.0, VIEW.1)?;
    let marks = BoneMarks {
        bones: (made.rig.bones.iter())
            .map(|bone| [turn * bone.from, turn * bone.to])
            .collect(),
        joints: (made.joints.iter())
            .map(|joint| (turn * joint.at, !MadeRig::is_doubtful(joint)))
            .collect(),
    };
    let mut sheet = Picture::new(u64::from(2 * VIEW.0), u64::from(VIEW.1), [255; 3])?;
    for (k, camera) in (0u32..).zip(&Camera::around_surfaces(&[&surface], &views, size)) {
        let mut picture = draw_surface(&surface, camera, pool);
        marks.draw_on(&mut picture, camera);
        sheet.paste_picture(&picture, k * VIEW.0, 0);
    }
    Ok(sheet.encode_png()?)
}

impl RigArgs {
    /// The joints that are given.
    fn joints(&self) -> Result<BTreeMap<&'static str, DVec3>, CliFailure> {
        let mut joints = BTreeMap::new();
        let mut add = |name: &str, numbers: Option<Vec<f64>>, from: &str| {
            let place = numbers
                .and_then(|n| <[f64; 3]>::try_from(n).ok())
                .map(DVec3::from_array);
            let Some(known) = BODY_JOINTS.iter().find(|n| **n == name) else {
                let allowed = BODY_JOINTS.join(", ");
                return Err(CliFailure::Input(format!(
                    "{from}: \"{name}\" is not a joint of a body; there are {allowed}"
                )));
            };
            let Some(place) = place.filter(|p| p.is_finite()) else {
                return Err(CliFailure::Input(format!(
                    "{from}: \"{name}\" needs three finite numbers, x, y and z"
                )));
            };
            joints.insert(*known, place);
            Ok(())
        };
        if let Some(path) = &self.landmarks {
            let reported = path.display().to_string();
            let value: Value =
                serde_json::from_slice(&read_file(path)?).map_err(|e| CliFailure::Input(format!("{reported}: {e}")))?;
            let is_rig = value.get("joints").is_some();
            let Some(entries) = value.get("joints").unwrap_or(&value).as_object() else {
                return Err(CliFailure::Input(format!(
                    "{reported}: an object of joints by name is needed"
                )));
            };
            for (name, place) in entries {
                if is_rig && !BODY_JOINTS.contains(&name.as_str()) {
                    continue;
                }
                let numbers = place.get("at").unwrap_or(place).as_array();
                add(
                    name,
                    numbers.and_then(|n| n.iter().map(Value::as_f64).collect()),
                    &reported,
                )?;
            }
        }
        for text in &self.at {
            let (name, place) = text.split_once('=').unwrap_or((text, ""));
            add(
                name.trim(),
                place.split(',').map(|n| n.trim().parse().ok()).collect(),
                "--at",
            )?;
        }
        Ok(joints)
    }
}

/// Arguments of `pliant skin`.
#[derive(Debug, Args)]
pub struct SkinArgs {
    /// Model file: glb (or vrm), gltf, obj, ply, off, stl, 3mf, fbx, splat or spz
    model: PathBuf,
    /// Rig file of `pliant rig`
    #[arg(long)]
    rig: PathBuf,
    /// Output file of the skinned model (.glb)
    #[arg(short, long, value_name = "MODEL")]
    output: PathBuf,
    #[command(flatten)]
    permission: OutputPermission,
    /// Maximum bone influences per vertex, 1 to 8; many engines take 4
    #[arg(long, value_name = "COUNT", default_value_t = 4)]
    influences: usize,
    /// Print a report as JSON on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    compute: ComputeArgs,
}

pub(super) fn run_skin(args: &SkinArgs) -> Result<(), CliFailure> {
    check_ending(&args.output, "glb", "a skinned model")?;
    args.permission.check_target(&args.output)?;
    let pool = args.compute.threads.start_pool()?;
    let rig = wire::rig_from_json(&read_file(&args.rig)?).map_err(|e| in_file(&args.rig, e))?;
    let spinner = args.compute.show_stages(args.json);
    let clock = Instant::now();
    let model = open_model(&args.model)?;
    let bound = bind_model(&model, &rig, args.influences, &Exec::new(&pool, &spinner))?;
    let influences: Vec<CarryingJoints> = bound.influences.iter().map(carrying_joints).collect();
    let written = model.write_skinned_clip(&SkinnedClip {
        name: "",
        influences: &influences,
        joints: &bound.joints,
        times: &[],
        frames: &[],
        root: None,
        correctives: None,
        beside: None,
    });
    let written = written.map_err(Error::from)?;
    spinner.finish();
    args.permission
        .write_model(&args.output, &written, &args.model, &model.files)?;
    let ms = clock.elapsed().as_secs_f64() * 1e3;
    let unweighted = bound
        .influences
        .iter()
        .filter(|own| own.iter().next().is_none())
        .count();
    let most = bound.influences.iter().map(|own| own.iter().count()).max().unwrap_or(0);
    let (vertices, bones) = (influences.len(), bound.joints.len());
    let mut held = vec![0u32; bones];
    bound
        .influences
        .iter()
        .for_each(|own| held[usize::from(own.bones[0])] += 1);
    let idle: Vec<&str> = (bound.joints.iter().zip(&held))
        .filter(|(_, held)| **held == 0)
        .map(|(joint, _)| joint.name.as_str())
        .collect();
    if args.json {
        return print_value(&json!({
            "vertices": vertices,
            "unweighted": unweighted,
            "bones": bones,
            "influences": most,
            "ms": ms,
            "heldByBone": bound.joints.iter().zip(&held).map(|(joint, held)| json!({"bone": joint.name, "vertices": held})).collect::<Vec<_>>(),
            "output": args.output.display().to_string(),
        }));
    }
    if !idle.is_empty() {
        let names = idle.join("\", \"");
        say!("warning: no vertex follows \"{names}\" most");
    }
    say!(
        "{} -> {}: {vertices} vertices on {bones} bones, at most {most} each, {unweighted} without a weight; {ms:.0} ms",
        args.model.display(),
        args.output.display()
    );
    Ok(())
}
