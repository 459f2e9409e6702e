#!/usr/bin/env bash
# Embree and presight on the same rays and triangles; prints one table. Needs Python 3 with venv and PyPI, once.
#   benches/peers/run.sh growth.py [--help]: the plot of cost against model size
#   benches/peers/run.sh by_cpu.py [--help]: CPU time, cold and warm, of scanners and free ray tables, too
#   benches/peers/run.sh tsdf.py [--help]: frames a second of Open3D's TSDF integration, and of exploration
#   benches/peers/run.sh flight.py: the end of the living room's flight by ICP
#   benches/peers/run.sh [--help] [--quick] [--scenes hospital,open_hall] [--sensors plumb-bob,video-camera] [--backends cpu,gpu] ...
# PRESIGHT_PEER=path takes another program than the bench `peer` built here, PEERS_PYTHON=path a Python that has the requirements.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(cd "$here/../.." && pwd)
venv="$here/.venv"

python="${PEERS_PYTHON:-$venv/bin/python}"
if [[ -n "${PEERS_PYTHON:-}" ]]; then
    :
elif [[ ! -f "$venv/ready" ]] || ! cmp -s "$here/requirements.txt" "$venv/ready"; then
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

if [[ -z "${PRESIGHT_PEER:-}" && " $* " != *" --make-poses "* && " $* " != *" --help "* && "${1:-}" != tsdf.py && "${1:-}" != flight.py ]]; then
    features=script
    [[ " $* " == *gpu* ]] && features=script,gpu
    PRESIGHT_PEER=$(cd "$root" && cargo bench --quiet --no-default-features --features "$features" --bench peer --no-run \
        --message-format json | "$python" -c 'import json, sys
print([m["executable"] for m in map(json.loads, sys.stdin) if m.get("executable")][-1])')
fi
export PRESIGHT_PEER="${PRESIGHT_PEER:-}"
script=peers.py
if [[ "${1:-}" == *.py ]]; then
    script=$1
    shift
fi
exec "$python" "$here/$script" "$@"
