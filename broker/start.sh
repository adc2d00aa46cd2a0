#!/bin/sh
# Starts Mosquitto: start.sh PROGRAM CONFIGURATION. Mosquitto ends at once where it cannot read its store, as after a power
# cut, and would never start again. Such a store is set aside, which is said, and the broker starts without it: retained
# messages are published again by those who know them. Mosquitto itself tells whether it can, before it starts: with a
# configuration that ends it (a password file that there is not) as soon as it has read the store, and which changes nothing.
set -u
store=$(sed -n 's/^persistence_location *//p' "$2" | tail -n 1)
store=${store%/}
file=$store/mosquitto.db

cannot_read() {
    said=$({
        sed -n '/^user /p' "$2"
        printf '%s\n' "persistence true" "persistence_location $store/" "log_dest stderr" \
            "listener 0 /nonexistent/socket" "password_file /nonexistent/passwords"
    } | timeout 10 "$1" -c /dev/stdin 2>&1)
    case $? in 134 | 135 | 139) return 0 ;; esac # It ends with a fault, as it would when started.
    case $said in *"Couldn't open database"*) return 0 ;; *) return 1 ;; esac
}
if [ -s "$file" ] && cannot_read "$@"; then
    mv -f "$file" "$file.unreadable" &&
        echo "the store of the broker cannot be read: set aside as $file.unreadable, starting without it" >&2
fi

# A broker that hangs answers no ping. Where a service manager listens (NOTIFY_SOCKET), it is told of each answer, and
# restarts the broker when there is none. In a container (OBU_BROKER_WATCH=1) nobody does: this script stays, and ends
# the broker, so that the container is restarted.
rules=$(sed -n 's/^password_file *//p' "$2" | tail -n 1)
secret_file=$(dirname "${rules:-/dev}")/broker.watch # of the user that asks
[ -r "$secret_file" ] || secret_file=/dev/null
port=$(sed -n 's/^listener *\([1-9][0-9]*\).*/\1/p' "$2" | head -n 1)
socket=$(sed -n 's/^listener *0 *//p' "$2" | head -n 1)
if [ -n "${NOTIFY_SOCKET:-}" ] && command -v python3 >/dev/null; then
    # It ends with the broker at once where util-linux is, else at its next question.
    $(command -v setpriv >/dev/null && echo setpriv --pdeathsig KILL) \
        python3 -I -S "$(dirname "$0")/probe.py" "${socket:-$port}" "$secret_file" &
fi
[ "${OBU_BROKER_WATCH:-}" = 1 ] || exec "$1" -c "$2"

# One connection stays open, and is asked every 3 s; a refusal is an answer as well. It is the user `broker.watch`, with a
# secret of at most 80 characters.
field() { printf "\\000\\$(printf '%03o' ${#1})%s" "$1"; }
ask() {
    secret=$(cat "$secret_file")
    flags='\002' size=24
    [ -z "$secret" ] || flags='\302' size=$((40 + ${#secret}))
    printf "\\020\\$(printf '%03o' $size)\\000\\004MQTT\\004$flags\\000\\074"
    field broker.watch
    [ -z "$secret" ] || { field broker.watch; field "$secret"; }
    while sleep 3; do printf '\300\000'; done
}
uptime_s() { cut -d. -f1 /proc/uptime; }
# Ends with the connection, or with the broker, which it kills when no answer comes for 12 s.
listen() {
    while asked=$(uptime_s); do
        [ "$(timeout 12 dd bs=4 count=1 2>/dev/null | wc -c)" -eq 0 ] || continue
        [ $(($(uptime_s) - asked)) -ge 10 ] || return 0
        echo "the broker hangs: it is killed" >&2
        kill -KILL "$broker"
        return 0
    done
}
"$1" -c "$2" &
broker=$!
trap 'kill -TERM "$broker"' TERM INT
while sleep 3; do ask | nc 127.0.0.1 "$port" | listen; done &
watch=$!
# Waits before it looks: a broker that has ended already is gone for `kill -0`, and its code is still to be had.
while
    wait "$broker"
    code=$?
    kill -0 "$broker" 2>/dev/null # A signal ended the wait.
do :; done
kill "$watch" 2>/dev/null
exit "$code"
