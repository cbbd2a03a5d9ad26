//! The example programs of the engine do what they say.

#[path = "../examples/custom_region.rs"]
mod custom_region;
#[path = "../examples/deform_file.rs"]
mod deform_file;
#[path = "../examples/drag_in_a_loop.rs"]
mod drag_in_a_loop;
#[path = "../examples/edit_between_poses.rs"]
mod edit_between_poses;
#[path = "../examples/progress_and_cancel.rs"]
mod progress_and_cancel;

use pliant::asset::{FileSet, Limits, Model, sample};

#[test]
fn a_file_is_deformed_and_can_be_read_again() {
    let before = sample::creature_glb().to_vec();
    let after = deform_file::turn_head(before.clone()).expect("it is turned");
    assert_ne!(before, after);
    let read =
        |glb| Model::read(FileSet::single("creature.glb", glb), None, &Limits::default()).expect("it is a model");
    assert_eq!(read(after).positions.len(), read(before).positions.len());
}

#[test]
fn a_drag_takes_few_cycles_a_pose() {
    let cycles = drag_in_a_loop::drag_head(6).expect("it drags");
    assert_eq!(cycles.len(), 6);
    assert!(cycles.iter().all(|&c| c <= 8), "{cycles:?}");
}

#[test]
fn an_edit_stands_between_poses() {
    let (report, shape) = edit_between_poses::cut_and_turn().expect("it cuts and turns");
    assert!(report.after.vertices < report.before.vertices);
    assert_eq!(shape.positions.len(), report.after.vertices as usize);
    assert_eq!(report.handles_kept, ["tail", "head"]);
}

#[test]
fn a_listed_region_goes_where_its_pose_says() {
    let (count, way) = custom_region::lift_what_sticks_out().expect("it lifts");
    assert!(count > 10, "{count}");
    assert!((way - 0.2).abs() < 1e-6, "{way}");
}

#[test]
fn opening_reports_its_stages_and_can_be_given_up() {
    let (stages, refused) = progress_and_cancel::watch_and_cancel().expect("it opens");
    assert_eq!(stages, ["read", "mesh", "graph", "hierarchy"]);
    assert_eq!(refused, "cancelled");
}
