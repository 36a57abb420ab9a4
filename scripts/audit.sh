#!/bin/sh
# Looks up all that requirements/*.txt install among known vulnerabilities (osv.dev). What is accepted, and why,
# stands here as --ignore-vuln ID beside its reason; nothing is.
# usage: audit.sh [PYTHON]
set -eu
cd "$(dirname "$0")/.."
python=$(sh scripts/find_python.sh "${1:-}")
mkdir -p .venv
[ -x .venv/audit/bin/pip-audit ] || {
    echo "== Installing pip-audit into .venv/audit"
    "$python" -m venv .venv/audit
    .venv/audit/bin/python -m pip --disable-pip-version-check install -q 'pip-audit>=2.7'
}
for lock in requirements/*.txt; do
    echo "== $lock"
    # Strict: a package that could not be looked up is no package without a vulnerability.
    .venv/audit/bin/pip-audit --strict --vulnerability-service osv --disable-pip --require-hashes \
        --progress-spinner off --requirement "$lock"
done
