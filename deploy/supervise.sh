#!/bin/sh
# Runs a process of the unit in a container, and kills it when it hangs, so that the container ends and is restarted:
# supervise.sh COMMAND... . Docker itself restarts no container that is unhealthy. A shell is enough, and takes little
# memory. The process touches $OBU_ALIVE.loop at each turn of its loop, twice a second, also while there is no broker;
# one that still can ends itself after 12 s, and tells where it hung. Commands that touch nothing are left alone, but for
# `run`, whose first turn must come within 90 s.
set -u
beats=${OBU_ALIVE:-/tmp/alive}.loop
rm -f "$beats"

"$@" <&0 &
child=$!
trap 'kill -TERM "$child"' TERM
trap 'kill -INT "$child"' INT

# Compares times of change with each other only: the clock may be set at any time.
watch() {
    before= silent_s=0
    while sleep 2; do
        now=$(stat -c %y "$beats" 2>/dev/null)
        silent_s=$((silent_s + 2))
        [ "$now" = "$before" ] || silent_s=0
        before=$now
        limit_s=14
        [ -n "$now" ] || limit_s=90
        [ "$silent_s" -ge "$limit_s" ] || continue
        echo "$* hangs: no turn of its loop for $silent_s s; it is killed" >&2
        kill -KILL "$child"
        return
    done
}
watch=
case " $* " in *" run "*) watch "$@" & watch=$! ;; esac

# Waits before it looks: a command that has ended already is gone for `kill -0`, and its code is still to be had.
while
    wait "$child"
    code=$?
    kill -0 "$child" 2>/dev/null # A signal ended the wait.
do :; done
[ -z "$watch" ] || kill "$watch" 2>/dev/null
exit "$code"
