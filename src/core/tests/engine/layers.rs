//! Layers: what lies outside of another part in the rest pose stays outside.

use glam::DVec3;
use pliant_core::asset::{FileSet, shapes};
use pliant_core::engine::{
    Contact, Deformer, DeformerLimits, Handle, HandlePose, ModelShape, OpenOptions, Region, SolveSettings,
};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

type Surface = (Vec<DVec3>, Vec<[u32; 3]>);

fn file_of(parts: &[Surface]) -> FileSet {
    let (mut points, mut triangles) = (String::new(), String::new());
    let (mut shift, mut faces) = (0, 0);
    for (own, corners) in parts {
        own.iter()
            .for_each(|p| points += &format!("{} {} {}\n", p.x as f32, p.y as f32, p.z as f32));
        corners
            .iter()
            .for_each(|[a, b, c]| triangles += &format!("3 {} {} {}\n", a + shift, b + shift, c + shift));
        shift += own.len() as u32;
        faces += corners.len();
    }
    FileSet::single("layers.off", format!("OFF\n{shift} {faces} 0\n{points}{triangles}"))
}

fn moved(mut surface: Surface, by: DVec3) -> Surface {
    surface.0.iter_mut().for_each(|p| *p += by);
    surface
}

/// The part of a surface whose corners all are wanted.
fn cut(surface: &Surface, wanted: impl Fn(DVec3) -> bool) -> Surface {
    let mut number = vec![u32::MAX; surface.0.len()];
    let mut points = Vec::new();
    let kept = surface
        .1
        .iter()
        .filter(|t| t.iter().all(|v| wanted(surface.0[*v as usize])));
    let kept: Vec<[u32; 3]> = kept.copied().collect();
    let triangles = kept.iter().map(|t| {
        t.map(|v| {
            if number[v as usize] == u32::MAX {
                number[v as usize] = points.len() as u32;
                points.push(surface.0[v as usize]);
            }
            number[v as usize]
        })
    });
    let triangles = triangles.collect();
    (points, triangles)
}

fn shape(deformer: &mut Deformer, handle: &str, pose: HandlePose, contact: Contact, exec: &Exec<'_>) -> ModelShape {
    let settings = SolveSettings {
        contact,
        ..SolveSettings::default()
    };
    deformer.commit([(handle, pose)], &settings, exec).expect("a shape")
}

fn new_pairs(deformer: &Deformer, shape: &ModelShape, exec: &Exec<'_>) -> u64 {
    deformer
        .crossing_pairs(&shape.positions, 0, exec)
        .expect("no cancel")
        .new
}

const AVOIDED: Contact = Contact::Avoided { clearance: None };

#[test]
fn a_sleeve_on_a_bent_arm_stays_outside_where_the_crease_has_room() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let arm = shapes::cylinder(0.5, 6.0, 32, 60, true);
    let sleeve = moved(shapes::cylinder(0.53, 3.0, 40, 36, false), DVec3::Z * 1.5);
    let ends = |wanted: &dyn Fn(f64) -> bool| {
        let all = arm.0.iter().enumerate().filter(|(_, p)| wanted(p.z));
        Region::vertices(all.map(|(v, _)| v as u32).collect::<Vec<_>>())
    };
    let handles = [
        Handle::new("upper", ends(&|z| z < 2.25)),
        Handle::new("fore", ends(&|z| z > 3.75)),
    ];
    let files = file_of(&[arm.clone(), sleeve]);
    let mut deformer =
        Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec).expect("a model");
    deformer.set_handles(handles.to_vec(), &exec).expect("right handles");
    let mut crossed = 0;
    for (degrees, part) in [(110.0f64, 0), (120.0, 6)] {
        let bend = || HandlePose::rotation(DVec3::X * degrees.to_radians()).about(DVec3::Z * 3.0);
        let without = shape(&mut deformer, "fore", bend(), Contact::Ignored, &exec);
        let with = shape(&mut deformer, "fore", bend(), AVOIDED, &exec);
        crossed += new_pairs(&deformer, &without, &exec);
        let left = new_pairs(&deformer, &with, &exec);
        // Of a crease as deep as the arm is thick a sixth may be left.
        assert!(
            left * part.max(1) <= new_pairs(&deformer, &without, &exec),
            "{degrees} degrees: {left}"
        );
        assert!(part > 0 || left == 0, "{degrees} degrees: {left}");
    }
    assert!(crossed > 100, "{crossed}");
}

#[test]
fn a_cap_stays_over_the_ball_that_is_pulled_through_it() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let ball = shapes::icosphere(1.0, 4);
    let cap = cut(&shapes::icosphere(1.05, 4), |p| p.z > 0.0);
    let of_ball = ball.0.len() as u32;
    let own = |surface: &Surface, first: u32, wanted: &dyn Fn(DVec3) -> bool| {
        let all = (first..).zip(&surface.0).filter(|(_, p)| wanted(**p));
        Region::vertices(all.map(|(v, _)| v).collect::<Vec<_>>())
    };
    let handles = [
        Handle::new("base", own(&ball, 0, &|p| p.z < -0.3)),
        Handle::new("rim", own(&cap, of_ball, &|p| p.z < 0.12)),
        Handle::new("top", own(&ball, 0, &|p| p.z > 0.95)),
    ];
    let mut options = OpenOptions::default();
    options.body.ties = None;
    let mut deformer = Deformer::open(
        file_of(&[ball.clone(), cap]),
        &options,
        &DeformerLimits::default(),
        &exec,
    )
    .expect("a model");
    deformer.set_handles(handles.to_vec(), &exec).expect("right handles");
    for by in [0.2, 0.3] {
        let pull = || HandlePose::translation(DVec3::Z * by);
        let without = shape(&mut deformer, "top", pull(), Contact::Ignored, &exec);
        let with = shape(&mut deformer, "top", pull(), AVOIDED, &exec);
        assert!(new_pairs(&deformer, &without, &exec) > 20, "{by}");
        assert_eq!(new_pairs(&deformer, &with, &exec), 0, "{by}");
        let top = |shape: &ModelShape| {
            let cap = &shape.positions[of_ball as usize..];
            cap.iter().map(|p| p.z).fold(f64::MIN, f64::max)
        };
        assert!(top(&without) < 1.0 + by && top(&with) > 1.0 + by, "{by}");
    }
}
