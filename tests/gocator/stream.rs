//! The sensor at its maximum rate: 5000 profiles per second of 1280 points, read by one thread. The test asserts processor time and
//! not wall-clock time, which depends on other programs on the machine; both are printed.
//!
//! `COAXIS_PROFILES=50000 cargo test --test all gocator::stream -- --nocapture --test-threads 1`

use super::sensor::{sensor, serve_source, settings, view};
use crate::made::count;
use coaxis::device::gocator::server::{Form, Source, Taken};
use coaxis::device::gocator::{Settings, Travel};
use coaxis::device::{Pending, ProfileSensor};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

const WIDTH: usize = 1280;
const RATE_HZ: f64 = 5_000.0;

/// The same profile repeatedly, each one tick later.
struct Endless {
    taken: Taken,
    sent_count: u64,
    rate_hz: Option<f64>,
    began_at: Option<Instant>,
}

#[expect(clippy::disallowed_methods, reason = "the test measures time")]
fn now() -> Instant {
    Instant::now()
}

impl Source for Endless {
    fn begin(&mut self) {
        (self.sent_count, self.began_at) = (0, None);
    }

    fn next(&mut self) -> Pending<'_, Option<Arc<Taken>>> {
        Box::pin(async {
            if let Some(rate_hz) = self.rate_hz {
                let began_at = *self.began_at.get_or_insert_with(now);
                sleep_until(began_at + Duration::from_secs_f64(self.sent_count as f64 / rate_hz)).await;
            }
            self.sent_count += 1;
            let (encoder, timestamp) = (self.sent_count as i64, 200 * self.sent_count);
            Some(Arc::new(Taken { encoder, timestamp, ..self.taken.clone() }))
        })
    }
}

/// Seconds that this thread has run on a processor.
fn processor_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux");
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1e9
}

/// Wall-clock seconds and processor seconds of the thread that reads `profiles_count` profiles.
fn read_stream(profiles_count: u64, rate_hz: Option<f64>) -> [f64; 2] {
    let point =
        |at: usize| (!at.is_multiple_of(11)).then_some([0.2 * at as f64 - 128.0, 40.0 - 1e-4 * (at * at) as f64 / 4.0]);
    let taken = Taken { points: (0..WIDTH).map(point).collect(), ..Taken::default() };
    let server_runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let source = Endless { taken, sent_count: 0, rate_hz, began_at: None };
    let server = server_runtime.block_on(serve_source(view(Form::PointCloud), Box::new(source)));
    let travel = Some(Travel::Encoder { mm_per_tick: 0.01, start_mm: 0.0, zero_ticks: None });
    let mut sensor = sensor(&Settings { travel, ..settings(&server) });
    let client_runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    client_runtime.block_on(async {
        sensor.connect().await.expect("there");
        sensor.start(profiles_count).await.expect("started");
        let (wall, processor) = (now(), processor_s());
        let (mut received_count, mut points_count) = (0, 0);
        while received_count < profiles_count {
            for profile in sensor.receive().await.expect("complete") {
                received_count += 1;
                points_count += profile.z.len() as u64;
            }
        }
        let took = [wall.elapsed().as_secs_f64(), processor_s() - processor];
        assert_eq!(points_count, profiles_count * (WIDTH - WIDTH.div_ceil(11)) as u64);
        sensor.stop().await.expect("nothing lost");
        took
    })
}

#[test]
fn one_thread_reads_the_sensor_at_its_maximum_rate() {
    let profiles_count = count("COAXIS_PROFILES", 5_000);
    for rate_hz in [Some(RATE_HZ), None] {
        let [wall_s, processor_s] = read_stream(profiles_count, rate_hz);
        let pace = rate_hz.map_or("flat out".to_owned(), |rate| format!("at {rate} Hz"));
        println!(
            "{profiles_count} profiles of {WIDTH} points {pace}: {:.0} profiles/s, {processor_s:.2} s of processor in {wall_s:.2} s",
            profiles_count as f64 / wall_s
        );
        let share = processor_s * RATE_HZ / profiles_count as f64;
        assert!(share < 1.0, "reading takes {share:.2} of a processor at {RATE_HZ} Hz");
    }
}
