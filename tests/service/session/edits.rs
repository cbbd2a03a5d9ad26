//! Edits in sessions: one commit each, undone and redone bit for bit, refused whole.

use super::bench::obj;
use super::fake::*;
use super::real::{bent, bent_in, turned, turning};
use glam::DVec3;
use pliant::asset::shapes;
use pliant::engine::{Handle, HandlePose, HandleSet, Region};
use pliant::graph::VolumeOptions;
use pliant::session::{ErrorCode, Manager, MemoryUse, SessionConfig};
use pliant::wire::{SessionEdit, json, session_edit};

/// An edit, as a request in JSON asks for it.
pub fn edit_of(request: &str) -> SessionEdit {
    session_edit(&json::from_json(request.as_bytes()).expect(request)).expect(request)
}

fn cut(height: f64, keep: &str) -> SessionEdit {
    edit_of(&format!(
        r#"{{"cut": {{"plane": {{"normal": [0, 0, 1], "offset": {height:?}}}, "keep": "{keep}", "fill": true}}}}"#
    ))
}

/// Puts another session's model `by` beside this one.
fn merge(other: &str, by: f64) -> SessionEdit {
    edit_of(&format!(
        r#"{{"merge": {{"session": "{other}", "how": "LOOSE", "transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, {by:?},0,0,1]}}}}"#
    ))
}

#[tokio::test]
async fn edits_are_undone_and_redone_to_the_bit_and_go_on_alike() {
    for snapshot_bytes in [1 << 24, 0] {
        let fixture = bent(limits(|config| config.snapshot_bytes = snapshot_bytes)).await;
        let mut digests = vec![fixture.digest().await];
        let mut said = Vec::new();
        digests.push(fixture.solve(turned(0.6)).await.digest);
        for height in [0.75, 1.4] {
            let result = fixture.edit(cut(height, "ABOVE")).await;
            assert!(result.after.expect("counts").vertices != result.before.expect("counts").vertices);
            assert_eq!(result.revision, fixture.history().await.current);
            said.push(result.after.expect("counts").vertices);
            digests.push(result.digest);
            // The base was cut off with the first edit, and what is left is held by the top alone.
            digests.push(fixture.solve(turned(0.3)).await.digest);
        }
        for digest in digests.iter().rev().skip(1) {
            fixture.undo().await;
            assert_eq!(fixture.digest().await, *digest);
        }
        let described = fixture.facts().await;
        assert_eq!(described.model.expect("model facts").vertices, 52);
        for digest in &digests[1..] {
            fixture.redo().await;
            assert_eq!(fixture.digest().await, *digest);
        }
        let described = fixture.facts().await;
        assert_eq!(described.model.expect("model facts").vertices, said[1]);
        let again = fixture.solve(turned(0.3)).await;
        assert_eq!(
            again.digest,
            *digests.last().expect("some"),
            "the same pose gives the same bits"
        );
        let kinds: Vec<String> = (fixture.history().await.commits.into_iter()).map(|c| c.kind).collect();
        assert_eq!(kinds[2..5], ["pose", "edit", "pose"]);
    }
}

#[tokio::test]
async fn a_refused_edit_changes_nothing() {
    let fixture = bent(small()).await;
    let before = (fixture.facts().await.revision, fixture.digest().await);
    let missed = fixture
        .manager
        .edit(tenant(), &fixture.id, cut(99.0, "BOTH"), None)
        .await
        .expect_err("misses");
    assert_eq!(missed.code, ErrorCode::FailedPrecondition);
    let unknown = fixture
        .manager
        .edit(tenant(), &fixture.id, merge("nobody", 0.0), None)
        .await
        .expect_err("no such session");
    assert_eq!(unknown.code, ErrorCode::NotFound);
    let after = (fixture.facts().await.revision, fixture.digest().await);
    assert_eq!(before, after);
}

#[tokio::test]
async fn an_edit_repeated_under_its_key_is_done_once() {
    let fixture = bent(small()).await;
    let request = cut(1.4, "BELOW");
    let first = fixture
        .manager
        .edit(tenant(), &fixture.id, request.clone(), key("k", ""))
        .await
        .expect("cut");
    let second = fixture
        .manager
        .edit(tenant(), &fixture.id, request, key("k", ""))
        .await
        .expect("the kept answer");
    assert_eq!(first, second);
    assert_eq!(fixture.facts().await.revision, first.revision);
}

#[tokio::test]
async fn a_session_is_wrapped_onto_the_shape_of_another_in_one_commit() {
    let fixture = bent(small()).await;
    let other = bent_in(&fixture.manager).await;
    other.solve(turned(0.3)).await;
    let (before, commits) = (fixture.digest().await, fixture.history().await.commits.len());
    let wrap = |source: &str| edit_of(&format!(r#"{{"wrap": {{"session": "{source}"}}}}"#));
    let result = fixture.edit(wrap(&other.id)).await;
    let told = result.wrap.expect("a report").to_target.expect("distances");
    assert!(told.p50 < 1e-3 && told.p95 < 1e-2, "{told:?}");
    let shown = fixture.digest().await;
    assert!(shown == result.digest && shown != before);
    let history = fixture.history().await;
    assert_eq!((history.commits.len(), history.current), (commits + 1, result.revision));
    fixture.undo().await;
    assert_eq!(fixture.digest().await, before);
    fixture.redo().await;
    assert_eq!(fixture.digest().await, result.digest);
    let unknown = fixture.manager.edit(tenant(), &fixture.id, wrap("nobody"), None).await;
    let unknown = unknown.expect_err("no such session");
    assert_eq!(
        (unknown.code, unknown.field.as_deref()),
        (ErrorCode::NotFound, Some("wrap.session"))
    );
    assert_eq!(fixture.digest().await, result.digest);
}

#[tokio::test]
async fn a_session_can_be_merged_with_another_of_its_tenant() {
    let fixture = bent(small()).await;
    let other = bent_in(&fixture.manager).await;
    let result = fixture.edit(merge(&other.id, 3.0)).await;
    assert_eq!(result.after.expect("counts").vertices, 104);
    let session = fixture.facts().await;
    assert_eq!(
        (
            session.solver.as_ref().map_or(0, |s| s.components),
            session.primitives.len()
        ),
        (2, 2)
    );
    assert_eq!(result.handles_kept, ["base", "top"]);
}

#[tokio::test]
async fn a_stream_goes_on_across_an_edit() {
    let fixture = bent(small()).await;
    let mut client = fixture.client().await;
    client.options(|options| options.output.changed_only = Some(1e-6));
    let mut sizes = Vec::new();
    for (seq, angle) in [(1, 0.2), (2, 0.3), (3, 0.4)] {
        client.push(turning(seq, angle, false));
        let frame = client.frame().await;
        assert!(frame.header.r#final);
        sizes.push(frame.selected.expect("changes only").len() as u32);
        client.ack(seq);
        if seq == 2 {
            fixture.edit(cut(1.4, "ABOVE")).await;
        }
    }
    let left = fixture.facts().await.model.expect("model facts").vertices;
    assert_eq!(sizes[2], left, "all vertices of the new shape: {sizes:?}");
}

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
        let fixture = bar(limits(|config| config.snapshot_bytes = snapshot_bytes)).await;
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
        pose.options.solve.quality.refine = Some(refine);
        let bent = fixture.solve(pose).await;
        let edit = fixture.edit(idle()).await;
        assert_eq!(edit.digest, bent.digest, "refine {refine}");
    }
}

#[tokio::test]
async fn a_session_reports_the_poses_in_force() {
    let fixture = bar(small()).await;
    let poses = async || -> Vec<_> { fixture.facts().await.handles.into_iter().map(|h| h.pose).collect() };
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
