-- What the cell was told: plans, and jobs (moves, scans, acts) with the request that asked for each, written before the
-- first byte goes to a device. A job without an end was under way; where the process died, the next start ends it.

CREATE TABLE plans (
    id          TEXT   NOT NULL PRIMARY KEY,
    created_at  BIGINT NOT NULL,
    request_id  TEXT   UNIQUE,
    fingerprint TEXT,
    document    TEXT   NOT NULL
);

CREATE INDEX plans_newest ON plans (created_at, id);

-- plan_id and request_id are let go where the cell refused the start, so that both may be tried again.
CREATE TABLE jobs (
    id          TEXT   NOT NULL PRIMARY KEY,
    kind        TEXT   NOT NULL,
    created_at  BIGINT NOT NULL,
    state       TEXT   NOT NULL,
    ended_at    BIGINT,
    plan_id     TEXT   UNIQUE REFERENCES plans (id),
    request_id  TEXT   UNIQUE,
    fingerprint TEXT,
    document    TEXT   NOT NULL
);

CREATE INDEX jobs_newest ON jobs (kind, created_at, id);
CREATE INDEX jobs_under_way ON jobs (ended_at, created_at);

-- One row: the newest fence that a lease was given.
CREATE TABLE fences (
    id    BIGINT NOT NULL PRIMARY KEY,
    fence BIGINT NOT NULL
);
