//! Laws of symmetry: what is done to the whole scene is done to the result, and what says nothing new changes nothing.
//!
//! A scene is a mesh with handles and their transforms. Each law deforms it twice, as it is and changed, and compares
//! the mesh's vertices. Both may differ by what solving leaves, and with interior nodes by what rounding does to their places.

use crate::support::bench::largest_distance;
use glam::{DMat3, DQuat, DVec3};
use pliant::asset::shapes::box_with_cells;
use pliant::deform::{
    BodyOptions, DeformableBody, HandleConstraint, HandleSetup, HandleSystem, PoseRequest, Quality, SolveState,
    Transform, VolumeMode, exp_rotation, log_rotation,
};
use pliant::exec::Exec;
use pliant::mesh::Mesh;
use pliant::pool::Pool;
use pliant::progress::Silent;
use shapes::Shape;
use std::collections::BTreeMap;

use crate::support::shapes;

/// Largest difference on the mesh's own graph, as a fraction of the diagonal.
const SURFACE: f64 = 1e-5;
/// The same with interior nodes, whose lattice moves with the shape.
const VOLUME: f64 = 1e-4;

/// A region in the coordinates of the unmoved scene, and what its handle does there.
#[derive(Clone, Copy)]
struct Handle {
    region: fn(DVec3) -> bool,
    transform: Transform,
}

/// Where everything in a scene is taken: turned or mirrored, then scaled, then shifted.
#[derive(Clone, Copy)]
struct Place {
    linear: DMat3,
    scale: f64,
    shift: DVec3,
}

const HOME: Place = Place {
    linear: DMat3::IDENTITY,
    scale: 1.0,
    shift: DVec3::ZERO,
};

impl Place {
    fn turned(rotation: DVec3, scale: f64, shift: DVec3) -> Self {
        Self {
            linear: DMat3::from_quat(exp_rotation(rotation)),
            scale,
            shift,
        }
    }

    fn mirrored(normal: DVec3) -> Self {
        let reflect = |v: DVec3| v - normal * (2.0 * normal.dot(v));
        Self {
            linear: DMat3::from_cols(reflect(DVec3::X), reflect(DVec3::Y), reflect(DVec3::Z)),
            ..HOME
        }
    }

    fn of(&self, p: DVec3) -> DVec3 {
        self.linear * p * self.scale + self.shift
    }

    fn back(&self, p: DVec3) -> DVec3 {
        self.linear.transpose() * (p - self.shift) / self.scale
    }

    /// The same motion seen from here.
    fn transform(&self, t: &Transform) -> Transform {
        // A rotation vector is axial: a mirror turns it round.
        let axial = self.linear.determinant().signum();
        Transform {
            translation: self.linear * t.translation * self.scale,
            rotation: self.linear * t.rotation * axial,
            log_scale: self.linear * t.log_scale * self.linear.transpose(),
            pivot: self.of(t.pivot),
        }
    }
}

fn hold(body: &DeformableBody, place: &Place, region: fn(DVec3) -> bool) -> HandleConstraint {
    let at = |n: u32| place.back(body.graph.positions[n as usize]);
    HandleConstraint {
        nodes: (0..body.nodes() as u32).filter(|&n| region(at(n))).collect(),
        position: true,
        rotation: true,
        scale: true,
        ..HandleConstraint::default()
    }
}

/// The deformed vertices of the scene when it stands at `place`, brought back home, in diagonals.
fn deformed(shape: &Shape, handles: &[Handle], place: &Place, volume: VolumeMode, refine: u32) -> Vec<DVec3> {
    let pool = Pool::new(2).expect("threads start");
    let mesh: Mesh = shapes::mesh(&shapes::moved(shape.clone(), |p| place.of(p)));
    let options = BodyOptions {
        volume,
        ..BodyOptions::default()
    };
    let body = DeformableBody::build(&mesh, &options, &Exec::new(&pool, &Silent)).expect("a body");
    let interior = body.nodes() > body.graph.surface;
    assert_eq!(interior, volume != VolumeMode::Off, "the shape has an inside");
    let rigging = HandleSetup {
        handles: handles.iter().map(|h| hold(&body, place, h.region)).collect(),
        ..HandleSetup::default()
    };
    assert!(
        rigging.handles.iter().all(|h| !h.nodes.is_empty()),
        "each handle holds something"
    );
    let rig = HandleSystem::build(&body, rigging, &Exec::new(&pool, &Silent)).expect("a rig");
    let transforms: Vec<Transform> = handles.iter().map(|h| place.transform(&h.transform)).collect();
    let quality = Quality {
        tolerance: Some(1e-9),
        refine: Some(refine),
        ..Quality::default()
    };
    let request = PoseRequest::new(&transforms, quality);
    let (mut state, exec) = (SolveState::default(), Exec::new(&pool, &Silent));
    let solution = rig
        .solve(&body, &request, &mut state, &exec, &mut |_| true)
        .expect("it solves");
    // Of the scene at home: a box around a model that is turned is another box.
    let diagonal = shapes::mesh(shape).bounds().diagonal();
    let vertices = solution.positions[..body.graph.surface].iter();
    vertices.map(|&p| place.back(p) / diagonal).collect()
}

fn root_mean_square(a: &[DVec3], b: &[DVec3]) -> f64 {
    let squares: f64 = a.iter().zip(b).map(|(a, b)| a.distance_squared(*b)).sum();
    (squares / a.len() as f64).sqrt()
}

/// A closed shape without any symmetry, 4 long: a rod that bends, thickens and has a bump. Vertices are scattered a
/// little, so that no two places are equally near to anything: which is taken must not depend on rounding.
fn rod() -> Shape {
    let mut random = 12345u64;
    let mut scatter = || {
        random = random
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        ((random >> 40) as f64 / (1u64 << 24) as f64 - 0.5) * 0.02
    };
    shapes::moved(shapes::cube(6), |p| {
        let (x, y, z) = (p.x * 0.5, p.y * 0.4, p.z * 2.0);
        let bump = libm::exp(-(z - 0.4) * (z - 0.4) * 4.0) * 0.2;
        let smooth = DVec3::new(
            x * (1.0 + 0.1 * z + bump) + 0.15 * libm::sin(z),
            y * (1.0 + bump * x) + 0.03 * z * z,
            z,
        );
        smooth + DVec3::new(scatter(), scatter(), scatter())
    })
}

fn low(p: DVec3) -> bool {
    p.z < -1.6
}

fn high(p: DVec3) -> bool {
    p.z > 1.55
}

/// One end stays, the other is bent, twisted, shifted and grows a little.
fn ends() -> [Handle; 2] {
    let turn = exp_rotation(DVec3::Z * 0.9) * exp_rotation(DVec3::new(0.8, 0.3, 0.0));
    [
        Handle {
            region: low,
            transform: Transform::IDENTITY,
        },
        Handle {
            region: high,
            transform: Transform {
                translation: DVec3::new(0.5, 0.9, -0.5),
                rotation: log_rotation(turn),
                log_scale: DMat3::from_diagonal(DVec3::splat(0.15)),
                pivot: DVec3::new(0.1, 0.2, 1.8),
            },
        },
    ]
}

/// Surface and volume graph, without and with refinement, and what each may differ by.
const CASES: [(VolumeMode, u32, f64); 4] = [
    (VolumeMode::Off, 0, SURFACE),
    (VolumeMode::Off, 3, SURFACE),
    (VolumeMode::Required, 0, VOLUME),
    (VolumeMode::Required, 3, VOLUME),
];

/// Deforms the scene at home and elsewhere, and compares.
fn same_at(places: &[Place]) {
    let (rod, ends) = (rod(), ends());
    for (volume, refine, allowed) in CASES {
        let home = deformed(&rod, &ends, &HOME, volume, refine);
        assert!(
            largest_distance(&home, &deformed_not(&rod)) > 0.1,
            "the pose moves the model by more than any tolerance"
        );
        for (k, place) in places.iter().enumerate() {
            let there = deformed(&rod, &ends, place, volume, refine);
            let (seen, mean) = (largest_distance(&home, &there), root_mean_square(&home, &there));
            println!("{volume:?}, refine {refine}, place {k}: largest {seen:.1e}, root mean square {mean:.1e}");
            assert!(
                seen <= allowed,
                "{volume:?}, refine {refine}, place {k}: {seen:e}, {mean:e}"
            );
        }
    }
}

/// The vertices in the rest pose, in diagonals.
fn deformed_not(shape: &Shape) -> Vec<DVec3> {
    let mesh = shapes::mesh(shape);
    let diagonal = mesh.bounds().diagonal();
    mesh.positions.iter().map(|p| *p / diagonal).collect()
}

#[test]
fn shifting_the_scene_shifts_the_result() {
    same_at(&[
        Place {
            shift: DVec3::new(3.3, -0.7, 12.1),
            ..HOME
        },
        Place {
            shift: DVec3::new(-1e4, 2e4, 512.25),
            ..HOME
        },
    ]);
}

#[test]
fn turning_the_scene_turns_the_result() {
    same_at(&[
        Place::turned(DVec3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2), 1.0, DVec3::ZERO),
        Place::turned(DVec3::new(0.4, -1.1, 2.0), 1.0, DVec3::ZERO),
    ]);
}

#[test]
fn scaling_the_scene_scales_the_result() {
    let scaled = |scale: f64| Place { scale, ..HOME };
    same_at(&[scaled(1e-3), scaled(3.7), scaled(1e6)]);
}

#[test]
fn doing_all_of_it_does_all_of_it() {
    same_at(&[Place::turned(
        DVec3::new(-2.0, 0.3, 0.9),
        0.031,
        DVec3::new(5.0, 6.0, -70.0),
    )]);
}

#[test]
fn a_mirrored_scene_gives_the_mirrored_result() {
    same_at(&[
        Place::mirrored(DVec3::X),
        Place::mirrored(DVec3::new(2.0, -1.0, 2.0) / 3.0),
    ]);
}

/// A brick around the origin that is its own mirror image in x and in z: its squares are split by both diagonals. Places are of single
/// precision, as those of most files.
fn mirrored_brick() -> Shape {
    let size = DVec3::new(1.0, 2.0, 0.6);
    let (points, faces) = box_with_cells(size, [12, 12, 12]);
    let mut points: Vec<DVec3> = points.iter().map(|p| (*p - size * 0.5).as_vec3().as_dvec3()).collect();
    let mut split = Vec::new();
    for pair in faces.chunks_exact(2) {
        let [a, b, c, d] = [pair[0][0], pair[0][1], pair[0][2], pair[1][2]];
        let middle = points.len() as u32;
        points.push([a, b, c, d].iter().map(|&v| points[v as usize]).sum::<DVec3>() * 0.25);
        split.extend([[a, b, middle], [b, c, middle], [c, d, middle], [d, a, middle]]);
    }
    (points, split)
}

#[test]
fn a_body_that_is_its_own_mirror_image_keeps_it() {
    let brick = mirrored_brick();
    let handle = |region, translation| Handle {
        region,
        transform: Transform {
            translation,
            ..Transform::IDENTITY
        },
    };
    let ends = [
        handle(|p| p.y < -0.8, DVec3::ZERO),
        handle(|p| p.y > 0.8, DVec3::new(0.0, 0.8, 0.0)),
    ];
    let key = |p: DVec3| (p * 1e4).round().to_array().map(|x| x as i64);
    let number: BTreeMap<[i64; 3], usize> = brick.0.iter().map(|p| key(*p)).zip(0..).collect();
    let shape = deformed(&brick, &ends, &HOME, VolumeMode::Required, 4);
    for mirror in [DVec3::new(-1.0, 1.0, 1.0), DVec3::new(1.0, 1.0, -1.0)] {
        let image = |p: &DVec3| shape[number[&key(*p * mirror)]] * mirror;
        let image: Vec<DVec3> = brick.0.iter().map(image).collect();
        let seen = largest_distance(&shape, &image);
        assert!(seen <= SURFACE, "{mirror}: {seen:e}");
    }
}

#[test]
fn winding_the_faces_the_other_way_changes_nothing() {
    let (rod, ends) = (rod(), ends());
    for (volume, refine, allowed) in CASES {
        let one = deformed(&rod, &ends, &HOME, volume, refine);
        let other = deformed(&shapes::inside_out(rod.clone()), &ends, &HOME, volume, refine);
        let seen = largest_distance(&one, &other);
        assert!(seen <= allowed, "{volume:?}, refine {refine}: {seen:e}");
    }
}

#[test]
fn renumbering_vertices_and_faces_changes_nothing() {
    let (rod, ends) = (rod(), ends());
    let count = rod.0.len();
    // A step without a common factor with the count visits each vertex once, in an order that has nothing of the old.
    let step = (count * 7 / 19..)
        .find(|s| gcd(*s, count) == 1)
        .expect("a prime comes soon");
    let old_of_new: Vec<usize> = (0..count).map(|k| (k * step + 5) % count).collect();
    let mut new_of_old = vec![0u32; count];
    old_of_new
        .iter()
        .zip(0u32..)
        .for_each(|(&old, new)| new_of_old[old] = new);
    let mut faces: Vec<[u32; 3]> = rod.1.iter().map(|t| t.map(|v| new_of_old[v as usize])).collect();
    faces.reverse();
    faces.iter_mut().step_by(3).for_each(|t| t.rotate_left(1));
    let shuffled: Shape = (old_of_new.iter().map(|&old| rod.0[old]).collect(), faces);
    for (volume, refine, allowed) in CASES {
        let home = deformed(&rod, &ends, &HOME, volume, refine);
        let there = deformed(&shuffled, &ends, &HOME, volume, refine);
        let sorted: Vec<DVec3> = (0..count).map(|old| there[new_of_old[old] as usize]).collect();
        let seen = largest_distance(&home, &sorted);
        assert!(seen <= allowed, "{volume:?}, refine {refine}: {seen:e}");
    }
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[test]
fn an_unmoved_handle_far_away_changes_nothing() {
    // What lies below the held middle does not move, and holding some of it says nothing new.
    fn middle(p: DVec3) -> bool {
        (-1.0..-0.3).contains(&p.z)
    }
    fn bottom(p: DVec3) -> bool {
        p.z < -1.8
    }
    let rod = rod();
    let held = |region| Handle {
        region,
        transform: Transform::IDENTITY,
    };
    let two = [held(middle), ends()[1]];
    for (volume, refine, allowed) in CASES {
        let rest = deformed(&rod, &two, &HOME, volume, refine);
        for three in [[two[0], two[1], held(bottom)], [held(bottom), two[0], two[1]]] {
            let seen = largest_distance(&rest, &deformed(&rod, &three, &HOME, volume, refine));
            assert!(seen <= allowed.min(SURFACE), "{volume:?}, refine {refine}: {seen:e}");
        }
    }
}

#[test]
fn an_unmoved_handle_on_another_part_changes_nothing() {
    fn aside(p: DVec3) -> bool {
        p.x > 5.0
    }
    let rod = rod();
    let vertices = rod.0.len();
    let scene = shapes::both(
        rod,
        shapes::moved(shapes::cube(3), |p| p * 0.3 + DVec3::new(7.0, 0.0, 0.0)),
    );
    let [base, top] = ends();
    let extra = Handle {
        region: aside,
        transform: Transform::IDENTITY,
    };
    for (volume, refine, allowed) in CASES {
        let rest = deformed(&scene, &[base, top], &HOME, volume, refine);
        let held = deformed(&scene, &[base, top, extra], &HOME, volume, refine);
        let seen = largest_distance(&rest[..vertices], &held[..vertices]);
        assert!(seen <= allowed.min(SURFACE), "{volume:?}, refine {refine}: {seen:e}");
        let at_rest = deformed_not(&scene);
        assert_eq!(held[vertices..], at_rest[vertices..], "what is held at rest stays");
    }
}

#[test]
fn a_rigid_motion_of_all_handles_moves_the_model_rigidly() {
    let (rod, [base, top]) = (rod(), ends());
    let motion = Transform {
        translation: DVec3::new(1.0, -2.0, 0.5),
        rotation: DVec3::new(0.3, -0.6, 1.0),
        log_scale: DMat3::ZERO,
        pivot: DVec3::new(0.5, 0.0, 1.0),
    };
    let turn = DQuat::from_scaled_axis(motion.rotation);
    let handles = [base, top].map(|h| Handle { transform: motion, ..h });
    for (volume, refine, _) in CASES {
        let seen = deformed(&rod, &handles, &HOME, volume, refine);
        let diagonal = shapes::mesh(&rod).bounds().diagonal();
        let expected: Vec<DVec3> = rod
            .0
            .iter()
            .map(|&p| (turn * (p - motion.pivot) + motion.pivot + motion.translation) / diagonal)
            .collect();
        let off = largest_distance(&seen, &expected);
        assert!(off <= SURFACE, "{volume:?}, refine {refine}: {off:e}");
    }
}
