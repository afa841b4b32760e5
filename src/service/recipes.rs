//! Recipes under a name: put under a precondition, looked up, listed.

use super::document::Entry;
use super::error::ServiceError;
use super::followers::aside;
use super::recipe::Recipe;
use super::{Service, document};
use crate::store::{Listing, Page, Precondition, PutRecipe, RecipeRow};
use jiff::Timestamp;
use serde::Serialize;
use std::sync::Arc;

/// Lower-case letters, digits, `-` and `_`, at most 64, the first no sign.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct RecipeName(String);

impl RecipeName {
    /// Longest name.
    pub const CHARACTERS_MAX: usize = 64;

    /// The name, if it is one.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
        let well_formed = text.bytes().all(|byte| plain(byte) || matches!(byte, b'-' | b'_'))
            && text.bytes().next().is_some_and(plain)
            && text.len() <= Self::CHARACTERS_MAX;
        well_formed.then(|| Self(text.to_owned()))
    }

    /// As text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// As text.
    #[must_use]
    pub fn into_string(self) -> String {
        self.0
    }
}

/// A recipe with what is known about its revision.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRecipe {
    /// Its name.
    pub name: String,
    /// What it says.
    pub recipe: Recipe,
    /// Counts up from 1.
    pub revision: u64,
    /// Names the revision.
    pub etag: String,
    /// When the first revision was put.
    pub created_at: Timestamp,
    /// When this revision was put.
    pub updated_at: Timestamp,
}

/// What became of a recipe that was put.
#[derive(Debug, Clone, PartialEq)]
pub enum Put {
    /// It is the first of its name.
    Created(StoredRecipe),
    /// It took the place of an earlier revision.
    Replaced(StoredRecipe),
}

impl Service {
    /// The recipe of a name.
    ///
    /// # Errors
    /// [`ServiceError::RecipeUnknown`].
    pub async fn recipe(&self, name: &RecipeName) -> Result<StoredRecipe, ServiceError> {
        let row = self.store.recipe(name.as_str()).await?;
        read_back(row.ok_or_else(|| ServiceError::RecipeUnknown { name: name.as_str().to_owned() })?)
    }

    /// A page of the recipes, the latest made first.
    ///
    /// # Errors
    /// What the store says.
    pub async fn recipes(&self, page: &Page) -> Result<Listing<Entry<StoredRecipe>>, ServiceError> {
        let Listing { rows, next } = self.store.recipes(page).await?;
        let read = move || {
            let entry = |row: RecipeRow| {
                let created_at = row.created_at;
                Entry::of(read_back(row), created_at)
            };
            rows.into_iter().map(entry).collect()
        };
        Ok(Listing { rows: aside(read).await?, next })
    }

    /// Checks a recipe and puts it under its name where the precondition holds.
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
            let put = service.store.put_recipe(named.as_str(), &document, service.clock.now(), precondition).await?;
            if !matches!(put, PutRecipe::PreconditionFailed { .. }) {
                service.advance();
            }
            Ok(put)
        };
        match self.followers.whole(putting).await? {
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

pub(super) fn read_back(row: RecipeRow) -> Result<StoredRecipe, ServiceError> {
    let recipe = document::read("recipe", &row.name, &row.document)?;
    let etag = row.etag();
    let RecipeRow { name, revision, created_at, updated_at, .. } = row;
    Ok(StoredRecipe { name, recipe, revision, etag, created_at, updated_at })
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
