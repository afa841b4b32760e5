//! Documents as stored: each has the version of its format, so that a document of a later version is recognised. A document that
//! cannot be read does not hide the others.
//!
//! ```text
//! {"document_version": 1, "content": …}     a document written before versions existed consists of the content alone
//! ```

use super::error::{ServiceError, Unreadable};
use jiff::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The version of the documents that this program writes, and the latest that it reads.
const VERSION: u64 = 1;

/// A record in a list.
#[derive(Debug, Clone)]
pub enum Entry<T> {
    /// It was read.
    Record(T),
    /// It cannot be read.
    Unreadable(UnreadableRecord),
}

/// The known facts about a record that cannot be read.
#[derive(Debug, Clone)]
pub struct UnreadableRecord {
    /// Its id, or its name.
    pub id: String,
    /// When it was created.
    pub created_at: Timestamp,
    /// Why it cannot be read.
    pub cause: Unreadable,
}

impl<T> Entry<T> {
    /// The list entry for the result of reading a record.
    ///
    /// # Errors
    /// Any error other than an unreadable record.
    pub(in crate::service) fn of(read: Result<T, ServiceError>, created_at: Timestamp) -> Result<Self, ServiceError> {
        match read {
            Ok(record) => Ok(Self::Record(record)),
            Err(ServiceError::RecordUnreadable { what, id, cause }) => {
                tracing::warn!(id, %cause, "the stored {what} {id} cannot be read");
                Ok(Self::Unreadable(UnreadableRecord { id, created_at, cause }))
            }
            Err(error) => Err(error),
        }
    }
}

#[derive(Serialize)]
struct Written<'a, T> {
    document_version: u64,
    content: &'a T,
}

#[derive(Deserialize)]
struct Version {
    document_version: Option<u64>,
}

#[derive(Deserialize)]
struct Content<T> {
    content: T,
}

/// The document of a record.
///
/// # Errors
/// [`ServiceError::RecordUnwritable`].
pub(in crate::service) fn write<T: Serialize>(what: &'static str, content: &T) -> Result<String, ServiceError> {
    serde_json::to_string(&Written { document_version: VERSION, content })
        .map_err(|source| ServiceError::RecordUnwritable { what, source: Arc::new(source) })
}

/// The record of a document.
///
/// # Errors
/// [`ServiceError::RecordUnreadable`].
pub(in crate::service) fn read<T: DeserializeOwned>(
    what: &'static str,
    id: &str,
    text: &str,
) -> Result<T, ServiceError> {
    parse(text).map_err(|cause| ServiceError::RecordUnreadable { what, id: id.to_owned(), cause })
}

fn parse<T: DeserializeOwned>(text: &str) -> Result<T, Unreadable> {
    let damaged = |source| Unreadable::Damaged(Arc::new(source));
    let Version { document_version } = serde_json::from_str(text).map_err(damaged)?;
    match document_version {
        None => serde_json::from_str(text).map_err(damaged),
        Some(found) if found > VERSION => Err(Unreadable::Later { found, known: VERSION }),
        Some(_) => serde_json::from_str(text).map(|Content { content }| content).map_err(damaged),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::Recipe;

    #[test]
    fn a_document_reads_back_with_and_without_a_version_and_a_later_version_is_reported() {
        let recipe = Recipe { points_min: Some(33), ..Recipe::default() };
        let written = write("recipe", &recipe).expect("written");
        assert_eq!(written, r#"{"document_version":1,"content":{"points_min":33}}"#);
        for text in [written.as_str(), r#"{"points_min":33}"#] {
            assert_eq!(read::<Recipe>("recipe", "a", text).expect("read"), recipe);
        }
        let later = read::<Recipe>("recipe", "a", r#"{"document_version":2,"new":{}}"#).expect_err("later");
        assert!(matches!(
            &later,
            ServiceError::RecordUnreadable { cause: Unreadable::Later { found: 2, known: 1 }, .. }
        ));
        for text in ["", "{", r#"{"document_version":1}"#, r#"{"document_version":1,"content":{"points_minn":1}}"#] {
            let damaged = read::<Recipe>("recipe", "a", text).expect_err("damaged");
            let ServiceError::RecordUnreadable { cause: Unreadable::Damaged(_), .. } = damaged else {
                panic!("{damaged}");
            };
        }
    }
}
