//! What a client requests of a measurement, and the declared properties of the bytes of its scan.

use super::recipe::RecipeName;
use super::recipe::{Recipe, Resolved};
use super::record::Measurement;
use crate::scan::decode::{Format, FormatClaims};
use crate::service::acquisition::Acquisition;
use crate::service::error::ServiceError;
use serde::Serialize;
use std::sync::Arc;

/// A client's own id of a request, so that the request may be repeated without harm.
pub type RequestId = String;

/// Parameters of a measurement besides the scan.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct MeasurementOrder {
    /// Name of a stored recipe.
    pub recipe: Option<RecipeName>,
    /// Values of the request that override the recipe.
    pub overrides: Recipe,
    /// With an id, a repeated request gets the first answer again.
    #[serde(skip)]
    pub request_id: Option<RequestId>,
}

/// A measurement, and whether it was recorded for an earlier request of the same id.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The record.
    pub measurement: Measurement,
    /// Whether an earlier answer is repeated, without a calculation.
    pub replayed: bool,
}

/// An order whose recipe was looked up and resolved.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedOrder {
    pub(in crate::service) order: MeasurementOrder,
    pub(in crate::service) resolved: Resolved,
    /// Whether its request id was answered before, so that nothing will be calculated.
    pub(in crate::service) answered: bool,
    /// When the scan arrived, if it is sent with this request.
    pub(in crate::service) acquisition: Acquisition,
}

impl ResolvedOrder {
    /// When the scan arrived, as stored.
    pub(in crate::service) fn arrival(&self) -> Result<String, ServiceError> {
        serde_json::to_string(&self.acquisition)
            .map_err(|source| ServiceError::RecordUnwritable { what: "scan", source: Arc::new(source) })
    }
}

/// Declared properties of the bytes of a scan.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Origin {
    /// The format given as a parameter.
    pub parameter: Option<Format>,
    /// The media type they were sent with.
    pub media_type: Option<String>,
    /// The name of the file.
    pub file_name: Option<String>,
}

impl Origin {
    /// The same for the decoder.
    #[must_use]
    pub fn claims(&self) -> FormatClaims<'_> {
        FormatClaims {
            parameter: self.parameter,
            media_type: self.media_type.as_deref(),
            file_name: self.file_name.as_deref(),
        }
    }
}
