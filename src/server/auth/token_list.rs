//! The tokens that are known, as hashes.

use super::auth_config::TokenEntry;
use super::principal::Principal;
use crate::session::{Error, ErrorCode};
use sha2::{Digest as _, Sha256};
use std::time::SystemTime;
use subtle::ConstantTimeEq as _;

/// The stored form of a token: SHA-256 of its text. Tokens are long and random, so a slow hash would add no protection.
pub fn token_digest(token: &str) -> [u8; 32] {
    Sha256::digest(token.as_bytes()).into()
}

/// The bearer of a token.
///
/// Every entry is compared, each in constant time, so that answers reveal nothing of the list.
///
/// # Errors
/// `UNAUTHENTICATED` for a token that is not in the list, or has expired.
pub(super) fn token_bearer(entries: &[TokenEntry], token: &str, now: SystemTime) -> Result<Principal, Error> {
    let digest = token_digest(token);
    let mut found = None;
    for entry in entries {
        if bool::from(entry.sha256.ct_eq(&digest)) {
            found = Some(entry);
        }
    }
    let refuse = |text: &str| Err(Error::new(ErrorCode::Unauthenticated, text));
    match found {
        None => refuse("the token is not known to this server, or no longer"),
        Some(entry) if entry.expires.is_some_and(|end| now >= end) => refuse("the token has expired"),
        Some(entry) => Ok(Principal {
            tenant: entry.tenant.clone(),
            name: entry.name.as_str().into(),
            reads_metrics: entry.metrics,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::Tenant;
    use std::time::Duration;

    fn entry(token: &str, tenant: &str, expires: Option<SystemTime>) -> TokenEntry {
        TokenEntry {
            tenant: Tenant(tenant.into()),
            sha256: token_digest(token),
            name: format!("{tenant}'s"),
            expires,
            metrics: false,
        }
    }

    #[test]
    fn a_token_has_one_bearer_until_it_expires() {
        let noon = SystemTime::UNIX_EPOCH + Duration::from_secs(1_800_000_000);
        let entries = [entry("one", "a", None), entry("two", "b", Some(noon))];
        let asked = |token, now| token_bearer(&entries, token, now);
        assert_eq!(&*asked("one", noon).unwrap().tenant.0, "a");
        assert_eq!(&*asked("two", noon - Duration::from_secs(1)).unwrap().tenant.0, "b");
        for (token, told) in [
            ("two", "expired"),
            ("three", "not known"),
            ("", "not known"),
            ("One", "not known"),
        ] {
            let refused = asked(token, noon).unwrap_err();
            assert_eq!(refused.code, ErrorCode::Unauthenticated);
            assert!(refused.message.contains(told), "{token}: {refused:?}");
        }
    }

    #[test]
    fn what_is_kept_is_what_sha256sum_prints() {
        let hex: String = token_digest("abc").iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(hex, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
