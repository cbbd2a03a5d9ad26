//! A model as it is drawn: its own normals and materials, wherever its vertices are.

use crate::asset::{DrawnModel, Model};
use crate::mesh::Crossing;
use crate::pool::Pool;
use crate::render::{Error, ShadedSurface, SurfaceDress, crossing_colour};
use clap::ValueEnum;
use glam::{DVec3, Vec3};
use std::sync::Arc;

/// By which normals surfaces are shaded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub(in crate::cli) enum NormalChoice {
    /// Those of the file; without any, flat faces in glTF, as creases in other formats
    #[default]
    File,
    /// Flat faces
    Flat,
    /// Smooth, but for edges between faces more than 40 degrees apart
    Creases,
}

/// A model that can be drawn.
pub(in crate::cli) struct DrawnShape {
    drawn: DrawnModel,
    normals: NormalChoice,
    dress: Option<Arc<SurfaceDress>>,
    /// The triangles to draw: one that is left out has one corner three times.
    shown: Vec<[u32; 3]>,
    /// Vertices of the model.
    vertices: usize,
}

impl DrawnShape {
    /// Reads what a model looks like.
    pub(in crate::cli) fn of_model(model: &Model, normals: NormalChoice) -> Result<Self, crate::asset::Error> {
        let drawn = model.drawn()?;
        Ok(Self {
            shown: drawn.geometry.triangles.clone(),
            drawn,
            normals,
            dress: None,
            vertices: model.positions.len(),
        })
    }

    /// Whether the model says nothing of colours.
    pub(in crate::cli) fn is_bare(&self) -> bool {
        self.drawn.look.is_bare()
    }

    /// Draws the model in its own base colours from now on. Returns sentences on pictures that cannot be drawn.
    pub(in crate::cli) fn wear_materials(&mut self) -> Result<Vec<String>, Error> {
        let mut faults = Vec::new();
        if !self.is_bare() {
            let DrawnModel { geometry, look, .. } = &self.drawn;
            let dress = SurfaceDress::of_model(look, &geometry.primitives, &geometry.triangles, &mut faults)?;
            self.dress = Some(Arc::new(dress));
        }
        Ok(faults)
    }

    /// Leaves out triangles of the model.
    pub(in crate::cli) fn keep_triangles(&mut self, is_kept: impl Fn(usize) -> bool) {
        for (shown, &source) in self.shown.iter_mut().zip(&self.drawn.triangles) {
            if !is_kept(source as usize) {
                *shown = [shown[0]; 3];
            }
        }
    }

    /// The surface with the model's vertices at `positions`; where the file has them, without.
    pub(in crate::cli) fn surface(
        &self,
        positions: Option<&[DVec3]>,
        shift: DVec3,
        pool: &Pool,
    ) -> Result<ShadedSurface, Error> {
        let rest = &self.drawn.geometry;
        let own = |positions: &[DVec3]| self.drawn.vertices.iter().map(|&v| positions[v as usize]).collect();
        let moved: Option<Vec<DVec3>> = positions.map(own);
        let turned = match (&moved, self.normals) {
            (Some(moved), NormalChoice::File) if !rest.normals.is_empty() => Some(rest.deformed(moved).normals),
            _ => None,
        };
        let mut places = moved.unwrap_or_else(|| rest.positions.clone());
        if shift != DVec3::ZERO {
            places.iter_mut().for_each(|p| *p += shift);
        }
        let surface = ShadedSurface::new(&places, &self.shown, pool)?;
        let none: &[Vec3] = &[];
        let shaded = match self.normals {
            NormalChoice::File => {
                let is_flat = self.drawn.look.is_flat_without_normals;
                surface.with_normals(turned.as_ref().unwrap_or(&rest.normals), &self.shown, is_flat)?
            }
            NormalChoice::Flat => surface.with_normals(none, &self.shown, true)?,
            NormalChoice::Creases => surface,
        };
        Ok(match &self.dress {
            Some(dress) => shaded.with_dress(Arc::clone(dress)),
            None => shaded,
        })
    }

    /// Colours a surface of this shape: linear light for each vertex of the model.
    pub(in crate::cli) fn colour_vertices(
        &self,
        surface: ShadedSurface,
        colours: &[Vec3],
    ) -> Result<ShadedSurface, Error> {
        let own: Vec<Vec3> = self.drawn.vertices.iter().map(|&v| colours[v as usize]).collect();
        surface.with_colours(&own)
    }

    /// Marks what crosses on a surface of this shape, from what each triangle of the model crosses.
    pub(in crate::cli) fn mark_crossings(
        &self,
        surface: ShadedSurface,
        crossings: &[Crossing],
    ) -> Result<ShadedSurface, Error> {
        let mark = |&t: &u32| crossing_colour(crossings[t as usize]);
        surface.with_marked_faces(&self.drawn.triangles.iter().map(mark).collect::<Vec<_>>())
    }

    /// Whether each vertex of the model is a corner of what is drawn.
    pub(in crate::cli) fn seen_vertices(&self) -> Vec<bool> {
        let mut seen = vec![false; self.vertices];
        for t in self.shown.iter().filter(|t| t[0] != t[1]) {
            t.iter()
                .for_each(|&v| seen[self.drawn.vertices[v as usize] as usize] = true);
        }
        seen
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::{FileSet, Format, Limits, shapes};
    use crate::render::{Camera, Picture, PictureSize, UpAxis, ViewDirection, draw_surface};
    use glam::DQuat;

    fn read(text: &str) -> Model {
        Model::read(
            FileSet::single("a.obj", text.to_owned()),
            Some(Format::OBJ),
            &Limits::default(),
        )
        .expect("a model")
    }

    fn picture(surface: &ShadedSurface, pool: &Pool) -> Picture {
        let view = ViewDirection::new(20.0, 10.0, UpAxis::Y).expect("in range");
        let size = PictureSize::new(64, 64).expect("in range");
        draw_surface(surface, &Camera::around_surfaces(&[surface], &[view], size)[0], pool)
    }

    #[test]
    fn normals_turn_with_the_shape_as_those_of_a_file_that_is_written() {
        let pool = Pool::new(2).expect("two threads");
        let (corners, triangles) = shapes::icosphere(1.0, 1);
        let mut text = String::new();
        for p in corners.iter().map(|p| *p * DVec3::new(1.0, 2.0, 0.5)) {
            text += &format!("v {} {} {}\nvn {} {} {}\n", p.x, p.y, p.z, p.x, p.y, p.z);
        }
        for t in triangles {
            let [a, b, c] = t.map(|v| v + 1);
            text += &format!("f {a}//{a} {b}//{b} {c}//{c}\n");
        }
        let model = read(&text);
        let turn = DQuat::from_rotation_z(1.0) * DQuat::from_rotation_x(0.7);
        let moved: Vec<DVec3> = model.positions.iter().map(|p| turn * *p * 1.1).collect();
        let written = model.write(&moved, Format::OBJ).expect("writable").main;
        let reopened = read(&String::from_utf8(written).expect("text"));
        let drawn = |model: &Model, positions: Option<&[DVec3]>| {
            let shape = DrawnShape::of_model(model, NormalChoice::File).expect("drawable");
            picture(&shape.surface(positions, DVec3::ZERO, &pool).expect("a surface"), &pool)
        };
        let [carried, read_again] = [drawn(&model, Some(&moved)), drawn(&reopened, None)];
        let still = drawn(&model, None);
        let apart = |a: &Picture, b: &Picture| {
            let pairs = a.pixels().as_flattened().iter().zip(b.pixels().as_flattened());
            pairs.map(|(x, y)| x.abs_diff(*y)).max().unwrap_or_default()
        };
        assert!(apart(&carried, &read_again) <= 2, "{}", apart(&carried, &read_again));
        assert!(apart(&carried, &still) > 50);
    }
}
