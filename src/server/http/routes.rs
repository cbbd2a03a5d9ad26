//! Which path leads to which function.

use super::{animate, carry, create, docs, edits, handles, models, pages, sessions, solve, viewer};
use crate::server::socket;
use crate::server::state::State;
use axum::Router;
use axum::routing::{get, patch, post, put};

/// All routes.
pub(super) fn all() -> Router<State> {
    Router::new()
        .route("/v1/sessions", post(create::create).get(sessions::list))
        .route("/v1/sessions/{id}", get(sessions::get).delete(sessions::delete))
        .route("/v1/sessions/{id}/handles", put(handles::put))
        .route(
            "/v1/sessions/{id}/handles/{handleId}",
            patch(handles::patch).delete(handles::delete),
        )
        .route("/v1/sessions/{id}/solve", post(solve::solve))
        .route("/v1/sessions/{id}/edits", post(edits::edit))
        .route("/v1/sessions/{id}/carry", post(carry::carry))
        .route("/v1/sessions/{id}/animations", post(animate::animate))
        .route("/v1/sessions/{id}/undo", post(sessions::undo))
        .route("/v1/sessions/{id}/redo", post(sessions::redo))
        .route("/v1/sessions/{id}/history", get(sessions::history))
        .route("/v1/sessions/{id}/model", get(models::model))
        .route("/v1/sessions/{id}/positions", get(models::positions))
        .route(
            "/v1/sessions/{id}/stream",
            get(socket::upgrade).connect(socket::upgrade),
        )
        .route("/v1/limits", get(sessions::limits))
        .route("/v1/sample.glb", get(pages::sample))
        .route("/healthz", get(pages::alive))
        .route("/readyz", get(pages::ready))
        .route("/metrics", get(pages::metrics))
        .route("/openapi.json", get(pages::openapi))
        .route("/docs", get(docs::page))
        .route("/docs/", get(docs::page))
        .route("/docs.js", get(docs::script))
        .route("/", get(viewer::page))
        .route("/icon.svg", get(viewer::icon))
        .route("/assets/{name}", get(viewer::asset))
}
