//! Sessions whose engine follows edits: going back gives the same bits as having stayed.

use super::bench::obj;
use super::edits::edit_of;
use super::fake::*;
use super::real::turned;
use glam::DVec3;
use pliant::asset::shapes;
use pliant::engine::{Handle, HandlePose, HandleSet, Region};
use pliant::graph::VolumeOptions;
use pliant::session::MemoryUse;
use pliant::session::{Manager, SessionConfig};
use pliant::wire::SessionEdit;

/// A session with a bar of some thousand vertices, held at its ends.
async fn bar(manager: &Manager) -> String {
    let files = obj(&shapes::box_with_cells(DVec3::new(1.0, 1.0, 3.0), [12, 12, 36]));
    // A graph of kind PAPER follows edits.
    let mut options = options();
    options.open.body.graph = VolumeOptions::paper();
    let made = manager.create(tenant(), files, options, None).await;
    let id = made.expect("a bar").value.id;
    let handles = HandleSet::from([
        Handle::new("base", Region::half_space([0.0, 0.0, -1.0], -0.4)),
        Handle::new("top", Region::half_space([0.0, 0.0, 1.0], 2.6)),
    ]);
    let set = manager.set_handles(tenant(), &id, handles, None).await;
    set.expect("two handles");
    id
}

fn delete(height: f64) -> SessionEdit {
    edit_of(&format!(
        r#"{{"delete": {{"region": {{"sphere": {{"center": [1, 0.5, {height:?}], "radius": 0.25}}}}, "fill": true}}}}"#
    ))
}

#[tokio::test]
async fn a_pose_after_going_back_has_the_bits_that_it_had_before() {
    for snapshot_bytes in [1 << 26, 0] {
        let config = SessionConfig {
            snapshot_bytes,
            ..small()
        };
        let manager = Manager::new(config).expect("valid");
        let id = bar(&manager).await;
        let mut after = Vec::new();
        for k in 0..4 {
            let bent = manager.solve(tenant(), &id, turned(0.2), None).await.expect("solved");
            after.push(bent.digest);
            let edit = manager
                .edit(tenant(), &id, delete(0.8 + 0.4 * f64::from(k)), None)
                .await
                .expect("an edit");
            assert!(edit.report.repaired, "edit {k} is followed");
        }
        // Back to before each pose, newest first, and the same pose again.
        for digest in after.iter().rev() {
            for _ in 0..2 {
                manager.undo(tenant(), &id, None).await.expect("undone");
            }
            let again = manager.solve(tenant(), &id, turned(0.2), None).await.expect("solved");
            assert_eq!(again.digest, *digest);
            manager.undo(tenant(), &id, None).await.expect("undone");
        }
    }
}

/// An edit on the rest shape that changes nothing.
fn idle() -> SessionEdit {
    edit_of(r#"{"on": "REST", "weld": {"tolerance": 1e-6}}"#)
}

#[tokio::test]
async fn an_edit_of_the_rest_shape_solves_as_the_pose_was_solved() {
    let manager = Manager::new(small()).expect("valid");
    let id = bar(&manager).await;
    let untouched = manager.edit(tenant(), &id, idle(), None).await.expect("an edit");
    assert!(
        !untouched.ms.contains_key("solve"),
        "nothing is posed: {:?}",
        untouched.ms
    );
    for refine in [0, 3] {
        let mut pose = turned(0.9);
        pose.options.solve.refine = Some(refine);
        let bent = manager.solve(tenant(), &id, pose, None).await.expect("solved");
        let edit = manager.edit(tenant(), &id, idle(), None).await.expect("an edit");
        assert_eq!(edit.report.digest, bent.digest, "refine {refine}");
    }
}

#[tokio::test]
async fn a_session_tells_the_poses_in_force() {
    let manager = Manager::new(small()).expect("valid");
    let id = bar(&manager).await;
    let poses = async || manager.get(tenant(), &id).await.expect("it is there").poses;
    assert_eq!(poses().await.0.as_slice(), [HandlePose::default(); 2]);
    manager.solve(tenant(), &id, turned(0.2), None).await.expect("solved");
    let turned = HandlePose::rotation([0.2, 0.0, 0.0]);
    assert_eq!(poses().await.0.as_slice(), [HandlePose::default(), turned]);
    manager.undo(tenant(), &id, None).await.expect("undone");
    assert_eq!(poses().await.0.as_slice(), [HandlePose::default(); 2]);
}

#[tokio::test]
async fn an_edit_is_held_to_the_memory_that_other_sessions_leave() {
    let open = Manager::new(small()).expect("valid");
    let id = bar(&open).await;
    let one = open.metrics().held_bytes(MemoryUse::Sessions).get() as u64;
    let twice = || edit_of(r#"{"subdivide": {"scheme": "LOOP"}}"#);
    open.edit(tenant(), &id, twice(), None).await.expect("there is room");

    let manager = Manager::new(SessionConfig {
        memory_bytes: 12 * one,
        ..small()
    })
    .expect("valid");
    let (mut ids, mut refused) = (Vec::new(), None);
    for _ in 0..3 {
        ids.push(bar(&manager).await);
    }
    for id in ids.iter().cycle().take(9) {
        if let Err(e) = manager.edit(tenant(), id, twice(), None).await {
            refused = Some((id, e));
            break;
        }
        let held = manager.metrics().held_bytes(MemoryUse::Sessions).get() as u64;
        assert!(held <= 12 * one, "{held} bytes are held, {one} by a bar");
    }
    let (id, error) = refused.expect("at some time there is no room");
    assert!(
        [413, 429].contains(&error.http_status()) && error.message.contains("memory"),
        "{error:?}"
    );
    manager
        .solve(tenant(), id, turned(0.1), None)
        .await
        .expect("the session goes on");
}
