//! What went in comes out; a request is answered once.

use tokio::task::JoinSet;

use super::*;
use crate::store::{Counts, Inserted, Precondition, PutRecipe, RecordedScan, StoreError};

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
async fn a_scan_keeps_the_row_of_the_first_time() {
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
async fn a_recipe_is_put_only_where_its_precondition_holds() {
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
async fn of_simultaneous_replacements_of_one_revision_one_wins() {
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
async fn sixty_four_clients_write_and_read_without_meeting_a_lock() {
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
