//! Laws of dragging: frames are what a solve in double precision gives, to what was asked for, whatever came before them.

use crate::support::bench::{largest_distance, obj};
use crate::support::shapes::{both, moved};
use glam::DVec3;
use pliant::asset::{FileSet, shapes};
use pliant::engine::{
    Deformer, DeformerLimits, Falloff, FalloffCurve, Handle, HandlePose, HandleRotation, HandleScale, Method,
    ModelShape, OpenOptions, Plane, Quality, Region, SolveMode, SolveSettings,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;

/// A box of many cells, and with `beside` a small one that touches it.
fn boxes(beside: bool) -> FileSet {
    let mut all = shapes::box_with_cells(DVec3::new(1.0, 1.0, 6.0), [8, 8, 48]);
    if beside {
        let small = shapes::box_with_cells(DVec3::new(0.5, 0.3, 0.5), [4, 3, 4]);
        all = both(all, moved(small, |p| p + DVec3::new(0.25, 1.002, 2.5)));
    }
    obj(&all)
}

fn beyond(id: &str, normal: DVec3, offset: f64) -> Handle {
    Handle::new(id, Region::HalfSpace(Plane { normal, offset }))
}

/// What the handles of a scene are.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Scene {
    /// One end held, one that moves.
    Ends,
    /// The same with a part that is tied to the bar.
    Tied,
    /// A soft one in the middle besides.
    Soft,
}

fn deformer(scene: Scene, pool: &Pool) -> Deformer {
    let exec = Exec::new(pool, &Silent);
    let files = boxes(scene == Scene::Tied);
    let mut deformer = Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec).unwrap();
    let mut handles = vec![beyond("low", -DVec3::Z, -0.3), beyond("high", DVec3::Z, 5.7)];
    if scene == Scene::Soft {
        handles.push(Handle {
            region: Region::Sphere {
                center: DVec3::new(0.5, 1.0, 3.0),
                radius: 0.4,
            },
            stiffness: Some(0.5),
            falloff: Some(Falloff {
                radius: 0.6,
                curve: FalloffCurve::Smooth,
            }),
            ..beyond("soft", DVec3::Z, 0.0)
        });
    }
    deformer.set_handles(handles, &exec).unwrap();
    deformer
}

/// The pose at a time of a movement: one end turns about two axes, moves, and with `scaled` grows; a soft handle comes along.
fn pose(scene: Scene, t: f64, scaled: bool) -> Vec<(&'static str, HandlePose)> {
    let mut poses = vec![(
        "high",
        HandlePose {
            translation: Some(DVec3::new(0.6, -0.4, 0.3) * t),
            rotation: Some(HandleRotation::Vector(DVec3::new(
                0.9 * t,
                0.4 * t,
                if scaled { 0.0 } else { 2.5 * t },
            ))),
            scale: scaled.then_some(HandleScale::PerAxis(DVec3::new(1.0 + 0.3 * t, 1.0, 1.0 - 0.2 * t))),
            ..HandlePose::default()
        },
    )];
    if scene == Scene::Soft {
        poses.push(("soft", HandlePose::translation(DVec3::Y * (0.5 * t))));
    }
    poses
}

fn frame(deformer: &mut Deformer, poses: Vec<(&str, HandlePose)>, settings: &SolveSettings, pool: &Pool) -> ModelShape {
    let poses = deformer.change_poses(&deformer.initial_poses(), poses).unwrap();
    let exec = Exec::new(pool, &Silent);
    deformer
        .solve(&poses, settings, SolveMode::Drag, &exec, &mut |_| true)
        .unwrap()
}

/// Solves to the last digits.
fn exact() -> SolveSettings {
    SolveSettings::from(Quality {
        tolerance: Some(1e-10),
        ..Quality::default()
    })
}

/// The largest distance of a vertex, as a fraction of the diagonal.
fn distance(deformer: &Deformer, a: &[DVec3], b: &[DVec3]) -> f64 {
    largest_distance(a, b) / deformer.diagonal()
}

#[test]
fn frames_are_as_near_to_the_exact_shape_as_asked_for() {
    let pool = Pool::new(2).unwrap();
    let mut none = 0;
    for scene in [Scene::Ends, Scene::Tied, Scene::Soft] {
        for scaled in [false, true] {
            let (mut dragged, mut beside) = (deformer(scene, &pool), deformer(scene, &pool));
            for k in 1..=24 {
                // There, a jump, and back.
                let t = [f64::from(k) / 24.0, 1.0 - f64::from(k) / 40.0][usize::from(k > 15)];
                let shown = frame(&mut dragged, pose(scene, t, scaled), &SolveSettings::default(), &pool);
                none += u32::from(shown.stats.cycles == 0);
                assert!(shown.stats.residual <= 1e-4, "{scene:?} {k}: {}", shown.stats.residual);
                if k % 4 == 0 {
                    let wanted = frame(&mut beside, pose(scene, t, scaled), &exact(), &pool);
                    let far = distance(&dragged, &shown.positions, &wanted.positions);
                    assert!(far < 2e-4, "{scene:?} scaled {scaled} frame {k}: {far:.1e}");
                    assert!(
                        far < 4.0 * shown.stats.max_error + 2e-6,
                        "{far:.1e} where {:.1e} was reported",
                        shown.stats.max_error
                    );
                }
            }
        }
    }
    assert!(
        none > 20,
        "a smooth drag goes on from what is known: {none} frames of 144 without an iteration"
    );
}

#[test]
fn an_error_that_is_asked_for_is_kept() {
    let pool = Pool::new(2).unwrap();
    let asked = SolveSettings::from(Quality {
        tolerance: None,
        max_error: Some(5e-5),
        ..Quality::default()
    });
    let (mut dragged, mut beside) = (deformer(Scene::Ends, &pool), deformer(Scene::Ends, &pool));
    for k in 1..=20 {
        let t = f64::from(k) / 20.0;
        let shown = frame(&mut dragged, pose(Scene::Ends, t, false), &asked, &pool);
        let wanted = frame(&mut beside, pose(Scene::Ends, t, false), &exact(), &pool);
        let far = distance(&dragged, &shown.positions, &wanted.positions);
        assert!(
            far < 1e-4 && shown.stats.max_error <= 5e-5,
            "frame {k}: {far:.1e}, reported {:.1e}",
            shown.stats.max_error
        );
    }
}

#[test]
fn frames_have_the_same_bits_on_any_number_of_threads() {
    let run = |threads: usize| -> Vec<u64> {
        let pool = Pool::new(threads).unwrap();
        let mut dragged = deformer(Scene::Tied, &pool);
        let mut bits = Vec::new();
        for k in 1..=24 {
            let shown = frame(
                &mut dragged,
                pose(Scene::Tied, f64::from(k) / 24.0, false),
                &SolveSettings::default(),
                &pool,
            );
            dragged.settle(&Exec::new(&pool, &Silent)).unwrap();
            bits.extend(shown.positions.iter().flat_map(|p| p.to_array().map(f64::to_bits)));
        }
        bits
    };
    let one = run(1);
    assert!([2, 3, 8].into_iter().all(|threads| run(threads) == one));
}

#[test]
fn methods_for_comparison_are_not_solved_ahead_where_nothing_turns_either() {
    let pool = Pool::new(2).unwrap();
    let is_solved_ahead = |method: Method| {
        let mut dragged = deformer(Scene::Ends, &pool);
        let settings = SolveSettings {
            method,
            ..SolveSettings::default()
        };
        (1..=8).any(|k| {
            let t = f64::from(k) / 8.0;
            let larger = HandlePose {
                scale: Some(HandleScale::PerAxis(DVec3::new(1.0 + 0.5 * t, 1.0, 1.0 - 0.3 * t))),
                ..HandlePose::translation(DVec3::new(0.6, -0.4, 0.3) * t)
            };
            frame(&mut dragged, vec![("high", larger)], &settings, &pool);
            dragged.is_worth_settling()
        })
    };
    assert!(is_solved_ahead(Method::Harmonic));
    assert!(!is_solved_ahead(Method::Diffusion) && !is_solved_ahead(Method::LinearFrames));
}

#[test]
fn frames_of_a_smooth_drag_need_no_iteration_where_the_time_between_them_is_used() {
    let pool = Pool::new(2).unwrap();
    let settings = SolveSettings::default();
    let mut cycles = [0, 0];
    let mut settled = 0;
    let (mut dragged, mut ahead, mut beside) = (
        deformer(Scene::Tied, &pool),
        deformer(Scene::Tied, &pool),
        deformer(Scene::Tied, &pool),
    );
    assert!(!ahead.is_worth_settling(), "nothing has been dragged");
    for k in 1..=60 {
        let now = || pose(Scene::Tied, f64::from(k) / 60.0, false);
        let shown = [&mut dragged, &mut ahead].map(|d| frame(d, now(), &settings, &pool));
        settled += u32::from(ahead.is_worth_settling());
        ahead.settle(&Exec::new(&pool, &Silent)).unwrap();
        assert!(!ahead.is_worth_settling(), "frame {k}: it is done");
        ahead.settle(&Exec::new(&pool, &Silent)).unwrap();
        if k <= 10 {
            continue;
        }
        (cycles.iter_mut().zip(&shown)).for_each(|(cycles, shown)| *cycles += shown.stats.cycles);
        assert!(shown[1].stats.residual <= 1e-4);
        if k % 7 == 0 {
            let wanted = frame(&mut beside, now(), &exact(), &pool);
            let far = distance(&ahead, &shown[1].positions, &wanted.positions);
            assert!(
                far < 1e-4 && far < 4.0 * shown[1].stats.max_error + 2e-6,
                "frame {k}: {far:.1e}"
            );
        }
    }
    assert!(settled > 3, "some frames leave much: {settled}");
    assert!(
        cycles[0] > 5 && cycles[1] <= 1,
        "{} iterations in frames, and {} where the time between them is used",
        cycles[0],
        cycles[1]
    );
}

#[test]
fn what_is_solved_between_frames_is_given_up_whole() {
    /// Gives up at once.
    struct GivenUp;
    impl pliant::progress::Progress for GivenUp {
        fn cancelled(&self) -> bool {
            true
        }
    }
    let pool = Pool::new(2).unwrap();
    let settings = SolveSettings::default();
    let (mut dragged, mut same) = (deformer(Scene::Ends, &pool), deformer(Scene::Ends, &pool));
    let mut given_up = 0;
    for k in 1..=40 {
        let now = || pose(Scene::Ends, f64::from(k) / 40.0, false);
        let [one, other] = [&mut dragged, &mut same].map(|d| frame(d, now(), &settings, &pool));
        // What was known of earlier poses may be forgotten, which the next frame makes up for.
        assert!(one.stats.residual <= 1e-4 && distance(&same, &one.positions, &other.positions) < 2e-4);
        if dragged.is_worth_settling() {
            given_up += 1;
            assert!(dragged.settle(&Exec::new(&pool, &GivenUp)).is_err());
        }
        // A commit in between uses the same memory, after which there is nothing to go on from.
        if k == 30 {
            let exec = Exec::new(&pool, &Silent);
            for d in [&mut dragged, &mut same] {
                d.commit(now(), &settings, &exec).unwrap();
            }
            assert!(!dragged.is_worth_settling());
        }
    }
    assert!(given_up > 2, "{given_up}");
}

#[test]
fn a_drag_goes_on_from_a_commit_and_a_commit_knows_nothing_of_it() {
    let pool = Pool::new(2).unwrap();
    let exec = Exec::new(&pool, &Silent);
    let settings = SolveSettings::default();
    let (mut dragged, mut fresh) = (deformer(Scene::Soft, &pool), deformer(Scene::Soft, &pool));
    for k in 1..=5 {
        frame(
            &mut dragged,
            pose(Scene::Soft, f64::from(k) / 10.0, false),
            &settings,
            &pool,
        );
    }
    let last = pose(Scene::Soft, 0.5, false);
    let [one, other] = [&mut dragged, &mut fresh].map(|d| d.commit(last.clone(), &settings, &exec).unwrap());
    assert_eq!(one.positions, other.positions, "a commit depends on nothing before it");
    // A frame of the same pose starts at the committed shape.
    let quick = SolveSettings::from(Quality {
        refine: Some(0),
        ..settings.quality
    });
    let shown = frame(&mut dragged, last.clone(), &quick, &pool);
    let wanted = frame(&mut fresh, last, &exact(), &pool);
    assert!(distance(&dragged, &shown.positions, &wanted.positions) < 2e-4);
}

#[test]
fn poses_beyond_the_range_of_numbers_leave_the_drag_usable() {
    let pool = Pool::new(2).unwrap();
    let mut dragged = deformer(Scene::Ends, &pool);
    let settings = SolveSettings::default();
    let far = |distance: f64| vec![("high", HandlePose::translation(DVec3::X * distance))];
    for distance in [1e5, 1e20, 1e37, 1e150, 1e300] {
        let poses = dragged.change_poses(&dragged.initial_poses(), far(distance)).unwrap();
        let exec = Exec::new(&pool, &Silent);
        if let Ok(shape) = dragged.solve(&poses, &settings, SolveMode::Drag, &exec, &mut |_| true) {
            assert!(shape.positions.iter().all(|p| p.is_finite()), "{distance:e}");
        }
    }
    let shown = frame(&mut dragged, far(0.5), &settings, &pool);
    let mut beside = deformer(Scene::Ends, &pool);
    let wanted = frame(&mut beside, far(0.5), &exact(), &pool);
    assert!(distance(&dragged, &shown.positions, &wanted.positions) < 2e-4);
}
