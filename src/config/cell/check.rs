//! Checks the settings of the cell: the range of every number, every adaptor, that simulated devices are not used together with
//! real ones by mistake, and that no machine is configured twice. An error names the dotted key.

use crate::cell::SettingsError;
use crate::device::{gocator, modbus, simulated};
use crate::motion::{ArrangementError, Carrier};

use super::settings::{Cell, Manipulator, ManipulatorAdaptor, SensorAdaptor, StageAdaptor};

impl Cell {
    /// Checks every value, except the settings of unused adaptors and of a disabled cell.
    ///
    /// # Errors
    /// [`CellError`] names the first invalid key.
    pub fn check(&self) -> Result<(), CellError> {
        if !self.enabled {
            return Ok(());
        }
        self.check_numbers()?;
        self.check_devices()?;
        self.check_adaptors()?;
        self.arrangement().check()?;
        self.settings().check()?;
        Ok(())
    }

    fn check_adaptors(&self) -> Result<(), CellError> {
        self.simulated.check()?;
        for carrier in Carrier::ALL {
            let (key, manipulator) = (key_of(carrier), self.manipulators.get(carrier));
            match manipulator.adaptor {
                ManipulatorAdaptor::Simulated => {}
                ManipulatorAdaptor::Modbus => {
                    manipulator.modbus.check().map_err(|cause| CellError::Modbus { key, cause })?;
                }
                #[cfg(feature = "opcua")]
                ManipulatorAdaptor::Opcua => {
                    manipulator.opcua.check().map_err(|cause| CellError::Opcua { key, cause })?;
                }
                #[cfg(not(feature = "opcua"))]
                ManipulatorAdaptor::Opcua => return Err(CellError::OpcuaNotBuilt { key }),
            }
        }
        if self.stage.adaptor == StageAdaptor::Modbus {
            self.stage.modbus.check().map_err(|cause| CellError::Modbus { key: "stage", cause })?;
        }
        if self.sensor.adaptor == SensorAdaptor::Gocator {
            self.sensor.gocator.check()?;
        }
        Ok(())
    }
}

/// The dotted name of a manipulator below `cell`.
pub(super) const fn key_of(carrier: Carrier) -> &'static str {
    match carrier {
        Carrier::M1 => "manipulators.m1",
        Carrier::M2 => "manipulators.m2",
    }
}

/// Why the settings of the cell are not valid.
#[derive(Debug, thiserror::Error)]
pub enum CellError {
    /// A number is out of its range.
    #[error("cell.{key} must be between {least} and {most}, got {value}")]
    OutOfRange {
        /// Dotted name below `cell`.
        key: String,
        /// The given value.
        value: f64,
        /// Least allowed value.
        least: f64,
        /// Greatest allowed value.
        most: f64,
    },
    /// A number is not below its upper bound.
    #[error("cell.{key} must be below {beside}, got {value} and {limit}")]
    NotBelow {
        /// Dotted name below `cell`.
        key: String,
        /// Key of the upper bound.
        beside: &'static str,
        /// The given value.
        value: f64,
        /// The value of the upper bound.
        limit: f64,
    },
    /// A setting of the simulation cannot be used.
    #[error("cell.simulated.{0}")]
    Simulated(#[from] simulated::SettingError),
    /// A setting of a Modbus device cannot be used.
    #[error("cell.{key}.{cause}")]
    Modbus {
        /// Dotted name of the device below `cell`.
        key: &'static str,
        /// The fault in its settings.
        cause: modbus::SettingsError,
    },
    /// A setting of an OPC UA device cannot be used.
    #[cfg(feature = "opcua")]
    #[error("cell.{key}.opcua.{cause}")]
    Opcua {
        /// Dotted name of the device below `cell`.
        key: &'static str,
        /// The fault in its settings.
        cause: crate::device::opcua::SettingRefusal,
    },
    /// A setting of the sensor cannot be used.
    #[error("cell.sensor.gocator: {0}")]
    Gocator(#[from] gocator::SettingsError),
    /// Simulated devices would be used together with real ones.
    #[error(
        "cell: {simulated} would be simulated beside {real}; name an adaptor for each, or allow it with cell.simulated_beside_real = true"
    )]
    Mixed {
        /// Names of the simulated devices.
        simulated: String,
        /// Names of the real devices.
        real: String,
    },
    /// One machine is configured twice.
    #[error("cell.{first} and cell.{second} are the same device; give each its own {what}")]
    SameDevice {
        /// Dotted name of one device.
        first: &'static str,
        /// Dotted name of the other device.
        second: &'static str,
        /// The keys that distinguish them.
        what: &'static str,
    },
    /// This program was built without OPC UA.
    #[error("cell.{key}.adaptor = \"opcua\": this program was built without OPC UA; build it with the feature opcua")]
    OpcuaNotBuilt {
        /// Dotted name of the device.
        key: &'static str,
    },
    /// The arrangement of the manipulators is not valid.
    #[error("cell.manipulators: {0}")]
    Arrangement(#[from] ArrangementError),
    /// The times are not consistent.
    #[error("cell.timing: {0}")]
    Settings(#[from] SettingsError),
}

/// A number with its key, its least and its greatest value.
type Range = (String, f64, f64, f64);

impl Cell {
    /// Checks that every number is within its range, and every lower limit below its upper one.
    pub(super) fn check_numbers(&self) -> Result<(), CellError> {
        let mut ranges = self.ranges();
        for carrier in Carrier::ALL {
            limits(key_of(carrier), self.manipulators.get(carrier), &mut ranges);
        }
        for (key, value, least, most) in ranges {
            // Written so that NaN fails as well.
            if !(least..=most).contains(&value) {
                return Err(CellError::OutOfRange { key, value, least, most });
            }
        }
        for carrier in Carrier::ALL {
            order(key_of(carrier), self.manipulators.get(carrier))?;
        }
        let lease = &self.lease;
        below("lease.ttl_min_ms", "lease.ttl_max_ms", real(lease.ttl_min_ms), real(lease.ttl_max_ms))
    }

    fn ranges(&self) -> Vec<Range> {
        let (lease, timing, together, scan) = (&self.lease, &self.timing, &self.together, &self.scan);
        let tolerance = &together.tolerance;
        let named: [(&str, f64, f64, f64); 23] = [
            ("plan_age_max_s", real(self.plan_age_max_s), 1.0, 3_600.0),
            ("lease.ttl_min_ms", real(lease.ttl_min_ms), 100.0, 600_000.0),
            ("lease.ttl_max_ms", real(lease.ttl_max_ms), 1_000.0, 600_000.0),
            ("lease.ttl_ms", real(lease.ttl_ms), real(lease.ttl_min_ms), real(lease.ttl_max_ms)),
            ("timing.poll_ms", real(timing.poll_ms), 5.0, 100.0),
            ("timing.poll_moving_ms", real(timing.poll_moving_ms), 5.0, 50.0),
            ("timing.reply_ms", real(timing.reply_ms), 20.0, 300.0),
            ("timing.connect_ms", real(timing.connect_ms), 20.0, 30_000.0),
            ("timing.acknowledge_ms", real(timing.acknowledge_ms), 20.0, 300.0),
            ("timing.watchdog_ms", real(timing.watchdog_ms), 100.0, 400.0),
            ("timing.arrival_ms", real(timing.arrival_ms), 100.0, 600_000.0),
            ("timing.scan_stall_ms", real(timing.scan_stall_ms), 50.0, 60_000.0),
            ("together.strain_max_mm", together.strain_max_mm, 1e-6, 100.0),
            ("together.run_on_max_mm", together.run_on_max_mm, 0.01, 100.0),
            ("together.twist_max_deg", together.twist_max_deg, 1e-6, 90.0),
            ("together.clearance_min_mm", together.clearance_min_mm, 0.0, 10_000.0),
            ("together.tolerance.x_mm", tolerance.x_mm, 1e-6, 10.0),
            ("together.tolerance.y_mm", tolerance.y_mm, 1e-6, 10.0),
            ("together.tolerance.z_mm", tolerance.z_mm, 1e-6, 10.0),
            ("together.tolerance.c_deg", tolerance.c_deg, 1e-6, 10.0),
            ("scan.profiles_count", real(scan.profiles_count), 2.0, 1e6),
            ("scan.speed_mm_s", scan.speed_mm_s, 1e-3, 10_000.0),
            ("scan.place_tolerance_mm", scan.place_tolerance_mm, 1e-3, 10_000.0),
        ];
        named.into_iter().map(|(key, value, least, most)| (key.to_owned(), value, least, most)).collect()
    }
}

fn limits(key: &str, manipulator: &Manipulator, ranges: &mut Vec<Range>) {
    const FAR: f64 = 100_000.0;
    const TURNS: f64 = 3_600.0;
    for (axis, value) in ["x", "y", "z"].iter().zip(manipulator.mount_mm) {
        ranges.push((format!("{key}.mount_mm ({axis})"), value, -FAR, FAR));
    }
    ranges.push((format!("{key}.half_span_mm"), manipulator.half_span_mm, 0.0, FAR));
    let limits = &manipulator.limits;
    for (axis, own) in [("x", &limits.x), ("y", &limits.y), ("z", &limits.z)] {
        let mut push = |name: &str, value, least, most| {
            ranges.push((format!("{key}.limits.{axis}.{name}"), value, least, most));
        };
        push("lower_mm", own.lower_mm, -FAR, FAR);
        push("upper_mm", own.upper_mm, -FAR, FAR);
        push("step_mm", own.step_mm, 1e-6, FAR);
        push("speed_mm_s", own.speed_mm_s, 1e-6, FAR);
        push("acceleration_mm_s2", own.acceleration_mm_s2, 1e-6, 1e6);
        push("jerk_mm_s3", own.jerk_mm_s3, 1e-6, 1e8);
    }
    let turn = &limits.c;
    let mut push = |name: &str, value, least, most| ranges.push((format!("{key}.limits.c.{name}"), value, least, most));
    push("lower_deg", turn.lower_deg, -TURNS, TURNS);
    push("upper_deg", turn.upper_deg, -TURNS, TURNS);
    push("step_deg", turn.step_deg, 1e-6, TURNS);
    push("speed_deg_s", turn.speed_deg_s, 1e-6, TURNS);
    push("acceleration_deg_s2", turn.acceleration_deg_s2, 1e-6, 1e6);
    push("jerk_deg_s3", turn.jerk_deg_s3, 1e-6, 1e8);
}

fn order(key: &str, manipulator: &Manipulator) -> Result<(), CellError> {
    let limits = &manipulator.limits;
    for (axis, own) in [("x", &limits.x), ("y", &limits.y), ("z", &limits.z)] {
        below(&format!("{key}.limits.{axis}.lower_mm"), "upper_mm", own.lower_mm, own.upper_mm)?;
    }
    below(&format!("{key}.limits.c.lower_deg"), "upper_deg", limits.c.lower_deg, limits.c.upper_deg)
}

fn below(key: &str, beside: &'static str, value: f64, limit: f64) -> Result<(), CellError> {
    if value < limit { Ok(()) } else { Err(CellError::NotBelow { key: key.to_owned(), beside, value, limit }) }
}

/// The counts and milliseconds in the allowed ranges are far below 2⁵³; greater values only need to remain out of range.
#[expect(clippy::cast_precision_loss, reason = "beyond 2⁵³ every range is left")]
const fn real(value: u64) -> f64 {
    value as f64
}

/// The address of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Link<'a> {
    Simulated,
    Modbus {
        address: &'a str,
        unit_id: u8,
        base: u16,
    },
    #[cfg(feature = "opcua")]
    Opcua {
        endpoint: &'a str,
        device: &'a str,
    },
    /// An adaptor whose address cannot be used twice.
    Other,
}

impl<'a> Link<'a> {
    fn modbus(settings: &'a modbus::Settings) -> Self {
        Self::Modbus { address: &settings.address, unit_id: settings.unit_id, base: settings.base }
    }

    /// The keys that distinguish two devices of this kind.
    const fn what(self) -> Option<&'static str> {
        match self {
            Self::Simulated | Self::Other => None,
            Self::Modbus { .. } => Some("modbus.address, modbus.unit_id or modbus.base"),
            #[cfg(feature = "opcua")]
            Self::Opcua { .. } => Some("opcua.endpoint or opcua.device"),
        }
    }
}

impl Cell {
    /// Checks that simulated devices are not used together with real ones by mistake, and that no machine is configured twice.
    pub(super) fn check_devices(&self) -> Result<(), CellError> {
        let simulated = self.devices().into_iter().filter(|(_, link)| *link == Link::Simulated);
        let simulated: Vec<&str> = simulated.map(|(key, _)| key).collect();
        let real = self.devices().into_iter().filter(|(_, link)| *link != Link::Simulated);
        let real: Vec<&str> = real.map(|(key, _)| key).collect();
        if !self.simulated_beside_real && !simulated.is_empty() && !real.is_empty() {
            return Err(CellError::Mixed { simulated: simulated.join(", "), real: real.join(", ") });
        }
        let devices = self.devices();
        for (place, (first, link)) in devices.iter().enumerate() {
            let same = devices.iter().skip(place + 1).find(|(_, other)| other == link && link.what().is_some());
            if let (Some((second, _)), Some(what)) = (same, link.what()) {
                return Err(CellError::SameDevice { first, second, what });
            }
        }
        Ok(())
    }

    /// Every configured device with its address.
    fn devices(&self) -> Vec<(&'static str, Link<'_>)> {
        let manipulators = Carrier::ALL.map(|carrier| {
            let manipulator = self.manipulators.get(carrier);
            let link = match manipulator.adaptor {
                ManipulatorAdaptor::Simulated => Link::Simulated,
                ManipulatorAdaptor::Modbus => Link::modbus(&manipulator.modbus),
                #[cfg(feature = "opcua")]
                ManipulatorAdaptor::Opcua => {
                    Link::Opcua { endpoint: &manipulator.opcua.endpoint, device: &manipulator.opcua.device }
                }
                #[cfg(not(feature = "opcua"))]
                ManipulatorAdaptor::Opcua => Link::Other,
            };
            (key_of(carrier), link)
        });
        let stage = match self.stage.adaptor {
            StageAdaptor::Simulated => Some(Link::Simulated),
            StageAdaptor::Modbus => Some(Link::modbus(&self.stage.modbus)),
            StageAdaptor::None => None,
        };
        let sensor = match self.sensor.adaptor {
            SensorAdaptor::Simulated => Some(Link::Simulated),
            SensorAdaptor::Gocator => Some(Link::Other),
            SensorAdaptor::None => None,
        };
        let others = [stage.map(|link| ("stage", link)), sensor.map(|link| ("sensor", link))];
        manipulators.into_iter().chain(others.into_iter().flatten()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Layers;

    fn complaint(text: &str) -> String {
        Layers::default().text("file", text).and_then(Layers::build).expect_err("refused").to_string()
    }

    #[test]
    fn an_invalid_value_is_refused_with_its_key() {
        let said = complaint("[cell.manipulators.m2.limits.y]\nspeed_mm_s = 0.0");
        assert_eq!(said, "cell.manipulators.m2.limits.y.speed_mm_s must be between 0.000001 and 100000, got 0");
        let said = complaint("[cell.manipulators.m1.limits.c]\nlower_deg = 40");
        assert_eq!(said, "cell.manipulators.m1.limits.c.lower_deg must be below upper_deg, got 40 and 30");
        let said = complaint("[cell.timing]\nwatchdog_ms = 5000");
        assert!(said.starts_with("cell.timing.watchdog_ms must be between 100 and 400"), "{said}");
        let said = complaint("[cell.lease]\nttl_ms = 90000");
        assert!(said.starts_with("cell.lease.ttl_ms must be between 1000 and 60000"), "{said}");
        let said = complaint(
            "[cell]\nsimulated_beside_real = true\n[cell.stage]\nadaptor = 'modbus'\nmodbus.address = 'nowhere'",
        );
        assert!(said.starts_with("cell.stage.modbus.address"), "{said}");
        let said = complaint("[cell.simulated]\ntime_factor = 0.0");
        assert!(said.starts_with("cell.simulated.time_factor"), "{said}");
    }

    #[test]
    fn simulated_devices_beside_real_ones_need_permission() {
        let said = complaint("[cell.manipulators.m1]\nadaptor = 'modbus'");
        let expected = "cell: manipulators.m2, stage, sensor would be simulated beside manipulators.m1";
        assert!(said.starts_with(expected), "{said}");
    }

    #[test]
    fn one_machine_configured_twice_is_refused() {
        let both = "[cell]\nsimulated_beside_real = true\n[cell.manipulators.m1]\nadaptor = 'modbus'\n\
                    [cell.manipulators.m2]\nadaptor = 'modbus'\n";
        Layers::default().text("file", both).and_then(Layers::build).expect("their blocks differ by default");
        let said = complaint(&format!("{both}modbus.base = 0"));
        assert!(said.starts_with("cell.manipulators.m1 and cell.manipulators.m2 are the same device"), "{said}");
    }

    #[cfg(feature = "opcua")]
    #[test]
    fn two_manipulators_over_opc_ua_must_have_different_devices() {
        let both = "[cell]\nsimulated_beside_real = true\n[cell.manipulators.m1]\nadaptor = 'opcua'\n\
                    [cell.manipulators.m2]\nadaptor = 'opcua'\n";
        let config = Layers::default().text("file", both).and_then(Layers::build).expect("their devices differ");
        assert!(config.cell.manipulators.m2.opcua.device.ends_with("own:M2"));
        let said = complaint(&format!("{both}opcua.device = '{}'", config.cell.manipulators.m1.opcua.device));
        assert!(said.contains("are the same device"), "{said}");
    }

    #[test]
    fn the_examples_in_the_documentation_are_valid() {
        let pages = [
            include_str!("../../../docs/gocator.md"),
            include_str!("../../../docs/modbus.md"),
            include_str!("../../../docs/moving.md"),
            #[cfg(feature = "opcua")]
            include_str!("../../../docs/opcua.md"),
        ];
        let examples = pages.iter().flat_map(|page| page.split("```toml\n").skip(1));
        let mut count = 0;
        for example in examples.filter_map(|rest| rest.split("```").next()) {
            let alone = "[cell]\nsimulated_beside_real = true\n";
            let layers = Layers::default().text("page", alone).and_then(|layers| layers.text("example", example));
            layers.and_then(Layers::build).unwrap_or_else(|error| panic!("{error}\n{example}"));
            count += 1;
        }
        assert!(count >= 3, "{count} examples");
    }

    #[test]
    fn a_mistyped_key_of_the_cell_is_refused_by_name() {
        assert!(complaint("[cell.manipulators.m1.limits.x]\nlowr_mm = 1").contains("lowr_mm"));
        assert!(complaint("[cell.manipulators.m3]\nadaptor = 'modbus'").contains("m3"));
        assert!(complaint("[cell.manipulators.m1]\nadaptor = 'modbos'").contains("modbos"));
    }

    #[test]
    fn settings_of_one_manipulator_do_not_change_the_others() {
        let text = "[cell]\nsimulated_beside_real = true\n[cell.manipulators.m2]\nadaptor = 'modbus'\n\
             modbus.address = '10.0.0.7:502'\nlimits.z.upper_mm = 7.5";
        let config = Layers::default().text("file", text).and_then(Layers::build).expect("valid");
        let (m1, m2) = (&config.cell.manipulators.m1, &config.cell.manipulators.m2);
        assert_eq!((m1.adaptor, m2.adaptor), (ManipulatorAdaptor::Simulated, ManipulatorAdaptor::Modbus));
        assert_eq!((m2.modbus.address.as_str(), m2.modbus.base), ("10.0.0.7:502", 256));
        assert_eq!((m2.limits.z.upper_mm, m2.limits.z.lower_mm, m1.limits.z.upper_mm), (7.5, -25.0, 25.0));
        assert!(m2.mount_mm[0] > m1.mount_mm[0]);
        let variables = [
            ("COAXIS_CELL__MANIPULATORS__M1__ADAPTOR".into(), "modbus".into()),
            ("COAXIS_CELL__SIMULATED_BESIDE_REAL".into(), "true".into()),
        ];
        let config = Layers::default().environment(variables).and_then(Layers::build).expect("valid");
        assert_eq!(config.cell.manipulators.m1.adaptor, ManipulatorAdaptor::Modbus);
    }
}
