//! Which statuses each operation answers with.

use crate::server::http::Route;
use std::collections::BTreeSet;

/// What every operation may answer: a malformed head, missing or insufficient credentials, a page of another origin, a
/// too large head, an exhausted quota, a defect, a server that stops or has no room, a deadline.
const EVERYWHERE: [u16; 9] = [400, 401, 403, 404, 429, 431, 500, 503, 504];

/// Successes beside the usual one: what was made before, a part of an answer, and one that the caller has already.
pub(super) fn other_successes(route: &Route) -> Vec<u16> {
    match route.rpc {
        // An idempotent repeat.
        Some("CreateSession") => vec![200],
        _ if is_download(route) => vec![206, 304],
        _ => Vec::new(),
    }
}

/// Statuses with which an operation refuses or fails.
pub(super) fn refusals(route: &Route) -> BTreeSet<u16> {
    let mut all = BTreeSet::from(EVERYWHERE);
    if !is_about_the_server(route) {
        // A state that hinders it, more than the limits allow, what means nothing, a caller that has left, what is not done here.
        all.extend([409, 413, 422, 499, 501]);
    }
    if ["post", "put", "patch"].contains(&route.method) {
        // Bodies that come too slowly, or of a kind that is not read.
        all.extend([408, 415]);
    }
    if is_download(route) {
        all.insert(416);
    }
    if ["/v1/sessions/{id}/solve", "/v1/sessions/{id}/animations"].contains(&route.path) {
        all.insert(406);
    }
    if route.path.ends_with("/stream") {
        all.insert(426);
    }
    all
}

/// Whether it is about a session that another one of several nodes may have, or have more room for: the caller is sent there.
pub(super) fn is_sent_on(route: &Route) -> bool {
    route.rpc == Some("CreateSession") || route.path.starts_with("/v1/sessions/{id}")
}

/// Whether it answers with bytes that can be asked for in parts.
fn is_download(route: &Route) -> bool {
    [
        "/v1/sessions/{id}/model",
        "/v1/sessions/{id}/positions",
        "/v1/sample.glb",
    ]
    .contains(&route.path)
}

/// Whether it is about the server alone, and takes nothing that could be wrong.
fn is_about_the_server(route: &Route) -> bool {
    ["/healthz", "/readyz", "/metrics", "/openapi.json", "/v1/limits"].contains(&route.path)
}
