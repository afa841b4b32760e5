//! The program as a user runs it: a process that serves from a folder in memory.

use std::error::Error;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};

pub(crate) type Outcome<T> = Result<T, Box<dyn Error>>;

/// The program under test: the given path, or this build. Cargo's own flags are ignored.
pub(crate) fn program() -> String {
    let given = std::env::args().skip(1).find(|argument| !argument.starts_with("--"));
    given.unwrap_or_else(|| env!("CARGO_BIN_EXE_coaxis").to_owned())
}

/// A running service.
pub(crate) struct Serving {
    pub(crate) child: Child,
    pub(crate) address: String,
    /// Not read any further; closing it would break the service's log.
    _log: BufReader<ChildStderr>,
}

impl Serving {
    /// Serves from `data`, with `more` arguments.
    pub(crate) fn start(program: &str, data: &Path, more: &[&str]) -> Outcome<Self> {
        let mut command = Command::new(program);
        command.args(["serve", "--listen", "127.0.0.1:0", "--data"]).arg(data).args(more);
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn()?;
        let mut log = BufReader::new(child.stderr.take().ok_or("no log")?);
        let address = address(&mut log)?;
        Ok(Self { child, address, _log: log })
    }
}

/// The address on which it listens, which may not be in the first line of the log.
fn address(log: &mut impl BufRead) -> Outcome<String> {
    let mut said = String::new();
    while log.read_line(&mut said)? > 0 {
        if let Some((_, address)) = said.rsplit_once("http://") {
            return Ok(address.split_whitespace().next().unwrap_or_default().to_owned());
        }
    }
    Err(format!("it does not listen: {said}").into())
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A temporary folder in memory, deleted at the end.
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Outcome<Self> {
        let path = Path::new("/dev/shm").join(format!("coaxis-{name}-{}", std::process::id()));
        fs::create_dir_all(path.join("data"))?;
        Ok(Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
