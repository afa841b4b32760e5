//! Gives raw scans their place, together with the rows that refer to them: no row without its file, and no file that is left
//! without a row.
//!
//! ```text
//! rows, mark, link ──> commit ──> look: a row refers to it?  yes: unmark
//!                        │                                     no:  remove the file, unmark
//!                        └ process dies ──> the same look at the next start, for every mark that is there
//! ```
//!
//! All of it happens in the one task that writes, so the same bytes sent by many clients at once never race. A file whose
//! mark is gone is never removed: if the database is lost, the scans are not.

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

/// A write of rows that brings the file of a scan along.
pub(super) struct WithFile<W> {
    write: W,
    scan: Arc<CompleteScan>,
    /// The same bytes had their place before.
    is_kept: bool,
}

impl<W> WithFile<W> {
    /// Brings the content to the disk before the queue, where others would have to wait for it.
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
        // A write may come to nothing, e.g. where the request was answered before.
        if is_recorded(&self.scan.id(), database).await? {
            let (scan, is_kept) = (Arc::clone(&self.scan), self.is_kept);
            blocking(move || scan.settle(is_kept)).await?;
        }
        Ok(outcome)
    }

    async fn conclude(&self, database: &mut SqliteConnection) {
        // What fails here stays marked and is made good at the next start.
        let _ = clear_up(&self.scan.folder, self.scan.sha256_hex.clone(), database).await;
    }
}

/// Makes good what an earlier process left between a file and its row.
pub(super) async fn clear_up_all(folder: &Arc<Folder>, database: &mut SqliteConnection) -> Result<(), StoreError> {
    let marked = Arc::clone(folder);
    for sha256_hex in blocking(move || marked.marked()).await? {
        clear_up(folder, sha256_hex, database).await?;
    }
    Ok(())
}

/// Removes a marked file unless a row refers to it, then the mark.
async fn clear_up(folder: &Arc<Folder>, sha256_hex: String, database: &mut SqliteConnection) -> Result<(), StoreError> {
    let Some(mark) = folder.mark(&sha256_hex).filter(|mark| mark.exists()) else { return Ok(()) };
    let recorded = is_recorded(&format!("s-{sha256_hex}"), database).await?;
    let orphan = folder.scan(&sha256_hex).filter(|_| !recorded);
    blocking(move || {
        if let Some((shelf, place)) = orphan {
            remove(place)?;
            // The mark must not be gone before the file is.
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
    /// Whether a file of the same length has the place.
    fn has_place(&self, place: &Path) -> bool {
        fs::metadata(place).is_ok_and(|there| there.is_file() && there.len() == self.bytes_count)
    }

    /// Whether the same bytes have the place. Another file there was damaged; these bytes repair it.
    fn is_kept(&self) -> bool {
        let place = self.folder.scan(&self.sha256_hex).map(|(_, place)| place).filter(|place| self.has_place(place));
        let digest = place.and_then(|place| fs::File::open(place).and_then(|mut file| digest_of(&mut file)).ok());
        digest.as_ref() == Some(&self.sha256_hex)
    }

    /// Writes the content to the disk, unless the same bytes are kept already; returns whether they are.
    fn make_durable(&self) -> Result<bool, StoreError> {
        let is_kept = self.is_kept();
        if !is_kept {
            self.file.sync_all().map_err(StoreError::of_file(self.temporary.path()))?;
        }
        Ok(is_kept)
    }

    /// First the content, then the name: a file under its digest is always complete. The temporary name stays until this is dropped,
    /// so that the write can be tried again after its commit failed.
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

    /// Replaces the file at the place in one step.
    fn put_at(&self, place: &Path) -> io::Result<()> {
        let second = self.folder.new_name();
        // A file system without hard links has one name for a file; then it cannot be tried again.
        let from = fs::hard_link(self.temporary.path(), &second).map_or(self.temporary.path(), |()| second.as_path());
        let renamed = fs::rename(from, place);
        // It is still there after a failure, and where both names are of one file already.
        let _ = fs::remove_file(&second);
        renamed
    }
}
