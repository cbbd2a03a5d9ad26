//! What an animation answers, over gRPC and over HTTP.

use super::*;
use crate::support::commands::words;
use crate::support::gltf_parsed::parse;
use pliant::wire::frames::FrameReader;
use prost::Message as _;
use std::collections::BTreeMap;
use std::process::Command;

/// The report of the program's own command on the same files.
fn reported_by_command(model: &str, clip: &str) -> Value {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, text) in [
        ("bar.obj", model),
        ("bar.bvh", clip),
        ("rig.json", &bar_rig().to_string()),
    ] {
        std::fs::write(folder.path().join(name), text).expect("written");
    }
    let done = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .current_dir(folder.path())
        .args(words(
            "animate bar.obj --bvh bar.bvh --rig rig.json --skip-first no --json",
        ))
        .output()
        .expect("it runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    serde_json::from_slice(&done.stdout).expect("JSON")
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_those_of_the_command_line() {
    let server = Server::start().await;
    let (model, clip) = (bar_obj(24), bending_clip(70));
    let id = text(&server.open(model.clone()).await["id"]);
    let mut client = server.grpc().await;
    let mut animating = Animating::begin(&mut client, bar_options(&id, &clip)).await;
    let frames = animating.all_frames().await;
    let report = reported_by_command(&model, &clip);
    let wanted = report["frames"].as_array().expect("frames");
    assert_eq!((frames.len(), wanted.len()), (70, 70));
    for (k, (seen, wanted)) in frames.iter().zip(wanted).enumerate() {
        assert_eq!(seen.reply.digest, text(&wanted["digest"]), "frame {k}");
        assert_eq!(
            (seen.seq, seen.reply.index, seen.reply.count),
            (k as u64 + 1, k as u32, 70)
        );
        assert_eq!(seen.reply.time, wanted["time"].as_f64().unwrap_or(0.0));
        let quality = seen.quality.as_ref().expect("measured");
        assert_eq!(quality.edge_rms, wanted["edgeRms"].as_f64().unwrap_or(0.0));
        let rotation: Vec<f64> = seen.reply.root_rotation.clone();
        let reply: Vec<f64> = wanted["rootRotation"]
            .as_array()
            .expect("four")
            .iter()
            .filter_map(Value::as_f64)
            .collect();
        assert_eq!(rotation, reply);
    }
    assert!(
        !animating.stages.is_empty(),
        "what is under way before the first frame is told"
    );
    let ended = animating.report.expect("a report");
    let totals = ended.totals.expect("totals");
    assert_eq!(totals.frames, 70);
    assert_eq!(
        totals.edge_rms_mean,
        report["totals"]["edgeRmsMean"].as_f64().expect("a number")
    );
    assert_eq!(
        ended.handles.len(),
        report["handles"].as_array().expect("handles").len()
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_without_a_rig_drives_the_one_that_pliant_rig_makes() {
    let server = Server::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("wave.bvh"), waving_clip()).expect("written");
    let pliant = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pliant"));
        let done = command.current_dir(folder.path()).args(args).output().expect("it runs");
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    };
    pliant(&["sample", "figure", "-o", "figure.glb"]);
    pliant(&words("rig figure.glb --bvh wave.bvh -o rig.json --no-picture"));
    let rig: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("rig.json")).expect("a rig")).expect("JSON");
    let opened = server.post("/v1/sessions?sample=figure").document().await;
    let id = text(&opened["id"]);
    let mut reply = Vec::new();
    for options in [json!({"rig": rig}), json!({})] {
        let form = animation_form(&options, Some(waving_clip()));
        let answer = post_animation(&server, &id, "application/x-ndjson", form).await;
        let lines = answer.text().await.expect("lines");
        let frames: Vec<Value> = lines.lines().map(|l| serde_json::from_str(l).expect("JSON")).collect();
        let digests: Vec<String> = (frames.iter())
            .filter(|f| f["part"].as_u64().unwrap_or(0) == 0 && f["parts"].as_u64().unwrap_or(0) > 0)
            .map(|f| text(&f["animated"]["digest"]))
            .collect();
        assert_eq!(digests.len(), 3, "{}", lines.chars().take(300).collect::<String>());
        reply.push(digests);
    }
    assert_eq!(reply[0], reply[1], "bit for bit");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_part_of_it_has_the_same_bits() {
    let (server, id) = opened_bar().await;
    let options = bar_options(&id, &bending_clip(90));
    let all = animated(&server, options.clone()).await;
    for (first, count) in [(0, 5), (63, 3), (70, 4), (80, 0)] {
        let part = pb::AnimateOptions {
            first,
            count,
            ..options.clone()
        };
        let seen = animated(&server, part).await;
        let end = if count == 0 { 90 } else { first + count };
        assert_eq!(seen, all[first as usize..end as usize], "{first}:{count}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_motion_of_the_root_goes_where_it_is_asked_to() {
    let (server, id) = opened_bar().await;
    let options = pb::AnimateOptions {
        first: 8,
        count: 1,
        ..bar_options(&id, &bending_clip(10))
    };
    let with_root = |root: pb::animate_options::Root| pb::AnimateOptions {
        root: root.into(),
        ..options.clone()
    };
    use pb::animate_options::Root;
    let apart = animated(&server, with_root(Root::Node)).await.remove(0);
    let baked = animated(&server, with_root(Root::Baked)).await.remove(0);
    let dropped = animated(&server, with_root(Root::None)).await.remove(0);
    let still = (vec![0.0; 3], vec![0.0, 0.0, 0.0, 1.0]);
    for frame in [&baked, &dropped] {
        assert_eq!(
            (frame.reply.root_translation.clone(), frame.reply.root_rotation.clone()),
            still
        );
        assert_eq!(
            frame.reply.digest, apart.reply.digest,
            "digests are of what the root bone sees"
        );
    }
    assert_eq!(dropped.data, apart.data);
    let rotation = glam::DQuat::from_slice(&apart.reply.root_rotation);
    let translation = glam::DVec3::from_slice(&apart.reply.root_translation);
    assert!(rotation.to_axis_angle().1 > 0.05 && translation.length() > 0.05);
    for (p, q) in floats(&apart.data)
        .chunks_exact(3)
        .zip(floats(&baked.data).chunks_exact(3))
    {
        let moved = rotation * glam::Vec3::from_slice(p).as_dvec3() + translation;
        assert!(moved.distance(glam::Vec3::from_slice(q).as_dvec3()) < 1e-5);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clip_comes_whole_or_in_chunks() {
    let (server, id) = opened_bar().await;
    let clip = bending_clip(6);
    let options = bar_options(&id, &clip);
    let whole = animated(&server, options.clone()).await;
    let announced = pb::AnimateOptions {
        source: Some(Source::BvhSize(clip.len() as u64)),
        ..options
    };
    let chunks = clip
        .as_bytes()
        .chunks(100)
        .map(|c| Message::Chunk(Bytes::copy_from_slice(c)));
    let messages = [Message::Options(announced)].into_iter().chain(chunks);
    let mut client = server.grpc().await;
    let mut animating = Animating::begin_with(&mut client, messages).await;
    animating.half_close();
    assert_eq!(animating.all_frames().await, whole);
}

#[tokio::test(flavor = "multi_thread")]
async fn http_answers_frames_in_a_row() {
    let (server, id) = opened_bar().await;
    let clip = bending_clip(7);
    let wanted = animated(&server, bar_options(&id, &clip)).await;
    let form = || animation_form(&json!({"rig": bar_rig(), "skipFirst": "NO"}), Some(clip.clone()));
    let answer = post_animation(&server, &id, "application/vnd.google.protobuf", form()).await;
    assert_eq!(answer.status(), 200);
    let kind = header(&answer, "content-type").to_owned();
    assert_eq!(
        kind,
        "application/vnd.google.protobuf; proto=pliant.v1.Frame; encoding=delimited"
    );
    let mut body = answer.bytes().await.expect("a body");
    let mut frames = Vec::new();
    while !body.is_empty() {
        frames.push(pb::Frame::decode_length_delimited(&mut body).expect("a frame"));
    }
    let last = frames.pop().expect("a report").animated.and_then(|a| a.report);
    assert_eq!(last.and_then(|r| r.totals).map(|t| t.frames), Some(7));
    let data: Vec<Vec<u8>> = frames.iter().map(|f| f.data.to_vec()).collect();
    assert_eq!(data, wanted.iter().map(|f| f.data.clone()).collect::<Vec<_>>());

    let answer = post_animation(&server, &id, "*/*", form()).await;
    assert_eq!(answer.headers()["content-type"], "application/x-ndjson");
    let lines = answer.text().await.expect("a body");
    let lines = lines.lines().map(|line| pliant::wire::json::from_json(line.as_bytes()));
    let without_times = |frame: pb::Frame| pb::Frame {
        solve_ms: 0.0,
        queue_ms: 0.0,
        ..frame
    };
    let lines: Vec<pb::Frame> = lines.map(|frame| without_times(frame.expect("a frame"))).collect();
    let frames: Vec<pb::Frame> = frames.into_iter().map(without_times).collect();
    assert_eq!(lines[..7], frames[..]);
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_that_say_what_differs_show_the_same() {
    let server = Server::start().await;
    let model = server.open(bar_obj(16)).await;
    let (id, vertices) = (
        text(&model["id"]),
        model["model"]["vertices"].as_u64().expect("a number"),
    );
    let clip = bending_clip(7);
    let wanted = animated(&server, bar_options(&id, &clip)).await;
    let options = json!({"rig": bar_rig(), "skipFirst": "NO", "output": {"encoding": "DELTA"}});
    let form = animation_form(&options, Some(clip.clone()));
    let answer = post_animation(&server, &id, "application/vnd.google.protobuf", form).await;
    assert_eq!(answer.status(), 200);
    let mut body = answer.bytes().await.expect("a body");
    let mut reader = FrameReader::new(vertices as usize);
    let mut encodings = Vec::new();
    for whole in &wanted {
        let part = pb::Frame::decode_length_delimited(&mut body).expect("a frame");
        assert!(reader.take(&part).expect("is read"));
        assert_eq!(part.number, encodings.len() as u64 + 1);
        let seen = reader
            .numbers(pb::frame::Attribute::Position)
            .iter()
            .zip(floats(&whole.data));
        let apart = seen.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart < 5.0 / 65535.0, "frame {}: {apart}", part.number);
        encodings.push(part.encoding());
    }
    assert_eq!(encodings[0], pb::frame::Encoding::Meshopt);
    assert!(encodings.contains(&pb::frame::Encoding::Delta), "{encodings:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn http_answers_a_model_that_plays_a_clip_of_its_own() {
    let server = Server::start().await;
    let created = server.post("/v1/sessions?sample=figure").answer().await;
    let id = text(&created.json::<Value>().await.expect("JSON")["id"]);
    for (options, is_skin) in [
        (json!({"clip": "walk", "count": 12}), false),
        (json!({"count": 12, "as": "SKIN", "bones": 9}), true),
    ] {
        let answer = post_animation(&server, &id, "model/gltf-binary", animation_form(&options, None)).await;
        assert_eq!(
            answer.status(),
            200,
            "{options}: {}",
            answer.text().await.unwrap_or_default()
        );
        assert_eq!(answer.headers()["x-pliant-frames"], "12");
        let is_reported = answer.headers().contains_key("x-pliant-warning");
        let file = parse(&answer.bytes().await.expect("a body"), &BTreeMap::new());
        let clips = file.json["animations"].as_array().expect("animations");
        assert_eq!(
            clips.last().map(|c| c["name"].clone()),
            Some(json!("walk")),
            "{options}"
        );
        let joints = file.json["skins"]
            .as_array()
            .map_or(0, |s| s[0]["joints"].as_array().map_or(0, Vec::len));
        assert_eq!(
            (joints, is_reported),
            if is_skin { (9, true) } else { (0, is_reported) },
            "{options}"
        );
    }
}
