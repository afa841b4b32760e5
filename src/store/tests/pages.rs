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
    let mut rows: Vec<_> = (0..count).map(|number| varied(number).row).collect();
    rows.sort_by(|a, b| (b.created_at, &b.id).cmp(&(a.created_at, &a.id)));
    rows
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

#[test]
fn only_cursors_of_our_own_making_are_read() {
    let cursor = Cursor::new(at(5), "m-1");
    assert_eq!(Cursor::parse(&cursor.to_string()).unwrap(), cursor);
    let text = cursor.to_string();
    let foreign = ["", "m-1", "00", &text[1..], &text.to_uppercase(), &format!("{text}0"), "ffffffffffffffff", "ä"];
    for text in foreign {
        assert!(matches!(Cursor::parse(text), Err(StoreError::CursorMalformed)), "{text}");
    }
}
