//! Whether a request may enter at all: under which name it came, and which page sent it. Looked at before anything else.

use super::config::ServerConfig;
use crate::session::{Error, ErrorCode};
use http::{Request, header};

/// Travels with a request that may not enter, so that it is numbered, counted and answered like any other.
#[derive(Debug, Clone)]
pub(super) struct Refused(pub Error);

/// Why a request may not enter; `None` where it may. A page needs no answer to do harm, and may not read either: all methods are
/// alike.
pub(super) fn refuse<B>(request: &Request<B>, config: &ServerConfig) -> Option<Refused> {
    let misaddressed = config.hosts.check(request).err();
    let error = misaddressed.or_else(|| {
        let foreign = !config.origins.admit(request.headers(), request.uri()) || is_embedded(request, config);
        let told = "pages of this origin may not call; the key cors_origins lists who may";
        foreign.then(|| Error::new(ErrorCode::PermissionDenied, told))
    })?;
    Some(Refused(error))
}

/// Whether a page of another site embeds the answer, as an image or a frame: browsers name no origin then, but say that much
/// (`Sec-Fetch-Site`). Following a link from there is not embedding.
fn is_embedded<B>(request: &Request<B>, config: &ServerConfig) -> bool {
    let says = |name: &str, value: &str| {
        request
            .headers()
            .get(name)
            .is_some_and(|v| v.as_bytes() == value.as_bytes())
    };
    let follows_link = says("sec-fetch-mode", "navigate") && says("sec-fetch-dest", "document");
    says("sec-fetch-site", "cross-site")
        && !request.headers().contains_key(header::ORIGIN)
        && !config.origins.allow_any()
        && !follows_link
}
