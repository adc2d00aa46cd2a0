#!/bin/sh
# Run by `make up`: ends with 1 and a sentence where Docker Engine or Compose is too old for docker-compose.yml and
# deploy/compose.vehicle.yml. A service that waits for another one's end, and `!reset`, need these versions.
set -u
compose_needed=2.24
engine_needed=20.10

# Whether version $1, such as v2.40.3-desktop.1, is at least $2, such as 2.24.
at_least() {
    major=${1#v} && major=${major%%[!0-9]*}
    rest=${1#*.} && minor=${rest%%[!0-9]*}
    [ "${major:-0}" -gt "${2%.*}" ] || { [ "${major:-0}" -eq "${2%.*}" ] && [ "${minor:-0}" -ge "${2#*.}" ]; }
}

if ! command -v docker >/dev/null; then
    echo "Docker is not installed; install Docker Engine with Compose, or run \`make demo\`, which does without" >&2
    exit 1
fi
compose=$(docker compose version --short 2>/dev/null)
if [ -z "$compose" ]; then
    echo "Docker has no Compose; install Compose $compose_needed or newer (docker-compose-plugin, Debian: docker-compose)" >&2
    exit 1
fi
if ! at_least "$compose" $compose_needed; then
    echo "Compose is $compose, and $compose_needed or newer is needed: update docker-compose-plugin" >&2
    exit 1
fi
# Without an answer from the engine, Compose says itself why.
engine=$(docker version --format '{{.Server.Version}}' 2>/dev/null)
if [ -n "$engine" ] && ! at_least "$engine" $engine_needed; then
    echo "Docker Engine is $engine, and $engine_needed or newer is needed: update it" >&2
    exit 1
fi
