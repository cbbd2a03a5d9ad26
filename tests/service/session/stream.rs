//! The deform stream's promises.

use super::fake::*;
use crate::support::server::stays;
use pliant::session::{ErrorCode, StreamAnswer};
use pliant::wire::frames::encode;
use pliant::wire::{self, StreamRequest};
use std::sync::atomic::Ordering::SeqCst;
use std::time::Duration;

#[tokio::test]
async fn the_latest_pose_wins_and_the_skipped_ones_are_counted() {
    let (fixture, control, mut client) = Fixture::streamed().await;
    client.drag_held_up(&control).await;
    (2..=10).for_each(|seq| client.drag(seq, &[("a", seq as f64)]));
    control.release();
    let first = client.frame().await;
    assert_eq!(
        (first.header.seq, first.header.superseded, first.header.r#final),
        (1, 0, true)
    );
    let second = client.frame().await;
    assert_eq!(
        (second.header.seq, second.header.superseded, second.header.r#final),
        (10, 8, true)
    );
    assert_eq!(second.x, [10.0, 0.0, 10.0, 0.0]);
    assert!(second.header.solve_ms > 0.0 && second.header.residual <= 1.001e-4);
    client.silent().await;
    let metrics = fixture.metrics();
    assert_eq!(
        (
            metrics.poses_received.get(),
            metrics.poses_solved.get(),
            metrics.poses_superseded.get()
        ),
        (10, 2, 8)
    );
}

#[tokio::test]
async fn skipped_poses_still_move_the_handles_that_newer_ones_do_not_name() {
    let (_fixture, control, mut client) = Fixture::streamed().await;
    client.drag_held_up(&control).await;
    client.drag(2, &[("b", 2.0)]);
    client.drag(3, &[("a", 3.0)]);
    control.release();
    client.frame().await;
    let merged = client.frame().await;
    assert_eq!((merged.header.seq, merged.header.superseded), (3, 1));
    assert_eq!(merged.x, [3.0, 2.0, 3.0, 2.0]);
    client.ack(3);
    client.drag(4, &[]);
    assert_eq!(client.frame().await.x, [3.0, 2.0, 3.0, 2.0], "poses are sticky");
}

#[tokio::test]
async fn a_wrong_pose_is_reported_and_the_stream_goes_on() {
    let (_fixture, _, mut client) = Fixture::streamed().await;
    client.drag(5, &[("a", 1.0)]);
    assert_eq!(client.frame().await.header.seq, 5);
    client.drag(5, &[("a", 2.0)]);
    let (seq, error) = client.error().await;
    assert_eq!((seq, error.grpc_code()), (5, 3), "{}", error.message);
    client.drag(6, &[("nobody", 2.0)]);
    let (seq, error) = client.error().await;
    assert_eq!((seq, error.grpc_code()), (6, 3), "{}", error.message);
    client.drag(7, &[("a", f64::NAN)]);
    assert_eq!(client.error().await.0, 7);
    client.ack(5);
    client.drag(8, &[("b", 1.0)]);
    let frame = client.frame().await;
    assert_eq!(
        (frame.header.seq, frame.header.superseded, frame.x),
        (8, 0, vec![1.0; 4])
    );
}

#[tokio::test]
async fn a_wrong_pose_among_skipped_ones_takes_no_effect_and_no_part_in_the_count() {
    let (_fixture, control, mut client) = Fixture::streamed().await;
    client.drag_held_up(&control).await;
    client.drag(2, &[("b", 2.0), ("a", f64::INFINITY)]);
    client.drag(3, &[("a", 3.0)]);
    client.drag(4, &[("nobody", 4.0)]);
    control.release();
    let (mut frames, mut errors) = (Vec::new(), Vec::new());
    for _ in 0..4 {
        match client.next().await.expect("open") {
            StreamAnswer::Frame(frame) => frames.push((frame.header.seq, frame.header.superseded)),
            StreamAnswer::Failure { seq, .. } => errors.push(seq),
            other => panic!("unexpected {other:?}"),
        }
    }
    assert_eq!((frames, errors), (vec![(1, 0), (3, 0)], vec![2, 4]));
    client.ack(3);
    client.drag(5, &[]);
    assert_eq!(client.frame().await.x, [3.0, 0.0, 3.0, 0.0], "b never moved");
}

#[tokio::test]
async fn without_handles_every_pose_is_refused() {
    let (manager, _) = manager(small());
    let id = create(&manager, "points 4").await;
    let mut client = StreamClient::open(&manager, &id).await;
    client.drag(1, &[]);
    let (seq, error) = client.error().await;
    assert_eq!((seq, error.grpc_code()), (1, 9), "{}", error.message);
    manager
        .set_handles(tenant(), &id, handles(&["a"]), None)
        .await
        .expect("one handle");
    client.drag(2, &[("a", 1.0)]);
    assert_eq!(client.frame().await.header.seq, 2);
}

#[tokio::test]
async fn no_more_frames_than_the_window_are_on_their_way() {
    let (_fixture, control, mut client) = Fixture::streamed().await;
    for seq in 1..=2 {
        client.drag(seq, &[("a", seq as f64)]);
        assert_eq!(client.frame().await.header.seq, seq);
    }
    (3..=9).for_each(|seq| client.drag(seq, &[("a", seq as f64)]));
    client.silent().await;
    assert_eq!(
        control.solves.load(SeqCst),
        2,
        "no work is done for a frame that cannot be sent"
    );
    client.ack(1);
    let frame = client.frame().await;
    assert_eq!((frame.header.seq, frame.header.superseded), (9, 6));
    client.options(|options| options.window = 3);
    client.drag(10, &[]);
    assert_eq!(client.frame().await.header.seq, 10, "a wider window holds one more");
}

#[tokio::test]
async fn a_reader_that_stops_costs_no_more_than_its_window() {
    let (fixture, control, mut client) = Fixture::streamed().await;
    let before = fixture.held_bytes();
    for half in [1..=10_000, 10_001..=20_000] {
        for seq in half {
            client.drag(seq, &[("a", seq as f64), ("b", 1.0)]);
        }
        let solves = control.solves.load(SeqCst);
        until(|| control.solves.load(SeqCst) > solves).await;
    }
    client.drag(20_001, &[("a", 7.0)]);
    stays("two frames", Duration::from_millis(50), async || {
        (control.solves.load(SeqCst), fixture.held_bytes()) == (2, before)
    })
    .await;
    let (first, second) = (client.frame().await.header, client.frame().await.header);
    assert!(first.seq < second.seq);
    client.silent().await;
    client.ack(second.seq);
    let last = client.frame().await;
    assert_eq!(
        (last.header.seq, &last.x[..2]),
        (20_001, &[7.0, 1.0][..]),
        "the newest, not the next"
    );
    let skipped: u32 = [&first, &second, &last.header].iter().map(|f| f.superseded).sum();
    assert_eq!(skipped + 3, 20_001);
}

#[tokio::test]
async fn commits_are_never_skipped_and_stay_in_order() {
    let (fixture, control, mut client) = Fixture::streamed().await;
    client.options(|options| options.window = 8);
    client.drag_held_up(&control).await;
    client.drag(2, &[("b", 2.0)]);
    client.commit(3, &[("a", 3.0)]);
    client.drag(4, &[("a", 4.0)]);
    client.commit(5, &[]);
    client.drag(6, &[("a", 6.0)]);
    control.release();
    let mut frames = Vec::new();
    for _ in 0..4 {
        frames.push(client.frame().await);
    }
    let reply: Vec<_> = frames
        .iter()
        .map(|f| (f.header.seq, f.header.superseded, f.header.revision))
        .collect();
    // Revision 2 made the handles.
    assert_eq!(reply, [(1, 0, 2), (3, 1, 3), (5, 1, 4), (6, 0, 4)]);
    assert_eq!(
        (&frames[1].x[..2], &frames[2].x[..2]),
        (&[3.0, 2.0][..], &[4.0, 2.0][..])
    );
    let history = fixture.history().await;
    let kinds: Vec<&str> = history.commits.iter().map(|c| c.kind.as_str()).collect();
    assert_eq!(kinds, ["create", "handles", "pose", "pose"]);
    let solved = fixture.solve(solve(&[])).await;
    assert_eq!(
        solved.digest, history.commits[3].digest,
        "a commit does not depend on what was dragged before"
    );
}

#[tokio::test]
async fn too_many_waiting_commits_are_refused_by_number() {
    let (fixture, control) = Fixture::with(|config| config.stream_commits = 2).await;
    let mut client = fixture.client().await;
    client.options(|options| options.window = 8);
    control.hold();
    client.commit(1, &[("a", 1.0)]);
    control.held_up().await;
    (2..=4).for_each(|seq| client.commit(seq, &[("a", 1.0)]));
    let (seq, error) = client.error().await;
    assert_eq!((seq, error.grpc_code()), (4, 8), "{}", error.message);
    control.release();
    for seq in 1..=3 {
        assert_eq!(client.frame().await.header.seq, seq);
    }
}

#[tokio::test]
async fn what_was_dragged_and_not_committed_goes_with_the_stream() {
    let (fixture, _) = Fixture::fake(small()).await;
    let rest = fixture.positions().await.bytes;
    let mut client = fixture.client().await;
    client.drag(1, &[("a", 5.0)]);
    client.frame().await;
    drop(client);
    assert_eq!(fixture.positions().await.bytes, rest);
    let mut client = fixture.client().await;
    client.drag(1, &[("b", 1.0)]);
    assert_eq!(client.frame().await.x, [0.0, 1.0, 0.0, 1.0]);
}

#[tokio::test]
async fn a_commit_elsewhere_moves_a_stream_but_not_what_it_drags() {
    let (fixture, _, mut client) = Fixture::streamed().await;
    client.drag(1, &[("a", 5.0)]);
    client.frame().await;
    fixture.solve(solve(&[("b", 2.0)])).await;
    client.ack(1);
    client.drag(2, &[]);
    assert_eq!(client.frame().await.x, [5.0, 2.0, 5.0, 2.0]);
    client.ack(2);
    fixture.undo().await;
    client.drag(3, &[]);
    assert_eq!(client.frame().await.x, [0.0; 4], "undo takes the drag along");
}

#[tokio::test]
async fn progressive_frames_come_from_the_first_cycle_on() {
    let (_fixture, control, mut client) = Fixture::streamed().await;
    client.options(|options| (options.progressive, options.window) = (true, 4));
    control.hold();
    client.drag(1, &[("a", 1.0)]);
    let mut residuals = Vec::new();
    for cycle in 1..=4u32 {
        control.step(1);
        let frame = client.frame().await;
        client.ack(1);
        assert_eq!((frame.header.seq, frame.header.r#final), (1, cycle == 4));
        assert_eq!(
            frame.x[0],
            if cycle == 4 {
                1.0
            } else {
                1.0 - 0.1f64.powi(cycle as i32)
            }
        );
        residuals.push(frame.header.residual);
    }
    assert!(residuals.is_sorted_by(|a, b| a > b));
}

#[tokio::test]
async fn a_newer_pose_cuts_a_progressive_solve_short_but_not_another() {
    let (fixture, control) = Fixture::fake(small()).await;
    for progressive in [true, false] {
        let mut client = fixture.client().await;
        client.options(|options| (options.progressive, options.window) = (progressive, 8));
        control.hold();
        client.drag(1, &[("a", 1.0)]);
        control.step(1);
        control.held_up().await;
        client.drag(2, &[("a", 2.0)]);
        control.release();
        let mut frames = Vec::new();
        while frames
            .last()
            .is_none_or(|f: &SeenFrame| f.header.seq < 2 || !f.header.r#final)
        {
            frames.push(client.frame().await);
            client.ack(2);
        }
        let of_first: Vec<_> = frames.iter().filter(|f| f.header.seq == 1).collect();
        let last = of_first.last().expect("every pose taken has a frame");
        assert!(last.header.r#final);
        assert_eq!(last.x[0] == 1.0, !progressive, "{:?}", last.x);
        assert_eq!(of_first.len(), if progressive { 2 } else { 1 });
    }
}

#[tokio::test]
async fn a_budget_takes_the_best_there_is() {
    let (_fixture, control, mut client) = Fixture::streamed().await;
    client.options(|options| options.budget_ms = Some(1.0));
    client.drag_held_up(&control).await;
    tokio::time::sleep(Duration::from_millis(5)).await;
    control.step(1);
    let frame = client.frame().await;
    assert_eq!((frame.header.r#final, frame.x[0]), (true, 0.9));
    assert!(frame.header.residual > 0.05 && frame.header.solve_ms >= 1.0);
}

#[tokio::test]
async fn pings_are_answered_while_solving() {
    let (_fixture, control, mut client) = Fixture::streamed().await;
    client.drag_held_up(&control).await;
    client.silent().await;
    control.release();
    assert_eq!(client.frame().await.header.seq, 1);
}

#[tokio::test]
async fn a_client_that_has_said_everything_gets_its_last_frame_unasked() {
    let (_fixture, control, mut client) = Fixture::streamed().await;
    client.drag_held_up(&control).await;
    for seq in 2..=9 {
        if seq % 3 == 0 {
            client.commit(seq, &[("a", seq as f64)])
        } else {
            client.drag(seq, &[("a", 0.5)])
        }
    }
    client.drag(10, &[("b", 10.0)]);
    client.input.finish();
    control.release();
    let mut reply = Vec::new();
    while let Some(message) = client.next().await {
        let StreamAnswer::Frame(frame) = message else {
            panic!("only frames were expected, not {message:?}")
        };
        let header = frame.header;
        reply.push((header.seq, header.superseded, header.r#final));
    }
    assert_eq!(
        reply,
        [(1, 0, true), (3, 1, true), (6, 2, true), (9, 2, true), (10, 0, true)]
    );
}

#[tokio::test]
async fn dropping_a_stream_stops_its_solve_and_changes_nothing() {
    let (fixture, control, mut client) = Fixture::streamed().await;
    client.drag(1, &[("b", 1.0)]);
    client.frame().await;
    control.hold();
    client.commit(2, &[("a", 1.0)]);
    control.held_up().await;
    assert_eq!(fixture.metrics().pool_busy.get(), 1);
    let cycles = control.cycles.load(SeqCst);
    drop(client);
    until(|| fixture.metrics().pool_busy.get() == 0).await;
    assert!(
        control.cycles.load(SeqCst) <= cycles + 1,
        "it stopped at the next cycle"
    );
    control.release();
    let session = fixture.facts().await;
    assert_eq!((session.revision, fixture.metrics().streams.get()), (2, 0));
    let solved = fixture.solve_a(1.0).await;
    assert_eq!(solved.frame.positions[1].x, 1.0, "b is at rest");
}

#[tokio::test]
async fn streams_take_turns() {
    let (fixture, control) = Fixture::fake(small()).await;
    let mut greedy = fixture.client().await;
    let mut modest = fixture.client().await;
    control.hold();
    greedy.drag(1, &[("a", 1.0)]);
    control.held_up().await;
    modest.drag(1, &[("b", 1.0)]);
    (2..100).for_each(|seq| greedy.drag(seq, &[("a", 1.0)]));
    // One solve of four cycles for each of them.
    control.step(8);
    assert_eq!(
        modest.frame().await.x,
        [0.0, 1.0, 0.0, 1.0],
        "each stream has its own drag"
    );
    control.release();
    assert_eq!(greedy.frame().await.header.seq, 1);
    assert_eq!(greedy.frame().await.header.seq, 99);
}

#[tokio::test]
async fn wrong_options_end_the_stream() {
    let (_fixture, _, mut client) = Fixture::streamed().await;
    let wrong = wire::Error::invalid("options.tolerance", "is -1");
    client.push(StreamRequest::Options(Err(wrong)));
    let (seq, error) = client.error().await;
    assert_eq!((seq, error.grpc_code()), (0, 3), "{}", error.message);
    assert!(client.next().await.is_none());
    let refused = client.input.push(StreamRequest::Ping(0));
    assert_eq!(refused.map_err(|e| e.code), Err(ErrorCode::Cancelled));
}

#[tokio::test]
async fn changes_only_are_sent_once_a_frame_is_acknowledged() {
    let (_fixture, _, mut client) = Fixture::streamed().await;
    client.options(|options| options.output.changed_only = Some(0.01));
    client.drag(1, &[("a", 1.0)]);
    assert_eq!(client.frame().await.selected, Some(vec![0, 1, 2, 3]));
    client.ack(1);
    client.drag(2, &[("b", 1.0)]);
    assert_eq!(client.frame().await.selected, Some(vec![1, 3]));
    client.ack(2);
    client.drag(3, &[("b", 1.001)]);
    let still = client.frame().await;
    assert_eq!((still.selected, still.header.r#final), (Some(Vec::new()), true));
}

#[tokio::test]
async fn large_frames_come_in_parts_made_one_by_one() {
    let (manager, _) = manager(limits(|config| config.part_bytes = 1200));
    let id = create(&manager, "points 1000").await;
    manager
        .set_handles(tenant(), &id, handles(&["a"]), None)
        .await
        .expect("one handle");
    let mut client = StreamClient::open(&manager, &id).await;
    client.drag(1, &[("a", 1.0)]);
    let Some(StreamAnswer::Frame(frame)) = client.next().await else {
        panic!("a frame was expected")
    };
    for (k, part) in encode(*frame).enumerate() {
        assert_eq!(
            (part.seq, part.part as usize, part.parts, part.first_vertex as usize),
            (1, k, 10, k * 100)
        );
        assert_eq!((part.vertex_count, part.data.len(), part.r#final), (100, 1200, true));
    }
    assert_eq!(manager.metrics().frames_sent.get(), 1);
}

#[tokio::test]
async fn there_are_only_so_many_streams() {
    let (fixture, _) = Fixture::with(|config| config.streams = 2).await;
    let _first = fixture.manager.stream(tenant(), &fixture.id).await.expect("one");
    let second = fixture.manager.stream(tenant(), &fixture.id).await.expect("two");
    let error = fixture.manager.stream(tenant(), &fixture.id).await.expect_err("three");
    assert_eq!((error.http_status(), error.retry_after_s), (429, Some(1)));
    drop(second);
    fixture.manager.stream(tenant(), &fixture.id).await.expect("two again");
}
