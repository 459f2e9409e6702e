#!/usr/bin/env bash
# Embree and presight on the same rays and triangles; prints one table. Needs Python 3 with venv and PyPI, once.
#   benches/peers/run.sh [--help] [--scenes hospital,factory_hall] [--backends cpu,gpu] [--embree-only] ...
# PRESIGHT=path takes another presight command than the one built here.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(cd "$here/../.." && pwd)
venv="$here/.venv"

if [[ ! -f "$venv/ready" ]] || ! cmp -s "$here/requirements.txt" "$venv/ready"; then
    echo "benches/peers: making $venv (open3d-cpu is about 100 MB)" >&2
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check -r "$here/requirements.txt" >&2
    if ! said=$("$venv/bin/python" -c 'import open3d' 2>&1); then
        printf 'benches/peers: Open3D does not load: %s\n' "${said##*$'\n'}" >&2
        echo "benches/peers: on Debian and Ubuntu: apt-get install libusb-1.0-0 libgomp1" >&2
        exit 1
    fi
    cp "$here/requirements.txt" "$venv/ready"
fi

if [[ -z "${PRESIGHT:-}" && " $* " != *" --embree-only "* && " $* " != *" --make-poses "* && " $* " != *" --help "* ]]; then
    (cd "$root" && cargo build --release --quiet) >&2
    PRESIGHT="${CARGO_TARGET_DIR:-$root/target}/release/presight"
fi
export PRESIGHT="${PRESIGHT:-}"
exec "$venv/bin/python" "$here/peers.py" "$@"
