//! What every call brings: its caller, its idempotency key, the names in its path, its query, and the media types that it accepts.

use super::body;
use super::problem::{Problem, clip};
use crate::auth;
use crate::messages::NamesSession;
use crate::state::ServerState;
use axum::extract::{FromRequestParts, Path, Query, Request};
use http::request::Parts;
use http::{HeaderMap, StatusCode, Uri, header};
use percent_encoding::percent_decode_str;
use pliant_mcp::AgentCaller;
use pliant_session::{CallKey, Error, Manager, Tenant};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Who calls, checked before anything else.
pub(crate) struct Caller {
    /// The tenant.
    pub tenant: Tenant,
    /// What it is called, for the audit trail.
    name: Arc<str>,
    /// Whether it may read the counts of the whole server.
    pub reads_metrics: bool,
    /// The idempotency key, where one was sent.
    key: Option<Result<String, Error>>,
}

impl Caller {
    /// The sessions, with what is done noted as the caller's.
    pub fn manager(&self, state: &ServerState) -> Manager {
        state.manager.on_behalf_of(&self.name)
    }

    /// The caller as the tools of agents know it.
    pub fn agent(&self) -> AgentCaller {
        AgentCaller {
            tenant: self.tenant.clone(),
            name: Arc::clone(&self.name),
            span: tracing::Span::current(),
        }
    }

    /// The idempotency key. An invalid one fails here, not earlier, so that a missing session is reported first.
    pub fn key(&self) -> Result<Option<&str>, Error> {
        match &self.key {
            None => Ok(None),
            Some(Ok(key)) => Ok(Some(key)),
            Some(Err(error)) => Err(error.clone()),
        }
    }

    /// The idempotency key together with what identifies the request.
    pub fn call_key(&self, request: impl FnOnce() -> Vec<u8>) -> Result<Option<CallKey>, Error> {
        let with_request = |key: &str| CallKey {
            key: key.to_owned(),
            request: request(),
        };
        Ok(self.key()?.map(with_request))
    }
}

impl FromRequestParts<ServerState> for Caller {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &ServerState) -> Result<Self, Problem> {
        let principal = auth::principal(&parts.extensions)?;
        let (tenant, name) = (principal.tenant.clone(), Arc::clone(&principal.name));
        let reads_metrics = principal.reads_metrics;
        let key = parts.headers.get("idempotency-key").map(|value| {
            let text = value
                .to_str()
                .map_err(|_| Error::invalid("Idempotency-Key", "is not printable ASCII"))?;
            Ok(text.to_owned())
        });
        Ok(Self {
            tenant,
            name,
            reads_metrics,
            key,
        })
    }
}

/// A call on a session, or on one of its handles.
pub(super) struct SessionCall {
    /// What every call can reach.
    pub state: ServerState,
    /// Who calls.
    pub caller: Caller,
    /// The sessions, with what is done noted as the caller's.
    pub manager: Manager,
    /// The session's id.
    pub id: String,
    /// The handle's id, where the path has one.
    pub handle_id: String,
}

impl SessionCall {
    /// Checks that the session exists, before anything else of the request is read.
    pub async fn check_session(&self) -> Result<(), Problem> {
        self.state.manager.get(&self.caller.tenant, &self.id).await?;
        Ok(())
    }

    /// Checks that the session exists, and reads the JSON message of the body.
    pub async fn message<M>(&self, request: Request) -> Result<M, Problem>
    where
        M: prost::Message + Default + prost::Name + NamesSession,
    {
        self.check_session().await?;
        self.body_message(request).await
    }

    /// Reads the JSON message of the body.
    pub async fn body_message<M>(&self, request: Request) -> Result<M, Problem>
    where
        M: prost::Message + Default + prost::Name + NamesSession,
    {
        let mut message: M = body::message(&self.state, request).await?;
        body::same_session(message.session_id(), &self.id)?;
        message.set_session_id(&self.id);
        Ok(message)
    }

    /// The idempotency key together with the message.
    pub fn key_of(&self, message: &impl prost::Message) -> Result<Option<CallKey>, Error> {
        self.caller.call_key(|| message.encode_to_vec())
    }
}

impl FromRequestParts<ServerState> for SessionCall {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &ServerState) -> Result<Self, Problem> {
        let caller = Caller::from_request_parts(parts, state).await?;
        let Names(names) = Names::<PathNames>::from_request_parts(parts, state).await?;
        Ok(Self {
            state: state.clone(),
            manager: caller.manager(state),
            caller,
            id: names.id,
            handle_id: names.handle_id,
        })
    }
}

#[derive(Deserialize)]
struct PathNames {
    id: String,
    #[serde(rename = "handleId", default)]
    handle_id: String,
}

/// Names in the path.
pub(super) struct Names<T>(pub T);

impl<T: DeserializeOwned + Send> FromRequestParts<ServerState> for Names<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &ServerState) -> Result<Self, Problem> {
        match Path::<T>::from_request_parts(parts, state).await {
            Ok(Path(names)) => Ok(Self(names)),
            Err(_) => Err(Problem::new(
                StatusCode::BAD_REQUEST,
                "INVALID_ARGUMENT",
                "the path is not valid percent-encoded UTF-8",
            )),
        }
    }
}

/// The parameters of a request, by name.
///
/// # Errors
/// One that is not in `allowed`, or twice, or not readable, with what is allowed. `allowed` names ending in `.` allow
/// everything that begins with them.
pub(super) fn parameters(uri: &Uri, allowed: &[&str]) -> Result<BTreeMap<String, String>, Problem> {
    // Invalid UTF-8 would silently become other text.
    let is_text = |query| percent_decode_str(query).decode_utf8().is_ok();
    if !uri.query().is_none_or(is_text) {
        return Err(Error::malformed("the query is not UTF-8").into());
    }
    let Ok(Query(pairs)) = Query::<Vec<(String, String)>>::try_from_uri(uri) else {
        return Err(Error::malformed("the query is not readable").into());
    };
    let mut parameters = BTreeMap::new();
    for (name, value) in pairs {
        if !allowed
            .iter()
            .any(|a| name == *a || (a.ends_with('.') && name.starts_with(a)))
        {
            let names: Vec<&str> = allowed.iter().copied().filter(|a| !a.ends_with('.')).collect();
            let list = if names.is_empty() {
                "none here".to_owned()
            } else {
                names.join(", ")
            };
            return Err(refuse(&name, &format!("is not a query parameter; allowed are {list}")));
        }
        if parameters.insert(name.clone(), value).is_some() {
            return Err(refuse(&name, "is given twice"));
        }
    }
    Ok(parameters)
}

fn refuse(name: &str, problem: &str) -> Problem {
    let name = clip(name);
    let error = Error {
        field: Some(name.clone()),
        ..Error::malformed(format!("{name}: {problem}"))
    };
    error.into()
}

/// The offered media type that a client prefers.
///
/// # Errors
/// 406, with all offers, where it accepts none.
pub(super) fn negotiate<'a>(headers: &HeaderMap, offers: &[&'a str]) -> Result<&'a str, Problem> {
    let accept = headers.get(header::ACCEPT).and_then(|v| v.to_str().ok());
    choose(accept, offers).map(|k| offers[k]).ok_or_else(|| {
        let list = offers.join(", ");
        let detail = format!("none of the types in Accept is offered; there are {list}");
        Problem::new(StatusCode::NOT_ACCEPTABLE, "INVALID_ARGUMENT", detail)
    })
}

/// The index in `offers` of the type that `accept` likes best; the first offer for an empty or absent header, `None` when
/// nothing offered is acceptable. Among equals the more specific range wins, then the order of `accept`.
fn choose(accept: Option<&str>, offers: &[&str]) -> Option<usize> {
    let accept = accept.map(str::trim).filter(|a| !a.is_empty());
    let Some(accept) = accept else {
        return (!offers.is_empty()).then_some(0);
    };
    let mut best: Option<(f32, u8, usize, usize)> = None;
    for (position, range) in accept.split(',').enumerate() {
        let mut parameters = range.split(';').map(str::trim);
        let range = parameters.next().unwrap_or_default();
        let quality = parameters
            .find_map(|p| p.strip_prefix("q="))
            .map_or(1.0, |q| q.parse::<f32>().unwrap_or(0.0));
        if quality.is_nan() || quality <= 0.0 {
            continue;
        }
        for (index, offer) in offers.iter().enumerate() {
            let Some(specific) = specificity(range, offer) else {
                continue;
            };
            let better = best.is_none_or(|(q, s, p, i)| {
                (quality, specific, std::cmp::Reverse(position), std::cmp::Reverse(index))
                    .partial_cmp(&(q, s, std::cmp::Reverse(p), std::cmp::Reverse(i)))
                    .is_some_and(|o| o.is_gt())
            });
            if better {
                best = Some((quality, specific, position, index));
            }
        }
    }
    best.map(|(_, _, _, index)| index)
}

fn specificity(range: &str, offer: &str) -> Option<u8> {
    if range == "*/*" {
        return Some(0);
    }
    if let Some(group) = range.strip_suffix("/*") {
        return offer
            .split('/')
            .next()
            .is_some_and(|g| g.eq_ignore_ascii_case(group))
            .then_some(1);
    }
    range.eq_ignore_ascii_case(offer).then_some(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_parameters_are_taken_once() {
        let uri: Uri = "/x?format=glb&label=a%20b".parse().unwrap();
        let found = parameters(&uri, &["format", "label"]).unwrap();
        assert_eq!(found["label"], "a b");
        assert!(parameters(&uri, &["format"]).is_err());
        assert!(parameters(&"/x?format=glb&format=obj".parse().unwrap(), &["format"]).is_err());
        assert!(parameters(&"/x?format=%ff%fe".parse().unwrap(), &["format"]).is_err());
        assert!(parameters(&"/x".parse().unwrap(), &[]).unwrap().is_empty());
    }

    const OFFERS: [&str; 3] = ["application/json", "application/octet-stream", "model/gltf-binary"];

    #[test]
    fn the_first_offer_is_the_default() {
        assert_eq!(choose(None, &OFFERS), Some(0));
        assert_eq!(choose(Some("*/*"), &OFFERS), Some(0));
        assert_eq!(choose(Some("  "), &OFFERS), Some(0));
    }

    #[test]
    fn quality_then_precision_then_order_decide() {
        assert_eq!(choose(Some("application/octet-stream"), &OFFERS), Some(1));
        assert_eq!(
            choose(Some("application/json;q=0.5, model/gltf-binary"), &OFFERS),
            Some(2)
        );
        assert_eq!(choose(Some("*/*, model/gltf-binary"), &OFFERS), Some(2));
        assert_eq!(choose(Some("model/*"), &OFFERS), Some(2));
        assert_eq!(
            choose(Some("Application/JSON, application/octet-stream"), &OFFERS),
            Some(0)
        );
    }

    #[test]
    fn what_is_not_offered_or_refused_is_not_chosen() {
        assert_eq!(choose(Some("image/png"), &OFFERS), None);
        assert_eq!(choose(Some("application/json;q=0"), &OFFERS), None);
    }
}
