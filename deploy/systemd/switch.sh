#!/usr/bin/env bash
# Start the processes that the settings switch on, and end those that they switch off, now and from each start on.
# The settings are written by an unprivileged process: another one reads them, and only names of our own list count.
# `switch.sh enable` starts none, but notes them for the next start; it ends those that are switched off.
set -euo pipefail
cd "$(dirname "$0")/../.."

SETTINGS=/var/lib/obu-private/settings
of_file='from shared.processes import *; from shared.runtime.config import load_vehicle; v = load_vehicle()
print(*(name for name in switchable(v.role) if name in v.processes))'
all='from shared.processes import *; print(*(row.name for row in PROCESSES if row.kind is not Kind.STANDING))'

follow() { # --now, or nothing
    wanted=" $(setpriv --reuid obu --regid obu --clear-groups --no-new-privs .venv/bin/python -c "$of_file") "
    on=() off=()
    names=$(.venv/bin/python -c "$all") # a failure here ends the script, one within `for` would not
    for name in $names; do
        case $wanted in *" $name "*) runs=1 ;; *) runs= ;; esac
        if systemctl is-enabled --quiet "obu@$name.service" 2>/dev/null; then is=1; else is=; fi
        [ "$runs" = "$is" ] || if [ -n "$runs" ]; then on+=("obu@$name.service"); else off+=("obu@$name.service"); fi
    done
    [ ${#off[@]} = 0 ] || systemctl disable --quiet --now "${off[@]}"
    [ ${#on[@]} != 0 ] || return 0
    # The broker knows a process by its secret, which is made here.
    if [ -n "$1" ]; then
        .venv/bin/python -m cli keys make --broker-files /etc/obu/broker --broker-user mosquitto --group obu >/dev/null
        systemctl reload obu-broker.service
    fi
    systemctl enable --quiet "${on[@]}"
    [ -z "$1" ] || systemctl start --no-block "${on[@]}" # one that cannot start would hold this up without end
}

now=--now
[ "${1:-}" != enable ] || now=
while :; do # what is written meanwhile starts no second run
    before=$(stat -c %z "$SETTINGS" 2>/dev/null || true)
    follow "$now"
    [ "$before" != "$(stat -c %z "$SETTINGS" 2>/dev/null || true)" ] || break
done
