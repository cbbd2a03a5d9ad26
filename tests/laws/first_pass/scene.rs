//! Bodies with handles, solved without a workbench around them.

use glam::{DMat3, DQuat, DVec3};
use pliant::asset::shapes;
use pliant::core::reference::{SpatialRbf, diffuse, linear_frames};
use pliant::deform::{
    BodyOptions, DeformableBody, FirstPass, HandleConstraint, HandleSetup, HandleSystem, PoseRequest, Quality,
    SolveStart, SolveState, SolvedNodes, Transform, VolumeMode, exp_rotation, log_rotation,
};
use pliant::engine::Method;
use pliant::exec::Exec;
use pliant::mesh::{Mesh, Weld};
use pliant::pool::Pool;
use pliant::progress::Silent;

pub type Shape = (Vec<DVec3>, Vec<[u32; 3]>);

pub const METHODS: [Method; 4] = [
    Method::Harmonic,
    Method::Diffusion,
    Method::LinearFrames,
    Method::SpatialRbf,
];

pub struct Scene {
    pub shape: Shape,
    pub body: DeformableBody,
    pub rig: HandleSystem,
    pub pool: Pool,
}

impl Scene {
    /// Handles that hold positions and rotations of the vertices and inner nodes that `regions` say.
    pub fn new(shape: Shape, volume: VolumeMode, regions: &[&dyn Fn(DVec3) -> bool], threads: usize) -> Self {
        let nodes = |body: &DeformableBody, region: &dyn Fn(DVec3) -> bool| {
            let nodes = (0u32..).zip(&body.graph.positions);
            nodes.filter(|(_, p)| region(**p)).map(|(n, _)| n).collect::<Vec<_>>()
        };
        let holds = |body: &DeformableBody| regions.iter().map(|region| hold(nodes(body, region), None)).collect();
        Self::with(shape, volume, holds, threads)
    }

    pub fn with(
        shape: Shape,
        volume: VolumeMode,
        holds: impl Fn(&DeformableBody) -> Vec<HandleConstraint>,
        threads: usize,
    ) -> Self {
        let pool = Pool::new(threads).expect("threads start");
        let mesh = Mesh::build(&shape.0, &shape.1, Weld::Exact).expect("a mesh");
        let options = BodyOptions {
            volume,
            ..Default::default()
        };
        let body = DeformableBody::build(&mesh, &options, &Exec::new(&pool, &Silent)).expect("a body");
        let rigging = HandleSetup {
            handles: holds(&body),
            ..Default::default()
        };
        let rig = HandleSystem::build(&body, rigging, &Exec::new(&pool, &Silent)).expect("a rig");
        Self { shape, body, rig, pool }
    }

    /// A bar along z, 4 long and 1 wide, held at both ends.
    pub fn bar() -> Self {
        Self::bar_on(2)
    }

    pub fn bar_on(threads: usize) -> Self {
        Self::new(bar(), VolumeMode::Auto, &[&|p| p.z <= 0.25, &|p| p.z >= 3.75], threads)
    }

    /// The bar as a surface, with handles at both ends and three in between.
    pub fn many() -> Self {
        Self::many_placed(DQuat::IDENTITY, DVec3::ZERO, 2)
    }

    pub fn many_placed(turn: DQuat, shift: DVec3, threads: usize) -> Self {
        let shape = bar();
        let side = |p: DVec3, z: f64, x: f64| (p.z - z).abs() < 0.2 && (p.x - x).abs() < 0.01;
        let regions: [&dyn Fn(DVec3) -> bool; 5] = [
            &|p| p.z <= 0.25,
            &|p| p.z >= 3.75,
            &|p| side(p, 1.0, 0.5),
            &|p| side(p, 2.0, -0.5),
            &|p| side(p, 3.0, 0.5),
        ];
        let chosen: Vec<Vec<u32>> = regions
            .iter()
            .map(|region| {
                (0u32..)
                    .zip(&shape.0)
                    .filter(|(_, p)| region(**p))
                    .map(|(i, _)| i)
                    .collect()
            })
            .collect();
        let positions = shape.0.iter().map(|p| turn * *p + shift).collect();
        let holds = |_: &DeformableBody| chosen.iter().map(|nodes| hold(nodes.clone(), None)).collect();
        Self::with((positions, shape.1), VolumeMode::Off, holds, threads)
    }

    /// A flat sheet, held at two edges.
    pub fn sheet() -> Self {
        let turn = exp_rotation(DVec3::new(0.4, 0.3, 0.8));
        let (positions, triangles) = shapes::grid(1.0, 1.0, [12, 12]);
        let across: Vec<f64> = positions.iter().map(|p| p.x).collect();
        let (low, high) = (
            across.iter().copied().fold(f64::INFINITY, f64::min),
            across.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        );
        let side = |keep: &dyn Fn(f64) -> bool| {
            (0u32..)
                .zip(&across)
                .filter(|(_, x)| keep(**x))
                .map(|(i, _)| i)
                .collect()
        };
        let holds = [side(&|x| x < low + 0.1), side(&|x| x > high - 0.1)];
        let shape = (positions.iter().map(|p| turn * *p).collect(), triangles);
        Self::with(
            shape,
            VolumeMode::Auto,
            |_| holds.iter().cloned().map(|n: Vec<u32>| hold(n, None)).collect(),
            2,
        )
    }

    /// A handle on each of some vertices of the bar's surface; the last one soft when it has a stiffness.
    pub fn of_vertices(vertices: &[u32], stiffness: Option<f64>) -> Self {
        let last = vertices.len() - 1;
        let holds = |_: &DeformableBody| {
            let of = |(k, v): (usize, &u32)| hold(vec![*v], stiffness.filter(|_| k == last));
            vertices.iter().enumerate().map(of).collect()
        };
        Self::with(bar(), VolumeMode::Off, holds, 2)
    }

    /// A spring of six close coils. Handle 0 is an anchor at both ends of the wire and half a turn before and after the
    /// place that handle 1 grips. Also the vertices of the coils beside that place: cut off along the wire by anchors,
    /// and near in space.
    pub fn spring() -> (Self, Vec<usize>) {
        const TURNS: f64 = 6.0;
        let shape = shapes::spring(1.0, 0.08, 0.25, TURNS, 10, 480);
        let turns = |p: DVec3| {
            let angle = f64::atan2(p.y, p.x) / std::f64::consts::TAU;
            (p.z / 0.25 - angle).round() + angle
        };
        let near = |t: f64, at: f64| (t - at).abs() < 0.07;
        let regions: [&dyn Fn(DVec3) -> bool; 2] =
            [&|p| [0.0, 2.5, 3.5, TURNS].iter().any(|at| near(turns(p), *at)), &|p| {
                near(turns(p), 3.0)
            }];
        let beside = |p: DVec3| near(turns(p), 2.0) || near(turns(p), 4.0);
        let neighbours = (0..shape.0.len()).filter(|&i| beside(shape.0[i])).collect();
        (Self::new(shape, VolumeMode::Auto, &regions, 2), neighbours)
    }

    pub fn is_held(&self, node: usize) -> bool {
        self.rig
            .setup()
            .handles
            .iter()
            .any(|h| h.nodes.contains(&(node as u32)))
    }

    pub fn solve(&self, method: Method, transforms: &[Transform], tolerance: f64) -> SolvedNodes {
        self.solve_in(
            &mut SolveState::default(),
            SolveStart::Fresh,
            method,
            transforms,
            tolerance,
        )
    }

    pub fn solve_in(
        &self,
        state: &mut SolveState,
        start: SolveStart,
        method: Method,
        transforms: &[Transform],
        tolerance: f64,
    ) -> SolvedNodes {
        let exec = Exec::new(&self.pool, &Silent);
        let (body, handles) = (&self.body, &self.rig);
        let turns = match method {
            Method::Harmonic => None,
            Method::Diffusion => diffuse(body, handles, transforms, &exec).expect("rotations"),
            Method::LinearFrames => linear_frames(body, handles, transforms, &self.pool),
            Method::SpatialRbf => {
                let solved = SpatialRbf::default().solve(handles, body, transforms, state, &exec);
                return solved.expect("solved");
            }
        };
        let quality = Quality {
            tolerance: Some(tolerance),
            ..Quality::default()
        };
        let request = PoseRequest {
            start,
            first_pass: match method {
                Method::Harmonic => FirstPass::Harmonic,
                _ => FirstPass::Given(turns.as_deref()),
            },
            ..PoseRequest::new(transforms, quality)
        };
        let solved = handles.solve(body, &request, state, &exec, &mut |_| true);
        solved.expect("solved")
    }

    /// Handles of [`Scene::many`] turned about axes of their own and moved a little; `size` 1 is up to 90°.
    pub fn turned(&self, size: f64) -> Vec<Transform> {
        let turns = [
            (DVec3::ZERO, DVec3::ZERO),
            (DVec3::new(0.3, 0.5, 1.4), DVec3::new(0.3, 0.0, 0.2)),
            (DVec3::new(-0.4, 0.8, 0.2), DVec3::new(0.0, 0.2, 0.0)),
            (DVec3::new(0.0, -0.5, -0.3), DVec3::ZERO),
            (DVec3::new(0.9, 0.0, 0.7), DVec3::new(-0.1, 0.1, 0.0)),
        ];
        let transform = |(k, (rotation, translation)): (usize, &(DVec3, DVec3))| {
            let nodes = &self.rig.setup().handles[k].nodes;
            let places = nodes.iter().map(|n| self.body.graph.positions[*n as usize]);
            Transform {
                rotation: *rotation * size,
                translation: *translation * size,
                log_scale: DMat3::ZERO,
                pivot: places.sum::<DVec3>() / nodes.len() as f64,
            }
        };
        turns.iter().enumerate().map(transform).collect()
    }
}

pub fn hold(nodes: Vec<u32>, stiffness: Option<f64>) -> HandleConstraint {
    HandleConstraint {
        pulls: match stiffness {
            Some(_) => nodes.iter().map(|n| (*n, 1.0)).collect(),
            None => Vec::new(),
        },
        nodes,
        stiffness,
        position: true,
        rotation: true,
        scale: true,
        ..Default::default()
    }
}

pub fn bar() -> Shape {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(1.0, 1.0, 4.0), [8, 8, 32]);
    (
        positions.iter().map(|p| *p - DVec3::new(0.5, 0.5, 0.0)).collect(),
        triangles,
    )
}

pub fn turn_about(rotation: DVec3, pivot: DVec3) -> Transform {
    Transform {
        rotation,
        pivot,
        ..Transform::IDENTITY
    }
}

pub fn rotation_in(frame: &[f32; 9]) -> DQuat {
    DQuat::from_mat3(&glam::Mat3::from_cols_array(frame).as_dmat3())
}

pub fn angle_between(a: DQuat, b: DQuat) -> f64 {
    log_rotation(a.inverse() * b).length()
}

pub fn rms(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    let squares: f64 = a.iter().zip(b).map(|(a, b)| a.distance_squared(*b)).sum();
    (squares / a.len() as f64).sqrt()
}
