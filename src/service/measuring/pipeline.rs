//! The whole way from the bytes of a scan to an estimate, in one place for service and offline command, so that both give
//! the same bits. In: a reader and a resolved recipe. Plain calculation: must not know store, clock or network.

use std::io::BufRead;

use super::recipe::Resolved;
use crate::estimation::{Progress, ScanEstimate, Warning, estimate_parts};
use crate::scan::decode::{DecodeError, Format, FormatClaims, Limits, Request, Sent, Unit, decode, find_format};
use crate::scan::missing::{MissingKind, Removed, clean};
use crate::scan::slice::{SliceError, slice};
use crate::scan::{Cloud, Scan};

/// A scan that was read and cut into profiles.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// What the file turned out to be.
    pub format: Format,
    /// The unit that its coordinates were read in.
    pub unit: Unit,
    /// Its profiles.
    pub scan: Scan,
    /// Points that the file holds.
    pub points_count: u64,
    /// Points that the file marks as missing, besides.
    pub missing_count: u64,
    /// Values that stand for missing points, and profiles that repeat an earlier one.
    pub warnings: Vec<Warning>,
}

/// A scan that was estimated.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// What it was estimated from.
    pub prepared: Prepared,
    /// What came out.
    pub estimate: ScanEstimate,
}

/// Why a scan could not be estimated. An estimate that refuses is no such reason but a result.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The bytes are not a scan that can be read.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The points cannot be put into profiles as asked.
    #[error(transparent)]
    Slice(#[from] SliceError),
}

/// What a file turned out to be, before anybody cuts it into profiles.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoded {
    /// What the file turned out to be.
    pub format: Format,
    /// Its points.
    pub cloud: Cloud,
}

/// Bytes to points; `sent` counts the bytes as they were sent, where they were unpacked on the way.
///
/// # Errors
/// [`DecodeError`] with what is wrong with the bytes.
pub fn read(
    reader: &mut dyn BufRead,
    claims: &FormatClaims<'_>,
    resolved: &Resolved,
    limits: &Limits,
    sent: Option<&Sent>,
) -> Result<Decoded, DecodeError> {
    let format = find_format(claims, reader.fill_buf()?)?;
    let Resolved { unit, decimal, grid, .. } = *resolved;
    let request = Request { unit, profile_column: resolved.profile_column(), decimal, grid, limits, sent };
    Ok(Decoded { format, cloud: decode(format, reader, &request)? })
}

/// Points to profiles.
///
/// # Errors
/// [`MeasureError`] with what is wrong with the way they are to be cut.
pub(in crate::service) fn cut(
    decoded: Decoded,
    resolved: &Resolved,
    limits: &Limits,
) -> Result<Prepared, MeasureError> {
    let Decoded { format, cloud } = decoded;
    let (cloud, removed) = clean(cloud, resolved.missing_values.as_deref());
    let points_count = u64::try_from(cloud.columns.len()).unwrap_or(u64::MAX);
    let (unit, missing_count) = (cloud.unit, cloud.missing_count);
    if points_count == 0 {
        return Err(DecodeError::NoPoints { missing_count }.into());
    }
    let scan = slice(cloud, &resolved.slicing, limits)?;
    Ok(Prepared { format, unit, scan, points_count, missing_count, warnings: warnings(&removed) })
}

/// What a user should know of the points that were removed; what was declared needs no word.
fn warnings(removed: &Removed) -> Vec<Warning> {
    let found = removed.missing.iter().filter(|missing| !matches!(missing.kind, MissingKind::Declared(_)));
    let missing = found.map(|missing| Warning::MissingValues {
        value: missing.to_string(),
        count: missing.count,
        points_count: removed.points,
    });
    let (repeated_count, profiles_count) = (removed.repeated_profiles, removed.profiles);
    let repeated = (repeated_count > 0).then_some(Warning::RepeatedProfiles { repeated_count, profiles_count });
    missing.chain(repeated).collect()
}

/// Points to an estimate.
///
/// # Errors
/// [`MeasureError`] with what is wrong with the way they are to be cut.
pub fn measure(
    decoded: Decoded,
    resolved: &Resolved,
    limits: &Limits,
    progress: &Progress,
) -> Result<Measured, MeasureError> {
    let prepared = cut(decoded, resolved, limits)?;
    let mut estimate = estimate_parts(&prepared.scan, &resolved.settings, &resolved.parts, progress);
    estimate.warn(&prepared.warnings);
    Ok(Measured { prepared, estimate })
}
