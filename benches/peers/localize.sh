#!/usr/bin/env bash
# Poses from the same frames and priors: presight, GICP of small_gicp, and an ICP that casts rays as MICP-L does; prints one table.
# Needs Python 3 with venv and PyPI, once.   benches/peers/localize.sh [--threads 2]
# PEERS_PYTHON=path takes a Python that has the requirements and small_gicp, PRESIGHT_LOCALIZE=path another program than the bench.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(cd "$here/../.." && pwd)
venv="$here/.venv-localize"
frames="$root/target/peers-localize"

python="${PEERS_PYTHON:-$venv/bin/python}"
if [[ -z "${PEERS_PYTHON:-}" && ! -f "$venv/ready" ]]; then
    echo "benches/peers: making $venv (open3d-cpu is about 100 MB)" >&2
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check -r "$here/requirements.txt" small_gicp==1.0.1 >&2
    touch "$venv/ready"
fi
if [[ -n "${PRESIGHT_LOCALIZE:-}" ]]; then
    (cd "$root" && "$PRESIGHT_LOCALIZE" frames "$frames") >&2
else
    (cd "$root" && cargo bench -p presight --no-default-features --bench localize -- frames "$frames") >&2
fi
exec "$python" "$here/localize.py" "$frames" "$@"
