//! Which edit and which pose come next: drawn from a seed and from what the model has become.

pub use crate::support::draw::Draw;

use glam::DVec3;
use serde_json::{Value, json};

/// What the script looks at.
pub struct Seen<'a> {
    pub positions: &'a [DVec3],
    /// About the mean length of an edge.
    pub edge: f64,
    pub diagonal: f64,
    /// Above so many vertices the model is thinned out.
    pub most: usize,
    /// Whether parts that touch may be made.
    pub apart: bool,
}

impl Seen<'_> {
    fn place(&self, draw: &mut Draw) -> DVec3 {
        self.positions[draw.below(self.positions.len())]
    }

    /// A ball about a vertex.
    fn ball(&self, draw: &mut Draw) -> Value {
        let radius = self.diagonal * draw.within(0.04, 0.16);
        json!({"sphere": {"center": self.place(draw).to_array(), "radius": radius}})
    }

    /// The next edit.
    pub fn edit(&self, draw: &mut Draw) -> Value {
        let on = if draw.below(4) == 0 { "REST" } else { "CURRENT" };
        let mut edit = self.operation(draw);
        edit["on"] = on.into();
        edit
    }

    fn operation(&self, draw: &mut Draw) -> Value {
        if self.positions.len() > self.most {
            return json!({"decimate": {"ratio": draw.within(0.4, 0.7)}});
        }
        if self.positions.len() < 120 {
            return json!({"subdivide": {"scheme": "MIDPOINT"}});
        }
        let region = self.ball(draw);
        match draw.below(18) {
            0 | 1 => json!({"subdivide": {"region": region, "scheme": "MIDPOINT"}}),
            2 => json!({"subdivide": {"region": region, "scheme": "LOOP"}}),
            3 | 4 => json!({"decimate": {"region": region, "ratio": draw.within(0.2, 0.9)}}),
            5 | 6 => json!({"remesh": {"region": region, "edgeLength": self.edge * draw.within(0.6, 1.8)}}),
            7 | 8 => json!({"remesh": {"auto": true}}),
            9 | 10 => json!({"delete": {"region": region, "fill": true}}),
            11 => json!({"delete": {"region": region}}),
            12 => json!({"fill": {}}),
            13 => self.cut(draw),
            14 => {
                let start = self.place(draw);
                let mut points = start.to_array().to_vec();
                for _ in 0..draw.below(3) + 1 {
                    let next = start + draw.direction() * self.edge * draw.within(1.0, 4.0);
                    points.extend(next.to_array());
                }
                json!({"insertCurve": {"points": points}})
            }
            15 => json!({"weld": {"tolerance": self.edge * draw.within(1e-4, 0.05)}}),
            16 => self.merge(draw),
            _ => self.nonsense(draw),
        }
    }

    /// A plane that takes off a tip, or, where touching parts are allowed, one through the middle of everything.
    fn cut(&self, draw: &mut Draw) -> Value {
        let normal = draw.direction();
        let mut heights: Vec<f64> = self.positions.iter().map(|p| p.dot(normal)).collect();
        heights.sort_by(f64::total_cmp);
        let both = self.apart && draw.below(3) == 0;
        let part = if both { 0.5 } else { draw.within(0.9, 0.99) };
        let offset = heights[(part * (heights.len() - 1) as f64) as usize];
        let keep = if both { "BOTH" } else { "BELOW" };
        json!({"cut": {"plane": {"normal": normal.to_array(), "offset": offset}, "keep": keep, "fill": draw.below(4) > 0}})
    }

    /// A small box, on the surface or beside it.
    fn merge(&self, draw: &mut Draw) -> Value {
        use base64::Engine as _;
        let text = super::obj(&pliant::asset::shapes::box_with_cells(DVec3::ONE, [2, 2, 2])).main;
        let at = self.place(draw) + draw.direction() * self.edge;
        let size = self.edge * draw.within(1.0, 3.0);
        let how = ["LOOSE", "LOOSE", "WELD", "STITCH"][draw.below(4)];
        let model = base64::engine::general_purpose::STANDARD.encode(text);
        let transform = [
            size, 0.0, 0.0, 0.0, 0.0, size, 0.0, 0.0, 0.0, 0.0, size, 0.0, at.x, at.y, at.z, 1.0,
        ];
        json!({"merge": {"model": model, "format": "obj", "transform": transform, "how": how}})
    }

    /// What has to be refused.
    fn nonsense(&self, draw: &mut Draw) -> Value {
        let far = json!({"sphere": {"center": [1e9, 0, 0], "radius": 1.0}});
        match draw.below(8) {
            0 => json!({"cut": {"plane": {"normal": [0, 0, 1], "offset": 1e9}}}),
            1 => json!({"delete": {"region": far}}),
            2 => json!({"decimate": {"ratio": 1.5}}),
            3 => json!({"remesh": {"edgeLength": -self.edge}}),
            4 => json!({"insertCurve": {"points": [0, 0]}}),
            5 => json!({"weld": {"tolerance": 0}}),
            6 => json!({"merge": {"model": "AAAA", "how": "WELD"}}),
            _ => json!({"cut": {"path": [0, 4294967295u32]}}),
        }
    }

    /// Two handles at the ends of the model along a direction.
    pub fn handles(&self, draw: &mut Draw) -> Value {
        let along = draw.direction();
        let mut heights: Vec<f64> = self.positions.iter().map(|p| p.dot(along)).collect();
        heights.sort_by(f64::total_cmp);
        let at = |part: f64| heights[(part * (heights.len() - 1) as f64) as usize];
        json!([
            {"id": "base", "region": {"halfSpace": {"normal": (-along).to_array(), "offset": -at(0.1)}}},
            {"id": "top", "region": {"halfSpace": {"normal": along.to_array(), "offset": at(0.9)}}},
        ])
    }

    /// A pose of the handle `id`.
    pub fn pose(&self, draw: &mut Draw, id: &str) -> Value {
        let turn = draw.direction() * draw.within(0.0, 0.35);
        let shift = draw.direction() * self.diagonal * draw.within(0.0, 0.05);
        json!({"handles": [{"id": id, "pose": {"rotationVector": turn.to_array(), "translation": shift.to_array()}}]})
    }
}
