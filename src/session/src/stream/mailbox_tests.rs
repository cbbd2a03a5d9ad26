//! The state of a stream, driven without a session: whatever the order of events, its counts balance and it stays bounded.

use super::*;
use crate::capacity::memory_ledger::MemoryLedger;
use crate::capacity::memory_use::MemoryUse;
use crate::stream::waiting_poses::WAITING_DRAGS;
use glam::DVec3;
use pliant_core::engine::{HandlePose, VertexTargets};
use pliant_wire::pb;
use proptest::prelude::*;

fn mailbox(config: &SessionConfig) -> Mailbox {
    let held = MemoryLedger::new(1 << 20, Arc::default()).reserve_later(MemoryUse::Sessions, None);
    Mailbox::new("here", &"anyone".into(), config, Arc::default(), Arc::default(), held)
}

fn posed(seq: u64, entries: PoseEntries, commit: bool) -> StreamRequest {
    StreamRequest::Pose {
        seq,
        commit,
        more: false,
        key: None,
        entries: Ok(entries),
    }
}

fn pose(seq: u64, ids: &[&str], commit: bool) -> StreamRequest {
    let at_rest = |id: &&str| ((*id).to_owned(), Ok(HandlePose::default()));
    posed(seq, ids.iter().map(at_rest).collect(), commit)
}

fn options(window: u32) -> StreamRequest {
    StreamRequest::Options(Ok(DeformOptions {
        window,
        ..DeformOptions::with_defaults(8)
    }))
}

fn frame(seq: u64, last: bool) -> Frame {
    Frame {
        header: pb::Frame {
            seq,
            r#final: last,
            ..Default::default()
        },
        positions: Arc::new(vec![DVec3::ZERO]),
        part_bytes: 1 << 20,
        ..Frame::default()
    }
}

/// Does work as a session would, with every pose being right.
fn complete(mailbox: &Mailbox, work: Vec<WaitingPose>) -> u64 {
    let merged: u32 = work.iter().map(|p| p.poses - 1).sum();
    let seq = work.last().expect("never empty").seq;
    mailbox.settle_unsolved(Vec::new(), merged + work.len() as u32 - 1);
    mailbox.complete_work(mailbox.dragged_poses(), Some(frame(seq, true)));
    seq
}

fn collect_frame(mailbox: &Mailbox) -> Option<pb::Frame> {
    match mailbox.next_answer() {
        Poll::Ready(Some(StreamAnswer::Frame(frame))) => Some(frame.header),
        Poll::Pending => None,
        other => panic!("a frame was expected, not {other:?}"),
    }
}

#[test]
fn commits_bar_the_poses_behind_them() {
    let mailbox = mailbox(&SessionConfig::default());
    for (seq, commit) in [(1, false), (2, true), (3, false), (4, true), (5, false)] {
        mailbox.push(pose(seq, &["a"], commit)).expect("open");
    }
    let seqs = |work: &[WaitingPose]| work.iter().map(|p| p.seq).collect::<Vec<_>>();
    for expected in [vec![1, 2], vec![3, 4], vec![5]] {
        let work = mailbox.take_work().expect("work waits and the window is open");
        assert!(mailbox.take_work().is_none(), "one piece of work at a time");
        assert_eq!(seqs(&work), expected);
        let seq = complete(&mailbox, work);
        collect_frame(&mailbox).expect("its frame");
        mailbox.push(StreamRequest::Ack(seq)).expect("open");
    }
}

#[test]
fn an_acknowledgement_counts_for_frames_that_were_taken_only() {
    let mailbox = mailbox(&SessionConfig::default());
    for seq in 1..=2 {
        mailbox.push(pose(seq, &["a"], false)).expect("open");
        complete(&mailbox, mailbox.take_work().expect("room for two"));
    }
    mailbox.push(StreamRequest::Ack(9)).expect("open");
    mailbox.push(pose(3, &["a"], false)).expect("open");
    assert!(mailbox.take_work().is_none(), "two frames wait to be taken");
    assert_eq!(collect_frame(&mailbox).map(|f| f.seq), Some(1));
    assert!(mailbox.take_work().is_none(), "taken, not acknowledged");
    mailbox.push(StreamRequest::Ack(1)).expect("open");
    assert!(mailbox.take_work().is_some());
}

#[test]
fn the_last_place_of_the_window_is_for_the_final_frame() {
    let mailbox = mailbox(&SessionConfig::default());
    mailbox.push(pose(1, &["a"], false)).expect("open");
    let work = mailbox.take_work().expect("work");
    assert!(mailbox.wants_intermediate_frame());
    mailbox.send_frame(frame(1, false));
    assert!(!mailbox.wants_intermediate_frame());
    complete(&mailbox, work);
    assert_eq!(collect_frame(&mailbox).map(|f| f.r#final), Some(false));
    assert_eq!(collect_frame(&mailbox).map(|f| f.r#final), Some(true));
}

#[test]
fn a_window_of_one_holds_the_final_frame_until_the_first_is_acknowledged() {
    let mailbox = mailbox(&SessionConfig::default());
    mailbox.push(options(1)).expect("open");
    mailbox.push(pose(1, &["a"], false)).expect("open");
    let work = mailbox.take_work().expect("work");
    assert!(mailbox.wants_intermediate_frame());
    mailbox.send_frame(frame(1, false));
    complete(&mailbox, work);
    assert_eq!(collect_frame(&mailbox).map(|f| f.r#final), Some(false));
    mailbox.push(pose(2, &["a"], false)).expect("open");
    assert!(mailbox.next_answer().is_pending() && mailbox.take_work().is_none());
    mailbox.push(StreamRequest::Ack(1)).expect("open");
    assert_eq!(collect_frame(&mailbox).map(|f| (f.seq, f.r#final)), Some((1, true)));
}

#[test]
fn commits_of_a_stream_that_leaves_do_not_wait_for_its_reader() {
    let mailbox = mailbox(&SessionConfig::default());
    mailbox.push(options(1)).expect("open");
    mailbox.push(pose(1, &["a"], false)).expect("open");
    let work = mailbox.take_work().expect("work");
    mailbox.send_frame(frame(1, false));
    complete(&mailbox, work);
    for (seq, commit) in [(2, true), (3, false), (4, true), (5, false)] {
        mailbox.push(pose(seq, &["a"], commit)).expect("open");
    }
    assert!(mailbox.take_work().is_none(), "the window is full");
    mailbox.leave("the end is near");
    let mut stored = Vec::new();
    while let Some(work) = mailbox.take_work() {
        stored.push(complete(&mailbox, work));
    }
    assert_eq!(stored, [2, 4], "a drag waits on");
    assert!(matches!(
        mailbox.next_answer(),
        Poll::Ready(Some(StreamAnswer::Notice { code: "going-away", .. }))
    ));
    let frames: Vec<_> = std::iter::from_fn(|| collect_frame(&mailbox)).collect();
    let reported: Vec<_> = frames.iter().map(|f| (f.seq, f.r#final)).collect();
    assert_eq!(reported, [(1, false), (1, true), (2, true), (4, true)]);
    mailbox.push(StreamRequest::Ack(4)).expect("open");
    assert_eq!(mailbox.take_work().map(|work| complete(&mailbox, work)), Some(5));
}

#[test]
fn a_flood_is_merged_and_the_newest_entry_of_a_handle_wins() {
    let mailbox = mailbox(&SessionConfig {
        handles: 4,
        ..SessionConfig::default()
    });
    for seq in 1..=5000u64 {
        let entry = (
            ["a", "b", "c"][(seq % 3) as usize].to_owned(),
            Ok(HandlePose::translation([seq as f64, 0.0, 0.0])),
        );
        mailbox.push(posed(seq, vec![entry], false)).expect("open");
    }
    let work = mailbox.take_work().expect("work");
    assert!(work.len() <= WAITING_DRAGS + 1);
    assert_eq!(work.iter().map(|p| p.poses).sum::<u32>(), 5000);
    let mut merged = DraggedPoses::new();
    for pose in work {
        merged.extend(pose.entries.into_iter().map(|(id, pose)| (id, pose.expect("right"))));
    }
    let newest: Vec<f64> = merged.values().flat_map(|p| p.translation).map(|by| by.x).collect();
    assert_eq!(newest, [4998.0, 4999.0, 5000.0]);
}

#[test]
fn what_waits_is_bounded_whatever_is_sent() {
    let config = SessionConfig {
        handles: 4,
        stream_commits: 2,
        ..SessionConfig::default()
    };
    let mailbox = mailbox(&config);
    for seq in 1..=2000u64 {
        let ids: Vec<String> = (0..4).map(|k| format!("{}", seq * 10 + k)).collect();
        let ids: Vec<&str> = ids.iter().map(String::as_str).collect();
        mailbox.push(pose(seq, &ids, seq % 500 == 0)).expect("open");
        let entries: usize = mailbox.lock_state().waiting.iter().map(|w| w.entries.len()).sum();
        assert!(
            entries <= 2 * 4 + WAITING_DRAGS + 3 * 4,
            "{entries} entries wait after {seq} poses"
        );
        mailbox.push(StreamRequest::Ping(seq)).expect("open");
    }
    assert_eq!(mailbox.lock_state().pongs.len(), WAITING_PONGS);
    let reported: Vec<u64> = mailbox
        .lock_state()
        .notes
        .iter()
        .map(|n| {
            if let StreamAnswer::Failure { seq, .. } = n {
                *seq
            } else {
                0
            }
        })
        .collect();
    assert_eq!(reported, [1500, 2000], "the third and fourth commit were refused");
    let large = StreamRequest::Pose {
        seq: 3000,
        commit: false,
        more: false,
        key: None,
        entries: Err(WireError::invalid("pose.handles", "too many")),
    };
    mailbox.push(large).expect("open");
    assert_eq!(mailbox.lock_state().notes.len(), 3);
}

#[test]
fn errors_that_no_one_reads_end_the_stream() {
    let mailbox = mailbox(&SessionConfig::default());
    mailbox.push(pose(5, &[], false)).expect("open");
    let refused = (0..1000)
        .take_while(|_| mailbox.push(pose(1, &[], false)).is_ok())
        .count();
    assert_eq!(refused, WAITING_NOTES + 1);
    let answers: Vec<_> = (0..WAITING_NOTES + 2).map(|_| mailbox.next_answer()).collect();
    let Some(Poll::Ready(Some(StreamAnswer::Failure { error, seq }))) = answers.get(WAITING_NOTES) else {
        panic!("an error comes last")
    };
    assert_eq!((*seq, error.grpc_code()), (0, 8));
    assert!(matches!(answers.last(), Some(Poll::Ready(None))));
}

#[test]
fn wrong_options_end_the_stream() {
    let mailbox = mailbox(&SessionConfig::default());
    let wrong = StreamRequest::Options(Err(WireError::invalid("options.tolerance", "is NaN")));
    mailbox.push(wrong).expect("reported on the stream");
    let Poll::Ready(Some(StreamAnswer::Failure { error, seq })) = mailbox.next_answer() else {
        panic!("an error was expected")
    };
    assert_eq!((seq, error.grpc_code()), (0, 3));
    assert!(matches!(mailbox.next_answer(), Poll::Ready(None)));
    assert!(mailbox.push(pose(1, &[], false)).is_err());
}

#[derive(Debug, Clone)]
enum Event {
    Pose { commit: bool, wrong: bool },
    Take,
    Complete { fails: bool },
    More,
    Collect,
    Ack,
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        4 => (prop::bool::weighted(0.2), prop::bool::weighted(0.1)).prop_map(|(commit, wrong)| Event::Pose { commit, wrong }),
        2 => Just(Event::Take),
        2 => prop::bool::weighted(0.1).prop_map(|fails| Event::Complete { fails }),
        1 => Just(Event::More),
        2 => Just(Event::Collect),
        2 => Just(Event::Ack),
    ]
}

proptest! {
    /// Final frames plus errors plus the sum of `superseded` is the number of poses received, the window holds at all times,
    /// every commit that was taken in is answered, in order, and the last pose has a final frame.
    #[test]
    fn every_pose_is_counted_once(events in prop::collection::vec(event(), 0..120), window in 1u32..4) {
        let mailbox = mailbox(&SessionConfig { stream_commits: 3, ..SessionConfig::default() });
        mailbox.push(options(window)).expect("open");
        let (mut seq, mut sent, mut finals, mut errors, mut superseded) = (0u64, 0u32, Vec::new(), Vec::new(), 0u32);
        let mut commits = Vec::new();
        let (mut work, mut in_flight): (Option<Vec<WaitingPose>>, Vec<u64>) = (None, Vec::new());
        let mut collect = |in_flight: &mut Vec<u64>| -> bool {
            match mailbox.next_answer() {
                Poll::Ready(Some(StreamAnswer::Frame(frame))) => {
                    superseded += frame.header.superseded;
                    in_flight.push(frame.header.seq);
                    if frame.header.r#final {
                        finals.push(frame.header.seq);
                    }
                    true
                }
                Poll::Ready(Some(StreamAnswer::Failure { seq, .. })) => {
                    errors.push(seq);
                    true
                }
                Poll::Ready(Some(_)) => true,
                Poll::Ready(None) | Poll::Pending => false,
            }
        };
        let finish = |work: Vec<WaitingPose>, fails: bool| {
            let newest = work.last().map(|p| (p.seq, p.poses)).expect("never empty");
            let others: u32 = work.iter().map(|p| p.poses).sum::<u32>() - 1;
            mailbox.settle_unsolved(Vec::new(), others);
            if fails {
                mailbox.settle_unsolved(vec![(newest.0, Error::malformed("no"))], 0);
            }
            mailbox.complete_work(DraggedPoses::new(), (!fails).then(|| frame(newest.0, true)));
        };
        for event in events {
            match event {
                Event::Pose { commit, wrong } => {
                    sent += 1;
                    if wrong && seq > 0 {
                        mailbox.push(pose(seq, &["a"], commit)).expect("open");
                    } else {
                        seq += 1;
                        if commit {
                            commits.push(seq);
                        }
                        mailbox.push(pose(seq, &["a"], commit)).expect("open");
                    }
                }
                Event::Take => {
                    if work.is_none() {
                        work = mailbox.take_work();
                    }
                }
                Event::More => {
                    if work.is_some() && mailbox.wants_intermediate_frame() {
                        mailbox.send_frame(frame(work.as_ref().and_then(|w| w.last()).map_or(0, |p| p.seq), false));
                    }
                }
                Event::Complete { fails } => {
                    if let Some(work) = work.take() {
                        finish(work, fails);
                    }
                }
                Event::Collect => {
                    collect(&mut in_flight);
                }
                Event::Ack => {
                    let acknowledged = in_flight.first().copied().unwrap_or(0);
                    in_flight.retain(|&s| s > acknowledged);
                    mailbox.push(StreamRequest::Ack(acknowledged)).expect("open");
                }
            }
            let state = mailbox.lock_state();
            prop_assert!(state.frames.waiting.len() + in_flight.len() <= window as usize);
        }
        mailbox.finish();
        let mut ended = false;
        for _ in 0..1000 {
            if let Some(work) = work.take().or_else(|| mailbox.take_work()) {
                finish(work, false);
            }
            if !collect(&mut in_flight) && matches!(mailbox.next_answer(), Poll::Ready(None)) {
                ended = true;
                break;
            }
        }
        prop_assert!(ended, "the stream comes to its end");
        let balance = finals.len() as u32 + errors.len() as u32 + superseded;
        let refused_last = errors.last().is_some_and(|&e| finals.last().is_none_or(|&f| e >= f));
        // No frame reports what was skipped for a pose that then failed, with no frame after it.
        prop_assert!(balance == sent || (refused_last && balance <= sent), "{} of {} poses reported", balance, sent);
        prop_assert!(finals.is_sorted());
        for commit in commits {
            prop_assert!(finals.contains(&commit) || errors.contains(&commit), "commit {} was skipped", commit);
        }
        if seq > 0 {
            prop_assert!(finals.last() == Some(&seq) || errors.contains(&seq), "the last pose is answered");
        }
    }
}

#[test]
fn newer_targets_replace_those_that_wait_and_parts_need_memory() {
    let mailbox = mailbox(&SessionConfig::default());
    // 600 KB of the 1 MiB that there is.
    let large = |first: Option<u32>, weight: Option<f32>| {
        let targets = VertexTargets::of(std::iter::repeat_n([1.0; 3], 50_000));
        let weights = weight.map_or_else(Vec::new, |w| vec![w; 50_000]);
        vec![(
            "scan".to_owned(),
            Ok(HandlePose::targets(VertexTargets {
                first,
                ..targets.weighted(weights)
            })),
        )]
    };
    mailbox.push(posed(1, large(None, Some(0.5)), false)).expect("open");
    for seq in 2..=5 {
        mailbox.push(posed(seq, large(None, None), false)).expect("open");
    }
    assert!(mailbox.next_answer().is_pending(), "nothing is refused");
    let work = mailbox.take_work().expect("poses");
    let entries: usize = work.iter().map(|pose| pose.entries.len()).sum();
    assert_eq!((work.len(), entries), (5, 2), "the weights of the first, and the last");
    complete(&mailbox, work);

    let part = |seq: u64, first: u32| match posed(seq, large(Some(first), None), false) {
        StreamRequest::Pose {
            seq,
            commit,
            key,
            entries,
            ..
        } => StreamRequest::Pose {
            more: true,
            seq,
            commit,
            key,
            entries,
        },
        other => other,
    };
    assert!(collect_frame(&mailbox).is_some());
    mailbox.push(part(6, 0)).expect("open");
    assert!(mailbox.take_work().is_none(), "a part is not solved");
    mailbox.push(part(7, 50_000)).expect("open");
    match mailbox.next_answer() {
        Poll::Ready(Some(StreamAnswer::Failure { error, seq: 7 })) => {
            assert_eq!(error.code, ErrorCode::ResourceExhausted)
        }
        other => panic!("a refusal was expected, not {other:?}"),
    }
    mailbox.push(posed(8, vec![], false)).expect("open");
    assert_eq!(mailbox.take_work().map(|work| work.len()), Some(2));
}
