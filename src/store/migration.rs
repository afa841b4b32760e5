//! Brings a database to the schema that this program knows, a numbered step at a time, each in one transaction: a step that
//! fails leaves the file as it was.

use sha2::{Digest, Sha256};
use sqlx::{AssertSqlSafe, Connection, Row, SqliteConnection};

use super::error::StoreError;
use super::{connection, hex, statements};

/// A step of the schema. Its text never changes once it was released: databases remember its checksum.
#[derive(Debug, Clone, Copy)]
pub(super) struct Migration {
    pub(super) version: i64,
    pub(super) sql: &'static str,
}

/// From this version on the database counts its commits.
pub(super) const COUNTS_COMMITS: i64 = 3;

/// All steps, counting up from 1.
pub(super) const MIGRATIONS: &[Migration] = &[
    Migration { version: 1, sql: include_str!("migrations/0001_records.sql") },
    Migration { version: 2, sql: include_str!("migrations/0002_cell.sql") },
    Migration { version: COUNTS_COMMITS, sql: include_str!("migrations/0003_order_and_commits.sql") },
];

/// Applies the steps that the database has not seen.
///
/// # Errors
/// [`StoreError::NewerSchema`], [`StoreError::MigrationDiffers`], or what the database says.
pub(super) async fn migrate(database: &mut SqliteConnection, steps: &'static [Migration]) -> Result<(), StoreError> {
    let found = user_version(database).await?;
    let known = steps.last().map_or(0, |step| step.version);
    if found > known {
        return Err(StoreError::NewerSchema { found, known });
    }
    if found > 0 {
        compare_checksums(database, steps).await?;
    }
    for step in steps.iter().filter(|step| step.version > found) {
        apply(database, *step).await?;
    }
    Ok(())
}

/// The version of the last step that was applied; 0 of a new database.
pub(super) async fn user_version(database: &mut SqliteConnection) -> Result<i64, StoreError> {
    Ok(sqlx::query_scalar("PRAGMA user_version").fetch_one(database).await?)
}

async fn compare_checksums(database: &mut SqliteConnection, steps: &[Migration]) -> Result<(), StoreError> {
    for row in sqlx::query(statements::MIGRATIONS).fetch_all(database).await? {
        let (version, checksum): (i64, String) = (row.try_get("version")?, row.try_get("checksum")?);
        let known = steps.iter().find(|step| step.version == version).map(checksum_of);
        if known.as_deref() != Some(&checksum) {
            return Err(StoreError::MigrationDiffers { version });
        }
    }
    Ok(())
}

async fn apply(database: &mut SqliteConnection, step: Migration) -> Result<(), StoreError> {
    let mut transaction = database.begin_with(connection::BEGIN).await?;
    sqlx::raw_sql(statements::CREATE_MIGRATIONS).execute(&mut *transaction).await?;
    sqlx::raw_sql(step.sql).execute(&mut *transaction).await?;
    sqlx::query(statements::INSERT_MIGRATION)
        .bind(step.version)
        .bind(checksum_of(&step))
        .execute(&mut *transaction)
        .await?;
    // A pragma takes no placeholder; the number is our own.
    let mark = AssertSqlSafe(format!("PRAGMA user_version = {}", step.version));
    sqlx::raw_sql(mark).execute(&mut *transaction).await?;
    Ok(transaction.commit().await?)
}

fn checksum_of(step: &Migration) -> String {
    hex(&Sha256::digest(step.sql.as_bytes()))
}
