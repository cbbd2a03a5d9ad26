//! Parts of a model as its user has them: opened, posed, edited, taken back.

use super::shapes::{axe, block, obj, offset_errors, quantile, side_by_side, slices, together};
use glam::DVec3;
use pliant_core::asset::shapes::Shape;
use pliant_core::edit::{KeptSide, SubdivisionScheme};
use pliant_core::engine::{
    CutLine, Deformer, DeformerLimits, Edit, Error, Handle, HandlePose, OpenOptions, Plane, Region, SolveSettings,
    digest,
};
use pliant_core::exec::Exec;
use pliant_core::graph::VolumeOptions;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

fn pool() -> Pool {
    Pool::new(2).expect("threads")
}

fn open(shape: &Shape, options: &OpenOptions, exec: &Exec<'_>) -> Deformer {
    Deformer::open(obj(shape), options, &DeformerLimits::default(), exec).expect("the shape opens")
}

/// The lowest tenth held, and the highest to be posed.
fn ends(deformer: &Deformer) -> [Handle; 2] {
    let heights = || deformer.rest().iter().map(|p| p.y);
    let (low, high) = (heights().fold(f64::MAX, f64::min), heights().fold(f64::MIN, f64::max));
    let part = 0.1 * (high - low);
    [
        Handle::new("bottom", Region::half_space([0.0, -1.0, 0.0], -(low + part))),
        Handle::new("top", Region::half_space([0.0, 1.0, 0.0], high - part)),
    ]
}

fn bend() -> HandlePose {
    HandlePose::rotation([0.0, 0.0, std::f64::consts::FRAC_PI_4]).about(DVec3::ZERO)
}

/// The 95th percentile of how far neighbours of different parts have come apart in a bend, over the diagonal.
fn torn(shape: &Shape, options: &OpenOptions) -> f64 {
    let pool = pool();
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(shape, options, &exec);
    deformer.set_handles(ends(&deformer), &exec).expect("handles");
    let shape = deformer
        .commit([("top", bend())], &SolveSettings::default(), &exec)
        .expect("solved");
    let mesh = super::shapes::unwelded(&(deformer.rest().to_vec(), deformer.geometry().triangles.clone()));
    let pairs = side_by_side(&mesh, 0.003 * deformer.diagonal(), &pool);
    assert!(!pairs.is_empty(), "parts lie side by side");
    quantile(&offset_errors(&pairs, &mesh.positions, &shape.positions), 0.95) / deformer.diagonal()
}

fn separate() -> OpenOptions {
    let mut options = OpenOptions::default();
    options.body.ties = None;
    options
}

#[test]
fn an_axe_bends_as_one_and_a_cake_keeps_its_slices_together() {
    // The parts of an axe overlap, and hold together by the interior that they share; slices hold by their ties alone.
    for (name, shape, least_apart) in [("axe", axe(), 0.0), ("cake", slices(6, 1e-4), 3e-3)] {
        let tied = torn(&shape, &OpenOptions::default());
        let apart = torn(&shape, &separate());
        assert!(tied <= 2e-3, "{name}: {tied}");
        assert!(
            apart >= 5.0 * tied && apart > least_apart,
            "{name} without ties: {apart}, with them {tied}"
        );
    }
}

#[test]
fn facts_list_parts_ties_and_what_stays_loose() {
    let pool = pool();
    let exec = Exec::new(&pool, &Silent);
    let shape = together([axe(), block([3.0, 0.0, 0.0], [0.5; 3], [4; 3])]);
    let facts = open(&shape, &OpenOptions::default(), &exec).facts().solver;
    assert_eq!((facts.components, facts.ties.loose_parts), (4, 1));
    assert!(facts.ties.ties > 20, "{} ties", facts.ties.ties);
    assert_eq!((facts.ties.loose[0].component, facts.ties.loose[0].vertices), (3, 98));
    let one = open(&block([0.0; 3], [1.0; 3], [3; 3]), &OpenOptions::default(), &exec)
        .facts()
        .solver;
    assert_eq!((one.components, one.ties.ties, one.ties.loose_parts), (1, 0, 0));
}

#[test]
fn parts_that_are_kept_apart_get_no_ties_and_wrong_numbers_are_refused() {
    let pool = pool();
    let exec = Exec::new(&pool, &Silent);
    let open_with = |components: &[u32], primitives: &[u32]| {
        let mut options = OpenOptions::default();
        options.kept_apart.components = components.to_vec();
        options.kept_apart.primitives = primitives.to_vec();
        Deformer::open(obj(&slices(3, 1e-4)), &options, &DeformerLimits::default(), &exec)
    };
    let loose = |components: &[u32], primitives: &[u32]| {
        open_with(components, primitives)
            .expect("allowed")
            .facts()
            .solver
            .ties
            .loose_parts
    };
    assert_eq!(
        (loose(&[], &[]), loose(&[2], &[]), loose(&[1], &[]), loose(&[], &[0])),
        (0, 1, 3, 3)
    );
    for (components, primitives, reported) in [
        (
            &[3][..],
            &[][..],
            "keepApart.components[0]: is 3, the model has 3 connected parts, counted from 0",
        ),
        (
            &[],
            &[0, 7],
            "keepApart.primitives[1]: is 7, the model has 1 primitive, counted from 0",
        ),
    ] {
        let error = open_with(components, primitives).err().expect("refused");
        assert!(
            matches!(error, Error::Invalid { .. }) && error.to_string() == reported,
            "{error}"
        );
    }
}

#[test]
fn a_pose_that_pulls_tied_parts_apart_is_reported_with_the_names() {
    let pool = pool();
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(&slices(2, 1e-4), &OpenOptions::default(), &exec);
    let halves = [
        Handle::new("lower", Region::half_space([0.0, -1.0, 0.0], -0.2501)),
        Handle::new("upper", Region::half_space([0.0, 1.0, 0.0], 0.25005)),
    ];
    deformer.set_handles(halves, &exec).expect("handles");
    let reported = |by: [f64; 3], both: bool| {
        let mut poses = vec![("upper", HandlePose::translation(by))];
        poses.extend(both.then(|| ("lower", HandlePose::translation(by))));
        let poses = deformer
            .change_poses(&deformer.initial_poses(), poses)
            .expect("handles of that name");
        deformer.pose_warnings(&poses)
    };
    let warnings = reported([0.0, 0.5, 0.0], false);
    assert_eq!(warnings.len(), 1);
    assert_eq!(warnings[0].code, "parts-pulled-apart");
    for word in ["\"lower\"", "\"upper\"", "0.500", "keepApart"] {
        assert!(warnings[0].message.contains(word), "{}", warnings[0].message);
    }
    assert!(
        reported([0.0, 0.001, 0.0], false).is_empty(),
        "a hair's breadth is not worth a word"
    );
    assert!(reported([0.0, 0.5, 0.0], true).is_empty(), "both go together");
}

/// The digest of the bent shape in the present state of the topology.
fn bent(deformer: &mut Deformer, exec: &Exec<'_>) -> String {
    deformer.set_handles(ends(deformer), exec).expect("handles");
    digest(
        &deformer
            .commit([("top", bend())], &SolveSettings::default(), exec)
            .expect("solved")
            .positions,
    )
}

#[test]
fn what_is_undone_is_as_it_was_and_edits_tie_again_around_themselves() {
    let pool = pool();
    let exec = Exec::new(&pool, &Silent);
    // A graph of kind PAPER follows edits.
    let mut options = OpenOptions::default();
    options.body.graph = VolumeOptions::paper();
    let mut deformer = open(&axe(), &options, &exec);
    let rest = deformer.topology_state();
    let first = bent(&mut deformer, &exec);
    // Where the head sits on the handle, and somewhere on the handle alone.
    for (name, region) in [
        ("at the head", Region::sphere([0.1, 1.35, 0.1], 0.12)),
        ("on the handle", Region::sphere([0.1, -0.5, 0.1], 0.12)),
    ] {
        let edit = Edit::Subdivide {
            region: Some(region),
            scheme: SubdivisionScheme::Midpoint,
            creases: Default::default(),
        };
        let outcome = deformer.edit_rest(&edit, &exec).expect("split");
        assert!(outcome.report.repaired, "{name}: the graph follows");
        let followed = deformer.body().graph.ties.clone().expect("ties");
        let built = {
            let shape = (deformer.rest().to_vec(), deformer.geometry().triangles.clone());
            open(&shape, &options, &exec).body().graph.ties.clone().expect("ties")
        };
        let pairs = |ties: &pliant_core::graph::PartTies| {
            let mut pairs: Vec<_> = ties.anchors().iter().map(|a| a.vertex).collect();
            pairs.sort_unstable();
            pairs
        };
        assert_eq!(
            pairs(&followed).len(),
            pairs(&built).len(),
            "{name}: as many ties as a new graph"
        );
        let edited = deformer.topology_state();
        let second = bent(&mut deformer, &exec);
        assert_ne!(first, second, "{name}");
        deformer.restore_topology(&rest, &exec).expect("back");
        assert_eq!(bent(&mut deformer, &exec), first, "{name}: undone");
        deformer.restore_topology(&edited, &exec).expect("forth");
        assert_eq!(bent(&mut deformer, &exec), second, "{name}: done again");
        deformer.restore_topology(&rest, &exec).expect("back");
    }
}

#[test]
fn what_a_cut_has_separated_is_not_tied_again_but_all_else_is() {
    let pool = pool();
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(&axe(), &OpenOptions::default(), &exec);
    let cut = Edit::Cut {
        along: CutLine::Plane(Plane::new([0.0, 1.0, 0.0], 0.3)),
        keep: KeptSide::Both,
        fill: true,
        cap: None,
    };
    deformer.edit_rest(&cut, &exec).expect("cut");
    let graph = &deformer.body().graph;
    let of = |wanted: &dyn Fn(DVec3) -> bool| {
        let found = graph.positions[..graph.surface].iter().position(|p| wanted(*p));
        graph.component[found.expect("a vertex there")]
    };
    let (lower, upper) = (of(&|p| p.y < -1.0), of(&|p| p.y > 1.95));
    let (head, pin) = (of(&|p| p.x > 0.6), of(&|p| p.z > 0.24));
    assert_ne!(lower, upper, "the halves of the handle are two");
    assert_eq!((head, pin), (upper, upper), "head and pin hold on to the upper half");
    assert_eq!(deformer.facts().solver.ties.loose_parts, 1);
}
