//! Lists one page at a time, newest first, in the order of the commits. A cursor names the last row of a page, and the next page
//! begins after it, so that rows added meanwhile neither shift nor repeat any row.

use std::fmt;

use sqlx::{AssertSqlSafe, FromRow, SqlitePool, sqlite::SqliteRow};

use super::error::StoreError;
use super::{rows, statements};

/// The greatest number of rows in a page.
pub const PAGE_ROWS_MAX: u32 = 1000;

/// Selects a page of a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// Number of requested rows, limited to 1 to [`PAGE_ROWS_MAX`].
    pub limit: u32,
    /// [`Listing::next`] of the previous page; `None` for the newest rows.
    pub before: Option<Cursor>,
}

/// A page of a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listing<T> {
    /// Newest first.
    pub rows: Vec<T>,
    /// Where the next page begins; `None` on the last page.
    pub next: Option<Cursor>,
}

/// A position in a list. Its text is opaque to clients and safe in a URL.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cursor(u64);

/// A row of a list.
pub(super) trait Listed: for<'r> FromRow<'r, SqliteRow> {
    /// The table's statement.
    const LIST: statements::List;
}

impl Cursor {
    #[cfg(test)]
    pub(super) const fn new(sequence: u64) -> Self {
        Self(sequence)
    }

    /// Parses the text of a cursor.
    ///
    /// # Errors
    /// [`StoreError::CursorMalformed`] for any text that [`fmt::Display`] did not write.
    pub fn parse(text: &str) -> Result<Self, StoreError> {
        let canonical = text.len() == DIGITS && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
        let sequence =
            u64::from_str_radix(text, 16).ok().filter(|sequence| canonical && i64::try_from(*sequence).is_ok());
        sequence.map(Self).ok_or(StoreError::CursorMalformed)
    }
}

const DIGITS: usize = 16;

impl fmt::Display for Cursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

/// One page of the rows that fulfil every given condition.
pub(super) async fn list<T: Listed>(
    readers: &SqlitePool,
    conditions: &[(&'static str, Option<&str>)],
    page: &Page,
) -> Result<Listing<T>, StoreError> {
    let limit = page.limit.clamp(1, PAGE_ROWS_MAX);
    let set: Vec<_> = conditions.iter().filter_map(|&(column, value)| Some((column, value?))).collect();
    let columns: Vec<_> = set.iter().map(|&(column, _)| column).collect();
    let sql = T::LIST.page(&columns, page.before.is_some());
    // One additional row shows whether there is a next page.
    let mut query = sqlx::query(AssertSqlSafe(sql)).bind(i64::from(limit) + 1);
    for &(_, value) in &set {
        query = query.bind(value);
    }
    if let Some(Cursor(sequence)) = page.before {
        query = query.bind(rows::integer(sequence)?);
    }
    let mut rows = query.fetch_all(readers).await?;
    let wanted = usize::try_from(limit).unwrap_or(usize::MAX);
    let more = rows.len() > wanted;
    rows.truncate(wanted);
    let last = rows.last().filter(|_| more);
    let next = last.map(|row| rows::count(row, "sequence").map(Cursor)).transpose()?;
    Ok(Listing { rows: rows.iter().map(T::from_row).collect::<Result<_, _>>()?, next })
}
