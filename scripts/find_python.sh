#!/bin/sh
# Prints the path of a CPython 3.10-3.13 that can make virtual environments; says what was found where none is.
# Without a named one, the Python that made the environment is tried first: so that it need not be made again.
# usage: find_python.sh [PYTHON [ENVIRONMENT]]
set -eu

probe='
import os, sys
version = "%d.%d.%d" % sys.version_info[:3]
if not (3, 10) <= sys.version_info[:2] <= (3, 13):
    sys.exit("Python %s, not 3.10 to 3.13" % version)
if sys.implementation.name != "cpython":
    sys.exit("%s, not CPython" % sys.implementation.name)
try:
    import ensurepip, venv
except ImportError:
    sys.exit("Python %s without the venv module (Debian, Ubuntu: apt install python%d.%d-venv)"
             % (version, sys.version_info[0], sys.version_info[1]))
# The one that an active environment was made from: that may be the environment which is made anew.
inside = sys.prefix != sys.base_prefix
print(os.path.join(sys.base_prefix, "bin", "python%d.%d" % sys.version_info[:2]) if inside else sys.executable)
'

maker=$(cut -d ' ' -f 2 "${2:-}/lock.stamp" 2>/dev/null) || maker=
newline='
'
found=
for candidate in ${1:-$maker python3.12 python3.11 python3.10 python3.13 python3 python}; do
    # A pyenv shim exists on the PATH and yet fails with 127: only running a candidate tells.
    if answer=$("$candidate" -c "$probe" 2>&1); then
        echo "$answer"
        exit 0
    fi
    command -v "$candidate" >/dev/null 2>&1 || answer="not found"
    found="$found  $candidate: ${answer%%"$newline"*}$newline"
done
printf 'No suitable Python. Needed: CPython 3.10 to 3.13 with its venv module. Tried:\n%s' "$found" >&2
echo 'Install one (Debian, Ubuntu: apt install python3 python3-venv) or name one: make ... PYTHON=/path/to/python' >&2
exit 1
