//! The flags of `coaxis simulate scan` for errors of the sensor, of the stage and of its encoder.

use crate::scan::synthetic::{
    Bend, Curl, LaserPlane, Part, Reflections, RepeatedX, Ripple, SensorErrors, Side, Travel,
};

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
    /// The part as this sensor scans it.
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
            // Beyond, an axis within 80° of X may not cross the laser plane at all.
            ("laser-tilt-y-deg", self.laser_tilt_y_deg, -45.0, 45.0),
            ("laser-tilt-z-deg", self.laser_tilt_z_deg, -45.0, 45.0),
            // At 2 there is no standard deviation.
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
