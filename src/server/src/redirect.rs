//! How a caller is sent to the node that has the session.
//!
//! Headers name the node's address and its name. Where a proxy stands before all nodes, the address is the proxy's; the
//! caller repeats the call there with the name, by which the proxy chooses.

use http::{HeaderMap, Uri};
use pliant_session::OwnerAddress;

/// The header with the address of the node that has the session.
pub(super) const OWNER: &str = "x-pliant-owner";
/// The header with its name; callers send it back.
pub(super) const NODE: &str = "x-pliant-node";
/// The header of callers that follow to the owner themselves: how often they were sent already. They get no redirect,
/// which an HTTP library would follow without their token.
pub(super) const HOPS: &str = "x-pliant-hops";
/// The name in a query, for callers that follow a location and send no header of their own.
pub(super) const NODE_QUERY: &str = "pliant-node";

/// Whether a caller follows to the owner itself.
pub(super) fn follows_by_itself(headers: &HeaderMap) -> bool {
    headers.contains_key(HOPS)
}

/// Where a request that was sent to `uri` is to go.
pub(super) fn location(owner: &OwnerAddress, uri: &Uri) -> String {
    let mut location = format!("{}{}", owner.address, uri.path());
    let kept = uri.query().into_iter().flat_map(|query| query.split('&'));
    let kept = kept.filter(|part| !part.is_empty() && !is_node(part));
    let named = format!("{NODE_QUERY}={}", owner.node);
    let mut mark = '?';
    for part in kept.chain([named.as_str()]) {
        location.push(mark);
        location.push_str(part);
        mark = '&';
    }
    location
}

fn is_node(part: &str) -> bool {
    part.strip_prefix(NODE_QUERY).is_some_and(|rest| rest.starts_with('='))
}

/// A request's address without the name of a node, which is the proxy's alone; `None` where it has none.
pub(super) fn without_node(uri: &Uri) -> Option<Uri> {
    let query = uri.query()?;
    if !query.split('&').any(is_node) {
        return None;
    }
    let kept: Vec<&str> = query.split('&').filter(|part| !is_node(part)).collect();
    let path = match kept.is_empty() {
        true => uri.path().to_owned(),
        false => format!("{}?{}", uri.path(), kept.join("&")),
    };
    let mut parts = uri.clone().into_parts();
    parts.path_and_query = Some(path.parse().ok()?);
    Uri::from_parts(parts).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_location_keeps_what_was_asked_and_names_one_node() {
        let owner = OwnerAddress {
            address: "http://10.0.0.5:7411".into(),
            node: "b".into(),
        };
        let cases = [
            (
                "/v1/sessions/7/solve",
                "/v1/sessions/7/solve?pliant-node=b",
                "/v1/sessions/7/solve",
            ),
            ("/m?format=obj", "/m?format=obj&pliant-node=b", "/m?format=obj"),
            (
                "/m?pliant-node=a&format=obj",
                "/m?format=obj&pliant-node=b",
                "/m?format=obj",
            ),
        ];
        for (asked, there, without) in cases {
            let sent = location(&owner, &asked.parse().unwrap());
            assert_eq!(sent, format!("http://10.0.0.5:7411{there}"));
            let arrived = without_node(&sent.parse().unwrap()).unwrap();
            assert_eq!(arrived.path_and_query().unwrap().as_str(), without);
        }
        assert_eq!(without_node(&"/m?format=obj".parse().unwrap()), None);
    }
}
