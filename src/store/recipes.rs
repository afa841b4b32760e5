//! Recipes: the current revision of each name, written under a precondition.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{FromRow, SqliteConnection};

use super::error::StoreError;
use super::page::{self, Listed, Listing, Page};
use super::repository::Store;
use super::rows::{Precondition, PutRecipe, RecipeRow, count, integer, micros, text, timestamp};
use super::statements;
use super::writer::Write;

impl Store {
    /// Stores a recipe if the precondition is fulfilled at that moment. Durable on return.
    ///
    /// # Errors
    /// The errors of every write: [`StoreError::Full`], [`StoreError::Unavailable`].
    pub async fn put_recipe(
        &self,
        name: &str,
        document: &str,
        updated_at: Timestamp,
        precondition: Precondition,
    ) -> Result<PutRecipe, StoreError> {
        let (name, document) = (name.to_owned(), document.to_owned());
        self.writer.write(Put { name, document, updated_at, precondition }).await
    }

    /// The current revision of the recipe with this name.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn recipe(&self, name: &str) -> Result<Option<RecipeRow>, StoreError> {
        Ok(sqlx::query_as(statements::RECIPE).bind(name).fetch_optional(&self.readers).await?)
    }

    /// A page of the recipes, by the time of their first revision, newest first.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn recipes(&self, page: &Page) -> Result<Listing<RecipeRow>, StoreError> {
        page::list(&self.readers, &[], page).await
    }
}

struct Put {
    name: String,
    document: String,
    updated_at: Timestamp,
    precondition: Precondition,
}

impl Write for Put {
    type Outcome = PutRecipe;

    async fn apply(&self, database: &mut SqliteConnection) -> Result<PutRecipe, StoreError> {
        let select = sqlx::query_as(statements::RECIPE).bind(&self.name);
        let current: Option<RecipeRow> = select.fetch_optional(&mut *database).await?;
        if !holds(&self.precondition, current.as_ref()) {
            return Ok(PutRecipe::PreconditionFailed { current });
        }
        match current {
            None => Ok(PutRecipe::Created(self.create(database).await?)),
            Some(current) => Ok(PutRecipe::Replaced(self.replace(&current, database).await?)),
        }
    }
}

impl Put {
    fn revision(&self, revision: u64, created_at: Timestamp) -> RecipeRow {
        let (name, document) = (self.name.clone(), self.document.clone());
        RecipeRow { name, revision, document, created_at, updated_at: self.updated_at }
    }

    async fn create(&self, database: &mut SqliteConnection) -> Result<RecipeRow, StoreError> {
        let row = self.revision(1, self.updated_at);
        let insert = sqlx::query(statements::INSERT_RECIPE)
            .bind(&row.name)
            .bind(integer(row.revision)?)
            .bind(&row.document)
            .bind(micros(row.created_at))
            .bind(micros(row.updated_at));
        insert.execute(database).await?;
        Ok(row)
    }

    async fn replace(&self, current: &RecipeRow, database: &mut SqliteConnection) -> Result<RecipeRow, StoreError> {
        let row = self.revision(current.revision.saturating_add(1), current.created_at);
        let update = sqlx::query(statements::REPLACE_RECIPE)
            .bind(&row.name)
            .bind(integer(row.revision)?)
            .bind(&row.document)
            .bind(micros(row.updated_at));
        update.execute(database).await?;
        Ok(row)
    }
}

fn holds(precondition: &Precondition, current: Option<&RecipeRow>) -> bool {
    match precondition {
        Precondition::None => true,
        Precondition::MustExist => current.is_some(),
        Precondition::MustNotExist => current.is_none(),
        Precondition::Match(etag) => current.is_some_and(|current| current.etag() == *etag),
    }
}

impl Listed for RecipeRow {
    const LIST: statements::List = statements::RECIPES;
}

impl FromRow<'_, SqliteRow> for RecipeRow {
    fn from_row(row: &SqliteRow) -> Result<Self, sqlx::Error> {
        Ok(Self {
            name: text(row, "name")?,
            revision: count(row, "revision")?,
            document: text(row, "document")?,
            created_at: timestamp(row, "created_at")?,
            updated_at: timestamp(row, "updated_at")?,
        })
    }
}
