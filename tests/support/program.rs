//! The server as a program of its own, which a test can kill.

use super::server::{AnsweredCall as _, Socket, http, retried, within};
use reqwest::RequestBuilder;
use rustix::process::{Pid, WaitId, WaitIdOptions, waitid};
use serde_json::Value;
use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A running program. Dropping it kills it.
pub struct ServedProgram {
    child: Child,
    pub url: String,
    log: PathBuf,
}

impl ServedProgram {
    /// Starts the server with a folder for its sessions. Its log goes to a file beside that folder.
    pub fn start(folder: &Path, arguments: &[&str]) -> Self {
        Self::try_start(folder, arguments).expect("the server starts")
    }

    /// Starts the server with sessions in memory alone.
    pub fn start_in_memory(log: PathBuf, arguments: &[&str]) -> Self {
        Self::start_anywhere(log, arguments, &[]).expect("the server starts")
    }

    /// As `start`; the log when it does not come up.
    pub fn try_start(folder: &Path, arguments: &[&str]) -> Result<Self, String> {
        let log = folder.with_extension("log");
        let arguments = [&["--data-dir", folder.to_str().expect("UTF-8")], arguments].concat();
        Self::start_anywhere(log, &arguments, &[])
    }

    /// Starts the server with arguments and variables alone; the log when it does not come up.
    pub fn start_anywhere(log: PathBuf, arguments: &[&str], variables: &[(&str, &str)]) -> Result<Self, String> {
        // A limit on the size of files ends a process that has not asked for something else.
        let mut command = Command::new("sh");
        let somewhere = ["--listen", "127.0.0.1:0"];
        let is_reported = arguments.contains(&"--listen");
        command
            .args([
                "-c",
                "trap '' XFSZ; exec \"$@\"",
                "sh",
                env!("CARGO_BIN_EXE_pliant"),
                "serve",
            ])
            .args(if is_reported { &[][..] } else { &somewhere[..] })
            .args(["--threads", "2"])
            .args(arguments)
            .envs(variables.iter().copied())
            .env_remove("PLIANT_CONFIG")
            .stdout(Stdio::piped())
            .stderr(File::create(&log).expect("a log"));
        let mut child = command.spawn().expect("the program starts");
        let mut line = String::new();
        let stdout = child.stdout.take().expect("piped");
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        // With a log of JSON it is a line of that form.
        let said = match serde_json::from_str::<Value>(&line) {
            Ok(line) => super::server::text(&line["message"]),
            Err(_) => line,
        };
        match said.trim().strip_prefix("listening on ") {
            Some(url) => Ok(Self {
                child,
                url: url.to_owned(),
                log,
            }),
            None => {
                let _ = child.wait();
                Err(std::fs::read_to_string(log).unwrap_or_default())
            }
        }
    }

    /// The process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// What it logged so far.
    pub fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Ends it as a crash does: at once.
    pub fn kill(mut self) {
        self.child.kill().expect("it runs");
        self.child.wait().expect("it ends");
    }

    /// Sends it a signal, such as `-CONT`, which lets it go on after [`ServedProgram::pause`].
    pub fn signal(&self, name: &str) {
        let done = Command::new("kill").args([name, &self.id().to_string()]).status();
        assert!(done.expect("kill runs").success());
    }

    /// Stops it where it is. It does nothing more once this returns; after the signal alone its threads go on until they notice.
    pub fn pause(&self) {
        self.signal("-STOP");
        let stopped = waitid(WaitId::Pid(Pid::from_child(&self.child)), WaitIdOptions::STOPPED);
        assert!(stopped.expect("a child").is_some_and(|status| status.stopped()));
    }

    /// Asks it to stop, and returns at once.
    pub fn ask_to_stop(&self) {
        self.signal("-TERM");
    }

    /// Asks it to stop and waits for its end, which has to be a good one.
    pub async fn stop(mut self) {
        self.ask_to_stop();
        let pause = std::time::Duration::from_millis(5);
        let ended = retried("the end", pause, async || self.child.try_wait().expect("a child")).await;
        assert_eq!(ended.code(), Some(0), "{}", self.log());
    }

    /// Makes a call; the status and the JSON of the answer, null where there is none.
    pub async fn call(&self, method: &str, path: &str, body: Option<&Value>) -> (u16, Value) {
        self.call_with_key(method, path, body, None).await
    }

    /// As `call`, with an idempotency key.
    pub async fn call_with_key(
        &self,
        method: &str,
        path: &str,
        body: Option<&Value>,
        key: Option<&str>,
    ) -> (u16, Value) {
        let method = method.parse().expect("a method");
        let mut request = http().request(method, format!("{}{path}", self.url));
        if let Some(body) = body {
            request = request.json(body);
        }
        if let Some(key) = key {
            request = request.header("idempotency-key", key);
        }
        let answer = within(path, request.send()).await.expect("an answer");
        let status = answer.status().as_u16();
        let text = within(path, answer.text()).await.expect("a body");
        (status, serde_json::from_str(&text).unwrap_or(Value::Null))
    }

    /// As `call`, of a server that may end meanwhile; the status of a whole answer.
    pub async fn try_call(&self, method: &str, path: &str, body: Option<&Value>) -> Option<u16> {
        let method = method.parse().expect("a method");
        let mut request = http().request(method, format!("{}{path}", self.url));
        if let Some(body) = body {
            request = request.json(body);
        }
        let answer = within(path, request.send()).await.ok()?;
        let status = answer.status().as_u16();
        within(path, answer.bytes()).await.ok()?;
        Some(status)
    }

    /// A call that must succeed.
    pub async fn done(&self, method: &str, path: &str, body: Option<&Value>) -> Value {
        let (status, answer) = self.call(method, path, body).await;
        assert!(
            (200..300).contains(&status),
            "{method} {path}: {status} {answer}\n{}",
            self.log()
        );
        answer
    }

    pub fn get(&self, path: &str) -> RequestBuilder {
        http().get(format!("{}{path}", self.url))
    }

    pub fn post(&self, path: &str) -> RequestBuilder {
        http().post(format!("{}{path}", self.url))
    }

    pub fn put(&self, path: &str) -> RequestBuilder {
        http().put(format!("{}{path}", self.url))
    }

    pub fn delete(&self, path: &str) -> RequestBuilder {
        http().delete(format!("{}{path}", self.url))
    }

    /// A WebSocket on a path.
    pub async fn socket(&self, path: &str) -> Socket {
        let url = format!("{}{path}", self.url.replace("http", "ws"));
        Socket::connect(&url).await.expect("a stream")
    }

    /// Opens a session on a model.
    pub async fn open(&self, model: String, query: &str) -> String {
        let answer = self.post(&format!("/v1/sessions{query}")).body(model).answer().await;
        let status = answer.status();
        let session: Value = answer.json().await.expect("JSON");
        assert_eq!(status.as_u16(), 201, "{session}");
        super::server::text(&session["id"])
    }

    /// The current vertices, as the server sends them.
    pub async fn positions(&self, id: &str) -> Vec<u8> {
        let answer = self.get(&format!("/v1/sessions/{id}/positions")).answer().await;
        assert_eq!(answer.status().as_u16(), 200, "{}", self.log());
        answer.bytes().await.expect("a body").to_vec()
    }
}

impl Drop for ServedProgram {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A token for a tenant, and the lines of the configuration that admit it.
pub fn new_token() -> (String, String) {
    let made = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .args(["token", "studio"])
        .output();
    let made = String::from_utf8(made.expect("it runs").stdout).expect("UTF-8");
    let (token, lines) = made.split_once('\n').expect("a token and its lines");
    (token.to_owned(), lines.to_owned())
}
