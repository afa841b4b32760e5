-- Every list is ordered by the order in which its rows were committed, so that a clock that is set back changes no order.
-- The count of commits, of which the file coaxis.commits holds a copy. The latest arrival of each scan, in service's words.

ALTER TABLE scans ADD COLUMN sequence BIGINT;
ALTER TABLE scans ADD COLUMN arrival TEXT;
UPDATE scans SET sequence = numbered.number FROM
    (SELECT id, ROW_NUMBER() OVER (ORDER BY created_at, id) AS number FROM scans) AS numbered WHERE numbered.id = scans.id;
DROP INDEX scans_newest;
CREATE UNIQUE INDEX scans_newest ON scans (sequence);

ALTER TABLE measurements ADD COLUMN sequence BIGINT;
UPDATE measurements SET sequence = numbered.number FROM
    (SELECT id, ROW_NUMBER() OVER (ORDER BY created_at, id) AS number FROM measurements) AS numbered
    WHERE numbered.id = measurements.id;
DROP INDEX measurements_newest;
DROP INDEX measurements_of_scan;
DROP INDEX measurements_of_verdict;
DROP INDEX measurements_of_recipe;
CREATE UNIQUE INDEX measurements_newest ON measurements (sequence);
CREATE INDEX measurements_of_scan ON measurements (scan_id, sequence);
CREATE INDEX measurements_of_verdict ON measurements (verdict, sequence);
CREATE INDEX measurements_of_recipe ON measurements (recipe, sequence);

ALTER TABLE recipes ADD COLUMN sequence BIGINT;
UPDATE recipes SET sequence = numbered.number FROM
    (SELECT name, ROW_NUMBER() OVER (ORDER BY created_at, name) AS number FROM recipes) AS numbered
    WHERE numbered.name = recipes.name;
DROP INDEX recipes_newest;
CREATE UNIQUE INDEX recipes_newest ON recipes (sequence);

ALTER TABLE plans ADD COLUMN sequence BIGINT;
UPDATE plans SET sequence = numbered.number FROM
    (SELECT id, ROW_NUMBER() OVER (ORDER BY created_at, id) AS number FROM plans) AS numbered WHERE numbered.id = plans.id;
DROP INDEX plans_newest;
CREATE UNIQUE INDEX plans_newest ON plans (sequence);

ALTER TABLE jobs ADD COLUMN sequence BIGINT;
UPDATE jobs SET sequence = numbered.number FROM
    (SELECT id, ROW_NUMBER() OVER (ORDER BY created_at, id) AS number FROM jobs) AS numbered WHERE numbered.id = jobs.id;
DROP INDEX jobs_newest;
DROP INDEX jobs_under_way;
CREATE UNIQUE INDEX jobs_newest ON jobs (sequence);
CREATE INDEX jobs_of_kind ON jobs (kind, sequence);
CREATE INDEX jobs_under_way ON jobs (ended_at, sequence);

-- One row. The chain tells two databases apart that have the same number of commits.
CREATE TABLE commits (
    id       BIGINT NOT NULL PRIMARY KEY,
    count    BIGINT NOT NULL,
    chain    TEXT   NOT NULL,
    previous TEXT   NOT NULL
);
INSERT INTO commits (id, count, chain, previous) VALUES (1, 0, '', '');
