//! What becomes of handles across an edit.

use super::*;
use crate::support::messages::DeformerMessages;

#[test]
fn handles_hold_what_lies_in_their_regions_after_an_edit() {
    let mut bench = held();
    let counts = |bench: &Deformer| -> Vec<u32> { bench.facts_message().handles.iter().map(|h| h.vertices).collect() };
    let before = counts(&bench);
    edited(&mut bench, &midpoint(Some(half_space([0.0, 0.0, 1.0], 1.4))));
    let after = counts(&bench);
    assert_eq!(before[0], after[0], "the base was not touched");
    assert!(
        after[1] > 3 * before[1],
        "what lies between held vertices is held: {before:?} {after:?}"
    );
    let above_plane = bench.rest().iter().filter(|p| p.z >= 1.5).count();
    assert_eq!(after[1] as usize, above_plane, "all that the plane leaves above it");
    let region = bench.handles_message().handles[1].region.clone();
    assert_eq!(region, Some(above(1.5)), "the region stays as it was given");
}

#[test]
fn a_region_that_a_pose_has_moved_is_the_list_of_its_vertices() {
    let mut bench = held();
    let before = bench.facts_message().handles[1].vertices;
    let shape = solve(&mut bench, &[("top", turn(DVec3::X * 1.2, DVec3::ZERO))], 1e-5).shape();
    edit(&mut bench, &midpoint(Some(half_space([0.0, 0.0, -1.0], 1.4))), &shape).expect("an edit");
    assert_eq!(
        bench.facts_message().handles[1].vertices,
        before,
        "the top was not touched"
    );
    let region = bench.handles_message().handles[1].region.clone().and_then(|r| r.region);
    let Some(pb::region::Region::Vertices(list)) = region else {
        panic!("its vertices have left their places, so that they are listed")
    };
    assert!(list.ranges.iter().map(|r| r.count).sum::<u32>() >= before);
}

#[test]
fn a_handle_that_loses_everything_is_gone_and_said_to_be() {
    let mut bench = bench(&bar());
    let middle = pb::Region {
        region: Some(pb::region::Region::Box(pb::region::Box {
            min: vec![-1.0, -1.0, -0.2],
            max: vec![1.0, 1.0, 0.2],
        })),
    };
    set(
        &mut bench,
        vec![
            handle("base", below(-1.5)),
            handle("middle", middle),
            handle("top", above(1.5)),
        ],
    );
    let outcome = edited(&mut bench, &cut_at(0.9, cut::Keep::Above, true));
    assert_eq!(outcome.result.handles_kept, ["top"]);
    let lost: Vec<&str> = outcome
        .result
        .warnings
        .iter()
        .filter(|w| w.code == "handle-lost")
        .map(|w| w.r#where.as_str())
        .collect();
    assert_eq!(lost, ["handles[0]", "handles[1]"]);
    assert_eq!(bench.facts_message().handles.len(), 1);
}

#[test]
fn weights_are_blended_and_stay_between_0_and_1() {
    let mut bench = bench(&bar());
    let values: Vec<f32> = bench.rest().iter().map(|p| ((p.z + 2.0) / 4.0) as f32).collect();
    let soft = pb::Handle {
        stiffness: Some(2.0),
        ..handle(
            "soft",
            pb::Region {
                region: Some(pb::region::Region::Weights(pb::region::Weights { values })),
            },
        )
    };
    set(&mut bench, vec![handle("base", below(-1.9)), soft]);
    edited(&mut bench, &midpoint(None));
    let region = bench.handles_message().handles[1].region.clone().and_then(|r| r.region);
    let Some(pb::region::Region::Weights(weights)) = region else {
        panic!("still weights")
    };
    assert_eq!(weights.values.len(), bench.rest().len());
    for (p, w) in bench.rest().iter().zip(weights.values) {
        assert!((f64::from(w) - (p.z + 2.0) / 4.0).abs() < 1e-6);
    }
}
