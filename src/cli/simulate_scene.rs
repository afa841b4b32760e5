//! Flags of `coaxis simulate scan`: for the scene (direction of the sensor, correlated noise, objects on and beside the part), for
//! the written points and the position of the complete scan, and for errors of the sensor, of the stage and of its encoder.

use crate::geometry::Frame;
use crate::scan::synthetic::{
    Bead, Bend, ClampShape, Coordinates, Curl, Export, Interference, LaserPlane, Part, Reflections, RepeatedX, Ripple,
    Sampling, SensorErrors, Sentinel, SentinelPlace, Side, Steps, Surroundings, Travel, random_frame,
};

/// Without a flag its object is absent.
#[derive(Debug, clap::Args)]
pub(super) struct SceneArguments {
    /// Direction of the middle of the arc, from +Z towards +Y
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_hyphen_values = true)]
    view_deg: f64,
    /// Sample by equal steps of y, as a sensor above does, and not by equal angles
    #[arg(long)]
    even_across: bool,
    /// How far profiles may lie from their even places, as a share of half the spacing
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    spacing_spread: f64,
    /// Correlation of a point's noise with its neighbour's along the profile
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    noise_correlation: f64,
    /// Standard deviation by which whole profiles are off, in y and in z
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    jitter_mm: f64,
    /// Face of the clamps: concentric, flat, or the radius of a round clamp in mm
    #[arg(long, value_name = "SHAPE", default_value = "concentric", value_parser = clamp_shape)]
    clamp_shape: ClampShape,
    /// How far from the middle of the arc holes and clamps stand, as a share of it
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    shift: f64,
    /// Height of a weld bead along the part
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    bead_height_mm: f64,
    /// Share of the arc that the bead covers
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, allow_hyphen_values = true)]
    bead_arc: f64,
    /// Where its middle lies along the arc, 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.4, allow_hyphen_values = true)]
    bead_place: f64,
    /// Points on a floor beside the part, as a share of those on it
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    floor: f64,
    /// How far below the axis the floor lies
    #[arg(long, value_name = "MM", default_value_t = 100.0, allow_hyphen_values = true)]
    floor_depth_mm: f64,
    /// Points of a support beside the part, as a share of those on it
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    support: f64,
    /// Share of the profiles that show the support
    #[arg(long, value_name = "SHARE", default_value_t = 1.0, allow_hyphen_values = true)]
    supports: f64,
    /// Radius of a round support; 0 for a level one
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    support_radius_mm: f64,
}

fn clamp_shape(text: &str) -> Result<ClampShape, String> {
    match (text, text.parse::<f64>()) {
        ("concentric", _) => Ok(ClampShape::Concentric),
        ("flat", _) => Ok(ClampShape::Flat),
        (_, Ok(radius_mm)) if (1e-3..=1e5).contains(&radius_mm) => Ok(ClampShape::Round { radius_mm }),
        _ => Err("the value must be concentric, flat, or a radius in mm between 0.001 and 100000".to_owned()),
    }
}

impl SceneArguments {
    /// The part with the objects of this scene.
    pub(super) fn around(&self, part: &Part) -> Part {
        let sampling = if self.even_across { Sampling::EvenAcross } else { Sampling::EvenAngle };
        let bead = Bead { height_mm: self.bead_height_mm, arc: self.bead_arc, place: self.bead_place };
        Part {
            view_deg: self.view_deg,
            sampling,
            spacing_spread: self.spacing_spread,
            noise_correlation: self.noise_correlation,
            jitter_sigma_mm: self.jitter_mm,
            interference: Interference { clamp_shape: self.clamp_shape, shift: self.shift, bead, ..part.interference },
            surroundings: Surroundings {
                floor: self.floor,
                floor_depth_mm: self.floor_depth_mm,
                support: self.support,
                supports: self.supports,
                support_radius_mm: self.support_radius_mm,
            },
            ..part.clone()
        }
    }

    /// Names, values and bounds, in the order of the flags.
    pub(super) fn ranges(&self) -> [(&'static str, f64, f64, f64); 14] {
        [
            ("view-deg", self.view_deg, -180.0, 180.0),
            ("spacing-spread", self.spacing_spread, 0.0, 1.0),
            ("noise-correlation", self.noise_correlation, 0.0, 1.0),
            ("jitter-mm", self.jitter_mm, 0.0, 1e4),
            ("shift", self.shift, -1.0, 1.0),
            ("bead-height-mm", self.bead_height_mm, -1e4, 1e4),
            ("bead-arc", self.bead_arc, 0.0, 1.0),
            ("bead-place", self.bead_place, 0.0, 1.0),
            ("floor", self.floor, 0.0, 10.0),
            ("floor-depth-mm", self.floor_depth_mm, -1e5, 1e5),
            ("support", self.support, 0.0, 10.0),
            ("supports", self.supports, 0.0, 1.0),
            ("support-radius-mm", self.support_radius_mm, 0.0, 1e5),
            ("bead-arc of a bead", if self.bead_height_mm == 0.0 { 1.0 } else { self.bead_arc }, 1e-6, 1.0),
        ]
    }
}

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

/// A triple of numbers.
#[derive(Debug, Clone, Copy)]
struct Three([f64; 3]);

fn three(text: &str) -> Result<Three, String> {
    let wrong = || "the value must be three numbers, e.g. 0,0,1".to_owned();
    let numbers: Vec<f64> =
        text.split(',').map(|part| part.trim().parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
    let three: [f64; 3] = numbers.try_into().map_err(|_| wrong())?;
    // Far beyond the coordinates that a reader accepts.
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

    /// The rail frame in the coordinates of the written scan; `None` if the scan is not moved.
    pub(super) fn frame(&self) -> Option<Frame> {
        let given = self.frame_x_axis.zip(self.frame_z_axis);
        let given = given.map(|(Three(x_axis), Three(z_axis))| {
            let Three(origin_mm) = self.frame_origin_mm;
            Frame { origin_mm, x_axis, z_axis }
        });
        given.or_else(|| self.moved_seed.map(|seed| random_frame(seed, self.moved_mm)))
    }

    /// The seed of the order of the points; `None` if their order is kept.
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

/// Without these flags the sensor and the stage are exact.
#[derive(Debug, clap::Args)]
pub(super) struct SensorArguments {
    /// Tilt of the laser plane about Y; every point then has an x of its own
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_hyphen_values = true)]
    laser_tilt_y_deg: f64,
    /// Tilt of the laser plane about Z
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_hyphen_values = true)]
    laser_tilt_z_deg: f64,
    /// Scan the inner surface of a pipe instead of the outer one
    #[arg(long)]
    inside: bool,
    /// Degrees of freedom (above 2) of Student's t distribution for the noise, instead of a normal distribution; the standard
    /// deviation stays as given by --noise-mm
    #[arg(long, value_name = "NUMBER", allow_hyphen_values = true)]
    noise_freedom: Option<f64>,
    /// Error of z at the ends of the sensor's range, growing with the square of the distance from the middle of the range
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    bend_mm: f64,
    /// z in the middle of the sensor's range
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    bend_middle_mm: f64,
    /// Half of the sensor's range in z
    #[arg(long, value_name = "MM", default_value_t = 100.0, allow_hyphen_values = true)]
    bend_range_mm: f64,
    /// Amplitude of a periodic error of z along y
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    ripple_mm: f64,
    /// Period of that error
    #[arg(long, value_name = "MM", default_value_t = 10.0, allow_hyphen_values = true)]
    ripple_period_mm: f64,
    /// How far points on steep flanks move away from the axis, for each radian of incidence beyond --curl-from-deg
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    curl_mm_per_rad: f64,
    /// Angle of incidence where that begins
    #[arg(long, value_name = "DEG", default_value_t = 45.0, allow_hyphen_values = true)]
    curl_from_deg: f64,
    /// Share of the points that are seen by a second reflection
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    reflections: f64,
    /// How far those points are displaced away from the axis; negative towards it
    #[arg(long, value_name = "MM", default_value_t = -2.0, allow_hyphen_values = true)]
    reflection_offset_mm: f64,
    /// Standard deviation of the encoder noise in the x of every point
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    encoder_noise_mm: f64,
    /// Stick-slip: mean distance that the drive runs ahead before the stage moves on
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_hyphen_values = true)]
    stick_mm: f64,
    /// Share of the profiles that repeat the profile before bit for bit
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    repeated_profiles: f64,
    /// The x of a repeated profile: same (it arrives twice) or new (its points replace those of the next profile)
    #[arg(long, value_name = "X", default_value = "same", value_parser = repeated_x)]
    repeated_x: RepeatedX,
    /// Share of the profiles that are lost
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, allow_hyphen_values = true)]
    lost_profiles: f64,
}

fn repeated_x(text: &str) -> Result<RepeatedX, String> {
    match text {
        "same" => Ok(RepeatedX::Same),
        "new" => Ok(RepeatedX::New),
        _ => Err("the value must be same or new".to_owned()),
    }
}

impl SensorArguments {
    /// The part with the errors of this sensor and stage.
    pub(super) fn scanning(&self, part: &Part) -> Part {
        Part {
            laser_plane: LaserPlane { about_y_deg: self.laser_tilt_y_deg, about_z_deg: self.laser_tilt_z_deg },
            side: if self.inside { Side::Inside } else { Side::Outside },
            noise_freedom: self.noise_freedom,
            sensor: SensorErrors {
                bend: Bend { size_mm: self.bend_mm, middle_mm: self.bend_middle_mm, range_mm: self.bend_range_mm },
                ripple: Ripple { amplitude_mm: self.ripple_mm, period_mm: self.ripple_period_mm },
                curl: Curl { mm_per_rad: self.curl_mm_per_rad, from_deg: self.curl_from_deg },
                reflections: Reflections { ratio: self.reflections, offset_mm: self.reflection_offset_mm },
            },
            travel: Travel {
                encoder_sigma_mm: self.encoder_noise_mm,
                stick_mm: self.stick_mm,
                repeated_ratio: self.repeated_profiles,
                repeated_x: self.repeated_x,
                lost_ratio: self.lost_profiles,
            },
            ..*part
        }
    }

    /// Names, values and bounds, in the order of the flags.
    pub(super) fn ranges(&self) -> [(&'static str, f64, f64, f64); 16] {
        [
            // With a greater tilt, an axis within 80° of X might not intersect the laser plane at all.
            ("laser-tilt-y-deg", self.laser_tilt_y_deg, -45.0, 45.0),
            ("laser-tilt-z-deg", self.laser_tilt_z_deg, -45.0, 45.0),
            // With two or fewer degrees of freedom there is no standard deviation.
            ("noise-freedom", self.noise_freedom.unwrap_or(3.0), 2.1, 1e6),
            ("bend-mm", self.bend_mm, -1e3, 1e3),
            ("bend-middle-mm", self.bend_middle_mm, -1e5, 1e5),
            ("bend-range-mm", self.bend_range_mm, 1e-3, 1e5),
            ("ripple-mm", self.ripple_mm, -1e3, 1e3),
            ("ripple-period-mm", self.ripple_period_mm, 1e-3, 1e5),
            ("curl-mm-per-rad", self.curl_mm_per_rad, -1e3, 1e3),
            ("curl-from-deg", self.curl_from_deg, 0.0, 180.0),
            ("reflections", self.reflections, 0.0, 1.0),
            ("reflection-offset-mm", self.reflection_offset_mm, -1e4, 1e4),
            ("encoder-noise-mm", self.encoder_noise_mm, 0.0, 1e4),
            ("stick-mm", self.stick_mm, 0.0, 1e6),
            ("repeated-profiles", self.repeated_profiles, 0.0, 1.0),
            ("lost-profiles", self.lost_profiles, 0.0, 1.0),
        ]
    }
}
