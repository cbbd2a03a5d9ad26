//! Targets of points inside triangles, and targets that are planes.

use glam::{DQuat, DVec3};
use pliant_core::asset::{FileSet, shapes};
use pliant_core::deform::VolumeMode;
use pliant_core::engine::{
    Anchor, AnchorCorners, Deformer, DeformerLimits, Edit, Error, Handle, HandlePose, ModelShape, OpenOptions, Quality,
    Region, SolveSettings, StiffnessPer, VertexRange, VertexTargets,
};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

type Triangles = (Vec<DVec3>, Vec<[u32; 3]>);

fn open((points, triangles): &Triangles, exec: &Exec<'_>) -> Deformer {
    let mut text = String::new();
    for p in points {
        let p = p.as_vec3();
        text += &format!("v {} {} {}\n", p.x, p.y, p.z);
    }
    for [a, b, c] in triangles {
        text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
    }
    let mut options = OpenOptions::default();
    options.body.volume = VolumeMode::Off;
    let files = FileSet::single("model.obj", text);
    Deformer::open(files, &options, &DeformerLimits::default(), exec).expect("a model")
}

fn tube(fine: usize) -> Triangles {
    shapes::cylinder(0.5, 4.0, 12 * fine, 24 * fine, true)
}

fn all(deformer: &Deformer) -> Region {
    let count = deformer.rest().len() as u32;
    Region::Vertices {
        indices: Vec::new(),
        ranges: vec![VertexRange { first: 0, count }],
    }
}

fn exact() -> SolveSettings {
    let mut settings = SolveSettings::default();
    settings.quality = Quality {
        tolerance: Some(1e-9),
        ..settings.quality
    };
    settings
}

fn commit(deformer: &mut Deformer, targets: VertexTargets, exec: &Exec<'_>) -> ModelShape {
    let changes = [("scan", HandlePose::targets(targets))];
    deformer.commit(changes, &exact(), exec).expect("solved")
}

/// As points are solved for, until nothing moves.
fn settled(deformer: &mut Deformer, targets: VertexTargets, exec: &Exec<'_>) -> ModelShape {
    let mut settings = exact();
    settings.quality.refine = Some(300);
    let changes = [("scan", HandlePose::targets(targets))];
    deformer.commit(changes, &settings, exec).expect("solved")
}

fn farthest(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

fn single(p: DVec3) -> [f32; 3] {
    p.as_vec3().to_array()
}

/// A point in every `step`th triangle of a model.
fn landmarks(triangles: &[[u32; 3]], step: usize) -> Vec<Anchor> {
    let faces = (0..triangles.len() as u32).step_by(step);
    let anchor = |face: u32| Anchor {
        corners: AnchorCorners::Face(face),
        weights: [[0.5, 0.25, 0.25], [0.125, 0.5, 0.375], [0.25, 0.0, 0.75]][face as usize % 3],
    };
    faces.map(anchor).collect()
}

fn place_of(anchor: &Anchor, triangles: &[[u32; 3]], positions: &[DVec3]) -> DVec3 {
    let corners = match anchor.corners {
        AnchorCorners::Face(face) => triangles[face as usize],
        AnchorCorners::Vertices(corners) => corners,
    };
    let corners = corners.iter().zip(anchor.weights);
    corners.map(|(v, w)| positions[*v as usize] * f64::from(w)).sum()
}

#[test]
fn anchors_pull_the_points_inside_triangles_and_nothing_else_of_them() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let model = tube(1);
    let mut deformer = open(&model, &exec);
    let anchors = landmarks(&model.1, 37);
    let scan = Handle::with_targets("scan", Region::Anchors(anchors.clone()), 5.0);
    deformer.set_handles([scan], &exec).expect("right handles");
    assert_eq!(deformer.facts().handles[0].vertices as usize, anchors.len());

    // Where they ask for a turn and a shift the shape is exactly that, wherever in their triangles they are.
    let (turn, by) = (DQuat::from_rotation_x(0.9), DVec3::new(1.0, 0.5, -2.0));
    let rest = deformer.rest().to_vec();
    let moved = |p: DVec3| turn * p + by;
    let targets = VertexTargets::of(anchors.iter().map(|a| single(moved(place_of(a, &model.1, &rest)))));
    let shape = commit(&mut deformer, targets, &exec);
    let expected: Vec<DVec3> = rest.iter().map(|p| moved(*p)).collect();
    let off = farthest(&shape.positions, &expected) / deformer.diagonal();
    assert!(off < 2e-5, "off by {off} of the diagonal");

    // Where they ask for a bend, stiff ones get it.
    let bent = |p: DVec3| p + DVec3::X * 0.1 * p.z * p.z;
    let stiff = Handle::with_targets("scan", Region::Anchors(anchors.clone()), 1000.0);
    deformer.set_handles([stiff], &exec).expect("right handles");
    let wanted: Vec<DVec3> = anchors.iter().map(|a| bent(place_of(a, &model.1, &rest))).collect();
    let shape = commit(
        &mut deformer,
        VertexTargets::of(wanted.iter().map(|p| single(*p))),
        &exec,
    );
    let there: Vec<DVec3> = anchors
        .iter()
        .map(|a| place_of(a, &model.1, &shape.positions))
        .collect();
    let off = farthest(&there, &wanted) / deformer.diagonal();
    assert!(off < 2e-3, "off by {off} of the diagonal");
}

#[test]
fn anchors_at_corners_are_vertices() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let model = tube(1);
    let mut deformer = open(&model, &exec);
    let rest = deformer.rest().to_vec();
    let numbers: Vec<u32> = (0..rest.len() as u32).step_by(5).collect();
    let wanted = |&v: &u32| {
        let p = rest[v as usize];
        single(p + DVec3::new(0.3 * libm::sin(p.z), 0.1 * p.z, 0.0))
    };
    let targets = VertexTargets::of(numbers.iter().map(wanted)).weighted(numbers.iter().map(|v| (v % 3) as f32));
    let region = Region::vertices(numbers.iter().copied());
    deformer
        .set_handles([Handle::with_targets("scan", region, 0.7)], &exec)
        .expect("right");
    let expected = settled(&mut deformer, targets.clone(), &exec);
    let anchor = |&v: &u32| Anchor {
        corners: AnchorCorners::Vertices([(v + 1) % 20, v, (v + 7) % 20]),
        weights: [0.0, 1.0, 0.0],
    };
    let region = Region::Anchors(numbers.iter().map(anchor).collect());
    deformer
        .set_handles([Handle::with_targets("scan", region, 0.7)], &exec)
        .expect("right");
    let shape = settled(&mut deformer, targets, &exec);
    let off = farthest(&shape.positions, &expected.positions) / deformer.diagonal();
    let moved = farthest(&shape.positions, &rest) / deformer.diagonal();
    assert!(
        moved > 0.03 && off < 0.001 * moved,
        "off by {off}, moved by {moved} of the diagonal"
    );
}

#[test]
fn tangential_targets_let_a_plate_slide_in_its_plane() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (points, triangles) = shapes::grid(4.0, 4.0, [16, 16]);
    let points: Vec<DVec3> = points
        .iter()
        .map(|p| DVec3::from_array([p.x, p.z + p.y, 0.0]))
        .collect();
    let mut deformer = open(&(points, triangles.clone()), &exec);
    let rest = deformer.rest().to_vec();
    let mut solved = |tangential: f64, shift: DVec3, normal: Option<DVec3>| {
        let scan = Handle {
            tangential,
            ..Handle::with_targets("scan", all(&deformer), 2.0)
        };
        deformer.set_handles([scan], &exec).expect("right handles");
        // Straight up to a slope: a plate that stays under its targets is stretched by 12 %.
        let targets = VertexTargets::of(rest.iter().map(|p| single(*p + DVec3::Z * (0.5 * p.x + 0.2) + shift)));
        let targets = match normal {
            Some(normal) => targets.across(rest.iter().map(|_| single(normal))),
            None => targets,
        };
        match tangential > 0.0 && normal != Some(DVec3::ZERO) {
            true => commit(&mut deformer, targets, &exec).positions.to_vec(),
            false => settled(&mut deformer, targets, &exec).positions.to_vec(),
        }
    };
    let normal = DVec3::new(-0.5, 0.0, 1.0);
    let stretch = |shape: &[DVec3]| {
        let edges = triangles.iter().flat_map(|[a, b, c]| [(*a, *b), (*b, *c), (*c, *a)]);
        let edges = edges.map(|(a, b)| (a as usize, b as usize));
        edges
            .map(|(a, b)| (shape[a].distance(shape[b]) / rest[a].distance(rest[b]) - 1.0).abs())
            .fold(0.0, f64::max)
    };
    let above = |shape: &[DVec3]| {
        let heights = shape.iter().map(|p| (p.z - 0.5 * p.x - 0.2).abs());
        heights.fold(0.0, f64::max)
    };
    let stuck = solved(0.0, DVec3::ZERO, Some(normal).filter(|_| false));
    assert!(stretch(&stuck) > 0.05, "{}", stretch(&stuck));
    let free = solved(1.0, DVec3::ZERO, Some(normal));
    assert!(stretch(&free) < 5e-3, "{}", stretch(&free));
    assert!(above(&free) < 5e-3, "{}", above(&free));
    // Along the plane targets may be anywhere.
    let shifted = solved(1.0, DVec3::new(2.0, 1.0, 1.0), Some(normal * 7.0));
    assert!(farthest(&shifted, &free) < 1e-4, "{}", farthest(&shifted, &free));
    // The surface of the targets has the same normals.
    let own = solved(1.0, DVec3::ZERO, None);
    assert!(farthest(&own, &free) < 1e-4, "{}", farthest(&own, &free));
    let half = solved(0.5, DVec3::ZERO, Some(normal));
    assert!(stretch(&half) > 2.0 * stretch(&free) && stretch(&half) < stretch(&stuck));
    // Without a normal a vertex is wanted at its target.
    let none = solved(1.0, DVec3::ZERO, Some(DVec3::ZERO));
    assert!(farthest(&none, &stuck) < 1e-3, "{}", farthest(&none, &stuck));
    // However stiff the planes are, they hold nothing along them.
    let stiff = Handle {
        tangential: 1.0,
        ..Handle::with_targets("scan", all(&deformer), 100.0)
    };
    deformer.set_handles([stiff], &exec).expect("right handles");
    let targets = VertexTargets::of(rest.iter().map(|p| single(*p + DVec3::Z * (0.5 * p.x + 0.2))));
    let targets = targets.across(rest.iter().map(|_| single(normal)));
    let rigid = commit(&mut deformer, targets, &exec).positions;
    assert!(stretch(&rigid) < 5e-3, "{}", stretch(&rigid));
    assert!(above(&rigid) < 5e-3, "{}", above(&rigid));
}

#[test]
fn a_finer_surface_takes_the_same_shape_where_stiffness_is_per_area() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let wanted = |p: &DVec3| single(*p + DVec3::new(0.3 * libm::sin(1.5 * p.z), 0.1 * libm::cos(p.z), 0.0));
    let solved = |fine: usize, per: StiffnessPer, stiffness: f64| {
        let model = tube(fine);
        let mut deformer = open(&model, &exec);
        let scan = Handle {
            targets: Some(per),
            ..Handle::with_targets("scan", all(&deformer), stiffness)
        };
        deformer.set_handles([scan], &exec).expect("right handles");
        let targets = VertexTargets::of(deformer.rest().iter().map(wanted));
        let shape = commit(&mut deformer, targets, &exec);
        (deformer.rest().to_vec(), shape.positions.to_vec(), deformer.diagonal())
    };
    // Largest distance of the vertices that both have, of the diagonal.
    let apart = |per: StiffnessPer, stiffness: f64| {
        let (coarse_rest, coarse, diagonal) = solved(2, per, stiffness);
        let (fine_rest, fine, _) = solved(4, per, stiffness);
        let mut shared = 0;
        let mut most = 0.0f64;
        for (rest, now) in coarse_rest.iter().zip(&coarse) {
            if let Some(k) = fine_rest.iter().position(|p| p.distance(*rest) < 1e-5 * diagonal) {
                shared += 1;
                most = most.max(fine[k].distance(*now) / diagonal);
            }
        }
        assert!(shared > coarse.len() / 2, "{shared} of {}", coarse.len());
        most
    };
    let (area, vertex) = (apart(StiffnessPer::Area, 0.02), apart(StiffnessPer::Vertex, 0.02));
    assert!(area < 3e-3, "{area} {vertex}");
    assert!(vertex > 3.0 * area, "{area} {vertex}");
}

#[test]
fn anchors_outlive_edits_by_their_corners() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let model = tube(1);
    let mut deformer = open(&model, &exec);
    let anchors = landmarks(&model.1, 29);
    let places: Vec<DVec3> = anchors.iter().map(|a| place_of(a, &model.1, deformer.rest())).collect();
    let handles = [Handle::with_targets("scan", Region::Anchors(anchors), 1.0)];
    deformer.set_handles(handles, &exec).expect("right handles");
    let above = Region::half_space([0.0, 0.0, 1.0], 1.0);
    let edit = Edit::Delete {
        region: above,
        fill: false,
    };
    deformer.edit_rest(&edit, &exec).expect("edited");
    let Region::Anchors(left) = &deformer.handles().handles[0].region else {
        panic!("no anchors any more");
    };
    let rest = deformer.rest().to_vec();
    let now: Vec<DVec3> = left.iter().map(|a| place_of(a, &[], &rest)).collect();
    assert!(!now.is_empty() && now.len() < places.len());
    for place in now {
        assert!(places.iter().any(|p| p.distance(place) < 1e-5), "{place}");
    }
}

#[test]
fn what_does_not_fit_a_point_is_refused_with_its_field() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let model = tube(1);
    let mut deformer = open(&model, &exec);
    let anchor = |corners: AnchorCorners| {
        let weights = [1.0, 0.0, 0.0];
        Handle::with_targets("scan", Region::Anchors(vec![Anchor { corners, weights }]), 1.0)
    };
    let refused = |deformer: &mut Deformer, handle: Handle, expected: &str| match deformer.set_handles([handle], &exec)
    {
        Err(Error::Invalid { field, .. }) => assert_eq!(field, expected),
        other => panic!("{expected}: {other:?}"),
    };
    let faces = model.1.len() as u32;
    refused(
        &mut deformer,
        anchor(AnchorCorners::Face(faces)),
        "handles[0].region.anchors.faces[0]",
    );
    let beyond = AnchorCorners::Vertices([0, 1, 100_000]);
    refused(&mut deformer, anchor(beyond), "handles[0].region.anchors.corners[2]");
    let plain = Handle {
        tangential: 0.5,
        ..Handle::new("plain", all(&deformer))
    };
    refused(&mut deformer, plain, "handles[0].targets.tangential");

    let tangential = Handle {
        tangential: 1.0,
        ..anchor(AnchorCorners::Face(3))
    };
    deformer
        .set_handles([tangential, Handle::with_targets("all", all(&deformer), 1.0)], &exec)
        .expect("right");
    let refused = |id: &str, targets: VertexTargets, expected: &str| {
        let changes = [(id, HandlePose::targets(targets))];
        match deformer.change_poses(&deformer.initial_poses(), changes) {
            Err(Error::Invalid { field, .. }) => assert_eq!(field, expected),
            other => panic!("{expected}: {other:?}"),
        }
    };
    let one = VertexTargets::of([[0.0; 3]]);
    refused("scan", one.clone(), "pose.handles[0].pose.targets.normals");
    refused(
        "scan",
        one.clone().across([[1.0; 3]; 2]),
        "pose.handles[0].pose.targets.normals",
    );
    refused(
        "all",
        VertexTargets::default().across([[1.0; 3]]),
        "pose.handles[0].pose.targets.normals",
    );
}
