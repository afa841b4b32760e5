//! Lists: complete, ordered, undisturbed by what is added meanwhile, and never sorted by the database.

use sqlx::{AssertSqlSafe, Row};

use super::*;
use crate::store::{Cursor, Filter, Listing, PAGE_ROWS_MAX, Page, Precondition, StoreError, page::Listed};

/// Verdicts and recipes in cycles of different length, four rows to a second, ids in no order of time.
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
async fn paging_neither_skips_nor_repeats_while_rows_are_added() {
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
async fn a_filter_keeps_what_meets_all_its_conditions() {
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
async fn scans_and_recipes_are_listed_newest_first_too() {
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
async fn the_order_of_a_list_is_that_of_the_commits_although_the_clock_goes_back() {
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
async fn a_row_with_a_damaged_text_or_time_hides_none_of_the_others() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    for number in 0..3 {
        store.insert_measurement(new_measurement(&format!("m-{number}"), number)).await.unwrap();
    }
    let damage = "UPDATE measurements SET document = CAST(x'7b22ff' AS TEXT), created_at = 9223372036854775807 \
        WHERE id = 'm-1'";
    store.writer.write(super::failures::Statement(damage)).await.unwrap();
    let rows = store.measurements(&Filter::default(), &Page { limit: 10, before: None }).await.unwrap().rows;
    let documents: Vec<_> = rows.iter().map(|row| (row.id.as_str(), row.document.as_str())).collect();
    assert_eq!(documents, [("m-2", "{\"id\":\"m-2\"}"), ("m-1", "{\"\u{fffd}"), ("m-0", "{\"id\":\"m-0\"}")]);
}

#[test]
fn only_cursors_of_our_own_making_are_read() {
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
