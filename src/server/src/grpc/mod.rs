//! gRPC and gRPC-Web: decode, call pliant-session, encode.
//!
//! Everything of tonic stays in this folder; no other part of the server sees its types.

mod codec;
mod deadline;
mod deformer;
mod streams;

/// Generated from the schema.
mod services {
    #![allow(missing_docs, clippy::all)]
    include!(concat!(env!("OUT_DIR"), "/services/server/pliant.v1.rs"));
    include!(concat!(env!("OUT_DIR"), "/services/client/pliant.v1.rs"));
}

/// The generated client.
pub mod client {
    pub use super::services::deformer_client::DeformerClient;
}

use super::state::ServerState;
use axum::body::Body;
use http::{Request, Response};
use pliant_wire::pb;
use services::deformer_server::DeformerServer;
use std::convert::Infallible;
use std::time::Duration;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use tower::{Layer as _, ServiceExt as _};

/// The time between two checks whether the server is ready.
const HEALTH_PERIOD: Duration = Duration::from_millis(500);
/// The name under which health is reported, besides the empty name of the whole server.
const SERVICE: &str = "pliant.v1.Deformer";

/// All gRPC services of this server.
#[derive(Clone)]
pub(super) struct Grpc {
    routes: tonic_web::GrpcWebService<deadline::Timed>,
    health: HealthReporter,
}

impl Grpc {
    /// The services over `state`, reported as serving.
    ///
    /// # Errors
    /// A text, when the descriptors built into this program cannot be read.
    pub async fn new(state: &ServerState) -> Result<Self, String> {
        let deformer = DeformerServer::new(deformer::Calls::new(state.clone()))
            .max_decoding_message_size(state.message_bytes)
            .max_encoding_message_size(usize::MAX);
        let (health, health_service) = tonic_health::server::health_reporter();
        health.set_service_status(SERVICE, ServingStatus::Serving).await;
        tokio::spawn(report_health(health.clone(), state.clone()));
        let mut routes = tonic::service::Routes::new(deformer).add_service(health_service);
        if state.config.reflection {
            let configure = || {
                tonic_reflection::server::Builder::configure()
                    .register_encoded_file_descriptor_set(pb::DESCRIPTORS)
                    .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
            };
            routes = routes.add_service(configure().build_v1().map_err(|e| e.to_string())?);
            routes = routes.add_service(configure().build_v1alpha().map_err(|e| e.to_string())?);
        }
        let names = pliant_wire::json::descriptors().map_err(|e| e.to_string())?.services();
        let known = names
            .flat_map(|service| {
                service
                    .methods()
                    .map(|m| format!("{}/{}", service.full_name(), m.name()))
                    .collect::<Vec<_>>()
            })
            .collect();
        let timed = deadline::Timed::new(routes.prepare(), state.telemetry.clone(), known);
        Ok(Self {
            routes: tonic_web::GrpcWebLayer::new().layer(timed),
            health,
        })
    }

    /// Answers a request.
    pub async fn call(&self, request: Request<Body>) -> Response<Body> {
        let answer: Result<Response<tonic::body::Body>, Infallible> = self.routes.clone().oneshot(request).await;
        match answer {
            Ok(response) => response.map(Body::new),
            Err(never) => match never {},
        }
    }

    /// Reports to health watchers: not serving.
    pub async fn stop_serving(&self) {
        report(&self.health, ServingStatus::NotServing).await;
    }
}

/// Reports the state of `/readyz` to health watchers, until the server stops.
async fn report_health(health: HealthReporter, state: ServerState) {
    let mut was_ready = true;
    while !state.draining.is_cancelled() {
        let is_ready = state.manager.admits() && state.manager.takes_writes();
        if is_ready != was_ready {
            was_ready = is_ready;
            let status = match is_ready {
                true => ServingStatus::Serving,
                false => ServingStatus::NotServing,
            };
            report(&health, status).await;
        }
        tokio::select! {
            () = state.draining.cancelled() => return,
            () = tokio::time::sleep(HEALTH_PERIOD) => {}
        }
    }
}

async fn report(health: &HealthReporter, status: ServingStatus) {
    health.set_service_status(SERVICE, status).await;
    health.set_service_status("", status).await;
}

/// The answer that rejects a call.
pub(super) fn rejection(error: pliant_session::Error) -> Response<Body> {
    codec::status(error).into_http()
}
