#!/usr/bin/env bash
# Makes the first picture of README.md: a depth image as predicted from the model of a room, as measured in the room
# since it changed (simulated), and the verdict on each pixel.   docs/pictures/should-and-is.sh [presight]
set -euo pipefail
presight=$(realpath "$(command -v "${1:-presight}")") here=$(realpath "$(dirname "$0")") work=$(mktemp -d)
PATH=$(dirname "$presight"):$PATH
ln -s "$here/../../scenes" "$work/scenes"
cd "$work"
cat > camera.toml <<'TOML'
format = 1
kind = "camera"
class = "laser"
width = 400
height = 300
fx = 260.0
fy = 260.0
cx = 199.5
cy = 149.5
range_max = 8.0
[noise]
range_sigma = 0.005
TOML
presight env create changed.presight scenes/room.glb
presight env apply changed.presight - <<'JSON'
{"op": "delete_object", "object": "room/parcel"}
{"op": "move", "object": "room/plant", "pose": [2.3, 1.5, 0, 0, 0, 0]}
JSON
# Three steps towards the middle of the room: roll 0, pitch 12 and yaw 38 degrees.
for k in 0 1 2; do echo "$k 0.$((30 + k)) 0.35 1.65 -0.0340 0.0988 0.3238 0.9403"; done > drive.tum
presight simulate changed.presight --sensor camera.toml --poses drive.tum --seed 1 --out measured
presight replay measured --map scenes/room.glb --sensor camera.toml --init reference --out shown
cp shown/frames/000002.png "$here/should-and-is.png"
