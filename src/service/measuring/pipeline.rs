//! The complete path from the bytes of a scan to an estimate, in one place for service and offline command, so that both give
//! the same bits. The input is a reader and a resolved recipe.

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
    /// The detected format.
    pub format: Format,
    /// The unit in which its coordinates were read.
    pub unit: Unit,
    /// Its profiles.
    pub scan: Scan,
    /// Number of points in the file.
    pub points_count: u64,
    /// Number of points that the file marks as missing, not included in the above.
    pub missing_count: u64,
    /// Values that mark missing points, and profiles that repeat an earlier one.
    pub warnings: Vec<Warning>,
}

/// A scan with its estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The scan.
    pub prepared: Prepared,
    /// The result.
    pub estimate: ScanEstimate,
}

/// Why a scan could not be estimated. An estimate that refuses the scan is a result, not an error.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The bytes are not a readable scan.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The points cannot be cut into profiles as requested.
    #[error(transparent)]
    Slice(#[from] SliceError),
}

/// The decoded file, before it is cut into profiles.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoded {
    /// The detected format.
    pub format: Format,
    /// Its points.
    pub cloud: Cloud,
}

/// Decodes bytes to points; `sent` counts the compressed bytes if they are decompressed during reading.
///
/// # Errors
/// [`DecodeError`] with the cause in the bytes.
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

/// Cuts points into profiles.
///
/// # Errors
/// [`MeasureError`] if the points cannot be cut as requested.
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

/// Warnings about removed points; declared missing values need none.
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

/// Estimates the pose from points.
///
/// # Errors
/// [`MeasureError`] if the points cannot be cut as requested.
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
