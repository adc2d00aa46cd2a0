#!/bin/sh
# Starts Mosquitto: start.sh PROGRAM CONFIGURATION. Mosquitto ends at once where it cannot read its store, as after a power
# cut, and would never start again. Such a store is set aside, which is said, and the broker starts without it: retained
# messages are published again by those who know them. It is one
#   - that does not begin as every store does (null bytes), or
#   - with which the last start did not come as far as its first save, which is 30 s after it or at a regular stop.
set -u
store=$(sed -n 's/^persistence_location *//p' "$2" | tail -n 1)
store=${store%/}
file=$store/mosquitto.db
tried=$store/mosquitto.tried # the store of the last start

if [ -s "$file" ]; then
    state=$(stat -c '%i %Y %s' "$file")
    name=$(dd if="$file" bs=1 skip=3 count=12 2>/dev/null | tr -d '\000')
    if [ "$name" != "mosquitto db" ] || [ "$state" = "$(cat "$tried" 2>/dev/null)" ]; then
        mv -f "$file" "$file.unreadable" &&
            echo "the store of the broker cannot be read: set aside as $file.unreadable, starting without it" >&2
    else
        echo "$state" 2>/dev/null >"$tried" || echo "cannot write into $store: the disk may be full" >&2
    fi
fi
exec "$1" -c "$2"
