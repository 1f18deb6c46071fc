#!/bin/sh
# Every library's licence, source and known holes against deny.toml, by the cargo-deny that is given.
set -eu
cd "$(dirname "$0")/.."
deny=${1:-cargo-deny}
"$deny" --locked check licenses bans sources
if said=$("$deny" fetch db 2>&1); then
    "$deny" --locked check --disable-fetch advisories
else
    echo "SKIPPED advisories: the database of known holes cannot be fetched here: $(echo "$said" | grep -m 1 fatal || echo "$said" | tail -n 1)"
fi
