//! The formats that are read and written, with their names and media types.

use serde::{Deserialize, Serialize};
use std::fmt;

/// The formats that are read and written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// Text tables: CSV, TXT, XYZ, ASC, TSV, PTS, DS.
    Csv,
    /// The sectioned text that Gocator sensors export, version 2.
    GocatorCsv,
    /// Polygon files, text or binary; vertices only.
    Ply,
    /// Point cloud library files, text, binary or compressed.
    Pcd,
    /// One numpy array.
    Npy,
    /// Numpy arrays in a zip archive.
    Npz,
    /// `{"profiles": [{"x_mm": 0.0, "points": [[y, z], ...]}]}`
    Json,
}

impl Format {
    /// Every format, in the order in which messages list them.
    pub const ALL: [Self; 7] = [Self::Csv, Self::GocatorCsv, Self::Ply, Self::Pcd, Self::Npy, Self::Npz, Self::Json];

    /// The name used in requests, results and messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::GocatorCsv => "gocator_csv",
            Self::Ply => "ply",
            Self::Pcd => "pcd",
            Self::Npy => "npy",
            Self::Npz => "npz",
            Self::Json => "json",
        }
    }

    /// The format of a name or a file extension, irrespective of case.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let name = name.trim().to_ascii_lowercase();
        match name.as_str() {
            "txt" | "xyz" | "asc" | "tsv" | "pts" | "ds" => Some(Self::Csv),
            _ => Self::ALL.into_iter().find(|format| format.name() == name),
        }
    }

    /// The format of a media type without its parameters; `None` if the type is general or unknown.
    #[must_use]
    pub fn from_media_type(media_type: &str) -> Option<Self> {
        let essence = media_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
        match essence.as_str() {
            "text/csv" | "application/csv" | "text/tab-separated-values" => Some(Self::Csv),
            "application/vnd.gocator+csv" => Some(Self::GocatorCsv),
            "application/ply" | "application/x-ply" | "model/ply" => Some(Self::Ply),
            "application/pcd" | "application/x-pcd" | "application/vnd.pointcloud+pcd" => Some(Self::Pcd),
            "application/npy" | "application/x-npy" => Some(Self::Npy),
            "application/npz" | "application/x-npz" | "application/zip" => Some(Self::Npz),
            "application/json" => Some(Self::Json),
            _ => None,
        }
    }

    /// The media type of files of this format.
    #[must_use]
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Csv => "text/csv",
            Self::GocatorCsv => "application/vnd.gocator+csv",
            Self::Ply => "application/x-ply",
            Self::Pcd => "application/x-pcd",
            Self::Npy => "application/x-npy",
            Self::Npz => "application/x-npz",
            Self::Json => "application/json",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
