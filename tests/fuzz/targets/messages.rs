//! Messages of the schema, as protobuf and as JSON, up to the values that they mean.

use pliant::engine::HandleSet;
use pliant::wire::{self, StreamLimits, json, pb};
use prost::Message;
use std::time::Duration;

/// The first byte says which message the others are.
pub fn messages(bytes: &[u8]) {
    let Some((&which, rest)) = bytes.split_first() else {
        return;
    };
    match which % 10 {
        0 => decoded(rest, check_handles),
        1 => decoded(rest, |request: pb::EditRequest| drop(wire::session_edit(&request))),
        2 => decoded(rest, |request: pb::SolveRequest| drop(wire::pose_commit(&request, 8))),
        3 => decoded(rest, |request: pb::DeformRequest| {
            let limits = StreamLimits {
                window: 8,
                pose_entries: 64,
            };
            drop(wire::stream_request(&request, limits));
        }),
        4 => decoded(rest, |create: pb::CreateOptions| {
            drop(wire::session_options(
                &create,
                Duration::from_secs(1)..=Duration::from_secs(3600),
            ));
        }),
        5 => decoded(rest, |request: pb::CarryRequest| drop(wire::carry_order(&request))),
        6 => decoded(rest, |options: pb::AnimateOptions| {
            drop(wire::animate_order(&options, 8, 1 << 20))
        }),
        7 => decoded(rest, |rig: pb::Rig| drop(wire::motion_rig(&rig))),
        8 => decoded(rest, |request: pb::ListSessionsRequest| {
            drop(wire::session_page(&request))
        }),
        _ => decoded(rest, |handle: pb::Handle| {
            let fields = ["region", "pose", "constrains", "stiffness", "rigid", "falloff"].map(str::to_owned);
            drop(wire::handle_patch(&handle, &fields, &HandleSet::default()));
        }),
    }
}

fn decoded<M: Message + Default>(bytes: &[u8], check: impl FnOnce(M)) {
    if let Ok(message) = M::decode(bytes) {
        check(message);
    }
}

/// Handles that were accepted are the same when they are told and read again.
fn check_handles(request: pb::SetHandlesRequest) {
    let Ok(set) = wire::handle_set(&request) else { return };
    let told = wire::handle_set_message(&set);
    let again = wire::handle_set(&told).expect("handles that were told");
    assert_eq!(wire::handle_set_message(&again), told);
}

/// The first byte says which message the text is.
pub fn json(bytes: &[u8]) {
    let Some((&which, rest)) = bytes.split_first() else {
        return;
    };
    match which % 8 {
        0 => read_and_told::<pb::Job>(rest),
        1 => read_and_told::<pb::SetHandlesRequest>(rest),
        2 => read_and_told::<pb::EditRequest>(rest),
        3 => read_and_told::<pb::SolveRequest>(rest),
        4 => read_and_told::<pb::CreateOptions>(rest),
        5 => read_and_told::<pb::AnimateOptions>(rest),
        6 => read_and_told::<pb::Rig>(rest),
        _ => read_and_told::<pb::DeformRequest>(rest),
    }
}

/// A message that was read is the same when it is told and read again.
fn read_and_told<M: Message + Default + prost::Name + PartialEq>(text: &[u8]) {
    let Ok(message) = json::from_json::<M>(text) else {
        return;
    };
    let told = json::to_json(&message).expect("a message of the schema").to_string();
    let again: M = json::from_json(told.as_bytes()).expect("a message that was told");
    // Bytes, so that what is no number equals itself.
    assert_eq!(again.encode_to_vec(), message.encode_to_vec());
}
