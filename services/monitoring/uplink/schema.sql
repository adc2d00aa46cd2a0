-- The chain that grows now: one row.
CREATE TABLE IF NOT EXISTS chain (
    one INTEGER PRIMARY KEY CHECK (one = 1), vehicle TEXT NOT NULL, epoch_ms INTEGER NOT NULL, next INTEGER NOT NULL,
    previous BLOB NOT NULL
);
-- Reports (kind 0), events (1) and numbers of lost reports (2) that are in no batch yet.
CREATE TABLE IF NOT EXISTS pending (
    id INTEGER PRIMARY KEY, kind INTEGER NOT NULL, content TEXT NOT NULL
);
-- Signed batches without a receipt.
CREATE TABLE IF NOT EXISTS batch (
    id INTEGER PRIMARY KEY AUTOINCREMENT, kind INTEGER NOT NULL, refused_ns INTEGER, reason TEXT, -- OBU time line
    epoch_ms INTEGER NOT NULL, first INTEGER NOT NULL, count INTEGER NOT NULL, from_ms INTEGER NOT NULL,
    digest BLOB NOT NULL, content BLOB NOT NULL, UNIQUE (epoch_ms, first)
);
-- In the order of their making within each.
CREATE INDEX IF NOT EXISTS batch_kind ON batch (kind, refused_ns);
CREATE INDEX IF NOT EXISTS batch_digest ON batch (digest); -- a refusal names nothing else
CREATE INDEX IF NOT EXISTS batch_refused ON batch (refused_ns);
