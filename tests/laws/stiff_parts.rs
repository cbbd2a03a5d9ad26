//! Laws of stiff parts: they keep their shape, nothing pulls at them, and what lies between bends.

use crate::support::bench::{largest_distance, obj};
use crate::support::shapes::{both, moved};
use glam::DVec3;
use pliant::asset::shapes;
use pliant::engine::{
    Deformer, DeformerLimits, Handle, HandlePose, HandleSet, OpenOptions, Plane, Region, SolveMode, SolveSettings,
    Stiff,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;

const LENGTH: f64 = 8.0;
const BOLTS: usize = 6;

/// A bar along z with bolts on one side, which touch it.
fn bar_with_bolts() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut all = shapes::box_with_cells(DVec3::new(1.0, 1.0, LENGTH), [5, 5, 40]);
    for k in 0..BOLTS {
        let bolt = shapes::box_with_cells(DVec3::new(0.5, 0.6, 0.7), [3, 3, 3]);
        let z = 1.0 + k as f64;
        all = both(all, moved(bolt, move |p| p + DVec3::new(0.25, 1.002, z)));
    }
    all
}

fn deformer(stiff: Option<Stiff>, pool: &Pool) -> Deformer {
    let exec = Exec::new(pool, &Silent);
    let (options, limits) = (OpenOptions::default(), DeformerLimits::default());
    let mut deformer = Deformer::open(obj(&bar_with_bolts()), &options, &limits, &exec).unwrap();
    let end = |id: &str, normal: DVec3, offset: f64| Handle::new(id, Region::HalfSpace(Plane { normal, offset }));
    let handles = vec![end("low", -DVec3::Z, -0.5), end("high", DVec3::Z, LENGTH - 0.5)];
    let set = HandleSet {
        stiff,
        ..HandleSet::from(handles)
    };
    deformer.set_handles(set, &exec).unwrap();
    deformer
}

/// The upper end turned by a right angle and moved along.
fn bent() -> HandlePose {
    HandlePose::rotation([0.0, 1.5, 0.0]).about([0.5, 0.5, LENGTH - 0.5])
}

fn commit(deformer: &mut Deformer, pose: HandlePose, pool: &Pool) -> Vec<DVec3> {
    let exec = Exec::new(pool, &Silent);
    let shape = deformer
        .commit([("high", pose.clone())], &SolveSettings::default(), &exec)
        .unwrap();
    shape.positions.to_vec()
}

fn bolts() -> Stiff {
    Stiff {
        components: (1..=BOLTS as u32).collect(),
        ..Stiff::default()
    }
}

fn off_rigid(deformer: &Deformer, shape: &[DVec3], pool: &Pool) -> f64 {
    let measured = deformer.measure(shape, false, &Exec::new(pool, &Silent)).unwrap();
    measured.off_rigid.expect("there are stiff parts")
}

#[test]
fn bolts_keep_their_shape_and_stay_on_the_bar() {
    let pool = Pool::new(2).unwrap();
    let (mut soft, mut hard) = (deformer(None, &pool), deformer(Some(bolts()), &pool));
    assert_eq!(hard.facts().solver.stiff_parts, BOLTS as u32);
    let before = commit(&mut soft, bent(), &pool);
    let shape = commit(&mut hard, bent(), &pool);
    assert!(off_rigid(&hard, &before, &pool) > 0.02, "without the word they bend");
    let off = off_rigid(&hard, &shape, &pool);
    assert!(off < 1e-9, "{off}");
    // The bar itself is hardly another one.
    let bar = 6 * 6 * 2 + 39 * 20;
    let far = largest_distance(&shape[..bar], &before[..bar]) / LENGTH;
    assert!(far < 0.02, "the bar has moved by {far}");
    // Where each bolt's foot is near the bar it stays near: no more than a fifth of its width away.
    let rest = hard.rest().clone();
    for foot in bar..rest.len() {
        let below = (0..bar).min_by(|a, b| rest[*a].distance(rest[foot]).total_cmp(&rest[*b].distance(rest[foot])));
        let below = below.unwrap();
        let (was, is) = (rest[below].distance(rest[foot]), shape[below].distance(shape[foot]));
        assert!(was > 0.2 || (is - was).abs() < 0.1, "{was} {is}");
    }
    let one = Pool::new(1).unwrap();
    assert_eq!(commit(&mut hard, bent(), &one), shape, "on one thread");
}

#[test]
fn nothing_pulls_at_a_stiff_part() {
    let pool = Pool::new(2).unwrap();
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = deformer(Some(bolts()), &pool);
    let set = HandleSet {
        handles: deformer.handles().handles[1..].to_vec(),
        ..deformer.handles().clone()
    };
    deformer.set_handles(set, &exec).unwrap();
    // One handle takes all along, wherever it goes.
    let pose = HandlePose::translation([3.0, -1.0, 2.0]).rotated([0.4, 1.0, -2.0]);
    let shape = commit(&mut deformer, pose.clone(), &pool);
    let poses = deformer
        .change_poses(&deformer.initial_poses(), [("high", pose.clone())])
        .unwrap();
    let map = deformer.transforms(&poses).unwrap()[0].map();
    let wanted: Vec<DVec3> = deformer.rest().iter().map(|p| map(*p)).collect();
    let far = largest_distance(&shape, &wanted) / LENGTH;
    assert!(far < 1e-3, "{far}");
    let still = commit(&mut deformer, HandlePose::default(), &pool);
    assert_eq!(still, **deformer.rest());
}

#[test]
fn bolts_are_found_and_all_parts_are_stiff_when_asked_for() {
    let pool = Pool::new(2).unwrap();
    let auto = Stiff {
        auto: true,
        ..Stiff::default()
    };
    let mut found = deformer(Some(auto), &pool);
    assert_eq!(found.hard_parts(), (1..=BOLTS as u32).collect::<Vec<_>>());
    let same = commit(&mut deformer(Some(bolts()), &pool), bent(), &pool);
    assert_eq!(commit(&mut found, bent(), &pool), same);
    // The bar is held by both handles: it bends, and a warning reports it.
    let all = Stiff {
        all: true,
        ..Stiff::default()
    };
    let mut all = deformer(Some(all), &pool);
    let warned = all.facts().warnings.iter().any(|w| w.code == "stiff-part-held");
    assert!(warned && all.facts().solver.stiff_parts == BOLTS as u32);
    assert_eq!(commit(&mut all, bent(), &pool), same);
}

#[test]
fn a_part_under_a_handle_follows_it_as_a_whole() {
    let pool = Pool::new(2).unwrap();
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = deformer(Some(bolts()), &pool);
    let mut handles = deformer.handles().handles.clone();
    // One corner of the third bolt.
    handles.push(Handle::new("corner", Region::sphere([0.25, 1.602, 3.0], 0.2)));
    let set = HandleSet {
        stiff: Some(bolts()),
        ..HandleSet::from(handles)
    };
    deformer.set_handles(set, &exec).unwrap();
    assert_eq!(deformer.facts().solver.stiff_parts, BOLTS as u32 - 1);
    let up = HandlePose::translation([0.0, 0.4, 0.0]);
    let shape = deformer
        .commit([("corner", up)], &SolveSettings::default(), &exec)
        .unwrap();
    let moved = |p: &DVec3| p.y > 1.001 && (3.0..=3.7).contains(&p.z);
    let off = deformer.rest().iter().zip(shape.iter()).filter(|(p, _)| moved(p));
    let far = off.map(|(p, x)| (*p + DVec3::Y * 0.4).distance(*x)).fold(0.0, f64::max);
    assert!(far < 1e-12, "{far}");
}

#[test]
fn a_ring_around_a_hole_stays_a_ring_while_the_plate_bends_and_a_drag_shows_it() {
    let pool = Pool::new(2).unwrap();
    let exec = Exec::new(&pool, &Silent);
    let plate = shapes::box_with_cells(DVec3::new(4.0, 0.3, 8.0), [16, 2, 32]);
    let (options, limits) = (OpenOptions::default(), DeformerLimits::default());
    let mut deformer = Deformer::open(obj(&plate), &options, &limits, &exec).unwrap();
    let end = |id: &str, normal: DVec3, offset: f64| Handle::new(id, Region::HalfSpace(Plane { normal, offset }));
    let stiff = Stiff {
        regions: vec![Region::capsule([2.0, -1.0, 4.0], [2.0, 1.0, 4.0], 1.2)],
        ..Stiff::default()
    };
    let set = HandleSet {
        stiff: Some(stiff),
        ..HandleSet::from(vec![end("low", -DVec3::Z, -1.0), end("high", DVec3::Z, 7.0)])
    };
    deformer.set_handles(set, &exec).unwrap();
    let pose = HandlePose::rotation([-1.2, 0.0, 0.0]).about([2.0, 0.15, 7.0]);
    let shape = commit(&mut deformer, pose.clone(), &pool);
    let off = off_rigid(&deformer, &shape, &pool);
    assert!(off < 1e-9, "{off}");
    let poses = deformer
        .change_poses(&deformer.initial_poses(), [("high", pose.clone())])
        .unwrap();
    let shown = deformer
        .solve(&poses, &SolveSettings::default(), SolveMode::Drag, &exec, &mut |_| true)
        .unwrap();
    let off = off_rigid(&deformer, &shown, &pool);
    assert!(off < 1e-9, "in a drag: {off}");
    // Half as rigid is half as much off.
    let mut set = deformer.handles().clone();
    set.stiff.as_mut().unwrap().strength = 0.5;
    deformer.set_handles(set, &exec).unwrap();
    let halfway = commit(&mut deformer, pose.clone(), &pool);
    let bends = off_rigid(&deformer, &halfway, &pool);
    assert!(bends > 1e-3, "{bends}");
}
