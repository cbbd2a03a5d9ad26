//! gRPC: every rpc, the status codes and their details, deadlines, health, reflection, gRPC-Web.

mod around;

use crate::support::server::*;
use bytes::Bytes;
use futures::StreamExt as _;
use pliant::wire::pb::{self, create_session_request::Message as Upload};
use tonic::{Code, Request};
use tonic_types::StatusExt as _;

fn upload(messages: Vec<Upload>) -> impl futures::Stream<Item = pb::CreateSessionRequest> + Send + 'static {
    futures::stream::iter(
        messages
            .into_iter()
            .map(|message| pb::CreateSessionRequest { message: Some(message) }),
    )
}

fn chunks(model: &str, size: usize) -> Vec<Upload> {
    model
        .as_bytes()
        .chunks(size)
        .map(|chunk| Upload::Chunk(Bytes::copy_from_slice(chunk)))
        .collect()
}

/// The field that a refusal names; empty where it names none.
fn field_of(refused: &tonic::Status) -> String {
    let request = refused.get_error_details().bad_request().cloned();
    request.map(|b| b.field_violations[0].field.clone()).unwrap_or_default()
}

fn named(id: &str) -> pb::SessionRequest {
    pb::SessionRequest {
        session_id: id.to_owned(),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_rpc_answers() {
    let server = Server::start().await;
    let mut client = server.grpc().await;
    let model = bar_obj(24);
    let mut messages = vec![Upload::Options(pb::CreateOptions {
        label: "bar".into(),
        ..pb::CreateOptions::default()
    })];
    messages.extend(chunks(&model, 1000));
    let session = client.create_session(upload(messages)).await.unwrap().into_inner();
    let id = session.id.clone();
    assert_eq!(
        (session.label.as_str(), session.model.as_ref().map(|m| m.bytes)),
        ("bar", Some(model.len() as u64))
    );

    assert_eq!(client.get_session(named(&id)).await.unwrap().into_inner().id, id);
    let list = client.list_sessions(pb::ListSessionsRequest::default()).await.unwrap();
    assert_eq!(list.into_inner().sessions.len(), 1);
    let limits = client.get_limits(pb::GetLimitsRequest {}).await.unwrap().into_inner();
    assert_eq!(limits.part_bytes, 1 << 20);

    let handles = pb::SetHandlesRequest {
        session_id: id.clone(),
        handles: end_handles(),
        ..pb::SetHandlesRequest::default()
    };
    let held = client.set_handles(handles).await.unwrap().into_inner();
    assert_eq!(held.handles.len(), 2);
    assert!(held.revision > session.revision);

    let frames = client.solve(turn_request(&id, 7, 0.5)).await.unwrap().into_inner();
    let frames: Vec<pb::Frame> = frames.map(Result::unwrap).collect().await;
    assert_eq!(frames.len(), 1);
    assert_eq!((frames[0].seq, frames[0].r#final, frames[0].parts), (7, true, 1));
    let bent = floats(&frames[0].data);
    assert_eq!(bent.len() as u32, 3 * session.model.unwrap().vertices);

    let chunks: Vec<pb::Chunk> = export(&mut client, &id, "").await.unwrap();
    let exported: Vec<u8> = chunks.iter().flat_map(|c| c.data.to_vec()).collect();
    let text = String::from_utf8(exported).unwrap();
    assert_ne!(text, model);
    assert_eq!(text.lines().count(), model.lines().count());
    let ply = export(&mut client, &id, "ply").await.unwrap();
    assert!(ply[0].data.starts_with(b"ply"));

    let undone = client.undo(named(&id)).await.unwrap().into_inner();
    let redone = client.redo(named(&id)).await.unwrap().into_inner();
    assert!(redone.revision > undone.revision);
    let history = client.history(named(&id)).await.unwrap().into_inner();
    let kinds: Vec<&str> = history.commits.iter().map(|c| c.kind.as_str()).collect();
    assert_eq!(kinds, ["create", "handles", "pose"]);

    client.delete_session(named(&id)).await.unwrap();
    assert_eq!(client.get_session(named(&id)).await.unwrap_err().code(), Code::NotFound);
}

#[tokio::test(flavor = "multi_thread")]
async fn stiff_parts_and_free_rotations_are_one_thing_by_both_protocols() {
    let (server, id) = Server::start_with_bar().await;
    let stiff = serde_json::json!({"regions": [{"sphere": {"center": [0.5, 0.5, 2], "radius": 0.8}}]});
    let pose = serde_json::json!({"translation": [1.5, 0, -0.5], "freeRotation": true});
    let body = serde_json::json!({"handles": ends(), "stiff": stiff});
    let put = server.put(&path(&id, "/handles")).json(&body).document().await;
    assert_eq!(put["solver"]["stiffParts"], 1, "{put}");
    let solve = serde_json::json!({"pose": {"handles": [{"id": "top", "pose": pose}]}});
    let solved = server.post(&path(&id, "/solve")).json(&solve).document().await;
    let quality = &solved["frames"][0]["quality"];
    assert!(quality["offRigid"].as_f64().is_some_and(|off| off < 1e-9), "{quality}");
    let shown = server.document(&path(&id, "")).await;
    assert_eq!(shown["handles"][1]["pose"]["freeRotation"], true, "{shown}");

    let mut client = server.grpc().await;
    let other = server.open(bar_obj(24)).await["id"].as_str().unwrap().to_owned();
    let handles = pb::SetHandlesRequest {
        session_id: other.clone(),
        handles: end_handles(),
        stiff: Some(pliant::wire::json::from_json(stiff.to_string().as_bytes()).unwrap()),
        ..pb::SetHandlesRequest::default()
    };
    let held = client.set_handles(handles.clone()).await.unwrap().into_inner();
    assert_eq!(held.solver.unwrap().stiff_parts, 1);
    let request = pb::SolveRequest {
        session_id: other.clone(),
        pose: Some(pliant::wire::json::from_json(solve["pose"].to_string().as_bytes()).unwrap()),
        options: None,
    };
    let frames = client.solve(request).await.unwrap().into_inner();
    let frames: Vec<pb::Frame> = frames.map(Result::unwrap).collect().await;
    let positions = server.content(&path(&id, "/positions")).await;
    assert_eq!(floats(&frames[0].data), floats(&positions));

    let mut wrong = handles.clone();
    wrong.stiff.as_mut().unwrap().strength = Some(2.0);
    assert_eq!(
        field_of(&client.set_handles(wrong).await.unwrap_err()),
        "stiff.strength"
    );
    let mut missing = handles;
    missing.stiff = Some(pb::Stiff {
        components: vec![7],
        ..pb::Stiff::default()
    });
    assert_eq!(
        field_of(&client.set_handles(missing).await.unwrap_err()),
        "stiff.components[0]"
    );
}

type Client = pliant::server::grpc::client::DeformerClient<tonic::transport::Channel>;

async fn export(client: &mut Client, id: &str, format: &str) -> Result<Vec<pb::Chunk>, tonic::Status> {
    let request = pb::ExportRequest {
        session_id: id.to_owned(),
        format: format.to_owned(),
    };
    let mut stream = client.export(request).await?.into_inner();
    let mut chunks = Vec::new();
    while let Some(chunk) = stream.message().await? {
        chunks.push(chunk);
    }
    Ok(chunks)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_transports_give_the_same_bits() {
    let server = Server::start().await;
    let mut client = server.grpc().await;
    let id = server.bar_session().await;
    let body = turn_json(0.5);
    let url = server.url(&path(&id, "/solve"));
    let over_http = http()
        .post(url)
        .json(&body)
        .header("accept", "application/octet-stream")
        .answer()
        .await;
    let over_http = over_http.bytes().await.unwrap();
    let mut frames = client.solve(turn_request(&id, 0, 0.5)).await.unwrap().into_inner();
    let frame = frames.message().await.unwrap().unwrap();
    assert_eq!(frame.data, over_http);
}

#[tokio::test(flavor = "multi_thread")]
async fn failures_carry_code_and_details() {
    let server = Server::with(|sessions, _| sessions.sessions = 1).await;
    let mut client = server.grpc().await;
    let id = server.bar_session().await;

    let missing = client.get_session(named("nobody")).await.unwrap_err();
    assert_eq!(missing.code(), Code::NotFound);
    assert_eq!(missing.get_error_details().error_info().unwrap().reason, "NOT_FOUND");

    let mut handles = end_handles();
    handles[1].pose = Some(pb::HandlePose {
        scale: vec![0.0],
        ..pb::HandlePose::default()
    });
    let handles = pb::SetHandlesRequest {
        session_id: id.clone(),
        handles,
        ..pb::SetHandlesRequest::default()
    };
    let wrong = client.set_handles(handles).await.unwrap_err();
    assert_eq!(wrong.code(), Code::InvalidArgument);
    assert_eq!(field_of(&wrong), "handles[1].pose.scale", "{wrong}");

    let full = client
        .create_session(upload(chunks(&bar_obj(4), 1000)))
        .await
        .unwrap_err();
    assert_eq!(full.code(), Code::ResourceExhausted);
    assert!(full.get_error_details().retry_info().is_some(), "{full}");
    assert!(full.metadata().contains_key("retry-after"));

    let operation = pb::edit_request::Operation::Weld(pb::edit_request::Weld { tolerance: -0.1 });
    let edit = pb::EditRequest {
        session_id: id.clone(),
        operation: Some(operation),
        ..pb::EditRequest::default()
    };
    let edit = client.edit(edit).await.unwrap_err();
    assert_eq!(edit.code(), Code::InvalidArgument);
    assert!(edit.message().contains("weld.tolerance"), "{edit}");

    let format = export(&mut client, &id, "doc").await.unwrap_err();
    assert_eq!(
        (format.code(), field_of(&format).as_str()),
        (Code::InvalidArgument, "format")
    );

    let forward = client.redo(named(&id)).await.unwrap_err();
    assert_eq!(forward.code(), Code::FailedPrecondition);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_keeps_its_order_and_its_limit() {
    let server = Server::with(|sessions, _| sessions.upload_bytes = 100 << 10).await;
    let mut client = server.grpc().await;
    let options = || Upload::Options(pb::CreateOptions::default());
    let chunk = |bytes: usize| Upload::Chunk(Bytes::from(vec![b'v'; bytes]));
    let companion = |uri: &str| Upload::Companion(pb::Companion { uri: uri.to_owned() });
    let cases: Vec<(Vec<Upload>, Code, &str)> = vec![
        (vec![chunk(10), options()], Code::InvalidArgument, "options"),
        (vec![options(), options()], Code::InvalidArgument, "options"),
        (vec![chunk(10), companion("")], Code::InvalidArgument, "companion.uri"),
        (
            vec![chunk(10), companion("a"), companion("a")],
            Code::InvalidArgument,
            "companion.uri",
        ),
        (
            vec![chunk(60 << 10), companion("a"), chunk(60 << 10)],
            Code::ResourceExhausted,
            "102400",
        ),
        (vec![], Code::InvalidArgument, ""),
    ];
    for (messages, code, word) in cases {
        let refused = client.create_session(upload(messages)).await.unwrap_err();
        assert_eq!(refused.code(), code, "{refused}");
        assert!(
            refused.message().contains(word) || field_of(&refused) == word,
            "{refused}"
        );
    }
    // Refused while it is being sent: an upload without end does end.
    let endless = futures::stream::repeat_with(move || pb::CreateSessionRequest {
        message: Some(Upload::Chunk(Bytes::from(vec![b'v'; 32 << 10]))),
    });
    let refused = within("the refusal of an endless upload", client.create_session(endless))
        .await
        .unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
    assert_eq!(refused.get_error_details().error_info().unwrap().reason, "TOO_LARGE");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_above_the_limit_is_refused() {
    let server = Server::with(|sessions, _| sessions.message_bytes = 64 << 10).await;
    let mut client = server.grpc().await;
    let refused = client
        .create_session(upload(vec![Upload::Chunk(Bytes::from(vec![0; 65 << 10]))]))
        .await
        .unwrap_err();
    assert!(matches!(refused.code(), Code::ResourceExhausted), "{refused}");
    let request = pb::SessionRequest {
        session_id: "x".repeat(65 << 10),
    };
    let refused = client.get_session(request).await.unwrap_err();
    assert!(
        refused.code() == Code::ResourceExhausted && refused.message().contains("too large"),
        "{refused}"
    );
    assert!(client.get_limits(pb::GetLimitsRequest {}).await.is_ok());
}

#[tokio::test(flavor = "multi_thread")]
async fn companions_come_in_the_same_stream() {
    let server = Server::start().await;
    let mut client = server.grpc().await;
    let positions: [f32; 12] = [0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 0., 1.];
    let indices: [u32; 12] = [0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2];
    let mut bin: Vec<u8> = positions.iter().flat_map(|f| f.to_le_bytes()).collect();
    bin.extend(indices.iter().flat_map(|i| i.to_le_bytes()));
    let gltf = serde_json::json!({
        "asset": {"version": "2.0"}, "buffers": [{"uri": "t.bin", "byteLength": 96}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 48}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0,
    })
    .to_string();
    let mut messages = chunks(&gltf, 100);
    messages.push(Upload::Companion(pb::Companion { uri: "t.bin".into() }));
    messages.extend(bin.chunks(50).map(|c| Upload::Chunk(Bytes::copy_from_slice(c))));
    let session = client.create_session(upload(messages)).await.unwrap().into_inner();
    let files = export(&mut client, &session.id, "").await.unwrap();
    assert_eq!(files.iter().map(|c| c.uri.as_str()).collect::<Vec<_>>(), ["", "t.bin"]);
    assert_eq!(files[1].data, bin);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idempotency_key_comes_as_metadata() {
    let server = Server::start().await;
    let mut client = server.grpc().await;
    let mut ids = Vec::new();
    for _ in 0..2 {
        let mut request = Request::new(upload(chunks(&bar_obj(4), 500)));
        request
            .metadata_mut()
            .insert("idempotency-key", "again".parse().unwrap());
        ids.push(client.create_session(request).await.unwrap().into_inner().id);
    }
    assert_eq!(ids[0], ids[1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_hangs_up_stops_its_call() {
    let server = Server::start().await;
    let mut client = server.grpc().await;
    let messages = chunks(&large_bar(), 1 << 20);
    let call = tokio::spawn(async move { client.create_session(upload(messages)).await });
    let busy = || server.manager.metrics().pool_busy.get() > 0;
    eventually("work under way", async || busy() || call.is_finished()).await;
    call.abort();
    eventually("a free slot", async || !busy()).await;
    eventually("the call is counted as cancelled", async || {
        let text = server.get("/metrics").answer().await.text().await.unwrap();
        text.contains("route=\"pliant.v1.Deformer/CreateSession\",code=\"CANCELLED\"")
    })
    .await;
    assert_eq!(server.manager.metrics().sessions.get(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_export_reports_what_followed_with_its_first_piece_and_in_a_header() {
    let server = Server::start().await;
    let mut client = server.grpc().await;
    let url = server.url("/v1/sessions?sample=figure");
    let figure: serde_json::Value = http().post(url).document().await;
    let id = figure["id"].as_str().unwrap().to_owned();
    let handles = serde_json::json!({"handles": [
        {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.08}}},
        {"id": "head", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.54}}}]});
    let url = server.url(&path(&id, "/handles"));
    assert!(http().put(url).json(&handles).answer().await.status().is_success());
    let pose = serde_json::json!({"pose": {"handles": [{"id": "head", "pose": {"translation": [0, 0.2, 0]}}]}});
    let url = server.url(&path(&id, "/solve"));
    assert!(http().post(url).json(&pose).answer().await.status().is_success());

    let chunks = export(&mut client, &id, "").await.unwrap();
    let (first, rest) = chunks.split_first().unwrap();
    let reply = first.followed.as_ref().unwrap();
    assert!(
        reply.joints == 17 && reply.moved_joints > 9 && reply.rewritten_clips == 2,
        "{reply:?}"
    );
    assert!(reply.farthest.iter().any(|joint| joint.name == "head"), "{reply:?}");
    assert!(rest.iter().all(|chunk| chunk.followed.is_none()));
    let url = server.url(&path(&id, "/model"));
    let headers = http().get(url).answer().await.headers().clone();
    let wanted = format!(
        "joints={}/17, clips=2/2, morph-targets=0/0, passengers=0/0, passenger-nodes=0/0",
        reply.moved_joints
    );
    assert_eq!(headers["x-pliant-followed"], wanted.as_str());

    // In another format nothing of the kind is written, and a bar has nothing.
    let bar = server.bar_session().await;
    for (id, format) in [(&id, "obj"), (&bar, "")] {
        let chunks = export(&mut client, id, format).await.unwrap();
        assert!(chunks.iter().all(|chunk| chunk.followed.is_none()), "{format}");
    }
}
