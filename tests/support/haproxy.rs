//! HAProxy before three nodes, as `deploy/haproxy.cfg` sets it up, started as an ordinary program where Debian's package is installed.

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A running proxy. Dropping it ends it.
pub struct HaProxy {
    child: Child,
    /// The address under which all nodes are reached.
    pub url: String,
}

impl Drop for HaProxy {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A port that no one uses at the moment.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("an address").port()
}

impl HaProxy {
    /// Starts it before nodes on these ports, with its files in a folder; `None` where it is not installed.
    pub fn start(folder: &Path, nodes: [u16; 3]) -> Option<Self> {
        let program = ["/usr/sbin/haproxy", "/usr/bin/haproxy"]
            .into_iter()
            .find(|p| Path::new(p).exists());
        let Some(program) = program else {
            println!("SKIPPED: HAProxy is not installed (apt-get install haproxy); nodes were not called through it");
            return None;
        };
        let port = free_port();
        let config = folder.join("haproxy.cfg");
        std::fs::write(&config, configuration(port, nodes)).expect("written");
        let checked = Command::new(program).args(["-c", "-q", "-f"]).arg(&config).status();
        assert!(
            checked.expect("haproxy runs").success(),
            "deploy/haproxy.cfg can be read"
        );
        let log = std::fs::File::create(folder.join("haproxy.log")).expect("a log");
        let child = Command::new(program)
            .args(["-db", "-f"])
            .arg(&config)
            .stdout(Stdio::null())
            .stderr(log)
            .spawn();
        Some(Self {
            child: child.expect("haproxy starts"),
            url: format!("http://127.0.0.1:{port}"),
        })
    }
}

/// The file of `deploy/` with this port and these nodes.
fn configuration(port: u16, nodes: [u16; 3]) -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/haproxy.cfg");
    let mut text = std::fs::read_to_string(file).expect("the file of deploy/");
    text = text.replace("bind :7411\n", &format!("bind 127.0.0.1:{port}\n"));
    for (k, node) in nodes.iter().enumerate() {
        let reply = format!("10.0.0.{}:7411", 5 + k);
        assert!(text.contains(&reply), "deploy/haproxy.cfg names {reply}");
        text = text.replace(&reply, &format!("127.0.0.1:{node}"));
    }
    text
}
