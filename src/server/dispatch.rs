//! One port, two families: requests of gRPC and gRPC-Web go to one side, all others to HTTP.

use super::auth::{Gatekeeper, principal};
use super::config::ServerConfig;
use super::connection_facts::ConnectionFacts;
use super::grpc::Grpc;
use super::http;
use super::origin::Origins;
use super::state::State;
use super::visitors::{self, Refused};
use crate::session::Error;
use ::http::{HeaderName, HeaderValue, Method, Request, Response, header};
use axum::Router;
use axum::body::Body;
use axum::response::IntoResponse as _;
use std::convert::Infallible;
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tower::{Layer as _, Service, ServiceExt as _};
use tower_http::cors::{AllowHeaders, AllowOrigin, Cors, CorsLayer};

/// Answers every request of the port.
#[derive(Clone)]
pub(super) struct Dispatch {
    sides: Sides,
    /// The same for requests of browser pages.
    pages: Cors<Sides>,
    dropped: CancellationToken,
    state: State,
}

impl Dispatch {
    /// Everything that answers over `state`.
    ///
    /// # Errors
    /// A text, when the descriptors built into this program cannot be read.
    pub async fn new(state: &State) -> Result<Self, String> {
        let sides = Sides {
            grpc: Grpc::new(state).await?,
            http: http::router(state),
            gatekeeper: state.gatekeeper.clone(),
        };
        let pages = cors(&state.config).layer(sides.clone());
        let dropped = CancellationToken::new();
        Ok(Self {
            sides,
            pages,
            dropped,
            state: state.clone(),
        })
    }

    /// Answers a request.
    pub async fn call(&self, mut request: Request<Body>) -> Response<Body> {
        let refused = visitors::refuse(&request, &self.state.config);
        let answer = if let Some(refused) = refused {
            request.extensions_mut().insert(refused);
            self.sides.clone().oneshot(request).await
        } else if request.headers().contains_key(header::ORIGIN) {
            self.pages.clone().oneshot(request).await
        } else {
            self.sides.clone().oneshot(request).await
        };
        match answer {
            Ok(response) => guarded(response),
            Err(never) => match never {},
        }
    }

    /// Whether a request is answered in gRPC's way.
    pub fn is_grpc<B>(request: &Request<B>) -> bool {
        Grpc::takes(request)
    }

    /// The answer to a request that is refused after it was answered.
    pub fn refusal(error: Error, is_grpc: bool) -> Response<Body> {
        if is_grpc {
            super::grpc::refusal(error)
        } else {
            http::problem::Problem::from(error).into_response()
        }
    }

    /// Reports to health watchers: not serving.
    pub async fn stop_serving(&self) {
        self.sides.grpc.stop_serving().await;
    }

    /// Drops every connection that is still open.
    pub fn drop_connections(&self) {
        self.dropped.cancel();
    }

    /// Cancelled when connections are dropped.
    pub fn dropped(&self) -> CancellationToken {
        self.dropped.clone()
    }
}

/// Forbids browsers to guess the type of an answer, and pages of other origins to embed it.
fn guarded(mut response: Response<Body>) -> Response<Body> {
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
struct Sides {
    grpc: Grpc,
    http: Router,
    gatekeeper: Gatekeeper,
}

impl Service<Request<Body>> for Sides {
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = futures::future::BoxFuture<'static, Result<Response<Body>, Infallible>>;

    fn poll_ready(&mut self, _: &mut std::task::Context<'_>) -> std::task::Poll<Result<(), Infallible>> {
        std::task::Poll::Ready(Ok(()))
    }

    /// Authenticates inside the CORS layer: pages must be able to read a 401, and preflight requests carry no
    /// credentials.
    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        let Self { grpc, http, gatekeeper } = self.clone();
        Box::pin(async move {
            if request.extensions().get::<Refused>().is_none() {
                let shown = request.extensions().get::<ConnectionFacts>().cloned();
                let shown = shown.as_ref().and_then(|facts| facts.shown.as_ref());
                if let Err(error) = gatekeeper.admit(&mut request, shown).await {
                    request.extensions_mut().insert(Refused(error));
                }
            }
            let tenant = principal(request.extensions()).map(|p| p.tenant.clone()).ok();
            let mut response = if Grpc::takes(&request) {
                grpc.call(request).await
            } else {
                http.oneshot(request).await?
            };
            // Who asked is charged for the answer until it is read.
            if let Some(tenant) = tenant {
                response.extensions_mut().insert(tenant);
            }
            Ok(response)
        })
    }
}

/// CORS: which pages may call, and which headers they may read.
fn cors(config: &ServerConfig) -> CorsLayer {
    let origins: Origins = config.origins.clone();
    let allowed = AllowOrigin::predicate(move |origin: &HeaderValue, request: &::http::request::Parts| {
        let host = request.headers.get(header::HOST).and_then(|h| h.to_str().ok());
        origins.allow(origin, host.or_else(|| request.uri.authority().map(|a| a.as_str())))
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
        "x-pliant-faces-too-large",
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
