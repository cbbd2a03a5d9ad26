//! Messages of the schema, as protobuf and as JSON, up to the values that they mean; frames as a client reads them; records of a
//! store, as bytes that a dying disk has changed; reports of `pliant check`, which come from other machines to be joined.

use pliant::check::report::{html_report, json_report, junit_report, merge_reports, read_report};
use pliant::engine::HandleSet;
use pliant::wire::frames::FrameReader;
use pliant::wire::record::{LoggedCommit, RecordedModel};
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

/// Handles that were accepted are the same when they are written and read again.
fn check_handles(request: pb::SetHandlesRequest) {
    let Ok(set) = wire::handle_set(&request) else { return };
    let written = wire::handle_set_message(&set);
    let again = wire::handle_set(&written).expect("handles that were written");
    assert_eq!(wire::handle_set_message(&again), written);
}

/// The first byte says which message the text is.
pub fn json(bytes: &[u8]) {
    let Some((&which, rest)) = bytes.split_first() else {
        return;
    };
    match which % 8 {
        0 => read_and_write::<pb::Job>(rest),
        1 => read_and_write::<pb::SetHandlesRequest>(rest),
        2 => read_and_write::<pb::EditRequest>(rest),
        3 => read_and_write::<pb::SolveRequest>(rest),
        4 => read_and_write::<pb::CreateOptions>(rest),
        5 => read_and_write::<pb::AnimateOptions>(rest),
        6 => read_and_write::<pb::Rig>(rest),
        _ => read_and_write::<pb::DeformRequest>(rest),
    }
}

/// A message that was read is the same when it is written and read again.
fn read_and_write<M: Message + Default + prost::Name + PartialEq>(text: &[u8]) {
    let Ok(message) = json::from_json::<M>(text) else {
        return;
    };
    let written = json::to_json(&message).expect("a message of the schema").to_string();
    let again: M = json::from_json(written.as_bytes()).expect("a message that was written");
    // Bytes, so that what is not a number equals itself.
    assert_eq!(again.encode_to_vec(), message.encode_to_vec());
}

/// Vertices of the model that the frames are of.
pub const VERTICES: usize = 48;

/// Parts that follow one another; what was refused is followed by what may still be read.
pub fn frames(mut bytes: &[u8]) {
    let mut reader = FrameReader::new(VERTICES);
    while let Ok(part) = pb::Frame::decode_length_delimited(&mut bytes) {
        let _ = reader.take(&part);
        let position = pb::frame::Attribute::Position;
        let numbers = reader.numbers(position).len();
        assert!(numbers == 0 || numbers == 3 * VERTICES, "{numbers} numbers");
        if bytes.is_empty() {
            return;
        }
    }
}

pub fn commit_records(bytes: &[u8]) {
    let Ok(commit) = LoggedCommit::read(bytes) else { return };
    assert!(!commit.kind().is_empty());
    let written = commit.write();
    let again = LoggedCommit::read(&written).expect("a record that was just written");
    assert_eq!(again.write(), written, "a record changes when it is written again");
}

pub fn model_records(bytes: &[u8]) {
    let Ok(model) = RecordedModel::read(bytes) else { return };
    let written = model.write();
    let again = RecordedModel::read(&written).expect("a record that was just written");
    assert_eq!(again.write(), written, "a record changes when it is written again");
}

pub fn reports(bytes: &[u8]) {
    let Ok(report) = read_report("r.json", bytes) else {
        return;
    };
    let written = json_report(&report, true).expect("a document").to_string();
    let again = read_report("r.json", written.as_bytes()).expect("a document that was just written");
    assert_eq!(
        json_report(&again, true).expect("as before").to_string(),
        written,
        "a report changes when it is written again"
    );
    // Whatever it says, it is text in a page and in XML.
    assert!(!html_report(&report).contains("<script"));
    let xml = junit_report(&report).expect("texts in memory");
    assert!(
        String::from_utf8(xml)
            .expect("UTF-8")
            .trim_end()
            .ends_with("</testsuites>")
    );
    let joined = merge_reports(vec![("a".into(), report.clone()), ("b".into(), report)]);
    assert!(joined.is_err(), "one shard, twice");
}
