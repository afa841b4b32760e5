//! Plans of motion: written once, found again by id and by request.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{FromRow, SqliteConnection};

use super::error::StoreError;
use super::jobs::request;
use super::page::{self, Listed, Listing, Page};
use super::repository::Store;
use super::rows::{RequestKey, micros, optional_text, text, timestamp};
use super::statements;
use super::writer::Write;

/// A plan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlanRow {
    /// Its id, made by service.
    pub id: String,
    /// When it was made; kept to the microsecond.
    pub created_at: Timestamp,
    /// The request that asked for it, where the client gave it an id.
    pub request: Option<RequestKey>,
    /// The plan.
    pub document: String,
}

/// A plan as it stands in a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedPlan {
    /// The plan.
    pub plan: PlanRow,
    /// The job that executes it, where one does.
    pub job_id: Option<String>,
}

/// What became of a plan that was to be kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum InsertedPlan {
    /// It is kept.
    New,
    /// The request was answered before, by this plan; nothing was written.
    Replayed(Box<PlanRow>),
    /// The request's id was used before for something else; nothing was written.
    RequestMismatch,
}

impl Store {
    /// Keeps a plan. Durable on return.
    ///
    /// # Errors
    /// What every write may meet: [`StoreError::Full`], [`StoreError::Unavailable`].
    pub async fn insert_plan(&self, plan: PlanRow) -> Result<InsertedPlan, StoreError> {
        self.writer.write(plan).await
    }

    /// The plan of this id.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn plan(&self, id: &str) -> Result<Option<PlanRow>, StoreError> {
        Ok(sqlx::query_as(statements::PLAN).bind(id).fetch_optional(&self.readers).await?)
    }

    /// The plan that a request of this id asked for.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn plan_by_request(&self, request_id: &str) -> Result<Option<PlanRow>, StoreError> {
        Ok(sqlx::query_as(statements::PLAN_OF_REQUEST).bind(request_id).fetch_optional(&self.readers).await?)
    }

    /// A page of the plans, newest first.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn plans(&self, page: &Page) -> Result<Listing<ListedPlan>, StoreError> {
        page::list(&self.readers, &[], page).await
    }
}

impl Write for PlanRow {
    type Outcome = InsertedPlan;

    async fn apply(&self, database: &mut SqliteConnection) -> Result<InsertedPlan, StoreError> {
        if let Some(RequestKey { id, fingerprint }) = &self.request {
            let select = sqlx::query_as(statements::PLAN_OF_REQUEST).bind(id);
            let earlier: Option<Self> = select.fetch_optional(&mut *database).await?;
            if let Some(earlier) = earlier {
                let same = earlier.request.as_ref().is_some_and(|asked| asked.fingerprint == *fingerprint);
                return Ok(if same {
                    InsertedPlan::Replayed(Box::new(earlier))
                } else {
                    InsertedPlan::RequestMismatch
                });
            }
        }
        let (request_id, fingerprint) = self.request.as_ref().map(|r| (&r.id, &r.fingerprint)).unzip();
        let insert = sqlx::query(statements::INSERT_PLAN)
            .bind(&self.id)
            .bind(micros(self.created_at))
            .bind(request_id)
            .bind(fingerprint)
            .bind(&self.document);
        insert.execute(database).await?;
        Ok(InsertedPlan::New)
    }
}

impl Listed for ListedPlan {
    const LIST: statements::List = statements::PLANS;
}

impl FromRow<'_, SqliteRow> for ListedPlan {
    fn from_row(row: &SqliteRow) -> Result<Self, sqlx::Error> {
        Ok(Self { plan: PlanRow::from_row(row)?, job_id: optional_text(row, "job_id")? })
    }
}

impl FromRow<'_, SqliteRow> for PlanRow {
    fn from_row(row: &SqliteRow) -> Result<Self, sqlx::Error> {
        Ok(Self {
            id: text(row, "id")?,
            created_at: timestamp(row, "created_at")?,
            request: request(row)?,
            document: text(row, "document")?,
        })
    }
}
