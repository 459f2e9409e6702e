#!/usr/bin/env bash
# Peak memory of an update by the number of drives: 400 frames each, to and fro in scenes/room.glb, of which the shelf is gone and sofa
# and plant are moved. COLUMNS_OF_LIDAR (480) makes frames smaller.   benches/update/memory.sh PRESIGHT [DRIVES]..
set -euo pipefail
presight=$(realpath "$(command -v "${1:-presight}")") room=$(realpath "$(dirname "$0")/../../scenes/room.glb")
shift || true
columns=${COLUMNS_OF_LIDAR:-480}
work=$(mktemp -d)
cd "$work"
cat > changes.jsonl <<'END'
{"op":"delete_object","object":"room/shelf"}
{"op":"move","object":"room/sofa","pose":[4.3,0.6,0,0,0,90]}
{"op":"move","object":"room/plant","pose":[5.2,2.4,0,0,0,0]}
END
cat > lidar.toml <<END
format = 1
kind = "scanner"
class = "laser"
range_max = 20
[azimuth]
start_deg = -180
step_deg = $(awk "BEGIN { print 360 / $columns }")
count = $columns
[elevation]
start_deg = -30
step_deg = 1.5
count = 32
[noise]
range_sigma = 0.01
[mount]
xyz = [0.0, 0.0, 1.0]
END
awk 'BEGIN { for (k = 0; k < 400; k++) { half = 0.6 * sin(0.031 * k)
    printf "%.1f %.4f %.4f 0 0 0 %.6f %.6f\n", 0.5 * k, 2.2 + 1.3 * sin(0.05 * k), 2.9 - 0.3 * sin(0.021 * k), sin(half), cos(half) } }' > way.tum
"$presight" env create real.presight "$room" > create.log
"$presight" env apply real.presight changes.jsonl > apply.log
"$presight" env create map.presight "$room" > create.log
"$presight" simulate real.presight --sensor lidar.toml --poses way.tum --seed 1 --out run > simulate.log
echo "| drives | frames and views | peak MiB |"
echo "|---|---|---|"
(($#)) || set -- 1 3 6 12
for drives in "$@"; do
    logs=()
    for ((k = 0; k < drives; k++)); do logs+=(run/scans.jsonl); done
    "$presight" update "${logs[@]}" --map map.presight --init reference --poses way.tum \
        --pose-cov 0.005,0.005,0.005,0.1,0.1,0.1 --out found > found.log &
    run=$! peak=0
    # The kernel keeps the peak of a process while it lives.
    while read -r _ kib _ < <(grep VmHWM "/proc/$run/status" 2> none.log); do peak=$kib; sleep 0.2; done
    wait "$run"
    echo "| $drives | $(head -1 found.log) | $((peak / 1024)) |"
done
