//! Records that are damaged or of a later version prevent neither the start nor the listing of the others.

use super::*;
use crate::store::{MeasurementRow, NewMeasurement, Precondition, ScanRow, Store};

const LATER: &str = r#"{"document_version":99,"content":{}}"#;
const DAMAGED: &str = r#"{"id":"m-"#;

fn at() -> Timestamp {
    Timestamp::from_second(1_800_000_000).expect("a time")
}

fn bad_measurement(id: &str, document: &str) -> NewMeasurement {
    let scan_id = format!("s-{}", "a".repeat(64));
    let scan = ScanRow {
        id: scan_id.clone(),
        created_at: at(),
        bytes_count: 1,
        format: "ply".to_owned(),
        points_count: None,
        description: None,
        arrival: None,
    };
    let row = MeasurementRow {
        id: id.to_owned(),
        created_at: at(),
        verdict: "accepted".to_owned(),
        method: "cylinder".to_owned(),
        scan_id,
        recipe: None,
        document: document.to_owned(),
    };
    NewMeasurement { row, scan: Some(scan), profiles: b"no list".to_vec(), request: None }
}

/// The document of a valid measurement with a recipe key that this version does not know.
async fn with_unknown_recipe_key(folder: &TempFolder) -> String {
    let service = open(folder).await;
    let id = measure_once(&service, order("good")).await.measurement.id;
    let document = service.shared.store.measurement(&id).await.expect("read").expect("there").document;
    service.close().await;
    document.replacen(r#""recipe":{"#, r#""recipe":{"new_in_2030":1,"#, 1)
}

#[tokio::test]
async fn unreadable_records_stop_neither_the_start_nor_a_list() {
    let folder = TempFolder::new();
    let unknown_key = with_unknown_recipe_key(&folder).await;
    assert!(unknown_key.contains("new_in_2030"));
    let store = Store::open(&folder.0).await.expect("a store");
    store.put_recipe("later", LATER, at(), Precondition::None).await.expect("put");
    for (id, document) in [("m-later", LATER), ("m-damaged", DAMAGED), ("m-unknown-key", &unknown_key)] {
        store.insert_measurement(bad_measurement(id, document)).await.expect("inserted");
    }
    store.close().await;
    drop(store);

    let service = open(&folder).await;
    assert_eq!(
        service.measuring.last().map(|last| (last.id, last.verdict)),
        Some(("m-unknown-key".to_owned(), Some(Verdict::Accepted)))
    );
    let page = Page { limit: 10, before: None };
    let listed = service.measuring.measurements(&Filter::default(), &page).await.expect("a list").rows;
    let told: Vec<_> = listed
        .iter()
        .map(|entry| match entry {
            Entry::Record(_) => ("read", String::new()),
            Entry::Unreadable(record) => (record.id.as_str(), record.cause.to_string()),
        })
        .collect();
    assert_eq!(told.iter().map(|(id, _)| *id).collect::<Vec<_>>(), ["m-unknown-key", "m-damaged", "m-later", "read"]);
    assert!(told[0].1.contains("new_in_2030") && told[2].1.contains("document version 99"), "{told:?}");
    assert!(matches!(service.measuring.recipes(&page).await.expect("a list").rows[..], [Entry::Unreadable(_)]));
    for id in ["m-later", "m-damaged", "m-unknown-key"] {
        let refused = service.operating.measurement(id).await.expect_err("unreadable");
        assert!(matches!(refused, ServiceError::RecordUnreadable { .. }), "{refused}");
        let refused = service.measuring.profiles(id).await.expect_err("unreadable");
        assert!(matches!(refused, ServiceError::RecordUnreadable { .. }), "{refused}");
    }
    let name = RecipeName::parse("later").expect("a name");
    let refused = service
        .accept(MeasurementOrder { recipe: Some(name), ..MeasurementOrder::default() })
        .await
        .expect_err("unreadable");
    assert!(matches!(refused, ServiceError::RecordUnreadable { .. }), "{refused}");
    measure_once(&service, order("after")).await;

    let mut findings = Vec::new();
    let examined = examine(&folder.0, true, &mut |finding| findings.push(finding.to_owned())).await.expect("examined");
    // Three measurements, the recipe, and the scan whose file is missing.
    assert_eq!((examined.findings_count, findings.len()), (5, 5), "{findings:?}");
}
