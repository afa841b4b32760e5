//! Moves raw scans to their final place, together with the rows that refer to them, so that no row lacks its file and no file lacks
//! a row.
//!
//! ```text
//! rows, mark, link ──> commit ──> check: a row refers to it?  yes: remove the mark
//!                           │                                  no:  remove the file and the mark
//!                           └ process ends ──> the same check at the next start, for every mark that exists
//! ```
//!
//! All of this happens in the one task that writes, so that the same bytes sent by many clients at once never race. A file without
//! a mark is never removed: if the database is lost, the scans are not.

use std::{
    fs,
    io::{self, ErrorKind},
    os::unix::fs::OpenOptionsExt as _,
    path::{Path, PathBuf},
    sync::Arc,
};

use sqlx::SqliteConnection;

use super::error::StoreError;
use super::folder::{self, FILE_MODE, Folder, blocking};
use super::scan_files::{CompleteScan, digest_of};
use super::statements;
use super::writer::Write;

/// A write of rows together with the file of a scan.
pub(super) struct WithFile<W> {
    write: W,
    scan: Arc<CompleteScan>,
    /// Whether the same bytes are already in their final place.
    is_kept: bool,
}

impl<W> WithFile<W> {
    /// Makes the content durable before the write is queued, because other writes would have to wait for it there.
    pub(super) async fn new(write: W, scan: Arc<CompleteScan>) -> Result<Self, StoreError> {
        let content = Arc::clone(&scan);
        let is_kept = blocking(move || content.make_durable()).await?;
        Ok(Self { write, scan, is_kept })
    }
}

impl<W: Write> Write for WithFile<W> {
    type Outcome = W::Outcome;

    async fn apply(&self, database: &mut SqliteConnection) -> Result<W::Outcome, StoreError> {
        let outcome = self.write.apply(database).await?;
        // A write may change nothing, e.g. if the request was answered before.
        if is_recorded(&self.scan.id(), database).await? {
            let (scan, is_kept) = (Arc::clone(&self.scan), self.is_kept);
            blocking(move || scan.settle(is_kept)).await?;
        }
        Ok(outcome)
    }

    async fn conclude(&self, database: &mut SqliteConnection) {
        // After a failure the mark remains, and the next start repeats this step.
        let _ = clear_up(&self.scan.folder, self.scan.sha256_hex.clone(), database).await;
    }
}

/// Completes what an earlier process left unfinished between a file and its row.
pub(super) async fn clear_up_all(folder: &Arc<Folder>, database: &mut SqliteConnection) -> Result<(), StoreError> {
    let marked = Arc::clone(folder);
    for sha256_hex in blocking(move || marked.marked()).await? {
        clear_up(folder, sha256_hex, database).await?;
    }
    Ok(())
}

/// Removes a marked file unless a row refers to it, and then the mark.
async fn clear_up(folder: &Arc<Folder>, sha256_hex: String, database: &mut SqliteConnection) -> Result<(), StoreError> {
    let Some(mark) = folder.mark(&sha256_hex).filter(|mark| mark.exists()) else { return Ok(()) };
    let recorded = is_recorded(&format!("s-{sha256_hex}"), database).await?;
    let orphan = folder.scan(&sha256_hex).filter(|_| !recorded);
    blocking(move || {
        if let Some((shelf, place)) = orphan {
            remove(place)?;
            // The mark must not be removed before the file.
            if shelf.is_dir() {
                folder::sync(&shelf)?;
            }
        }
        remove(mark)
    })
    .await
}

async fn is_recorded(id: &str, database: &mut SqliteConnection) -> Result<bool, StoreError> {
    Ok(sqlx::query(statements::SCAN).bind(id).fetch_optional(database).await?.is_some())
}

fn remove(path: PathBuf) -> Result<(), StoreError> {
    match fs::remove_file(&path) {
        Err(error) if !matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            Err(StoreError::of_file(path)(error))
        }
        _ => Ok(()),
    }
}

impl CompleteScan {
    /// Whether a file of the same length is in the final place.
    fn has_place(&self, place: &Path) -> bool {
        fs::metadata(place).is_ok_and(|there| there.is_file() && there.len() == self.bytes_count)
    }

    /// Whether the same bytes are in the final place. A different file there was damaged; these bytes repair it.
    fn is_kept(&self) -> bool {
        let place = self.folder.scan(&self.sha256_hex).map(|(_, place)| place).filter(|place| self.has_place(place));
        let digest = place.and_then(|place| fs::File::open(place).and_then(|mut file| digest_of(&mut file)).ok());
        digest.as_ref() == Some(&self.sha256_hex)
    }

    /// Writes the content to the disk, unless the same bytes are kept already, and returns whether they are.
    fn make_durable(&self) -> Result<bool, StoreError> {
        let is_kept = self.is_kept();
        if !is_kept {
            self.file.sync_all().map_err(StoreError::of_file(self.temporary.path()))?;
        }
        Ok(is_kept)
    }

    /// Writes the content first and the name afterwards, so that a file under its digest is always complete. The temporary name
    /// remains until this is dropped, so that the write can be tried again after its commit failed.
    fn settle(&self, is_kept: bool) -> Result<(), StoreError> {
        let digest = &self.sha256_hex;
        let ((shelf, place), mark) =
            self.folder.scan(digest).zip(self.folder.mark(digest)).ok_or(StoreError::Closed)?;
        if is_kept && self.has_place(&place) {
            return Ok(());
        }
        let mut options = fs::OpenOptions::new();
        options.write(true).create(true).truncate(true).mode(FILE_MODE);
        options.open(&mark).map_err(StoreError::of_file(&mark))?;
        folder::sync(&self.folder.incoming())?;
        self.file.sync_all().map_err(StoreError::of_file(self.temporary.path()))?;
        folder::create(&shelf)?;
        self.put_at(&place).map_err(StoreError::of_file(&place))?;
        folder::sync(&shelf)?;
        folder::sync(&self.folder.scans())
    }

    /// Replaces the file in the final place atomically.
    fn put_at(&self, place: &Path) -> io::Result<()> {
        let second = self.folder.new_name();
        // A file system without hard links allows one name for a file; then the write cannot be tried again.
        let from = fs::hard_link(self.temporary.path(), &second).map_or(self.temporary.path(), |()| second.as_path());
        let renamed = fs::rename(from, place);
        // The second name still exists after a failure, and if both names already referred to the same file.
        let _ = fs::remove_file(&second);
        renamed
    }
}
