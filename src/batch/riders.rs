//! What a job carries along with its model outside of the mesh: nodes of its file, points and other models.

use crate::asset::{Limits, WrittenFiles};
use crate::engine::{CarriedNode, Deformer, OpenOptions, PassengerKind, RidingFile};
use crate::exec::Exec;
use crate::mesh::carry::CarriedFrame;
use crate::progress::Silent;
use crate::wire::{Error, pb};
use glam::DVec3;

/// Another model, carried to the final shape of a job.
#[derive(Debug, Clone)]
pub struct CarriedFile {
    /// Where it is to be written, below the folder of the job's result.
    pub path: String,
    /// Its files.
    pub written: WrittenFiles,
}

/// Nodes, points and other models that are carried along. Points and models are in the current rest pose: an edit of
/// the current shape makes that shape the rest pose.
pub(super) struct Riders(Vec<Rider>);

struct Rider {
    name: String,
    kind: RiderKind,
}

enum RiderKind {
    /// Nodes of the model's file, which the deformer carries; by the number of their passenger.
    Nodes(usize),
    Points(Vec<CarriedFrame>),
    File {
        file: RidingFile,
        path: String,
    },
}

impl Riders {
    /// Reads those passengers that are not in the mesh.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the passenger for a file that is not a model, or a repeated path.
    pub fn read(options: &OpenOptions, limits: &Limits) -> Result<Self, Error> {
        let mut riders: Vec<Rider> = Vec::new();
        for (k, passenger) in options.passengers.iter().enumerate() {
            let kind = match &passenger.kind {
                PassengerKind::Primitive(_) | PassengerKind::PrimitivesNamed(_) => continue,
                PassengerKind::Node(_) | PassengerKind::NodesNamed(_) => RiderKind::Nodes(k),
                PassengerKind::Points { positions, rotations } => {
                    let places = positions.iter().zip(rotations);
                    let frame = |(&position, &rotation)| CarriedFrame {
                        rotation,
                        ..CarriedFrame::resting(position)
                    };
                    RiderKind::Points(places.map(frame).collect())
                }
                PassengerKind::Model(file) => {
                    let taken = riders
                        .iter()
                        .any(|r| matches!(&r.kind, RiderKind::File { path, .. } if *path == file.path));
                    if taken {
                        let problem = format!("is \"{}\", where an earlier passenger is written", file.path);
                        return Err(Error::invalid(format!("passengers[{k}].file.output"), problem));
                    }
                    let path = file.path.clone();
                    let rule = options.following.large_splats;
                    let file = RidingFile::read(file.clone(), rule, limits, &Silent)
                        .map_err(|e| Error::invalid(format!("passengers[{k}].file"), e.to_string()))?;
                    RiderKind::File { file, path }
                }
            };
            riders.push(Rider {
                name: passenger.name.clone(),
                kind,
            });
        }
        Ok(Self(riders))
    }

    /// Carries all along with a shape of the model, one position per render vertex.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn move_along(&mut self, deformer: &Deformer, positions: &[DVec3], exec: &Exec<'_>) -> Result<(), Error> {
        if self.0.is_empty() {
            return Ok(());
        }
        let carrier = deformer.carrier(positions, exec)?;
        for rider in &mut self.0 {
            exec.progress.report("passengers", 0.0);
            exec.check()?;
            match &mut rider.kind {
                RiderKind::Nodes(_) => {}
                RiderKind::Points(frames) => {
                    let places: Vec<DVec3> = frames.iter().map(|f| f.position).collect();
                    for (frame, moved) in frames.iter_mut().zip(carrier.carry_points(&places, exec)?) {
                        *frame = CarriedFrame {
                            position: moved.position,
                            rotation: moved.rotation * frame.rotation,
                            scale: moved.scale * frame.scale,
                        };
                    }
                }
                RiderKind::File { file, .. } => file.move_along(&carrier, exec)?,
            }
        }
        Ok(())
    }

    /// Returns the reports of all, and the files of the models. `nodes` are those of the model's file in its final
    /// shape, in the order of passengers.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the passenger that cannot be written.
    pub fn write_files(self, nodes: &[CarriedNode]) -> Result<(Vec<pb::report::Passenger>, Vec<CarriedFile>), Error> {
        let (mut reported, mut files) = (Vec::new(), Vec::new());
        for Rider { name, kind } in self.0 {
            let mut message = pb::report::Passenger {
                name,
                ..Default::default()
            };
            match kind {
                RiderKind::Nodes(k) => {
                    let own = &nodes[nodes.partition_point(|node| node.passenger < k)..];
                    let own = &own[..own.partition_point(|node| node.passenger == k)];
                    if let (true, Some(first)) = (message.name.is_empty(), own.first()) {
                        message.name.clone_from(&first.name);
                    }
                    message.nodes = own.iter().map(|node| node.node as u32).collect();
                    let frames: Vec<CarriedFrame> = own.iter().map(|node| node.frame).collect();
                    report_frames(&mut message, &frames);
                }
                RiderKind::Points(frames) => report_frames(&mut message, &frames),
                RiderKind::File { file, path } => {
                    let written = file.write()?;
                    message.output = path.clone();
                    files.push(CarriedFile { path, written });
                }
            }
            reported.push(message);
        }
        Ok((reported, files))
    }
}

fn report_frames(message: &mut pb::report::Passenger, frames: &[CarriedFrame]) {
    message.positions = frames.iter().flat_map(|f| f.position.to_array()).collect();
    message.rotations = frames.iter().flat_map(|f| f.rotation.to_array()).collect();
    message.scales = frames.iter().map(|f| f.scale).collect();
}
