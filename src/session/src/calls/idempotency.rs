//! Answers kept by idempotency key, so that a call that is sent twice happens once.
//!
//! A call claims its key before it does anything and completes the claim with its answer; a claim that is dropped, because
//! the call failed or was given up, frees the key. Failures are not kept: nothing happened, so a retry may try.

use crate::answers::Tenant;
use crate::capacity::memory_ledger::{MemoryLedger, MemoryReservation};
use crate::capacity::memory_use::MemoryUse;
use crate::config::SessionConfig;
use crate::error::{Error, ErrorCode};
use crate::store::LoggedKey;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;
use xxhash_rust::xxh3::Xxh3;

/// Bytes of answers kept for one tenant, and never more than this share of the memory that there is.
const TENANT_BYTES: u64 = 256 << 20;
const TENANT_SHARE: u64 = 8;
/// Tenants whose keys are kept.
const TENANTS: usize = 10_000;

/// The hash of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RequestFingerprint(u128);

impl RequestFingerprint {
    /// The hash of an operation and its arguments.
    pub fn of(operation: &str, parts: &[&[u8]]) -> Self {
        let mut hasher = Xxh3::new();
        for part in [operation.as_bytes()].iter().chain(parts) {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part);
        }
        Self(hasher.digest128())
    }

    /// Whether it is this one, as it was kept.
    pub fn is(self, kept: u128) -> bool {
        self.0 == kept
    }
}

/// The answers `A` of finished calls, by tenant and key.
#[derive(Debug)]
pub(crate) struct IdempotencyKeys<A> {
    tenants: Arc<Mutex<BTreeMap<Tenant, TenantKeys<A>>>>,
    age: Duration,
    keys: usize,
    /// Bytes kept for one tenant.
    bytes: u64,
    ledger: Arc<MemoryLedger>,
}

#[derive(Debug)]
struct TenantKeys<A> {
    entries: BTreeMap<Arc<str>, KeyEntry<A>>,
    /// Keys of finished calls, oldest first; each use of a key has another number.
    finished: VecDeque<(Instant, u64, Arc<str>)>,
    bytes: u64,
}

impl<A> Default for TenantKeys<A> {
    fn default() -> Self {
        Self {
            entries: BTreeMap::new(),
            finished: VecDeque::new(),
            bytes: 0,
        }
    }
}

#[derive(Debug)]
struct KeyEntry<A> {
    fingerprint: RequestFingerprint,
    answer: Option<KeptAnswer<A>>,
    number: u64,
}

/// An answer, and its bytes in the ledger.
#[derive(Debug)]
struct KeptAnswer<A> {
    answer: A,
    bytes: u64,
    _counted: Option<MemoryReservation>,
}

/// What a key says about a call.
#[derive(Debug)]
pub(crate) enum ClaimOutcome<A> {
    /// It is new: do it, then complete the claim.
    New(KeyClaim<A>),
    /// It was done; this was the answer.
    Done(A),
}

/// The right to answer for one key.
#[derive(Debug)]
pub(crate) struct KeyClaim<A> {
    tenants: Arc<Mutex<BTreeMap<Tenant, TenantKeys<A>>>>,
    tenant: Tenant,
    key: Arc<str>,
    ledger: Arc<MemoryLedger>,
    fingerprint: RequestFingerprint,
    open: bool,
}

/// The key has an answer of another kind, which the fingerprint of the request rules out.
pub(crate) fn answer_of_another_call() -> Error {
    Error::new(ErrorCode::Internal, "the kept answer is of another call")
}

/// The key stands for another request.
pub(crate) fn key_of_another_request() -> Error {
    let text = "was used for a different request; choose a new key";
    Error::invalid("idempotency-key", text)
}

impl<A: Clone> IdempotencyKeys<A> {
    pub fn new(config: &SessionConfig, ledger: &Arc<MemoryLedger>) -> Self {
        Self {
            bytes: TENANT_BYTES.min(ledger.total() / TENANT_SHARE),
            ledger: Arc::clone(ledger),
            tenants: Arc::default(),
            age: config.idempotency_age,
            keys: config.idempotency_keys,
        }
    }

    /// Puts back a key that was answered before the process was started, `age` ago.
    pub fn restore(&self, key: &LoggedKey, age: Duration, answer: A, bytes: u64) {
        let now = Instant::now();
        let finished = now.checked_sub(age).unwrap_or(now);
        let mut tenants = self.tenants.lock().unwrap_or_else(PoisonError::into_inner);
        let keys = tenants.entry(key.tenant.clone()).or_default();
        let number = keys.finished.back().map_or(1, |(_, n, _)| n + 1);
        let name: Arc<str> = Arc::from(key.key.as_str());
        keys.bytes = keys.bytes.saturating_add(bytes);
        keys.finished.push_back((finished, number, Arc::clone(&name)));
        let entry = KeyEntry {
            fingerprint: RequestFingerprint(key.fingerprint),
            answer: Some(KeptAnswer {
                answer,
                bytes,
                _counted: None,
            }),
            number,
        };
        keys.entries.insert(name, entry);
    }

    /// Claims `key` for a request.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` for a malformed key or one of another request, `ABORTED` while the first call runs,
    /// `RESOURCE_EXHAUSTED` when all keys are taken by calls that run.
    pub fn claim(&self, tenant: &Tenant, key: &str, fingerprint: RequestFingerprint) -> Result<ClaimOutcome<A>, Error> {
        if key.is_empty() || key.len() > 255 || !key.bytes().all(|b| b.is_ascii_graphic()) {
            return Err(Error::invalid(
                "idempotency-key",
                "1 to 255 visible ASCII characters are allowed",
            ));
        }
        let mut tenants = self.tenants.lock().unwrap_or_else(PoisonError::into_inner);
        if !tenants.contains_key(tenant) && tenants.len() >= TENANTS {
            tenants.retain(|_, keys| {
                keys.forget(self.age, self.keys, self.bytes);
                !keys.entries.is_empty()
            });
            if tenants.len() >= TENANTS {
                return Err(Error::exhausted(
                    "too many callers use idempotency keys at the moment",
                    60,
                ));
            }
        }
        let keys = tenants.entry(tenant.clone()).or_default();
        keys.forget(self.age, self.keys, self.bytes);
        if let Some(entry) = keys.entries.get(key) {
            return match &entry.answer {
                _ if entry.fingerprint != fingerprint => Err(key_of_another_request()),
                Some(kept) => Ok(ClaimOutcome::Done(kept.answer.clone())),
                None => Err(Error {
                    retry_after_s: Some(1),
                    ..Error::new(
                        ErrorCode::Aborted,
                        "the first call with this idempotency key is still running",
                    )
                }),
            };
        }
        if keys.entries.len() >= self.keys {
            // Whatever is finished may go; what runs may not.
            keys.forget(self.age, self.keys.saturating_sub(1), self.bytes);
            if keys.entries.len() >= self.keys {
                return Err(Error::exhausted("too many calls with idempotency keys are running", 1));
            }
        }
        let key: Arc<str> = Arc::from(key);
        keys.entries.insert(
            Arc::clone(&key),
            KeyEntry {
                fingerprint,
                answer: None,
                number: 0,
            },
        );
        Ok(ClaimOutcome::New(KeyClaim {
            tenants: Arc::clone(&self.tenants),
            tenant: tenant.clone(),
            key,
            ledger: Arc::clone(&self.ledger),
            fingerprint,
            open: true,
        }))
    }
}

impl<A> TenantKeys<A> {
    /// Drops answers that are too old, and the oldest ones beyond `keys` and the bytes allowed.
    fn forget(&mut self, age: Duration, keys: usize, bytes: u64) {
        while let Some((when, number, _)) = self.finished.front() {
            let (when, number) = (*when, *number);
            if when.elapsed() < age && self.entries.len() <= keys && self.bytes <= bytes {
                break;
            }
            let Some((_, _, key)) = self.finished.pop_front() else {
                break;
            };
            if self
                .entries
                .get(&key)
                .is_some_and(|e| e.number == number && e.answer.is_some())
                && let Some(KeyEntry { answer: Some(kept), .. }) = self.entries.remove(&key)
            {
                self.bytes = self.bytes.saturating_sub(kept.bytes);
            }
        }
    }
}

impl<A> KeyClaim<A> {
    /// Tenant, key and the fingerprint of the request, to be kept with the commit that answers it.
    pub fn logged(&self) -> (Tenant, String, u128) {
        (self.tenant.clone(), self.key.to_string(), self.fingerprint.0)
    }

    /// Keeps the answer, which holds about `bytes`.
    pub fn complete(mut self, answer: A, bytes: u64) {
        self.open = false;
        let mut tenants = self.tenants.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(keys) = tenants.get_mut(&self.tenant) else {
            return;
        };
        let number = keys.finished.back().map_or(1, |(_, n, _)| n + 1);
        let Some(entry) = keys.entries.get_mut(&self.key) else {
            return;
        };
        // It was given already, so it is kept even where that breaks the budget.
        let counted = self.ledger.reserve_later(MemoryUse::KeptAnswers, None);
        let _ = counted.resize(bytes);
        entry.answer = Some(KeptAnswer {
            answer,
            bytes,
            _counted: Some(counted),
        });
        entry.number = number;
        keys.bytes = keys.bytes.saturating_add(bytes);
        keys.finished.push_back((Instant::now(), number, Arc::clone(&self.key)));
    }
}

impl<A> Drop for KeyClaim<A> {
    fn drop(&mut self) {
        if self.open {
            let mut tenants = self.tenants.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(keys) = tenants.get_mut(&self.tenant) {
                keys.entries.remove(&self.key);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys_with(config: SessionConfig) -> IdempotencyKeys<u32> {
        IdempotencyKeys::new(&config, &MemoryLedger::new(1 << 20, Arc::default()))
    }

    fn keep(store: &IdempotencyKeys<u32>, key: &str, body: &str, answer: u32) {
        match store
            .claim(
                &Tenant::default(),
                key,
                RequestFingerprint::of("op", &[body.as_bytes()]),
            )
            .expect("claimed")
        {
            ClaimOutcome::New(claim) => claim.complete(answer, 8),
            ClaimOutcome::Done(_) => panic!("{key} is taken"),
        }
    }

    fn ask(store: &IdempotencyKeys<u32>, key: &str, body: &str) -> Result<Option<u32>, Error> {
        let claimed = store.claim(
            &Tenant::default(),
            key,
            RequestFingerprint::of("op", &[body.as_bytes()]),
        )?;
        Ok(if let ClaimOutcome::Done(answer) = claimed {
            Some(answer)
        } else {
            None
        })
    }

    #[tokio::test]
    async fn the_first_answer_is_given_again() {
        let store = keys_with(SessionConfig::default());
        keep(&store, "a", "x", 1);
        assert_eq!(ask(&store, "a", "x").expect("same request"), Some(1));
        assert_eq!(ask(&store, "a", "y").expect_err("another request").http_status(), 422);
        let other = Tenant(Arc::from("other"));
        let theirs = store
            .claim(&other, "a", RequestFingerprint::of("op", &[b"y"]))
            .expect("keys belong to tenants");
        assert!(matches!(theirs, ClaimOutcome::New(_)));
    }

    #[tokio::test]
    async fn an_answer_that_is_too_old_is_forgotten() {
        let store = keys_with(SessionConfig {
            idempotency_age: Duration::ZERO,
            ..SessionConfig::default()
        });
        keep(&store, "a", "x", 1);
        assert_eq!(ask(&store, "a", "y").expect("forgotten"), None);
        let tenants = store.tenants.lock().expect("no panic");
        assert!(tenants[&Tenant::default()].entries.is_empty() && tenants[&Tenant::default()].bytes == 0);
    }

    #[tokio::test]
    async fn a_running_call_holds_its_key_and_a_failed_one_frees_it() {
        let store: IdempotencyKeys<u32> = keys_with(SessionConfig::default());
        let claim = store
            .claim(&Tenant::default(), "a", RequestFingerprint::of("op", &[]))
            .expect("new");
        let error = store
            .claim(&Tenant::default(), "a", RequestFingerprint::of("op", &[]))
            .expect_err("runs");
        assert_eq!((error.http_status(), error.code_name()), (409, "ABORTED"));
        drop(claim);
        assert!(matches!(
            store.claim(&Tenant::default(), "a", RequestFingerprint::of("op", &[])),
            Ok(ClaimOutcome::New(_))
        ));
    }

    #[tokio::test]
    async fn keys_are_bounded_and_checked() {
        let store = keys_with(SessionConfig {
            idempotency_keys: 2,
            ..SessionConfig::default()
        });
        for (k, key) in ["a", "b", "c"].into_iter().enumerate() {
            keep(&store, key, key, k as u32);
        }
        assert_eq!(ask(&store, "c", "c").expect("kept"), Some(2));
        assert_eq!(ask(&store, "b", "b").expect("kept"), Some(1));
        assert_eq!(ask(&store, "a", "a").expect("made room"), None);
        for bad in ["", "two words", "é", &"k".repeat(256)] {
            assert_eq!(ask(&store, bad, "x").expect_err("no key").http_status(), 422, "{bad:?}");
        }
        let _running: Vec<_> = ["p", "q"]
            .map(|k| store.claim(&Tenant::default(), k, RequestFingerprint::of("o", &[])))
            .into();
        let full = store
            .claim(&Tenant::default(), "r", RequestFingerprint::of("o", &[]))
            .expect_err("both run");
        assert_eq!(full.http_status(), 429);
    }

    #[test]
    fn requests_differ_by_where_their_parts_end() {
        assert_ne!(
            RequestFingerprint::of("a", &[b"bc", b"d"]),
            RequestFingerprint::of("a", &[b"b", b"cd"])
        );
        assert_ne!(
            RequestFingerprint::of("ab", &[b""]),
            RequestFingerprint::of("a", &[b"b"])
        );
    }
}
