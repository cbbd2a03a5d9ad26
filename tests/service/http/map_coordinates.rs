//! Models in map coordinates over the wire: 32-bit numbers relative to an origin that the answer names.

use crate::support::server::*;
use crate::support::shapes::obj_text;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use futures::StreamExt as _;
use glam::DVec3;
use pliant::asset::shapes::box_with_cells;
use pliant::wire::pb::{self, deform_response};
use serde_json::json;

/// With a bar of few binary places nothing is rounded there, so that no decision between equal lengths is another one.
const PLACE: DVec3 = DVec3::new(523_417.265625, 5_274_861.703125, 412.109375);

fn bar_at(place: DVec3) -> String {
    let (mut positions, triangles) = box_with_cells(DVec3::new(0.5, 0.5, 4.0), [4, 4, 32]);
    positions.iter_mut().for_each(|p| *p += place);
    obj_text(&(positions, triangles))
}

fn placed(bytes: &[u8], origin: DVec3) -> Vec<DVec3> {
    let numbers = floats(bytes);
    let relative = numbers.as_chunks::<3>().0.iter();
    relative
        .map(|p| glam::Vec3::from_array(*p).as_dvec3() + origin)
        .collect()
}

fn assert_near(what: &str, seen: &[DVec3], wanted: &[DVec3], within: f64) {
    assert_eq!(seen.len(), wanted.len(), "{what}");
    let off = seen.iter().zip(wanted).map(|(p, q)| (*p - *q).length());
    let off = off.fold(0.0, f64::max);
    assert!(off < within, "{what}: {off} off");
}

/// Where the vertices of an OBJ are, which has doubles.
fn places_of(obj: &str) -> Vec<DVec3> {
    let rows = obj.lines().filter_map(|line| line.strip_prefix("v "));
    let numbers = |row: &str| {
        row.split(' ')
            .map(|word| word.parse().expect("a number"))
            .collect::<Vec<f64>>()
    };
    rows.map(|row| DVec3::from_slice(&numbers(row))).collect()
}

/// What other calls answer of a posed bar, relative to its place: points and a model that are carried along, an edit, and what it is
/// when that is undone.
async fn answers(server: &Server, id: &str, place: DVec3, shape: &[DVec3]) -> Vec<(&'static str, Vec<DVec3>)> {
    let model = || async {
        places_of(&String::from_utf8_lossy(
            &server.content(&path(id, "/model?format=obj")).await,
        ))
    };
    let beside = [
        DVec3::new(0.7, 0.25, 3.9),
        DVec3::new(0.25, -0.1, 2.0),
        DVec3::new(0.25, 0.25, 0.1),
    ];
    let points = beside.map(|p| (place + p).to_array()).concat();
    let carry = async |order: serde_json::Value| server.post(&path(id, "/carry")).json(&order).document().await;
    let carried = carry(json!({"points": points})).await;
    let numbers: Vec<f64> = serde_json::from_value(carried["points"].clone()).expect("numbers");
    let hull = STANDARD.encode(bar_at(place));
    let hull = carry(json!({"model": hull, "format": "obj"})).await;
    let hull = STANDARD.decode(text(&hull["model"])).expect("base64");
    let cut = json!({"cut": {"plane": {"normal": [0, 0, 1], "offset": 1.3 + place.z}, "keep": "BELOW", "fill": true}});
    server.post(&path(id, "/edits")).json(&cut).document().await;
    let cut = model().await;
    server.post(&path(id, "/undo")).json(&json!({})).document().await;
    let found = [
        ("the shape", shape.to_vec()),
        (
            "carried points",
            numbers
                .as_chunks::<3>()
                .0
                .iter()
                .map(|p| DVec3::from_array(*p))
                .collect(),
        ),
        ("a carried model", places_of(&String::from_utf8_lossy(&hull))),
        ("the shape that is cut", cut),
        ("the shape after undo", model().await),
    ];
    found
        .map(|(what, places)| (what, places.iter().map(|p| *p - place).collect()))
        .into()
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
    let (mut far, mut shape) = (String::new(), Vec::new());
    let mut answered: Vec<Vec<(&str, Vec<DVec3>)>> = Vec::new();
    for place in [DVec3::ZERO, PLACE] {
        let opened = server.open(bar_at(place)).await;
        far = text(&opened["id"]);
        let put = server
            .put(&path(&far, "/handles"))
            .json(&handles(place.z))
            .answer()
            .await;
        assert_eq!(put.status(), 200);
        let solved = server.post(&path(&far, "/solve")).json(&turn(place)).document().await;
        let model = server.content(&path(&far, "/model?format=obj")).await;
        shape = places_of(&String::from_utf8_lossy(&model));
        let buffer = server.get(&path(&far, "/positions")).answer().await;
        let header = buffer.headers().get("x-pliant-origin");
        let words = header.map(|value| value.to_str().expect("text").to_owned());
        let words = words.iter().flat_map(|text| text.split(' '));
        let named: Vec<f64> = words.map(|word| word.parse().expect("a number")).collect();
        assert_eq!(json!(named), opened["origin"], "the header says what the session does");
        assert_eq!(solved["frames"][0]["origin"], opened["origin"]);
        assert_eq!(named.is_empty(), place == DVec3::ZERO, "{named:?}");
        let origin = if named.is_empty() {
            DVec3::ZERO
        } else {
            DVec3::from_slice(&named)
        };
        assert_eq!(origin.as_vec3().as_dvec3(), origin, "32-bit readers have the same one");
        let buffer = placed(&buffer.bytes().await.expect("bytes"), origin);
        assert_near("the buffer", &buffer, &shape, 1e-6);
        answered.push(answers(&server, &far, place, &shape).await);
    }
    for ((what, near), (_, there)) in answered[0].iter().zip(&answered[1]) {
        assert_near(what, there, near, 1e-6);
    }

    // A stream's frames as well, in floats and in steps.
    for (encoding, within_step) in [(pb::frame::Encoding::F32, 1e-6), (pb::frame::Encoding::Meshopt, 2e-4)] {
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
        let pose = pb::Pose {
            seq: 1,
            commit: true,
            ..pose
        };
        requests
            .send(message(pb::deform_request::Message::Pose(pose)))
            .await
            .expect("sent");
        let mut reader = pliant::wire::frames::FrameReader::new(shape.len());
        let part = loop {
            let next = within("a frame", responses.next())
                .await
                .expect("a response")
                .expect("no error");
            if let Some(deform_response::Message::Frame(part)) = next.message
                && reader.take(&part).expect("a part")
                && part.r#final
            {
                break part;
            }
        };
        let numbers = reader.numbers(pb::frame::Attribute::Position);
        let bytes: Vec<u8> = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let origin = DVec3::from_slice(&part.origin);
        let model = server.content(&path(&far, "/model?format=obj")).await;
        let shape = places_of(&String::from_utf8_lossy(&model));
        assert_near(encoding.as_str_name(), &placed(&bytes, origin), &shape, within_step);
    }
}
