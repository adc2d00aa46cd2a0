"""What enrolment, renewal and revocation of a vehicle share, by command and by page: a lock, and what is revoked."""

# Held to the end of the transaction: no key is certified while the vehicle's keys are being revoked.
LOCK_VEHICLE = "SELECT pg_advisory_xact_lock(2401, hashtext(%(vehicle)s))"
# With `key` one of the vehicle's keys, else all.
REVOKE = """
UPDATE certificate SET revoked = now(), reason = %(reason)s
WHERE vehicle = %(vehicle)s AND revoked IS NULL AND (%(key)s::text IS NULL OR key_id = %(key)s)
RETURNING key_id, tenant_id
"""
# With all keys of a vehicle, the tokens made for its name.
END_TOKENS = """
UPDATE enrolment SET expires = now()
WHERE vehicle = %(vehicle)s AND %(key)s::text IS NULL AND used IS NULL AND expires > now()
RETURNING tenant_id, vehicle
"""
END_TOKEN = """
UPDATE enrolment SET expires = now()
WHERE token_id = %(token)s AND used IS NULL AND expires > now() RETURNING tenant_id, vehicle
"""
