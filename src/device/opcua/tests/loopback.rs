//! The link and our own simulated PLC, through a real socket: the contract of every adaptor, two manipulators on one server, and
//! a server that is gone.

use super::limits;
use crate::device::contract::{check_manipulator, motion::check_manipulator_motion};
use crate::device::opcua::{OpcuaManipulator, Plc, PlcServer, Security, Settings, device_path};
use crate::device::simulated::{Controller, ControllerSettings};
use crate::device::{Action, Command, DeviceError, Manipulator, States};
use crate::motion::{Carrier, Pair};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinHandle;

struct Bench {
    folder: PathBuf,
    plc: Arc<Plc>,
    address: SocketAddr,
    server: JoinHandle<()>,
}

impl Bench {
    async fn start(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("coaxis-loopback-{name}-{}", std::process::id()));
        let controllers = Pair::from_fn(|_| Controller::new(ControllerSettings::exact(limits())));
        let plc = Arc::new(Plc::new(controllers, States::default().codes()));
        let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
        let server = PlcServer::listen(anywhere, &plc, &folder.join("plc")).await.expect("a server");
        let address = server.address();
        let server = tokio::spawn(async move { server.run().await.expect("serves") });
        Self { folder, plc, address, server }
    }

    fn link(&self, carrier: Carrier) -> OpcuaManipulator {
        let settings = Settings {
            endpoint: format!("opc.tcp://{}", self.address),
            device: device_path(carrier),
            security: Security { pki: Some(self.folder.join("client")), ..Security::default() },
            ..Settings::default()
        };
        OpcuaManipulator::new(carrier.name(), &settings).expect("settings")
    }

    fn executed(&self, carrier: Carrier) -> Vec<u16> {
        self.plc.with(carrier, |controller, _| controller.record().all_executed().map(|entry| entry.sequence).collect())
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.server.abort();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn told(sequence: u16, action: Action) -> Command {
    Command { sequence, fence: 1, watchdog: Duration::from_millis(400), action }
}

#[tokio::test]
async fn our_own_plc_and_our_adaptor_keep_the_contract() {
    let bench = Bench::start("contract").await;
    let mut link = bench.link(Carrier::M1);
    let report = check_manipulator(&mut link).await;
    assert!(report.passed(), "{report:#?}");
    let report = check_manipulator_motion(&mut link, 1).await;
    assert!(report.passed(), "{report:#?}");
    let executed = bench.executed(Carrier::M1);
    assert!(executed.windows(2).all(|pair| pair[0] < pair[1]), "each once: {executed:?}");
    assert!(bench.executed(Carrier::M2).is_empty());
}

#[tokio::test]
async fn each_manipulator_hears_its_own_commands() {
    let bench = Bench::start("two").await;
    let (mut m1, mut m2) = (bench.link(Carrier::M1), bench.link(Carrier::M2));
    m1.connect().await.expect("connected");
    m2.connect().await.expect("connected");
    m2.send(&told(3, Action::Enable)).await.expect("handed over");
    assert_eq!(m1.read().await.expect("a reading").acknowledged.sequence, 0);
    assert_eq!(m2.read().await.expect("a reading").acknowledged.sequence, 3);
    assert_eq!((bench.executed(Carrier::M1), bench.executed(Carrier::M2)), (vec![], vec![3]));
}

#[tokio::test]
async fn without_a_connection_nothing_is_said_and_a_server_that_is_gone_is_a_link_lost() {
    let bench = Bench::start("gone").await;
    let mut link = bench.link(Carrier::M1);
    let early = link.send(&told(1, Action::Enable)).await;
    assert!(matches!(early, Err(DeviceError::LinkLost { .. })), "{early:?}");
    link.connect().await.expect("connected");
    bench.server.abort();
    let gone = tokio::time::timeout(Duration::from_secs(5), async {
        loop {
            if let Err(error) = link.read().await {
                return error;
            }
        }
    });
    let gone = gone.await.expect("noticed");
    assert!(matches!(gone, DeviceError::LinkLost { .. } | DeviceError::Silent { .. }), "{gone}");
    let after = link.send(&told(2, Action::Enable)).await;
    assert!(matches!(after, Err(DeviceError::LinkLost { .. })), "{after:?}");
    assert!(bench.executed(Carrier::M1).is_empty());
}

#[tokio::test]
async fn a_reading_that_is_given_up_costs_the_session() {
    let bench = Bench::start("dropped").await;
    let mut link = bench.link(Carrier::M1);
    link.connect().await.expect("connected");
    {
        let mut reading = link.read();
        let started =
            std::future::poll_fn(|context| std::task::Poll::Ready(reading.as_mut().poll(context).is_pending()));
        assert!(started.await);
    }
    let after = link.read().await;
    assert!(matches!(after, Err(DeviceError::LinkLost { .. })), "{after:?}");
    link.connect().await.expect("connected anew");
}
