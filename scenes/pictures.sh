#!/usr/bin/env bash
# Makes the pictures of the scenes anew: scenes/pictures.sh [PRESIGHT]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
presight="${1:-../target/release/presight}"
mkdir -p pictures

picture() { # SCENE SENSOR POSE
    "$presight" predict "$1.rhai" --sensor "$2" --pose "$3" --backend cpu --png "pictures/$1.png"
}

picture factory overview.toml 1.0,17.0,5.2,0,8,-4
picture docking overview.toml 0.2,-0.6,1.5,0,18,5
picture corridor overview.toml 2.0,-0.2,1.6,0,4,1
picture shared_edge small.toml 0,0,0,0,0,0
picture tie small.toml 0,0,0,0,0,0
picture behind small.toml 0,0,0,0,0,0
picture empty small.toml 0,0,0,0,0,0
picture seam all_round.toml 0,0,0,0,0,0
picture pole all_round.toml 0,0,0,0,0,0
