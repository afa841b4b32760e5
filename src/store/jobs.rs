//! Jobs of the cell (moves, scans, acts): written before anything is sent, ended once, found again by id, by request and by
//! plan.

use std::sync::Arc;

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{FromRow, SqliteConnection};

use super::error::StoreError;
use super::page::{self, Listed, Listing, Page};
use super::placing::WithFile;
use super::repository::Store;
use super::rows::{
    Inserted, NewMeasurement, RequestKey, count, integer, micros, optional_text, optional_timestamp, text, timestamp,
};
use super::scan_files::CompleteScan;
use super::statements;
use super::writer::Write;

/// A job of the cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobRow {
    /// Its id, made by service.
    pub id: String,
    /// What kind of job, in service's words.
    pub kind: String,
    /// When it was asked for; kept to the microsecond.
    pub created_at: Timestamp,
    /// How far it is, in service's words.
    pub state: String,
    /// When it was over; `None` while it is under way.
    pub ended_at: Option<Timestamp>,
    /// The plan that it executes.
    pub plan_id: Option<String>,
    /// The request that asked for it, where the client gave it an id.
    pub request: Option<RequestKey>,
    /// What was commanded, and what became of it.
    pub document: String,
}

/// A job that is about to start.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewJob {
    /// Its row, without an end.
    pub row: JobRow,
}

/// How a job ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EndedJob {
    /// Its id.
    pub id: String,
    /// How, in service's words.
    pub state: String,
    /// When.
    pub ended_at: Timestamp,
    /// What was commanded, and what became of it.
    pub document: String,
}

/// What became of a job that was to be written down.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum InsertedJob {
    /// It is recorded, and may start.
    New,
    /// The request was answered before, by this job; nothing was written.
    Replayed(Box<JobRow>),
    /// The request's id was used before for something else; nothing was written.
    RequestMismatch,
    /// The plan was executed before, by this job; nothing was written.
    PlanUsed(Box<JobRow>),
}

impl Store {
    /// Writes a job down before it starts. Durable on return.
    ///
    /// # Errors
    /// What every write may meet: [`StoreError::Full`], [`StoreError::Unavailable`].
    pub async fn insert_job(&self, new: NewJob) -> Result<InsertedJob, StoreError> {
        self.writer.write(new).await
    }

    /// Writes down how a job ended; the first end stays.
    ///
    /// # Errors
    /// What every write may meet.
    pub async fn end_job(&self, end: EndedJob) -> Result<(), StoreError> {
        self.writer.write(End { end, frees: false }).await
    }

    /// Writes down that a job was refused before anything was sent: its request and its plan may be tried again.
    ///
    /// # Errors
    /// What every write may meet.
    pub async fn refuse_job(&self, end: EndedJob) -> Result<(), StoreError> {
        self.writer.write(End { end, frees: true }).await
    }

    /// Ends a job by the measurement that it was for, which comes with the file of its scan unless that is kept already: all or
    /// nothing. After an error the caller can pass the file again as long as it keeps it.
    ///
    /// # Errors
    /// As [`Store::insert_measurement_of`].
    pub async fn end_job_with(
        &self,
        end: EndedJob,
        new: NewMeasurement,
        file: Option<Arc<CompleteScan>>,
    ) -> Result<Inserted, StoreError> {
        let write = EndWithMeasurement { end: End { end, frees: false }, new };
        match file {
            Some(file) => self.writer.write(WithFile::new(write, file).await?).await,
            None => self.writer.write(write).await,
        }
    }

    /// Ends all jobs that an earlier process left under way, with this state: those that were.
    ///
    /// # Errors
    /// What every write may meet.
    pub async fn interrupt_jobs(&self, state: &str, at: Timestamp) -> Result<Vec<JobRow>, StoreError> {
        self.writer.write(Interrupt { state: state.to_owned(), at }).await
    }

    /// The job of this id.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn job(&self, id: &str) -> Result<Option<JobRow>, StoreError> {
        self.one_job(statements::JOB, id).await
    }

    /// The job that a request of this id asked for.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn job_by_request(&self, request_id: &str) -> Result<Option<JobRow>, StoreError> {
        self.one_job(statements::JOB_OF_REQUEST, request_id).await
    }

    /// The job that executes the plan of this id.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn job_of_plan(&self, plan_id: &str) -> Result<Option<JobRow>, StoreError> {
        self.one_job(statements::JOB_OF_PLAN, plan_id).await
    }

    /// A page of the jobs of a kind, of one state where it is given, newest first.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn jobs(&self, kind: &str, state: Option<&str>, page: &Page) -> Result<Listing<JobRow>, StoreError> {
        page::list(&self.readers, &[("kind", Some(kind)), ("state", state)], page).await
    }

    /// The greatest fencing token that was recorded; 0 if there is none.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn fence(&self) -> Result<u64, StoreError> {
        let row = sqlx::query(statements::FENCE).fetch_optional(&self.readers).await?;
        Ok(row.map(|row| count(&row, "fence")).transpose()?.unwrap_or(0))
    }

    /// Records a fencing token before a command is sent with it; a lower one changes nothing. Durable on return.
    ///
    /// # Errors
    /// What every write may meet.
    pub async fn raise_fence(&self, fence: u64) -> Result<(), StoreError> {
        self.writer.write(RaiseFence(integer(fence)?)).await
    }

    async fn one_job(&self, statement: &'static str, key: &str) -> Result<Option<JobRow>, StoreError> {
        Ok(sqlx::query_as(statement).bind(key).fetch_optional(&self.readers).await?)
    }
}

impl Write for NewJob {
    type Outcome = InsertedJob;

    async fn apply(&self, database: &mut SqliteConnection) -> Result<InsertedJob, StoreError> {
        if let Some(request) = &self.row.request
            && let Some(earlier) = find(statements::JOB_OF_REQUEST, &request.id, database).await?
        {
            let same = earlier.request.as_ref().is_some_and(|asked| asked.fingerprint == request.fingerprint);
            return Ok(if same { InsertedJob::Replayed(Box::new(earlier)) } else { InsertedJob::RequestMismatch });
        }
        if let Some(plan_id) = &self.row.plan_id
            && let Some(earlier) = find(statements::JOB_OF_PLAN, plan_id, database).await?
        {
            return Ok(InsertedJob::PlanUsed(Box::new(earlier)));
        }
        insert(&self.row, database).await?;
        Ok(InsertedJob::New)
    }
}

async fn find(
    statement: &'static str,
    key: &str,
    database: &mut SqliteConnection,
) -> Result<Option<JobRow>, StoreError> {
    Ok(sqlx::query_as(statement).bind(key).fetch_optional(database).await?)
}

async fn insert(row: &JobRow, database: &mut SqliteConnection) -> Result<(), StoreError> {
    let (request_id, fingerprint) = row.request.as_ref().map(|r| (&r.id, &r.fingerprint)).unzip();
    let insert = sqlx::query(statements::INSERT_JOB)
        .bind(&row.id)
        .bind(&row.kind)
        .bind(micros(row.created_at))
        .bind(&row.state)
        .bind(row.ended_at.map(micros))
        .bind(&row.plan_id)
        .bind(request_id)
        .bind(fingerprint)
        .bind(&row.document);
    insert.execute(database).await?;
    Ok(())
}

/// The end of a job; `frees` its request and its plan where nothing was sent.
struct End {
    end: EndedJob,
    frees: bool,
}

impl Write for End {
    type Outcome = ();

    async fn apply(&self, database: &mut SqliteConnection) -> Result<(), StoreError> {
        let EndedJob { id, state, ended_at, document } = &self.end;
        let statement = if self.frees { statements::REFUSE_JOB } else { statements::END_JOB };
        let update = sqlx::query(statement).bind(id).bind(state).bind(micros(*ended_at)).bind(document);
        update.execute(database).await?;
        Ok(())
    }
}

struct EndWithMeasurement {
    end: End,
    new: NewMeasurement,
}

impl Write for EndWithMeasurement {
    type Outcome = Inserted;

    async fn apply(&self, database: &mut SqliteConnection) -> Result<Inserted, StoreError> {
        let inserted = self.new.apply(database).await?;
        self.end.apply(database).await?;
        Ok(inserted)
    }
}

struct Interrupt {
    state: String,
    at: Timestamp,
}

impl Write for Interrupt {
    type Outcome = Vec<JobRow>;

    async fn apply(&self, database: &mut SqliteConnection) -> Result<Vec<JobRow>, StoreError> {
        let under_way = sqlx::query_as(statements::JOBS_UNDER_WAY).fetch_all(&mut *database).await?;
        let update = sqlx::query(statements::INTERRUPT_JOBS).bind(&self.state).bind(micros(self.at));
        update.execute(database).await?;
        Ok(under_way)
    }
}

struct RaiseFence(i64);

impl Write for RaiseFence {
    type Outcome = ();

    async fn apply(&self, database: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query(statements::RAISE_FENCE).bind(self.0).execute(database).await?;
        Ok(())
    }
}

impl Listed for JobRow {
    const LIST: statements::List = statements::JOBS;
}

impl FromRow<'_, SqliteRow> for JobRow {
    fn from_row(row: &SqliteRow) -> Result<Self, sqlx::Error> {
        Ok(Self {
            id: text(row, "id")?,
            kind: text(row, "kind")?,
            created_at: timestamp(row, "created_at")?,
            state: text(row, "state")?,
            ended_at: optional_timestamp(row, "ended_at")?,
            plan_id: optional_text(row, "plan_id")?,
            request: request(row)?,
            document: text(row, "document")?,
        })
    }
}

/// The request of a row that may have none.
pub(super) fn request(row: &SqliteRow) -> Result<Option<RequestKey>, sqlx::Error> {
    let (id, fingerprint) = (optional_text(row, "request_id")?, optional_text(row, "fingerprint")?);
    Ok(id.zip(fingerprint).map(|(id, fingerprint)| RequestKey { id, fingerprint }))
}
