//! Which cell can be: every number within its range, every adaptor set up. What is wrong is told with its dotted key.

use super::Cell;
use super::devices::{ManipulatorAdaptor, SensorAdaptor, StageAdaptor};
use super::error::CellError;
use crate::motion::Carrier;

impl Cell {
    /// Checks every value; those of adaptors that are not chosen are let be, and so is a cell that is not enabled.
    ///
    /// # Errors
    /// [`CellError`] names the first key that cannot be used.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Layers;

    fn complaint(text: &str) -> String {
        Layers::default().text("file", text).and_then(Layers::build).expect_err("refused").to_string()
    }

    #[test]
    fn nonsense_is_refused_with_its_key() {
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
    fn simulated_devices_stand_beside_real_ones_only_where_that_is_allowed() {
        let said = complaint("[cell.manipulators.m1]\nadaptor = 'modbus'");
        let expected = "cell: manipulators.m2, stage, sensor would be simulated beside manipulators.m1";
        assert!(said.starts_with(expected), "{said}");
    }

    #[test]
    fn two_names_for_one_machine_are_refused() {
        let both = "[cell]\nsimulated_beside_real = true\n[cell.manipulators.m1]\nadaptor = 'modbus'\n\
                    [cell.manipulators.m2]\nadaptor = 'modbus'\n";
        Layers::default().text("file", both).and_then(Layers::build).expect("their blocks differ by default");
        let said = complaint(&format!("{both}modbus.base = 0"));
        assert!(said.starts_with("cell.manipulators.m1 and cell.manipulators.m2 are the same device"), "{said}");
    }

    #[cfg(feature = "opcua")]
    #[test]
    fn over_opc_ua_each_manipulator_has_a_device_of_its_own_and_may_not_share_it() {
        let both = "[cell]\nsimulated_beside_real = true\n[cell.manipulators.m1]\nadaptor = 'opcua'\n\
                    [cell.manipulators.m2]\nadaptor = 'opcua'\n";
        let config = Layers::default().text("file", both).and_then(Layers::build).expect("their devices differ");
        assert!(config.cell.manipulators.m2.opcua.device.ends_with("own:M2"));
        let said = complaint(&format!("{both}opcua.device = '{}'", config.cell.manipulators.m1.opcua.device));
        assert!(said.contains("are the same device"), "{said}");
    }

    #[test]
    fn the_examples_of_the_pages_can_be_used() {
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
    fn what_is_said_about_one_manipulator_leaves_the_rest_as_it_is() {
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
