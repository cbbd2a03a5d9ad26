//! Points and models carried along with a session's shape.

use super::post;
use crate::support::gltf_parsed::parse;
use crate::support::server::*;
use crate::support::skinning::world_transforms;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use pliant::wire::pb;
use serde_json::{Value, json};

async fn carry(server: &Server, id: &str, body: Value) -> Value {
    let answer = post(server, &format!("/v1/sessions/{id}/carry"), body).await;
    assert_eq!(answer.status(), 200);
    answer.json().await.expect("JSON")
}

fn numbers(value: &Value) -> Vec<f64> {
    let list = value.as_array().expect("a list");
    list.iter().map(|v| v.as_f64().expect("a number")).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn points_and_a_model_ride_along_through_poses_undo_and_edits() {
    let (server, id) = Server::start_with_bar().await;
    // Above the top of the bar, beside it, and inside its held base.
    let points = json!([0.25, 0.25, 4.3, 0.65, 0.25, 3.95, 0.25, 0.25, 0.125]);
    let rest = carry(&server, &id, json!({"points": points})).await;
    assert_eq!(rest["points"], points);
    assert_eq!(
        (&rest["scales"], &rest["revision"]),
        (&json!([1.0, 1.0, 1.0]), &json!("2"))
    );

    let solved = post(&server, &format!("/v1/sessions/{id}/solve"), turn_json(1.0)).await;
    assert_eq!(solved.status(), 200);
    let quarter = [
        0.0,
        0.0,
        std::f64::consts::FRAC_1_SQRT_2,
        std::f64::consts::FRAC_1_SQRT_2,
    ];
    let axes: Vec<f64> = [quarter; 3].concat();
    let order = json!({"points": points, "rotations": axes});
    let posed = carry(&server, &id, order.clone()).await;
    let now = numbers(&posed["points"]);
    // The top turns by a radian about the bar's middle and rises by a quarter.
    let beside = [0.25 + 0.4 * 1f64.cos(), 0.25 + 0.4 * 1f64.sin(), 4.2];
    for (at, expected) in [(0, [0.25, 0.25, 4.55]), (3, beside), (6, [0.25, 0.25, 0.125])] {
        for k in 0..3 {
            assert!(
                (now[at + k] - expected[k]).abs() < 0.05,
                "point {}: {:?}",
                at / 3,
                &now[at..at + 3]
            );
        }
    }
    let turned = numbers(&posed["rotations"]);
    // A quaternion and its negative are one rotation.
    let angle = |q: &[f64]| 2.0 * (q[2] * q[3].signum()).atan2(q[3].abs());
    assert!(
        (angle(&turned[..4]) - 1.0 - std::f64::consts::FRAC_PI_2).abs() < 0.05,
        "{turned:?}"
    );
    assert!(
        (angle(&turned[8..]) - std::f64::consts::FRAC_PI_2).abs() < 0.02,
        "{turned:?}"
    );

    // A model of the same bar goes where the bar goes.
    let model = STANDARD.encode(bar_obj(8));
    let answer = carry(&server, &id, json!({"model": model, "format": "obj"})).await;
    let text = String::from_utf8(
        STANDARD
            .decode(answer["model"].as_str().expect("bytes"))
            .expect("base64"),
    );
    let text = text.expect("a text");
    let heights = text
        .lines()
        .filter_map(|l| l.strip_prefix("v ")?.split(' ').nth(2)?.parse::<f64>().ok());
    let highest = heights.fold(f64::MIN, f64::max);
    assert!((highest - 4.25).abs() < 1e-3, "{highest}");

    // The same over gRPC, bit for bit.
    let mut client = server.grpc().await;
    let request: pb::CarryRequest = pliant::wire::json::from_json(order.to_string().as_bytes()).expect("a request");
    let request = pb::CarryRequest {
        session_id: id.clone(),
        ..request
    };
    let reply = client.carry(request).await.expect("an answer").into_inner();
    assert_eq!(reply.points, now);

    // Undo goes back, redo forward, and an edit of the current shape makes it the rest pose.
    for (step, expected) in [("undo", &rest["points"]), ("redo", &posed["points"])] {
        assert_eq!(
            post(&server, &format!("/v1/sessions/{id}/{step}"), json!({}))
                .await
                .status(),
            200
        );
        assert_eq!(
            &carry(&server, &id, json!({"points": points})).await["points"],
            expected
        );
    }
    let cut = json!({"subdivide": {"scheme": "MIDPOINT"}});
    assert_eq!(
        post(&server, &format!("/v1/sessions/{id}/edits"), cut).await.status(),
        200
    );
    let again = carry(&server, &id, json!({"points": now})).await;
    assert_eq!(numbers(&again["points"]), now);
    let session = server.document(&format!("/v1/sessions/{id}")).await;
    assert_eq!(session["revision"], again["revision"], "carrying commits nothing");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_carried_is_reported_by_its_field() {
    let (server, id) = Server::start_with_bar().await;
    let path = format!("/v1/sessions/{id}/carry");
    for (body, field) in [
        (json!({}), "points"),
        (json!({"points": [1, 2]}), "points"),
        (json!({"points": [1, 2, "NaN"]}), "points[2]"),
        (json!({"points": [1, 2, 3], "rotations": [0, 0, 0, 3]}), "rotations[0]"),
        (json!({"points": [1, 2, 3], "rotations": [0, 0, 1]}), "rotations"),
        (json!({"points": [1, 2, 3], "format": "obj"}), "format"),
        (json!({"model": STANDARD.encode("v 0 0 0"), "format": "xyz"}), "format"),
    ] {
        let answer = post(&server, &path, body.clone()).await;
        assert_eq!(answer.status(), 422, "{body}");
        let problem: Value = answer.json().await.expect("JSON");
        assert_eq!(problem["errors"][0]["field"], field, "{problem}");
    }
    let broken = post(&server, &path, json!({"model": STANDARD.encode("no model")})).await;
    assert_eq!(broken.status().as_u16() / 100, 4);
    assert_eq!(
        post(&server, "/v1/sessions/none/carry", json!({"points": [0, 0, 0]}))
            .await
            .status(),
        404
    );
    // Passengers that are no part of the model's file are a job's.
    let points = json!({"passengers": [{"points": {"positions": [0, 0, 0]}}]});
    let mut client = server.grpc().await;
    let options: pb::CreateOptions = pliant::wire::json::from_json(points.to_string().as_bytes()).expect("options");
    let first = pb::CreateSessionRequest {
        message: Some(pb::create_session_request::Message::Options(options)),
    };
    let chunk = pb::CreateSessionRequest {
        message: Some(pb::create_session_request::Message::Chunk(bar_obj(4).into())),
    };
    let refused = client
        .create_session(futures::stream::iter([first, chunk]))
        .await
        .expect_err("refused");
    assert!(refused.message().contains("passengers[0].points"), "{refused:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_of_the_model_rides_along_through_poses_edits_and_undo() {
    let server = Server::start().await;
    let options = json!({"rig": "KEEP", "passengers": [{"primitivesNamed": "lod1"}, {"nodesNamed": "hatSocket"}]});
    let options =
        percent_encoding::utf8_percent_encode(&options.to_string(), percent_encoding::NON_ALPHANUMERIC).to_string();
    let opened = server
        .post(&format!("/v1/sessions?sample=figure&options={options}"))
        .document()
        .await;
    let id = opened["id"].as_str().expect("an id");
    let path = |rest: &str| format!("/v1/sessions/{id}/{rest}");
    // Where the exported file has the socket, seen by another reader.
    let exported = async || {
        let file = server.content(&path("model?format=glb")).await;
        let file = parse(&file, &Default::default());
        let mut nodes = file.json["nodes"].as_array().into_iter().flatten();
        let socket = nodes.position(|node| node["name"] == "hatSocket").expect("a socket");
        world_transforms(&file, None).expect("nodes")[socket].translation
    };
    let at_rest = exported().await;
    let points = json!({"points": at_rest.to_array()});
    let handles = json!({"handles": [
        {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.3}}},
        {"id": "head", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.54}}},
    ]});
    let set = server.put(&path("handles")).json(&handles).send();
    assert_eq!(within("handles", set).await.unwrap().status(), 200);
    let turn = |x: f64| json!({"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0.2, 0.6, 0], "translation": [x, 0.1, 0]}}]}});
    assert_eq!(post(&server, &path("solve"), turn(0.1)).await.status(), 200);
    let carried = glam::DVec3::from_slice(&numbers(&carry(&server, id, points).await["points"]));
    let bent = exported().await;
    assert!(
        bent.distance(carried) < 2e-6 && bent.distance(at_rest) > 0.05,
        "{bent} {carried}"
    );

    // What the edit sees becomes the rest pose, and the socket rides on from there.
    let finer = json!({"on": "CURRENT", "subdivide": {"scheme": "MIDPOINT"}});
    let edited = post(&server, &path("edits"), finer).await;
    assert_eq!(edited.status(), 200, "{}", edited.text().await.unwrap());
    assert!(exported().await.distance(bent) < 2e-6);
    let points = json!({"points": bent.to_array()});
    assert_eq!(post(&server, &path("solve"), turn(-0.2)).await.status(), 200);
    let carried = glam::DVec3::from_slice(&numbers(&carry(&server, id, points).await["points"]));
    let on = exported().await;
    assert!(
        on.distance(carried) < 4e-6 && on.distance(bent) > 0.05,
        "{on} {carried}"
    );
    for (way, wanted) in [
        ("undo", bent),
        ("undo", bent),
        ("redo", bent),
        ("redo", on),
        ("undo", bent),
    ] {
        assert_eq!(post(&server, &path(way), json!({})).await.status(), 200);
        assert!(exported().await.distance(wanted) < 2e-6, "{way}");
    }
    for _ in 0..2 {
        post(&server, &path("undo"), json!({})).await;
    }
    assert_eq!(exported().await, at_rest);
}
