#!/usr/bin/env bash
# Makes changed-room.png: the shelf of scenes/room.glb is gone, sofa and plant are moved, and one person walks about. The map is
# the room as it was.   docs/pictures/changed-room.sh [presight]
set -euo pipefail
presight=$(realpath "$(command -v "${1:-presight}")") here=$(realpath "$(dirname "$0")") work=$(mktemp -d)
room=$here/../../scenes/room.glb
cd "$work"
cat > changes.jsonl <<'END'
{"op":"delete_object","object":"room/shelf"}
{"op":"move","object":"room/sofa","pose":[4.3,0.6,0,0,0,90]}
{"op":"move","object":"room/plant","pose":[5.2,2.4,0,0,0,0]}
END
awk 'BEGIN { for (k = 0; k < 24; k++) { half = 0.25 * sin(0.09 * k)
    printf "%.1f %.4f %.4f 0.5 0 0 %.6f %.6f\n", 0.1 * k, 0.9 + 0.03 * k, 2.9 - 0.01 * k, sin(half), cos(half) } }' > way.tum
"$presight" env create real.presight "$room"
"$presight" env apply real.presight changes.jsonl
"$presight" simulate real.presight --sensor laser-scanner --poses way.tum --walkers 1 --seed 1 --out run
"$presight" replay run/scans.jsonl --map "$room" --init reference --out drive
cp drive/frames/000020.png "$here/changed-room.png"
