#!/bin/sh
# Brings the environment .venv/NAME up to date: the packages of requirements/NAME.txt and this tree's hd_diag.
# Does nothing, and says nothing, where both are unchanged.
# usage: environment.sh NAME [PYTHON]
set -eu
cd "$(dirname "$0")/.."
# A sourced ROS 2 or another environment would otherwise be mixed in.
unset PYTHONPATH PYTHONHOME LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE

name=$1
lock=requirements/$name.txt
source_lock=requirements/$name-source.txt # what has no wheels
env=.venv/$name
log=.venv/$name.log
pip="$env/bin/python -m pip --disable-pip-version-check --no-input"

fail() {
    tail -n 5 "$log" >&2
    echo "FAILED: $1 (whole output: $log)" >&2
    exit 1
}

install_lock() {
    case $name in
    demo) size="750 MB, of which 200 MB are downloaded" ;;
    ubuntu) size="550 MB" ;;
    *) size="1.1 GB" ;;
    esac
    echo "== Environment $env: $(grep -c == "$lock") packages of $lock with $("$python" -V); $size, 1 to 5 minutes"
    rm -rf "$env"
    "$python" -m venv "$env" >"$log" 2>&1 || fail "$python cannot make a virtual environment (Debian, Ubuntu: apt install python3-venv)"
    # Bytecode is written when a module is first imported: most of them never are.
    $pip install --require-hashes --no-deps --no-compile --only-binary :all: -r "$lock" >>"$log" 2>&1 ||
        fail "pip could not install $lock: is there a network, and a package index that pip can reach?"
    [ ! -f "$source_lock" ] ||
        $pip install --require-hashes --no-deps --no-build-isolation -r "$source_lock" >>"$log" 2>&1 ||
        fail "pip could not install $source_lock"
}

install_tree() {
    echo "== Installing hd_diag of this tree into $env (5 s)"
    # From a copy: a build in place would leave build/ behind, and what was deleted would live on in it.
    copy=.venv/$name.source
    rm -rf "$copy"
    mkdir "$copy"
    cp -R $sources "$copy"
    package=$(echo "$env"/lib/python3*/site-packages)/hd_diag
    before=.venv/$name.before
    rm -rf "$before"
    [ ! -d "$package" ] || cp -Rp "$package" "$before"
    $pip install --no-index --no-deps --no-build-isolation --no-compile --force-reinstall "$copy" >>"$log" 2>&1 ||
        fail "hd_diag could not be installed"
    # Machine code is kept for a file with the time of its compilation: what has not changed keeps its time.
    [ ! -d "$before" ] || (cd "$before" && find . -name '*.py') | while read -r file; do
        ! cmp -s "$before/$file" "$package/$file" || touch -r "$before/$file" "$package/$file"
    done
    rm -rf "$copy" "$before"
    compile_kernels
}

# Once here rather than in every process that is first to compute; two at a time, one reads what the other has compiled.
compile_kernels() {
    echo "== Compiling its kernels where they have changed (half a minute)"
    $env/bin/python -I -c 'from hd_diag.diagnosis.fit import fit_parameters; from hd_diag.tolerance import evaluation; fit_parameters.warm_up(); evaluation.warm_up()' >>"$log" 2>&1 &
    first=$!
    $env/bin/python -I -c 'from hd_diag.config.configuration import resolve; from hd_diag.messages import encoding; from hd_diag.monitor import all_joints; encoding.warm_up(); all_joints.warm_up(resolve({}))' >>"$log" 2>&1 ||
        fail "the kernels could not be compiled"
    wait "$first" || fail "the kernels could not be compiled"
}

python=$(sh scripts/find_python.sh "${2:-}" "$env")
mkdir -p .venv
touch .venv/COLCON_IGNORE # colcon must not look for packages in there

# Environments cannot be moved, so the folder is part of the stamp. find_python.sh reads the Python behind it.
lock_stamp="$PWD $python $("$python" -V) $(cat requirements/"$name"*.txt | cksum)"
if [ "$(cat "$env/lock.stamp" 2>/dev/null)" != "$lock_stamp" ]; then
    install_lock
    echo "$lock_stamp" >"$env/lock.stamp"
fi

sources="hd_diag config launch examples resource package.xml setup.py setup.cfg pyproject.toml README.md LICENSE"
tree_stamp=$(find $sources -type f ! -path '*/__pycache__/*' | LC_ALL=C sort | xargs cksum | cksum)
if [ "$(cat "$env/tree.stamp" 2>/dev/null)" != "$tree_stamp" ]; then
    install_tree
    echo "$tree_stamp" >"$env/tree.stamp"
fi
