\set session random(1, :sessions)
\set me random(1, :nodes)
SELECT owner, generation, COALESCE(address, ''), COALESCE(name, ''), COALESCE(leaving, 0), COALESCE(lease_until_ms, 0) > CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT) FROM sessions LEFT JOIN nodes ON node = owner WHERE id = 's' || :session AND tenant = 't';
BEGIN;
SELECT lease_until_ms > CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT) FROM nodes WHERE node = 'dead' FOR SHARE;
UPDATE sessions SET owner = 'node' || :me, generation = generation + 1 WHERE id = 's' || :session RETURNING generation;
COMMIT;
