//! Idempotency keys where several nodes share a store: a call that one of them has answered may be repeated at another.

use crate::answers::Tenant;
use crate::calls::command::StoredAnswer;
use crate::calls::idempotency::{ClaimOutcome, RequestFingerprint, key_of_another_request};
use crate::error::Error;
use crate::shared::SharedResources;
use crate::store::millis;
use std::time::Duration;

/// Claims a key, or gives the answer that is kept for it, here or by another node.
pub(crate) async fn claim_everywhere(
    shared: &SharedResources,
    tenant: &Tenant,
    key: &str,
    fingerprint: RequestFingerprint,
) -> Result<ClaimOutcome<StoredAnswer>, Error> {
    let claim = match shared.idempotency.claim(tenant, key, fingerprint)? {
        ClaimOutcome::New(claim) => claim,
        done => return Ok(done),
    };
    let Some(store) = shared.store.as_ref().filter(|store| store.ownership().is_some()) else {
        return Ok(ClaimOutcome::New(claim));
    };
    let Some(known) = store.key(tenant, key).await? else {
        return Ok(ClaimOutcome::New(claim));
    };
    let now = shared.surroundings.now_ms();
    if Duration::from_millis(now.saturating_sub(known.at_ms)) >= shared.config.idempotency_age {
        let before_ms = now
            .saturating_sub(millis(shared.config.idempotency_age))
            .saturating_add(1);
        store.forget_keys(before_ms).await?;
        return Ok(ClaimOutcome::New(claim));
    }
    if !fingerprint.is(known.fingerprint) {
        return Err(key_of_another_request());
    }
    Ok(ClaimOutcome::Done(StoredAnswer::Recorded {
        session: known.session,
        sequence: known.sequence,
    }))
}
