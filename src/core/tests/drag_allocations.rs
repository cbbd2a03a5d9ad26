//! Once a drag is under way, a frame asks the allocator for the shape that it hands out and for next to nothing beside.

use counting_allocator::{CountingAllocator, counted};
use pliant_core::asset::{FileSet, shapes};
use pliant_core::engine::{Deformer, DeformerLimits, Handle, HandlePose, OpenOptions, Region, SolveSettings};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

#[path = "../../solver/tests/support/counting_allocator.rs"]
mod counting_allocator;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Calls of the allocator that a frame may cost on one thread: what is posed is reported handle by handle.
const CALLS: usize = 40;
/// The same with more threads, where work is handed out.
const CALLS_OF_THREADS: usize = 400;
/// Bytes beside the shape: what is reported of thin faces, and of handles.
const BYTES: usize = 24 << 10;
/// With more threads every block of rows hands over its sums: so many bytes for a node.
const BYTES_A_NODE: usize = 1;

// One test, so that nothing else in the process allocates meanwhile.
#[test]
fn frames_of_a_drag_ask_for_the_shape_that_they_hand_out() {
    for threads in [1, 2, 4] {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let mut deformer = Deformer::open(cylinder(), &OpenOptions::default(), &DeformerLimits::default(), &exec)
            .expect("the cylinder opens");
        let ends = [
            Handle::new("held", Region::half_space([0.0, 0.0, -1.0], -0.3)),
            Handle::new("moved", Region::half_space([0.0, 0.0, 1.0], 2.7)),
        ];
        deformer.set_handles(ends, &exec).expect("handles");
        let nodes = deformer.facts().solver.graph_vertices;
        assert!(nodes > 1 << 14, "enough for several threads: {nodes} nodes");
        let settings = SolveSettings::default();
        // A commit first, whose memory a drag has no use for.
        let pose = |frame: usize| {
            let way = 0.01 * frame as f64;
            HandlePose::translation([way, 0.0, 0.0]).rotated([0.0, way, 0.3 * way])
        };
        deformer.commit([("moved", pose(3))], &settings, &exec).expect("solved");
        let mut drag = deformer.drag(&settings);
        let mut cycles = 0;
        for frame in 0..60 {
            let (shape, asked) = counted(|| drag.solve([("moved", pose(frame))], &exec));
            let shape = shape.expect("solved");
            if frame < 20 {
                continue;
            }
            cycles += shape.stats.cycles;
            let handed_out = size_of_val(shape.positions.as_slice());
            let (calls, bytes) = match threads {
                1 => (CALLS, BYTES),
                _ => (CALLS_OF_THREADS, BYTES + BYTES_A_NODE * nodes as usize),
            };
            assert!(
                asked.calls <= calls && asked.bytes <= handed_out + bytes,
                "{threads} threads, frame {frame}: {} calls for {} bytes, of which {handed_out} are handed out:\n{}",
                asked.calls,
                asked.bytes,
                asked.traces.join("\n")
            );
        }
        assert!(cycles > 0, "some frames iterate");
    }
}

/// A cylinder as a file.
fn cylinder() -> FileSet {
    let (points, faces) = shapes::cylinder(0.3, 3.0, 96, 240, true);
    let mut text = String::new();
    points
        .iter()
        .for_each(|p| text += &format!("v {} {} {}\n", p.x, p.y, p.z));
    for face in faces {
        let [a, b, c] = face.map(|v| v + 1);
        text += &format!("f {a} {b} {c}\n");
    }
    FileSet::single("cylinder.obj", text)
}
