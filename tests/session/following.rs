//! Sessions whose engine follows edits: going back gives the same bits as having stayed.

use super::fake::*;
use super::real::turned;
use glam::DVec3;
use pliant::asset::{FileSet, shapes};
use pliant::job::pb;
use pliant::session::{Config, Manager};

/// A session with a bar of some thousand vertices, held at its ends.
async fn bar(manager: &Manager) -> String {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(1.0, 1.0, 3.0), [12, 12, 36]);
    let mut text = String::new();
    positions
        .iter()
        .for_each(|p| text += &format!("v {} {} {}\n", p.x, p.y, p.z));
    triangles
        .iter()
        .for_each(|t| text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
    let files = FileSet::single("bar.obj", text.into_bytes());
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
        let config = Config {
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
