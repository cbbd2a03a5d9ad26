//! Where a session's surface passes through itself.

use super::post;
use crate::support::server::*;
use crate::support::shapes::{both, moved, obj_text};
use glam::DVec3;
use pliant::asset::shapes;
use pliant::wire::pb;
use serde_json::{Value, json};

/// Two boxes without a common point: the second lies at `x`.
fn boxes(x: f64) -> Vec<u8> {
    let mut text = String::new();
    for from in [0.0, x] {
        for k in 0..8 {
            let [a, b, c] = [k & 1, k >> 1 & 1, k >> 2].map(f64::from);
            text += &format!("v {} {} {}\n", from + a, 0.1 * from + b, 0.1 * from + c);
        }
    }
    for first in [1, 9] {
        for quad in [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ] {
            let [a, b, c, d] = quad.map(|k| k + first);
            text += &format!("f {a} {b} {c}\nf {a} {c} {d}\n");
        }
    }
    text.into_bytes()
}

async fn crossings(server: &Server, id: &str, body: Value) -> Value {
    let answer = post(server, &format!("/v1/sessions/{id}/crossings"), body).await;
    assert_eq!(answer.status(), 200);
    answer.json().await.expect("JSON")
}

fn triangles(list: &Value) -> Vec<u64> {
    let list = list.as_array().expect("a list");
    list.iter().map(|t| t.as_u64().expect("a number")).collect()
}

/// A session of boxes, the second of which was dragged by `way` along x.
async fn dragged(server: &Server, x: f64, way: f64) -> String {
    let options = "%7B%22parts%22:%22SEPARATE%22,%22components%22:%22FREE%22%7D";
    let url = format!("/v1/sessions?format=obj&options={options}");
    let opened = server.post(&url).body(boxes(x)).document().await;
    let id = opened["id"].as_str().expect("an id").to_owned();
    let handles = json!({"handles": [{"id": "a", "region": {"component": {"index": 0}}}, {"id": "b", "region": {"component": {"index": 1}}}]});
    let set = server
        .put(&format!("/v1/sessions/{id}/handles"))
        .json(&handles)
        .answer()
        .await;
    assert_eq!(set.status(), 200);
    let pose = json!({"pose": {"handles": [{"id": "b", "pose": {"translation": [way, 0, 0]}}]}});
    let solved = post(server, &format!("/v1/sessions/{id}/solve"), pose).await;
    assert_eq!(solved.status(), 200);
    id
}

#[tokio::test(flavor = "multi_thread")]
async fn triangles_that_cross_are_named_up_to_a_limit() {
    let server = Server::start().await;
    let id = dragged(&server, 2.0, -1.5).await;
    let all = crossings(&server, &id, json!({})).await;
    let named = triangles(&all["triangles"]);
    assert!(
        named.iter().any(|t| *t < 12) && named.iter().any(|t| *t >= 12),
        "of both boxes: {named:?}"
    );
    assert!(named.is_sorted() && named.len() < 24);
    assert_eq!(all["total"], named.len());
    assert_eq!(all["totalAtRest"].as_u64().unwrap_or_default(), 0);
    let first = crossings(&server, &id, json!({"limit": 1})).await;
    assert_eq!(
        (triangles(&first["triangles"]), &first["total"]),
        (named[..1].to_vec(), &all["total"])
    );

    let mut client = server.grpc().await;
    let request = pb::CrossingsRequest {
        session_id: id.clone(),
        ..Default::default()
    };
    let reply = client.crossings(request).await.expect("an answer").into_inner();
    assert_eq!(reply.triangles.iter().map(|t| u64::from(*t)).collect::<Vec<_>>(), named);
    let session = server.document(&format!("/v1/sessions/{id}")).await;
    assert_eq!(session["revision"], all["revision"]);

    // What crossed in the rest pose is listed apart, and undone it is all that there is.
    let both = dragged(&server, 0.5, 0.2).await;
    let still = crossings(&server, &both, json!({})).await;
    assert!(!triangles(&still["atRest"]).is_empty(), "{still}");
    let undone = post(&server, &format!("/v1/sessions/{both}/undo"), json!({})).await;
    assert_eq!(undone.status(), 200);
    let rest = crossings(&server, &both, json!({})).await;
    assert_eq!(rest["total"].as_u64().unwrap_or_default(), 0);

    assert_eq!(all["pairs"], json!([]), "nobody asked");

    let refused = post(
        &server,
        &format!("/v1/sessions/{id}/crossings"),
        json!({"limit": 1_000_001}),
    )
    .await;
    assert_eq!(refused.status(), 422);
    let problem: Value = refused.json().await.expect("JSON");
    assert_eq!(problem["errors"][0]["field"], "limit", "{problem}");
}

#[tokio::test(flavor = "multi_thread")]
async fn pairs_say_where_they_cross_how_deep_and_whether_handles_hold_them() {
    let server = Server::start().await;
    let id = dragged(&server, 2.0, -1.5).await;
    let found = crossings(&server, &id, json!({"pairs": true})).await;
    let pairs = found["pairs"].as_array().expect("pairs");
    let named = triangles(&found["triangles"]);
    let of_pairs = pairs
        .iter()
        .flat_map(|pair| ["first", "second"].map(|side| pair[side].as_u64().unwrap_or_default()));
    let mut of_pairs: Vec<u64> = of_pairs.collect();
    of_pairs.sort_unstable();
    of_pairs.dedup();
    assert_eq!(of_pairs, named, "the same triangles");
    // Both boxes are handles, so that nothing but their poses parts them.
    assert_eq!(found["heldPairs"], pairs.len(), "{found}");
    assert_eq!(found["newPairs"].as_u64().unwrap_or_default(), 0);
    for pair in pairs {
        assert_eq!(pair["kind"], "HELD");
        let depth = pair["depth"].as_f64().unwrap_or_default();
        assert!(depth > 0.0 && depth < 1.0, "{pair}");
        // The boxes share 0.5 to 1 along x.
        let x = pair["at"][0].as_f64().expect("a place");
        assert!((0.5..=1.0).contains(&x), "{pair}");
    }
    let one = crossings(&server, &id, json!({"pairs": true, "limit": 1})).await;
    assert_eq!(one["pairs"].as_array().map(Vec::as_slice), Some(&pairs[..1]));
    assert_eq!(one["heldPairs"], pairs.len());

    let both = dragged(&server, 0.5, 0.2).await;
    let still = crossings(&server, &both, json!({"pairs": true})).await;
    assert!(still["atRestPairs"].as_u64() > Some(0), "{still}");
    assert!(
        still["pairs"]
            .as_array()
            .is_some_and(|all| all.iter().any(|pair| pair["kind"] == "AT_REST"))
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_that_crosses_itself_is_freed_of_that_and_undo_brings_it_back() {
    let server = Server::start().await;
    let ball = shapes::icosphere(0.5, 3);
    let other = moved(ball.clone(), |p| p + DVec3::new(0.9, 0.02, 0.01));
    let opened = server
        .post("/v1/sessions?format=obj")
        .body(obj_text(&both(ball, other)))
        .document()
        .await;
    let id = opened["id"].as_str().expect("an id").to_owned();
    let at_rest = |found: &Value| found["totalAtRest"].as_u64().unwrap_or_default();
    let before = at_rest(&crossings(&server, &id, json!({})).await);
    assert!(before > 0, "the balls cross");

    let path = format!("/v1/sessions/{id}/edits");
    let answer = post(&server, &path, json!({"unintersect": {}})).await;
    assert_eq!(answer.status(), 200);
    let edited: Value = answer.json().await.expect("JSON");
    let report = &edited["unintersect"];
    // 64-bit numbers are text in JSON.
    assert_ne!(report["crossingsBefore"], "0", "{report}");
    assert_eq!(report["crossings"], "0", "{report}");
    assert_eq!(at_rest(&crossings(&server, &id, json!({})).await), 0);

    let undone = post(&server, &format!("/v1/sessions/{id}/undo"), json!({})).await;
    assert_eq!(undone.status(), 200);
    assert_eq!(at_rest(&crossings(&server, &id, json!({})).await), before);
    // A second time there is nothing to do where all is fixed.
    let fixed = json!({"unintersect": {"fixed": {"halfSpace": {"normal": [1, 0, 0], "offset": -10}}}});
    let kept: Value = post(&server, &path, fixed).await.json().await.expect("JSON");
    assert_eq!(kept["unintersect"]["movedVertices"].as_u64().unwrap_or_default(), 0);
    let warnings = kept["warnings"].as_array().cloned().unwrap_or_default();
    assert!(warnings.iter().any(|w| w["code"] == "contact-left"), "{kept}");

    let refused = post(&server, &path, json!({"unintersect": {"clearance": -1}})).await;
    assert_eq!(refused.status(), 422);
    assert!(refused.text().await.expect("text").contains("unintersect.clearance"));
}
