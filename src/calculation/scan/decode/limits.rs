//! The limits of a scan. Every reader checks them before it uses a number that a file states.

use serde::{Deserialize, Serialize};

/// Limits on files and on the results of decoding; a setting that is left out keeps its default.
///
/// There is no limit for the nesting of JSON: its reader accepts one structure, four levels deep, and refuses any other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Points of a file, missing ones included.
    pub points_max: usize,
    /// Profiles of a scan.
    pub profiles_max: usize,
    /// Points of one profile.
    pub points_per_profile_max: usize,
    /// Columns of a table, properties of a PLY element, fields of a PCD point.
    pub columns_max: usize,
    /// Lines of a PLY or PCD header.
    pub header_lines_max: usize,
    /// Length of one line of text.
    pub line_bytes_max: usize,
    /// Entries of an NPZ archive.
    pub npz_entries_max: usize,
    /// Bytes after decompression.
    pub inflated_bytes_max: u64,
    /// Bytes after decompression for each byte before it.
    pub inflate_ratio_max: u64,
    /// Largest magnitude of a coordinate, mm.
    pub coordinate_max_mm: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            points_max: 20_000_000,
            profiles_max: 100_000,
            points_per_profile_max: 10_000,
            columns_max: 256,
            header_lines_max: 1_000,
            line_bytes_max: 1 << 20,
            npz_entries_max: 64,
            inflated_bytes_max: 512 << 20,
            inflate_ratio_max: 100,
            coordinate_max_mm: 1e6,
        }
    }
}
