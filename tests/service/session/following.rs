//! Sessions whose engine follows edits: going back gives the same bits as having stayed.

use super::bench::obj;
use super::fake::*;
use super::real::turned;
use glam::DVec3;
use pliant::asset::shapes;
use pliant::session::{Manager, SessionConfig};
use pliant::wire::pb;

/// A session with a bar of some thousand vertices, held at its ends.
async fn bar(manager: &Manager) -> String {
    let files = obj(&shapes::box_with_cells(DVec3::new(1.0, 1.0, 3.0), [12, 12, 36]));
    let made = manager
        .create(tenant(), files, pb::CreateOptions::default(), None)
        .await;
    let id = made.expect("a bar").value.id;
    let end = |name: &str, z: f64, offset: f64| pb::Handle {
        id: name.into(),
        region: Some(pb::Region {
            region: Some(pb::region::Region::HalfSpace(pb::region::HalfSpace {
                normal: vec![0.0, 0.0, z],
                offset,
            })),
        }),
        ..Default::default()
    };
    let request = pb::SetHandlesRequest {
        session_id: id.clone(),
        handles: vec![end("base", -1.0, -0.4), end("top", 1.0, 2.6)],
        ..Default::default()
    };
    manager.set_handles(tenant(), request, None).await.expect("two handles");
    id
}

fn delete(id: &str, height: f64) -> pb::EditRequest {
    let sphere = pb::region::Sphere {
        center: vec![1.0, 0.5, height],
        radius: 0.25,
    };
    let delete = pb::edit_request::Delete {
        region: Some(pb::Region {
            region: Some(pb::region::Region::Sphere(sphere)),
        }),
        fill: true,
    };
    pb::EditRequest {
        session_id: id.into(),
        operation: Some(pb::edit_request::Operation::Delete(delete)),
        ..Default::default()
    }
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
            let bent = manager.solve(tenant(), turned(&id, 0.2), None).await.expect("solved");
            after.push(bent.digest);
            let edit = manager
                .edit(tenant(), delete(&id, 0.8 + 0.4 * f64::from(k)), None)
                .await
                .expect("an edit");
            assert!(edit.repaired, "edit {k} is followed");
        }
        // Back to before each pose, newest first, and the same pose again.
        for digest in after.iter().rev() {
            for _ in 0..2 {
                manager.undo(tenant(), &id, None).await.expect("undone");
            }
            let again = manager.solve(tenant(), turned(&id, 0.2), None).await.expect("solved");
            assert_eq!(again.digest, *digest);
            manager.undo(tenant(), &id, None).await.expect("undone");
        }
    }
}

/// An edit on the rest shape that changes nothing.
fn idle(id: &str) -> pb::EditRequest {
    let weld = pb::edit_request::Weld { tolerance: 1e-6 };
    pb::EditRequest {
        session_id: id.into(),
        on: pb::edit_request::On::Rest.into(),
        operation: Some(pb::edit_request::Operation::Weld(weld)),
    }
}

#[tokio::test]
async fn an_edit_of_the_rest_shape_solves_as_the_pose_was_solved() {
    let manager = Manager::new(small()).expect("valid");
    let id = bar(&manager).await;
    let untouched = manager.edit(tenant(), idle(&id), None).await.expect("an edit");
    assert!(
        !untouched.ms.contains_key("solve"),
        "nothing is posed: {:?}",
        untouched.ms
    );
    for refine in [0, 3] {
        let options = pb::Options {
            refine: Some(refine),
            ..Default::default()
        };
        let pose = pb::SolveRequest {
            options: Some(options),
            ..turned(&id, 0.9)
        };
        let bent = manager.solve(tenant(), pose, None).await.expect("solved");
        let edit = manager.edit(tenant(), idle(&id), None).await.expect("an edit");
        assert_eq!(edit.digest, bent.digest, "refine {refine}");
    }
}

#[tokio::test]
async fn a_session_tells_the_poses_in_force() {
    let manager = Manager::new(small()).expect("valid");
    let id = bar(&manager).await;
    let pose = |session: &pb::Session, k: usize| session.handles[k].pose.clone();
    let session = manager.get(tenant(), &id).await.expect("it is there");
    assert_eq!((pose(&session, 0), pose(&session, 1)), (None, None));
    manager.solve(tenant(), turned(&id, 0.2), None).await.expect("solved");
    let session = manager.get(tenant(), &id).await.expect("it is there");
    let turned = pose(&session, 1).expect("the top is turned");
    assert_eq!((pose(&session, 0), turned.rotation_vector), (None, vec![0.2, 0.0, 0.0]));
    manager.undo(tenant(), &id, None).await.expect("undone");
    let session = manager.get(tenant(), &id).await.expect("it is there");
    assert_eq!(pose(&session, 1), None);
}

#[tokio::test]
async fn an_edit_is_held_to_the_memory_that_other_sessions_leave() {
    let open = Manager::new(small()).expect("valid");
    let id = bar(&open).await;
    let one = open.metrics().bytes.get() as u64;
    let twice = |id: &str| pb::EditRequest {
        session_id: id.into(),
        operation: Some(pb::edit_request::Operation::Subdivide(Default::default())),
        ..Default::default()
    };
    open.edit(tenant(), twice(&id), None).await.expect("there is room");

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
        if let Err(e) = manager.edit(tenant(), twice(id), None).await {
            refused = Some((id, e));
            break;
        }
        let held = manager.metrics().bytes.get() as u64;
        assert!(held <= 12 * one, "{held} bytes are held, {one} by a bar");
    }
    let (id, error) = refused.expect("at some time there is no room");
    assert!(
        [413, 429].contains(&error.http_status()) && error.message.contains("memory"),
        "{error:?}"
    );
    manager
        .solve(tenant(), turned(id, 0.1), None)
        .await
        .expect("the session goes on");
}
