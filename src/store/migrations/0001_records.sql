-- Scans, measurements with their diagnostics, the requests that made them, recipes.
-- Times are microseconds since 1970-01-01T00:00:00Z. Every list is read newest first by (created_at, id).

CREATE TABLE scans (
    id           TEXT   NOT NULL PRIMARY KEY,
    created_at   BIGINT NOT NULL,
    bytes_count  BIGINT NOT NULL,
    format       TEXT   NOT NULL,
    points_count BIGINT,
    description  TEXT
);

CREATE INDEX scans_newest ON scans (created_at, id);

CREATE TABLE measurements (
    id         TEXT   NOT NULL PRIMARY KEY,
    created_at BIGINT NOT NULL,
    verdict    TEXT   NOT NULL,
    method     TEXT   NOT NULL,
    scan_id    TEXT   NOT NULL REFERENCES scans (id),
    recipe     TEXT,
    document   TEXT   NOT NULL
);

CREATE INDEX measurements_newest ON measurements (created_at, id);
CREATE INDEX measurements_of_scan ON measurements (scan_id, created_at, id);
CREATE INDEX measurements_of_verdict ON measurements (verdict, created_at, id);
CREATE INDEX measurements_of_recipe ON measurements (recipe, created_at, id);

-- Apart from the measurements, because they are large and rarely asked for.
CREATE TABLE profiles (
    measurement_id TEXT NOT NULL PRIMARY KEY REFERENCES measurements (id),
    content        BLOB NOT NULL
);

CREATE TABLE requests (
    id             TEXT NOT NULL PRIMARY KEY,
    fingerprint    TEXT NOT NULL,
    measurement_id TEXT NOT NULL REFERENCES measurements (id)
);

CREATE TABLE recipes (
    name       TEXT   NOT NULL PRIMARY KEY,
    revision   BIGINT NOT NULL,
    document   TEXT   NOT NULL,
    created_at BIGINT NOT NULL,
    updated_at BIGINT NOT NULL
);

CREATE INDEX recipes_newest ON recipes (created_at, name);

-- One row that the readiness probe counts up, to see that a write comes to rest.
CREATE TABLE probes (
    id           BIGINT NOT NULL PRIMARY KEY,
    writes_count BIGINT NOT NULL
);
