-- First schema of a centre. Times: timestamptz where the centre says them, milliseconds of UTC where a vehicle does.
CREATE EXTENSION IF NOT EXISTS postgis;

CREATE TABLE tenant (
    tenant_id integer GENERATED ALWAYS AS IDENTITY PRIMARY KEY, name text NOT NULL UNIQUE,
    retention_days integer NOT NULL DEFAULT 90 CHECK (retention_days BETWEEN 1 AND 3650), web_hook text,
    web_hook_secret text, -- of the signatures of what it is sent
    -- charges of toll plazas, apart from positions and other events
    toll_retention_days integer NOT NULL DEFAULT 1095 CHECK (toll_retention_days BETWEEN 1 AND 7300)
);
CREATE TABLE vehicle (
    vehicle text PRIMARY KEY CHECK (vehicle ~ '^[A-Za-z0-9_-]{1,48}$'), tenant_id integer NOT NULL REFERENCES tenant,
    created timestamptz NOT NULL DEFAULT now(), erased timestamptz, note text NOT NULL DEFAULT ''
);
-- Public keys: kind 'tls' (certified, its serial) or 'evidence' (registered; old ones stay for verification).
CREATE TABLE certificate (
    key_id text PRIMARY KEY, vehicle text NOT NULL REFERENCES vehicle, tenant_id integer NOT NULL REFERENCES tenant,
    kind text NOT NULL CHECK (kind IN ('tls', 'evidence')), public_key bytea NOT NULL, serial text,
    registered timestamptz NOT NULL DEFAULT now(), not_before timestamptz NOT NULL, not_after timestamptz,
    revoked timestamptz, reason text
);
CREATE INDEX certificate_vehicle ON certificate (vehicle, kind);
CREATE INDEX certificate_revoked ON certificate (revoked) WHERE revoked IS NOT NULL;
CREATE TABLE enrolment (
    token_hash bytea PRIMARY KEY, tenant_id integer NOT NULL REFERENCES tenant, vehicle text, -- NULL: as the unit is named
    made timestamptz NOT NULL DEFAULT now(), made_by text NOT NULL, expires timestamptz NOT NULL,
    used timestamptz, used_by text,
    token_id text NOT NULL GENERATED ALWAYS AS (left(encode(token_hash, 'hex'), 16)) STORED -- to speak of it
);
-- One row a batch of positions or events: day of the first signed stamp; content is the whole signed batch.
CREATE TABLE segment (
    day date NOT NULL, vehicle text NOT NULL, epoch bigint NOT NULL, first_sequence bigint NOT NULL,
    count integer NOT NULL, kind smallint NOT NULL, from_ms bigint NOT NULL, to_ms bigint NOT NULL,
    verdict smallint, -- worst of the batch; NULL: it holds events
    tenant_id integer NOT NULL, digest bytea NOT NULL, content bytea NOT NULL, arrived timestamptz NOT NULL DEFAULT now(),
    PRIMARY KEY (day, vehicle, epoch, first_sequence)
) PARTITION BY RANGE (day);
CREATE INDEX segment_vehicle ON segment (vehicle, from_ms);
CREATE INDEX segment_unsafe ON segment (arrived) WHERE verdict = 5; -- what alarms look for
CREATE TABLE gap (
    vehicle text NOT NULL, epoch bigint NOT NULL, first_sequence bigint NOT NULL, count bigint NOT NULL,
    tenant_id integer NOT NULL, from_ms bigint NOT NULL, to_ms bigint NOT NULL, content bytea NOT NULL,
    told bigint NOT NULL DEFAULT 0, -- how many of its reports an alarm has counted
    arrived timestamptz NOT NULL DEFAULT now(), PRIMARY KEY (vehicle, epoch, first_sequence)
);
CREATE INDEX gap_untold ON gap (vehicle) WHERE told < count AND content <> ''; -- empty: it is erased
-- What an erasure leaves of a vehicle's batches, and of those of before it that come later.
CREATE TABLE erased_batch (
    vehicle text NOT NULL, epoch bigint NOT NULL, first_sequence bigint NOT NULL, count integer NOT NULL,
    tenant_id integer NOT NULL, digest bytea NOT NULL, PRIMARY KEY (vehicle, epoch, first_sequence)
);
-- What is accounted for of each outbox: numbers received and lost, and the one after the highest.
CREATE TABLE epoch (
    vehicle text NOT NULL, epoch bigint NOT NULL, tenant_id integer NOT NULL, received bigint NOT NULL DEFAULT 0,
    lost bigint NOT NULL DEFAULT 0, highest bigint NOT NULL DEFAULT 0, PRIMARY KEY (vehicle, epoch),
    CHECK (received <= 9007199254740992 AND lost <= 9007199254740992) -- all numbers that there are: sums stay in range
);
CREATE TABLE set_aside (
    digest bytea PRIMARY KEY, vehicle text NOT NULL, tenant_id integer NOT NULL, reason text NOT NULL,
    content bytea NOT NULL, arrived timestamptz NOT NULL DEFAULT now()
);
-- The newest report of each vehicle: by its number within an epoch, else by its stamp, since an epoch may have begun by a
-- clock that was years ahead.
CREATE TABLE vehicle_now (
    vehicle text PRIMARY KEY, tenant_id integer NOT NULL, epoch bigint NOT NULL, sequence bigint NOT NULL,
    utc_ms bigint NOT NULL, arrived timestamptz NOT NULL DEFAULT now(),
    position_ms bigint, -- of the last position, which stays where later reports have none; NULL: there was none
    latitude_deg double precision, longitude_deg double precision,
    height_m real, north_m_s real, east_m_s real, level_m real, verdict smallint NOT NULL,
    verdict_since_ms bigint NOT NULL,
    -- The place on the map as two numbers of Web Mercator [m]: a tile compares them in half the time of a geometry, and
    -- a row that changes every ten seconds has no index of places to keep.
    x_m double precision GENERATED ALWAYS AS (longitude_deg * 111319.49079327358) STORED,
    y_m double precision GENERATED ALWAYS AS (
        CASE WHEN abs(latitude_deg) < 85.06 THEN 6378137 * ln(tan(radians(45 + latitude_deg / 2))) END
    ) STORED
);
CREATE INDEX vehicle_now_tenant ON vehicle_now (tenant_id);
CREATE TABLE event (
    vehicle text NOT NULL, epoch bigint NOT NULL, sequence bigint NOT NULL, tenant_id integer NOT NULL,
    utc_ms bigint NOT NULL, name text NOT NULL, content jsonb NOT NULL, arrived timestamptz NOT NULL DEFAULT now(),
    PRIMARY KEY (vehicle, epoch, sequence)
);
CREATE INDEX event_time ON event (tenant_id, utc_ms DESC);
CREATE TABLE alarm (
    alarm_id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY, tenant_id integer NOT NULL, vehicle text NOT NULL,
    kind text NOT NULL CHECK (kind IN ('unsafe', 'gap', 'silent', 'signature')),
    since_ms bigint NOT NULL, until_ms bigint, raised timestamptz NOT NULL DEFAULT now(),
    late boolean NOT NULL DEFAULT false, -- raised by data that came long after their stamps
    detail jsonb NOT NULL DEFAULT '{}', acknowledged timestamptz, acknowledged_by text,
    ended timestamptz, hooked timestamptz, hooked_end timestamptz -- when it ended here, and when the web hook took it and its end
);
CREATE UNIQUE INDEX alarm_open ON alarm (vehicle, kind) WHERE until_ms IS NULL;
CREATE INDEX alarm_vehicle ON alarm (vehicle, kind);
CREATE INDEX alarm_tenant ON alarm (tenant_id, raised DESC);
CREATE TABLE account (
    account_id integer GENERATED ALWAYS AS IDENTITY PRIMARY KEY, tenant_id integer NOT NULL REFERENCES tenant,
    name text NOT NULL UNIQUE, password text NOT NULL, -- scrypt
    role text NOT NULL CHECK (role IN ('viewer', 'operator', 'toll', 'admin')), created timestamptz NOT NULL DEFAULT now(),
    disabled timestamptz
);
CREATE TABLE session (
    token_hash bytea PRIMARY KEY, account_id integer NOT NULL REFERENCES account ON DELETE CASCADE,
    csrf text NOT NULL, expires timestamptz NOT NULL
);
CREATE TABLE audit (
    at timestamptz NOT NULL DEFAULT now(), tenant_id integer, who text NOT NULL, action text NOT NULL,
    vehicle text, detail jsonb NOT NULL DEFAULT '{}'
);
CREATE INDEX audit_tenant ON audit (tenant_id, at DESC);

-- Roles without a password of their own: members log in (fleet/database/roles.py). The page sees its tenant alone.
DO $$ BEGIN
    IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = 'fleet_ingest') THEN CREATE ROLE fleet_ingest NOLOGIN; END IF;
    IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = 'fleet_admission') THEN CREATE ROLE fleet_admission NOLOGIN; END IF;
    IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = 'fleet_alarms') THEN CREATE ROLE fleet_alarms NOLOGIN; END IF;
    IF NOT EXISTS (SELECT FROM pg_roles WHERE rolname = 'fleet_web') THEN CREATE ROLE fleet_web NOLOGIN; END IF;
END $$;

-- The pages see one tenant: that of the setting fleet.tenant, which each transaction states. Other processes see all.
CREATE FUNCTION web_tenant() RETURNS integer LANGUAGE sql STABLE
AS $$ SELECT nullif(current_setting('fleet.tenant', true), '')::integer $$;

DO $$
DECLARE name text;
BEGIN
    FOREACH name IN ARRAY ARRAY['tenant', 'vehicle', 'certificate', 'enrolment', 'segment', 'gap', 'epoch', 'set_aside',
        'erased_batch', 'vehicle_now', 'event', 'alarm', 'account', 'audit'] LOOP
        EXECUTE format('ALTER TABLE %I ENABLE ROW LEVEL SECURITY', name);
        EXECUTE format('CREATE POLICY of_tenant ON %I TO fleet_web USING (tenant_id = (SELECT web_tenant())) '
            'WITH CHECK (tenant_id = (SELECT web_tenant()))', name);
        EXECUTE format('CREATE POLICY of_all ON %I TO fleet_ingest, fleet_admission, fleet_alarms '
            'USING (true) WITH CHECK (true)', name);
    END LOOP;
END $$;
ALTER TABLE session ENABLE ROW LEVEL SECURITY;
CREATE POLICY of_tenant ON session TO fleet_web USING (account_id IN (SELECT account_id FROM account))
    WITH CHECK (account_id IN (SELECT account_id FROM account));

-- Each process logs in as itself, and may do what it needs.
GRANT SELECT ON tenant, vehicle, certificate, segment, gap, epoch, set_aside, vehicle_now, event, alarm, session, audit
    TO fleet_web;
GRANT SELECT (token_id, tenant_id, vehicle, made, made_by, expires, used, used_by) ON enrolment TO fleet_web;
GRANT UPDATE (expires) ON enrolment TO fleet_web; -- of a vehicle that is revoked, or a token that is withdrawn
GRANT SELECT (account_id, tenant_id, name, role, created, disabled) ON account TO fleet_web;
GRANT INSERT ON enrolment, account, session, audit TO fleet_web;
GRANT UPDATE (role, password, disabled) ON account TO fleet_web;
GRANT UPDATE (acknowledged, acknowledged_by) ON alarm TO fleet_web;
GRANT UPDATE (web_hook, web_hook_secret) ON tenant TO fleet_web;
GRANT UPDATE (revoked, reason) ON certificate TO fleet_web;
GRANT DELETE ON session TO fleet_web;

GRANT SELECT ON vehicle, certificate TO fleet_ingest;
GRANT SELECT, INSERT ON segment, event, set_aside, erased_batch TO fleet_ingest;
GRANT SELECT, INSERT, UPDATE ON gap, epoch, vehicle_now, alarm TO fleet_ingest;
GRANT DELETE ON gap TO fleet_ingest; -- of gaps that a larger one stands for

GRANT SELECT ON tenant TO fleet_admission;
GRANT SELECT, INSERT ON vehicle, certificate TO fleet_admission;
GRANT SELECT, UPDATE (used, used_by) ON enrolment TO fleet_admission;
GRANT INSERT ON audit TO fleet_admission;

GRANT SELECT ON tenant, vehicle, vehicle_now, epoch, gap TO fleet_alarms;
GRANT SELECT (day, vehicle, epoch, first_sequence, kind, from_ms, to_ms, verdict, tenant_id, arrived) ON segment
    TO fleet_alarms; -- and not the content, which says where a vehicle was
GRANT UPDATE (told) ON gap TO fleet_alarms;
GRANT SELECT, INSERT, UPDATE ON alarm TO fleet_alarms;

-- Temporary tables for those alone that work with them: one must not stand in for a table of the functions below.
DO $$ BEGIN
    EXECUTE format('REVOKE TEMPORARY ON DATABASE %I FROM PUBLIC', current_database());
    EXECUTE format('GRANT TEMPORARY ON DATABASE %I TO fleet_ingest, fleet_alarms', current_database());
END $$;

-- Makes the partition of a day; for processes that may not make tables themselves. A table of the day that is no
-- partition is what a removal has left that was interrupted: nothing is lost with it.
CREATE FUNCTION ensure_segment_day(wanted date) RETURNS void LANGUAGE plpgsql SECURITY DEFINER
SET search_path = public, pg_temp AS $$
DECLARE name text := 'segment_' || to_char(wanted, 'YYYYMMDD');
BEGIN
    IF wanted NOT BETWEEN DATE '2020-01-01' AND DATE '2100-01-01' THEN RAISE 'no possible day: %', wanted; END IF;
    PERFORM pg_advisory_xact_lock(34);
    IF to_regclass('public.' || name) IS NOT NULL THEN
        IF EXISTS (SELECT FROM pg_inherits WHERE inhrelid = to_regclass('public.' || name)) THEN RETURN; END IF;
        EXECUTE format('DROP TABLE public.%I', name);
    END IF;
    EXECUTE format('CREATE TABLE public.%I PARTITION OF public.segment FOR VALUES FROM (%L) TO (%L)',
        name, wanted, wanted + 1);
END $$;

-- Who logs in is of no tenant yet: functions that give one row to who knows the name, or the cookie.
CREATE FUNCTION login_account(wanted text)
RETURNS TABLE (account_id integer, tenant_id integer, name text, password text, role text)
LANGUAGE sql STABLE SECURITY DEFINER SET search_path = public, pg_temp
AS $$ SELECT account_id, tenant_id, name, password, role FROM account WHERE name = wanted AND disabled IS NULL $$;

CREATE FUNCTION login_session(wanted bytea)
RETURNS TABLE (account_id integer, tenant_id integer, tenant text, name text, role text, csrf text)
LANGUAGE sql STABLE SECURITY DEFINER SET search_path = public, pg_temp
AS $$
    SELECT account.account_id, account.tenant_id, tenant.name, account.name, account.role, session.csrf
    FROM session JOIN account USING (account_id) JOIN tenant USING (tenant_id)
    WHERE token_hash = wanted AND expires > now() AND disabled IS NULL
$$;
REVOKE EXECUTE ON FUNCTION ensure_segment_day(date), login_account(text), login_session(bytea) FROM PUBLIC;
GRANT EXECUTE ON FUNCTION ensure_segment_day(date) TO fleet_ingest;
GRANT EXECUTE ON FUNCTION login_account(text), login_session(bytea) TO fleet_web;
