//! One port, two families: requests of gRPC and gRPC-Web go to tonic's services, all others to HTTP.

use super::auth::{Authenticator, principal};
use super::config::ServerConfig;
use super::connection::CertificateCaller;
use super::grpc::{self, Grpc};
use super::http::{self, problem::Problem};
use super::request_filter::{self, Rejected};
use super::state::ServerState;
use ::http::{HeaderName, HeaderValue, Method, Request, Response, header};
use axum::Router;
use axum::body::Body;
use axum::response::IntoResponse as _;
use pliant_session::Error;
use std::convert::Infallible;
use std::time::Duration;
use tower::util::BoxCloneSyncService;
use tower::{Layer as _, ServiceExt as _, service_fn};
use tower_http::cors::{AllowHeaders, AllowOrigin, CorsLayer};

type Routed = BoxCloneSyncService<Request<Body>, Response<Body>, Infallible>;

/// Answers every request of the port.
#[derive(Clone)]
pub(super) struct Dispatch {
    /// For programs.
    plain: Routed,
    /// For browser pages, with the headers of CORS.
    pages: Routed,
    grpc: Grpc,
    state: ServerState,
}

impl Dispatch {
    /// Sets up everything that answers over `state`.
    ///
    /// # Errors
    /// A text, when the descriptors built into this program cannot be read.
    pub async fn new(state: &ServerState) -> Result<Self, String> {
        let grpc = Grpc::new(state).await?;
        let routes = Routes {
            grpc: grpc.clone(),
            http: http::router(state),
            authenticator: state.authenticator.clone(),
        };
        let plain = service_fn(move |request| routes.clone().answer(request));
        Ok(Self {
            pages: BoxCloneSyncService::new(cors(&state.config).layer(plain.clone())),
            plain: BoxCloneSyncService::new(plain),
            grpc,
            state: state.clone(),
        })
    }

    /// Answers a request.
    pub async fn call(&self, mut request: Request<Body>) -> Response<Body> {
        let rejected = request_filter::reject(&request, &self.state.config.hosts, &self.state.config.origins);
        let is_page = rejected.is_none() && request.headers().contains_key(header::ORIGIN);
        if let Some(rejected) = rejected {
            request.extensions_mut().insert(rejected);
        }
        let service = if is_page { &self.pages } else { &self.plain };
        match service.clone().oneshot(request).await {
            Ok(response) => with_browser_headers(response),
            Err(never) => match never {},
        }
    }

    /// Reports to health watchers: not serving.
    pub async fn stop_serving(&self) {
        self.grpc.stop_serving().await;
    }
}

/// Whether a request is one of gRPC or gRPC-Web.
pub(super) fn is_grpc<B>(request: &Request<B>) -> bool {
    let content_type = request.headers().get(header::CONTENT_TYPE);
    content_type.is_some_and(|kind| kind.as_bytes().starts_with(b"application/grpc"))
}

/// The answer that rejects a call, after it was answered otherwise.
pub(super) fn rejection(error: Error, is_grpc: bool) -> Response<Body> {
    if is_grpc {
        grpc::rejection(error)
    } else {
        Problem::from(error).into_response()
    }
}

/// Forbids browsers to guess the type of an answer, and pages of other origins to embed it.
fn with_browser_headers(mut response: Response<Body>) -> Response<Body> {
    let headers = response.headers_mut();
    for (name, value) in [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    }
    response
}

#[derive(Clone)]
struct Routes {
    grpc: Grpc,
    http: Router,
    authenticator: Authenticator,
}

impl Routes {
    /// Authenticates inside the CORS layer: pages must be able to read a 401, and preflight requests contain no credentials.
    async fn answer(self, mut request: Request<Body>) -> Result<Response<Body>, Infallible> {
        if request.extensions().get::<Rejected>().is_none() {
            let certificate = request.extensions().get::<CertificateCaller>().cloned();
            let certificate = certificate.and_then(|caller| caller.0);
            if let Err(error) = self.authenticator.admit(&mut request, certificate.as_ref()).await {
                request.extensions_mut().insert(Rejected(error));
            }
        }
        let tenant = principal(request.extensions()).map(|p| p.tenant.clone()).ok();
        let mut response = if is_grpc(&request) {
            self.grpc.call(request).await
        } else {
            self.http.oneshot(request).await?
        };
        // The answer counts for the caller's tenant until it is read.
        if let Some(tenant) = tenant {
            response.extensions_mut().insert(tenant);
        }
        Ok(response)
    }
}

/// CORS: which pages may call, and which headers they may read.
fn cors(config: &ServerConfig) -> CorsLayer {
    let origins = config.origins.clone();
    let allowed = AllowOrigin::predicate(move |_: &HeaderValue, request: &::http::request::Parts| {
        origins.admit(&request.headers, &request.uri)
    });
    let own = [
        "grpc-status",
        "grpc-message",
        "grpc-status-details-bin",
        "x-request-id",
        "x-pliant-owner",
        "x-pliant-node",
        "x-pliant-revision",
        "x-pliant-digest",
        "x-pliant-vertices",
        "x-pliant-origin",
        "x-pliant-residual",
        "x-pliant-max-error",
        "x-pliant-solve-ms",
        "x-pliant-queue-ms",
        "x-pliant-edge-rms",
        "x-pliant-volume-change",
        "x-pliant-open-surface",
        "x-pliant-area-change",
        "x-pliant-flipped-triangles",
        "x-pliant-max-stretch",
        "x-pliant-self-intersections",
        "x-pliant-new-self-intersections",
        "x-pliant-faces-too-large",
        "x-pliant-off-rigid",
        "x-pliant-followed",
        "x-pliant-frames",
        "x-pliant-warning",
    ];
    let mut exposed: Vec<HeaderName> = own.into_iter().map(HeaderName::from_static).collect();
    exposed.extend([
        header::ETAG,
        header::LOCATION,
        header::LINK,
        header::RETRY_AFTER,
        header::CONTENT_RANGE,
        header::ACCEPT_RANGES,
        header::CONTENT_DISPOSITION,
    ]);
    CorsLayer::new()
        .allow_origin(allowed)
        .allow_methods([
            Method::GET,
            Method::HEAD,
            Method::POST,
            Method::PUT,
            Method::PATCH,
            Method::DELETE,
        ])
        .allow_headers(AllowHeaders::mirror_request())
        .expose_headers(exposed)
        .max_age(Duration::from_secs(3600))
}
