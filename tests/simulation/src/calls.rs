//! The calls that clients make, as a node carries them out.

use crate::engine::bar;
use bytes::Bytes;
use pliant_asset::FileSet;
use pliant_core::engine::{Handle, HandlePose, HandleSet, Region};
use pliant_session::{CallKey, Error, Manager, MemoryUse, StreamAnswer, Tenant};
use pliant_wire::{DeformOptions, PoseCommit, PoseKey, SessionOptions, StreamRequest, json, pb, session_edit};
use std::fmt;

/// A call.
#[derive(Debug, Clone)]
pub enum Call {
    /// Opens a model of points, or the bar where there are none.
    Create {
        points: u64,
    },
    /// Sets so many handles, on the bar its top or both ends.
    Handles {
        count: u64,
        on_bar: bool,
    },
    /// Cuts the bar at so many hundredths.
    Cut {
        height: u64,
    },
    Solve {
        x: u64,
    },
    /// Poses on a stream, the last of them a commit.
    Drag {
        poses: u64,
        x: u64,
    },
    Undo,
    Redo,
    Look,
    Delete,
}

/// What a call was answered with.
#[derive(Debug, Clone, Default)]
pub struct Answered {
    /// The session.
    pub id: String,
    /// Its revision.
    pub revision: u64,
    /// Its history, where it is still at this node.
    pub history: Option<pb::HistoryResponse>,
    /// What must not be.
    pub wrong: Option<String>,
}

impl fmt::Display for Answered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (commits, current) = self.history.as_ref().map_or((0, 0), |h| (h.commits.len(), h.current));
        write!(f, "{} revision {}, at {current} of {commits}", self.id, self.revision)
    }
}

fn key_of(key: &str, call: &Call) -> Option<CallKey> {
    Some(CallKey {
        key: key.to_owned(),
        request: format!("{call:?}").into_bytes(),
    })
}

fn moved(x: u64) -> Vec<(String, HandlePose)> {
    vec![("h0".into(), HandlePose::translation([x as f64 / 1024.0, 0.0, 0.0]))]
}

/// Carries out a call at a node.
///
/// # Errors
/// Those of the call.
pub async fn carry_out(manager: &Manager, id: &str, call: Call, key: String) -> Result<Answered, Error> {
    let me = Tenant::default();
    let mut answered = Answered {
        id: id.to_owned(),
        ..Answered::default()
    };
    let keyed = key_of(&key, &call);
    match call {
        Call::Create { points } => {
            let text = match points {
                0 => bar(),
                points => format!("points {points}"),
            };
            let model = FileSet::single("model.obj", Bytes::from(text));
            let made = manager.create(&me, model, SessionOptions::default(), keyed).await?;
            answered.id = made.value.id;
            answered.revision = 1;
        }
        Call::Handles { count, on_bar } => {
            let ends = [([0.0, 0.0, 1.0], 2.7), ([0.0, 0.0, -1.0], -0.3)];
            let region = |k: usize| match on_bar {
                true => Region::half_space(ends[k % 2].0, ends[k % 2].1),
                false => Region::Component(0),
            };
            let count = if on_bar { count.min(2) } else { count };
            let handles = (0..count as usize).map(|k| Handle::new(format!("h{k}"), region(k)));
            let set: HandleSet = handles.collect::<Vec<_>>().into();
            answered.revision = manager.set_handles(&me, id, set, keyed).await?.revision;
        }
        Call::Solve { x } => {
            let pose = PoseCommit {
                seq: 1,
                changes: moved(x),
                options: DeformOptions::with_defaults(8),
            };
            answered.revision = manager.solve(&me, id, pose, keyed).await?.revision;
        }
        Call::Drag { poses, x } => drag(manager, id, (poses, x), key, &mut answered).await?,
        Call::Cut { height } => {
            let edit = format!(
                r#"{{"cut": {{"plane": {{"normal": [0, 0, 1], "offset": {}}}, "keep": "ABOVE", "fill": true}}}}"#,
                height as f64 / 100.0
            );
            let read = json::from_json(edit.as_bytes()).map_err(Error::from)?;
            let edit = session_edit(&read).map_err(Error::from)?;
            answered.revision = manager.edit(&me, id, edit, keyed).await?.revision;
        }
        Call::Undo => answered.revision = manager.undo(&me, id, Some(&key)).await?.revision,
        Call::Redo => answered.revision = manager.redo(&me, id, Some(&key)).await?.revision,
        Call::Look => drop(manager.positions(&me, id).await?),
        Call::Delete => manager.delete(&me, id).await?,
    }
    answered.history = manager.history(&me, &answered.id).await.ok();
    if matches!(call, Call::Look) && answered.history.is_none() {
        return Err(Error::new(pliant_session::ErrorCode::Unavailable, "it went meanwhile"));
    }
    let held = MemoryUse::ALL.map(|what| manager.metrics().held_bytes(what).get());
    if held.iter().any(|&bytes| bytes < 0) {
        answered.wrong = Some(format!("negative bytes are held: {held:?}"));
    }
    Ok(answered)
}

/// Drags on a stream and commits the last pose. Each pose must be answered once: by a frame, as one that a later frame has
/// superseded, or by an error.
async fn drag(
    manager: &Manager,
    id: &str,
    (poses, x): (u64, u64),
    key: String,
    answered: &mut Answered,
) -> Result<(), Error> {
    let (input, mut output) = manager.stream(&Tenant::default(), id).await?;
    let request = format!("{poses} {x}").into_bytes();
    for seq in 1..=poses {
        let commit = seq == poses;
        let key = key.clone();
        input.push(StreamRequest::Pose {
            more: false,
            seq,
            commit,
            key: commit.then(|| PoseKey {
                key,
                request: request.clone(),
            }),
            entries: Ok(moved(x + poses - seq)
                .into_iter()
                .map(|(id, pose)| (id, Ok(pose)))
                .collect()),
        })?;
        if seq % 7 == 0 {
            tokio::task::yield_now().await;
        }
    }
    input.finish();
    let (mut counted, mut failed, mut ended) = (0, None, None);
    while let Some(answer) = output.next().await {
        match answer {
            StreamAnswer::Frame(frame) => {
                counted += 1 + u64::from(frame.header.superseded);
                let _ = input.push(StreamRequest::Ack(frame.header.seq));
                if frame.header.seq == poses && frame.header.r#final {
                    answered.revision = frame.header.revision;
                }
            }
            StreamAnswer::Failure { error, seq: 0 } => ended = Some(error),
            StreamAnswer::Failure { error, .. } => {
                counted += 1;
                failed = Some(error);
            }
            _ => {}
        }
    }
    if let Some(error) = ended.or(failed) {
        return Err(error);
    }
    if counted != poses {
        answered.wrong = Some(format!("{poses} poses were sent and {counted} answered"));
    }
    Ok(())
}
