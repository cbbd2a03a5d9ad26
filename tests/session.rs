//! What clients of a session can rely on, whatever the transport: the deform stream's promises, commits that can be undone
//! to the bit, limits, expiry, idempotency, draining. Most tests drive an engine whose cycles they control.

#[path = "session/fake.rs"]
mod fake;

use fake::*;
use pliant::asset::{FileSet, Format};
use pliant::job::frames::digest;
use pliant::job::pb;
use pliant::session::{Code, Config, Error, Manager, Tenant};
use proptest::prelude::*;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::time::Duration;

type Tell = pb::deform_response::Message;

mod stream {
    use super::*;

    #[tokio::test]
    async fn the_latest_pose_wins_and_the_skipped_ones_are_counted() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        control.hold();
        client.drag(1, &[("a", 1.0)]);
        control.held_up().await;
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
        let metrics = manager.metrics();
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
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        control.hold();
        client.drag(1, &[("a", 1.0)]);
        control.held_up().await;
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
    async fn a_wrong_pose_is_told_and_the_stream_goes_on() {
        let (manager, _) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        client.drag(5, &[("a", 1.0)]);
        assert_eq!(client.frame().await.header.seq, 5);
        client.drag(5, &[("a", 2.0)]);
        let error = client.error().await;
        assert_eq!((error.seq, error.code), (5, 3), "{}", error.message);
        client.drag(6, &[("nobody", 2.0)]);
        let error = client.error().await;
        assert_eq!((error.seq, error.code), (6, 3), "{}", error.message);
        client.drag(7, &[("a", f64::NAN)]);
        assert_eq!(client.error().await.seq, 7);
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
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        control.hold();
        client.drag(1, &[("a", 1.0)]);
        control.held_up().await;
        client.drag(2, &[("b", 2.0), ("a", f64::INFINITY)]);
        client.drag(3, &[("a", 3.0)]);
        client.drag(4, &[("nobody", 4.0)]);
        control.release();
        let (mut frames, mut errors) = (Vec::new(), Vec::new());
        for _ in 0..4 {
            match client.next().await.expect("open") {
                Tell::Frame(frame) => frames.push((frame.seq, frame.superseded)),
                Tell::Error(error) => errors.push(error.seq),
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
        let mut client = Client::open(&manager, &id).await;
        client.drag(1, &[]);
        let error = client.error().await;
        assert_eq!((error.seq, error.code), (1, 9), "{}", error.message);
        manager
            .set_handles(&tenant(), handles(&id, &["a"]), None)
            .await
            .expect("one handle");
        client.drag(2, &[("a", 1.0)]);
        assert_eq!(client.frame().await.header.seq, 2);
    }

    #[tokio::test]
    async fn no_more_frames_than_the_window_are_on_their_way() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
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
        client.options(pb::Options {
            window: 3,
            ..Default::default()
        });
        client.drag(10, &[]);
        assert_eq!(client.frame().await.header.seq, 10, "a wider window holds one more");
    }

    #[tokio::test]
    async fn a_reader_that_stops_costs_no_more_than_its_window() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        let before = manager.metrics().bytes.get();
        for seq in 1..=20_000 {
            client.drag(seq, &[("a", seq as f64), ("b", 1.0)]);
        }
        until(|| control.solves.load(SeqCst) >= 2).await;
        client.drag(20_001, &[("a", 7.0)]);
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert_eq!(
            (control.solves.load(SeqCst), manager.metrics().bytes.get()),
            (2, before)
        );
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
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        client.options(pb::Options {
            window: 8,
            ..Default::default()
        });
        control.hold();
        client.drag(1, &[("a", 1.0)]);
        control.held_up().await;
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
        let told: Vec<_> = frames
            .iter()
            .map(|f| (f.header.seq, f.header.superseded, f.header.revision))
            .collect();
        // Revision 2 made the handles.
        assert_eq!(told, [(1, 0, 2), (3, 1, 3), (5, 1, 4), (6, 0, 4)]);
        assert_eq!(
            (&frames[1].x[..2], &frames[2].x[..2]),
            (&[3.0, 2.0][..], &[4.0, 2.0][..])
        );
        let history = manager.history(&tenant(), &id).await.expect("open");
        let kinds: Vec<&str> = history.commits.iter().map(|c| c.kind.as_str()).collect();
        assert_eq!(kinds, ["create", "handles", "pose", "pose"]);
        let solved = manager
            .solve(&tenant(), solve(&id, &[]), None)
            .await
            .expect("the committed poses");
        assert_eq!(
            solved.digest, history.commits[3].digest,
            "a commit does not depend on what was dragged before"
        );
    }

    #[tokio::test]
    async fn too_many_waiting_commits_are_refused_by_number() {
        let (manager, control) = manager(Config {
            stream_commits: 2,
            ..small()
        });
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        client.options(pb::Options {
            window: 8,
            ..Default::default()
        });
        control.hold();
        client.commit(1, &[("a", 1.0)]);
        control.held_up().await;
        (2..=4).for_each(|seq| client.commit(seq, &[("a", 1.0)]));
        let error = client.error().await;
        assert_eq!((error.seq, error.code), (4, 8), "{}", error.message);
        control.release();
        for seq in 1..=3 {
            assert_eq!(client.frame().await.header.seq, seq);
        }
    }

    #[tokio::test]
    async fn what_was_dragged_and_not_committed_goes_with_the_stream() {
        let (manager, _) = manager(small());
        let id = open(&manager).await;
        let rest = manager.positions(&tenant(), &id).await.expect("open").bytes;
        let mut client = Client::open(&manager, &id).await;
        client.drag(1, &[("a", 5.0)]);
        client.frame().await;
        drop(client);
        assert_eq!(manager.positions(&tenant(), &id).await.expect("open").bytes, rest);
        let mut client = Client::open(&manager, &id).await;
        client.drag(1, &[("b", 1.0)]);
        assert_eq!(client.frame().await.x, [0.0, 1.0, 0.0, 1.0]);
    }

    #[tokio::test]
    async fn a_commit_elsewhere_moves_a_stream_but_not_what_it_drags() {
        let (manager, _) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        client.drag(1, &[("a", 5.0)]);
        client.frame().await;
        manager
            .solve(&tenant(), solve(&id, &[("b", 2.0)]), None)
            .await
            .expect("solved");
        client.ack(1);
        client.drag(2, &[]);
        assert_eq!(client.frame().await.x, [5.0, 2.0, 5.0, 2.0]);
        client.ack(2);
        manager.undo(&tenant(), &id, None).await.expect("undone");
        client.drag(3, &[]);
        assert_eq!(client.frame().await.x, [0.0; 4], "undo takes the drag along");
    }

    #[tokio::test]
    async fn progressive_frames_come_from_the_first_cycle_on() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        client.options(pb::Options {
            progressive: true,
            window: 4,
            ..Default::default()
        });
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
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        for progressive in [true, false] {
            let mut client = Client::open(&manager, &id).await;
            client.options(pb::Options {
                progressive,
                window: 8,
                ..Default::default()
            });
            control.hold();
            client.drag(1, &[("a", 1.0)]);
            control.step(1);
            control.held_up().await;
            client.drag(2, &[("a", 2.0)]);
            control.release();
            let mut frames = Vec::new();
            while frames
                .last()
                .is_none_or(|f: &Seen| f.header.seq < 2 || !f.header.r#final)
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
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        client.options(pb::Options {
            budget_ms: 1.0,
            ..Default::default()
        });
        control.hold();
        client.drag(1, &[("a", 1.0)]);
        control.held_up().await;
        tokio::time::sleep(Duration::from_millis(5)).await;
        control.step(1);
        let frame = client.frame().await;
        assert_eq!((frame.header.r#final, frame.x[0]), (true, 0.9));
        assert!(frame.header.residual > 0.05 && frame.header.solve_ms >= 1.0);
    }

    #[tokio::test]
    async fn pings_are_answered_while_solving() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        control.hold();
        client.drag(1, &[("a", 1.0)]);
        control.held_up().await;
        client.silent().await;
        control.release();
        assert_eq!(client.frame().await.header.seq, 1);
    }

    #[tokio::test]
    async fn a_client_that_has_said_everything_gets_its_last_frame_unasked() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        control.hold();
        client.drag(1, &[("a", 1.0)]);
        control.held_up().await;
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
        let mut told = Vec::new();
        while let Some(message) = client.next().await {
            let Tell::Frame(frame) = message else {
                panic!("only frames were expected, not {message:?}")
            };
            told.push((frame.seq, frame.superseded, frame.r#final));
        }
        assert_eq!(
            told,
            [(1, 0, true), (3, 1, true), (6, 2, true), (9, 2, true), (10, 0, true)]
        );
    }

    #[tokio::test]
    async fn dropping_a_stream_stops_its_solve_and_changes_nothing() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        client.drag(1, &[("b", 1.0)]);
        client.frame().await;
        control.hold();
        client.commit(2, &[("a", 1.0)]);
        control.held_up().await;
        assert_eq!(manager.metrics().pool_busy.get(), 1);
        let cycles = control.cycles.load(SeqCst);
        drop(client);
        until(|| manager.metrics().pool_busy.get() == 0).await;
        assert!(
            control.cycles.load(SeqCst) <= cycles + 1,
            "it stopped at the next cycle"
        );
        control.release();
        let session = manager.get(&tenant(), &id).await.expect("open");
        assert_eq!((session.revision, manager.metrics().streams.get()), (2, 0));
        let solved = manager
            .solve(&tenant(), solve(&id, &[("a", 1.0)]), None)
            .await
            .expect("the session works");
        assert_eq!(solved.positions[1].x, 1.0, "b is at rest");
    }

    #[tokio::test]
    async fn streams_take_turns() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut greedy = Client::open(&manager, &id).await;
        let mut modest = Client::open(&manager, &id).await;
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
        let (manager, _) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        client.options(pb::Options {
            tolerance: -1.0,
            ..Default::default()
        });
        let error = client.error().await;
        assert_eq!((error.seq, error.code), (0, 3), "{}", error.message);
        assert!(client.next().await.is_none());
        let refused = client
            .input
            .push(ask(pb::deform_request::Message::Ping(pb::Ping::default())));
        assert_eq!(refused.map_err(|e| e.code), Err(Code::Cancelled));
    }

    #[tokio::test]
    async fn changes_only_are_sent_once_a_frame_is_acknowledged() {
        let (manager, _) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        let output = Some(pb::Output {
            changed_only: Some(0.01),
            ..Default::default()
        });
        client.options(pb::Options {
            output,
            ..Default::default()
        });
        client.drag(1, &[("a", 1.0)]);
        assert_eq!(client.frame().await.header.indices, [0, 1, 2, 3]);
        client.ack(1);
        client.drag(2, &[("b", 1.0)]);
        assert_eq!(client.frame().await.header.indices, [1, 3]);
        client.ack(2);
        client.drag(3, &[("b", 1.001)]);
        let still = client.frame().await.header;
        assert_eq!((still.vertex_count, still.parts, still.r#final), (0, 1, true));
    }

    #[tokio::test]
    async fn large_frames_come_in_parts_made_one_by_one() {
        let (manager, _) = manager(Config {
            part_bytes: 1200,
            ..small()
        });
        let id = create(&manager, "points 1000").await;
        manager
            .set_handles(&tenant(), handles(&id, &["a"]), None)
            .await
            .expect("one handle");
        let mut client = Client::open(&manager, &id).await;
        client.drag(1, &[("a", 1.0)]);
        for k in 0..10 {
            let Some(Tell::Frame(part)) = client.next().await else {
                panic!("a part was expected")
            };
            assert_eq!(
                (part.seq, part.part, part.parts, part.first_vertex),
                (1, k, 10, k * 100)
            );
            assert_eq!((part.vertex_count, part.data.len(), part.r#final), (100, 1200, true));
        }
        assert_eq!(manager.metrics().frames_sent.get(), 1);
    }

    #[tokio::test]
    async fn there_are_only_so_many_streams() {
        let (manager, _) = manager(Config { streams: 2, ..small() });
        let id = open(&manager).await;
        let _first = manager.stream(&tenant(), &id).await.expect("one");
        let second = manager.stream(&tenant(), &id).await.expect("two");
        let error = manager.stream(&tenant(), &id).await.expect_err("three");
        assert_eq!((error.http_status(), error.retry_after_s), (429, Some(1)));
        drop(second);
        manager.stream(&tenant(), &id).await.expect("two again");
    }
}

mod commits {
    use super::*;

    #[tokio::test]
    async fn undo_and_redo_restore_positions_to_the_bit() {
        // With no bytes for snapshots, every step back is a replay.
        for snapshot_bytes in [1 << 20, 0] {
            let (manager, _) = manager(Config {
                snapshot_bytes,
                ..small()
            });
            let id = open(&manager).await;
            let mut shapes = vec![manager.positions(&tenant(), &id).await.expect("open").bytes];
            for (k, x) in [0.1, -0.7, 3.3].into_iter().enumerate() {
                let solved = manager
                    .solve(&tenant(), solve(&id, &[(["a", "b"][k % 2], x)]), None)
                    .await
                    .expect("solved");
                assert_eq!(solved.revision, 3 + k as u64);
                assert_eq!(digest(&solved.positions), solved.digest);
                let mut client = Client::open(&manager, &id).await;
                client.drag(1, &[("a", 9.0)]);
                client.frame().await;
                shapes.push(manager.positions(&tenant(), &id).await.expect("open").bytes);
            }
            manager
                .set_handles(&tenant(), handles(&id, &["b", "c", "d"]), None)
                .await
                .expect("other handles");
            let told = manager.history(&tenant(), &id).await.expect("open");
            let session = manager.undo(&tenant(), &id, None).await.expect("undone");
            assert_eq!(
                session.handles.iter().map(|h| h.id.as_str()).collect::<Vec<_>>(),
                ["a", "b"]
            );
            let mut revision = session.revision;
            for back in (0..3).rev() {
                let session = manager.undo(&tenant(), &id, None).await.expect("undone");
                assert!(session.revision > revision);
                revision = session.revision;
                assert_eq!(
                    manager.positions(&tenant(), &id).await.expect("open").bytes,
                    shapes[back]
                );
            }
            for shape in &shapes[1..] {
                manager.redo(&tenant(), &id, None).await.expect("redone");
                assert_eq!(manager.positions(&tenant(), &id).await.expect("open").bytes, *shape);
            }
            manager.redo(&tenant(), &id, None).await.expect("redone");
            let error = manager.redo(&tenant(), &id, None).await.expect_err("nothing is left");
            assert_eq!((error.http_status(), error.code_name()), (409, "FAILED_PRECONDITION"));
            assert_eq!(manager.history(&tenant(), &id).await.expect("open"), told);
            let after = manager
                .solve(&tenant(), solve(&id, &[("c", 1.0)]), None)
                .await
                .expect("the handles are back");
            assert_eq!(after.positions[1].x, 2.0);
        }
    }

    #[tokio::test]
    async fn nothing_to_undo_is_a_precondition() {
        let (manager, _) = manager(small());
        let id = create(&manager, "points 4").await;
        let error = manager.undo(&tenant(), &id, None).await.expect_err("only the creation");
        assert_eq!((error.http_status(), error.code_name()), (409, "FAILED_PRECONDITION"));
        let error = manager
            .solve(&tenant(), solve(&id, &[]), None)
            .await
            .expect_err("no handles");
        assert_eq!((error.http_status(), error.code_name()), (409, "FAILED_PRECONDITION"));
    }

    #[tokio::test]
    async fn handles_leave_the_shape_alone_and_start_at_their_poses() {
        let (manager, _) = manager(small());
        let id = open(&manager).await;
        manager
            .solve(&tenant(), solve(&id, &[("a", 4.0)]), None)
            .await
            .expect("solved");
        let before = manager.positions(&tenant(), &id).await.expect("open");
        let mut request = handles(&id, &["a", "b"]);
        request.handles[1].pose = pose(1, &[("b", 6.0)], false).handles[0].pose.clone();
        let session = manager.set_handles(&tenant(), request, None).await.expect("replaced");
        assert_eq!((session.revision, session.build_ms.contains_key("fields")), (4, true));
        let after = manager.positions(&tenant(), &id).await.expect("open");
        assert_eq!(after.bytes, before.bytes);
        assert_ne!(after.etag, before.etag);
        let solved = manager.solve(&tenant(), solve(&id, &[]), None).await.expect("solved");
        assert_eq!(
            (solved.positions[0].x, solved.positions[1].x),
            (0.0, 7.0),
            "a is at rest again"
        );

        let rigid = pb::Handle {
            id: "a".into(),
            rigid: true,
            ..Default::default()
        };
        manager
            .put_handle(&tenant(), &id, rigid, &["rigid".into()], None)
            .await
            .expect("patched");
        let solved = manager.solve(&tenant(), solve(&id, &[]), None).await.expect("solved");
        assert_eq!(solved.positions[1].x, 7.0, "a patch moves nothing");
        manager.remove_handle(&tenant(), &id, "a", None).await.expect("removed");
        let solved = manager.solve(&tenant(), solve(&id, &[]), None).await.expect("solved");
        assert_eq!(
            (solved.positions[0].x, solved.positions[1].x),
            (6.0, 7.0),
            "b holds everything now"
        );
        let error = manager
            .remove_handle(&tenant(), &id, "a", None)
            .await
            .expect_err("gone");
        assert_eq!(error.http_status(), 404);
    }

    #[tokio::test]
    async fn a_call_that_fails_changes_nothing() {
        let (manager, _) = manager(small());
        let id = open(&manager).await;
        manager
            .solve(&tenant(), solve(&id, &[("a", 4.0)]), None)
            .await
            .expect("solved");
        let before = (
            manager.get(&tenant(), &id).await.expect("open"),
            manager.history(&tenant(), &id).await,
        );
        let error = manager
            .set_handles(&tenant(), handles(&id, &["x", ""]), None)
            .await
            .expect_err("an empty id");
        assert_eq!(
            (error.http_status(), error.field.as_deref()),
            (422, Some("handles[1].id"))
        );
        let error = manager
            .solve(&tenant(), solve(&id, &[("x", 1.0)]), None)
            .await
            .expect_err("unknown");
        assert_eq!(
            (error.http_status(), error.field.as_deref()),
            (422, Some("pose.handles[0].id"))
        );
        let mut request = solve(&id, &[]);
        request.options = Some(pb::Options {
            tolerance: 7.0,
            ..Default::default()
        });
        let error = manager
            .solve(&tenant(), request, None)
            .await
            .expect_err("a strange tolerance");
        assert_eq!(
            (error.http_status(), error.field.as_deref()),
            (422, Some("options.tolerance"))
        );
        let error = manager
            .export(&tenant(), &id, Some(Format::Stl))
            .await
            .expect_err("cannot be written");
        assert_eq!(error.http_status(), 422);
        let mut after = (
            manager.get(&tenant(), &id).await.expect("open"),
            manager.history(&tenant(), &id).await,
        );
        after.0.expires_at.clone_from(&before.0.expires_at);
        assert_eq!(after, before);
        let solved = manager.solve(&tenant(), solve(&id, &[]), None).await.expect("solved");
        assert_eq!(solved.positions[0].x, 4.0);
    }

    #[tokio::test]
    async fn a_caller_that_goes_leaves_the_old_state() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        control.hold();
        let solving = tokio::time::timeout(
            Duration::from_millis(20),
            manager.solve(&tenant(), solve(&id, &[("a", 1.0)]), None),
        );
        assert!(solving.await.is_err(), "it is held up");
        until(|| manager.metrics().pool_busy.get() == 0).await;
        let more = handles(&id, &["a", "b", "c"]);
        let setting = tokio::time::timeout(Duration::from_millis(20), manager.set_handles(&tenant(), more, None));
        assert!(setting.await.is_err(), "it is held up");
        until(|| manager.metrics().pool_busy.get() == 0).await;
        control.release();
        let session = manager.get(&tenant(), &id).await.expect("open");
        assert_eq!((session.revision, session.handles.len()), (2, 2));
        let solved = manager
            .solve(&tenant(), solve(&id, &[("b", 1.0)]), None)
            .await
            .expect("the session works");
        assert_eq!((solved.positions[0].x, solved.revision), (0.0, 3));
    }

    #[tokio::test]
    async fn a_solve_that_takes_too_long_is_given_up() {
        let (manager, control) = manager(Config {
            solve: Duration::from_millis(10),
            ..small()
        });
        let id = open(&manager).await;
        control.hold();
        let error = manager
            .solve(&tenant(), solve(&id, &[("a", 1.0)]), None)
            .await
            .expect_err("held up");
        assert_eq!((error.http_status(), error.code_name()), (504, "DEADLINE_EXCEEDED"));
        let mut client = Client::open(&manager, &id).await;
        client.commit(1, &[("a", 1.0)]);
        assert_eq!(client.error().await.code, 4);
        assert_eq!(manager.get(&tenant(), &id).await.expect("open").revision, 2);
    }

    #[tokio::test]
    async fn exports_and_positions_are_of_the_committed_shape() {
        let (manager, _) = manager(small());
        let id = open(&manager).await;
        manager
            .solve(&tenant(), solve(&id, &[("a", 2.0)]), None)
            .await
            .expect("solved");
        let positions = manager.positions(&tenant(), &id).await.expect("open");
        assert_eq!(positions.bytes.len(), 4 * 12);
        assert_eq!(
            f32::from_le_bytes(positions.bytes[..4].try_into().expect("four bytes")),
            2.0
        );
        let own = manager.export(&tenant(), &id, None).await.expect("written");
        assert!(own.format == Format::Obj && own.written.main.starts_with(b"obj [DVec3(2.0"));
        let other = manager
            .export(&tenant(), &id, Some(Format::Ply))
            .await
            .expect("written");
        assert!(own.etag != other.etag && own.etag.starts_with('"') && own.etag.ends_with('"'));
        assert_eq!(
            manager
                .export_etag(&tenant(), &id, Some(Format::Ply))
                .await
                .expect("open"),
            other.etag
        );
        manager
            .solve(&tenant(), solve(&id, &[("a", 3.0)]), None)
            .await
            .expect("solved");
        assert_ne!(
            manager
                .export_etag(&tenant(), &id, Some(Format::Ply))
                .await
                .expect("open"),
            other.etag
        );
    }

    #[derive(Debug, Clone)]
    enum Command {
        Solve(usize, i8),
        Drag(usize, i8),
        Handles(usize),
        Undo,
        Redo,
        GiveUp,
    }

    fn command() -> impl Strategy<Value = Command> {
        prop_oneof![
            (0usize..2, -9i8..9).prop_map(|(h, x)| Command::Solve(h, x)),
            (0usize..2, -9i8..9).prop_map(|(h, x)| Command::Drag(h, x)),
            (1usize..3).prop_map(Command::Handles),
            Just(Command::Undo),
            Just(Command::Redo),
            Just(Command::GiveUp),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// Whatever a client does, the revision grows with every change and only then, the digest is that of the positions, and a
        /// commit reached again by undo or redo has the bits that it had.
        #[test]
        fn any_order_of_calls_keeps_the_books(commands in prop::collection::vec(command(), 1..25), keep in any::<bool>()) {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(async move {
                let snapshot_bytes = if keep { 1 << 20 } else { 0 };
                let (manager, control) = manager(Config { snapshot_bytes, history: 5, ..small() });
                let id = open(&manager).await;
                let mut client = Client::open(&manager, &id).await;
                let mut seq = 0;
                let mut last = manager.get(&tenant(), &id).await.expect("open").revision;
                let mut shapes = std::collections::BTreeMap::new();
                for command in commands {
                    let changed = match command {
                        Command::Solve(h, x) => {
                            let name = ["a", "b"][h];
                            manager.solve(&tenant(), solve(&id, &[(name, x.into())]), None).await.is_ok()
                        }
                        Command::Handles(n) => {
                            manager.set_handles(&tenant(), handles(&id, &["a", "b"][..n]), None).await.expect("set");
                            true
                        }
                        Command::Undo => manager.undo(&tenant(), &id, None).await.is_ok(),
                        Command::Redo => manager.redo(&tenant(), &id, None).await.is_ok(),
                        Command::Drag(h, x) => {
                            seq += 1;
                            client.drag(seq, &[(["a", "b"][h], x.into())]);
                            // A frame, or an error where there is no handle b.
                            client.next().await.expect("open");
                            client.ack(seq);
                            false
                        }
                        Command::GiveUp => {
                            control.hold();
                            let request = solve(&id, &[("a", 100.0)]);
                            let limit = Duration::from_millis(2);
                            let _ = tokio::time::timeout(limit, manager.solve(&tenant(), request, None)).await;
                            until(|| manager.metrics().pool_busy.get() == 0).await;
                            control.release();
                            false
                        }
                    };
                    let session = manager.get(&tenant(), &id).await.expect("open");
                    let history = manager.history(&tenant(), &id).await.expect("open");
                    assert_eq!(session.revision, last + u64::from(changed), "{command:?}");
                    last = session.revision;
                    assert!(history.commits.len() <= 6 && history.commits.is_sorted_by_key(|c| c.revision));
                    let current = history.commits.iter().find(|c| c.revision == history.current).expect("listed");
                    let bytes = manager.positions(&tenant(), &id).await.expect("open").bytes;
                    let known = shapes.entry(current.revision).or_insert_with(|| (current.digest.clone(), bytes.clone()));
                    assert_eq!(*known, (current.digest.clone(), bytes), "{command:?}");
                }
            });
        }
    }
}

mod limits {
    use super::*;

    async fn refused(manager: &Manager, text: &str, options: pb::CreateOptions) -> Error {
        manager
            .create(&tenant(), model(text), options, None)
            .await
            .expect_err("refused")
    }

    #[tokio::test]
    async fn creation_checks_sizes_and_words() {
        let (manager, _) = manager(Config {
            upload_bytes: 20,
            memory_bytes: 4 << 20,
            ..small()
        });
        let options = pb::CreateOptions::default;
        let told = |e: Error| (e.http_status(), e.field.unwrap_or_default());
        let large = refused(&manager, "points 4 and then some", options()).await;
        assert_eq!((told(large.clone()).0, large.code_name()), (413, "RESOURCE_EXHAUSTED"));
        assert_eq!(told(refused(&manager, "nonsense", options()).await).0, 400);
        let label = pb::CreateOptions {
            label: "x".repeat(257),
            ..options()
        };
        assert_eq!(told(refused(&manager, "points 4", label).await), (422, "label".into()));
        let ttl = pb::CreateOptions {
            ttl: "1ms".into(),
            ..options()
        };
        assert_eq!(told(refused(&manager, "points 4", ttl).await), (422, "ttl".into()));
        let never = refused(&manager, "large 9999999", options()).await;
        assert_eq!((never.http_status(), never.retry_after_s), (413, None));
        assert_eq!(refused(&manager, "panic", options()).await.http_status(), 500);
        assert_eq!(
            (manager.metrics().sessions.get(), manager.metrics().bytes.get()),
            (0, 0)
        );
        let id = create(&manager, "points 4").await;
        assert!(id.len() == 32 && id.bytes().all(|b| b.is_ascii_hexdigit()));
    }

    #[tokio::test]
    async fn memory_that_is_taken_is_asked_for_again_later() {
        let (manager, _) = manager(Config {
            memory_bytes: 4 << 20,
            high_water: 0.5,
            ..small()
        });
        assert!(manager.admits());
        let id = create(&manager, "points 30000").await;
        assert!(manager.metrics().bytes.get() >= 3_000_000 && !manager.admits());
        let later = refused(&manager, "large 3000000", pb::CreateOptions::default()).await;
        assert_eq!(
            (later.http_status(), later.retry_after_s.is_some()),
            (429, true),
            "{later}"
        );
        let wrong = refused(&manager, "points 30000", pb::CreateOptions::default()).await;
        assert_eq!(
            wrong.http_status(),
            429,
            "an estimate that was too low is caught when the truth is known"
        );
        manager.delete(&tenant(), &id).await.expect("deleted");
        assert_eq!((manager.metrics().bytes.get(), manager.admits()), (0, true));
        create(&manager, "points 30000").await;
    }

    #[tokio::test]
    async fn there_are_only_so_many_sessions() {
        let (manager, _) = manager(Config { sessions: 2, ..small() });
        let first = create(&manager, "points 4").await;
        create(&manager, "points 4").await;
        let error = refused(&manager, "points 4", pb::CreateOptions::default()).await;
        assert_eq!((error.http_status(), error.retry_after_s.is_some()), (429, true));
        manager.delete(&tenant(), &first).await.expect("deleted");
        create(&manager, "points 4").await;
        assert_eq!(
            manager.delete(&tenant(), &first).await.expect_err("gone").http_status(),
            404
        );
    }

    #[tokio::test]
    async fn a_session_that_is_busy_takes_only_so_many_calls() {
        let (manager, control) = manager(Config {
            session_queue: 1,
            ..small()
        });
        let id = open(&manager).await;
        control.hold();
        let call = || {
            let (manager, id) = (manager.clone(), id.clone());
            tokio::spawn(async move { manager.solve(&tenant(), solve(&id, &[]), None).await })
        };
        let first = call();
        control.held_up().await;
        let second = call();
        let third = call();
        let (mut done, mut refused) = (0, 0);
        until(|| second.is_finished() || third.is_finished()).await;
        control.release();
        for call in [first, second, third] {
            match call.await.expect("no panic") {
                Ok(_) => done += 1,
                Err(error) => {
                    assert_eq!((error.http_status(), error.retry_after_s), (429, Some(1)));
                    refused += 1;
                }
            }
        }
        assert_eq!((done, refused), (2, 1));
    }

    #[tokio::test]
    async fn a_build_that_nobody_waits_for_stops() {
        let (manager, control) = manager(small());
        control.hold();
        let options = pb::CreateOptions::default();
        let create = tokio::time::timeout(
            Duration::from_millis(20),
            manager.create(&tenant(), model("slow 4"), options, None),
        );
        assert!(create.await.is_err());
        until(|| manager.metrics().pool_busy.get() == 0 && manager.metrics().bytes.get() == 0).await;
        assert_eq!(manager.metrics().sessions.get(), 0);
    }

    #[tokio::test]
    async fn a_panic_costs_its_own_session_only() {
        let (manager, _) = manager(small());
        let other = open(&manager).await;
        let id = create(&manager, "points 4").await;
        manager
            .set_handles(&tenant(), handles(&id, &["panic"]), None)
            .await
            .expect("set");
        let mut client = Client::open(&manager, &id).await;
        let error = manager
            .solve(&tenant(), solve(&id, &[("panic", 1.0)]), None)
            .await
            .expect_err("it panics");
        assert_eq!((error.http_status(), error.code_name()), (500, "INTERNAL"));
        let told = client.error().await;
        assert_eq!((told.seq, told.code), (0, 13));
        assert!(client.next().await.is_none());
        until(|| manager.metrics().sessions.get() == 1).await;
        assert_eq!(manager.get(&tenant(), &id).await.expect_err("gone").http_status(), 404);
        manager
            .solve(&tenant(), solve(&other, &[("a", 1.0)]), None)
            .await
            .expect("the other session works");
    }

    #[tokio::test]
    async fn a_tenant_sees_its_own_sessions_only() {
        let (manager, _) = manager(small());
        let id = open(&manager).await;
        let stranger = Tenant(Arc::from("stranger"));
        assert_eq!(
            manager.get(&stranger, &id).await.expect_err("not theirs").http_status(),
            404
        );
        assert_eq!(
            manager
                .delete(&stranger, &id)
                .await
                .expect_err("not theirs")
                .http_status(),
            404
        );
        assert_eq!(
            manager
                .stream(&stranger, &id)
                .await
                .expect_err("not theirs")
                .http_status(),
            404
        );
        assert_eq!(
            manager
                .solve(&stranger, solve(&id, &[]), None)
                .await
                .expect_err("not theirs")
                .http_status(),
            404
        );
        let listed = manager
            .list(&stranger, pb::ListSessionsRequest::default())
            .await
            .expect("a page");
        assert!(listed.sessions.is_empty());
    }

    #[tokio::test]
    async fn lists_come_in_pages_oldest_first() {
        let (manager, _) = manager(small());
        let mut made = Vec::new();
        for _ in 0..5 {
            made.push(create(&manager, "points 1").await);
        }
        let (mut seen, mut page_token) = (Vec::new(), String::new());
        loop {
            let page = manager
                .list(
                    &tenant(),
                    pb::ListSessionsRequest {
                        page_size: 2,
                        page_token,
                    },
                )
                .await
                .expect("a page");
            assert!(page.sessions.len() <= 2);
            seen.extend(page.sessions.into_iter().map(|s| s.id));
            page_token = page.next_page_token;
            if page_token.is_empty() {
                break;
            }
        }
        assert_eq!(seen, made);
        for (page_size, page_token, field) in [(1001, "", "pageSize"), (1, "x y", "pageToken")] {
            let request = pb::ListSessionsRequest {
                page_size,
                page_token: page_token.into(),
            };
            let error = manager.list(&tenant(), request).await.expect_err("refused");
            assert_eq!((error.http_status(), error.field.as_deref()), (422, Some(field)));
        }
    }
}

mod life {
    use super::*;

    #[tokio::test]
    async fn an_unused_session_expires_and_frees_its_memory() {
        let (manager, _) = manager(small());
        let options = || pb::CreateOptions {
            ttl: "1s".into(),
            label: "short".into(),
            ..Default::default()
        };
        let idle = manager
            .create(&tenant(), model("points 4"), options(), None)
            .await
            .expect("made")
            .value;
        let streaming = manager
            .create(&tenant(), model("points 4"), options(), None)
            .await
            .expect("made")
            .value;
        assert_eq!((idle.label.as_str(), idle.expires_at.ends_with('Z')), ("short", true));
        let stream = manager.stream(&tenant(), &streaming.id).await.expect("a stream");
        until(|| manager.metrics().sessions_expired.get() == 1).await;
        assert_eq!(
            manager
                .get(&tenant(), &idle.id)
                .await
                .expect_err("expired")
                .http_status(),
            404
        );
        // Twice its lease has passed for the other one by the next expiry of a third.
        let third = manager
            .create(&tenant(), model("points 4"), options(), None)
            .await
            .expect("made")
            .value;
        until(|| manager.metrics().sessions_expired.get() == 2).await;
        assert_eq!(
            manager
                .get(&tenant(), &third.id)
                .await
                .expect_err("expired")
                .http_status(),
            404
        );
        manager
            .get(&tenant(), &streaming.id)
            .await
            .expect("an open stream keeps it");
        drop(stream);
        until(|| manager.metrics().sessions_expired.get() == 3 && manager.metrics().bytes.get() == 0).await;
        assert_eq!(manager.metrics().sessions.get(), 0);
    }

    #[tokio::test]
    async fn deleting_ends_work_and_streams() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        control.hold();
        client.drag(1, &[("a", 1.0)]);
        control.held_up().await;
        let solving = tokio::spawn({
            let (manager, id) = (manager.clone(), id.clone());
            async move { manager.solve(&tenant(), solve(&id, &[]), None).await }
        });
        tokio::task::yield_now().await;
        manager.delete(&tenant(), &id).await.expect("deleted");
        assert_eq!(
            (manager.metrics().pool_busy.get(), manager.metrics().bytes.get()),
            (0, 0)
        );
        assert_eq!(solving.await.expect("no panic").expect_err("gone").http_status(), 404);
        let mut last = None;
        while let Some(message) = client.next().await {
            last = Some(message);
        }
        let Some(Tell::Error(error)) = last else {
            panic!("an error comes last, not {last:?}")
        };
        assert_eq!((error.seq, error.code), (0, 5));
    }

    #[tokio::test]
    async fn the_same_key_does_a_thing_once() {
        let (manager, control) = manager(small());
        let create = |text: &'static str, key: &'static str| {
            let manager = manager.clone();
            async move {
                manager
                    .create(&tenant(), model(text), pb::CreateOptions::default(), Some(key))
                    .await
            }
        };
        let first = create("points 4", "one").await.expect("made");
        let again = create("points 4", "one").await.expect("the same answer");
        assert!(!first.repeated && again.repeated && first.value == again.value);
        assert_eq!(manager.metrics().sessions.get(), 1);
        let other = create("points 5", "one").await.expect_err("another model");
        assert_eq!((other.http_status(), other.code_name()), (422, "INVALID_ARGUMENT"));
        assert_eq!(
            create("points 4", "no spaces").await.expect_err("no key").http_status(),
            422
        );

        let id = first.value.id;
        manager
            .set_handles(&tenant(), handles(&id, &["a", "b"]), Some("two"))
            .await
            .expect("set");
        manager
            .set_handles(&tenant(), handles(&id, &["a", "b"]), Some("two"))
            .await
            .expect("the same answer");
        let solve = |x: f64| {
            let (manager, request) = (manager.clone(), solve(&id, &[("a", x)]));
            async move { manager.solve(&tenant(), request, Some("three")).await }
        };
        control.hold();
        let running = tokio::spawn(solve(1.0));
        control.held_up().await;
        let meanwhile = solve(1.0).await.expect_err("the first still runs");
        assert_eq!((meanwhile.http_status(), meanwhile.code_name()), (409, "ABORTED"));
        control.release();
        let done = running.await.expect("no panic").expect("solved");
        let again = solve(1.0).await.expect("the same answer");
        assert_eq!(
            (done.revision, &done.frames, &done.digest),
            (again.revision, &again.frames, &again.digest)
        );
        assert_eq!(solve(2.0).await.expect_err("another pose").http_status(), 422);
        for _ in 0..2 {
            let session = manager.undo(&tenant(), &id, Some("four")).await.expect("undone once");
            assert_eq!(session.revision, 4);
        }
        assert_eq!(manager.get(&tenant(), &id).await.expect("open").revision, 4);
    }

    #[tokio::test]
    async fn a_call_that_failed_or_was_given_up_frees_its_key() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let wrong = manager
            .solve(&tenant(), solve(&id, &[("x", 1.0)]), Some("key"))
            .await
            .expect_err("unknown handle");
        assert_eq!(wrong.http_status(), 422);
        control.hold();
        let request = solve(&id, &[("a", 1.0)]);
        let solving = manager.solve(&tenant(), request.clone(), Some("key"));
        assert!(tokio::time::timeout(Duration::from_millis(20), solving).await.is_err());
        until(|| manager.metrics().pool_busy.get() == 0).await;
        control.release();
        let solved = loop {
            match manager.solve(&tenant(), request.clone(), Some("key")).await {
                // The session's task may not have heard of the end yet.
                Err(error) if error.code == Code::Aborted => tokio::time::sleep(Duration::from_millis(1)).await,
                other => break other.expect("done at last"),
            }
        };
        assert_eq!(solved.revision, 3);
    }

    #[tokio::test]
    async fn draining_tells_streams_and_waits_for_them() {
        let (manager, control) = manager(small());
        let id = open(&manager).await;
        let mut client = Client::open(&manager, &id).await;
        manager.start_drain();
        assert!(!manager.admits());
        let Some(Tell::Notice(notice)) = client.next().await else {
            panic!("a notice was expected")
        };
        assert_eq!((notice.code.as_str(), &notice.resume_token), ("going-away", &id));
        let error = manager.stream(&tenant(), &id).await.expect_err("no new streams");
        assert_eq!((error.http_status(), error.retry_after_s.is_some()), (503, true));
        let made = manager
            .create(&tenant(), model("points 4"), pb::CreateOptions::default(), None)
            .await;
        assert_eq!(made.expect_err("no new sessions").http_status(), 503);
        client.commit(1, &[("a", 1.0)]);
        assert_eq!(client.frame().await.header.seq, 1, "what is open still works");
        let draining = manager.drained();
        tokio::pin!(draining);
        assert!(futures::poll!(draining.as_mut()).is_pending());
        drop(client);
        draining.await;

        control.hold();
        let solving = tokio::spawn({
            let (manager, id) = (manager.clone(), id.clone());
            async move { manager.solve(&tenant(), solve(&id, &[]), None).await }
        });
        control.held_up().await;
        manager.abort();
        assert_eq!(
            solving.await.expect("no panic").expect_err("aborted").http_status(),
            503
        );
        manager.drained().await;
        until(|| manager.metrics().sessions.get() == 0 && manager.metrics().pool_busy.get() == 0).await;
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 4)]
    async fn many_sessions_share_few_slots() {
        let (manager, _) = manager(Config {
            compute_slots: 1,
            ..small()
        });
        let work = (0..8).map(|k| {
            let manager = manager.clone();
            tokio::spawn(async move {
                let id = open(&manager).await;
                let mut client = Client::open(&manager, &id).await;
                for seq in 1..=20 {
                    client.drag(seq, &[("a", f64::from(k))]);
                    assert_eq!(client.frame().await.x[0], f64::from(k));
                    client.ack(seq);
                }
                client.commit(21, &[]);
                assert_eq!(client.frame().await.header.revision, 3);
                drop(client);
                manager.delete(&tenant(), &id).await.expect("deleted");
            })
        });
        for done in futures::future::join_all(work).await {
            done.expect("no panic");
        }
        let metrics = manager.metrics();
        assert_eq!(
            (metrics.sessions.get(), metrics.streams.get(), metrics.bytes.get()),
            (0, 0, 0)
        );
        assert_eq!((metrics.poses_solved.get(), metrics.commits.get()), (8 * 21, 8 * 2));
    }
}

/// The same promises with the engine that users get.
mod real {
    use super::*;

    /// An upright bar of square section, closed, with the handles `base` (held) and `top`.
    fn bar() -> FileSet {
        let mut text = String::new();
        let (rings, corners) = (12, [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]);
        for k in 0..=rings {
            for (x, y) in corners {
                text += &format!("v {x} {y} {}\n", f64::from(k) * 0.25);
            }
        }
        for k in 0..rings {
            for c in 0..4 {
                let at = |k: i32, c: i32| k * 4 + c % 4 + 1;
                text += &format!(
                    "f {} {} {} {}\n",
                    at(k, c),
                    at(k, c + 1),
                    at(k + 1, c + 1),
                    at(k + 1, c)
                );
            }
        }
        text += &format!(
            "f 4 3 2 1\nf {} {} {} {}\n",
            rings * 4 + 1,
            rings * 4 + 2,
            rings * 4 + 3,
            rings * 4 + 4
        );
        FileSet::single("bar.obj", text.into_bytes())
    }

    fn half_space(id: &str, z: f64, offset: f64) -> pb::Handle {
        let half_space = pb::region::HalfSpace {
            normal: vec![0.0, 0.0, z],
            offset,
        };
        let region = Some(pb::Region {
            region: Some(pb::region::Region::HalfSpace(half_space)),
        });
        pb::Handle {
            id: id.into(),
            region,
            ..Default::default()
        }
    }

    async fn bent(manager: &Manager) -> (String, pb::Session) {
        let made = manager
            .create(&tenant(), bar(), pb::CreateOptions::default(), None)
            .await
            .expect("a bar")
            .value;
        let handles = vec![half_space("base", -1.0, -0.3), half_space("top", 1.0, 2.7)];
        let request = pb::SetHandlesRequest {
            session_id: made.id.clone(),
            handles,
            ..Default::default()
        };
        let session = manager
            .set_handles(&tenant(), request, None)
            .await
            .expect("two handles");
        (made.id, session)
    }

    fn turned(id: &str, angle: f64) -> pb::SolveRequest {
        let pose = pb::HandlePose {
            rotation_vector: vec![angle, 0.0, 0.0],
            ..Default::default()
        };
        let entry = pb::pose::Entry {
            id: "top".into(),
            pose: (angle != 0.0).then_some(pose),
        };
        let pose = pb::Pose {
            seq: 4,
            handles: vec![entry],
            commit: true,
        };
        pb::SolveRequest {
            session_id: id.into(),
            pose: Some(pose),
            options: None,
        }
    }

    #[tokio::test]
    async fn commits_undo_and_replay_to_the_bit() {
        for snapshot_bytes in [1 << 24, 0] {
            let manager = Manager::new(Config {
                snapshot_bytes,
                ..small()
            })
            .expect("valid");
            let (id, session) = bent(&manager).await;
            assert_eq!((session.handles.len(), session.primitives.len()), (2, 1));
            assert!(
                ["read", "mesh", "hierarchy", "fields"]
                    .iter()
                    .all(|s| session.build_ms.contains_key(*s)),
                "{session:?}"
            );
            let rest = manager
                .export(&tenant(), &id, None)
                .await
                .expect("written")
                .written
                .main;
            assert_eq!(rest, bar().main, "an undeformed model is written byte for byte");
            let first = manager.solve(&tenant(), turned(&id, 1.0), None).await.expect("solved");
            assert_ne!(
                manager
                    .export(&tenant(), &id, None)
                    .await
                    .expect("written")
                    .written
                    .main,
                rest
            );
            let second = manager.solve(&tenant(), turned(&id, -0.5), None).await.expect("solved");
            let mut client = Client::open(&manager, &id).await;
            for (seq, angle) in [(1, 0.2), (2, 0.9)] {
                let pose = turned(&id, angle).pose.expect("a pose");
                let pose = pb::Pose {
                    seq,
                    commit: false,
                    ..pose
                };
                client
                    .input
                    .push(ask(pb::deform_request::Message::Pose(pose)))
                    .expect("open");
                let frame = client.frame().await.header;
                assert!(frame.r#final && frame.residual <= 1e-4 && frame.max_error.is_finite());
                client.ack(seq);
            }
            drop(client);
            manager.undo(&tenant(), &id, None).await.expect("undone");
            let view = manager.history(&tenant(), &id).await.expect("open");
            let at = view
                .commits
                .iter()
                .find(|c| c.revision == view.current)
                .expect("listed");
            assert_eq!(at.digest, first.digest);
            let again = manager.solve(&tenant(), turned(&id, -0.5), None).await.expect("solved");
            assert_eq!(
                again.digest, second.digest,
                "the same handles, poses and settings give the same bits"
            );
            let home = manager.solve(&tenant(), turned(&id, 0.0), None).await.expect("solved");
            assert_eq!(home.digest, view.commits[0].digest, "at rest nothing moves");
            assert_eq!(
                manager
                    .export(&tenant(), &id, None)
                    .await
                    .expect("written")
                    .written
                    .main,
                rest
            );
        }
    }

    #[tokio::test]
    async fn frames_carry_normals_that_turn_with_the_shape() {
        let manager = Manager::new(small()).expect("valid");
        let (id, _) = bent(&manager).await;
        let output = Some(pb::Output {
            normals: true,
            tangents: true,
            ..Default::default()
        });
        let mut request = turned(&id, 1.0);
        request.options = Some(pb::Options {
            output,
            progressive: true,
            ..Default::default()
        });
        let solved = manager.solve(&tenant(), request, None).await.expect("solved");
        let attributes: Vec<i32> = solved.frames.iter().map(|f| f.attribute).collect();
        assert_eq!(attributes, [0, 1, 2]);
        assert!(
            solved
                .frames
                .iter()
                .all(|f| f.seq == 4 && f.r#final && f.vertex_count == 52)
        );
        let numbers = solved.frames[1]
            .data
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let numbers: Vec<f32> = numbers.collect();
        for normal in numbers.chunks_exact(3) {
            let length = normal.iter().map(|x| x * x).sum::<f32>();
            assert!((length - 1.0).abs() < 1e-3, "{normal:?}");
        }
        let repeat = manager.solve(&tenant(), turned(&id, 1.0), None).await.expect("solved");
        assert_eq!(
            repeat.digest, solved.digest,
            "what frames carry does not change the shape"
        );
    }
}
