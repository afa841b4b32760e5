//! Named recipes: stored under a precondition, looked up, listed.

use super::recipe::RecipeName;
use std::sync::Arc;

use jiff::Timestamp;

use super::state::Measuring;
use crate::service::background::run_blocking;
use crate::service::document;
use crate::service::document::Entry;
use crate::service::error::ServiceError;
use crate::store::{Listing, Page, Precondition, PutRecipe, RecipeRow};

use super::recipe::Recipe;

/// A recipe and its revision.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRecipe {
    /// Its name.
    pub name: String,
    /// Its values.
    pub recipe: Recipe,
    /// Revision number, from 1.
    pub revision: u64,
    /// Identifies the revision.
    pub etag: String,
    /// When the first revision was stored.
    pub created_at: Timestamp,
    /// When this revision was stored.
    pub updated_at: Timestamp,
}

/// Result of storing a recipe.
#[derive(Debug, Clone, PartialEq)]
pub enum Put {
    /// It is the first of its name.
    Created(StoredRecipe),
    /// It replaced an earlier revision.
    Replaced(StoredRecipe),
}

pub(in crate::service) fn read_back(row: RecipeRow) -> Result<StoredRecipe, ServiceError> {
    let recipe = document::read("recipe", &row.name, &row.document)?;
    let etag = row.etag();
    let RecipeRow { name, revision, created_at, updated_at, .. } = row;
    Ok(StoredRecipe { name, recipe, revision, etag, created_at, updated_at })
}

impl Measuring {
    /// The recipe of this name.
    ///
    /// # Errors
    /// [`ServiceError::RecipeUnknown`].
    pub async fn recipe(&self, name: &RecipeName) -> Result<StoredRecipe, ServiceError> {
        let row = self.shared.store.recipe(name.as_str()).await?;
        read_back(row.ok_or_else(|| ServiceError::RecipeUnknown { name: name.as_str().to_owned() })?)
    }

    /// A page of the recipes, the latest created first.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn recipes(&self, page: &Page) -> Result<Listing<Entry<StoredRecipe>>, ServiceError> {
        let Listing { rows, next } = self.shared.store.recipes(page).await?;
        let read = move || {
            let entry = |row: RecipeRow| {
                let created_at = row.created_at;
                Entry::of(read_back(row), created_at)
            };
            rows.into_iter().map(entry).collect()
        };
        Ok(Listing { rows: run_blocking(read).await?, next })
    }

    /// Validates a recipe and stores it under its name if the precondition is true.
    ///
    /// # Errors
    /// [`ServiceError::Recipe`], [`ServiceError::RecipeChanged`], [`ServiceError::RecipeAbsent`].
    pub async fn put_recipe(
        self: &Arc<Self>,
        name: &RecipeName,
        recipe: &Recipe,
        precondition: Precondition,
    ) -> Result<Put, ServiceError> {
        recipe.check()?;
        let document = document::write("recipe", recipe)?;
        let (service, named) = (Arc::clone(self), name.clone());
        let putting = async move {
            let put = service
                .shared
                .store
                .put_recipe(named.as_str(), &document, service.shared.clock.now(), precondition)
                .await?;
            if !matches!(put, PutRecipe::PreconditionFailed { .. }) {
                service.shared.advance();
            }
            Ok(put)
        };
        match self.shared.background.run_detached(putting).await? {
            PutRecipe::Created(row) => Ok(Put::Created(read_back(row)?)),
            PutRecipe::Replaced(row) => Ok(Put::Replaced(read_back(row)?)),
            PutRecipe::PreconditionFailed { current } => {
                let name = name.as_str().to_owned();
                Err(match current {
                    Some(row) => ServiceError::RecipeChanged { name, current_etag: row.etag() },
                    None => ServiceError::RecipeAbsent { name },
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_short_plain_and_begins_with_a_letter_or_digit() {
        assert!(["a", "shaft-200", "7_b"].into_iter().all(|name| RecipeName::parse(name).is_some()));
        let long = "a".repeat(65);
        assert!(["", "-a", "A", "ä", "a b", "a/b", &long].into_iter().all(|name| RecipeName::parse(name).is_none()));
    }
}
