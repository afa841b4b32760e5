//! How numbers and times stand in the database's columns, there and back. Must not know any table.

use jiff::Timestamp;
use sqlx::{Row, sqlite::SqliteRow};

use super::StoreError;

/// A time as microseconds since 1970; finer digits are dropped.
pub(super) fn micros(time: Timestamp) -> i64 {
    time.as_microsecond()
}

/// A count as the database's widest integer.
pub(super) fn integer(number: u64) -> Result<i64, StoreError> {
    i64::try_from(number).map_err(|_| StoreError::NumberTooLarge { number })
}

/// A time from its column.
pub(super) fn timestamp(row: &SqliteRow, column: &str) -> Result<Timestamp, sqlx::Error> {
    Timestamp::from_microsecond(row.try_get(column)?).map_err(undecodable(column))
}

/// A time from a column that may be empty.
pub(super) fn optional_timestamp(row: &SqliteRow, column: &str) -> Result<Option<Timestamp>, sqlx::Error> {
    let micros = row.try_get::<Option<i64>, _>(column)?;
    micros.map(|micros| Timestamp::from_microsecond(micros).map_err(undecodable(column))).transpose()
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
