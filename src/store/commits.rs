//! A count of commits that is kept beside the database, in order to detect a database that lost acknowledged records: its log was
//! damaged, it was replaced by an older copy, or it was removed. All calls on files block.
//!
//! ```text
//! transaction: rows, count n and chain n ──> commit ──> coaxis.commits: n, chain n ──> acknowledged
//!                                              │
//!                                              └ process ends ──> the database is one commit ahead of the file
//! ```
//!
//! chain n = SHA-256(chain n−1, n, a random number drawn at the start). The file has two slots that are written alternately, each
//! with its own checksum: if the last one was not written completely, the previous one is still valid.

use super::error::Loss;
use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::io;
use std::os::unix::fs::{FileExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use sha2::{Digest, Sha256};
use sqlx::{Row, SqliteConnection};

use super::error::StoreError;
use super::folder::{self, FILE_MODE};
use super::rows::hex;
use super::{rows, statements};

/// Bytes of a slot: one sector, which is written completely or not at all.
const SLOT_BYTES: usize = 512;

/// A number of commits, and a hash that distinguishes them from other histories of the same length.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Commits {
    pub(super) count: u64,
    pub(super) chain: String,
}

/// The commits of the database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Counted {
    pub(super) last: Commits,
    /// The chain of the previous commit.
    pub(super) previous: String,
}

impl Counted {
    /// Reads it from the database.
    pub(super) async fn of(database: &mut SqliteConnection) -> Result<Self, StoreError> {
        let row = sqlx::query(statements::COMMITS).fetch_one(database).await?;
        let last = Commits { count: rows::count(&row, "count")?, chain: row.try_get("chain")? };
        Ok(Self { last, previous: row.try_get("previous")? })
    }

    /// Whether these are the acknowledged commits, or one more: a process may end between a commit and its acknowledgement.
    pub(super) fn check(&self, acknowledged: &Commits) -> Result<(), Loss> {
        let (found, known) = (self.last.count, acknowledged.count);
        let continues = match found.checked_sub(known) {
            None => return Err(Loss::Behind { found, acknowledged: known }),
            Some(0) => self.last.chain == acknowledged.chain,
            Some(1) => self.previous == acknowledged.chain,
            Some(_) => false,
        };
        if continues { Ok(()) } else { Err(Loss::Foreign { found, acknowledged: known }) }
    }
}

/// The commit count of one store: the acknowledged commits, and the file that records them.
#[derive(Debug)]
pub(super) struct CommitLog {
    file: CommitFile,
    database: PathBuf,
    drawn: u64,
    known: Mutex<Known>,
    loss: OnceLock<Loss>,
    /// Tests use this to simulate a full disk.
    #[cfg(test)]
    pub(super) full: std::sync::atomic::AtomicBool,
}

#[derive(Debug)]
struct Known {
    last: Commits,
    /// Whether the file does not contain `last` yet.
    behind: bool,
    /// The identity of the database file and its log, as of the first commit of this connection.
    identity: Option<Identity>,
}

/// Device and inode number of the database file and of its log.
type Identity = [Option<(u64, u64)>; 2];

impl CommitLog {
    /// Creates the log for a database that was compared with its file.
    pub(super) fn new(file: CommitFile, database: PathBuf, last: Commits, loss: Option<Loss>) -> Self {
        let drawn = RandomState::new().build_hasher().finish();
        let known = Mutex::new(Known { last, behind: false, identity: None });
        Self {
            file,
            database,
            drawn,
            known,
            loss: loss.map(OnceLock::from).unwrap_or_default(),
            #[cfg(test)]
            full: std::sync::atomic::AtomicBool::new(false),
        }
    }

    /// Returns an error if records were lost.
    pub(super) fn check_loss(&self) -> Result<(), StoreError> {
        self.loss.get().map_or(Ok(()), |loss| Err(StoreError::RecordsLost(loss.clone())))
    }

    /// Returns an error if a test simulates a full disk.
    #[cfg(test)]
    pub(super) fn check_room(&self) -> Result<(), StoreError> {
        if self.full.load(std::sync::atomic::Ordering::SeqCst) { Err(StoreError::Full) } else { Ok(()) }
    }

    /// Forgets the identity, because the database will be opened again.
    pub(super) fn forget_identity(&self) {
        self.known().identity = None;
    }

    /// Returns an error if records were lost, or the last commit cannot be recorded.
    pub(super) fn admit(&self) -> Result<(), StoreError> {
        self.check_loss()?;
        let mut known = self.known();
        self.look_at_files(&mut known)?;
        if known.behind {
            self.file.write(&known.last)?;
            known.behind = false;
        }
        Ok(())
    }

    /// Compares the commits of the database with those that were acknowledged. There must be no commit meanwhile.
    pub(super) fn compare(&self, counted: &Counted) -> Result<(), StoreError> {
        let checked = counted.check(&self.known().last);
        checked.map_err(|loss| self.lose(loss))
    }

    /// Counts the transaction under way.
    pub(super) async fn count(&self, database: &mut SqliteConnection) -> Result<Commits, StoreError> {
        let counted = Counted::of(&mut *database).await?;
        self.compare(&counted)?;
        let count = counted.last.count.saturating_add(1);
        let chain = Sha256::new()
            .chain_update(&counted.last.chain)
            .chain_update(count.to_le_bytes())
            .chain_update(self.drawn.to_le_bytes())
            .finalize();
        let next = Commits { count, chain: hex(&chain) };
        sqlx::query(statements::COUNT_COMMIT)
            .bind(rows::integer(next.count)?)
            .bind(&next.chain)
            .bind(&counted.last.chain)
            .execute(database)
            .await?;
        Ok(next)
    }

    /// Records a durable commit, before it is acknowledged.
    pub(super) fn acknowledge(&self, commits: Commits) -> Result<(), StoreError> {
        {
            let mut known = self.known();
            (known.last, known.behind) = (commits, true);
        }
        self.admit()
    }

    /// If the names refer to other files than those that were opened, the written data are lost when these are closed.
    fn look_at_files(&self, known: &mut Known) -> Result<(), StoreError> {
        let mut log = self.database.clone().into_os_string();
        log.push("-wal");
        let now = [self.database.as_path(), Path::new(&log)].map(identity);
        match known.identity {
            Some(then) if then != now => Err(self.lose(Loss::Replaced { file: self.database.clone() })),
            // The log exists from the first commit on.
            None if now.iter().all(Option::is_some) => {
                known.identity = Some(now);
                Ok(())
            }
            Some(_) | None => Ok(()),
        }
    }

    fn lose(&self, loss: Loss) -> StoreError {
        tracing::error!("{loss}; nothing is written any more");
        StoreError::RecordsLost(self.loss.get_or_init(|| loss).clone())
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn identity(file: &Path) -> Option<(u64, u64)> {
    fs::metadata(file).ok().map(|file| (file.dev(), file.ino()))
}

/// The file of the count.
#[derive(Debug)]
pub(super) struct CommitFile {
    file: File,
    path: PathBuf,
}

impl CommitFile {
    /// Opens or creates the file, and returns its content; `None` if it is empty.
    pub(super) fn open(path: PathBuf) -> Result<(Self, Option<Commits>), StoreError> {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false).mode(FILE_MODE);
        let file = options.open(&path).map_err(StoreError::of_file(&path))?;
        // The space is allocated now, so that a full disk does not prevent the counting.
        let length = file.metadata().map_err(StoreError::of_file(&path))?.len();
        if length < 2 * SLOT_BYTES as u64 {
            file.write_all_at(&[b' '; 2 * SLOT_BYTES], 0)
                .and_then(|()| file.sync_all())
                .map_err(StoreError::of_file(&path))?;
            folder::sync(path.parent().unwrap_or(Path::new(".")))?;
        }
        let held = Self::read_from(&file).map_err(StoreError::of_file(&path))?;
        Ok((Self { file, path }, held))
    }

    /// Opens or creates the file without reading it.
    pub(super) fn create(path: PathBuf) -> Result<Self, StoreError> {
        let file = Self::open(path)?.0;
        file.file.write_all_at(&[b' '; 2 * SLOT_BYTES], 0).map_err(StoreError::of_file(&file.path))?;
        Ok(file)
    }

    /// The content of the file at this path; `None` if it does not exist or is empty.
    pub(super) fn read(path: &Path) -> Result<Option<Commits>, StoreError> {
        match File::open(path) {
            Ok(file) => Self::read_from(&file).map_err(StoreError::of_file(path)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(StoreError::of_file(path)(error)),
        }
    }

    fn read_from(file: &File) -> io::Result<Option<Commits>> {
        let mut bytes = [0; 2 * SLOT_BYTES];
        let mut length = 0;
        while let Some(rest) = bytes.get_mut(length..).filter(|rest| !rest.is_empty()) {
            match file.read_at(rest, length as u64)? {
                0 => break,
                count => length += count,
            }
        }
        Ok(bytes.chunks(SLOT_BYTES).filter_map(parse).max_by_key(|commits| commits.count))
    }

    /// Writes the count durably.
    pub(super) fn write(&self, commits: &Commits) -> Result<(), StoreError> {
        let Commits { count, chain } = commits;
        let text = format!("{count} {chain}");
        let slot = format!("{text} {}", checksum(&text));
        let slot = format!("{slot:<width$}\n", width = SLOT_BYTES - 1);
        let place = (count % 2) * SLOT_BYTES as u64;
        let written = self.file.write_all_at(slot.as_bytes(), place).and_then(|()| self.file.sync_data());
        written.map_err(StoreError::of_file(&self.path))
    }
}

fn parse(slot: &[u8]) -> Option<Commits> {
    let (text, sum) = std::str::from_utf8(slot).ok()?.trim_end().rsplit_once(' ')?;
    let (count, chain) = text.split_once(' ').filter(|_| checksum(text) == sum)?;
    Some(Commits { count: count.parse().ok()?, chain: chain.to_owned() })
}

fn checksum(text: &str) -> String {
    hex(&Sha256::digest(text)).get(..16).unwrap_or_default().to_owned()
}
