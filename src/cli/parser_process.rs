//! The process that decodes FBX and meshopt compression for `pliant serve`: how it is started, and what confines it.
//!
//! It is this program, started with a first argument that no help lists. It inherits a socket to the server and nothing else: no other
//! file, no environment. Before it reads from it, it gives up what decoding does not need. It cannot write or open files, start
//! processes, or use the network; a filter of system calls ends it where it tries. The server raises the limit of its memory as far as
//! memory was reserved for it, and ends it when the caller gives up, or after the time that it has; it ends with the server, too.

#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
pub(super) use confined::{answer, is_called, start};
#[cfg(not(all(target_os = "linux", target_pointer_width = "64")))]
pub(super) use unavailable::{answer, is_called, start};

#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
mod confined {
    use crate::asset::{ParserProcess, answer_parser_calls};
    use rustix::process::{
        Pid, Resource, Rlimit, Signal, getrlimit, prlimit, set_parent_process_death_signal, setrlimit,
    };
    use seccompiler::{
        BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
        TargetArch,
    };
    use std::collections::BTreeMap;
    use std::fs::File;
    use std::io::{self, ErrorKind, Read, Write};
    use std::os::fd::{AsFd as _, AsRawFd as _, OwnedFd};
    use std::os::unix::net::UnixStream;
    use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
    use std::process::{Child, Command, ExitCode, Stdio};
    use std::time::{Duration, Instant};

    /// The first argument of the process.
    const ARGUMENT: &str = "parse-apart";

    /// How long the process may take to start.
    const LONGEST_START: Duration = Duration::from_secs(10);

    /// After how long without progress the caller is asked whether it still waits.
    const PATIENCE: Duration = Duration::from_millis(20);

    /// Bytes of memory that the process may take beside what is allowed: of its allocator, and of what is small.
    const SPARE: u64 = 64 << 20;

    /// Numbers that open files of the process may have: input, output, errors, and the socket.
    const FILE_NUMBERS: u64 = 4;

    /// The variable that a debug build of the server reads for tests: what its processes do instead of decoding.
    const FAULT: &str = "FAULT_OF_PARSER";

    /// Whether this is the process.
    pub(in super::super) fn is_called() -> bool {
        std::env::args_os().nth(1).is_some_and(|argument| argument == ARGUMENT)
    }

    /// Gives up what decoding does not need, then decodes until no more calls come. Its first line says how many bytes of memory it holds,
    /// or why it cannot be confined.
    pub(in super::super) fn answer() -> ExitCode {
        // What a panic would print and look up, it may not.
        std::panic::set_hook(Box::new(|_| std::process::abort()));
        let answered = || -> io::Result<()> {
            let socket = File::from(io::stdin().as_fd().try_clone_to_owned()?);
            let (mut input, mut output) = (&socket, &socket);
            let fault = std::env::args().nth(2).filter(|_| cfg!(debug_assertions));
            let confined = match fault.as_deref() {
                Some("early-crash") => std::process::abort(),
                Some("unconfined") => Err(io::Error::other("as a test demands")),
                _ => confine(&socket),
            };
            let said = confined.as_ref().map_or_else(ToString::to_string, u64::to_string);
            output.write_all(format!("{said}\n").as_bytes())?;
            confined?;
            if let Some(fault) = fault {
                fail_as(&fault, &mut input)?;
            }
            answer_parser_calls(&mut input, &mut output)
        };
        answered().map_or(ExitCode::FAILURE, |()| ExitCode::SUCCESS)
    }

    /// Limits this process to memory and `socket`; returns the bytes of memory that it holds.
    fn confine(socket: &File) -> io::Result<u64> {
        set_parent_process_death_signal(Some(Signal::KILL))?;
        let status = std::fs::read_to_string("/proc/self/status")?;
        let size = status
            .lines()
            .find_map(|line| line.strip_prefix("VmSize:")?.strip_suffix("kB"));
        let kilobytes: u64 = size
            .and_then(|size| size.trim().parse().ok())
            .ok_or(ErrorKind::InvalidData)?;
        let held = kilobytes << 10;
        set_limit(Resource::As, held.saturating_add(SPARE))?;
        for (resource, most) in [
            (Resource::Fsize, 0),
            (Resource::Core, 0),
            (Resource::Nofile, FILE_NUMBERS),
        ] {
            set_limit(resource, most)?;
        }
        let machine = TargetArch::try_from(std::env::consts::ARCH);
        let filter = machine.and_then(|machine| call_filter(machine, socket)?.try_into());
        let filter: BpfProgram = filter.map_err(io::Error::other)?;
        seccompiler::apply_filter(&filter).map_err(io::Error::other)?;
        Ok(held)
    }

    fn set_limit(resource: Resource, most: u64) -> io::Result<()> {
        let maximum = getrlimit(resource).maximum;
        let current = Some(maximum.map_or(most, |maximum| most.min(maximum)));
        Ok(setrlimit(resource, Rlimit { current, maximum })?)
    }

    /// The system calls that decoding makes: of its own memory, of the socket, and those that end the process. Any other ends it, also one
    /// of a file that the server itself has inherited.
    fn call_filter(machine: TargetArch, socket: &File) -> Result<SeccompFilter, seccompiler::BackendError> {
        let condition =
            |argument, operator, value| SeccompCondition::new(argument, SeccompCmpArgLen::Dword, operator, value);
        let not_executable = || condition(2, SeccompCmpOp::MaskedEq(libc::PROT_EXEC as u64), 0);
        let anonymous = libc::MAP_ANONYMOUS as u64;
        let of_no_file = condition(3, SeccompCmpOp::MaskedEq(anonymous), anonymous)?;
        let of_socket = || condition(0, SeccompCmpOp::Eq, socket.as_raw_fd() as u64);
        let of_this_process = condition(0, SeccompCmpOp::Eq, std::process::id().into())?;
        let mut rules: BTreeMap<i64, Vec<SeccompRule>> = [
            libc::SYS_close,
            libc::SYS_brk,
            libc::SYS_munmap,
            libc::SYS_mremap,
            libc::SYS_madvise,
            libc::SYS_futex,
            libc::SYS_getrandom,
            libc::SYS_clock_gettime,
            libc::SYS_sched_yield,
            libc::SYS_getpid,
            libc::SYS_gettid,
            libc::SYS_rt_sigaction,
            libc::SYS_rt_sigprocmask,
            libc::SYS_rt_sigreturn,
            libc::SYS_sigaltstack,
            libc::SYS_restart_syscall,
            libc::SYS_exit,
            libc::SYS_exit_group,
        ]
        .map(|call| (call, Vec::new()))
        .into();
        for (call, conditions) in [
            (libc::SYS_read, vec![of_socket()?]),
            (libc::SYS_write, vec![of_socket()?]),
            (libc::SYS_mmap, vec![not_executable()?, of_no_file]),
            (libc::SYS_mprotect, vec![not_executable()?]),
            (libc::SYS_tgkill, vec![of_this_process]),
        ] {
            rules.insert(call, vec![SeccompRule::new(conditions)?]);
        }
        // What a program says when it lacks memory goes to /dev/null.
        let of_errors = condition(0, SeccompCmpOp::Eq, libc::STDERR_FILENO as u64)?;
        rules
            .entry(libc::SYS_write)
            .or_default()
            .push(SeccompRule::new(vec![of_errors])?);
        SeccompFilter::new(rules, SeccompAction::KillProcess, SeccompAction::Allow, machine)
    }

    /// Waits for a call and fails as a test demands.
    fn fail_as(fault: &str, input: &mut impl Read) -> io::Result<()> {
        input.read_exact(&mut [0])?;
        match fault {
            "crash" => std::process::abort(),
            "hang" => loop {
                std::hint::spin_loop();
            },
            "memory" => {
                let mut taken = Vec::new();
                loop {
                    taken.push(std::hint::black_box(vec![1u8; 1 << 20]));
                }
            }
            "open" => File::open("/etc/hostname").map(drop),
            "write" => io::stdout().write_all(b"\n"),
            "panic" => panic!("as a test demands"),
            _ => Ok(()),
        }
    }

    /// The process as the server sees it.
    struct ConfinedParser {
        child: Child,
        socket: UnixStream,
        /// Bytes of memory that it held when it started.
        held: u64,
        until: Instant,
    }

    /// Starts the process, which may work for so long, and waits until it is confined.
    ///
    /// # Errors
    /// When the system does not start or confine it.
    pub(in super::super) fn start(longest: Duration) -> io::Result<Box<dyn ParserProcess>> {
        let (socket, other_end) = UnixStream::pair()?;
        socket.set_read_timeout(Some(PATIENCE))?;
        socket.set_write_timeout(Some(PATIENCE))?;
        // The program that runs, also after its file was replaced.
        let mut command = Command::new("/proc/self/exe");
        command.arg(ARGUMENT);
        if cfg!(debug_assertions) {
            command.args(std::env::var(FAULT).ok());
        }
        let child = command
            .env_clear()
            // Ctrl-C in a terminal goes to a whole group; the server then finishes what it has begun.
            .process_group(0)
            .stdin(OwnedFd::from(other_end))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|error| io::Error::other(format!("/proc/self/exe: {error}")))?;
        // With it goes the other end here: without it, the end of the process is the end of what it says.
        drop(command);
        let mut parser = ConfinedParser {
            child,
            socket,
            held: 0,
            until: Instant::now() + LONGEST_START,
        };
        let (mut said, mut byte) = (String::new(), [0]);
        while byte != *b"\n" {
            match parser.read(&mut byte) {
                Ok(0) => return Err(io::Error::other(format!("the process for it {}", parser.ended()))),
                Ok(_) => said.push(char::from(byte[0])),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
        let confined = said.trim_end().parse();
        parser.held =
            confined.map_err(|_| io::Error::other(format!("no process can be confined: {}", said.trim_end())))?;
        parser.until = Instant::now() + longest;
        Ok(Box::new(parser))
    }

    impl ConfinedParser {
        fn check_time(&self) -> io::Result<()> {
            match Instant::now() < self.until {
                true => Ok(()),
                false => Err(io::Error::new(ErrorKind::TimedOut, "took longer than it may")),
            }
        }

        /// Ends the process; returns how it ended.
        fn ended(&mut self) -> String {
            // It is of no further use, and one that has ended stays ended.
            let _ = self.child.kill();
            let Ok(status) = self.child.wait() else {
                return "cannot be ended".into();
            };
            let signal = match status.signal() {
                None => return format!("failed ({status})"),
                Some(signal) => signal,
            };
            let why = match signal {
                libc::SIGABRT => "it failed, or took more memory than is allowed",
                libc::SIGSEGV | libc::SIGBUS => "it used memory that it does not have",
                libc::SIGSYS => "it asked the system for what it may not do",
                _ => "it was ended from outside",
            };
            format!("was ended by signal {signal}: {why}")
        }
    }

    impl Read for ConfinedParser {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            self.check_time()?;
            self.socket.read(bytes)
        }
    }

    impl Write for ConfinedParser {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.check_time()?;
            self.socket.write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl ParserProcess for ConfinedParser {
        fn allow(&mut self, bytes: u64) -> io::Result<()> {
            // What is reserved are estimates, and lists that grow need twice their room.
            let most = self.held.saturating_add(SPARE).saturating_add(bytes.saturating_mul(2));
            let maximum = getrlimit(Resource::As).maximum;
            let current = Some(maximum.map_or(most, |maximum| most.min(maximum)));
            let process = Pid::from_child(&self.child);
            prlimit(Some(process), Resource::As, Rlimit { current, maximum })?;
            Ok(())
        }

        fn end(&mut self) -> String {
            let ended = self.ended();
            tracing::warn!("the process that decodes a file {ended}");
            ended
        }
    }

    impl Drop for ConfinedParser {
        fn drop(&mut self) {
            self.ended();
        }
    }
}

#[cfg(not(all(target_os = "linux", target_pointer_width = "64")))]
mod unavailable {
    use crate::asset::ParserProcess;
    use std::io;
    use std::process::ExitCode;
    use std::time::Duration;

    pub(in super::super) fn is_called() -> bool {
        false
    }

    pub(in super::super) fn answer() -> ExitCode {
        ExitCode::FAILURE
    }

    pub(in super::super) fn start(_: Duration) -> io::Result<Box<dyn ParserProcess>> {
        Err(io::Error::new(
            io::ErrorKind::Unsupported,
            "only Linux of 64 bits confines a process for it",
        ))
    }
}
