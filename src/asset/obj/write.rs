//! OBJ out: the uploaded text with the changed numbers replaced, or a fresh text.

use super::normals::{Normals, Plan};
use super::{Corner, STYLE, Source, resolve, three_words};
use crate::asset::Geometry;
use crate::asset::model::bits;
use crate::asset::text::{Lexer, Patch, Precision, newline_of, push_triple};
use glam::{DVec3, Vec3};
use std::io::Write as _;

/// The uploaded text with the vertices at `positions`.
pub(in crate::asset) fn write(bytes: &[u8], source: &Source, rest: &Geometry, positions: &[DVec3]) -> Vec<u8> {
    let shading = source
        .normals
        .as_ref()
        .map(|normals| (normals, normals.plan(&rest.positions, positions, &rest.triangles)));
    let insertion = shading
        .as_ref()
        .and_then(|(normals, plan)| insertion_place(bytes, normals, plan));
    let mut lexer = Lexer::new(bytes, STYLE);
    let mut patch = Patch::new(bytes);
    let (mut vertices, mut normal_lines) = (0u32, 0u32);
    while let Some(keyword) = lexer.token() {
        if let (Some(place), Some((_, plan))) = (&insertion, &shading)
            && place.offset == keyword.start
        {
            insert(&mut patch, place, plan, newline_of(bytes));
        }
        match lexer.text(keyword) {
            b"v" => {
                let (old, new) = (rest.positions[vertices as usize], positions[vertices as usize]);
                if bits(old) != bits(new)
                    && let Ok(words) = three_words(&mut lexer)
                {
                    patch.replace_changed(words, old, new, Precision::Double);
                }
                vertices += 1;
            }
            b"vn" => {
                let new = shading
                    .as_ref()
                    .and_then(|(_, plan)| plan.rewritten[normal_lines as usize]);
                if let (Some(new), Ok(words)) = (new, three_words(&mut lexer)) {
                    let place = words[0].start..words[2].end;
                    push_triple(patch.replace(place), new.as_dvec3(), Precision::Single);
                }
                normal_lines += 1;
            }
            b"f" => {
                if let (Some(place), Some((normals, plan))) = (&insertion, &shading) {
                    while let Some(word) = lexer.token_on_line() {
                        let Some(corner) = Corner::parse(&lexer, word) else {
                            continue;
                        };
                        let renumbered = place.renumber(normals, plan, corner, [vertices, normal_lines], keyword.start);
                        if let Some(index) = renumbered {
                            let out = patch.replace(corner.normal_token.range());
                            out.extend_from_slice(index.to_string().as_bytes());
                        }
                    }
                }
            }
            _ => {}
        }
        lexer.end_line();
    }
    patch.finish()
}

/// Where new `vn` lines go: before the first face that uses one, because some readers look up normals at once.
struct Insertion {
    offset: usize,
    /// `vn` lines above.
    lines_above: u32,
    /// `vn` lines in the whole uploaded file.
    lines: u32,
    added: u32,
}

impl Insertion {
    /// The number that a corner must now give for its normal, counted from 1, if what is written there is no longer right.
    fn renumber(
        &self,
        normals: &Normals,
        plan: &Plan,
        corner: Corner,
        [vertices, normal_lines]: [u32; 2],
        face_offset: usize,
    ) -> Option<u32> {
        let (vertex, old) = (
            resolve(corner.vertex, vertices)?,
            resolve(corner.normal?, normal_lines)?,
        );
        let line = normals.line_of(plan, old, vertex);
        let wanted = if line >= self.lines {
            self.lines_above + (line - self.lines)
        } else if line >= self.lines_above {
            line + self.added
        } else {
            line
        };
        let lines_now = normal_lines + if face_offset >= self.offset { self.added } else { 0 };
        (resolve(corner.normal?, lines_now) != Some(wanted)).then_some(wanted + 1)
    }
}

fn insertion_place(bytes: &[u8], normals: &Normals, plan: &Plan) -> Option<Insertion> {
    if plan.added.is_empty() {
        return None;
    }
    let lines = plan.rewritten.len() as u32;
    let mut lexer = Lexer::new(bytes, STYLE);
    let (mut vertices, mut normal_lines) = (0u32, 0u32);
    while let Some(keyword) = lexer.token() {
        match lexer.text(keyword) {
            b"v" => vertices += 1,
            b"vn" => normal_lines += 1,
            b"f" => {
                while let Some(word) = lexer.token_on_line() {
                    let Some(corner) = Corner::parse(&lexer, word) else {
                        continue;
                    };
                    let vertex = resolve(corner.vertex, vertices);
                    let normal = corner.normal.and_then(|n| resolve(n, normal_lines));
                    if let (Some(vertex), Some(normal)) = (vertex, normal)
                        && normals.line_of(plan, normal, vertex) >= lines
                    {
                        let added = plan.added.len() as u32;
                        return Some(Insertion {
                            offset: keyword.start,
                            lines_above: normal_lines,
                            lines,
                            added,
                        });
                    }
                }
            }
            _ => {}
        }
        lexer.end_line();
    }
    None
}

fn insert(patch: &mut Patch<'_>, place: &Insertion, plan: &Plan, newline: &[u8]) {
    let out = patch.replace(place.offset..place.offset);
    for normal in &plan.added {
        push_line(out, b"vn ", normal.as_dvec3(), Precision::Single, newline);
    }
}

fn push_line(out: &mut Vec<u8>, keyword: &[u8], values: DVec3, precision: Precision, newline: &[u8]) {
    out.extend_from_slice(keyword);
    push_triple(out, values, precision);
    out.extend_from_slice(newline);
}

/// A fresh text: one object for each primitive, normals where every vertex has one.
pub(in crate::asset) fn build(geometry: &Geometry) -> Vec<u8> {
    let mut out = b"# pliant\n".to_vec();
    for &position in &geometry.positions {
        push_line(&mut out, b"v ", position, Precision::Double, b"\n");
    }
    let with_normals = geometry.all_have_normals();
    if with_normals {
        for &normal in &geometry.normals {
            let normal: Vec3 = normal;
            push_line(&mut out, b"vn ", normal.as_dvec3(), Precision::Single, b"\n");
        }
    }
    for (primitive, triangles) in geometry.triangles_of_primitives() {
        if geometry.primitives.len() > 1 || !primitive.name.is_empty() {
            out.extend_from_slice(b"o ");
            out.extend(
                primitive
                    .name
                    .chars()
                    .map(|c| if c.is_control() { ' ' } else { c })
                    .collect::<String>()
                    .bytes(),
            );
            out.push(b'\n');
        }
        for triangle in triangles {
            out.push(b'f');
            for &v in triangle {
                let number = u64::from(v) + 1;
                let result = if with_normals {
                    write!(out, " {number}//{number}")
                } else {
                    write!(out, " {number}")
                };
                debug_assert!(result.is_ok(), "writing to memory does not fail");
            }
            out.push(b'\n');
        }
    }
    out
}
