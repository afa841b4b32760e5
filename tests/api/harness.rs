//! A service and a client for tests. The service runs in this process, on a free port, with its own folder that
//! is deleted at the end.

use coaxis::config::{Cell, Config};
use coaxis::device::simulated::World;
use coaxis::http::{Server, Stopper};
use coaxis::service::{Capacity, Equipment, Service};
use serde_json::Value;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;

/// Longer than any operation in the tests; a test that reaches it fails.
const PATIENCE: Duration = Duration::from_secs(60);

/// Maximum number of blocking threads.
pub(crate) const BLOCKING_THREADS: usize = 4;

/// A running service.
pub(crate) struct Running {
    pub(crate) address: SocketAddr,
    /// The simulated world of the devices; `None` if the service has no cell.
    pub(crate) world: Option<World>,
    /// The service; `None` if it is in another process.
    pub(crate) verbs: Option<Arc<Service>>,
    stopper: Option<Stopper>,
    thread: Option<JoinHandle<()>>,
    agent: ureq::Agent,
}

/// A temporary folder, deleted at the end.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("api-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// Files of scans, including those that are being received.
    pub(crate) fn scan_files_count(&self) -> usize {
        fn count(folder: &Path) -> usize {
            let entries = std::fs::read_dir(folder).expect("readable");
            entries
                .map(|entry| entry.expect("entry").path())
                .map(|path| if path.is_dir() { count(&path) } else { 1 })
                .sum()
        }
        count(&self.0.join("scans"))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A service without a cell, otherwise with the default configuration, and its own folder.
pub(crate) fn start() -> (Running, Folder) {
    start_with(|_| {})
}

/// A service whose configuration was modified by `change`.
pub(crate) fn start_with(change: impl FnOnce(&mut Config)) -> (Running, Folder) {
    let folder = Folder::new();
    (start_on(&folder, change), folder)
}

/// A service on a folder that may have been used before.
pub(crate) fn start_on(folder: &Folder, change: impl FnOnce(&mut Config)) -> Running {
    let mut config = Config {
        listen: SocketAddr::from(([127, 0, 0, 1], 0)),
        data: folder.path().to_owned(),
        cell: Cell { enabled: false, ..Cell::default() },
        ..Config::default()
    };
    change(&mut config);
    config.check().expect("a valid configuration");
    let (sender, receiver) = mpsc::channel();
    let thread = std::thread::spawn(move || {
        // Few, so that a thread that blocks on another one is detected.
        let mut runtime = tokio::runtime::Builder::new_multi_thread();
        let runtime = runtime.worker_threads(2).max_blocking_threads(BLOCKING_THREADS).enable_all().build();
        runtime.expect("a runtime").block_on(async move {
            let capacity = Capacity::from_config(&config);
            let equipment = Equipment::of(&config.cell).expect("devices");
            let world = equipment.as_ref().and_then(|equipment| equipment.world.clone());
            let opened = Service::open_with(&config.data, capacity, config.estimation, equipment).await;
            let service = opened.expect("a store");
            let server = Server::bind(&config, Arc::clone(&service)).expect("a port");
            sender.send((server.address(), server.stopper(), world, service)).expect("the receiver waits");
            server.serve().await.expect("it serves");
        });
    });
    let (address, stopper, world, service) = receiver.recv().expect("it starts");
    Running { address, world, verbs: Some(service), stopper: Some(stopper), thread: Some(thread), agent: agent() }
}

/// A service in another process.
pub(crate) fn at(address: &str) -> Running {
    let address = address.parse().expect("an address");
    Running { address, world: None, verbs: None, stopper: None, thread: None, agent: agent() }
}

fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE)).build().into()
}

/// An answer, read to its end.
#[derive(Debug, Clone)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) headers: Vec<(String, String)>,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn header(&self, name: &str) -> &str {
        let found = self.headers.iter().find(|(key, _)| key.eq_ignore_ascii_case(name));
        found.map(|(_, value)| value.as_str()).unwrap_or_default()
    }

    pub(crate) fn text(&self) -> String {
        String::from_utf8(self.body.clone()).expect("text")
    }

    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    /// The body, after a check of the status.
    #[track_caller]
    pub(crate) fn expect(&self, status: u16) -> Value {
        assert_eq!(self.status, status, "{}", self.text());
        self.json()
    }

    /// The body, after a check that it is a problem of this status and code with all members of a problem.
    #[track_caller]
    pub(crate) fn problem(&self, status: u16, code: &str) -> Value {
        assert_eq!((self.status, self.header("content-type")), (status, "application/problem+json"), "{}", self.text());
        let problem = self.json();
        assert_eq!(problem["code"], code, "{problem}");
        assert_eq!(problem["status"], status);
        assert_eq!(problem["type"], format!("urn:coaxis:problem:{code}"));
        assert_eq!(problem["request_id"], self.header("x-request-id"));
        assert!(problem["retryable"].is_boolean() && !problem["title"].as_str().expect("title").is_empty());
        assert!(problem["detail"].as_str().expect("detail").len() > 10);
        problem
    }
}

impl Running {
    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub(crate) fn get(&self, path: &str) -> Answer {
        self.get_with(path, &[])
    }

    pub(crate) fn get_with(&self, path: &str, headers: &[(&str, &str)]) -> Answer {
        let request = headers.iter().fold(self.agent.get(self.url(path)), |r, (name, value)| r.header(*name, *value));
        read(request.call())
    }

    pub(crate) fn delete(&self, path: &str) -> Answer {
        read(self.agent.delete(self.url(path)).call())
    }

    pub(crate) fn post(&self, path: &str, body: &[u8]) -> Answer {
        self.post_with(path, &[], body)
    }

    pub(crate) fn post_json(&self, path: &str, body: &Value) -> Answer {
        self.post_with(path, &[("content-type", "application/json")], body.to_string().as_bytes())
    }

    pub(crate) fn post_with(&self, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
        let request = headers.iter().fold(self.agent.post(self.url(path)), |r, (name, value)| r.header(*name, *value));
        read(request.send(body))
    }

    pub(crate) fn put(&self, path: &str, headers: &[(&str, &str)], body: &Value) -> Answer {
        let request = self.agent.put(self.url(path)).header("content-type", "application/json");
        let request = headers.iter().fold(request, |r, (name, value)| r.header(*name, *value));
        read(request.send(body.to_string()))
    }

    /// Sends these bytes; the answer is everything received until the service closes the connection.
    pub(crate) fn raw(&self, bytes: &[u8]) -> String {
        let mut stream = self.connect();
        stream.write_all(bytes).expect("sent");
        rest(&mut stream)
    }

    pub(crate) fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        stream
    }

    /// A connection from another address of this machine.
    pub(crate) fn connect_from(&self, address: [u8; 4]) -> TcpStream {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let connected = runtime.block_on(async {
            let socket = tokio::net::TcpSocket::new_v4().expect("a socket");
            socket.bind(SocketAddr::from((address, 0))).expect("an address of this machine");
            socket.connect(self.address).await.expect("it listens")
        });
        let stream = connected.into_std().expect("a stream");
        stream.set_nonblocking(false).expect("it blocks");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        stream
    }

    /// The value of a counter.
    pub(crate) fn counter(&self, name: &str) -> f64 {
        let text = self.get("/metrics").text();
        let value = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok());
        value.unwrap_or_else(|| panic!("{name} is missing in\n{text}"))
    }

    /// Begins the shutdown: no further connection is accepted.
    pub(crate) fn begin_to_stop(&self) {
        self.stopper.as_ref().expect("it runs here").stop();
    }

    /// Shuts down and waits for the end.
    pub(crate) fn stop(mut self) {
        self.end();
    }

    /// Waits for the end after the shutdown has begun.
    pub(crate) fn wait(mut self) {
        self.verbs = None;
        self.thread.take().expect("it runs").join().expect("it ended in good order");
    }

    fn end(&mut self) {
        self.verbs = None;
        if let Some(stopper) = &self.stopper {
            stopper.stop();
        }
        if let Some(thread) = self.thread.take() {
            thread.join().expect("it ended in good order");
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.end();
        }
    }
}

/// Everything received until the other side closes the connection.
pub(crate) fn rest(stream: &mut TcpStream) -> String {
    let mut answer = Vec::new();
    // A reset after the answer is an end, too.
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

fn read(response: Result<ureq::http::Response<ureq::Body>, ureq::Error>) -> Answer {
    let mut response = response.expect("an answer");
    let headers = response.headers().iter();
    let headers = headers.map(|(name, value)| (name.to_string(), value.to_str().expect("text").to_owned())).collect();
    let body = response.body_mut().with_config().limit(1 << 30).read_to_vec().expect("a body");
    Answer { status: response.status().as_u16(), headers, body }
}
