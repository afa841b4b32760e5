//! The flags of `coaxis simulate scan` for how points are written, and for scans that are moved as a whole.

use crate::geometry::Frame;
use crate::scan::synthetic::{Coordinates, Export, Sentinel, SentinelPlace, Steps, random_frame};

/// Without these flags the points are written as they were scanned, in the rail frame.
#[derive(Debug, clap::Args)]
pub(super) struct ExportArguments {
    /// Round x to multiples of this
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    x_step_mm: f64,
    /// Round y to multiples of this
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    y_step_mm: f64,
    /// Round z to multiples of this
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    z_step_mm: f64,
    /// Number that stands for points without a return, e.g. -9999
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    sentinel_mm: Option<f64>,
    /// Share of the points that become this number
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, allow_hyphen_values = true, requires = "sentinel_mm")]
    sentinel_share: f64,
    /// Which points: random, or edges (the first and the last of every profile)
    #[arg(long, value_name = "WHERE", default_value = "random", value_parser = place, requires = "sentinel_mm")]
    sentinel_at: SentinelPlace,
    /// Coordinates that become this number: z, yz or xyz
    #[arg(long, value_name = "WHICH", default_value = "z", value_parser = coordinates, requires = "sentinel_mm")]
    sentinel_in: Coordinates,
    /// Turn the scan in a random direction and move it by up to --moved-mm along each axis; the same seed moves it alike. The
    /// scan becomes a cloud without profiles, which json and gocator_csv cannot hold
    #[arg(long, value_name = "SEED", conflicts_with = "frame_x_axis")]
    moved_seed: Option<u64>,
    /// Farthest that --moved-seed moves the scan along each axis
    #[arg(long, value_name = "MM", default_value_t = 1000.0, allow_hyphen_values = true, requires = "moved_seed")]
    moved_mm: f64,
    /// Move the scan so that the rail lies in this direction
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = three, requires = "frame_z_axis")]
    frame_x_axis: Option<Three>,
    /// Direction of the rail frame's Z in the moved scan
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = three, requires = "frame_x_axis")]
    frame_z_axis: Option<Three>,
    /// Origin of the rail frame in the moved scan
    #[arg(
        long,
        value_name = "X,Y,Z",
        default_value = "0,0,0",
        allow_hyphen_values = true,
        value_parser = three,
        requires = "frame_x_axis"
    )]
    frame_origin_mm: Three,
    /// Write the points of a moved scan in random order
    #[arg(long)]
    shuffle: bool,
}

/// Three numbers.
#[derive(Debug, Clone, Copy)]
struct Three([f64; 3]);

fn three(text: &str) -> Result<Three, String> {
    let wrong = || "the value must be three numbers, e.g. 0,0,1".to_owned();
    let numbers: Vec<f64> =
        text.split(',').map(|part| part.trim().parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
    let three: [f64; 3] = numbers.try_into().map_err(|_| wrong())?;
    // Far beyond any coordinate that a reader accepts.
    if three.iter().all(|number| number.abs() <= 1e9) { Ok(Three(three)) } else { Err(wrong()) }
}

fn place(text: &str) -> Result<SentinelPlace, String> {
    match text {
        "random" => Ok(SentinelPlace::Random),
        "edges" => Ok(SentinelPlace::Edges),
        _ => Err("the value must be random or edges".to_owned()),
    }
}

fn coordinates(text: &str) -> Result<Coordinates, String> {
    match text {
        "z" => Ok(Coordinates::Z),
        "yz" => Ok(Coordinates::YZ),
        "xyz" => Ok(Coordinates::XYZ),
        _ => Err("the value must be z, yz or xyz".to_owned()),
    }
}

impl ExportArguments {
    pub(super) fn export(&self) -> Export {
        let sentinel = self.sentinel_mm.map(|value_mm| Sentinel {
            value_mm,
            ratio: self.sentinel_share,
            place: self.sentinel_at,
            coordinates: self.sentinel_in,
        });
        Export { steps: Steps { x_mm: self.x_step_mm, y_mm: self.y_step_mm, z_mm: self.z_step_mm }, sentinel }
    }

    /// Where the rail frame lies in the written scan; `None` where the scan is not moved.
    pub(super) fn frame(&self) -> Option<Frame> {
        let given = self.frame_x_axis.zip(self.frame_z_axis);
        let given = given.map(|(Three(x_axis), Three(z_axis))| {
            let Three(origin_mm) = self.frame_origin_mm;
            Frame { origin_mm, x_axis, z_axis }
        });
        given.or_else(|| self.moved_seed.map(|seed| random_frame(seed, self.moved_mm)))
    }

    /// The seed of the order of the points; `None` where they keep it.
    pub(super) fn shuffle_seed(&self, seed: u64) -> Option<u64> {
        self.shuffle.then_some(seed)
    }

    /// Names, values and bounds, in the order of the flags.
    pub(super) fn ranges(&self) -> [(&'static str, f64, f64, f64); 6] {
        [
            ("x-step-mm", self.x_step_mm, 0.0, 1e4),
            ("y-step-mm", self.y_step_mm, 0.0, 1e4),
            ("z-step-mm", self.z_step_mm, 0.0, 1e4),
            ("sentinel-mm", self.sentinel_mm.unwrap_or(0.0), -1e9, 1e9),
            ("sentinel-share", self.sentinel_share, 0.0, 1.0),
            ("moved-mm", self.moved_mm, 0.0, 1e6),
        ]
    }
}
