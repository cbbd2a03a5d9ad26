//! An agent's end of stdio: a line of JSON there, a line back.

use crate::support::commands::pliant_in;
use crate::support::server::text;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Stdio};

/// The program with an agent at its other end.
pub struct Agent {
    child: Child,
    to: Option<ChildStdin>,
    from: BufReader<ChildStdout>,
    last: u64,
}

impl Agent {
    /// Starts the program on a folder and shakes hands.
    pub fn start(folder: &Path) -> Self {
        let mut command = pliant_in(folder, &["mcp"]);
        let started = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let mut child = started.expect("the program starts");
        let mut agent = Self {
            to: child.stdin.take(),
            from: BufReader::new(child.stdout.take().expect("piped")),
            child,
            last: 0,
        };
        let info = json!({"name": "test", "version": "1"});
        let hello = agent.request(
            "initialize",
            json!({"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": info}),
        );
        assert_eq!(hello["result"]["serverInfo"]["name"], "pliant", "{hello}");
        agent.send(&json!({"jsonrpc": "2.0", "method": "notifications/initialized"}).to_string());
        agent
    }

    /// Sends a line.
    pub fn send(&mut self, line: &str) {
        let to = self.to.as_mut().expect("open");
        to.write_all(line.as_bytes())
            .and_then(|()| to.write_all(b"\n"))
            .and_then(|()| to.flush())
            .expect("written");
    }

    /// Sends a request; its id.
    pub fn begin(&mut self, method: &str, params: Value) -> u64 {
        self.last += 1;
        self.send(&json!({"jsonrpc": "2.0", "id": self.last, "method": method, "params": params}).to_string());
        self.last
    }

    /// The next message. What is on stdout is the protocol and nothing else.
    pub fn next(&mut self) -> Value {
        let mut line = String::new();
        self.from.read_line(&mut line).expect("a line");
        serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:?}"))
    }

    /// Sends a request and waits for its answer.
    pub fn request(&mut self, method: &str, params: Value) -> Value {
        let id = self.begin(method, params);
        loop {
            let message = self.next();
            if message["id"] == id {
                return message;
            }
        }
    }

    /// Calls a tool; its result, which may be a refusal.
    pub fn call(&mut self, tool: &str, arguments: Value) -> Value {
        let answer = self.request("tools/call", json!({"name": tool, "arguments": arguments}));
        assert!(answer["result"].is_object(), "{tool}: {answer}");
        answer["result"].clone()
    }

    /// Closes the stream, at which the program ends well.
    pub fn end(mut self) {
        drop(self.to.take());
        assert!(self.child.wait().expect("it ends").success());
    }
}

impl Drop for Agent {
    fn drop(&mut self) {
        drop(self.to.take());
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What an answer says in numbers.
pub fn facts(result: &Value) -> &Value {
    &result["structuredContent"]
}

/// The picture of an answer: a PNG.
pub fn picture(result: &Value) -> Vec<u8> {
    let content = result["content"].as_array().expect("content");
    let image = content.iter().find(|own| own["type"] == "image").expect("a picture");
    assert_eq!(image["mimeType"], "image/png");
    STANDARD.decode(text(&image["data"])).expect("base64")
}

/// Pixels of the picture of an answer.
pub fn picture_size(result: &Value) -> [u32; 2] {
    let bytes = picture(result);
    let reader = png::Decoder::new(std::io::Cursor::new(&bytes))
        .read_info()
        .expect("a PNG");
    [reader.info().width, reader.info().height]
}

/// Checks that an answer is a refusal of a kind, about a field where one is named.
#[track_caller]
pub fn refused(result: &Value, code: &str, field: &str) {
    assert_eq!(result["isError"], true, "{result}");
    assert_eq!(facts(result)["code"], code, "{result}");
    if !field.is_empty() {
        assert_eq!(facts(result)["field"], field, "{result}");
    }
}
