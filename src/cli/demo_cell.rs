//! The demonstration's second half: the simulated cell scans its part, plans how to bring it to a target, moves, and scans again.
//! Everything goes over HTTP, as a client would do it; only the truth is looked up.

use super::client::{self, Answer};
use crate::config::{Cell, ManipulatorAdaptor, SensorAdaptor, StageAdaptor};
use crate::device::simulated::World;
use serde_json::{Value, json};
use std::error::Error;
use std::time::Duration;
use tokio::time::sleep;

/// Longest that anything may take.
const WAIT: Duration = Duration::from_secs(90);
/// Between two looks at the cell's state.
const LOOK: Duration = Duration::from_millis(50);

/// Where the part is wanted: along the rail, a little above.
const TARGET: [(&str, f64); 4] = [("deflection_deg", 0.0), ("pitch_deg", 0.0), ("y_c0_mm", 0.0), ("z_c0_mm", 10.0)];

/// Whether every device is made, so that nothing real moves.
pub(super) fn is_made(cell: &Cell) -> bool {
    cell.manipulators.iter().all(|(_, one)| one.adaptor == ManipulatorAdaptor::Simulated)
        && cell.stage.adaptor == StageAdaptor::Simulated
        && cell.sensor.adaptor == SensorAdaptor::Simulated
}

/// Measures, moves, measures again: what is to be shown.
pub(super) async fn align(base: &str, world: &World) -> Result<String, Box<dyn Error>> {
    until_idle(base).await?;
    let lease = post(base, "/v1/cell/lease", &json!({"holder": "demo", "ttl_s": 60}), 201).await?;
    let lease = json!({"lease_id": text(&lease, "lease_id")});
    for manipulator in ["m1", "m2"] {
        post(base, &format!("/v1/manipulators/{manipulator}/enable"), &lease, 200).await?;
    }
    until_allowed(base).await?;
    let before = measure(base, &lease).await?;
    let true_before = truth(world);
    let target: serde_json::Map<String, Value> =
        TARGET.iter().map(|(name, value)| ((*name).to_owned(), json!(value))).collect();
    let plan = post(base, "/v1/plans", &json!({"measurement_id": text(&before, "id"), "target": target}), 201).await?;
    let execute = format!("/v1/plans/{}/execute", text(&plan, "id"));
    let began = post(base, &execute, &lease, 201).await?;
    let moved = get(base, &format!("/v1/moves/{}?wait_s=60", text(&began, "id"))).await?;
    if text(&moved, "state") != "done" {
        return Err(format!("the move of the demonstration ended as {moved}").into());
    }
    let after = measure(base, &lease).await?;
    let true_after = truth(world);
    // Whoever comes next is to find it free.
    post(base, "/v1/cell/stop", &Value::Null, 200).await?;
    release(base, &lease).await?;
    Ok(report(&plan, [(&before, true_before), (&after, true_after)]))
}

async fn measure(base: &str, lease: &Value) -> Result<Value, Box<dyn Error>> {
    let order = json!({"source": "sensor", "lease_id": text(lease, "lease_id")});
    let began = post(base, "/v1/measurements", &order, 201).await?;
    let measured = get(base, &format!("/v1/measurements/{}?wait_s=60", text(&began, "id"))).await?;
    if text(&measured, "verdict") != "accepted" {
        return Err(format!("the measurement by the sensor came to {measured}").into());
    }
    Ok(measured)
}

async fn until_idle(base: &str) -> Result<(), Box<dyn Error>> {
    let up = |device: &Value| text(device, "link") == "up";
    let all_up = |cell: &Value| cell.get("devices").and_then(Value::as_array).is_some_and(|all| all.iter().all(up));
    until(base, |cell| text(cell, "state") == "idle" && all_up(cell)).await
}

async fn until_allowed(base: &str) -> Result<(), Box<dyn Error>> {
    until(base, |cell| cell.get("commands_allowed").and_then(Value::as_bool) == Some(true)).await
}

async fn until(base: &str, so: impl Fn(&Value) -> bool) -> Result<(), Box<dyn Error>> {
    for _ in 0..200 {
        let cell = get(base, "/v1/cell").await?;
        if so(&cell) {
            return Ok(());
        }
        sleep(LOOK).await;
    }
    Err("the simulated cell does not become ready; GET /v1/cell says why".into())
}

async fn release(base: &str, lease: &Value) -> Result<(), Box<dyn Error>> {
    let url = format!("{base}/v1/cell/lease?lease_id={}", text(lease, "lease_id"));
    expect(&url, &client::delete(&url, WAIT).await?, 200).map(|_| ())
}

async fn post(base: &str, path: &str, body: &Value, status: u16) -> Result<Value, Box<dyn Error>> {
    let url = format!("{base}{path}");
    let body = if body.is_null() { String::new() } else { body.to_string() };
    expect(&url, &client::post_json(&url, &body, WAIT).await?, status)
}

async fn get(base: &str, path: &str) -> Result<Value, Box<dyn Error>> {
    let url = format!("{base}{path}");
    expect(&url, &client::get(&url, WAIT).await?, 200)
}

fn expect(url: &str, answer: &Answer, status: u16) -> Result<Value, Box<dyn Error>> {
    if answer.status != status {
        return Err(format!("{url} answered {}: {}", answer.status, answer.body).into());
    }
    Ok(serde_json::from_str(&answer.body)?)
}

fn text<'a>(document: &'a Value, field: &str) -> &'a str {
    document.get(field).and_then(Value::as_str).unwrap_or_default()
}

/// The true axis in the order of [`TARGET`].
fn truth(world: &World) -> [f64; 4] {
    let axis = world.truth();
    [axis.deflection().degrees(), axis.pitch().degrees(), axis.y0, axis.z0]
}

fn report(plan: &Value, [(before, true_before), (after, true_after)]: [(&Value, [f64; 4]); 2]) -> String {
    let number =
        |document: &Value, pointer: &str| document.pointer(pointer).and_then(Value::as_f64).unwrap_or(f64::NAN);
    let mut text = format!(
        "\nThe simulated cell has scanned its part, moved it to a target by plan {} ({:.1} s, strain {:.4} mm) and scanned again:\n\
         {:<16}{:>12}{:>12}{:>12}{:>12}{:>12}",
        text(plan, "id"),
        number(plan, "/duration_s"),
        number(plan, "/strain_mm"),
        "",
        "before",
        "truth",
        "target",
        "after",
        "truth"
    );
    let rows = TARGET.iter().zip(true_before).zip(true_after);
    for (((field, wanted), true_before), true_after) in rows {
        let pointer = format!("/pose/{field}");
        text += &format!(
            "\n{field:<16}{:>12.4}{true_before:>12.4}{wanted:>12.4}{:>12.4}{true_after:>12.4}",
            number(before, &pointer),
            number(after, &pointer)
        );
    }
    text += "\nWhat is left of the way is the made backlash (0.05 mm) and cross-coupling (2 %); a second plan takes it. The made \
             cell runs faster than a real one.\n";
    text
}
