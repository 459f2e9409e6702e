#!/usr/bin/env bash
# Pages of updates, as a person checks them: a real building against its architect's model, and a changed hall.
#   benches/update/pages.sh PRESIGHT BENCH OUT      BENCH is the program of `cargo bench --bench update --no-run`
set -euo pipefail
presight=$(realpath "$1") bench=$(realpath "$2") out=$(mkdir -p "$3" && realpath "$3")
cd "$(dirname "$0")/../.."
data=${PRESIGHT_DATA:-../shared/data}
"$bench" willow "$out/willow-logs"
"$presight" update "$out"/willow-logs/drive*.jsonl --map "$data/env/office_willowgarage.glb" --init reference \
    --poses "$out/willow-logs/poses.tum" --pose-cov 0.003,0.003,0.001,0.06,0.06,0.02 --model-sigma 0.05 --out "$out/willow"
"$bench" hall "$out/hall-logs"
"$presight" update "$out/hall-logs/drive1.jsonl" --map "$data/env/factory_hall.glb" --init reference \
    --poses "$out/hall-logs/poses.tum" --pose-cov 0.005,0.005,0.005,0.1,0.1,0.1 --out "$out/hall"
