-- The ledger. Times are nanoseconds on the time line of the unit; JSON columns hold messages of shared/messages/toll.py.
-- What is in progress (registration, passage, held) has a seal: a signed statement on its content, so that what is
-- changed in the file while a vehicle approaches is recognised. NULL: without a key.
CREATE TABLE IF NOT EXISTS registration (
    identity TEXT NOT NULL, contract TEXT NOT NULL, tariff_class TEXT NOT NULL, valid_until_ns INTEGER NOT NULL,
    content TEXT NOT NULL, seal TEXT, PRIMARY KEY (identity, contract, tariff_class)
);
-- Passages of registered vehicles that are in progress: their newest statement, that of the crossing, and the
-- registrations as they were signed.
CREATE TABLE IF NOT EXISTS passage (
    passage_id TEXT PRIMARY KEY, sampled_ns INTEGER NOT NULL, statement TEXT NOT NULL, crossed TEXT,
    registrations TEXT NOT NULL DEFAULT '[]', seal TEXT
);
-- Passages whose final state is stored, so that a repeated statement changes nothing.
CREATE TABLE IF NOT EXISTS settled (passage_id TEXT PRIMARY KEY, final_ns INTEGER NOT NULL, summary TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS booking (
    transaction_id TEXT PRIMARY KEY, passage_id TEXT NOT NULL, kind TEXT NOT NULL, booked_ns INTEGER NOT NULL,
    amount_cents INTEGER NOT NULL, content TEXT NOT NULL, UNIQUE (passage_id, kind)
);
CREATE TABLE IF NOT EXISTS outbox (transaction_id TEXT PRIMARY KEY REFERENCES booking);
CREATE TABLE IF NOT EXISTS receipt (
    transaction_id TEXT PRIMARY KEY REFERENCES booking, received_ns INTEGER NOT NULL, content TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS evidence (
    passage_id TEXT PRIMARY KEY, digest TEXT NOT NULL, stored_ns INTEGER NOT NULL, pack BLOB NOT NULL,
    seal TEXT  -- signed statement on the digest; NULL: of version 2, or without a key
);
-- Bookings in their order, each with the hash of the one before; and signed statements on the newest of them.
CREATE TABLE IF NOT EXISTS entry (
    number INTEGER PRIMARY KEY, transaction_id TEXT NOT NULL UNIQUE REFERENCES booking, link TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS head (name TEXT PRIMARY KEY, statement TEXT NOT NULL);
-- Reconciliation: pulses and crossings that wait for each other, without names, and what came of them by hour.
CREATE TABLE IF NOT EXISTS pulse (
    lane TEXT NOT NULL, since_ns INTEGER NOT NULL, number INTEGER NOT NULL, sampled_ns INTEGER NOT NULL,
    done INTEGER NOT NULL DEFAULT 0,  -- 1: a passage or a payment explains it; 2: none does
    backward INTEGER NOT NULL DEFAULT 0,  -- the vehicle drove backwards, by a detector that states that
    owner TEXT,  -- the passage whose charge it has confirmed; of a pulse backwards: that it has excused
    PRIMARY KEY (lane, since_ns, number)
);
CREATE TABLE IF NOT EXISTS crossing (
    number INTEGER PRIMARY KEY, crossing_ns INTEGER NOT NULL, sd_s REAL NOT NULL, state TEXT NOT NULL,
    lane TEXT, lanes TEXT NOT NULL,
    passage_id TEXT,                      -- NULL: of version 1
    overlaps TEXT NOT NULL DEFAULT '[]',  -- passages in the same place; empty once that is judged
    settled_ns INTEGER NOT NULL DEFAULT 0,
    authenticated INTEGER NOT NULL DEFAULT 0,
    in_review INTEGER NOT NULL DEFAULT 0,  -- of a contract
    modes TEXT NOT NULL DEFAULT '[]'  -- by what is supposed of its receiver's error
);
-- Complete passages that wait for the pulse of a detector: their final statement, and that of the crossing; also those
-- that say they have turned around behind the gate line.
CREATE TABLE IF NOT EXISTS held (
    passage_id TEXT PRIMARY KEY, charged TEXT NOT NULL, crossed TEXT NOT NULL,
    registrations TEXT NOT NULL DEFAULT '[]', seal TEXT
);
-- What names the vehicle of a charged or held passage (station IDs, contract), and from approach to exit when.
CREATE TABLE IF NOT EXISTS chain (
    name TEXT NOT NULL, passage_id TEXT NOT NULL, from_ns INTEGER NOT NULL, to_ns INTEGER NOT NULL,
    crossing_ns INTEGER, sd_s REAL NOT NULL DEFAULT 1.0, lane TEXT, authenticated INTEGER NOT NULL DEFAULT 0,
    PRIMARY KEY (name, passage_id, from_ns)
);
CREATE TABLE IF NOT EXISTS review (
    passage_id TEXT PRIMARY KEY, since_ns INTEGER NOT NULL, content TEXT NOT NULL, sent INTEGER NOT NULL DEFAULT 0
);
CREATE TABLE IF NOT EXISTS balance (
    lane TEXT NOT NULL, hour_ns INTEGER NOT NULL, outcome TEXT NOT NULL, n INTEGER NOT NULL,
    PRIMARY KEY (lane, hour_ns, outcome)
);
-- Hours that are over, each with the hash of the one before.
CREATE TABLE IF NOT EXISTS account (
    number INTEGER PRIMARY KEY, hour_ns INTEGER NOT NULL, lane TEXT NOT NULL, counts TEXT NOT NULL, link TEXT NOT NULL,
    UNIQUE (hour_ns, lane)
);
-- What the operator was paid otherwise in mixed lanes; `done`: it has settled a pulse.
CREATE TABLE IF NOT EXISTS payment (
    payment TEXT PRIMARY KEY, lane TEXT NOT NULL, sampled_ns INTEGER NOT NULL, done INTEGER NOT NULL DEFAULT 0
);
-- Pictures of the lanes' cameras, which have their content: what is ordered of each.
CREATE TABLE IF NOT EXISTS picture (
    picture TEXT PRIMARY KEY, lane TEXT NOT NULL, pulse_ns INTEGER NOT NULL, until_ns INTEGER NOT NULL,
    action TEXT NOT NULL, reason TEXT, sent INTEGER NOT NULL DEFAULT 0  -- 1: published; 2: the camera has answered
);
CREATE TABLE IF NOT EXISTS alarm (since_ns INTEGER NOT NULL, content TEXT NOT NULL, sent INTEGER NOT NULL DEFAULT 0);
-- Each is for a query that is repeated: nothing that is done every second reads a table that grows with the years.
CREATE INDEX IF NOT EXISTS registration_until ON registration (valid_until_ns);
CREATE INDEX IF NOT EXISTS settled_final ON settled (final_ns);
CREATE INDEX IF NOT EXISTS receipt_received ON receipt (received_ns);
CREATE INDEX IF NOT EXISTS evidence_stored ON evidence (stored_ns);
CREATE INDEX IF NOT EXISTS pulse_sampled ON pulse (sampled_ns);
CREATE INDEX IF NOT EXISTS pulse_waiting ON pulse (sampled_ns) WHERE NOT done;
CREATE INDEX IF NOT EXISTS pulse_missed ON pulse (sampled_ns) WHERE done = 2;
CREATE INDEX IF NOT EXISTS chain_to ON chain (to_ns);
CREATE INDEX IF NOT EXISTS review_since ON review (since_ns);
CREATE INDEX IF NOT EXISTS review_waiting ON review (since_ns) WHERE NOT sent;
CREATE INDEX IF NOT EXISTS payment_sampled ON payment (sampled_ns);
CREATE INDEX IF NOT EXISTS picture_until ON picture (until_ns);
CREATE INDEX IF NOT EXISTS picture_waiting ON picture (pulse_ns) WHERE NOT sent;
CREATE INDEX IF NOT EXISTS picture_unanswered ON picture (pulse_ns) WHERE sent = 1;
CREATE INDEX IF NOT EXISTS picture_kept ON picture (action, pulse_ns);
CREATE INDEX IF NOT EXISTS alarm_since ON alarm (since_ns);
CREATE INDEX IF NOT EXISTS balance_hour ON balance (hour_ns);
-- Keyed digests of the CAM of charged passages, as long as their evidence.
CREATE TABLE IF NOT EXISTS replay (
    digest BLOB PRIMARY KEY, passage_id TEXT NOT NULL, stored_ns INTEGER NOT NULL
) WITHOUT ROWID;
