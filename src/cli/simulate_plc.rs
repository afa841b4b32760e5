//! `coaxis simulate plc`: a PLC with two manipulators and a stage, to try coaxis or another client against. One protocol a
//! flag; all that are asked for are served until the command is ended.

use super::{Outcome, print};
#[cfg(feature = "opcua")]
use crate::device::States;
use crate::device::modbus::{Layout, Plc, serve};
#[cfg(feature = "opcua")]
use crate::device::opcua;
use crate::device::simulated::{Controller, ControllerSettings};
#[cfg(feature = "opcua")]
use crate::motion::Pair;
use crate::motion::{Axes, AxisLimits};
use std::error::Error;
use std::net::SocketAddr;
use std::process::ExitCode;
use std::sync::Arc;
use tokio::net::TcpListener;

/// Serve a made PLC with two manipulators and a stage, until it is ended. It moves nothing but numbers
#[derive(Debug, clap::Args)]
#[group(id = "protocols", required = true, multiple = true)]
pub(super) struct PlcArguments {
    /// Serve it by Modbus TCP; port 0 takes a free one. m1 is at base 0, m2 at 256, the stage at 512, or unit ids 1, 2, 3
    #[arg(long, value_name = "ADDRESS")]
    modbus: Option<SocketAddr>,
    /// Serve it by OPC UA, anonymous and unencrypted; port 0 takes a free one. The nodes are in docs/opcua.md; no stage
    #[cfg(feature = "opcua")]
    #[arg(long, value_name = "ADDRESS")]
    opcua: Option<SocketAddr>,
}

pub(super) fn run(arguments: &PlcArguments) -> Outcome {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(serve_all(arguments))?;
    Ok(ExitCode::SUCCESS)
}

/// Each protocol has a PLC of its own.
async fn serve_all(arguments: &PlcArguments) -> Result<(), Box<dyn Error>> {
    let modbus = async {
        match arguments.modbus {
            Some(address) => serve_modbus(address).await,
            None => Ok(()),
        }
    };
    #[cfg(feature = "opcua")]
    let opcua = async {
        match arguments.opcua {
            Some(address) => serve_opcua(address).await,
            None => Ok(()),
        }
    };
    #[cfg(not(feature = "opcua"))]
    let opcua = std::future::ready(Ok(()));
    tokio::try_join!(modbus, opcua).map(|_| ())
}

async fn serve_modbus(address: SocketAddr) -> Result<(), Box<dyn Error>> {
    let listener = TcpListener::bind(address).await.map_err(|error| format!("cannot listen on {address}: {error}"))?;
    print(&format!("modbus {}\n", listener.local_addr()?))?;
    let plc = Plc::new(Layout::default(), vec![manipulator(), manipulator(), stage()]);
    Ok(serve(listener, Arc::new(plc)).await?)
}

#[cfg(feature = "opcua")]
async fn serve_opcua(address: SocketAddr) -> Result<(), Box<dyn Error>> {
    let controllers = Pair { m1: manipulator(), m2: manipulator() };
    let plc = Arc::new(opcua::Plc::new(controllers, States::default().codes()));
    // The library wants a folder for keys, although there are none.
    let folder = std::env::temp_dir().join("coaxis-simulated-plc");
    let server = opcua::PlcServer::listen(address, &plc, &folder).await?;
    print(&format!("opcua opc.tcp://{}\n", server.address()))?;
    Ok(server.run().await?)
}

/// 50 mm to both sides at 10 mm/s, 12 degrees at 6 degrees/s; references known.
fn manipulator() -> Controller {
    let linear = AxisLimits { lower: -50.0, upper: 50.0, speed: 10.0, acceleration: 50.0, jerk: 500.0, step: 50.0 };
    let turn = AxisLimits {
        lower: -12_f64.to_radians(),
        upper: 12_f64.to_radians(),
        speed: 6_f64.to_radians(),
        acceleration: 30_f64.to_radians(),
        jerk: 300_f64.to_radians(),
        step: 24_f64.to_radians(),
    };
    Controller::new(ControllerSettings::exact(Axes { x: linear, y: linear, z: linear, c: turn }))
}

/// A rail of 1200 mm at 200 mm/s on axis x; the other axes are there and are never moved.
fn stage() -> Controller {
    let rail = AxisLimits { lower: 0.0, upper: 1200.0, speed: 200.0, acceleration: 1e3, jerk: 1e4, step: 1200.0 };
    Controller::new(ControllerSettings::exact(Axes { x: rail, y: rail, z: rail, c: rail }))
}
