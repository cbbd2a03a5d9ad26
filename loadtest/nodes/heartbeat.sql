\set node random(1, :nodes)
INSERT INTO nodes (node, name, address, leaving, lapses, lease_until_ms, sessions, most_sessions, memory_used, memory_total, work)
VALUES ('node' || :node, 'n' || :node, 'http://10.0.0.1:7411', 0, 1, CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT) + 4000, 10, 64, 1, 2, 3)
ON CONFLICT (node) DO UPDATE SET leaving = excluded.leaving,
lapses = nodes.lapses + CASE WHEN nodes.lease_until_ms < CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT) THEN 1 ELSE 0 END,
lease_until_ms = CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT) + 4000, sessions = excluded.sessions, most_sessions = excluded.most_sessions,
memory_used = excluded.memory_used, memory_total = excluded.memory_total, work = excluded.work
RETURNING lapses;
