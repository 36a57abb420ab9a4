#!/bin/sh
# Writes requirements/*.txt: one lock for CPython 3.10-3.13 each, with hashes and without index addresses.
# usage: lock.sh [PYTHON]
set -eu
cd "$(dirname "$0")/.."
python=$(sh scripts/find_python.sh "${1:-}")
mkdir -p .venv
[ -x .venv/lock/bin/uv ] || {
    echo "== Installing uv into .venv/lock"
    "$python" -m venv .venv/lock
    .venv/lock/bin/python -m pip --disable-pip-version-check install -q 'uv>=0.5'
}

# empy exists only as source: kept apart, and left out where nothing runs it (ROS uses it to build itself).
compile() {
    output=requirements/$1.txt
    shift
    echo "== Resolving $output"
    .venv/lock/bin/uv pip compile --quiet --universal --python-version 3.10 --generate-hashes --upgrade \
        --no-header --no-emit-index-url --no-emit-find-links --output-file "$output" "$@"
}

compile demo --no-emit-package empy setup.py --extra ros
compile test --no-emit-package empy setup.py --extra ros --extra fleet --extra test --extra dev --extra docs \
    --constraints requirements/demo.txt
compile test-source requirements/test-source.in
compile ubuntu setup.py requirements/ubuntu.in
compile challenge setup.py --extra challenge --constraints requirements/demo.txt
