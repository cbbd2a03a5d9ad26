//! What moves in a scene beside a skin goes on: props, what a hand carries, what stands still, and faces.

use super::{animate, farthest, read_cache, read_glb};
use crate::support::commands::Workplace;
use crate::support::gltf_parsed::Parsed;
use crate::support::khronos;
use crate::support::skinning::{ClipTime, DrawnPrimitive, draw, list};
use base64::Engine as _;
use glam::{DQuat, DVec3, Vec3};
use pliant::asset::shapes;
use std::collections::BTreeMap;

/// Frames a second.
const RATE: f64 = 5.0;

/// A glTF that is put together.
#[derive(Default)]
struct Builder {
    bytes: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Builder {
    fn add(&mut self, bytes: &[u8], rest: &str) -> usize {
        self.views.push(format!(
            r#"{{"buffer":0,"byteOffset":{},"byteLength":{}}}"#,
            self.bytes.len(),
            bytes.len()
        ));
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let view = self.views.len() - 1;
        self.accessors.push(format!(r#"{{"bufferView":{view},{rest}}}"#));
        self.accessors.len() - 1
    }

    fn floats(&mut self, values: &[f32], kind: &str) -> usize {
        let lanes = match kind {
            "SCALAR" => 1,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let bound = |pick: fn(f32, f32) -> f32| {
            let lane = |lane| values.iter().skip(lane).step_by(lanes).copied().reduce(pick);
            let all: Vec<String> = (0..lanes).map(|l| lane(l).expect("values").to_string()).collect();
            all.join(",")
        };
        let bounds = format!(r#""min":[{}],"max":[{}]"#, bound(f32::min), bound(f32::max));
        let count = values.len() / lanes;
        self.add(
            &bytes,
            &format!(r#""componentType":5126,"count":{count},"type":"{kind}",{bounds}"#),
        )
    }

    fn points(&mut self, points: &[Vec3]) -> usize {
        let values: Vec<f32> = points.iter().flat_map(|p| p.to_array()).collect();
        self.floats(&values, "VEC3")
    }

    fn triangles(&mut self, triangles: &[[u32; 3]]) -> usize {
        let bytes: Vec<u8> = triangles.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let count = 3 * triangles.len();
        self.add(
            &bytes,
            &format!(r#""componentType":5125,"count":{count},"type":"SCALAR""#),
        )
    }
}

/// The bar's vertices along x, with how much of each the upper joint holds.
fn bar() -> (Vec<Vec3>, Vec<[u32; 3]>, Vec<f32>) {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [24, 4, 4]);
    let positions: Vec<Vec3> = positions
        .iter()
        .map(|p| (*p - DVec3::new(3.0, 0.5, 0.5)).as_vec3())
        .collect();
    let upper = positions.iter().map(|p| (0.5 + p.x).clamp(0.0, 1.0)).collect();
    (positions, triangles, upper)
}

/// A bar on two joints that bends and walks along; a prop in its hand, by a matrix that shears; a lamp that jumps; a face that
/// smiles along a spline; and a floor. `has_frown`: whether the bar's own morph target is moved, which lifts its end.
pub(super) fn make_scene(folder: &Workplace, has_frown: bool) {
    let mut all = Builder::default();
    let (positions, triangles, upper) = bar();
    let joints: Vec<u8> = upper.iter().flat_map(|_| [0, 1, 0, 0]).collect();
    let weights: Vec<f32> = upper.iter().flat_map(|w| [1.0 - w, *w, 0.0, 0.0]).collect();
    let lifted: Vec<Vec3> = positions
        .iter()
        .map(|p| Vec3::Z * if p.x > 1.5 { 0.25 } else { 0.0 })
        .collect();
    let body = [
        all.points(&positions),
        all.triangles(&triangles),
        all.add(
            &joints,
            &format!(r#""componentType":5121,"count":{},"type":"VEC4""#, upper.len()),
        ),
        all.floats(&weights, "VEC4"),
        all.points(&lifted),
    ];
    let corners = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z].map(|p| p * 0.5 + Vec3::Y * 2.0);
    let small = [
        all.points(&corners),
        all.triangles(&[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    ];
    let smile = [
        all.points(&[Vec3::ZERO, Vec3::X, Vec3::ZERO, Vec3::ZERO]),
        all.points(&[Vec3::Y, Vec3::ZERO, Vec3::Y, Vec3::ZERO]),
    ];
    let times = all.floats(&[0.0, 0.5, 1.1, 2.0], "SCALAR");
    let turns: Vec<f32> = [0.0, 0.6, -0.4, 0.9]
        .iter()
        .flat_map(|a| DQuat::from_rotation_z(*a).as_quat().to_array())
        .collect();
    let turns = all.floats(&turns, "VEC4");
    let walk = all.points(&[Vec3::ZERO, Vec3::X, Vec3::new(2.0, 0.5, 0.0), Vec3::new(4.0, 0.0, 1.0)]);
    let jumps = all.points(&[Vec3::Z, Vec3::X * 3.0, Vec3::Y, Vec3::ONE]);
    let smiles: Vec<f32> = (0..24).map(|i| ((i * 5) % 7) as f32 * 0.2).collect();
    let smiles = all.floats(&smiles, "SCALAR");
    let frowns = all.floats(&[0.0, 1.0, 0.5, 1.0], "SCALAR");
    let frown = r#",{"sampler":4,"target":{"node":0,"path":"weights"}}"#;
    let frown = if has_frown { frown } else { "" };
    let text = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0,1,4,5,6]}}],
        "nodes":[{{"name":"body","mesh":0,"skin":0}},{{"name":"low","children":[2]}},{{"name":"high","children":[3]}},
        {{"name":"prop","mesh":1,"matrix":[1,0,0,0, 0.5,1,0,0, 0,0,1,0, 2.5,0,0,1]}},{{"name":"lamp","mesh":1}},
        {{"name":"face","mesh":2,"translation":[0,3,0]}},{{"name":"floor","mesh":1,"translation":[0,-4,0]}}],
        "skins":[{{"joints":[1,2]}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":{},"JOINTS_0":{},"WEIGHTS_0":{}}},"indices":{},"targets":[{{"POSITION":{}}}]}}]}},
        {{"primitives":[{{"attributes":{{"POSITION":{}}},"indices":{}}}]}},
        {{"primitives":[{{"attributes":{{"POSITION":{}}},"indices":{},"targets":[{{"POSITION":{}}},{{"POSITION":{}}}]}}]}}],
        "animations":[{{"name":"act","channels":[{{"sampler":0,"target":{{"node":2,"path":"rotation"}}}},
        {{"sampler":1,"target":{{"node":1,"path":"translation"}}}},{{"sampler":2,"target":{{"node":4,"path":"translation"}}}},
        {{"sampler":3,"target":{{"node":5,"path":"weights"}}}}{frown}],
        "samplers":[{{"input":{times},"output":{turns}}},{{"input":{times},"output":{walk}}},
        {{"input":{times},"interpolation":"STEP","output":{jumps}}},
        {{"input":{times},"interpolation":"CUBICSPLINE","output":{smiles}}},{{"input":{times},"output":{frowns}}}]}}],
        "accessors":[{}],"bufferViews":[{}],"buffers":[{{"byteLength":{},"uri":"data:application/octet-stream;base64,{}"}}]}}"#,
        body[0],
        body[2],
        body[3],
        body[1],
        body[4],
        small[0],
        small[1],
        small[0],
        small[1],
        smile[0],
        smile[1],
        all.accessors.join(","),
        all.views.join(","),
        all.bytes.len(),
        base64::engine::general_purpose::STANDARD.encode(&all.bytes),
    );
    folder.put("scene.gltf", text);
}

pub(super) fn scene_folder() -> Workplace {
    let folder = Workplace::empty();
    make_scene(&folder, false);
    folder
}

/// Runs the clip of a scene into an output.
fn act(folder: &Workplace, arguments: &[&str]) {
    let clip = ["scene.gltf", "--clip", "act", "--fps", "5", "--refine", "0"];
    animate(folder, &[&clip[..], arguments].concat()).well();
}

/// What a file draws at a time of its last clip, by the name of the node.
fn drawn_by_name(file: &Parsed, seconds: f64) -> BTreeMap<String, Vec<DVec3>> {
    let clip = file.json["animations"].as_array().expect("clips").len() - 1;
    let drawn = draw(file, Some(ClipTime { clip, seconds }), &[]).expect("a plain player draws it");
    let name = |d: &DrawnPrimitive| file.json["nodes"][d.node]["name"].as_str().expect("a name").to_owned();
    drawn.into_iter().map(|d| (name(&d), d.positions)).collect()
}

const BESIDE: [&str; 4] = ["prop", "lamp", "face", "floor"];

#[test]
fn what_has_no_skin_goes_on_in_step_in_every_output() {
    let folder = &scene_folder();
    let source = read_glb(&folder.join("scene.gltf"));
    let bar = bar().0.len();
    for (first, count) in [(0, 11), (3, 5), (6, 1)] {
        let frames = format!("{first}:{count}");
        act(folder, &["--frames", &frames, "-o", "act.pc2", "--force"]);
        let (_, cache) = read_cache(&folder.join("act.pc2"));
        let morph = ["--frames", &frames, "-o", "morph.glb", "--force"];
        act(folder, &morph);
        let skin = ["--as", "skin", "--bones", "8", "-o", "skin.glb", "--force"];
        act(folder, &[&morph[..2], &skin].concat());
        let written = ["morph.glb", "skin.glb"].map(|name| read_glb(&folder.join(name)));
        for (k, frame) in cache.iter().enumerate() {
            let seconds = (first + k) as f64 / RATE;
            let wanted = drawn_by_name(&source, seconds);
            let mut at = bar;
            for name in BESIDE {
                let own = &frame[at..at + wanted[name].len()];
                at += own.len();
                let off = farthest(&wanted[name], own);
                assert!(off < 1e-5, "{name}, frame {k} of {frames} in the cache: {off}");
                for (file, what) in written.iter().zip(["morphs", "a skin"]) {
                    let seen = &drawn_by_name(file, k as f64 / RATE)[name];
                    let off = farthest(seen, own);
                    assert!(off < 1e-5, "{name}, frame {k} of {frames} as {what}: {off}");
                }
            }
            let body = &drawn_by_name(&written[0], k as f64 / RATE)["body"];
            let off = farthest(body, &frame[..bar]);
            assert!(off < 1e-5, "the body, frame {k} of {frames}: {off}");
        }
        for file in &written {
            let clips = file.json["animations"].as_array().expect("clips");
            assert_eq!(clips.len(), 1, "the clip is played anew, and not kept beside");
            let length = crate::support::skinning::clip_length(file, 0);
            let wanted = (count - 1) as f64 / RATE;
            assert!(
                (length - wanted).abs() < 1e-6,
                "all of it lasts {length} s, not {wanted}"
            );
        }
    }
}

#[test]
fn without_the_root_all_is_as_the_root_sees_it() {
    let folder = &scene_folder();
    act(folder, &["--root", "none", "-o", "act.pc2"]);
    act(folder, &["--root", "none", "-o", "act.glb"]);
    act(folder, &["--root", "baked", "-o", "baked.glb"]);
    act(folder, &["-o", "node.glb"]);
    let (_, cache) = read_cache(&folder.join("act.pc2"));
    let [apart, baked, node] = ["act.glb", "baked.glb", "node.glb"].map(|name| read_glb(&folder.join(name)));
    for (k, frame) in cache.iter().enumerate() {
        let seconds = k as f64 / RATE;
        let drawn = drawn_by_name(&apart, seconds);
        let mut at = 0;
        for name in ["body"].iter().chain(&BESIDE) {
            let own = &drawn[*name];
            let off = farthest(own, &frame[at..at + own.len()]);
            assert!(off < 1e-5, "{name}, frame {k}: {off}");
            at += own.len();
        }
        let (baked, node) = (drawn_by_name(&baked, seconds), drawn_by_name(&node, seconds));
        for (name, own) in &baked {
            let own: Vec<Vec3> = own.iter().map(|p| p.as_vec3()).collect();
            let off = farthest(&node[name], &own);
            assert!(off < 1e-5, "{name}, frame {k}, baked: {off}");
        }
    }
}

#[test]
fn a_skin_with_morph_targets_has_them_turned_along() {
    let folder = &Workplace::empty();
    let mut shapes = Vec::new();
    for has_frown in [false, true] {
        make_scene(folder, has_frown);
        act(folder, &["-o", "act.pc2", "--force"]);
        shapes.push(read_cache(&folder.join("act.pc2")).1);
    }
    // At 0.5 s the joint has turned by 0.6 about z, along which nothing changes; the weight is 1.
    let (positions, _, _) = bar();
    let end: Vec<usize> = (0..positions.len()).filter(|v| positions[*v].x > 2.2).collect();
    assert!(!end.is_empty());
    let source = read_glb(&folder.join("scene.gltf"));
    for (k, weight) in [(0, 0.0), (1, 0.4), (10, 1.0)] {
        for v in &end {
            let shift = shapes[1][k][*v] - shapes[0][k][*v];
            assert!((shift.z - 0.25 * weight).abs() < 0.02, "frame {k}: {shift}");
            assert!(shift.x.hypot(shift.y) < 0.02, "frame {k}: {shift}");
        }
    }
    assert_eq!(list(&source.json["animations"][0]["channels"]).len(), 5);
}

#[test]
fn what_goes_on_beside_a_skin_is_valid() {
    let folder = &Workplace::empty();
    make_scene(folder, true);
    let mut made = Vec::new();
    for (k, [first, second]) in [["--as", "morph"], ["--as", "skin"]].iter().enumerate() {
        for (number, root) in ["node", "none"].iter().enumerate() {
            let name = format!("{k}_{number}.glb");
            act(folder, &[first, second, "--root", root, "--frames", "2:6", "-o", &name]);
            made.push((folder.join(name), folder.join("scene.gltf")));
        }
    }
    khronos::assert_nothing_new("clips beside skins", &made);
}
