//! The route table.

use super::{edge, openapi};
use crate::http::app::App;
use crate::http::v1::{cell, events, manipulators, measurements, moves, plans, recipes, scans, status};
use axum::Router;
use axum::middleware::from_fn_with_state;
use axum::routing::get;
use tower_http::catch_panic::CatchPanicLayer;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Every resource with its documentation.
fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(openapi::head())
        .routes(routes!(measurements::create_measurement, measurements::list_measurements))
        .routes(routes!(measurements::get_measurement))
        .routes(routes!(measurements::list_profiles))
        .routes(routes!(measurements::get_plot))
        .routes(routes!(scans::create_scan, scans::list_scans))
        .routes(routes!(scans::get_scan))
        .routes(routes!(scans::get_scan_content))
        .routes(routes!(recipes::list_recipes))
        .routes(routes!(recipes::get_recipe, recipes::put_recipe))
        .routes(routes!(cell::get_cell))
        .routes(routes!(cell::take_lease, cell::get_lease, cell::release_lease))
        .routes(routes!(cell::stop_cell))
        .routes(routes!(cell::reset_cell))
        .routes(routes!(manipulators::list_manipulators))
        .routes(routes!(manipulators::get_manipulator))
        .routes(routes!(manipulators::enable_manipulator))
        .routes(routes!(manipulators::disable_manipulator))
        .routes(routes!(manipulators::home_manipulator))
        .routes(routes!(plans::create_plan, plans::list_plans))
        .routes(routes!(plans::get_plan))
        .routes(routes!(plans::execute_plan))
        .routes(routes!(moves::create_move, moves::list_moves))
        .routes(routes!(moves::get_move))
        .routes(routes!(events::list_events))
        .routes(routes!(status::get_status))
        .routes(routes!(status::get_liveness))
        .routes(routes!(status::get_readiness))
        .routes(routes!(status::get_metrics))
        .routes(routes!(openapi::get_openapi))
        .routes(routes!(openapi::get_docs))
}

/// The complete OpenAPI document as text, as it is committed.
///
/// # Errors
/// If it cannot be serialised as JSON.
pub fn openapi_json() -> Result<String, serde_json::Error> {
    openapi::with_refusals(routes().into_openapi())
}

/// The router with all layers.
pub(in crate::http) fn router(app: App) -> Router {
    let (router, _) = routes().split_for_parts();
    router
        .route("/docs/{file}", get(openapi::get_docs_file))
        .fallback(edge::route_unknown)
        .method_not_allowed_fallback(edge::method_not_allowed)
        .layer(CatchPanicLayer::custom(edge::panicked))
        .layer(from_fn_with_state(app.clone(), edge::edge))
        .with_state(app)
}
