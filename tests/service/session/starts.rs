//! Commits and frames that go on from the shape of a commit: undone, kept in a store, and refused where that is none of theirs.

use super::fake::*;
use super::real::{bent_in, manager_of, turned, turning};
use pliant::engine::{Handle, HandleSet, Method, Region};
use pliant::session::{Manager, SessionConfig};
use pliant::wire::{DeformOptions, PoseCommit};

/// The top turned, from the shape of a commit.
fn from(revision: u64, angle: f64) -> PoseCommit {
    PoseCommit {
        options: DeformOptions {
            from_revision: Some(revision),
            ..stream_options()
        },
        ..turned(angle)
    }
}

async fn problem(fixture: &Fixture, commit: PoseCommit) -> String {
    let before = fixture.digest().await;
    let refused = fixture.refuses(commit).await;
    assert_eq!(fixture.digest().await, before, "nothing has changed");
    assert_eq!(refused.field.as_deref(), Some("options.fromRevision"), "{refused:?}");
    refused.message
}

#[tokio::test(flavor = "multi_thread")]
async fn a_commit_goes_on_from_another_and_undoes_and_reopens_to_the_same_bits() {
    let folder = tempfile::tempdir().expect("a folder");
    let manager = manager_of(folder.path()).await;
    let fixture = bent_in(&manager).await;
    let there = fixture.solve(turned(2.8)).await;
    let plain = fixture.solve(turned(-2.8)).await;
    let kept = fixture.solve(from(there.revision, -2.8)).await;
    assert_ne!(
        kept.digest, plain.digest,
        "the shape depends on where its fits go on from"
    );
    let onward = fixture.solve(from(kept.revision, -2.4)).await;
    fixture.solve(turned(0.3)).await;
    let again = fixture.solve(from(there.revision, -2.8)).await;
    assert_eq!(again.digest, kept.digest, "and on nothing else");

    // Frames that are solved as commits are, and a commit of them.
    let mut client = fixture.client().await;
    client.options(|options| {
        options.from_revision = Some(there.revision);
        options.fits_coarse_first = true;
    });
    client.push(turning(1, 1.0, false));
    client.frame().await;
    client.ack(1);
    client.push(turning(2, -2.8, false));
    // Folds of a frame are not looked at, those of a commit are.
    let seen = client.frame().await.x;
    client.ack(2);
    client.push(turning(5, 0.5, false));
    client.frame().await;
    client.ack(5);
    client.push(turning(6, -2.8, false));
    assert_eq!(client.frame().await.x, seen, "whatever was dragged before");
    client.ack(6);
    client.push(turning(7, -2.8, true));
    client.frame().await;
    client.ack(7);
    assert_eq!(fixture.digest().await, kept.digest);
    client.options(|options| options.from_revision = Some(1000));
    client.push(turning(8, 1.0, true));
    assert_eq!(client.error().await.1.field.as_deref(), Some("options.fromRevision"));
    drop(client);
    let id = fixture.id.clone();
    drop(fixture);
    close(manager).await;

    let manager = manager_of(folder.path()).await;
    let fixture = Fixture {
        manager: manager.clone(),
        id,
    };
    assert_eq!(fixture.digest().await, kept.digest, "as it was stored");
    for _ in 0..3 {
        fixture.undo().await;
    }
    assert_eq!(
        fixture.digest().await,
        onward.digest,
        "solved again from two others in turn"
    );
    fixture.undo().await;
    assert_eq!(fixture.digest().await, kept.digest);
    fixture.undo().await;
    assert_eq!(fixture.digest().await, plain.digest);
    close(manager).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn shapes_of_other_handles_and_too_many_in_turn_are_refused() {
    let manager = Manager::new(SessionConfig::default()).expect("a manager");
    let fixture = bent_in(&manager).await;
    let rest = fixture.facts().await.revision;
    let first = fixture.solve(from(rest, 0.1)).await;
    assert!(
        problem(&fixture, from(first.revision + 1, 0.1))
            .await
            .contains(&format!("from 1 to {}", first.revision))
    );
    let mut last = first.revision;
    let refused = loop {
        let commit = from(last, 0.1);
        match fixture.manager.solve(tenant(), &fixture.id, commit, None).await {
            Ok(solved) => last = solved.revision,
            Err(refused) => break refused,
        }
    };
    assert!(refused.message.contains("allowed are 15"), "{refused:?}");
    assert_eq!(last - first.revision, 15, "from rest, and fifteen commits");

    let rbf = PoseCommit {
        options: DeformOptions {
            solve: pliant::engine::SolveSettings {
                method: Method::SpatialRbf,
                ..stream_options().solve
            },
            ..from(first.revision, 0.2).options
        },
        ..turned(0.2)
    };
    assert_eq!(fixture.refuses(rbf).await.field.as_deref(), Some("options.method"));

    let handles = HandleSet::from([
        Handle::new("base", Region::half_space([0.0, 0.0, -1.0], -0.3)),
        Handle::new("top", Region::half_space([0.0, 0.0, 1.0], 2.5)),
    ]);
    fixture.set_handles(handles).await;
    assert!(problem(&fixture, from(first.revision, 0.1)).await.contains("handles"));
    // Its handles are those of now, but not its shape's.
    let set = fixture.facts().await.revision;
    assert!(problem(&fixture, from(set, 0.1)).await.contains("handles"));
}
