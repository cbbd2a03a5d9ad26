//! A hand that is turned over twists the forearm evenly instead of wringing the wrist.

use crate::arm::{animate, arm_rig, clip_text, frames, open_arm};
use pliant_core::engine::AnimationRefinement;
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

#[test]
fn a_wrist_turned_by_150_degrees_keeps_its_volume() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = open_arm(&exec);
    let volume = |slices: usize, refinement: AnimationRefinement| {
        let text = clip_text(0.0, &[[0.0, 150.0]]);
        let animation = animate(&deformer, &text, arm_rig(slices), refinement, &exec);
        let frame = frames(&animation, 0..1, 1, &exec).remove(0);
        let quality = deformer.quality(&frame.positions, &pool);
        (quality.volume_change, quality.flipped_triangles)
    };
    let (sliced, flipped) = volume(3, AnimationRefinement::Carried);
    assert!(sliced > -0.12 && flipped == 0, "{sliced}, {flipped} flipped");
    let (whole, _) = volume(1, AnimationRefinement::Steps(0));
    assert!(whole < sliced - 0.02, "three slices {sliced}, one {whole}");
}
