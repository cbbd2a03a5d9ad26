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
async fn bar(config: SessionConfig) -> Fixture {
    bar_in(&Manager::new(config).expect("a valid configuration")).await
}

/// As [`bar`], in a manager that there is.
async fn bar_in(manager: &Manager) -> Fixture {
    let files = obj(&shapes::box_with_cells(DVec3::new(1.0, 1.0, 3.0), [12, 12, 36]));
    // A graph of kind PAPER follows edits.
    let mut options = options();
    options.open.body.graph = VolumeOptions::paper();
    let made = manager.create(tenant(), files, options, None).await;
    let (manager, id) = (manager.clone(), made.expect("a bar").value.id);
    let fixture = Fixture { manager, id };
    let handles = HandleSet::from([
        Handle::new("base", Region::half_space([0.0, 0.0, -1.0], -0.4)),
        Handle::new("top", Region::half_space([0.0, 0.0, 1.0], 2.6)),
    ]);
    fixture.set_handles(handles).await;
    fixture
}

fn delete(height: f64) -> SessionEdit {
    edit_of(&format!(
        r#"{{"delete": {{"region": {{"sphere": {{"center": [1, 0.5, {height:?}], "radius": 0.25}}}}, "fill": true}}}}"#
    ))
}

#[tokio::test]
async fn a_pose_after_going_back_has_the_bits_that_it_had_before() {
    for snapshot_bytes in [1 << 26, 0] {
        let fixture = bar(SessionConfig {
            snapshot_bytes,
            ..small()
        })
        .await;
        let mut after = Vec::new();
        for k in 0..4 {
            let bent = fixture.solve(turned(0.2)).await;
            after.push(bent.digest);
            let edit = fixture.edit(delete(0.8 + 0.4 * f64::from(k))).await;
            assert!(edit.repaired, "edit {k} is followed");
        }
        // Back to before each pose, newest first, and the same pose again.
        for digest in after.iter().rev() {
            for _ in 0..2 {
                fixture.undo().await;
            }
            let again = fixture.solve(turned(0.2)).await;
            assert_eq!(again.digest, *digest);
            fixture.undo().await;
        }
    }
}

/// An edit on the rest shape that changes nothing.
fn idle() -> SessionEdit {
    edit_of(r#"{"on": "REST", "weld": {"tolerance": 1e-6}}"#)
}

#[tokio::test]
async fn an_edit_of_the_rest_shape_solves_as_the_pose_was_solved() {
    let fixture = bar(small()).await;
    let untouched = fixture.edit(idle()).await;
    assert!(
        !untouched.ms.contains_key("solve"),
        "nothing is posed: {:?}",
        untouched.ms
    );
    for refine in [0, 3] {
        let mut pose = turned(0.9);
        pose.options.solve.refine = Some(refine);
        let bent = fixture.solve(pose).await;
        let edit = fixture.edit(idle()).await;
        assert_eq!(edit.digest, bent.digest, "refine {refine}");
    }
}

#[tokio::test]
async fn a_session_tells_the_poses_in_force() {
    let fixture = bar(small()).await;
    let poses = async || {
        fixture
            .facts()
            .await
            .handles
            .into_iter()
            .map(|h| h.pose)
            .collect::<Vec<_>>()
    };
    assert_eq!(poses().await, [None, None]);
    fixture.solve(turned(0.2)).await;
    let turned = pliant::wire::handle_pose_message(&HandlePose::rotation([0.2, 0.0, 0.0]));
    assert_eq!(poses().await, [None, Some(turned)]);
    fixture.undo().await;
    assert_eq!(poses().await, [None, None]);
}

#[tokio::test]
async fn an_edit_is_held_to_the_memory_that_other_sessions_leave() {
    let open = Manager::new(small()).expect("valid");
    let fixture = bar_in(&open).await;
    let one = open.metrics().held_bytes(MemoryUse::Sessions).get() as u64;
    let twice = || edit_of(r#"{"subdivide": {"scheme": "LOOP"}}"#);
    fixture.edit(twice()).await;

    let manager = Manager::new(SessionConfig {
        memory_bytes: 12 * one,
        ..small()
    })
    .expect("valid");
    let (mut bars, mut refused) = (Vec::new(), None);
    for _ in 0..3 {
        bars.push(bar_in(&manager).await);
    }
    for fixture in bars.iter().cycle().take(9) {
        if let Err(e) = manager.edit(tenant(), &fixture.id, twice(), None).await {
            refused = Some((fixture, e));
            break;
        }
        let held = manager.metrics().held_bytes(MemoryUse::Sessions).get() as u64;
        assert!(held <= 12 * one, "{held} bytes are held, {one} by a bar");
    }
    let (fixture, error) = refused.expect("at some time there is no room");
    assert!(
        [413, 429].contains(&error.http_status()) && error.message.contains("memory"),
        "{error:?}"
    );
    fixture.solve(turned(0.1)).await;
}
