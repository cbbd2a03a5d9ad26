//! Sequences of edits on a file that repeats each vertex for every triangle, and on its welded twin: after each the same
//! surface.

use super::{ByteDraw, sessions};
use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits, Model, shapes};
use pliant::deform::VolumeMode;
use pliant::engine::{CutLine, Deformer, DeformerLimits, Edit, OpenOptions, Region};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Vertices do not count: the soup has more of them.
const LIMITS: DeformerLimits = DeformerLimits {
    model: Limits {
        apart: None,
        cage_triangles: 500,
        vertices: 20_000,
        triangles: 800,
        decoded_bytes: 1 << 20,
        document_bytes: 1 << 20,
        points_and_lines: true,
    },
    memory_bytes: 1 << 30,
    graph_bytes: None,
    handles: 16,
};

/// Corners by triangle.
fn corners(cells: [usize; 3]) -> Vec<[DVec3; 3]> {
    let (points, faces) = shapes::box_with_cells(DVec3::new(1.0, 2.0, 1.0), cells);
    faces.iter().map(|t| t.map(|v| points[v as usize])).collect()
}

/// Points in the order in which triangles first name them.
fn twin(corners: &[[DVec3; 3]]) -> FileSet {
    let (mut number, mut places, mut faces) = (BTreeMap::new(), String::new(), String::new());
    for t in corners {
        let numbers = t.map(|p| {
            let next = number.len();
            *number.entry(p.to_array().map(f64::to_bits)).or_insert_with(|| {
                let _ = writeln!(places, "{} {} {}", p.x, p.y, p.z);
                next
            })
        });
        let _ = writeln!(faces, "3 {} {} {}", numbers[0], numbers[1], numbers[2]);
    }
    let text = format!("OFF\n{} {} 0\n{places}{faces}", number.len(), corners.len());
    FileSet::single("twin.off", text.into_bytes())
}

fn off_soup(corners: &[[DVec3; 3]]) -> FileSet {
    let mut text = format!("OFF\n{} {} 0\n", 3 * corners.len(), corners.len());
    for p in corners.iter().flatten() {
        let _ = writeln!(text, "{} {} {}", p.x, p.y, p.z);
    }
    for t in 0..corners.len() {
        let _ = writeln!(text, "3 {} {} {}", 3 * t, 3 * t + 1, 3 * t + 2);
    }
    FileSet::single("soup.off", text.into_bytes())
}

/// A text of one solid: facets of another would be apart from those of the first.
fn text_stl(corners: &[[DVec3; 3]]) -> FileSet {
    let mut text = String::from("solid a box\n");
    for t in corners {
        text.push_str("facet normal 0 0 0\nouter loop\n");
        for p in t {
            let _ = writeln!(text, "vertex {} {} {}", p.x, p.y, p.z);
        }
        text.push_str("endloop\nendfacet\n");
    }
    text.push_str("endsolid a box\n");
    FileSet::single("soup.stl", text.into_bytes())
}

/// The triangles by the places of their corners, in an order of their own.
fn surface(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<[[u64; 3]; 3]> {
    let place = |v: u32| (positions[v as usize] + DVec3::ZERO).to_array().map(f64::to_bits);
    let turned = |t: &[u32; 3]| {
        let mut t = t.map(place);
        let first = (0..3).min_by_key(|&k| t[k]).unwrap_or(0);
        t.rotate_left(first);
        t
    };
    let mut all: Vec<_> = triangles.iter().map(turned).collect();
    all.sort_unstable();
    all
}

/// Whether an edit names vertices, which have other numbers in the twin.
fn names_vertices(edit: &Edit) -> bool {
    let region = match edit {
        Edit::Cut { along, .. } => return matches!(along, CutLine::Path { .. }),
        Edit::Delete { region, .. } => Some(region),
        Edit::Subdivide { region, .. }
        | Edit::SubdivideForPose { region }
        | Edit::Decimate { region, .. }
        | Edit::Fill { region, .. } => region.as_ref(),
        Edit::Remesh(command) => command.region.as_ref(),
        Edit::Smooth(command) => command.region.as_ref(),
        _ => None,
    };
    matches!(region, Some(Region::Vertices { .. }))
}

pub fn soups(bytes: &[u8]) {
    let mut draw = ByteDraw(bytes);
    let pool = Pool::new(1).expect("one thread");
    let exec = Exec::new(&pool, &Silent);
    let mut options = OpenOptions::default();
    options.body.volume = VolumeMode::Off;
    let cells = [[1, 2, 1], [2, 2, 1], [1, 1, 1], [2, 3, 2]][draw.below(4)];
    let corners = corners(cells);
    let is_stl = draw.flag();
    let soup = if is_stl { text_stl(&corners) } else { off_soup(&corners) };
    let [mut soup, mut twin] =
        [soup, twin(&corners)].map(|files| Deformer::open(files, &options, &LIMITS, &exec).expect("the box opens"));
    for _ in 0..4 {
        if draw.is_done() {
            break;
        }
        let edit = sessions::edit(&mut draw);
        if names_vertices(&edit) {
            continue;
        }
        let (got, wanted) = (soup.edit_rest(&edit, &exec), twin.edit_rest(&edit, &exec));
        assert_eq!(
            got.is_ok(),
            wanted.is_ok(),
            "{edit:?}: {:?} and {:?}",
            got.err(),
            wanted.err()
        );
        let [got, wanted] = [&soup, &twin].map(|d| surface(d.rest(), &d.geometry().triangles));
        assert!(got == wanted, "{edit:?} makes another surface of the soup");
    }
    let format = if is_stl { Format::STL } else { Format::OFF };
    let Ok(written) = soup.write(&soup.rest_shape(), format, &exec) else {
        return;
    };
    let back = Model::read(FileSet::single("back", written.main), Some(format), &Limits::default());
    let back = back.expect("what was written is read");
    assert_eq!(back.triangles.len(), soup.geometry().triangles.len());
}
