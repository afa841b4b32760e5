//! Every statement of the store, in SQL that both SQLite and PostgreSQL accept: numbered placeholders, ON CONFLICT, no types. The
//! differences between the two (types, pragmas) are in the migrations and in `database`.

macro_rules! scan_columns {
    () => {
        "id, created_at, bytes_count, format, points_count, description, arrival"
    };
}
macro_rules! measurement_columns {
    () => {
        "measurements.id, created_at, verdict, method, scan_id, recipe, document"
    };
}
macro_rules! plan_columns {
    () => {
        "id, created_at, request_id, fingerprint, document"
    };
}
macro_rules! job_columns {
    () => {
        "id, kind, created_at, state, ended_at, plan_id, request_id, fingerprint, document"
    };
}
macro_rules! recipe_columns {
    () => {
        "name, revision, document, created_at, updated_at"
    };
}

pub(super) const INSERT_SCAN: &str = concat!(
    "INSERT INTO scans (",
    scan_columns!(),
    ", sequence) VALUES ($1, $2, $3, $4, $5, $6, $7, (SELECT COALESCE(MAX(sequence), 0) + 1 FROM scans)) \
     ON CONFLICT (id) DO NOTHING"
);
pub(super) const SCAN_ARRIVED: &str = "UPDATE scans SET arrival = $2 WHERE id = $1";
pub(super) const SCAN: &str = concat!("SELECT ", scan_columns!(), " FROM scans WHERE id = $1");
pub(super) const SCANS: List = List { select: concat!("SELECT sequence, ", scan_columns!(), " FROM scans") };

pub(super) const INSERT_MEASUREMENT: &str = "INSERT INTO measurements \
    (id, created_at, verdict, method, scan_id, recipe, document, sequence) \
    VALUES ($1, $2, $3, $4, $5, $6, $7, (SELECT COALESCE(MAX(sequence), 0) + 1 FROM measurements))";
pub(super) const NEWEST_MEASUREMENT: &str =
    "SELECT sequence, id, created_at, verdict FROM measurements ORDER BY sequence DESC LIMIT 1";
pub(super) const INSERT_PROFILES: &str = "INSERT INTO profiles (measurement_id, content) VALUES ($1, $2)";
pub(super) const INSERT_REQUEST: &str = "INSERT INTO requests (id, fingerprint, measurement_id) VALUES ($1, $2, $3)";
pub(super) const MEASUREMENT: &str = concat!("SELECT ", measurement_columns!(), " FROM measurements WHERE id = $1");
pub(super) const ANSWERED_REQUEST: &str = concat!(
    "SELECT ",
    measurement_columns!(),
    ", requests.fingerprint FROM requests JOIN measurements ON measurements.id = requests.measurement_id \
     WHERE requests.id = $1"
);
pub(super) const PROFILES: &str = "SELECT content FROM profiles WHERE measurement_id = $1";
pub(super) const MEASUREMENTS: List =
    List { select: concat!("SELECT sequence, ", measurement_columns!(), " FROM measurements") };

pub(super) const INSERT_RECIPE: &str = concat!(
    "INSERT INTO recipes (",
    recipe_columns!(),
    ", sequence) VALUES ($1, $2, $3, $4, $5, (SELECT COALESCE(MAX(sequence), 0) + 1 FROM recipes))"
);
pub(super) const REPLACE_RECIPE: &str =
    "UPDATE recipes SET revision = $2, document = $3, updated_at = $4 WHERE name = $1";
pub(super) const RECIPE: &str = concat!("SELECT ", recipe_columns!(), " FROM recipes WHERE name = $1");
pub(super) const RECIPES: List = List { select: concat!("SELECT sequence, ", recipe_columns!(), " FROM recipes") };

pub(super) const INSERT_PLAN: &str = concat!(
    "INSERT INTO plans (",
    plan_columns!(),
    ", sequence) VALUES ($1, $2, $3, $4, $5, (SELECT COALESCE(MAX(sequence), 0) + 1 FROM plans))"
);
pub(super) const PLAN: &str = concat!("SELECT ", plan_columns!(), " FROM plans WHERE id = $1");
pub(super) const PLAN_OF_REQUEST: &str = concat!("SELECT ", plan_columns!(), " FROM plans WHERE request_id = $1");
pub(super) const PLANS: List = List {
    select: concat!(
        "SELECT sequence, ",
        plan_columns!(),
        ", (SELECT jobs.id FROM jobs WHERE jobs.plan_id = plans.id) AS job_id FROM plans"
    ),
};

pub(super) const INSERT_JOB: &str = concat!(
    "INSERT INTO jobs (",
    job_columns!(),
    ", sequence) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, (SELECT COALESCE(MAX(sequence), 0) + 1 FROM jobs))"
);
pub(super) const END_JOB: &str =
    "UPDATE jobs SET state = $2, ended_at = $3, document = $4 WHERE id = $1 AND ended_at IS NULL";
pub(super) const REFUSE_JOB: &str = "UPDATE jobs SET state = $2, ended_at = $3, document = $4, plan_id = NULL, \
    request_id = NULL, fingerprint = NULL WHERE id = $1 AND ended_at IS NULL";
pub(super) const INTERRUPT_JOBS: &str = "UPDATE jobs SET state = $1, ended_at = $2 WHERE ended_at IS NULL";
pub(super) const JOBS_UNDER_WAY: &str =
    concat!("SELECT ", job_columns!(), " FROM jobs WHERE ended_at IS NULL ORDER BY sequence");
pub(super) const JOB: &str = concat!("SELECT ", job_columns!(), " FROM jobs WHERE id = $1");
pub(super) const JOB_OF_REQUEST: &str = concat!("SELECT ", job_columns!(), " FROM jobs WHERE request_id = $1");
pub(super) const JOB_OF_PLAN: &str = concat!("SELECT ", job_columns!(), " FROM jobs WHERE plan_id = $1");
pub(super) const JOBS: List = List { select: concat!("SELECT sequence, ", job_columns!(), " FROM jobs") };

pub(super) const RAISE_FENCE: &str = "INSERT INTO fences (id, fence) VALUES (1, $1) \
    ON CONFLICT (id) DO UPDATE SET fence = excluded.fence WHERE excluded.fence > fences.fence";
pub(super) const FENCE: &str = "SELECT fence FROM fences WHERE id = 1";

pub(super) const NEWEST_SCAN: &str = "SELECT id FROM scans ORDER BY sequence DESC LIMIT 1";

pub(super) const COMMITS: &str = "SELECT count, chain, previous FROM commits WHERE id = 1";
pub(super) const COUNT_COMMIT: &str = "UPDATE commits SET count = $1, chain = $2, previous = $3 WHERE id = 1";

pub(super) const PROBE: &str = "INSERT INTO probes (id, writes_count) VALUES (1, 1) \
    ON CONFLICT (id) DO UPDATE SET writes_count = probes.writes_count + 1";
pub(super) const COUNTS: &str = "SELECT (SELECT COUNT(*) FROM scans) AS scans_count, \
    (SELECT COUNT(*) FROM measurements) AS measurements_count, (SELECT COUNT(*) FROM recipes) AS recipes_count";

pub(super) const CREATE_MIGRATIONS: &str = "CREATE TABLE IF NOT EXISTS migrations \
    (version BIGINT NOT NULL PRIMARY KEY, checksum TEXT NOT NULL)";
pub(super) const INSERT_MIGRATION: &str = "INSERT INTO migrations (version, checksum) VALUES ($1, $2)";
pub(super) const MIGRATIONS: &str = "SELECT version, checksum FROM migrations ORDER BY version";

/// A list of rows in the order of their commits, newest first.
pub(super) struct List {
    select: &'static str,
}

impl List {
    /// The statement for one page. $1 is the number of rows, followed by a value for each column that must be equal and by the
    /// cursor. An index on (column, sequence) serves it without sorting.
    pub(super) fn page(&self, equal: &[&'static str], behind_cursor: bool) -> String {
        let mut conditions: Vec<String> =
            equal.iter().zip(2..).map(|(column, number)| format!("{column} = ${number}")).collect();
        if behind_cursor {
            conditions.push(format!("sequence < ${}", equal.len() + 2));
        }
        let filter = if conditions.is_empty() { String::new() } else { format!(" WHERE {}", conditions.join(" AND ")) };
        format!("{}{filter} ORDER BY sequence DESC LIMIT $1", self.select)
    }
}
