//! FBX read in a process of its own: the file goes there, and the GLB comes back.

use super::super::gltf;
use super::scene::FORMAT;
use super::translation::translate_here;
use crate::apart::{AnsweredCalls, DecodedPlace, PROCESS_BYTES, ParserCalls, ParserStarter};
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
    let mut held = files.total_bytes().saturating_add(PROCESS_BYTES);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Format;
    use crate::apart::{ParserProcess, message};
    use std::cell::RefCell;
    use std::io::{Read, Write};
    use std::time::Duration;

    thread_local! {
        /// What the next process says, whatever it is asked.
        static SAID: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    }

    /// A process that is not what it was when it started.
    struct TakenProcess(io::Cursor<Vec<u8>>);

    impl Read for TakenProcess {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            self.0.read(bytes)
        }
    }

    impl Write for TakenProcess {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl ParserProcess for TakenProcess {
        fn allow(&mut self, bytes: u64) -> io::Result<()> {
            assert!(bytes <= ROOM, "{bytes}");
            Ok(())
        }

        fn end(&mut self) -> String {
            "lies".into()
        }
    }

    /// Bytes that the read may hold in all.
    const ROOM: u64 = 8 << 20;

    struct Room;

    impl Progress for Room {
        fn may_hold(&self, bytes: u64) -> bool {
            bytes <= ROOM
        }
    }

    /// What becomes of a file whose process says this.
    fn read(said: Vec<u8>) -> Result<(), String> {
        SAID.set(said);
        let starter = ParserStarter {
            start: |_| Ok(Box::new(TakenProcess(io::Cursor::new(SAID.take())))),
            longest: Duration::ZERO,
        };
        let limits = Limits {
            apart: Some(starter),
            ..Limits::default()
        };
        let files = FileSet::single("a.fbx", "; FBX");
        let read = crate::Model::read_watched(files, Some(Format::FBX), &limits, &Room);
        read.map(drop).map_err(|error| error.to_string())
    }

    #[test]
    fn what_a_process_says_that_lies_is_refused_as_a_file_would_be() {
        let translated = |companions: &[&str]| FbxAnswer::Translated {
            companions: companions.iter().map(ToString::to_string).collect(),
            warnings: Vec::new(),
        };
        let lies = [
            message(&translated(&[]), &[]),
            message(&translated(&["a.png"]), &[b"glTF"]),
            message(&translated(&[]), &[b"glTF", b"more"]),
            message(&FbxAnswer::MayHold(u64::MAX), &[]),
            message(&FbxAnswer::MayHold(ROOM - PROCESS_BYTES / 2), &[]),
            message(&"something else", &[]),
        ];
        for said in lies {
            let text = read(said).expect_err("refused");
            assert!(text.contains("the process that decodes it lies"), "{text}");
        }
        // What it translates is read like any other file.
        assert!(
            read(message(&translated(&[]), &[b"no GLB"]))
                .expect_err("refused")
                .contains("glb")
        );
        // Lengths are refused before anything of them is taken, JSON by what it becomes.
        let claims = |length: u64| [1, length].map(u64::to_le_bytes).concat();
        let names = message(&translated(&[""; 200_000]), &[b"glTF"]);
        let garbage = b"something else than a message".to_vec();
        for said in [claims(u64::MAX), claims(ROOM), names, garbage] {
            let text = read(said).expect_err("refused");
            assert!(text.contains("the memory that reading the model takes"), "{text}");
        }
        // It names no limit that is none.
        let what = "<script>".to_owned();
        let refusal = FbxRefusal::TooLarge {
            what,
            seen: 2,
            limit: 1,
        };
        let text = read(message(&FbxAnswer::Refused(refusal), &[])).expect_err("refused");
        assert!(text.contains("the model"), "{text}");
    }
}
