//! Records: inserted once per request, read back and listed by pages in the order of their commits; jobs are recorded before
//! anything is sent, and the next start ends those that were under way when the process ended.

use super::*;

use crate::store::page::Listed;
use crate::store::{
    Counts, Cursor, EndedJob, Filter, Inserted, InsertedJob, InsertedPlan, JobRow, Listing, NewJob, PAGE_ROWS_MAX,
    Page, PlanRow, Precondition, PutRecipe, RecordedScan, StoreError,
};
use sqlx::{AssertSqlSafe, Row};
use tokio::task::JoinSet;

#[tokio::test]
async fn records_survive_closing_and_opening() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let mut new = new_measurement("m-1", 1);
    new.row.recipe = Some("flange".into());
    new.request = request("order-7", "f1");
    assert_eq!(store.insert_measurement(new.clone()).await.unwrap(), Inserted::New);
    store.put_recipe("flange", "{}", at(2), Precondition::None).await.unwrap();
    store.close().await;
    drop(store);

    let store = folder.open().await;
    assert_eq!(store.measurement("m-1").await.unwrap(), Some(new.row.clone()));
    assert_eq!(store.profiles("m-1").await.unwrap(), Some(new.profiles));
    assert_eq!(store.scan(&scan_id('a')).await.unwrap(), new.scan);
    let answered = store.measurement_by_request("order-7").await.unwrap().unwrap();
    assert_eq!((answered.fingerprint.as_str(), answered.measurement), ("f1", new.row));
    assert_eq!(store.recipe("flange").await.unwrap().unwrap().etag(), "r1");
    let counts = Counts { scans_count: 1, measurements_count: 1, recipes_count: 1 };
    assert_eq!(store.counts().await.unwrap(), counts);
    assert_eq!(store.measurement("m-2").await.unwrap(), None);
}

#[tokio::test]
async fn a_repeated_scan_keeps_its_first_row() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let first = ScanRow { points_count: None, description: Some("part 4.ply".into()), ..scan_row('b') };
    assert_eq!(store.record_scan(&first).await.unwrap(), RecordedScan::New);
    let later = ScanRow { created_at: at(9), ..scan_row('b') };
    assert_eq!(store.record_scan(&later).await.unwrap(), RecordedScan::Known(first));
}

#[tokio::test]
async fn a_repeated_request_gets_the_first_answer() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let first = NewMeasurement { request: request("r", "same"), ..new_measurement("m-1", 1) };
    store.insert_measurement(first.clone()).await.unwrap();
    let again = NewMeasurement { request: request("r", "same"), ..new_measurement("m-2", 2) };
    assert_eq!(store.insert_measurement(again).await.unwrap(), Inserted::Replayed(Box::new(first.row)));
    let other = NewMeasurement { request: request("r", "other"), ..new_measurement("m-3", 3) };
    assert_eq!(store.insert_measurement(other).await.unwrap(), Inserted::RequestMismatch);
    assert_eq!(store.counts().await.unwrap().measurements_count, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn simultaneous_repetitions_make_one_measurement() {
    let folder = TempFolder::new();
    let store = std::sync::Arc::new(folder.open().await);
    let mut clients = JoinSet::new();
    for client in 0..16 {
        let store = std::sync::Arc::clone(&store);
        let new = NewMeasurement { request: request("r", "f"), ..new_measurement(&format!("m-{client}"), client) };
        clients.spawn(async move { (new.row.id.clone(), store.insert_measurement(new).await.unwrap()) });
    }
    let (mut made, mut told) = (Vec::new(), Vec::new());
    for (own_id, inserted) in clients.join_all().await {
        match inserted {
            Inserted::New => made.push(own_id),
            Inserted::Replayed(row) => told.push(row.id),
            Inserted::RequestMismatch => panic!("the fingerprint is the same"),
        }
    }
    assert_eq!((made.len(), told.len()), (1, 15));
    assert!(told.iter().all(|id| *id == made[0]));
}

#[tokio::test]
async fn a_measurement_needs_its_scan_and_an_id_of_its_own() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let orphan = NewMeasurement { scan: None, ..new_measurement("m-1", 1) };
    let refused = store.insert_measurement(orphan).await.unwrap_err();
    assert!(matches!(refused, StoreError::ScanUnknown { scan_id: id } if id == scan_id('a')));
    store.insert_measurement(new_measurement("m-1", 1)).await.unwrap();
    let refused = store.insert_measurement(new_measurement("m-1", 2)).await.unwrap_err();
    assert!(matches!(refused, StoreError::IdTaken { id } if id == "m-1"));
}

#[tokio::test]
async fn a_recipe_is_stored_only_if_its_precondition_is_met() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let put = |document, second, precondition| store.put_recipe("flange", document, at(second), precondition);

    let none = PutRecipe::PreconditionFailed { current: None };
    assert_eq!(put("a", 1, Precondition::MustExist).await.unwrap(), none);
    assert_eq!(put("a", 1, Precondition::Match("r1".into())).await.unwrap(), none);
    let PutRecipe::Created(first) = put("a", 1, Precondition::MustNotExist).await.unwrap() else {
        panic!("there is no recipe yet")
    };
    let failed = put("b", 2, Precondition::MustNotExist).await.unwrap();
    assert_eq!(failed, PutRecipe::PreconditionFailed { current: Some(first.clone()) });
    let PutRecipe::Replaced(second) = put("b", 2, Precondition::Match(first.etag())).await.unwrap() else {
        panic!("the etag is the current one")
    };
    assert_eq!((second.revision, second.created_at, second.updated_at), (2, at(1), at(2)));
    let failed = put("c", 3, Precondition::Match(first.etag())).await.unwrap();
    assert_eq!(failed, PutRecipe::PreconditionFailed { current: Some(second.clone()) });
    assert_eq!(store.recipe("flange").await.unwrap(), Some(second));
}

#[tokio::test(flavor = "multi_thread")]
async fn one_of_several_simultaneous_replacements_of_a_revision_succeeds() {
    let folder = TempFolder::new();
    let store = std::sync::Arc::new(folder.open().await);
    store.put_recipe("flange", "", at(0), Precondition::None).await.unwrap();
    let mut clients = JoinSet::new();
    for client in 0..16 {
        let store = std::sync::Arc::clone(&store);
        clients.spawn(async move {
            store.put_recipe("flange", "", at(client), Precondition::Match("r1".into())).await.unwrap()
        });
    }
    let outcomes = clients.join_all().await;
    assert_eq!(outcomes.iter().filter(|outcome| matches!(outcome, PutRecipe::Replaced(_))).count(), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sixty_four_clients_write_and_read_without_lock_errors() {
    let folder = TempFolder::new();
    let store = std::sync::Arc::new(folder.open().await);
    let mut clients = JoinSet::new();
    for client in 0..64 {
        let store = std::sync::Arc::clone(&store);
        clients.spawn(async move {
            for second in 0..10 {
                let new = new_measurement(&format!("m-{client}-{second}"), second);
                let row = new.row.clone();
                assert_eq!(store.insert_measurement(new).await.unwrap(), Inserted::New);
                assert_eq!(store.measurement(&row.id).await.unwrap(), Some(row));
            }
        });
    }
    clients.join_all().await;
    assert_eq!(store.counts().await.unwrap().measurements_count, 640);
}

/// Verdicts and recipes in cycles of different length, four rows per second, ids in random order.
fn varied(number: i64) -> NewMeasurement {
    let mut new = new_measurement(&format!("m-{:04}", number * 389 % 1000), number / 4);
    new.row.verdict = if number % 3 == 0 { "refused".into() } else { "accepted".into() };
    new.row.recipe = (number % 5 != 0).then(|| format!("recipe-{}", number % 5));
    new
}

async fn insert_varied(store: &Store, count: i64) -> Vec<MeasurementRow> {
    let inserts = (0..count).map(|number| store.insert_measurement(varied(number)));
    for insert in inserts {
        insert.await.unwrap();
    }
    (0..count).rev().map(|number| varied(number).row).collect()
}

#[tokio::test]
async fn pages_neither_skip_nor_repeat_rows_while_rows_are_added() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let expected = insert_varied(&store, 1000).await;
    let mut page = Page { limit: 37, before: None };
    let mut seen = Vec::new();
    loop {
        let Listing { rows, next } = store.measurements(&Filter::default(), &page).await.unwrap();
        assert!(rows.len() == 37 || next.is_none());
        seen.extend(rows);
        let Some(cursor) = next else { break };
        page.before = Some(Cursor::parse(&cursor.to_string()).unwrap());
        let added = new_measurement(&format!("added-{}", seen.len()), 10_000);
        store.insert_measurement(added).await.unwrap();
    }
    assert_eq!(seen, expected);
}

#[tokio::test]
async fn a_filter_lists_the_rows_that_meet_all_conditions() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let all = insert_varied(&store, 120).await;
    let either = |value: &str| [None, Some(value.to_owned())];
    for verdict in either("refused") {
        for recipe in either("recipe-2") {
            for scan_id in [None, Some(scan_id('a')), Some(scan_id('b'))] {
                let filter = Filter { scan_id, verdict: verdict.clone(), recipe: recipe.clone() };
                let meets = |row: &&MeasurementRow| {
                    filter.scan_id.as_ref().is_none_or(|id| row.scan_id == *id)
                        && filter.verdict.as_ref().is_none_or(|verdict| row.verdict == *verdict)
                        && (filter.recipe.is_none() || row.recipe == filter.recipe)
                };
                let expected: Vec<_> = all.iter().filter(meets).cloned().collect();
                let listing = store.measurements(&filter, &Page { limit: 200, before: None }).await.unwrap();
                assert_eq!(listing, Listing { rows: expected, next: None }, "{filter:?}");
            }
        }
    }
}

#[tokio::test]
async fn no_list_is_sorted_by_the_database() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let filters: [&[&'static str]; 5] =
        [&[], &["scan_id"], &["verdict"], &["recipe"], &["scan_id", "verdict", "recipe"]];
    let mut statements: Vec<_> = filters.iter().map(|columns| MeasurementRow::LIST.page(columns, true)).collect();
    statements.push(MeasurementRow::LIST.page(&[], false));
    statements.push(ScanRow::LIST.page(&[], true));
    statements.push(crate::store::RecipeRow::LIST.page(&[], true));
    for statement in statements {
        let plan = AssertSqlSafe(format!("EXPLAIN QUERY PLAN {statement}"));
        let steps = sqlx::query(plan).fetch_all(&store.readers).await.unwrap();
        let details: Vec<String> = steps.iter().map(|step| step.get("detail")).collect();
        let by_index = details.iter().all(|step| step.contains("USING INDEX") && !step.contains("TEMP B-TREE"));
        assert!(by_index, "{statement}: {details:?}");
    }
}

#[tokio::test]
async fn scans_and_recipes_are_listed_newest_first() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    for (second, digit) in "0123456789".chars().enumerate() {
        let created_at = at(second as i64);
        store.record_scan(&ScanRow { created_at, ..scan_row(digit) }).await.unwrap();
        store.put_recipe(&format!("größe {digit}"), "{}", created_at, Precondition::None).await.unwrap();
    }
    let first = Page { limit: 7, before: None };
    let scans = store.scans(&first).await.unwrap();
    let rest = store.scans(&Page { before: scans.next, ..first.clone() }).await.unwrap();
    let ids: Vec<_> = scans.rows.into_iter().chain(rest.rows).map(|row| row.id).collect();
    assert_eq!(ids, "9876543210".chars().map(scan_id).collect::<Vec<_>>());
    let recipes = store.recipes(&first).await.unwrap();
    let rest = store.recipes(&Page { before: recipes.next, ..first }).await.unwrap();
    let names: Vec<_> = recipes.rows.into_iter().chain(rest.rows).map(|row| row.name).collect();
    assert_eq!(names, "9876543210".chars().map(|digit| format!("größe {digit}")).collect::<Vec<_>>());
}

#[tokio::test]
async fn a_page_has_at_least_one_row_and_a_bounded_number() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    insert_varied(&store, 3).await;
    let all = Filter::default();
    assert_eq!(store.measurements(&all, &Page { limit: 0, before: None }).await.unwrap().rows.len(), 1);
    let listing = store.measurements(&all, &Page { limit: u32::MAX, before: None }).await.unwrap();
    assert_eq!((listing.rows.len(), listing.next), (3, None));
    assert_eq!(PAGE_ROWS_MAX, 1000);
}

#[tokio::test]
async fn lists_follow_the_order_of_the_commits_although_the_clock_is_set_back() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    for (number, second) in [5, 3_600, -3_600, 4].into_iter().enumerate() {
        store.insert_measurement(new_measurement(&format!("m-{}", 9 - number), second)).await.unwrap();
        let newest = store.newest_measurement().await.unwrap().unwrap();
        assert_eq!((newest.id, newest.sequence), (format!("m-{}", 9 - number), number as u64 + 1));
    }
    let (mut page, mut ids) = (Page { limit: 1, before: None }, Vec::new());
    loop {
        let Listing { rows, next } = store.measurements(&Filter::default(), &page).await.unwrap();
        ids.extend(rows.into_iter().map(|row| row.id));
        page.before = next;
        if next.is_none() {
            break;
        }
    }
    assert_eq!(ids, ["m-6", "m-7", "m-8", "m-9"]);
}

#[tokio::test]
async fn a_row_with_a_damaged_text_or_time_does_not_hide_other_rows() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    for number in 0..3 {
        store.insert_measurement(new_measurement(&format!("m-{number}"), number)).await.unwrap();
    }
    let damage = "UPDATE measurements SET document = CAST(x'7b22ff' AS TEXT), created_at = 9223372036854775807 \
        WHERE id = 'm-1'";
    store.writer.write(super::durability::Statement(damage)).await.unwrap();
    let rows = store.measurements(&Filter::default(), &Page { limit: 10, before: None }).await.unwrap().rows;
    let documents: Vec<_> = rows.iter().map(|row| (row.id.as_str(), row.document.as_str())).collect();
    assert_eq!(documents, [("m-2", "{\"id\":\"m-2\"}"), ("m-1", "{\"\u{fffd}"), ("m-0", "{\"id\":\"m-0\"}")]);
}

#[test]
fn only_cursors_written_by_the_store_are_accepted() {
    let cursor = Cursor::new(5);
    assert_eq!(Cursor::parse(&cursor.to_string()).unwrap(), cursor);
    let text = cursor.to_string();
    let foreign = [
        "",
        "m-1",
        "00",
        &text[1..],
        "000000000000000A",
        &format!("{text}0"),
        "ffffffffffffffff",
        "+000000000000005",
        "ä",
    ];
    for text in foreign {
        assert!(matches!(Cursor::parse(text), Err(StoreError::CursorMalformed)), "{text}");
    }
}

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
async fn a_job_keeps_its_first_end() {
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
    assert_eq!(executed, [("p-2", None), ("p-1", Some("v-1"))], "one query must find the jobs of all plans");
    assert_eq!(store.job_by_request("r").await.unwrap(), Some(first));
}

#[tokio::test]
async fn a_refused_job_frees_its_request_and_its_plan() {
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
async fn jobs_of_an_ended_process_are_ended_by_the_next_one() {
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
async fn a_measurement_ends_its_job_in_the_same_transaction() {
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
