//! How numbers and times stand in the database's columns, there and back.

use jiff::Timestamp;
use sqlx::{Row, sqlite::SqliteRow};

use super::error::StoreError;

/// A time as microseconds since 1970; finer digits are dropped.
pub(super) fn micros(time: Timestamp) -> i64 {
    time.as_microsecond()
}

/// A count as the database's widest integer.
pub(super) fn integer(number: u64) -> Result<i64, StoreError> {
    i64::try_from(number).map_err(|_| StoreError::NumberTooLarge { number })
}

/// A text from its column. Bytes that are not UTF-8 are replaced, so that a damaged text does not hide the row it stands in.
pub(super) fn text(row: &SqliteRow, column: &str) -> Result<String, sqlx::Error> {
    Ok(String::from_utf8_lossy(&row.try_get::<Vec<u8>, _>(column)?).into_owned())
}

/// A text from a column that may be empty, read as [`text`] reads it.
pub(super) fn optional_text(row: &SqliteRow, column: &str) -> Result<Option<String>, sqlx::Error> {
    let bytes = row.try_get::<Option<Vec<u8>>, _>(column)?;
    Ok(bytes.map(|bytes| String::from_utf8_lossy(&bytes).into_owned()))
}

/// A time from its column. A number that is no time is read as the nearest one, for the same reason as a damaged text.
pub(super) fn timestamp(row: &SqliteRow, column: &str) -> Result<Timestamp, sqlx::Error> {
    Ok(nearest(row.try_get(column)?))
}

/// A time from a column that may be empty, read as [`timestamp`] reads it.
pub(super) fn optional_timestamp(row: &SqliteRow, column: &str) -> Result<Option<Timestamp>, sqlx::Error> {
    Ok(row.try_get::<Option<i64>, _>(column)?.map(nearest))
}

fn nearest(micros: i64) -> Timestamp {
    let bound = if micros < 0 { Timestamp::MIN } else { Timestamp::MAX };
    Timestamp::from_microsecond(micros).unwrap_or(bound)
}

/// A count from its column.
pub(super) fn count(row: &SqliteRow, column: &str) -> Result<u64, sqlx::Error> {
    u64::try_from(row.try_get::<i64, _>(column)?).map_err(undecodable(column))
}

/// A count from a column that may be empty.
pub(super) fn optional_count(row: &SqliteRow, column: &str) -> Result<Option<u64>, sqlx::Error> {
    row.try_get::<Option<i64>, _>(column)?.map(|number| u64::try_from(number).map_err(undecodable(column))).transpose()
}

fn undecodable<E: std::error::Error + Send + Sync + 'static>(column: &str) -> impl FnOnce(E) -> sqlx::Error {
    let index = column.to_owned();
    |source| sqlx::Error::ColumnDecode { index, source: Box::new(source) }
}
