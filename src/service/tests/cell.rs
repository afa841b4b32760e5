//! Moves, scans and leases when the store is full, the pool is busy, or the client has disconnected. The devices are simulated.

use super::*;
use crate::config::Config;
use crate::motion::{Axes, Carrier, Pair};
use crate::store::EndedJob;

/// Simulated seconds per second.
const FAST: f64 = 50.0;
/// Longer than any operation in these tests.
const LONG: Duration = Duration::from_secs(60);

/// A service with a simulated cell: the lease is taken and the manipulators are enabled. One calculation runs, none waits.
async fn ready(folder: &TempFolder, time_factor: f64) -> (Arc<Service>, String) {
    let mut config = Config::default();
    config.cell.enabled = true;
    config.cell.simulated.time_factor = time_factor;
    // The tests must not depend on how soon a device answers on a loaded machine.
    config.cell.timing.reply_ms = 2_000;
    let limits = &mut config.limits;
    (limits.threads, limits.measurements_running_max, limits.queue_max) = (2, 1, 0);
    let equipment = Equipment::of(&config.cell).expect("devices");
    let opened = Service::open_with(&folder.0, Capacity::from_config(&config), config.estimation, equipment).await;
    let service = opened.expect("a store");
    until(&service, |snapshot| snapshot.state == crate::cell::State::Idle).await;
    until(&service, |snapshot| {
        snapshot.stage.as_ref().is_some_and(|stage| stage.reading.is_some())
            && snapshot.sensor.as_ref().is_some_and(|sensor| sensor.reading.is_some())
    })
    .await;
    let lease = service.operating.take_lease("test".to_owned(), Some(LONG)).await.expect("the lease is free").id;
    for carrier in Carrier::ALL {
        service
            .operating
            .command_manipulator(lease.clone(), carrier, crate::cell::Manual::Enable)
            .await
            .expect("enabled");
    }
    until(&service, |snapshot| snapshot.commands_allowed).await;
    (service, lease)
}

async fn until(service: &Arc<Service>, so: impl Fn(&crate::cell::Snapshot) -> bool) {
    let mut watch = service.operating.cell_handle().expect("a cell").cell.watch();
    let seen = tokio::time::timeout(LONG, watch.wait_for(|snapshot| so(snapshot))).await;
    assert!(matches!(seen, Ok(Ok(_))), "the expected state was not reached");
}

fn move_request(lease_id: &str, y: f64, request_id: &str) -> MoveRequest {
    let to = Axes { y: Some(y), ..Axes::default() };
    MoveRequest {
        lease_id: lease_id.to_owned(),
        targets: Pair { m1: Some(to), m2: Some(to) },
        speed_ratio: 1.0,
        request_id: Some(request_id.to_owned()),
    }
}

fn scan_request(lease_id: &str, request_id: &str) -> SensorRequest {
    SensorRequest { lease_id: lease_id.to_owned(), way: ScanWay::default(), order: order(request_id) }
}

async fn measured(service: &Arc<Service>, id: &str) -> Measurement {
    match service.operating.any_measurement(id, LONG).await.expect("there") {
        AnyMeasurement::Ran(measurement) => *measurement,
        AnyMeasurement::Scan(scan) => panic!("{scan:?}"),
    }
}

/// Waits until the end of a job is stored.
async fn written(service: &Arc<Service>, id: &str) -> String {
    loop {
        let row = service.shared.store.job(id).await.expect("read").expect("there");
        if row.ended_at.is_some() {
            return row.state;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_end_of_a_move_that_a_full_store_refuses_is_shown_and_written_later() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    let begun = service.operating.start_move(move_request(&lease, 2.0, "part-1")).await.expect("begun").job;
    service.shared.store.set_full(true);
    let over = service.operating.get_move(&begun.id, LONG).await.expect("there");
    assert_eq!(over.standing, JobStatus::Done);
    assert_eq!(
        service.shared.store.job(&begun.id).await.expect("read").expect("there").ended_at,
        None,
        "not written yet"
    );
    let listed = service.operating.moves(&Page { limit: 10, before: None }).await.expect("a list").rows;
    assert!(matches!(&listed[..], [Entry::Record(one)] if one.standing == JobStatus::Done), "{listed:?}");
    let again = service.operating.start_move(move_request(&lease, 2.0, "part-1")).await.expect("answered");
    assert_eq!((again.replayed, again.job.standing), (true, JobStatus::Done));
    service.shared.store.set_full(false);
    assert_eq!(written(&service, &begun.id).await, "done");
    service.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_measurement_by_the_sensor_that_a_full_store_refuses_is_shown_and_recorded_later() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    let begun = service.operating.measure_from_sensor(scan_request(&lease, "scan-1")).await.expect("begun").job;
    service.shared.store.set_full(true);
    let shown = measured(&service, &begun.id).await;
    assert!(service.shared.store.measurement(&begun.id).await.expect("read").is_none(), "not recorded yet");
    let page = Page { limit: 10, before: None };
    let listed = service.measuring.measurements(&Filter::default(), &page).await.expect("a list").rows;
    assert!(matches!(&listed[..], [Entry::Record(one)] if *one == shown), "{listed:?}");
    assert_eq!(service.measuring.profiles(&begun.id).await.expect("there").len() as u64, shown.counts.total_count);
    assert!(service.operating.sensor_scans(JobStatus::Running, &page).await.expect("a list").rows.is_empty());
    service.shared.store.set_full(false);
    assert_eq!(written(&service, &begun.id).await, "done");
    assert_eq!(measured(&service, &begun.id).await, shown);
    service.measuring.scan_content(&shown.scan_id()).await.expect("its points are kept");
    while service.measuring.last().is_none_or(|last| last.id != begun.id) {
        tokio::task::yield_now().await;
    }
    service.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ends_that_are_not_written_when_the_service_ends_are_tried_once_more() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    let begun = service.operating.start_move(move_request(&lease, 2.0, "part-1")).await.expect("begun").job;
    service.shared.store.set_full(true);
    service.operating.get_move(&begun.id, LONG).await.expect("there");
    service.shared.store.set_full(false);
    service.close().await;
    drop(service);
    let store = loop {
        // The last task that uses the folder may be ending at this moment.
        match crate::store::Store::open(&folder.0).await {
            Ok(store) => break store,
            Err(_) => tokio::time::sleep(Duration::from_millis(10)).await,
        }
    };
    assert_eq!(store.job(&begun.id).await.expect("read").expect("there").state, "done");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_lease_is_granted_if_its_fencing_token_cannot_be_stored() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    service.operating.release_lease(&lease).await.expect("released");
    let fence = service.shared.store.fence().await.expect("read");
    service.shared.store.set_full(true);
    for _ in 0..2 {
        let refused = service.operating.take_lease("line 3".to_owned(), None).await.expect_err("not stored");
        assert!(matches!(refused, ServiceError::Store(_)), "{refused}");
        assert!(
            service.operating.cell_handle().expect("a cell").cell.snapshot().lease.is_none(),
            "no lease was granted"
        );
    }
    service.shared.store.set_full(false);
    let held = service.operating.take_lease("line 3".to_owned(), None).await.expect("taken");
    assert_eq!((held.fence, service.shared.store.fence().await.expect("read")), (fence + 1, fence + 1));
    service.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_repeated_request_finds_its_measurement_by_the_sensor_although_the_pool_is_full() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    let begun = service.operating.measure_from_sensor(scan_request(&lease, "scan-1")).await.expect("begun").job;
    measured(&service, &begun.id).await;
    let (end, held) = occupy(&service.measuring.compute).await;
    let again = service.operating.measure_from_sensor(scan_request(&lease, "scan-1")).await.expect("answered");
    assert_eq!((again.job.id, again.replayed), (begun.id, true));
    let other = SensorRequest {
        way: ScanWay { profiles_count: Some(50), ..ScanWay::default() },
        ..scan_request(&lease, "scan-1")
    };
    let refused = service.operating.measure_from_sensor(other).await.expect_err("another request");
    assert!(matches!(refused, ServiceError::RequestIdReused { .. }), "{refused}");
    drop(end);
    held.await.expect("joined");
    service.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_scan_taken_during_another_calculation_waits_for_its_turn_and_its_points_are_stored_first() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    let (end, held) = occupy(&service.operating.line).await;
    let begun = service.operating.measure_from_sensor(scan_request(&lease, "scan-1")).await.expect("begun").job;
    let page = Page { limit: 10, before: None };
    while service.measuring.scans(&page).await.expect("a list").rows.is_empty() {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let AnyMeasurement::Scan(scan) = service.operating.any_measurement(&begun.id, Duration::ZERO).await.expect("there")
    else {
        panic!("there is no place to calculate")
    };
    assert_eq!(scan.standing, JobStatus::Running);
    drop(end);
    held.await.expect("joined");
    let measurement = measured(&service, &begun.id).await;
    assert_eq!(service.measuring.scans(&page).await.expect("a list").rows[0].id, measurement.scan_id());
    service.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn uploads_and_their_memory_neither_block_nor_delay_a_scan_by_the_sensor() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    let (end, held) = occupy(&service.measuring.compute).await;
    let all = service.shared.memory.rest.claim(usize::MAX).await.expect("free");
    assert!(matches!(service.accept(order("upload")).await, Err(ServiceError::Compute(_))), "no place for an upload");
    let begun = service.operating.measure_from_sensor(scan_request(&lease, "scan-1")).await.expect("begun").job;
    measured(&service, &begun.id).await;
    drop((all, end));
    held.await.expect("joined");
    service.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_scan_by_the_sensor_begins_without_memory_for_its_points() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    let all = service.shared.memory.sensor.claim_free().expect("free");
    let refused = service.operating.measure_from_sensor(scan_request(&lease, "scan-1")).await.expect_err("no memory");
    assert!(matches!(refused, ServiceError::ScansBusy), "{refused}");
    drop(all);
    let begun =
        service.operating.measure_from_sensor(scan_request(&lease, "scan-1")).await.expect("nothing was recorded").job;
    measured(&service, &begun.id).await;
    service.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_validity_of_a_pose_does_not_depend_on_the_wall_clock() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    let handle = service.operating.cell_handle().expect("a cell");
    let begun = service.operating.measure_from_sensor(scan_request(&lease, "scan-1")).await.expect("begun").job;
    let taken = measured(&service, &begun.id).await.acquisition.expect("taken here");
    for second in [-1_000_000_000, 0, 4_000_000_000] {
        let taken = Acquisition { at: Timestamp::from_second(second).expect("a time"), ..taken.clone() };
        assert_eq!(service.operating.check_fresh(handle, Some(&taken)), Ok(()), "{second} s");
    }
    let elsewhere = Acquisition { instance_id: "another".to_owned(), ..taken.clone() };
    assert_eq!(service.operating.check_fresh(handle, Some(&elsewhere)), Err(Stale::Restarted));
    assert_eq!(service.operating.check_fresh(handle, None), Err(Stale::Restarted));
    // Even if the clock is set back, a move counts as later than the scan before it.
    let moved = service.operating.start_move(move_request(&lease, 2.0, "part-1")).await.expect("begun").job;
    service.operating.get_move(&moved.id, LONG).await.expect("over");
    let future = Acquisition { at: Timestamp::from_second(4_000_000_000).expect("a time"), ..taken };
    assert_eq!(service.operating.check_fresh(handle, Some(&future)), Err(Stale::MovedSince));
    service.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_start_that_the_closing_cell_refuses_is_refused_and_its_ids_are_free() {
    let folder = TempFolder::new();
    let (service, lease) = ready(&folder, FAST).await;
    let order = MoveOrder {
        by: service.operating.authorise(&lease, None).await.expect("the lease is valid"),
        measurement_id: None,
        speed_ratio: 1.0,
        plan: crate::motion::plan_move(
            &service.operating.cell_handle().expect("a cell").arrangement,
            &service.operating.cell_handle().expect("a cell").positions().expect("known"),
            &move_request(&lease, 2.0, "").targets,
            1.0,
        )
        .expect("a path"),
    };
    // The lease was checked before, and now the cell closes.
    service.operating.cell_handle().expect("a cell").cell.close().await;
    let key = crate::store::RequestKey { id: "part-1".to_owned(), fingerprint: "f".to_owned() };
    let departure =
        crate::service::operating::moves::Departure { lease_id: lease, plan_id: None, request: Some(key), order };
    let refused = service.operating.depart(departure).await.expect_err("it closes");
    assert!(matches!(refused, ServiceError::Cell(crate::cell::Refusal::Closing)), "{refused}");
    assert_eq!(service.shared.store.job_by_request("part-1").await.expect("read"), None, "the id is free again");
    let listed = service.operating.moves(&Page { limit: 10, before: None }).await.expect("a list").rows;
    assert!(matches!(&listed[..], [Entry::Record(one)] if one.standing == JobStatus::Refused), "{listed:?}");
    service.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stops_that_a_full_store_refuses_are_recorded_later() {
    let folder = TempFolder::new();
    let (service, _) = ready(&folder, FAST).await;
    service.shared.store.set_full(true);
    service.operating.stop().await.expect("stopped");
    service.operating.stop().await.expect("stopped");
    service.shared.store.set_full(false);
    let stops = async || {
        let rows =
            service.shared.store.jobs("act", None, &Page { limit: 10, before: None }).await.expect("a list").rows;
        rows.into_iter().filter(|row| row.document.contains(r#""verb":"stop""#) && row.ended_at.is_some()).count()
    };
    while stops().await == 0 {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    service.close().await;
}

#[tokio::test]
async fn no_job_is_started_while_too_many_ends_wait() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    service.shared.store.set_full(true);
    for number in 0..64 {
        service.shared.unwritten.check_room(false).expect("space");
        let job = EndedJob {
            id: format!("v-{number}"),
            state: "done".to_owned(),
            ended_at: service.now(),
            document: String::new(),
        };
        service.operating.end_job(unwritten::End { job, frees: false, measured: None }).await;
    }
    let refused = service.shared.unwritten.check_room(false).expect_err("too many");
    assert!(matches!(refused, ServiceError::EndsUnwritten { count: 64 }), "{refused}");
    service.shared.store.set_full(false);
    service.close().await;
}

#[tokio::test]
async fn a_committed_measurement_is_the_newest_although_its_client_disconnected() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let upload = begin(&service, &ply(5), MeasurementOrder::default()).await.expect("space");
    let arrived = service.measuring.complete_upload(upload).await.expect("complete");
    let sequence = service.sequence();
    let mut measuring = Box::pin(service.measuring.measure_upload(arrived));
    while service.shared.background.count() == 0 {
        let pending =
            std::future::poll_fn(|context| std::task::Poll::Ready(measuring.as_mut().poll(context).is_pending()));
        assert!(pending.await, "it is over before it could be left");
        tokio::task::yield_now().await;
    }
    drop(measuring);
    while service.measuring.last().is_none() {
        tokio::task::yield_now().await;
    }
    assert!(service.sequence() > sequence);
}
