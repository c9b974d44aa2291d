#!/usr/bin/env bash
# The Python package as a newcomer gets it: pip installs it into a fresh virtual environment; types,
# tests, the example, and the example of the README of the repository, whose results are compared with
# those of the command: FGS, or else one that is built here.
set -euo pipefail
cd "$(dirname "$0")/.."

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
python3 -m venv "$scratch/venv"
export PATH="$scratch/venv/bin:$PATH"
# What the workspace has compiled is used again.
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$PWD/target}"

cargo fmt --manifest-path python/Cargo.toml --check
cargo clippy --manifest-path python/Cargo.toml --locked --quiet -- -D warnings
pip install --quiet --disable-pip-version-check \
    --config-settings=build-args="--profile dev --locked" "./python[test]"
if [ -z "${FGS:-}" ]; then
    cargo build --quiet --package fgs_cli
    export FGS="$CARGO_TARGET_DIR/debug/fgs"
fi

cp -r python/tests python/examples python/pyproject.toml "$scratch"
awk '/^```python$/ { inside = 1; next } /^```$/ { inside = 0 } inside' README.md > "$scratch/readme.py"
cd "$scratch"
python -m mypy.stubtest fgs_slam
python -m mypy tests examples
python -m pytest --quiet
python examples/room.py
rm -r room
python readme.py
"$FGS" run room --out by-command > by-command.log
for result in trajectory.txt map.ply; do
    cmp "by-command/$result" "by-python/$result"
done
