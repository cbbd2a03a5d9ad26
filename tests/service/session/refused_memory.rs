//! The memory that is left grows from nothing until a call fits: before that the call is refused and nothing changes, and then its result
//! is the one that it has with room to spare.

use super::edits::edit_of;
use super::fake::*;
use super::real::{bar_files, bent_in, turned};
use pliant::session::{Error, ErrorCode, Manager, MemoryUse};

/// Makes a call until it fits, with more memory each time; its result, and how often it was refused.
async fn until_it_fits<T>(manager: &Manager, call: impl AsyncFn() -> Result<T, Error>) -> (T, u32) {
    let ledger = manager.ledger();
    let mut left = 256;
    for refused in 0.. {
        let free = ledger.total() - ledger.used();
        let taken = free.saturating_sub(left);
        let held = ledger
            .reserve(MemoryUse::Uploads, None, taken, taken)
            .expect("it is free");
        let answer = call().await;
        drop(held);
        match answer {
            Ok(done) => return (done, refused),
            Err(error) => assert!(
                matches!(error.code, ErrorCode::ResourceExhausted | ErrorCode::TooLarge),
                "{left} bytes: {error}"
            ),
        }
        assert!(taken > 0, "it fits into what is there");
        left = left * 5 / 4;
    }
    unreachable!("memory is finite")
}

#[tokio::test]
async fn what_does_not_fit_is_refused_and_changes_nothing() {
    let config = limits(|config| config.memory_bytes = 64 << 20);
    let reference = bent_in(&Manager::new(config.clone()).expect("a valid configuration")).await;
    let manager = Manager::new(config).expect("a valid configuration");
    let open = async || manager.create(tenant(), bar_files(), options(), None).await;
    let (opened, refused) = until_it_fits(&manager, open).await;
    assert!(refused > 3, "opening was refused {refused} times");
    let fixture = Fixture {
        id: opened.value.id,
        manager: manager.clone(),
    };
    let set = manager.handles(tenant(), &reference.id).await;
    assert!(set.is_err(), "the other manager's");
    let handles = reference
        .manager
        .handles(tenant(), &reference.id)
        .await
        .expect("handles");
    let unchanged = async |before: &pliant::wire::pb::HistoryResponse| {
        assert_eq!(&fixture.history().await, before, "a refused call changed something");
    };

    let before = fixture.history().await;
    let set = async || {
        unchanged(&before).await;
        manager.set_handles(tenant(), &fixture.id, handles.clone(), None).await
    };
    let (_, refused) = until_it_fits(&manager, set).await;
    assert!(refused > 3, "handles were refused {refused} times");

    let before = fixture.history().await;
    let pose = async || {
        unchanged(&before).await;
        manager.solve(tenant(), &fixture.id, turned(0.6), None).await
    };
    let (posed, _) = until_it_fits(&manager, pose).await;
    assert_eq!(posed.digest, reference.solve(turned(0.6)).await.digest);

    let before = fixture.history().await;
    let request = r#"{"cut": {"plane": {"normal": [0, 0, 1], "offset": 0.75}, "keep": "ABOVE", "fill": true}}"#;
    let edit = async || {
        unchanged(&before).await;
        manager.edit(tenant(), &fixture.id, edit_of(request), None).await
    };
    let (edited, refused) = until_it_fits(&manager, edit).await;
    assert!(refused > 3, "the edit was refused {refused} times");
    assert_eq!(edited.digest, reference.edit(edit_of(request)).await.digest);

    manager.delete(tenant(), &fixture.id).await.expect("it is there");
    assert_eq!(manager.ledger().used(), 0, "all is given back");
}
