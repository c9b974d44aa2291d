#!/usr/bin/env bash
# What people see, in headless Chromium: the page of a run at work, the map of a finished one, and the report.
# Needs Node.js and Chromium. FGS names the command, or else one is built. Pictures go to the folder that is given.
set -euo pipefail
pictures=$(realpath "${1:-.}")
cd "$(dirname "$0")"
if [ -z "${FGS:-}" ]; then
    cargo build --quiet --package fgs_cli
    FGS="${CARGO_TARGET_DIR:-$PWD/../../../target}/debug/fgs"
fi
fgs=$(realpath "$FGS")

scratch=$(mktemp -d)
trap 'kill $(jobs -p) 2> /dev/null || true; rm -rf "$scratch"' EXIT
cp check.mjs "$scratch"
cd "$scratch"
npm install --silent --no-audit --no-fund puppeteer-core

# The address that a program in the background has written to a file.
address_in() {
    for _ in $(seq 100); do
        grep --only-matching --max-count=1 'http://[^ ]*' "$1" && return
        sleep 0.2
    done
    cat "$1" >&2
    return 1
}

"$fgs" synth room --frames 60 --size 160x120 --seed 3 > /dev/null
# So many steps that it is still at work when it has been looked at.
"$fgs" run room --out run --set mapping.iterations_per_frame=200 --live 127.0.0.1:0 > live.log 2>&1 &
node check.mjs "$(address_in live.log)" "$pictures/live.png" 40
kill $!
wait $! || true
"$fgs" run room --out run --set mapping.iterations_per_frame=2 > /dev/null 2>&1
"$fgs" view run --address 127.0.0.1:0 > view.log 2>&1 &
node check.mjs "$(address_in view.log)" "$pictures/view.png" 40
kill $!
wait $! || true
node check.mjs "file://$scratch/run/report.html" "$pictures/report.png" 2
