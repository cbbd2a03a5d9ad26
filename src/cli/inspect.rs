//! `pliant inspect`: what the solver sees in a model.

use super::failure::CliFailure;
use super::json_output::print_json;
use super::model_files::read_model;
use super::stage_spinner::StageSpinner;
use super::threads::ThreadArgs;
use crate::batch;
use crate::engine::DeformerLimits;
use crate::exec::Exec;
use crate::wire::pb;
use clap::Args;
use std::io::Write as _;
use std::path::PathBuf;

/// Arguments of `pliant inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// The model: glb, gltf, obj, ply, off or stl
    model: PathBuf,
    /// Print everything as JSON on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Runs the command.
pub(super) fn run_inspect(args: &InspectArgs) -> Result<(), CliFailure> {
    let pool = args.threads.start_pool()?;
    let files = read_model(&args.model)?;
    let spinner = StageSpinner::new(args.json);
    let found = batch::inspect(
        files,
        &pb::CreateOptions::default(),
        &DeformerLimits::default(),
        &Exec::new(&pool, &spinner),
    )?;
    spinner.finish();
    if args.json {
        return print_json(&found);
    }
    let text = describe_inspection(&found);
    write!(std::io::stdout(), "{text}").map_err(|e| CliFailure::Internal(format!("cannot write to stdout: {e}")))
}

fn describe_inspection(found: &pb::Inspection) -> String {
    let model = found.model.clone().unwrap_or_default();
    let solver = found.solver.clone().unwrap_or_default();
    let levels: Vec<String> = solver.levels.iter().map(|l| l.vertices.to_string()).collect();
    let yes_no = |b: bool| if b { "yes" } else { "no" };
    let mut text = String::new();
    let mut line = |name: &str, value: String| text.push_str(&format!("{name:<22}{value}\n"));
    line(
        "format",
        format!("{}, {} bytes, sha256 {}", model.format, model.bytes, model.sha256),
    );
    line(
        "render vertices",
        format!("{} in {} primitives", model.vertices, found.primitives.len()),
    );
    line("triangles", model.triangles.to_string());
    line("solver vertices", solver.solver_vertices.to_string());
    line("seam vertices", found.seam_vertices.to_string());
    line(
        "graph",
        format!("{} vertices, {} edges", solver.graph_vertices, solver.graph_edges),
    );
    line("hierarchy", levels.join(" > "));
    line("parts", found.components.to_string());
    line("closed", yes_no(found.closed).into());
    line("holes", found.boundary_loops.to_string());
    line(
        "non-manifold",
        format!(
            "{} edges, {} vertices",
            found.non_manifold_edges, found.non_manifold_vertices
        ),
    );
    line("degenerate faces", found.degenerate_faces.to_string());
    line("duplicate faces", found.duplicate_faces.to_string());
    line("unreferenced", found.unreferenced_vertices.to_string());
    line("box", format!("{:?} to {:?}", found.box_min, found.box_max));
    line("area", found.area.to_string());
    line("volume", found.volume.to_string());
    line("memory estimate", format!("{} MiB", found.memory_estimate >> 20));
    for w in &found.warnings {
        line(&format!("warning {}", w.code), format!(" {}", w.message));
    }
    text
}
