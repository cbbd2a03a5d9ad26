//! Rigs that are made of a session's model.

use super::post;
use crate::support::server::*;
use pliant::wire::pb;
use serde_json::{Value, json};

async fn rig(server: &Server, id: &str, body: Value) -> Value {
    let answer = post(server, &format!("/v1/sessions/{id}/rig"), body).await;
    assert_eq!(answer.status(), 200);
    answer.json().await.expect("JSON")
}

fn joint<'a>(made: &'a Value, name: &str) -> &'a Value {
    let joints = made["joints"].as_array().expect("joints");
    joints.iter().find(|joint| joint["name"] == name).expect(name)
}

#[tokio::test(flavor = "multi_thread")]
async fn joints_are_told_and_stay_where_they_are_put() {
    let server = Server::start().await;
    let opened = server.post("/v1/sessions?sample=figure").document().await;
    let id = opened["id"].as_str().expect("an id").to_owned();
    assert_eq!(rig(&server, &id, json!({})).await["source"], "skin");
    let found = rig(&server, &id, json!({"preset": "cmu"})).await;
    let at = joint(&found, "lElbow")["at"].as_array().expect("a place").clone();
    let put: Vec<f64> = at.iter().map(|x| x.as_f64().expect("a number") + 0.01).collect();
    let order = json!({"preset": "cmu", "joints": {"lElbow": {"at": put}}});
    let corrected = rig(&server, &id, order.clone()).await;
    let own = joint(&corrected, "lElbow");
    assert_eq!((&own["at"], &own["score"]), (&json!(put), &json!(1.0)), "it stays");
    assert_eq!(
        corrected["rig"]["joints"]["lElbow"]["at"],
        json!(put),
        "in the rig, too"
    );
    assert_eq!(
        joint(&corrected, "rElbow")["at"],
        joint(&found, "rElbow")["at"],
        "the other arm is as it was"
    );

    // What a recording is to be driven by is taken as it is.
    let mut client = server.grpc().await;
    let request: pb::MakeRigRequest = pliant::wire::json::from_json(order.to_string().as_bytes()).expect("a request");
    let request = pb::MakeRigRequest {
        session_id: id.clone(),
        ..request
    };
    let reply = client.make_rig(request).await.expect("an answer").into_inner();
    assert_eq!(
        reply.joints.len(),
        corrected["joints"].as_array().expect("joints").len()
    );
    let motion = pliant::wire::motion_rig(&reply.rig.expect("a rig")).expect("a rig that animate takes");
    assert!(
        motion
            .bones
            .iter()
            .any(|bone| bone.to.to_array()[..] == put[..] || bone.from.to_array()[..] == put[..])
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_makes_no_rig_is_reported_by_its_field_and_doubts_are_told() {
    let server = Server::start().await;
    let opened = server.post("/v1/sessions?sample=creature").document().await;
    let id = opened["id"].as_str().expect("an id").to_owned();
    let path = format!("/v1/sessions/{id}/rig");
    for (body, field) in [
        (json!({"joints": {"tail": {"at": [0, 0, 0]}}}), "joints.tail"),
        (json!({"joints": {"lHip": {"at": [0, 0]}}}), "joints.lHip"),
        (json!({"up": "w"}), "up"),
        (json!({"up": "z", "front": "-z"}), "front"),
        (json!({"preset": "other"}), "preset"),
        (json!({"joints": {"lElbow": {"at": [1e30, 0, 0]}}}), "joints.lElbow"),
    ] {
        let answer = post(&server, &path, body.clone()).await;
        assert_eq!(answer.status(), 422, "{body}");
        let problem: Value = answer.json().await.expect("JSON");
        assert_eq!(problem["errors"][0]["field"], field, "{problem}");
    }
    let answer = post(&server, &path, json!({"bvh": "bm90aGluZw=="})).await;
    assert_eq!(answer.status(), 400);
    let problem: Value = answer.json().await.expect("JSON");
    assert_eq!(problem["errors"][0]["field"], "bvh", "{problem}");
    // A creature with four legs is not a figure; where joints would be and what speaks against them is returned all the same.
    let made = rig(&server, &id, json!({})).await;
    let joints = made["joints"].as_array().expect("joints");
    let doubtful: Vec<&Value> = joints.iter().filter(|joint| joint["doubtful"] == true).collect();
    assert!(!doubtful.is_empty(), "{made}");
    assert!(
        doubtful
            .iter()
            .all(|joint| !joint["reason"].as_str().unwrap_or_default().is_empty())
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rig_is_made_of_what_edits_have_left_of_a_model() {
    let server = Server::start().await;
    let opened = server.post("/v1/sessions?sample=figure").document().await;
    let id = opened["id"].as_str().expect("an id").to_owned();
    let order = json!({"preset": "cmu", "up": "y", "front": "z"});
    let whole = rig(&server, &id, order.clone()).await;
    let knee = joint(&whole, "lKnee")["at"][1].as_f64().expect("a height");
    let cut = json!({"cut": {"plane": {"normal": [0, 1, 0], "offset": knee}, "keep": "ABOVE", "fill": true}});
    let edited = post(&server, &format!("/v1/sessions/{id}/edits"), cut).await;
    assert_eq!(edited.status(), 200);
    let rest = rig(&server, &id, order).await;
    for name in ["lAnkle", "rAnkle"] {
        assert_eq!(joint(&whole, name)["inside"], true, "{whole}");
        assert_ne!(joint(&rest, name)["inside"], true, "there are no feet any more: {rest}");
    }
    assert_eq!(joint(&rest, "lShoulder")["inside"], true, "{rest}");
}
