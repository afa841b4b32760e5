//! What the cell was told is written down before it is told, and what was under way when a process died is ended.

use super::*;
use crate::store::{EndedJob, Inserted, InsertedJob, InsertedPlan, JobRow, NewJob, Page, PlanRow};

fn job(id: &str, second: i64) -> JobRow {
    JobRow {
        id: id.into(),
        kind: "move".into(),
        created_at: at(second),
        state: "moving".into(),
        ended_at: None,
        plan_id: None,
        request: None,
        document: "{}".into(),
    }
}

fn end(id: &str, state: &str) -> EndedJob {
    EndedJob { id: id.into(), state: state.into(), ended_at: at(99), document: r#"{"over":true}"#.into() }
}

fn plan(id: &str) -> PlanRow {
    PlanRow { id: id.into(), created_at: at(0), request: None, document: "{}".into() }
}

async fn insert(store: &Store, row: JobRow) -> InsertedJob {
    store.insert_job(NewJob { row }).await.unwrap()
}

#[tokio::test]
async fn a_job_has_one_end_and_the_first_stays() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    assert_eq!(insert(&store, job("v-1", 1)).await, InsertedJob::New);
    assert_eq!(store.job("v-1").await.unwrap(), Some(job("v-1", 1)));
    store.end_job(end("v-1", "done")).await.unwrap();
    store.end_job(end("v-1", "failed")).await.unwrap();
    let row = store.job("v-1").await.unwrap().unwrap();
    assert_eq!((row.state.as_str(), row.ended_at, row.document.as_str()), ("done", Some(at(99)), r#"{"over":true}"#));
    assert_eq!(store.job("v-2").await.unwrap(), None);
}

#[tokio::test]
async fn a_request_and_a_plan_start_one_job() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    assert_eq!(store.insert_plan(plan("p-1")).await.unwrap(), InsertedPlan::New);
    let first = JobRow { request: request("r", "same"), plan_id: Some("p-1".into()), ..job("v-1", 1) };
    assert_eq!(insert(&store, first.clone()).await, InsertedJob::New);
    let again = JobRow { id: "v-2".into(), ..first.clone() };
    assert_eq!(insert(&store, again).await, InsertedJob::Replayed(Box::new(first.clone())));
    let other = JobRow { request: request("r", "other"), ..job("v-3", 3) };
    assert_eq!(insert(&store, other).await, InsertedJob::RequestMismatch);
    let executed_again = JobRow { request: request("s", "same"), plan_id: Some("p-1".into()), ..job("v-4", 4) };
    assert_eq!(insert(&store, executed_again).await, InsertedJob::PlanUsed(Box::new(first.clone())));
    assert_eq!(store.job_of_plan("p-1").await.unwrap(), Some(first.clone()));
    assert_eq!(store.insert_plan(plan("p-2")).await.unwrap(), InsertedPlan::New);
    let plans = store.plans(&Page { limit: 10, before: None }).await.unwrap().rows;
    let executed: Vec<_> = plans.iter().map(|listed| (listed.plan.id.as_str(), listed.job_id.as_deref())).collect();
    assert_eq!(executed, [("p-2", None), ("p-1", Some("v-1"))], "one query finds the jobs of all");
    assert_eq!(store.job_by_request("r").await.unwrap(), Some(first));
}

#[tokio::test]
async fn a_job_that_was_refused_frees_its_request_and_its_plan() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    store.insert_plan(plan("p-1")).await.unwrap();
    let refused = JobRow { request: request("r", "f"), plan_id: Some("p-1".into()), ..job("v-1", 1) };
    insert(&store, refused.clone()).await;
    store.refuse_job(end("v-1", "refused")).await.unwrap();
    assert_eq!(store.job("v-1").await.unwrap().unwrap().state, "refused");
    assert_eq!(insert(&store, JobRow { id: "v-2".into(), ..refused }).await, InsertedJob::New);
}

#[tokio::test]
async fn what_was_under_way_when_a_process_died_is_ended_by_the_next() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    insert(&store, job("v-1", 1)).await;
    insert(&store, job("v-2", 2)).await;
    store.end_job(end("v-1", "done")).await.unwrap();
    store.raise_fence(7).await.unwrap();
    store.raise_fence(3).await.unwrap();
    store.close().await;
    drop(store);
    let store = folder.open().await;
    assert_eq!(store.fence().await.unwrap(), 7);
    assert_eq!(store.interrupt_jobs("interrupted", at(50)).await.unwrap(), [job("v-2", 2)]);
    assert_eq!(store.interrupt_jobs("interrupted", at(60)).await.unwrap(), []);
    let page = store.jobs("move", None, &Page { limit: 10, before: None }).await.unwrap();
    let states: Vec<_> = page.rows.iter().map(|row| (row.id.as_str(), row.state.as_str(), row.ended_at)).collect();
    assert_eq!(states, [("v-2", "interrupted", Some(at(50))), ("v-1", "done", Some(at(99)))]);
    let done = store.jobs("move", Some("done"), &Page { limit: 10, before: None }).await.unwrap();
    assert_eq!(done.rows.iter().map(|row| row.id.as_str()).collect::<Vec<_>>(), ["v-1"]);
    assert_eq!(store.jobs("scan", None, &Page { limit: 10, before: None }).await.unwrap().rows, []);
}

#[tokio::test]
async fn a_measurement_ends_its_job_in_the_same_moment() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    insert(&store, JobRow { kind: "scan".into(), ..job("m-1", 1) }).await;
    let mut writer = store.begin_scan(100).await.unwrap();
    writer.write(b"points").await.unwrap();
    let file = writer.complete().await.unwrap();
    let row = row_of(&file);
    let new = NewMeasurement {
        row: crate::store::MeasurementRow { scan_id: row.id.clone(), ..measurement_row("m-1", 1) },
        scan: Some(row.clone()),
        profiles: Vec::new(),
        request: None,
    };
    assert_eq!(store.end_job_with(end("m-1", "done"), new, Some(file.into())).await.unwrap(), Inserted::New);
    assert_eq!(store.job("m-1").await.unwrap().unwrap().state, "done");
    assert!(store.measurement("m-1").await.unwrap().is_some());
    assert_eq!(folder.scan_ids(), [row.id]);
}
