//! A call that comes to the wrong node is sent to the right one, and a call that comes twice happens once, wherever it comes to.

use super::{node, node_with, unmoved};
use crate::durable::place::StorePlace;
use crate::durable::{bar_session, metric, path, seen, turn};
use crate::support::process::needed;
use crate::support::server::{AnsweredCall as _, bar_obj, header, http, within};
use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use pliant::server::grpc::client::DeformerClient;
use pliant::wire::pb;
use serde_json::{Value, json};

#[tokio::test(flavor = "multi_thread")]
async fn a_call_to_the_wrong_node_is_sent_to_the_right_one() {
    let place = needed!(StorePlace::remote().await);
    let (a, b) = (node(&place, "a"), node(&place, "b"));
    let id = bar_session(&a).await;
    turn(&a, &id, 0.4).await;
    let asked = format!("{}{}", b.url, path(&id, "/positions"));
    let sent = unmoved().get(&asked).answer().await;
    let header = |answer: &reqwest::Response, name: &str| {
        let value = answer.headers().get(name);
        value.map_or_else(String::new, |value| value.to_str().expect("a text").to_owned())
    };
    assert_eq!(sent.status().as_u16(), 307);
    assert_eq!(header(&sent, "x-pliant-owner"), a.url);
    assert_eq!(header(&sent, "x-pliant-node"), "a");
    let location = format!("{}{}?pliant-node=a", a.url, path(&id, "/positions"));
    assert_eq!(header(&sent, "location"), location);
    // As the description of the server says of this call.
    let described: Value = b.done("GET", "/openapi.json", None).await;
    let reply = &described["paths"]["/v1/sessions/{id}/positions"]["get"]["responses"]["307"]["$ref"];
    assert_eq!(reply, "#/components/responses/SentOn");
    let promised = described["components"]["responses"]["SentOn"]["headers"].as_object();
    for name in promised.expect("headers").keys() {
        assert!(!header(&sent, name).is_empty(), "{name}");
    }
    // A client that goes there on its own gets the same in an answer that no library follows.
    let reply = unmoved().get(&asked).header("x-pliant-hops", "0").answer().await;
    assert_eq!(reply.status().as_u16(), 503);
    assert_eq!(
        (header(&reply, "x-pliant-owner"), header(&reply, "location")),
        (a.url.clone(), String::new())
    );
    let problem: Value = reply.json().await.expect("a problem");
    assert_eq!(problem["code"], "UNAVAILABLE");

    let mut client = DeformerClient::connect(b.url.clone()).await.expect("a connection");
    let request = pb::SessionRequest { session_id: id.clone() };
    let refused = client.get_session(request).await.expect_err("it is elsewhere");
    assert_eq!(refused.code(), tonic::Code::Unavailable);
    let reply = |name: &str| {
        refused
            .metadata()
            .get(name)
            .map(|value| value.to_str().expect("a text").to_owned())
    };
    assert_eq!(reply("x-pliant-owner"), Some(a.url.clone()));
    assert_eq!(reply("x-pliant-node").as_deref(), Some("a"));

    // Who follows sees at one node what the other one has, and changes it there.
    assert_eq!(seen(&b, &id).await, seen(&a, &id).await);
    turn(&b, &id, 0.7).await;
    assert_eq!(seen(&b, &id).await, seen(&a, &id).await);
    let (status, _) = b.call("GET", &path("00000000000000000000000000000000", ""), None).await;
    assert_eq!(status, 404, "what nobody has is nowhere");
    b.done("DELETE", &path(&id, ""), None).await;
    assert_eq!(a.call("GET", &path(&id, ""), None).await.0, 404);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_call_that_comes_twice_happens_once_wherever_it_comes_to() {
    let place = needed!(StorePlace::remote().await);
    let (a, b) = (node(&place, "a"), node(&place, "b"));
    let create = async |url: &str, model: String| {
        let sent = http()
            .post(format!("{url}/v1/sessions"))
            .header("idempotency-key", "once");
        let answer = sent.body(model).answer().await;
        let status = answer.status().as_u16();
        (status, answer.json::<Value>().await.expect("JSON"))
    };
    // Both at the same time: one is first, the other one is asked to ask again or gets the same.
    let model = bar_obj(12);
    let (one, other) = tokio::join!(create(&a.url, model.clone()), create(&b.url, model.clone()));
    let statuses = [one.0, other.0];
    assert!(statuses.contains(&201), "{statuses:?}");
    assert!(
        statuses.iter().all(|status| [200, 201, 409].contains(status)),
        "{statuses:?}"
    );
    let first = if one.0 == 201 { one.1 } else { other.1 };
    for url in [&a.url, &b.url] {
        let (status, again) = create(url, model.clone()).await;
        assert_eq!((status, &again["id"]), (200, &first["id"]), "{again}");
        assert_eq!(
            create(url, bar_obj(7)).await.0,
            422,
            "another request under the same key"
        );
    }
    assert_eq!(place.count("sessions").await, 1);
    let id = first["id"].as_str().expect("an id").to_owned();
    let handles = json!({"handles": crate::support::server::ends()});
    a.done("PUT", &path(&id, "/handles"), Some(&handles)).await;
    let solve = crate::support::server::turn_json(0.5);
    let mut revisions = Vec::new();
    for server in [&a, &b, &a] {
        let (status, answer) = server
            .call_with_key("POST", &path(&id, "/solve"), Some(&solve), Some("solved-once"))
            .await;
        assert_eq!(status, 200, "{answer}");
        revisions.push(answer["revision"].clone());
    }
    assert!(revisions.iter().all(|r| r == &revisions[0]), "{revisions:?}");
    // Sessions are numbered across nodes, so that lists report each of them once.
    for server in [&a, &b, &a] {
        server.open(bar_obj(7), "").await;
    }
    for server in [&a, &b] {
        let list = server.done("GET", "/v1/sessions", None).await;
        assert_eq!(list["sessions"].as_array().expect("a list").len(), 4, "{list}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn no_server_has_the_store_for_itself_beside_nodes() {
    let place = needed!(StorePlace::remote().await);
    let a = node(&place, "a");
    place.refuses_to_start(&[], &["in use by another process"]);
    let pruned = place.store(&["prune"]);
    assert_eq!(pruned.code, 2, "{}", pruned.err);
    assert!(pruned.err.contains("in use by another process"), "{}", pruned.err);
    let id = bar_session(&a).await;
    let before = seen(&a, &id).await;
    a.stop().await;
    // One that has it for itself goes on with what nodes made, and nodes with what it made.
    let alone = place.start(&[]);
    assert_eq!(seen(&alone, &id).await, before);
    turn(&alone, &id, 0.3).await;
    let other = bar_session(&alone).await;
    let arguments = ["--advertise", "http://127.0.0.1:0"];
    let refused = place.start_logged("log-b", place.database().map(|d| d.url.as_str()), &arguments);
    let reply = refused.err().expect("refused");
    assert!(reply.contains("in use by another process"), "{reply}");
    let after = (seen(&alone, &id).await, seen(&alone, &other).await);
    alone.stop().await;
    let b = node(&place, "b");
    assert_eq!((seen(&b, &id).await, seen(&b, &other).await), after);
    let third = bar_session(&b).await;
    assert_eq!(
        b.done("GET", "/v1/sessions", None).await["sessions"]
            .as_array()
            .map(Vec::len),
        Some(3),
        "{third}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_session_goes_where_there_is_more_room() {
    let place = needed!(StorePlace::remote().await);
    let (small, large) = (node_with(&place, "small", &["--sessions", "2"]), node(&place, "large"));
    let create = async |client: reqwest::Client, to: &str| {
        let sent = client.post(format!("{to}/v1/sessions")).body(bar_obj(7)).send();
        within("an answer", sent).await.expect("an answer")
    };
    // Both are empty: it stays. Then half of the small one is taken, and none of the large one.
    assert_eq!(create(unmoved(), &small.url).await.status().as_u16(), 201);
    let sent = create(unmoved(), &small.url).await;
    assert_eq!(sent.status().as_u16(), 307);
    let location = header(&sent, "location");
    assert_eq!(location, format!("{}/v1/sessions?pliant-node=large", large.url));
    for _ in 0..3 {
        assert_eq!(
            create(http(), &small.url).await.status().as_u16(),
            201,
            "who follows has a session"
        );
    }
    assert_eq!(metric(&small, "pliant_sessions ").await, 1.0);
    assert_eq!(metric(&large, "pliant_sessions ").await, 3.0);
    // Whom another node has sent stays: no one is sent around.
    let stays = unmoved()
        .post(format!("{}/v1/sessions", small.url))
        .header("x-pliant-node", "small");
    let stays = stays.body(bar_obj(7)).answer().await;
    assert_eq!(stays.status().as_u16(), 201);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_merge_with_a_session_of_another_node_says_where_that_is() {
    let place = needed!(StorePlace::remote().await);
    let (a, b) = (node(&place, "a"), node(&place, "b"));
    let (here, there) = (bar_session(&a).await, bar_session(&b).await);
    turn(&b, &there, 0.4).await;
    let merge = |source: &str, value: &str| json!({"merge": {source: value, "how": "LOOSE"}});
    let before = seen(&a, &here).await;
    let merged = a
        .call("POST", &path(&here, "/edits"), Some(&merge("session", &there)))
        .await;
    let (status, reply) = merged;
    assert_eq!(
        (status, &reply["code"]),
        (409, &"FAILED_PRECONDITION".into()),
        "{reply}"
    );
    let said = reply["detail"].as_str().unwrap_or_default();
    assert!(said.contains(&b.url) && said.contains("\"b\""), "{reply}");
    assert_eq!(seen(&a, &here).await, before);
    // What it says to do works, from the node that was asked first.
    let model = format!("{}{}?format=obj", a.url, path(&there, "/model"));
    let model = http().get(model).answer().await;
    let model = BASE64_STANDARD.encode(model.bytes().await.expect("a body"));
    a.done("POST", &path(&here, "/edits"), Some(&merge("model", &model)))
        .await;
    let after = a.done("GET", &path(&here, ""), None).await;
    assert_ne!(after["primitives"], before.0["primitives"], "{after}");
}
