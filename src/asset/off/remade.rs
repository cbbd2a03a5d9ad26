//! OFF out after edits of the topology, and what an edited OFF gives to other formats.

use super::{STYLE, count, header};
use crate::asset::model::Source;
use crate::asset::plain::Extras;
use crate::asset::remade::{Carried, Origins, Remade, Run};
use crate::asset::text::{Lexer, Precision, integer, number, push_number, push_triple};
use crate::asset::{Error, Format, Model};
use crate::mesh::NONE;
use glam::Vec3;

/// What an OFF text holds beyond positions and triangles.
#[derive(Default)]
struct Rest<'a> {
    /// Comments above the keyword, and the keyword.
    head: &'a [u8],
    has_normals: bool,
    /// Numbers after the coordinates (and the normal) of every vertex, so many for each; empty unless all have as many.
    more: Vec<f64>,
    lanes: usize,
    /// All of them are whole.
    whole: bool,
    /// For each triangle what follows the corners of its face, such as a colour.
    of_triangle: Vec<&'a [u8]>,
}

/// Reads the text of a model that was read before.
fn rest<'a>(model: &'a Model, has_normals: bool) -> Result<Rest<'a>, Error> {
    let bytes = &model.files.main[..];
    let mut lexer = Lexer::new(bytes, STYLE);
    let start = lexer.at();
    header(&mut lexer)?;
    let mut rest = Rest {
        head: &bytes[start..lexer.at()],
        has_normals,
        whole: true,
        ..Rest::default()
    };
    let (vertices, _) = count(&mut lexer, "vertices")?;
    let (faces, _) = count(&mut lexer, "faces")?;
    lexer.end_line();
    let mut even = true;
    for vertex in 0..vertices {
        for _ in 0..if has_normals { 6 } else { 3 } {
            lexer.token();
        }
        let before = rest.more.len();
        while let Some(word) = lexer.token_on_line() {
            let text = lexer.text(word);
            rest.whole &= integer(text).is_some();
            rest.more.extend(number(text).filter(|v| v.is_finite()));
        }
        let lanes = rest.more.len() - before;
        even &= vertex == 0 || lanes == rest.lanes;
        rest.lanes = lanes;
        lexer.end_line();
    }
    if !even || rest.lanes == 0 {
        (rest.more, rest.lanes) = (Vec::new(), 0);
    }
    for face in 0..faces {
        let (corners, _) = count(&mut lexer, &format!("corners of face {face}"))?;
        for _ in 0..corners {
            lexer.token();
        }
        let mut place = lexer.at()..lexer.at();
        if let Some(word) = lexer.token_on_line() {
            place = word.range();
        }
        while let Some(word) = lexer.token_on_line() {
            place.end = word.end;
        }
        let triangles = usize::try_from(corners).unwrap_or(0).saturating_sub(2);
        rest.of_triangle
            .extend(std::iter::repeat_n(&bytes[place], triangles.min(bytes.len())));
        lexer.end_line();
    }
    Ok(rest)
}

fn all_rests<'a>(remade: &Remade<'a>) -> Result<Vec<Option<Rest<'a>>>, Error> {
    let one = |base: &crate::asset::remade::Base<'a>| match &base.model.source {
        Source::Off(source) => rest(base.model, source.has_normals).map(Some),
        _ => Ok(None),
    };
    remade.bases.iter().map(one).collect()
}

/// A text of the edited model with the kinds of numbers that the first base has. Faces are triangles and have the
/// colour of the face that they lie on.
pub(in crate::asset) fn write_remade(remade: &Remade<'_>, positions: &[glam::DVec3]) -> Result<Vec<u8>, Error> {
    let rests = all_rests(remade)?;
    let Some(Some(first)) = rests.first() else {
        return Err(Error::unwritable(Format::Off, "the first base is no OFF"));
    };
    let mut out = first.head.to_vec();
    if out.is_empty() {
        out.extend_from_slice(b"OFF");
    }
    out.extend(format!("\n{} {} 0\n", positions.len(), remade.triangles.len()).bytes());
    for run in remade.runs {
        let normals = if first.has_normals {
            Carried::new(remade, run, positions).normals()
        } else {
            Vec::new()
        };
        let own = rests
            .get(run.base as usize)
            .and_then(Option::as_ref)
            .filter(|r| r.lanes == first.lanes);
        for (i, vertex) in run.vertices().enumerate() {
            push_triple(&mut out, positions[vertex], Precision::Double);
            if first.has_normals {
                out.push(b' ');
                let normal = normals.get(i).copied().unwrap_or(Vec3::Z);
                push_triple(&mut out, normal.as_dvec3(), Precision::Single);
            }
            for lane in 0..first.lanes {
                // What another format leaves open is white.
                let white = if first.whole { 255.0 } else { 1.0 };
                let value = own.map_or(white, |own| blended(remade, vertex, own, lane));
                out.push(b' ');
                let value = if first.whole { value.round() } else { value };
                push_number(&mut out, value, Precision::Single);
            }
            out.push(b'\n');
        }
    }
    for run in remade.runs.iter().filter(|r| r.triangle_count > 0) {
        let old = &remade.base(run).model.geometry.triangles;
        let own = rests.get(run.base as usize).and_then(Option::as_ref);
        let own = own.filter(|own| own.of_triangle.len() == old.len() && own.of_triangle.iter().any(|t| !t.is_empty()));
        let origins = own.map(|_| Origins::new(remade, run, old));
        for (i, [a, b, c]) in remade.triangles[run.triangles()].iter().enumerate() {
            out.extend(format!("3 {a} {b} {c}").bytes());
            let origin = origins.as_ref().map_or(NONE, |o| o.of()[i]);
            let more = own
                .and_then(|own| own.of_triangle.get(origin as usize))
                .copied()
                .unwrap_or(&[]);
            if !more.is_empty() {
                out.push(b' ');
                out.extend_from_slice(more);
            }
            out.push(b'\n');
        }
    }
    Ok(out)
}

fn blended(remade: &Remade<'_>, vertex: usize, of: &Rest<'_>, lane: usize) -> f64 {
    let old = |v: u32| of.more.get(v as usize * of.lanes + lane).copied().unwrap_or(0.0);
    remade.recipe(vertex).iter().map(|(v, weight)| old(v) * weight).sum()
}

/// Colours of the vertices of runs.
pub(in crate::asset) fn extras(remade: &Remade<'_>, runs: &[&Run]) -> Result<Vec<Extras>, Error> {
    let Some((first, Source::Off(source))) = runs.first().map(|r| (*r, &remade.base(r).model.source)) else {
        return Ok(Vec::new());
    };
    let rest = rest(remade.base(first).model, source.has_normals)?;
    let word = rest.head.rsplit(|b| b.is_ascii_whitespace()).next().unwrap_or_default();
    let has_colours = word.contains(&b'C') && !word.starts_with(b"ST") && (3..=4).contains(&rest.lanes);
    let full = if rest.whole { 255.0 } else { 1.0 };
    let colour = |vertex: usize| {
        let lane = |lane: usize| {
            if lane < rest.lanes {
                blended(remade, vertex, &rest, lane) / full
            } else {
                1.0
            }
        };
        [0, 1, 2, 3].map(|l| (lane(l) as f32).clamp(0.0, 1.0))
    };
    let one = |run: &&Run| Extras {
        colours: if has_colours {
            run.vertices().map(colour).collect()
        } else {
            Vec::new()
        },
        ..Extras::default()
    };
    Ok(runs.iter().map(one).collect())
}
