//! Who asks. One place, before anything else is looked at, so that keys or certificates can be added without touching
//! the calls.

use crate::session::{Error, Tenant};
use http::HeaderMap;

/// The tenant of a request. Every caller is the tenant "default": this server has no accounts and relies on who can
/// reach its port.
///
/// # Errors
/// None today; `UNAUTHENTICATED` once there are accounts.
pub(super) fn tenant(_headers: &HeaderMap) -> Result<Tenant, Error> {
    Ok(Tenant::default())
}
