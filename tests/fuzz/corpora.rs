//! What the runs begin with: small inputs of every kind, generated ones and, where the data folder is there, files of it.

use crate::found_inputs;
use crate::support::data::{data_root, files_below};
use crate::support::fbx_text::FbxText;
use crate::support::packed_models::{draco_of_faces, embedded_zeros, fbx_of_zeros, meshopt_of_zeros, placed_often};
use crate::targets::sessions::{JOB_LIMITS, box_file};
use crate::targets::{self, TARGETS};
use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits, Model, sample};
use pliant::engine::{
    Deformer, Handle, HandlePose, HandlePoses, HandleSet, OpenOptions, PoseChain, PoseRecipe, Region, SolveSettings,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::frames::{Frame, FrameEncoding, FrameOutput, SentSteps, encode_next};
use pliant::wire::record::{FileReferences, LoggedCommit, RecordedModel, ShapeProbe};
use pliant::wire::{SessionOptions, json, pb, rig_from_json, rig_message, session_edit, session_message};
use prost::Message;
use std::path::Path;
use std::sync::Arc;

/// Larger files add nothing and are slow to mutate.
const LARGEST: u64 = 24 << 10;

const JOBS: [&str; 6] = [
    r#"{"handles": [{"id": "base", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": 0.6}}},
        {"id": "top", "region": {"sphere": {"center": [0, 1, 0], "radius": 0.6}}, "stiffness": 2, "falloff": {"radius": 0.5, "kind": "SMOOTH"}}],
        "steps": [{"pose": {"handles": [{"id": "top", "pose": {"rotationVector": [0, 0, 1.2], "translation": [0.1, 0, 0]}}]}}],
        "options": {"tolerance": 1e-3, "refine": 1}}"#,
    r#"{"steps": [{"edit": {"cut": {"plane": {"normal": [0, 1, 0.2], "offset": 0.3}, "keep": "BOTH", "fill": true}}},
        {"edit": {"remesh": {"edgeLength": 0.4}}}]}"#,
    r#"{"steps": [{"edit": {"merge": {"model": "b2ZmCjMgMSAwCjAgMCAwIDEgMCAwIDAgMSAwCjMgMCAxIDIK", "format": "off", "how": "LOOSE"}}},
        {"edit": {"weld": {"tolerance": 0.01}}}, {"edit": {"subdivide": {"scheme": "LOOP"}}}, {"edit": {"decimate": {"ratio": 0.5}}}]}"#,
    r#"{"create": {"components": "HOLD", "weights": "COTANGENT", "volumeGraph": {"mode": "OFF"}},
        "steps": [{"edit": {"delete": {"region": {"box": {"min": [-1, 0.5, -1], "max": [1, 2, 1]}}, "fill": true}}}, {"edit": {"fill": {}}}]}"#,
    r#"{"handles": [{"id": "a", "region": {"vertices": {"indices": [0, 1, 2]}}}, {"id": "b", "region": {"capsule": {"from": [0, 0, 0], "to": [0, 1, 0], "radius": 0.5}}}],
        "steps": [{"pose": {"handles": [{"id": "b", "pose": {"rotation": [0, 0.6, 0, 0.8], "scale": [1.2], "pivot": [0, 0, 0]}}]}}],
        "options": {"firstPass": "DIFFUSION", "method": "SPATIAL_RBF"}, "expect": {"flippedTriangles": 0}}"#,
    r#"{"steps": [{"edit": {"insertCurve": {"points": [0.5, 0, 0.1, 0.5, 0.5, -0.1], "closed": false}, "on": "REST"}}]}"#,
];

/// A report of a shard, with one of everything.
const REPORT: &str = r#"{"suite": "s", "how": "in process", "shard": {"number": 1, "of": 2, "cases": 2, "suite": "sha256:a", "split": "sha256:b",
    "build": "0.1.0"}, "passed": 0, "failed": 1, "skipped": 0, "blessed": 0, "notes": ["n"], "cases": [{"name": "a", "title": "A <b>", "model": "m.obj",
    "status": "failed", "identical": false, "digest": "xxh3:1", "storedDigest": "xxh3:2", "reasons": [{"code": "metric", "text": "t"}],
    "metrics": [{"name": "volumeChange", "allowed": 0, "holds": true, "applies": false}, {"name": "cycles", "value": 7, "stored": 5.5,
    "difference": "Infinity", "allowed": 1e-6, "reason": "r", "place": "vertex 1", "holds": false}], "notes": ["n"],
    "inputs": {"model": "aa", "job": "bb"}, "milliseconds": 1.25, "pictures": [{"caption": "after", "description": "d", "size": [1, 1],
    "png": "iVBORw0KGgo="}]}]}"#;

/// What a target begins with: generated inputs, small files of the data folder, and what was found before.
pub fn inputs_of(name: &str) -> Vec<Vec<u8>> {
    let mut inputs = match name {
        "obj" => models(&[Format::OBJ], &["obj"]),
        "decoders" => packed_models(),
        "ply" => models(&[Format::PLY], &["ply"]),
        "off" => models(&[Format::OFF], &["off"]),
        "stl" => models(&[Format::STL], &["stl"]),
        "threemf" => models(&[Format::THREE_MF], &["3mf"]),
        "glb" => models(&[Format::GLB], &["glb"]),
        "gltf" => models(&[Format::GLTF], &["gltf"]),
        "fbx" => vec![fbx()],
        "any_model" => models(
            &[Format::OBJ, Format::PLY, Format::OFF, Format::STL, Format::GLB],
            &["stl", "off"],
        ),
        "bvh" => recordings(),
        "rig" => vec![rig()],
        "messages" => messages(),
        "json" => texts(),
        "jobs" => jobs().iter().map(Message::encode_to_vec).collect(),
        "edits" | "handles" | "soups" => (0..24u8)
            .map(|k| {
                (0..60u8)
                    .map(|i| i.wrapping_mul(37).wrapping_add(k.wrapping_mul(11)) ^ k)
                    .collect()
            })
            .collect(),
        "commit_records" => commits(),
        "model_records" => vec![model_record()],
        "reports" => vec![REPORT.into()],
        "frames" => frames(),
        _ => Vec::new(),
    };
    inputs.extend(
        found_inputs(name)
            .iter()
            .map(|path| std::fs::read(path).expect("a readable file")),
    );
    inputs
}

/// What streams send: in each encoding three frames of a shape that moves, in several parts.
fn frames() -> Vec<Vec<u8>> {
    let encodings = [
        FrameEncoding::F32,
        FrameEncoding::U16,
        FrameEncoding::Meshopt,
        FrameEncoding::Delta,
    ];
    let reported = |encoding| {
        let (mut sent, mut bytes) = (SentSteps::default(), Vec::new());
        for k in 0..3 {
            let place = |v: usize| DVec3::new(v as f64, libm::sin(v as f64 + f64::from(k) * 0.01), 0.5);
            let positions: Vec<DVec3> = (0..targets::messages::VERTICES).map(place).collect();
            let output = FrameOutput {
                encoding,
                ..FrameOutput::default()
            };
            let request = Frame {
                positions: Arc::new(positions),
                output,
                part_bytes: 200,
                ..Frame::default()
            };
            let mut parts = encode_next(request, sent);
            parts
                .by_ref()
                .for_each(|part| bytes.extend(part.encode_length_delimited_to_vec()));
            sent = parts.into_sent();
        }
        bytes
    };
    encodings.map(reported).to_vec()
}

fn box_model() -> Model {
    Model::read(box_file(), Some(Format::OBJ), &Limits::default()).expect("the box")
}

/// Files that are packed, each behind the byte that says how much memory there is.
fn packed_models() -> Vec<Vec<u8>> {
    let packed = [
        fbx_of_zeros(3000),
        meshopt_of_zeros(300),
        draco_of_faces(100),
        placed_often(20, 9),
        embedded_zeros(300),
    ];
    let plain = models(&Format::ALL, &["fbx", "glb"]);
    let files = packed.into_iter().chain(plain).enumerate();
    files.map(|(k, file)| [&[(k % 16) as u8][..], &file].concat()).collect()
}

fn models(formats: &[Format], extensions: &[&str]) -> Vec<Vec<u8>> {
    let model = box_model();
    let moved: Vec<DVec3> = model.positions.iter().map(|&p| p * 1.5).collect();
    let mut inputs: Vec<Vec<u8>> = formats
        .iter()
        .map(|&f| model.write(&moved, f).expect("writes").main)
        .collect();
    if formats.contains(&Format::OBJ) {
        let text = "mtllib m.mtl\no one\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\nusemtl a\ns 1\nf 1/1/1 2/2/1 3/1/1 4/2/1\n\
                    g two\nusemtl b\nf -1//1 -2//1 -3//1\nl 1 2\n";
        inputs.push(text.into());
    }
    if formats.contains(&Format::PLY) {
        let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty float y\nproperty int z\nproperty uchar red\nelement face 1\n\
                    property list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n0 0 0 1\n1 0 0 2\n0 1 0 3\n3 0 1 2 6 0 0 1 0 0 1\n";
        inputs.push(text.into());
        inputs.push(
            text.replace("ascii", "binary_little_endian")
                .replace("end_header\n0 0", "end_header\n\0\0")
                .into(),
        );
    }
    if formats.contains(&Format::STL) {
        let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n";
        inputs.push(text.into());
    }
    if formats.contains(&Format::GLTF) {
        let text = r#"{"asset": {"version": "2.0"}, "buffers": [{"byteLength": 2048, "uri": "b.bin"}],
            "bufferViews": [{"buffer": 0, "byteLength": 1024}, {"buffer": 0, "byteOffset": 1024, "byteLength": 1024, "byteStride": 12}],
            "accessors": [{"bufferView": 1, "componentType": 5126, "count": 24, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]},
                {"bufferView": 0, "componentType": 5121, "count": 12, "type": "SCALAR",
                 "sparse": {"count": 2, "indices": {"bufferView": 0, "componentType": 5121}, "values": {"bufferView": 0}}}],
            "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 0}, "indices": 1, "targets": [{"POSITION": 0}], "material": 0, "mode": 4}]}],
            "skins": [{"joints": [1]}], "animations": [{"channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}],
                "samplers": [{"input": 1, "output": 0, "interpolation": "STEP"}]}],
            "nodes": [{"mesh": 0, "skin": 0, "children": [1], "scale": [1, 2, 1]}, {"translation": [0, 1, 0]}], "scenes": [{"nodes": [0]}], "scene": 0}"#;
        inputs.push(text.into());
    }
    inputs.extend(small_files(extensions));
    inputs
}

/// Files of the data folder that end so.
fn small_files(extensions: &[&str]) -> Vec<Vec<u8>> {
    let fits = |path: &Path| {
        let extension = path
            .extension()
            .and_then(|e| e.to_str())
            .unwrap_or_default()
            .to_ascii_lowercase();
        extensions.contains(&extension.as_str()) && path.metadata().is_ok_and(|facts| facts.len() <= LARGEST)
    };
    let files = files_below(&data_root(), fits);
    files
        .iter()
        .map(|path| std::fs::read(path).expect("a readable file"))
        .collect()
}

fn fbx() -> Vec<u8> {
    let mut file = FbxText::new();
    file.node(1, "Mesh", "a", [0.0, 1.0, 0.0], 0);
    let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    file.mesh(2, 1, &points, &[&[0, 1, 2, 3]], "");
    file.text().into()
}

fn recordings() -> Vec<Vec<u8>> {
    let text = "HIERARCHY\nROOT Hips\n{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n JOINT Spine\n {\n  OFFSET 0 5.2 0\n\
                CHANNELS 3 Zrotation Xrotation Yrotation\n  End Site\n  {\n   OFFSET 0 4 0\n  }\n }\n}\nMOTION\nFrames: 2\nFrame Time: 0.0083333\n\
                0 1 0 10 20 30 1 2 3\n0 1 0.5 -170 20 190 1 2 3\n";
    vec![text.into(), text.replace('\n', "\r\n").into()]
}

fn rig() -> Vec<u8> {
    let pictured = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/docs/pictures/boxer-rig.json");
    std::fs::read(pictured).expect("the rig of the picture")
}

fn jobs() -> Vec<pb::Job> {
    let read = |text: &&str| json::from_json(text.as_bytes()).unwrap_or_else(|e| panic!("{e}: {text}"));
    JOBS.iter().map(read).collect()
}

/// Every kind of message, as the target of messages takes them.
fn messages() -> Vec<Vec<u8>> {
    let mut inputs = Vec::new();
    let mut add = |which: u8, bytes: Vec<u8>| inputs.push([vec![which], bytes].concat());
    for job in jobs() {
        let handles = pb::SetHandlesRequest {
            handles: job.handles.clone(),
            ..Default::default()
        };
        add(0, handles.encode_to_vec());
        job.create.iter().for_each(|create| add(4, create.encode_to_vec()));
        job.handles.iter().for_each(|handle| add(9, handle.encode_to_vec()));
        for step in &job.steps {
            match &step.step {
                Some(pb::step::Step::Edit(edit)) => add(1, edit.encode_to_vec()),
                Some(pb::step::Step::Pose(pose)) => {
                    let solve = pb::SolveRequest {
                        pose: Some(pose.clone()),
                        options: job.options,
                        ..Default::default()
                    };
                    add(2, solve.encode_to_vec());
                    let message = pb::deform_request::Message::Pose(pose.clone());
                    let deform = pb::DeformRequest {
                        message: Some(message),
                        ..Default::default()
                    };
                    add(3, deform.encode_to_vec());
                }
                None => {}
            }
        }
    }
    let carry = pb::CarryRequest {
        points: vec![0.0, 0.5, 1.0],
        rotations: vec![0.0, 0.0, 0.0, 1.0],
        ..Default::default()
    };
    add(5, carry.encode_to_vec());
    add(6, animation().encode_to_vec());
    let rig = rig_from_json(&rig()).expect("the rig of the picture");
    add(7, rig_message(&rig, &[], "a model").encode_to_vec());
    add(8, pb::ListSessionsRequest::default().encode_to_vec());
    inputs
}

fn animation() -> pb::AnimateOptions {
    let text = r#"{"bvhSize": "100", "fps": 30, "refine": 2, "contact": "AVOID"}"#;
    json::from_json(text.as_bytes()).unwrap_or_default()
}

fn texts() -> Vec<Vec<u8>> {
    let job = |text: &&str| [b"\0", text.as_bytes()].concat();
    let mut inputs: Vec<Vec<u8>> = JOBS.iter().map(job).collect();
    let reported = json::to_json(&animation()).expect("options").to_string();
    inputs.push([b"\x05", reported.as_bytes()].concat());
    inputs.push([b"\x06".to_vec(), rig()].concat());
    inputs.push(br#"{"pose": {"seq": "7", "handles": [{"id": "a"}], "commit": true}}"#.to_vec());
    inputs
}

fn commits() -> Vec<Vec<u8>> {
    let pool = Pool::new(1).expect("one thread");
    let opened = Deformer::open(
        box_file(),
        &OpenOptions::default(),
        &JOB_LIMITS,
        &Exec::new(&pool, &Silent),
    );
    let facts = Box::new(session_message(&opened.expect("the box opens").facts()));
    let poses = HandlePoses(vec![HandlePose::rotation([0.1, 0.2, 0.3])].into());
    let probe = ShapeProbe::of(&[DVec3::ONE; 4]);
    let weld = json::from_json(br#"{"on": "REST", "weld": {"tolerance": 0.1}}"#).expect("a request");
    let commits = [
        LoggedCommit::Create { facts: facts.clone() },
        LoggedCommit::Handles {
            set: HandleSet::from([Handle::new("a", Region::sphere([0.0, 1.0, 0.0], 0.5)).soft(2.0)]),
            poses: poses.clone(),
            facts: facts.clone(),
        },
        LoggedCommit::Pose {
            chain: PoseChain {
                starts: vec![PoseRecipe::default()],
                pose: PoseRecipe {
                    poses: poses.clone(),
                    settings: SolveSettings::default(),
                },
            },
            warnings: Vec::new(),
            found_turns: Vec::new(),
            probe: probe.clone(),
            frame: None,
        },
        LoggedCommit::Edit {
            edit: Box::new(session_edit(&weld).expect("an edit")),
            files: Some(FileReferences::default()),
            report: Box::default(),
            poses,
            facts,
            probe,
        },
        LoggedCommit::Step {
            target: 3,
            forward: true,
        },
    ];
    commits.iter().map(LoggedCommit::write).collect()
}

fn model_record() -> Vec<u8> {
    let record = RecordedModel {
        files: FileReferences {
            name: "box.obj".into(),
            main: "ab12".into(),
            companions: [("b.png".to_owned(), "cd34".to_owned())].into(),
        },
        options: SessionOptions::default().create,
        of_today: true,
        loose_vertices_ride: true,
        near_origin: true,
        every_cut_ends_lines: true,
        riders_keep_sides: true,
        follows_edits: true,
        local_fields: true,
        label: "a box".into(),
        format: Format::OBJ,
        graph_bytes: Some(1 << 30),
    };
    record.write()
}

/// `cargo test --test fuzz -- --ignored` puts the inputs where coverage-guided runs look for them.
#[test]
#[ignore = "writes the inputs of coverage-guided runs"]
fn write_the_corpora() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/coverage/corpus");
    for (name, _) in TARGETS {
        let folder = folder.join(name);
        std::fs::create_dir_all(&folder).expect("a folder");
        let mut inputs = inputs_of(name);
        if name == "glb" || name == "any_model" {
            inputs.extend(sample_files());
        }
        for (k, input) in inputs.iter().enumerate() {
            std::fs::write(folder.join(format!("seed-{k:03}")), input).expect("writes");
        }
    }
}

/// Models with skins and clips.
fn sample_files() -> Vec<Vec<u8>> {
    let limits = Limits::default();
    let names = [sample::BuiltInModel::Figure];
    let files = names.map(sample::BuiltInModel::glb);
    // Only those that can be read are worth a start.
    files
        .into_iter()
        .filter(|f| Model::read(FileSet::single("a.glb", *f), None, &limits).is_ok())
        .map(<[u8]>::to_vec)
        .collect()
}
