//! Lists a page at a time, newest first. A cursor names the last row of a page by (created_at, key); the next page begins
//! behind it, so rows that are added meanwhile neither shift nor repeat any. Must not know what is listed.

use std::{fmt, str};

use jiff::Timestamp;
use sqlx::{AssertSqlSafe, FromRow, SqlitePool, sqlite::SqliteRow};

use super::{StoreError, statements};

/// The most rows that one page holds, whatever was asked for.
pub const PAGE_ROWS_MAX: u32 = 1000;

/// Which page of a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// Rows wanted; taken as 1 to [`PAGE_ROWS_MAX`].
    pub limit: u32,
    /// [`Listing::next`] of the page before; `None` for the newest rows.
    pub before: Option<Cursor>,
}

/// A page of a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listing<T> {
    /// Newest first.
    pub rows: Vec<T>,
    /// Where the next page begins; `None` where there is none.
    pub next: Option<Cursor>,
}

/// A place in a list. Its text is opaque to clients and safe in a URL.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cursor {
    created_at: Timestamp,
    key: String,
}

/// A row with a place in a list.
pub(super) trait Listed: for<'r> FromRow<'r, SqliteRow> + Send + Unpin {
    /// The table's statement and its key column.
    const LIST: statements::List;

    /// Its place.
    fn cursor(&self) -> Cursor;
}

impl Cursor {
    pub(super) fn new(created_at: Timestamp, key: &str) -> Self {
        Self { created_at, key: key.to_owned() }
    }

    /// Reads the text of a cursor.
    ///
    /// # Errors
    /// [`StoreError::CursorMalformed`] for anything that [`fmt::Display`] did not write.
    pub fn parse(text: &str) -> Result<Self, StoreError> {
        Self::read(text).ok_or(StoreError::CursorMalformed)
    }

    fn read(text: &str) -> Option<Self> {
        let (time, key) = text.split_at_checked(TIME_DIGITS)?;
        let canonical = text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
        if !canonical || key.len() % 2 != 0 {
            return None;
        }
        let created_at = Timestamp::from_microsecond(i64::from_str_radix(time, 16).ok()?).ok()?;
        let bytes: Option<Vec<u8>> = key
            .as_bytes()
            .chunks_exact(2)
            .map(|pair| u8::from_str_radix(str::from_utf8(pair).ok()?, 16).ok())
            .collect();
        Some(Self { created_at, key: String::from_utf8(bytes?).ok()? })
    }
}

const TIME_DIGITS: usize = 16;

impl fmt::Display for Cursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.created_at.as_microsecond())?;
        self.key.bytes().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// One page of the rows for which every set condition holds.
pub(super) async fn list<T: Listed>(
    readers: &SqlitePool,
    conditions: &[(&'static str, Option<&str>)],
    page: &Page,
) -> Result<Listing<T>, StoreError> {
    let limit = page.limit.clamp(1, PAGE_ROWS_MAX);
    let set: Vec<_> = conditions.iter().filter_map(|&(column, value)| Some((column, value?))).collect();
    let columns: Vec<_> = set.iter().map(|&(column, _)| column).collect();
    let sql = T::LIST.page(&columns, page.before.is_some());
    // One row more than wanted tells whether there is a next page.
    let mut query = sqlx::query_as::<_, T>(AssertSqlSafe(sql)).bind(i64::from(limit) + 1);
    for &(_, value) in &set {
        query = query.bind(value);
    }
    if let Some(cursor) = &page.before {
        query = query.bind(cursor.created_at.as_microsecond()).bind(&cursor.key);
    }
    let mut rows = query.fetch_all(readers).await?;
    let wanted = usize::try_from(limit).unwrap_or(usize::MAX);
    let more = rows.len() > wanted;
    rows.truncate(wanted);
    let next = if more { rows.last().map(T::cursor) } else { None };
    Ok(Listing { rows, next })
}
