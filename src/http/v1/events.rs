//! Numbered events: by polling with a bounded wait, or as a stream of server-sent events with the same content.

use crate::cell::{EventKind, Failure, JobEnd, StopCause};
use crate::http::app::App;
use crate::http::server::shares::{Peer, Place};
use crate::http::wire::body::header_text;
use crate::http::wire::command::{WaitSeconds, wait};
use crate::http::wire::extract::{Query, choose};
use crate::http::wire::numbers::rounded;
use crate::http::wire::problem::{Code, Problem};
use crate::service::{After, Event, Events, Happening, Service, stop_code};
use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use http_body_util::channel::{Channel, Sender};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use utoipa::{IntoParams, ToSchema};

const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

/// Maximum number of events of one answer.
const LIMIT: usize = 256;
/// Interval of the heartbeat on a stream without events.
const HEARTBEAT: Duration = Duration::from_secs(10);
/// Pieces of a stream that are queued for a slow reader; then the stream waits, too.
const PIECES_WAITING: usize = 8;

/// Which events.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct EventsQuery {
    /// Number of the last event that is known; 0 by default.
    after: Option<u64>,
    /// `instance_id` of the answer that `after` is from: where the service was restarted since, that is told by `missed_count`,
    /// and the events come from the first on.
    instance_id: Option<String>,
    /// How long to wait for the next event where there is none, in seconds.
    #[param(value_type = Option<u8>, minimum = 0, maximum = 60)]
    wait_s: Option<WaitSeconds>,
}

/// Events in order.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct EventList {
    /// At most 256; ask on behind the last one.
    events: Vec<EventDocument>,
    /// How many that were asked for are not kept any more; at least 1 where `after` is known to be of another instance.
    missed_count: u64,
    /// Number of the newest event of all; it may be beyond the last of these.
    newest: u64,
    /// Events are numbered anew with every instance.
    instance_id: String,
}

/// Something that has happened.
#[derive(Debug, Default, Serialize, ToSchema)]
#[schema(as = Event)]
pub(in crate::http) struct EventDocument {
    /// 1 for the first of this instance; without gaps.
    number: u64,
    /// When, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    at: Timestamp,
    /// `state_changed`, `link_up`, `link_lost`, `lease_taken`, `lease_ended`, `job_started`, `job_progress`, `job_ended`,
    /// `measured`, `not_measured`, `stopping`, `faulted`, `resolved`, `manual_done`, `manual_refused`, `reset`, `closed`.
    #[schema(example = "job_started")]
    event: &'static str,
    /// The device that it is about.
    #[serde(skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    /// The move (`v-`) or the measurement (`m-`) that it is about.
    #[serde(skip_serializing_if = "Option::is_none")]
    job_id: Option<String>,
    /// How far the job is, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    progress: Option<f64>,
    /// The state before.
    #[serde(skip_serializing_if = "Option::is_none")]
    from: Option<&'static str>,
    /// The state of cell or job from now on. `job_ended` reports the end in the cell: whether a scan became a measurement is reported by
    /// `measured` or `not_measured` after it.
    #[serde(skip_serializing_if = "Option::is_none")]
    state: Option<&'static str>,
    /// The verdict of a measurement.
    #[serde(skip_serializing_if = "Option::is_none")]
    verdict: Option<&'static str>,
    /// Who holds, or held, the lease.
    #[serde(skip_serializing_if = "Option::is_none")]
    holder: Option<String>,
    /// The lease's fence.
    #[serde(skip_serializing_if = "Option::is_none")]
    fence: Option<u64>,
    /// A short word for what happened.
    #[serde(skip_serializing_if = "Option::is_none")]
    code: Option<String>,
    /// A description of what happened.
    #[serde(skip_serializing_if = "Option::is_none")]
    text: Option<String>,
}

/// Get events
///
/// Those behind `after`, at most 256; with `wait_s` the answer waits for the first. With `Accept: text/event-stream` the same
/// comes as server-sent events, resumed behind `Last-Event-ID`, which holds over the `after` of the address. Whoever is too
/// slow, or resumes behind an event of an earlier instance, finds an event `missed`.
#[utoipa::path(
    get, path = "/v1/events", tag = "events",
    params(EventsQuery, ("Last-Event-ID" = Option<String>, Header, description = "The id of an event of this stream, `instance_id:number`, as browsers send it")),
    responses((status = 200, description = "Events", content((EventList = "application/json"), (String = "text/event-stream"))))
)]
pub(in crate::http) async fn list_events(
    State(app): State<App>,
    peer: Peer,
    Query(query): Query<EventsQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let wait = wait(query.wait_s);
    let after = query.after(&headers, app.service.instance_id())?;
    let streams = choose(&headers, &[("application/json", false), ("text/event-stream", true)])?;
    if streams {
        return Ok(stream(Arc::clone(&app.service), after, app.listeners.place(peer)?));
    }
    let _place = app.listeners.place_for(peer, wait)?;
    let events = app.service.events(after, LIMIT, wait).await;
    Ok(Json(EventList::of(events, &app.service)).into_response())
}

impl EventsQuery {
    /// Where to continue. The header has priority, because a browser that reconnects repeats the old address.
    fn after(&self, headers: &HeaderMap, instance_id: &str) -> Result<After, Problem> {
        if let Some(text) = header_text(headers, &LAST_EVENT_ID)? {
            return last_event(text.trim(), instance_id);
        }
        if self.after.is_some_and(|after| i64::try_from(after).is_err()) {
            let detail = format!("after must be the number of an event, at most {}", i64::MAX);
            return Err(Problem::new(Code::QueryInvalid, detail));
        }
        Ok(match &self.instance_id {
            Some(instance) if instance != instance_id => After::AnotherInstance,
            _ => After::Number(self.after.unwrap_or(0)),
        })
    }
}

/// The event identified by the id of a stream.
fn last_event(id: &str, instance_id: &str) -> Result<After, Problem> {
    // A number alone was not sent by this service, so its instance is unknown.
    let (instance, number) = id.rsplit_once(':').unwrap_or(("", id));
    let number = number.parse().map_err(|_| {
        let detail = "the header Last-Event-ID must be the id of an event of this stream: instance_id:number";
        Problem::new(Code::HeaderInvalid, detail)
    })?;
    Ok(if instance == instance_id { After::Number(number) } else { After::AnotherInstance })
}

/// A body that sends events as they occur, until the client disconnects or the service shuts down.
fn stream(service: Arc<Service>, after: After, place: Place) -> Response {
    let (sender, body) = Channel::<Bytes, Infallible>::new(PIECES_WAITING);
    tokio::spawn(async move {
        tell(service, after, sender).await;
        drop(place);
    });
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static("text/event-stream; charset=utf-8")),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    (headers, Body::new(body)).into_response()
}

async fn tell(service: Arc<Service>, mut after: After, mut sender: Sender<Bytes, Infallible>) {
    let hello = format!("retry: 2000\n: instance {}\n\n", service.instance_id());
    if sender.send_data(hello.into()).await.is_err() {
        return;
    }
    while !service.is_closing() {
        let events = service.events(after, LIMIT, HEARTBEAT).await;
        let mut piece = String::new();
        // Missed events are reported once; then the stream follows this instance.
        after = After::Number(events.seen);
        if events.missed_count > 0 {
            piece += &format!("event: missed\ndata: {{\"missed_count\": {}}}\n\n", events.missed_count);
        }
        for event in events.events {
            let id = format!("{}:{}", service.instance_id(), event.number);
            let document = EventDocument::from(event);
            let data = serde_json::to_string(&document).unwrap_or_default();
            piece += &format!("id: {id}\nevent: {}\ndata: {data}\n\n", document.event);
        }
        if piece.is_empty() {
            piece = ": still here\n\n".to_owned();
        }
        if sender.send_data(piece.into()).await.is_err() {
            return;
        }
    }
}

impl EventList {
    fn of(events: Events, service: &Service) -> Self {
        let Events { events, missed_count, newest, seen: _ } = events;
        Self {
            events: events.into_iter().map(EventDocument::from).collect(),
            missed_count,
            newest,
            instance_id: service.instance_id().to_owned(),
        }
    }
}

impl From<Event> for EventDocument {
    fn from(event: Event) -> Self {
        let Event { number, at, what } = event;
        let told = match what {
            Happening::Cell(kind) => of_cell(kind),
            Happening::Progress { job, progress } => {
                Self { job_id: Some(job), progress: Some(rounded(progress)), ..named("job_progress") }
            }
            Happening::Measured { measurement_id, verdict } => {
                Self { job_id: Some(measurement_id), verdict: Some(verdict.name()), ..named("measured") }
            }
            Happening::NotMeasured { measurement_id, code, text } => {
                Self { job_id: Some(measurement_id), ..coded("not_measured", &code, text) }
            }
        };
        Self { number, at, ..told }
    }
}

fn named(event: &'static str) -> EventDocument {
    EventDocument { event, ..EventDocument::default() }
}

fn coded(event: &'static str, code: &str, text: String) -> EventDocument {
    EventDocument { code: Some(code.to_owned()), text: Some(text), ..named(event) }
}

fn of_cell(kind: EventKind) -> EventDocument {
    use EventKind as K;
    match kind {
        K::StateChanged { from, to } => {
            EventDocument { from: Some(from.name()), state: Some(to.name()), ..named("state_changed") }
        }
        K::LinkUp { device } => EventDocument { device: Some(device), ..named("link_up") },
        K::LinkLost { device, cause } => {
            EventDocument { device: Some(device), ..coded("link_lost", "link_lost", cause) }
        }
        K::LeaseTaken { holder, fence } => {
            EventDocument { holder: Some(holder), fence: Some(fence), ..named("lease_taken") }
        }
        K::LeaseEnded { holder, fence, ran_out } => {
            let code = if ran_out { "lease_over" } else { "lease_released" };
            let (holder, fence) = (Some(holder), Some(fence));
            EventDocument { holder, fence, code: Some(code.to_owned()), ..named("lease_ended") }
        }
        K::JobStarted { job } => EventDocument { job_id: Some(job), ..named("job_started") },
        K::JobEnded { job, end } => EventDocument { job_id: Some(job), ..job_ended(&end) },
        K::Stopping { cause } => stopping(cause),
        K::Faulted(fault) => EventDocument {
            device: Some(fault.device),
            ..coded("faulted", fault.failure.code(), fault.failure.to_string())
        },
        K::Resolved { device, sequence, taken } => {
            let text = format!(
                "command {sequence} was {}",
                if taken { "accepted" } else { "not accepted and will not be executed" }
            );
            EventDocument { device: Some(device), text: Some(text), ..named("resolved") }
        }
        K::ManualDone { device, verb } => {
            EventDocument { device: Some(device), code: Some(verb.to_owned()), ..named("manual_done") }
        }
        K::ManualRefused { device, verb, cause } => {
            EventDocument { device: Some(device), ..coded("manual_refused", verb, cause) }
        }
        K::Reset => named("reset"),
        K::Closed => named("closed"),
    }
}

fn job_ended(end: &JobEnd) -> EventDocument {
    let ended = |state, failure: &Failure| EventDocument {
        state: Some(state),
        ..coded("job_ended", failure.code(), failure.to_string())
    };
    match end {
        JobEnd::Done => EventDocument { state: Some("done"), ..named("job_ended") },
        JobEnd::Stopped(cause) => {
            EventDocument { state: Some("stopped"), ..coded("job_ended", stop_code(*cause), cause.text().to_owned()) }
        }
        JobEnd::Failed(failure) => ended("failed", failure),
        JobEnd::Unknown(failure) => ended("unknown", failure),
    }
}

fn stopping(cause: Option<StopCause>) -> EventDocument {
    match cause {
        Some(cause) => coded("stopping", stop_code(cause), cause.text().to_owned()),
        None => coded(
            "stopping",
            "given_up",
            "the current activity could not continue, or an unexpected motion was detected".to_owned(),
        ),
    }
}
