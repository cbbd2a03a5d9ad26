//! Blend shapes that come to a session's model from another one.

use super::post;
use crate::support::server::*;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::Vec3;
use pliant::asset::{BlendShape, BlendShapes, FileSet, Limits, Model};
use pliant::wire::pb;
use serde_json::json;

fn read(bytes: Vec<u8>) -> Model {
    Model::read(FileSet::single("model", bytes), None, &Limits::default()).expect("a model")
}

/// The bar with a shape that lifts its upper half.
fn lifted_bar() -> (Vec<u8>, BlendShapes) {
    let bar = read(bar_obj(16).into_bytes());
    let lift = |height: f64| Vec3::new(0.0, 0.0, (height - 2.0).max(0.0) as f32);
    let shape = BlendShape {
        name: "lift".into(),
        moves: bar.positions.iter().map(|p| lift(p.z)).collect(),
        weight: 0.5,
    };
    let shapes = BlendShapes {
        shapes: vec![shape],
        ..BlendShapes::default()
    };
    (bar.write_blend_shapes(&shapes).expect("a GLB").main, shapes)
}

#[tokio::test(flavor = "multi_thread")]
async fn shapes_of_a_file_or_a_session_come_by_both_protocols_and_change_nothing() {
    let server = Server::start().await;
    let opened = server.open(bar_obj(16)).await;
    let id = text(&opened["id"]);
    let (source, shapes) = lifted_bar();
    let order = json!({"model": STANDARD.encode(&source)});
    let answer = post(&server, &path(&id, "/transfer"), order).await;
    assert_eq!(answer.status(), 200);
    assert_eq!(header(&answer, "content-type"), "model/gltf-binary");
    assert_eq!(
        header(&answer, "x-pliant-transferred"),
        "shapes=1, clips=0, flipped-triangles=0/0"
    );
    let by_http = answer.bytes().await.expect("bytes").to_vec();
    let found = read(by_http.clone()).blend_shapes().expect("shapes");
    assert_eq!((&*found.shapes[0].name, found.shapes[0].weight), ("lift", 0.5));
    for (was, now) in shapes.shapes[0].moves.iter().zip(&found.shapes[0].moves) {
        assert!(was.distance(*now) < 1e-3, "{was} {now}");
    }

    // The model that came is a session like another, and its shapes go on from there.
    let with_shapes = server.post("/v1/sessions").body(by_http.clone()).document().await;
    let request = pb::TransferRequest {
        session_id: id.clone(),
        source: Some(pb::transfer_request::Source::Session(text(&with_shapes["id"]))),
        ..pb::TransferRequest::default()
    };
    let mut chunks = server
        .grpc()
        .await
        .transfer(request)
        .await
        .expect("chunks")
        .into_inner();
    let first = chunks.message().await.expect("a chunk").expect("one");
    let told = first.transferred.expect("a report");
    assert_eq!((&*told.shapes[0].name, told.wrap), ("lift", None));
    assert_eq!(
        read(first.data.to_vec()).blend_shapes().expect("shapes").shapes.len(),
        1
    );

    let history = server.document(&path(&id, "/history")).await;
    assert_eq!(history["commits"].as_array().expect("commits").len(), 1);
}

/// The bar, so many times as thick.
fn thick_bar(by: f64) -> String {
    let thicker = |line: &str| match line.strip_prefix("v ") {
        Some(place) => {
            let p: Vec<f64> = place.split_whitespace().map(|n| n.parse().expect("a number")).collect();
            format!("v {} {} {}\n", p[0] * by, p[1] * by, p[2])
        }
        None => format!("{line}\n"),
    };
    bar_obj(16).lines().map(thicker).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_outfit_comes_to_another_body_by_http() {
    let server = Server::start().await;
    let id = text(&server.open(thick_bar(1.1)).await["id"]);
    let body = |by: f64| STANDARD.encode(thick_bar(by));
    let order = json!({"model": body(1.0), "shape": body(2.0), "fit": {"clearance": 0.01}});
    let answer = post(&server, &path(&id, "/transfer"), order).await;
    assert_eq!(answer.status(), 200);
    let told = header(&answer, "x-pliant-transferred").to_owned();
    assert!(told.ends_with("inside=0, crossings=0"), "{told}");
    let fitted = read(answer.bytes().await.expect("bytes").to_vec());
    let wide = |model: &Model| model.positions.iter().map(|p| p.x).fold(f64::MIN, f64::max);
    assert!(wide(&fitted) > wide(&read(thick_bar(2.0).into_bytes())));
    let history = server.document(&path(&id, "/history")).await;
    assert_eq!(history["commits"].as_array().expect("commits").len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_with_a_transfer_is_told_by_its_field() {
    let server = Server::start().await;
    let id = text(&server.open(bar_obj(16)).await["id"]);
    let bar = STANDARD.encode(bar_obj(16));
    for (order, field) in [
        (json!({}), "model"),
        (json!({"model": bar}), "model"),
        (json!({"model": bar, "output": "obj"}), "output"),
        (json!({"model": bar, "shape": STANDARD.encode(bar_obj(8))}), "shape"),
        (json!({"model": bar, "shape": bar, "output": "gltf"}), "output"),
        (json!({"model": bar, "landmarks": [{"ownVertex": 1}]}), "landmarks[0]"),
        (json!({"session": "none"}), "session"),
        (json!({"model": bar, "fit": {}}), "shape"),
        (
            json!({"model": bar, "shape": bar, "fit": {"clearance": -1}}),
            "fit.clearance",
        ),
    ] {
        let answer = post(&server, &path(&id, "/transfer"), order.clone()).await;
        let status = answer.status().as_u16();
        let problem: serde_json::Value = answer.json().await.expect("a problem");
        assert_eq!(
            (status / 100, &problem["errors"][0]["field"]),
            (4, &json!(field)),
            "{order}: {problem}"
        );
    }
}
