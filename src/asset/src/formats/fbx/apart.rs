//! FBX read in a process of its own: the file goes there, and the GLB comes back.

use super::super::gltf;
use super::scene::FORMAT;
use super::translation::translate_here;
use crate::apart::{AnsweredCalls, DecodedPlace, ParserCalls, ParserStarter};
use crate::codec::Translation;
use crate::files::ReadWatch;
use crate::{Error, FileSet, Limits};
use pliant_exec::progress::Progress;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io;
use std::sync::{Mutex, PoisonError};

/// What calls of this decoder name.
pub(in super::super) const DECODER: &str = "fbx";

/// Bytes that the process may hold before it asks for more, beside the files.
const FIRST_BYTES: u64 = 1 << 20;

/// A file to be read; its parts are the main file and the companions.
#[derive(Serialize, Deserialize)]
struct FbxCall {
    name: String,
    companions: Vec<String>,
    /// Vertices, triangles, bytes of decoding and of documents.
    limits: [u64; 4],
}

/// What the process says of it.
#[derive(Serialize, Deserialize)]
enum FbxAnswer {
    /// Whether so many bytes may be held; answered with true or false.
    MayHold(u64),
    /// The parts are the GLB and the companions of these names.
    Translated {
        companions: Vec<String>,
        warnings: Vec<(String, String, String)>,
    },
    Refused(FbxRefusal),
}

/// Why a file is not read.
#[derive(Serialize, Deserialize)]
enum FbxRefusal {
    Malformed {
        place: String,
        problem: String,
    },
    Unsupported {
        place: String,
        problem: String,
        hint: String,
    },
    TooLarge {
        what: String,
        seen: u64,
        limit: u64,
    },
    NoMesh(String),
    Other(String),
}

impl From<Error> for FbxRefusal {
    fn from(error: Error) -> Self {
        match error {
            Error::Malformed { place, problem, .. } => Self::Malformed { place, problem },
            Error::Unsupported {
                place, problem, hint, ..
            } => Self::Unsupported { place, problem, hint },
            Error::TooLarge { what, seen, limit } => Self::TooLarge {
                what: what.to_owned(),
                seen,
                limit,
            },
            Error::NoMesh { problem, .. } => Self::NoMesh(problem),
            other => Self::Other(other.to_string()),
        }
    }
}

impl From<FbxRefusal> for Error {
    fn from(refusal: FbxRefusal) -> Self {
        match refusal {
            FbxRefusal::Malformed { place, problem } => Self::malformed(FORMAT, place, problem),
            FbxRefusal::Unsupported { place, problem, hint } => Self::unsupported(FORMAT, place, problem, hint),
            FbxRefusal::TooLarge { what, seen, limit } => Self::TooLarge {
                what: Limits::NAMES
                    .into_iter()
                    .find(|name| *name == what)
                    .unwrap_or("the model"),
                seen,
                limit,
            },
            FbxRefusal::NoMesh(problem) => Self::NoMesh {
                format: FORMAT,
                problem,
            },
            FbxRefusal::Other(problem) => Self::malformed(FORMAT, "file", problem),
        }
    }
}

/// Has a file translated in a process of its own. What that process holds is reserved through `watch` before.
pub(super) fn translate(starter: ParserStarter, files: &FileSet, watch: &ReadWatch<'_>) -> Result<Translation, Error> {
    let at = DecodedPlace {
        place: "file",
        progress: watch.progress(),
    };
    let mut held = files.total_bytes().saturating_add(FIRST_BYTES);
    watch.reserve_apart(held)?;
    let mut calls = ParserCalls::start(starter, FORMAT)?;
    calls.allow(held, at)?;
    let call = FbxCall {
        name: files.name.clone(),
        companions: files.companions.keys().cloned().collect(),
        limits: [
            watch.vertices,
            watch.triangles,
            watch.decoded_bytes,
            watch.document_bytes,
        ],
    };
    let companions = files.companions.values().map(|bytes| &**bytes);
    let parts: Vec<&[u8]> = [&*files.main].into_iter().chain(companions).collect();
    calls.send(&(DECODER, call), &parts, at)?;
    loop {
        let mut taken: u64 = 0;
        let (answer, mut parts) = calls.receive(at, &mut |bytes| {
            taken = taken.saturating_add(bytes);
            watch.reserve_apart(held.saturating_add(taken))
        })?;
        match answer {
            FbxAnswer::MayHold(bytes) => {
                let may_hold = watch.reserve_apart(bytes).is_ok();
                if may_hold {
                    held = held.max(bytes);
                    calls.allow(held, at)?;
                }
                calls.send(&may_hold, &[], at)?;
            }
            FbxAnswer::Translated { companions, warnings } if parts.len() == 1 + companions.len() => {
                let main = parts.remove(0).into();
                return Ok(Translation {
                    files: FileSet {
                        name: files.name.clone(),
                        main,
                        companions: companions.into_iter().zip(parts.into_iter().map(Into::into)).collect(),
                    },
                    format: gltf::GLB_FORMAT,
                    warnings,
                });
            }
            FbxAnswer::Translated { .. } => return Err(calls.unexpected(at)),
            FbxAnswer::Refused(refusal) => return Err(refusal.into()),
        }
    }
}

/// Asks the other side for memory.
struct AskedMemory<'c, 'a>(Mutex<&'c mut AnsweredCalls<'a>>);

impl Progress for AskedMemory<'_, '_> {
    fn may_hold(&self, bytes: u64) -> bool {
        let mut calls = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let asked = calls.write(&FbxAnswer::MayHold(bytes), &[]);
        asked
            .and_then(|()| calls.read::<bool>())
            .is_ok_and(|(may_hold, _)| may_hold)
    }
}

/// Answers a call of [`translate`], in the other process.
pub(in super::super) fn answer(call: Value, mut parts: Vec<Vec<u8>>, calls: &mut AnsweredCalls<'_>) -> io::Result<()> {
    let call: FbxCall = serde_json::from_value(call)?;
    let main = parts.remove(0).into();
    let files = FileSet {
        name: call.name,
        main,
        companions: call
            .companions
            .into_iter()
            .zip(parts.into_iter().map(Into::into))
            .collect(),
    };
    let [vertices, triangles, decoded_bytes, document_bytes] = call.limits;
    let limits = Limits {
        vertices,
        triangles,
        decoded_bytes,
        document_bytes,
        ..Limits::default()
    };
    let memory = AskedMemory(Mutex::new(calls));
    let translated = translate_here(&files, &ReadWatch::new(&limits, &memory, files.total_bytes()));
    let calls = memory.0.into_inner().unwrap_or_else(PoisonError::into_inner);
    match translated {
        Err(error) => calls.write(&FbxAnswer::Refused(error.into()), &[]),
        Ok(Translation { files, warnings, .. }) => {
            let answer = FbxAnswer::Translated {
                companions: files.companions.keys().cloned().collect(),
                warnings,
            };
            let companions = files.companions.values().map(|bytes| &**bytes);
            let parts: Vec<&[u8]> = [&*files.main].into_iter().chain(companions).collect();
            calls.write(&answer, &parts)
        }
    }
}
