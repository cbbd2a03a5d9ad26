//! An engine whose every cycle the test controls, and the few lines that most tests begin with.
//!
//! Vertex `v` belongs to handle `v % handles` and goes where that handle's translation takes it; a cycle brings it a digit closer.
//! Results of drags differ from those of commits in a late digit that depends on how many drags there were,
//! so that a commit which depended on drags would show.

use crate::support::server::retried;
use bytes::Bytes;
use glam::DVec3;
use pliant::asset::{self, FileSet, Format, WrittenFiles};
use pliant::engine::{
    DeformerFacts, DeformerLimits, Error, Handle, HandleFacts, HandlePose, HandlePoses, HandleSet, MeshCounts,
    ModelFacts, ModelShape, OpenOptions, PoseStats, Region, Shader, SolveMode, SolveSettings, SolveUpdate, SolverFacts,
};
use pliant::exec::Exec;
use pliant::progress::{Cancelled, Progress};
use pliant::session::store::{Store, StoreError, StoreLocation};
use pliant::session::{
    self, CallKey, CommittedPose, Engine, EngineOpener, ExportedModel, Manager, MemoryUse, Metrics, PositionBuffer,
    SessionConfig, StreamAnswer, StreamInput, StreamOutput, Tenant,
};
use pliant::wire::{self, DeformOptions, PoseCommit, SessionEdit, SessionOptions, StreamRequest};
use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::sync::{Arc, Condvar, LazyLock, Mutex};
use std::time::Duration;
use tokio::task::JoinHandle;

/// Lets cycles pass, or holds them.
#[derive(Default)]
pub struct Control {
    knobs: Mutex<Knobs>,
    changed: Condvar,
    /// Solves begun.
    pub solves: AtomicU64,
    /// Cycles done.
    pub cycles: AtomicU64,
    /// By how many billionths results differ from those of other processors.
    pub late_digits: AtomicU64,
}

#[derive(Default)]
struct Knobs {
    held: bool,
    permits: u64,
    waiting: u64,
}

impl Control {
    /// From now on cycles wait for `step` or `release`.
    pub fn hold(&self) {
        self.knobs.lock().expect("no panic").held = true;
    }

    /// Lets `n` cycles pass.
    pub fn step(&self, n: u64) {
        self.knobs.lock().expect("no panic").permits += n;
        self.changed.notify_all();
    }

    /// Lets all cycles pass.
    pub fn release(&self) {
        *self.knobs.lock().expect("no panic") = Knobs::default();
        self.changed.notify_all();
    }

    /// Waits until a cycle waits and all steps are used up.
    pub async fn held_up(&self) {
        until(|| {
            let knobs = self.knobs.lock().expect("no panic");
            knobs.waiting > 0 && knobs.permits == 0
        })
        .await;
    }

    fn cycle(&self, progress: &dyn Progress) -> Result<(), Cancelled> {
        let mut knobs = self.knobs.lock().expect("no panic");
        knobs.waiting += 1;
        loop {
            let done = if progress.cancelled() {
                Err(Cancelled)
            } else if !knobs.held || knobs.permits > 0 {
                knobs.permits = knobs.permits.saturating_sub(1);
                Ok(())
            } else {
                let waited = self
                    .changed
                    .wait_timeout(knobs, Duration::from_millis(1))
                    .expect("no panic");
                knobs = waited.0;
                continue;
            };
            knobs.waiting = knobs.waiting.saturating_sub(1);
            self.cycles.fetch_add(1, SeqCst);
            return done;
        }
    }
}

/// A region that the fake refuses.
pub const NOWHERE: Region = Region::Component(99);

/// Opens [`Fake`]s on texts such as `points 12`.
pub struct OpenFake(pub Arc<Control>);

pub struct Fake {
    rest: Arc<Vec<DVec3>>,
    handles: HandleSet,
    control: Arc<Control>,
    drags: u32,
}

impl EngineOpener for OpenFake {
    fn open(
        &self,
        files: FileSet,
        _options: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Box<dyn Engine>, Error> {
        exec.progress.report("read", 0.0);
        let text = String::from_utf8_lossy(&files.main).into_owned();
        let (word, number) = text.split_once(' ').unwrap_or((&text, "0"));
        let number: u64 = number.trim().parse().unwrap_or(0);
        match word {
            "points" => {}
            "panic" => panic!("opening panics on purpose"),
            "slow" => self.0.cycle(exec.progress)?,
            "large" if number > limits.memory_bytes => {
                return Err(Error::TooLarge {
                    what: "bytes",
                    seen: number,
                    limit: limits.memory_bytes,
                });
            }
            _ => {
                let (format, place) = (Format::OBJ, "line 1".to_owned());
                return Err(asset::Error::Malformed {
                    format,
                    place,
                    problem: format!("\"{word}\""),
                }
                .into());
            }
        }
        exec.progress.report("hierarchy", 0.0);
        let rest = (0..number).map(|v| DVec3::new(v as f64, 0.1, 0.2)).collect();
        let (handles, control) = (HandleSet::default(), Arc::clone(&self.0));
        Ok(Box::new(Fake {
            rest: Arc::new(rest),
            handles,
            control,
            drags: 0,
        }))
    }
}

impl Engine for Fake {
    fn facts(&self) -> DeformerFacts {
        let facts = |h: &Handle| HandleFacts {
            id: h.id.clone(),
            vertices: 0,
            interior_nodes: 0,
            centroid: DVec3::ZERO,
            pivot: DVec3::ZERO,
        };
        DeformerFacts {
            model: ModelFacts {
                format: Format::OBJ,
                file_bytes: 0,
                sha256: String::new(),
                counts: MeshCounts::default(),
            },
            primitives: Vec::new(),
            solver: SolverFacts::default(),
            handles: self.handles.handles.iter().map(facts).collect(),
            warnings: Vec::new(),
            origin: DVec3::ZERO,
        }
    }

    fn rest_shape(&self) -> ModelShape {
        ModelShape::from_positions(Arc::clone(&self.rest))
    }

    fn diagonal(&self) -> f64 {
        1.0
    }

    fn byte_size(&self) -> u64 {
        100 * self.rest.len() as u64
    }

    fn format(&self) -> Format {
        Format::OBJ
    }

    fn set_handles(&mut self, handles: &HandleSet, exec: &Exec<'_>) -> Result<(), Error> {
        exec.progress.report("fields", 0.0);
        self.control.cycle(exec.progress)?;
        if let Some(k) = handles.handles.iter().position(|h| h.region == NOWHERE) {
            let place = format!("handles[{k}].region");
            return Err(Error::invalid(place, "is nowhere"));
        }
        self.handles = handles.clone();
        Ok(())
    }

    fn initial_poses(&self) -> HandlePoses {
        let poses = self.handles.handles.iter().map(|h| h.pose.clone().unwrap_or_default());
        HandlePoses(Arc::new(poses.collect()))
    }

    fn change_poses(&self, poses: &HandlePoses, changes: &[(String, HandlePose)]) -> Result<HandlePoses, Error> {
        let mut all = poses.0.as_ref().clone();
        for (k, (id, pose)) in changes.iter().enumerate() {
            let Some(at) = self.handles.handles.iter().position(|h| h.id == *id) else {
                return Err(Error::invalid(
                    format!("pose.handles[{k}].id"),
                    format!("no handle {id}"),
                ));
            };
            all[at] = pose.clone();
        }
        Ok(HandlePoses(Arc::new(all)))
    }

    fn solve(
        &mut self,
        poses: &HandlePoses,
        settings: &SolveSettings,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<ModelShape, Error> {
        self.control.solves.fetch_add(1, SeqCst);
        let handles = self.handles.handles.len();
        if self
            .handles
            .handles
            .iter()
            .zip(poses.0.iter())
            .any(|(h, p)| h.id == "panic" && p.translation.is_some())
        {
            panic!("solving panics on purpose");
        }
        if mode == SolveMode::Drag {
            self.drags += 1;
        }
        let trace = if mode == SolveMode::Drag {
            f64::from(self.drags) * 1e-9
        } else {
            self.control.late_digits.load(SeqCst) as f64 * 1e-9
        };
        let at = |share: f64| -> Vec<DVec3> {
            let moved = |(v, &p): (usize, &DVec3)| match poses.0[v % handles].translation {
                // How many handles there are shows too, so that a replay with other handles would.
                Some(by) => p + by * share + DVec3::splat(trace) * handles as f64,
                None => p,
            };
            self.rest.iter().enumerate().map(moved).collect()
        };
        let mut cycles = 0;
        let residual = loop {
            self.control.cycle(exec.progress)?;
            cycles += 1;
            let residual = 1.0 / 10f64.powi(cycles as i32);
            let watched = SolveUpdate {
                refined: 0,
                cycle: cycles,
                residual,
                max_error: residual,
                positions: &|| at(1.0 - residual),
            };
            if !watch(&watched) || residual <= settings.quality.tolerance.unwrap_or(1e-4) {
                break residual;
            }
        };
        let positions = Arc::new(at(if residual <= 1e-4 { 1.0 } else { 1.0 - residual }));
        Ok(ModelShape {
            stats: PoseStats {
                cycles,
                refined: 0,
                residual,
                max_error: residual,
                solver: "fake",
            },
            ..ModelShape::from_positions(positions)
        })
    }

    fn write(&self, positions: &[DVec3], format: Format, _exec: &Exec<'_>) -> Result<WrittenFiles, Error> {
        if format == Format::STL {
            return Err(asset::Error::Unwritable {
                format,
                problem: "this engine writes no stl".into(),
            }
            .into());
        }
        Ok(WrittenFiles {
            main: format!("{format} {positions:?}").into_bytes(),
            ..Default::default()
        })
    }

    fn shader(&self) -> Shader {
        Shader::default()
    }
}

/// Waits until something holds, for as long as a loaded machine may need.
pub async fn until(holds: impl Fn() -> bool) {
    retried("a condition", Duration::from_millis(1), async || holds().then_some(())).await;
}

/// The store of a folder, once the manager that had it before has left it.
pub async fn store_at(location: &StoreLocation) -> Store {
    retried("a store", Duration::from_millis(5), async || {
        match Store::open(location).await {
            Ok(store) => Some(store),
            Err(StoreError::Refused(_)) => None,
            Err(error) => panic!("{error}"),
        }
    })
    .await
}

/// Ends a manager whose store another one is to open.
pub async fn close(manager: Manager) {
    manager.abort();
    until(|| manager.metrics().sessions.get() == 0).await;
}

/// A session and its manager; its calls must succeed.
#[derive(Clone)]
pub struct Fixture {
    pub manager: Manager,
    pub id: String,
}

impl Fixture {
    /// A session of the fake as [`open`] makes it, and what controls its cycles.
    pub async fn fake(config: SessionConfig) -> (Self, Arc<Control>) {
        let (manager, control) = manager(config);
        (Self::of(&manager).await, control)
    }

    /// As [`Fixture::fake`], with a stream of the session.
    pub async fn streamed() -> (Self, Arc<Control>, StreamClient) {
        let (fixture, control) = Self::fake(small()).await;
        let client = fixture.client().await;
        (fixture, control, client)
    }

    /// As [`Fixture::fake`], with changed limits.
    pub async fn with(change: impl FnOnce(&mut SessionConfig)) -> (Self, Arc<Control>) {
        Self::fake(limits(change)).await
    }

    /// As [`Fixture::fake`], in a manager that there is.
    pub async fn of(manager: &Manager) -> Self {
        let (id, manager) = (open(manager).await, manager.clone());
        Self { manager, id }
    }

    pub async fn client(&self) -> StreamClient {
        StreamClient::open(&self.manager, &self.id).await
    }

    pub async fn solve(&self, commit: PoseCommit) -> CommittedPose {
        let solved = self.manager.solve(tenant(), &self.id, commit, None).await;
        solved.expect("the session solves")
    }

    /// Begins to solve.
    pub fn solving(&self, commit: PoseCommit) -> JoinHandle<Result<CommittedPose, session::Error>> {
        let Self { manager, id } = self.clone();
        tokio::spawn(async move { manager.solve(tenant(), &id, commit, None).await })
    }

    /// The refusal of a pose.
    pub async fn refuses(&self, commit: PoseCommit) -> session::Error {
        let solved = self.manager.solve(tenant(), &self.id, commit, None).await;
        solved.map(|_| ()).expect_err("the pose is refused")
    }

    /// Poses `a`, which the session solves.
    pub async fn solve_a(&self, x: f64) -> CommittedPose {
        self.solve(solve(&[("a", x)])).await
    }

    pub async fn edit(&self, edit: SessionEdit) -> wire::pb::EditResult {
        let edited = self.manager.edit(tenant(), &self.id, edit, None).await;
        edited.expect("the session is edited")
    }

    pub async fn set_handles(&self, handles: HandleSet) -> wire::pb::Session {
        let set = self.manager.set_handles(tenant(), &self.id, handles, None).await;
        set.expect("the handles are set")
    }

    pub async fn undo(&self) -> wire::pb::Session {
        let undone = self.manager.undo(tenant(), &self.id, None).await;
        undone.expect("a commit is undone")
    }

    pub async fn redo(&self) -> wire::pb::Session {
        let redone = self.manager.redo(tenant(), &self.id, None).await;
        redone.expect("a commit is redone")
    }

    pub async fn facts(&self) -> wire::pb::Session {
        let facts = self.manager.get(tenant(), &self.id).await;
        facts.expect("the session is open")
    }

    pub async fn history(&self) -> wire::pb::HistoryResponse {
        let history = self.manager.history(tenant(), &self.id).await;
        history.expect("the session is open")
    }

    /// The digest of the current commit.
    pub async fn digest(&self) -> String {
        let history = self.history().await;
        let current = history.commits.iter().find(|c| c.revision == history.current);
        current.expect("the current commit is listed").digest.clone()
    }

    pub async fn positions(&self) -> PositionBuffer {
        let positions = self.manager.positions(tenant(), &self.id).await;
        positions.expect("the session is open")
    }

    pub async fn export(&self, format: Option<Format>) -> ExportedModel {
        let exported = self.manager.export(tenant(), &self.id, format).await;
        exported.expect("the model is written")
    }

    pub fn metrics(&self) -> &Metrics {
        self.manager.metrics()
    }

    /// Bytes that sessions hold.
    pub fn held_bytes(&self) -> i64 {
        self.metrics().held_bytes(MemoryUse::Sessions).get()
    }
}

pub fn tenant() -> &'static Tenant {
    static ME: LazyLock<Tenant> = LazyLock::new(Tenant::default);
    &ME
}

pub fn small() -> SessionConfig {
    SessionConfig {
        compute_threads: 2,
        ..SessionConfig::default()
    }
}

/// Such a configuration with other limits.
pub fn limits(change: impl FnOnce(&mut SessionConfig)) -> SessionConfig {
    let mut config = small();
    change(&mut config);
    config
}

pub fn manager(config: SessionConfig) -> (Manager, Arc<Control>) {
    let control = Arc::new(Control::default());
    (
        Manager::with_opener(config, OpenFake(Arc::clone(&control))).expect("a valid configuration"),
        control,
    )
}

pub fn model(text: &str) -> FileSet {
    FileSet::single("model.obj", Bytes::copy_from_slice(text.as_bytes()))
}

/// A session of four vertices with the handles `a` and `b`; vertices 0 and 2 are a's.
pub async fn open(manager: &Manager) -> String {
    let id = create(manager, "points 4").await;
    manager
        .set_handles(tenant(), &id, handles(&["a", "b"]), None)
        .await
        .expect("two handles");
    id
}

pub async fn create(manager: &Manager, text: &str) -> String {
    let made = manager.create(tenant(), model(text), options(), None).await;
    made.expect("a session").value.id
}

/// Options of a session that asks for nothing.
pub fn options() -> SessionOptions {
    SessionOptions::default()
}

pub fn key(key: &str, request: impl std::fmt::Debug) -> Option<CallKey> {
    Some(CallKey {
        key: key.into(),
        request: format!("{request:?}").into_bytes(),
    })
}

pub fn handles(ids: &[&str]) -> HandleSet {
    let handle = |id: &&str| Handle::new(*id, Region::Component(0));
    ids.iter().map(handle).collect::<Vec<_>>().into()
}

fn along_x(entries: &[(&str, f64)]) -> Vec<(String, HandlePose)> {
    let pose = |(id, x): &(&str, f64)| ((*id).to_owned(), HandlePose::translation([*x, 0.0, 0.0]));
    entries.iter().map(pose).collect()
}

/// A pose on a stream; one that is not finite is one that `wire` would refuse.
pub fn pose(seq: u64, entries: &[(&str, f64)], commit: bool) -> StreamRequest {
    posed(seq, along_x(entries), commit)
}

pub fn posed(seq: u64, changes: Vec<(String, HandlePose)>, commit: bool) -> StreamRequest {
    let read = |(id, pose): (String, HandlePose)| match pose.translation {
        Some(by) if !by.is_finite() => {
            let field = "pose.handles[0].pose.translation";
            (id, Err(wire::Error::invalid(field, "is not finite")))
        }
        _ => (id, Ok(pose)),
    };
    StreamRequest::Pose {
        more: false,
        seq,
        commit,
        key: None,
        entries: Ok(changes.into_iter().map(read).collect()),
    }
}

pub fn solve(entries: &[(&str, f64)]) -> PoseCommit {
    PoseCommit {
        seq: 1,
        changes: along_x(entries),
        options: stream_options(),
    }
}

/// Options that ask for nothing.
pub fn stream_options() -> DeformOptions {
    DeformOptions::with_defaults(8)
}

/// The client of one stream.
pub struct StreamClient {
    pub input: StreamInput,
    pub output: StreamOutput,
}

/// A frame: its header, how far each of its vertices is from rest along x, and which they are when it carries changes only.
#[derive(Debug, Clone)]
pub struct SeenFrame {
    pub header: wire::pb::Frame,
    pub x: Vec<f64>,
    pub selected: Option<Vec<u32>>,
}

impl StreamClient {
    pub async fn open(manager: &Manager, id: &str) -> Self {
        let (input, output) = manager.stream(tenant(), id).await.expect("a stream");
        Self { input, output }
    }

    pub fn push(&self, request: StreamRequest) {
        self.input.push(request).expect("the stream is open");
    }

    pub fn drag(&self, seq: u64, entries: &[(&str, f64)]) {
        self.push(pose(seq, entries, false));
    }

    pub fn commit(&self, seq: u64, entries: &[(&str, f64)]) {
        self.push(pose(seq, entries, true));
    }

    pub fn ack(&self, seq: u64) {
        self.push(StreamRequest::Ack(seq));
    }

    /// Sends options that differ from those that ask for nothing.
    pub fn options(&self, change: impl FnOnce(&mut DeformOptions)) {
        let mut options = stream_options();
        change(&mut options);
        self.push(StreamRequest::Options(Ok(options)));
    }

    /// Drags `a` to 1, and waits until that is held up in its first cycle.
    pub async fn drag_held_up(&self, control: &Control) {
        control.hold();
        self.drag(1, &[("a", 1.0)]);
        control.held_up().await;
    }

    /// The next answer; panics when none comes.
    pub async fn next(&mut self) -> Option<StreamAnswer> {
        let next = tokio::time::timeout(Duration::from_secs(30), self.output.next()).await;
        next.expect("an answer comes")
    }

    /// The next answer, which must be a frame.
    pub async fn frame(&mut self) -> SeenFrame {
        match self.next().await {
            Some(StreamAnswer::Frame(frame)) => {
                let x = frame.positions.iter().enumerate().map(|(v, p)| p.x - v as f64);
                SeenFrame {
                    x: x.map(|x| (x * 1e4).round() / 1e4).collect(),
                    header: frame.header,
                    selected: frame.selected,
                }
            }
            other => panic!("a frame was expected, not {other:?}"),
        }
    }

    /// The next answer, which must be a failure: the number of the pose, and what is wrong with it.
    pub async fn error(&mut self) -> (u64, session::Error) {
        match self.next().await {
            Some(StreamAnswer::Failure { error, seq }) => (seq, error),
            other => panic!("an error was expected, not {other:?}"),
        }
    }

    /// Asserts that nothing comes but the answer to a ping.
    pub async fn silent(&mut self) {
        self.push(StreamRequest::Ping(77));
        let next = self.next().await;
        assert!(matches!(next, Some(StreamAnswer::Pong(77))), "{next:?}");
        let more = tokio::time::timeout(Duration::from_millis(30), self.output.next()).await;
        assert!(more.is_err(), "nothing was expected, not {more:?}");
    }
}
