//! Records of lists that cannot be read: shown as what is known of them, among the others.

use crate::service::{Entry, UnreadableRecord};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

/// A record of a list, or what is known of one that cannot be read.
#[derive(Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub(super) enum EntryDocument<T> {
    /// The record.
    Record(T),
    /// It is damaged, or a later version of the service has written it.
    Unreadable(UnreadableDocument),
}

/// What is known of a record that cannot be read.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Unreadable)]
pub(super) struct UnreadableDocument {
    /// Its id, or its name.
    id: String,
    /// `unreadable`.
    #[schema(example = "unreadable")]
    state: &'static str,
    /// When it was made, UTC.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// Why it cannot be read.
    text: String,
}

impl<T> EntryDocument<T> {
    /// As it is shown.
    pub(super) fn of<R>(entry: Entry<R>, show: impl FnOnce(R) -> T) -> Self {
        match entry {
            Entry::Record(record) => Self::Record(show(record)),
            Entry::Unreadable(UnreadableRecord { id, created_at, cause }) => {
                let text = format!("the record cannot be read: {cause}");
                Self::Unreadable(UnreadableDocument { id, state: "unreadable", created_at, text })
            }
        }
    }
}
