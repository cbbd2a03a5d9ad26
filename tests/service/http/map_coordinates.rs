//! Models in map coordinates over the wire: 32-bit numbers relative to an origin that the answer names.

use crate::support::server::*;
use crate::support::shapes::obj_text;
use futures::StreamExt as _;
use glam::DVec3;
use pliant::asset::shapes::box_with_cells;
use pliant::wire::pb::{self, deform_response};
use serde_json::{Value, json};

const PLACE: DVec3 = DVec3::new(523_417.3, 5_274_861.7, 412.1);

fn bar_at(place: DVec3) -> String {
    let (mut positions, triangles) = box_with_cells(DVec3::new(0.5, 0.5, 4.0), [3, 3, 24]);
    positions.iter_mut().for_each(|p| *p += place);
    obj_text(&(positions, triangles))
}

fn origin_of(numbers: &Value) -> DVec3 {
    DVec3::from_slice(&serde_json::from_value::<Vec<f64>>(numbers.clone()).expect("three numbers"))
}

fn placed(bytes: &[u8], origin: DVec3) -> Vec<DVec3> {
    let numbers = floats(bytes);
    let relative = numbers.as_chunks::<3>().0.iter();
    relative
        .map(|p| glam::Vec3::from_array(*p).as_dvec3() + origin)
        .collect()
}

fn assert_near(what: &str, far: &[DVec3], near: &[DVec3], within: f64) {
    assert_eq!(far.len(), near.len(), "{what}");
    let off = far
        .iter()
        .zip(near)
        .map(|(p, q)| (*p - PLACE - *q).length())
        .fold(0.0, f64::max);
    assert!(off < within, "{what}: {off} off");
}

#[tokio::test(flavor = "multi_thread")]
async fn buffers_and_frames_of_a_model_far_away_name_their_origin() {
    let server = Server::start().await;
    let handles = |z: f64| {
        json!({"handles": [
            {"id": "base", "region": {"halfSpace": {"normal": [0, 0, -1], "offset": -0.25 - z}}},
            {"id": "top", "region": {"halfSpace": {"normal": [0, 0, 1], "offset": 3.75 + z}}},
        ]})
    };
    let turn = |place: DVec3| {
        let pivot = (place + DVec3::new(0.25, 0.25, 4.0)).to_array();
        json!({"pose": {"handles": [{"id": "top", "pose": {"rotationVector": [0, 0.9, 0], "pivot": pivot}}]},
            "options": {"tolerance": 1e-6}})
    };
    let mut shapes = Vec::new();
    let mut far = String::new();
    for place in [DVec3::ZERO, PLACE] {
        let opened = server.open(bar_at(place)).await;
        let id = text(&opened["id"]);
        let put = server
            .put(&path(&id, "/handles"))
            .json(&handles(place.z))
            .answer()
            .await;
        assert_eq!(put.status(), 200);
        let solved = server.post(&path(&id, "/solve")).json(&turn(place)).document().await;
        let buffer = server.get(&path(&id, "/positions")).answer().await;
        let told = buffer
            .headers()
            .get("x-pliant-origin")
            .map(|value| value.to_str().expect("text").to_owned());
        let frame = &solved["frames"][0];
        if place == DVec3::ZERO {
            assert!(
                opened.get("origin").is_none() && frame.get("origin").is_none() && told.is_none(),
                "{opened}"
            );
            let near = placed(&buffer.bytes().await.expect("bytes"), DVec3::ZERO);
            shapes.push(near);
            continue;
        }
        let origin = origin_of(&opened["origin"]);
        assert_eq!(origin_of(&frame["origin"]), origin);
        let words: Vec<f64> = told
            .expect("a header")
            .split(' ')
            .map(|word| word.parse().expect("a number"))
            .collect();
        assert_eq!(DVec3::from_slice(&words), origin);
        assert_eq!(origin.as_vec3().as_dvec3(), origin, "32-bit readers have the same one");
        shapes.push(placed(&buffer.bytes().await.expect("bytes"), origin));
        far = id;
    }
    assert_near("the buffer", &shapes[1], &shapes[0], 1e-5);

    // A stream's frames as well, in floats and in steps.
    for encoding in [pb::frame::Encoding::F32, pb::frame::Encoding::Meshopt] {
        let (requests, mut responses) = server.stream(&far).await;
        let output = Some(pb::Output {
            encoding: encoding.into(),
            ..pb::Output::default()
        });
        let options = pb::Options {
            output,
            ..pb::Options::default()
        };
        requests
            .send(message(pb::deform_request::Message::Options(options)))
            .await
            .expect("sent");
        let pose: pb::Pose = pliant::wire::json::from_json(turn(PLACE)["pose"].to_string().as_bytes()).expect("a pose");
        let pose = pb::Pose { seq: 1, ..pose };
        requests
            .send(message(pb::deform_request::Message::Pose(pose)))
            .await
            .expect("sent");
        let mut reader = pliant::wire::frames::FrameReader::new(shapes[0].len());
        let part = loop {
            let next = within("a frame", responses.next())
                .await
                .expect("a response")
                .expect("no error");
            if let Some(deform_response::Message::Frame(part)) = next.message
                && reader.take(&part).expect("a part")
            {
                break part;
            }
        };
        let numbers = reader.numbers(pb::frame::Attribute::Position);
        let bytes: Vec<u8> = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let origin = DVec3::from_slice(&part.origin);
        assert_near(encoding.as_str_name(), &placed(&bytes, origin), &shapes[0], 5e-3);
    }
}
