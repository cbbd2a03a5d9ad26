//! Handles whose vertices have targets of their own.

use glam::DVec3;
use pliant_core::asset::{FileSet, shapes};
use pliant_core::deform::VolumeMode;
use pliant_core::engine::{
    Deformer, DeformerLimits, Error, Handle, HandleConstrains, HandlePose, HandleSet, ModelShape, OpenOptions, Quality,
    Region, SolveSettings, StiffnessPer, VertexRange, VertexTargets,
};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

/// A closed tube along an axis; `fine` times as many vertices each way.
fn tube(fine: usize) -> FileSet {
    model_of(&shapes::cylinder(0.5, 4.0, 12 * fine, 24 * fine, true))
}

fn model_of((points, triangles): &(Vec<DVec3>, Vec<[u32; 3]>)) -> FileSet {
    let mut text = String::new();
    for p in points {
        let p = p.as_vec3();
        text += &format!("v {} {} {}\n", p.x, p.y, p.z);
    }
    for [a, b, c] in triangles {
        text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
    }
    FileSet::single("tube.obj", text)
}

fn open(model: FileSet, volume: VolumeMode, exec: &Exec<'_>) -> Deformer {
    let mut options = OpenOptions::default();
    options.body.volume = volume;
    Deformer::open(model, &options, &DeformerLimits::default(), exec).expect("a model")
}

fn set(deformer: &mut Deformer, handles: impl Into<HandleSet>, exec: &Exec<'_>) {
    deformer.set_handles(handles, exec).expect("right handles");
}

/// Sets some handles, and one with targets for all vertices.
fn set_scan(deformer: &mut Deformer, others: &[Handle], stiffness: f64, exec: &Exec<'_>) {
    let scan = Handle::with_targets("scan", all(deformer), stiffness);
    let handles: Vec<Handle> = others.iter().cloned().chain([scan]).collect();
    set(deformer, handles, exec);
}

/// All vertices of a model.
fn all(deformer: &Deformer) -> Region {
    let count = deformer.rest().len() as u32;
    Region::Vertices {
        indices: Vec::new(),
        ranges: vec![VertexRange { first: 0, count }],
    }
}

fn base() -> Handle {
    Handle::new("base", Region::half_space([0.0, 0.0, -1.0], -0.3))
}

/// To a great exactness, so that ways of solving do not show.
fn exact() -> SolveSettings {
    let mut settings = SolveSettings::default();
    settings.quality = Quality {
        tolerance: Some(1e-10),
        ..settings.quality
    };
    settings
}

fn wave(p: &DVec3) -> [f32; 3] {
    let by = DVec3::new(0.4 * libm::sin(p.z), 0.1 * p.z * p.z, 0.2 * libm::cos(3.0 * p.x));
    (*p + by).as_vec3().to_array()
}

fn weight(k: usize) -> f32 {
    [1.0, 0.25, 0.0, 2.0, 0.5][k % 5]
}

fn waved(deformer: &Deformer) -> VertexTargets {
    VertexTargets::of(deformer.rest().iter().map(wave)).weighted((0..deformer.rest().len()).map(weight))
}

fn commit(deformer: &mut Deformer, pose: HandlePose, exec: &Exec<'_>) -> ModelShape {
    deformer.commit([("scan", pose)], &exact(), exec).expect("solved")
}

fn farthest(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

#[test]
fn targets_do_what_a_soft_handle_for_each_vertex_does() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(tube(1), VolumeMode::Off, &exec);
    set_scan(&mut deformer, &[base()], 0.3, &exec);
    let targets = waved(&deformer);
    let shape = commit(&mut deformer, HandlePose::targets(targets.clone()), &exec);

    let single = |vertex: usize, by: DVec3| Handle {
        constrains: HandleConstrains {
            rotation: false,
            scale: false,
            ..HandleConstrains::ALL
        },
        pose: Some(HandlePose::translation(by)),
        ..Handle::new(format!("v{vertex}"), Region::vertices([vertex as u32])).soft(0.3 * f64::from(weight(vertex)))
    };
    let rest = deformer.rest().to_vec();
    let by = |k: usize| DVec3::from_array(targets.positions[k].map(f64::from)) - rest[k];
    // The hard handle keeps its vertices.
    let mut handles = Vec::new();
    let pulled = (0..rest.len()).filter(|&k| weight(k) > 0.0);
    handles.extend(pulled.map(|k| single(k, by(k))));
    handles.push(base());
    let mut plain = open(tube(1), VolumeMode::Off, &exec);
    set(&mut plain, handles, &exec);
    let expected = plain.commit([], &exact(), &exec).expect("solved");
    let off = farthest(&shape.positions, &expected.positions) / deformer.diagonal();
    assert!(off < 1e-7, "off by {off} of the diagonal");
    let moved = farthest(&shape.positions, &rest) / deformer.diagonal();
    assert!(moved > 0.05, "only {moved} of the diagonal moved");
}

#[test]
fn targets_at_rest_and_weights_of_nothing_change_nothing() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(tube(1), VolumeMode::Off, &exec);
    let scan = Handle::with_targets("scan", all(&deformer), 1.0);
    set(&mut deformer, [base(), scan.clone()], &exec);
    let at_rest = VertexTargets::of(deformer.rest().iter().map(|p| p.as_vec3().to_array()));
    let shape = commit(&mut deformer, HandlePose::targets(at_rest), &exec);
    assert_eq!(shape.positions[..], deformer.rest()[..]);

    let high = Handle::new("high", Region::half_space([0.0, 0.0, 1.0], 3.7));
    let bent = [("high", HandlePose::rotation([0.8, 0.0, 0.0]))];
    set(&mut deformer, [base(), high.clone()], &exec);
    let without = deformer.commit(bent.clone(), &exact(), &exec).expect("solved");
    set(&mut deformer, [base(), high, scan], &exec);
    let count = deformer.rest().len();
    let nothing = waved(&deformer).weighted(std::iter::repeat_n(0.0, count));
    let [bent] = bent;
    let changes = [bent.clone(), ("scan", HandlePose::targets(nothing))];
    let with = deformer.commit(changes, &exact(), &exec).expect("solved");
    assert_eq!(with.positions, without.positions);
    // Without targets they pull to rest.
    let held = deformer.commit([bent], &exact(), &exec).expect("solved");
    assert!(farthest(&held.positions, &without.positions) > 0.1);
}

#[test]
fn a_drag_takes_new_targets_and_weights_without_new_handles() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(tube(1), VolumeMode::Off, &exec);
    set_scan(&mut deformer, &[base()], 0.5, &exec);
    let whole = waved(&deformer);
    let expected = {
        let mut settings = exact();
        settings.quality.refine = Some(0);
        let changes = [("scan", HandlePose::targets(whole.clone()))];
        deformer.commit(changes, &settings, &exec).expect("solved")
    };
    let count = whole.positions.len();
    let mut drag = deformer.drag(&SolveSettings {
        quality: Quality {
            tolerance: Some(1e-9),
            refine: Some(0),
            ..Quality::DEFAULT
        },
        ..SolveSettings::default()
    });
    // Somewhere else first, with weights of 1.
    let far = VertexTargets::of(whole.positions.iter().map(|p| p.map(|v| v + 0.7)));
    drag.solve([("scan", HandlePose::targets(far))], &exec).expect("solved");
    let weights = VertexTargets::default().weighted(whole.weights.iter().copied());
    drag.solve([("scan", HandlePose::targets(weights))], &exec)
        .expect("solved");
    // Positions in two parts: weights stay.
    let half = count / 3;
    for (first, last) in [(half, count), (0, half)] {
        let part = VertexTargets {
            first: Some(first as u32),
            positions: whole.positions[first..last].to_vec(),
            ..VertexTargets::default()
        };
        drag.solve([("scan", HandlePose::targets(part))], &exec)
            .expect("solved");
    }
    let shape = drag.solve([], &exec).expect("solved");
    assert_eq!(drag.poses().0[1].targets.as_deref(), Some(&whole));
    let off = farthest(&shape.positions, &expected.positions) / deformer.diagonal();
    assert!(off < 1e-6, "off by {off} of the diagonal");
}

#[test]
fn moved_targets_move_the_shape_for_any_order_of_handles_and_number_of_threads() {
    let way = DVec3::new(8.0, -4.0, 16.0);
    let solved = |by: DVec3, threads: usize, turned: bool| {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let mut deformer = open(tube(2), VolumeMode::Off, &exec);
        let region = all(&deformer);
        let other = Handle::with_targets("other", Region::half_space([0.0, 0.0, 1.0], 2.05), 2.0);
        let mut handles = vec![Handle::with_targets("scan", region, 0.5), other];
        if turned {
            handles.reverse();
        }
        set(&mut deformer, handles, &exec);
        let moved = |t: VertexTargets| VertexTargets {
            positions: (t.positions.iter())
                .map(|p| (DVec3::from_array(p.map(f64::from)) + by).as_vec3().to_array())
                .collect(),
            ..t
        };
        let upper = deformer.rest().iter().filter(|p| p.z >= 2.05);
        let upper = VertexTargets::of(upper.map(|p| (*p + DVec3::X * 0.5).as_vec3().to_array()));
        let changes = [
            ("scan", HandlePose::targets(moved(waved(&deformer)))),
            ("other", HandlePose::targets(moved(upper))),
        ];
        let shape = deformer.commit(changes, &exact(), &exec).expect("solved");
        (shape.positions.to_vec(), deformer.diagonal())
    };
    let (here, diagonal) = solved(DVec3::ZERO, 1, false);
    for threads in 2..=4 {
        assert_eq!(solved(DVec3::ZERO, threads, false).0, here, "{threads} threads");
    }
    let (turned, _) = solved(DVec3::ZERO, 2, true);
    assert!(farthest(&turned, &here) < 1e-9 * diagonal);
    let (there, _) = solved(way, 2, false);
    let back: Vec<DVec3> = there.iter().map(|p| *p - way).collect();
    let off = farthest(&back, &here) / diagonal;
    // Targets are in single precision.
    assert!(off < 2e-6, "off by {off} of the diagonal");
}

#[test]
fn vertices_at_a_seam_have_the_mean_of_their_targets() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let (mut points, triangles) = shapes::grid(1.0, 1.0, [4, 4]);
    let mut model = model_of(&(points.clone(), triangles.clone()));
    let mut whole = open(model, VolumeMode::Off, &exec);
    set_scan(&mut whole, &[], 1.0, &exec);
    // The corner of the last triangle once more, as a seam has it.
    let mut cut = triangles;
    let corner = cut.last_mut().expect("triangles");
    let (twin, copy) = (corner[0], points.len() as u32);
    corner[0] = copy;
    points.push(points[twin as usize]);
    model = model_of(&(points, cut));
    let mut seamed = open(model, VolumeMode::Off, &exec);
    assert_eq!(seamed.rest().len(), whole.rest().len() + 1, "a seam");
    set_scan(&mut seamed, &[], 1.0, &exec);

    let mut targets = waved(&whole);
    let (k, at) = (twin as usize, targets.positions[twin as usize]);
    targets.weights[k] = 1.0;
    let mut split = targets.clone();
    // 3 to 1 about the same place.
    split.positions[k] = [at[0] + 0.25, at[1], at[2]];
    split.weights[k] = 1.5;
    split.positions.push([at[0] - 0.75, at[1], at[2]]);
    split.weights.push(0.5);
    let expected = commit(&mut whole, HandlePose::targets(targets), &exec);
    let shape = commit(&mut seamed, HandlePose::targets(split), &exec);
    assert_eq!(shape.positions[k], shape.positions[copy as usize]);
    assert!(farthest(&shape.positions[..copy as usize], &expected.positions) < 1e-6);
}

#[test]
fn stiffness_per_area_means_the_same_at_any_resolution() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    // How far the top of a wave of targets is reached.
    let reached = |fine: usize, per: StiffnessPer| {
        let (points, triangles) = shapes::grid(4.0, 4.0, [20 * fine, 20 * fine]);
        let mut deformer = open(model_of(&(points, triangles)), VolumeMode::Off, &exec);
        let scan = Handle {
            targets: Some(per),
            ..Handle::with_targets("scan", all(&deformer), 0.02)
        };
        set(&mut deformer, [scan], &exec);
        let rest = deformer.rest().to_vec();
        let size = rest.iter().fold(DVec3::ZERO, |a, p| a.max(p.abs()));
        let up = (0..3).find(|&k| size[k] == 0.0).expect("flat");
        let raised = |p: &DVec3| {
            let mut p = *p;
            p[up] += 0.2 * libm::cos(1.5 * p[(up + 1) % 3]) * libm::cos(1.5 * p[(up + 2) % 3]);
            p.as_vec3().to_array()
        };
        let targets = VertexTargets::of(rest.iter().map(raised));
        let shape = commit(&mut deformer, HandlePose::targets(targets), &exec);
        shape.positions.iter().map(|p| p[up].abs()).fold(0.0, f64::max)
    };
    let per_area = [1, 2].map(|fine| reached(fine, StiffnessPer::Area));
    let per_vertex = [1, 2].map(|fine| reached(fine, StiffnessPer::Vertex));
    let change = |[coarse, fine]: [f64; 2]| (fine / coarse - 1.0).abs();
    assert!(change(per_area) < 0.05, "{per_area:?}");
    assert!(
        change(per_vertex) > 2.0 * change(per_area),
        "{per_vertex:?} {per_area:?}"
    );
}

#[test]
fn what_does_not_fit_is_refused_with_its_field_and_changes_nothing() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(tube(1), VolumeMode::Off, &exec);
    let scan = Handle::with_targets("scan", all(&deformer), 1.0);
    let wrong = [
        Handle {
            stiffness: None,
            ..scan.clone()
        },
        Handle {
            constrains: HandleConstrains::ALL,
            ..scan.clone()
        },
        Handle {
            rigid: true,
            ..scan.clone()
        },
    ];
    for handle in wrong {
        match deformer.set_handles([handle], &exec) {
            Err(Error::Invalid { field, .. }) => assert_eq!(field, "handles[0].targets"),
            other => panic!("{other:?}"),
        }
    }
    set(&mut deformer, [base(), scan], &exec);
    let targets = waved(&deformer);
    let count = targets.positions.len();
    let short = VertexTargets::of(targets.positions[1..].iter().copied());
    let beyond = VertexTargets {
        first: Some(u32::MAX),
        ..short.clone()
    };
    let weights = VertexTargets::default().weighted(vec![1.0; count + 1]);
    for (id, pose, field) in [
        (
            "scan",
            HandlePose::targets(short),
            "pose.handles[0].pose.targets.positions",
        ),
        (
            "scan",
            HandlePose::targets(beyond),
            "pose.handles[0].pose.targets.positions",
        ),
        (
            "scan",
            HandlePose::targets(weights),
            "pose.handles[0].pose.targets.weights",
        ),
        ("scan", HandlePose::translation([1.0, 0.0, 0.0]), "pose.handles[0].pose"),
        (
            "base",
            HandlePose::targets(targets.clone()),
            "pose.handles[0].pose.targets",
        ),
    ] {
        match deformer.commit([(id, pose)], &SolveSettings::default(), &exec) {
            Err(Error::Invalid { field: f, .. }) => assert_eq!(f, field),
            other => panic!("{field}: {other:?}"),
        }
    }
    // With nothing else to hold it and weights of 0 the model has no place.
    set_scan(&mut deformer, &[], 1.0, &exec);
    let expected = commit(&mut deformer, HandlePose::targets(targets.clone()), &exec);
    let nothing = targets.clone().weighted(vec![0.0; count]);
    let refused = deformer.commit([("scan", HandlePose::targets(nothing))], &exact(), &exec);
    assert!(matches!(refused, Err(Error::Precondition(_))), "{refused:?}");
    assert_eq!(
        commit(&mut deformer, HandlePose::targets(targets), &exec).positions,
        expected.positions
    );
}
