//! Around the service: deadlines, health, reflection, gRPC-Web, unknown methods.

use super::named;
use crate::support::server::*;
use bytes::{Buf as _, Bytes, BytesMut};
use futures::StreamExt as _;
use pliant::wire::pb;
use prost::Message as _;
use tonic::{Code, Request};

#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_ends_a_call_before_and_during_its_answer() {
    let server = Server::start().await;
    let channel = server.channel().await;
    // Raw calls, so that it is the server's clock that ends them and not the client's.
    let mut raw = tonic::client::Grpc::new(channel);
    raw.ready().await.unwrap();
    let id = server.bar_session().await;
    let codec = tonic_prost::ProstCodec::<pb::DeformRequest, pb::DeformResponse>::default();
    let first = pb::DeformRequest {
        session_id: id.clone(),
        message: None,
    };
    // A stream that stays open on both sides: only the deadline can end it.
    let mut request = Request::new(futures::stream::once(async move { first }).chain(futures::stream::pending()));
    request.metadata_mut().insert("grpc-timeout", "300m".parse().unwrap());
    let path = http::uri::PathAndQuery::from_static("/pliant.v1.Deformer/Deform");
    let mut responses = raw.streaming(request, path, codec).await.unwrap().into_inner();
    let ended = within("the deadline", responses.message()).await.unwrap_err();
    assert_eq!(ended.code(), Code::DeadlineExceeded, "{ended}");
    eventually("the stream's place", async || {
        server.metric("pliant_streams").await == 0.0
    })
    .await;

    // An upload that never ends, from a client without a clock.
    let plain = reqwest::Client::builder()
        .no_proxy()
        .http2_prior_knowledge()
        .build()
        .unwrap();
    let endless = futures::stream::pending::<Result<Bytes, std::io::Error>>();
    let request = plain
        .post(server.url("/pliant.v1.Deformer/CreateSession"))
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .header("grpc-timeout", "100m")
        .body(reqwest::Body::wrap_stream(endless));
    let late = request.answer().await;
    assert_eq!(late.headers()["grpc-status"], "4");
}

#[tokio::test(flavor = "multi_thread")]
async fn health_is_reported_and_watched() {
    use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};
    let server = Server::start().await;
    let mut client = HealthClient::new(server.channel().await);
    for service in ["", "pliant.v1.Deformer"] {
        let answer = client
            .check(HealthCheckRequest {
                service: service.into(),
            })
            .await
            .unwrap()
            .into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "{service:?}");
    }
    let unknown = client
        .check(HealthCheckRequest {
            service: "other".into(),
        })
        .await
        .unwrap_err();
    assert_eq!(unknown.code(), Code::NotFound);
}

#[tokio::test(flavor = "multi_thread")]
async fn reflection_reports_the_schema_with_its_imports() {
    use tonic_reflection::pb::v1::{
        ServerReflectionRequest, server_reflection_client::ServerReflectionClient,
        server_reflection_request::MessageRequest, server_reflection_response::MessageResponse,
    };
    let server = Server::start().await;
    let mut client = ServerReflectionClient::new(server.channel().await);
    let mut ask = async |message: MessageRequest| {
        let request = ServerReflectionRequest {
            host: String::new(),
            message_request: Some(message),
        };
        let mut answers = client
            .server_reflection_info(futures::stream::iter([request]))
            .await
            .unwrap()
            .into_inner();
        answers.message().await.unwrap().unwrap().message_response.unwrap()
    };
    let MessageResponse::ListServicesResponse(list) = ask(MessageRequest::ListServices(String::new())).await else {
        panic!("no list")
    };
    let names: Vec<&str> = list.service.iter().map(|s| s.name.as_str()).collect();
    assert!(
        names.contains(&"pliant.v1.Deformer") && names.contains(&"grpc.health.v1.Health"),
        "{names:?}"
    );
    let symbol = MessageRequest::FileContainingSymbol("pliant.v1.Deformer.Solve".into());
    let MessageResponse::FileDescriptorResponse(files) = ask(symbol).await else {
        panic!("no file")
    };
    let pool = prost_reflect::DescriptorPool::from_file_descriptor_set(prost_reflect::prost_types::FileDescriptorSet {
        file: files
            .file_descriptor_proto
            .iter()
            .map(|f| prost_reflect::prost_types::FileDescriptorProto::decode(f.as_slice()).unwrap())
            .collect(),
    })
    .unwrap();
    assert!(pool.get_message_by_name("pliant.v1.Frame").is_some());
}

/// Messages and trailers of a gRPC-Web body.
fn web_parts(mut body: Bytes) -> (Vec<Bytes>, String) {
    let (mut messages, mut trailers) = (Vec::new(), String::new());
    while body.len() >= 5 {
        let flag = body.get_u8();
        let length = body.get_u32() as usize;
        let part = body.split_to(length);
        if flag & 0x80 == 0 {
            messages.push(part)
        } else {
            trailers = String::from_utf8(part.to_vec()).unwrap()
        }
    }
    assert!(body.is_empty(), "whole parts");
    (messages, trailers)
}

async fn web(server: &Server, rpc: &str, message: &impl prost::Message) -> (reqwest::StatusCode, Vec<Bytes>, String) {
    web_bytes(server, rpc, &message.encode_to_vec()).await
}

async fn web_bytes(server: &Server, rpc: &str, message: &[u8]) -> (reqwest::StatusCode, Vec<Bytes>, String) {
    let mut body = BytesMut::new();
    body.extend([0u8]);
    body.extend((message.len() as u32).to_be_bytes());
    body.extend(message);
    let request = server
        .post(&format!("/pliant.v1.Deformer/{rpc}"))
        .header("content-type", "application/grpc-web+proto")
        .header("origin", "http://localhost:3000")
        .body(body.freeze());
    let answer = request.answer().await;
    assert_eq!(answer.headers()["access-control-allow-origin"], "http://localhost:3000");
    let status = answer.status();
    let headers = answer.headers().clone();
    let (messages, trailers) = web_parts(answer.bytes().await.unwrap());
    // A call that fails at once says so in its headers.
    let code = headers
        .get("grpc-status")
        .map(|c| format!("grpc-status:{}", c.to_str().unwrap()))
        .unwrap_or(trailers);
    (status, messages, code.replace(' ', ""))
}

#[tokio::test(flavor = "multi_thread")]
async fn browsers_call_over_grpc_web() {
    let (server, id) = Server::start_with_bar().await;
    let (status, messages, code) = web(&server, "GetSession", &named(&id)).await;
    assert_eq!((status.as_u16(), messages.len()), (200, 1));
    assert!(code.contains("grpc-status:0"), "{code}");
    assert_eq!(pb::Session::decode(messages[0].clone()).unwrap().id, id);

    let solve = turn_request(&id, 3, 0.2);
    let (_, messages, code) = web(&server, "Solve", &solve).await;
    assert!(code.contains("grpc-status:0"), "{code}");
    assert_eq!(pb::Frame::decode(messages[0].clone()).unwrap().seq, 3);

    let (_, _, code) = web(&server, "GetSession", &named("nobody")).await;
    assert!(code.contains("grpc-status:5"), "{code}");
}

#[tokio::test(flavor = "multi_thread")]
async fn unknown_methods_are_unimplemented_and_counted_as_one() {
    let server = Server::start().await;
    let mut raw = tonic::client::Grpc::new(server.channel().await);
    for path in ["/pliant.v1.Deformer/Melt", "/other.Service/Call"] {
        raw.ready().await.unwrap();
        let codec = tonic_prost::ProstCodec::<pb::GetLimitsRequest, pb::Limits>::default();
        let refused = raw
            .unary(
                Request::new(pb::GetLimitsRequest {}),
                http::uri::PathAndQuery::from_static(path),
                codec,
            )
            .await;
        assert_eq!(refused.unwrap_err().code(), Code::Unimplemented, "{path}");
    }
    let counts = server.get("/metrics").answer().await.text().await.unwrap();
    assert!(
        counts.contains("pliant_requests_total{transport=\"grpc\",route=\"unknown\",code=\"UNIMPLEMENTED\"} 2"),
        "{counts}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn bytes_that_are_no_message_are_the_callers_fault() {
    let server = Server::start().await;
    for rpc in [
        "CreateSession",
        "GetSession",
        "SetHandles",
        "Solve",
        "Deform",
        "Animate",
        "Edit",
    ] {
        let (status, messages, code) = web_bytes(&server, rpc, &[0xff; 9]).await;
        assert_eq!((status.as_u16(), messages.len()), (200, 0), "{rpc}");
        assert!(code.contains("grpc-status:3"), "{rpc}: {code}");
    }
}
