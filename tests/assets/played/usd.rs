//! Animations as USD text: the same points as in every other output, under what carries them.

use super::{FRAMES, animate_bar, bar_folder, farthest, read_cache};
use crate::support::data::report_skipped;
use glam::{DQuat, DVec3};
use std::fs;
use std::path::Path;
use std::process::Command;

/// The lists of numbers of a block of time samples, by frame.
fn samples(text: &str, name: &str) -> Vec<Vec<f64>> {
    let (_, block) = text.split_once(&format!("{name}.timeSamples = {{")).expect(name);
    let (block, _) = block.split_once('}').expect("an end");
    let mut all = Vec::new();
    for line in block.lines().filter(|l| !l.trim().is_empty()) {
        let (frame, values) = line.split_once(':').expect("a time code");
        assert_eq!(frame.trim(), all.len().to_string());
        let numbers = values.split(|c: char| "()[], ".contains(c)).filter(|n| !n.is_empty());
        all.push(numbers.map(|n| n.parse().expect("a number")).collect());
    }
    all
}

fn points(numbers: &[f64]) -> Vec<DVec3> {
    numbers.chunks(3).map(DVec3::from_slice).collect()
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).expect("a file")
}

#[test]
fn usd_has_the_points_of_every_frame_below_what_carries_them() {
    let folder = &bar_folder();
    animate_bar(folder, "-o bar.pc2");
    animate_bar(folder, "-o baked.usda --root baked");
    animate_bar(folder, "-o node.usda");
    let (_, frames) = read_cache(&folder.join("bar.pc2"));
    let (baked, node) = (read(&folder.join("baked.usda")), read(&folder.join("node.usda")));
    for text in [&baked, &node] {
        assert!(text.starts_with("#usda 1.0\n"), "{}", &text[..40]);
        for line in [
            "startTimeCode = 0",
            "endTimeCode = 11",
            "timeCodesPerSecond = 4",
            "upAxis = \"Y\"",
            "metersPerUnit = 1",
        ] {
            assert!(text.contains(line), "{line}");
        }
        assert!(
            text.contains("interpolation = \"faceVarying\""),
            "the seam of its texture coordinates stays"
        );
    }
    assert!(!baked.contains("xformOp"));
    let (shifts, turns) = (samples(&node, "xformOp:translate"), samples(&node, "xformOp:orient"));
    let (of_baked, of_node) = (samples(&baked, "points"), samples(&node, "points"));
    let extents = samples(&baked, "extent");
    assert_eq!(
        [of_baked.len(), of_node.len(), shifts.len(), extents.len()],
        [FRAMES; 4]
    );
    for (k, frame) in frames.iter().enumerate() {
        assert!(farthest(&points(&of_baked[k]), frame) < 1e-6, "frame {k}");
        let turn = DQuat::from_xyzw(turns[k][1], turns[k][2], turns[k][3], turns[k][0]);
        let carried = points(&of_node[k])
            .into_iter()
            .map(|p| turn * p + DVec3::from_slice(&shifts[k]));
        assert!(farthest(&carried.collect::<Vec<_>>(), frame) < 1e-5, "frame {k}");
        let corners = points(&extents[k]);
        let all = points(&of_baked[k]);
        assert!(
            all.iter()
                .all(|p| p.cmpge(corners[0]).all() && p.cmple(corners[1]).all())
        );
    }
    check_with_usd(&folder.join("node.usda"));
}

/// Lets the reader of USD's own library say what it sees, where python has it.
fn check_with_usd(path: &Path) {
    let program = "import sys\nfrom pxr import Usd, UsdGeom\ns = Usd.Stage.Open(sys.argv[1])\n\
        m = [UsdGeom.Mesh(p) for p in s.Traverse() if p.IsA(UsdGeom.Mesh)]\n\
        assert UsdGeom.Mesh.ValidateTopology(m[0].GetFaceVertexIndicesAttr().Get(), m[0].GetFaceVertexCountsAttr().Get(), \
        len(m[0].GetPointsAttr().Get(0)))[0]\nprint(len(m), m[0].GetPointsAttr().GetNumTimeSamples(), s.GetEndTimeCode())";
    let asked = Command::new("python3").args(["-c", program]).arg(path).output();
    match asked {
        Ok(said) if said.status.success() => {
            assert_eq!(String::from_utf8_lossy(&said.stdout).trim(), format!("1 {FRAMES} 11.0"));
        }
        Ok(said) if !String::from_utf8_lossy(&said.stderr).contains("No module named") => {
            panic!("{}", String::from_utf8_lossy(&said.stderr))
        }
        _ => report_skipped("USD by its own library", "python3 has no pxr (usd-core)"),
    }
}
