//! Files whose decoders run in another process: work that waits for it can be cancelled, when it reads and when it writes.

use crate::support::packed_models::meshopt_of;
use pliant::asset::{
    Error, FileSet, Following, Format, Limits, Model, ParserProcess, ParserStarter, ShapeFollowers, answer_parser_calls,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Progress;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::SeqCst};
use std::time::Duration;

/// Whether processes answer; those that do not are only asked.
static ANSWERS: AtomicBool = AtomicBool::new(true);
/// How often one was asked for an answer that did not come.
static ASKED: AtomicU64 = AtomicU64::new(0);

/// Answers on a thread, or not at all.
struct ThreadParser(UnixStream);

impl Read for ThreadParser {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if ANSWERS.load(SeqCst) {
            return self.0.read(bytes);
        }
        assert!(ASKED.fetch_add(1, SeqCst) < 1000, "it waits for ever");
        Err(io::ErrorKind::WouldBlock.into())
    }
}

impl Write for ThreadParser {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match ANSWERS.load(SeqCst) {
            true => self.0.write(bytes),
            false => Ok(bytes.len()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl ParserProcess for ThreadParser {
    fn allow(&mut self, _: u64) -> io::Result<()> {
        Ok(())
    }

    fn end(&mut self) -> String {
        "ended".into()
    }
}

fn start(_: Duration) -> io::Result<Box<dyn ParserProcess>> {
    let (socket, other) = UnixStream::pair()?;
    std::thread::spawn(move || answer_parser_calls(&mut &other, &mut &other));
    Ok(Box::new(ThreadParser(socket)))
}

/// Gives up once a process was asked.
struct Impatient;

impl Progress for Impatient {
    fn cancelled(&self) -> bool {
        ASKED.load(SeqCst) > 0
    }
}

#[test]
fn who_waits_for_a_process_can_give_up() {
    let limits = Limits {
        apart: Some(ParserStarter {
            start,
            longest: Duration::ZERO,
        }),
        ..Limits::default()
    };
    let packed = meshopt_of(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let read = || {
        let files = FileSet::single("packed.glb", packed.clone());
        Model::read_watched(files, None, &limits, &Impatient)
    };
    let model = read().expect("a model");
    let mut positions = model.positions.clone();
    positions[0].z = 0.5;
    let pool = Pool::new(1).expect("a thread");
    let write = || {
        let followers = ShapeFollowers {
            exec: Some(Exec::new(&pool, &Impatient)),
            ..Following::default().into()
        };
        model.write_following(&positions, Format::GLB, followers)
    };
    write().expect("files");
    ANSWERS.store(false, SeqCst);
    assert!(matches!(write(), Err(Error::Cancelled)));
    ASKED.store(0, SeqCst);
    assert!(matches!(read(), Err(Error::Cancelled)));
}
