#!/bin/sh
# Copies this tree, which is read-only, where it can be written, and prints where that is. What an earlier copy has
# beside it, environments and caches, stays.
# usage: copy_tree.sh
set -eu
cd "$(dirname "$0")/.."
name=hd_diag-make-$(pwd -P | cksum | tr -d ' ')
for copy in "${XDG_CACHE_HOME:-${HOME:-/nowhere}/.cache}/$name" "${TMPDIR:-/tmp}/$name-$(id -u)"; do
    mkdir -p -m 700 "$copy" 2>/dev/null && [ -O "$copy" ] && [ -w "$copy" ] || continue
    in_tree() { find "$1" -mindepth 1 -maxdepth 1 ! -name .venv ! -name '.*_cache' ! -name .hypothesis ! -name .git; }
    in_tree "$copy" | while read -r old; do rm -rf "$old"; done
    in_tree . | while read -r new; do cp -Rp "$new" "$copy" && chmod -R u+w "$copy/$new"; done
    echo "$copy"
    exit 0
done
echo "This tree is read-only, and so are \$HOME/.cache and ${TMPDIR:-/tmp}: set TMPDIR to a folder that can be written" >&2
exit 1
