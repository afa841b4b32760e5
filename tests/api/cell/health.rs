//! A cell that has ended is reported by the probe, by the counters, and by every view of the cell.

use super::{FAST, untouched};
use serde_json::json;
use std::sync::Arc;

#[test]
fn a_service_whose_cell_has_ended_is_not_ready_and_does_not_show_its_last_state() {
    let (service, _folder) = untouched(FAST);
    assert_eq!(service.get("/health/ready").expect(200)["status"], "ok");
    assert!(service.get("/metrics").text().contains("coaxis_cell_alive 1"));
    let verbs = Arc::clone(service.verbs.as_ref().expect("it runs here"));
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime")
        .block_on(verbs.stop_motion());
    drop(verbs);
    let problem = service.get("/health/ready").problem(503, "not_ready");
    assert_eq!(problem["not_ready"], json!(["cell"]));
    for path in ["/v1/cell", "/v1/cell/lease", "/v1/manipulators"] {
        assert_eq!(service.get(path).problem(503, "not_ready")["not_ready"], json!(["cell"]));
    }
    assert_eq!(service.get("/v1/status").expect(200)["cell_state"], json!(null));
    assert!(service.get("/metrics").text().contains("coaxis_cell_alive 0"));
    service.get("/health/live").expect(200);
}
