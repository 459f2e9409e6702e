#!/usr/bin/env bash
# Makes the models, sensors and logs that the guides and the examples of --help name, in a new folder.
#   scenes/examples.sh FOLDER && cd FOLDER        (presight on the path)
set -euo pipefail
scenes=$(cd "$(dirname "$0")" && pwd)
mkdir "$1"
cd "$1"
ln -s "$scenes" scenes

# Models: a hall, a corridor, and a furnished room as a store.
for scene in factory corridor; do
    presight env create $scene.presight "scenes/$scene.rhai"
    presight env export $scene.presight exported
    mv exported/scene.glb $scene.glb
    rm -r exported
done
mv factory.glb hall.glb
rm corridor.presight
cp hall.glb hall-2.glb
presight env create site.presight scenes/room.glb
presight features hall.glb --class video --min-length 3 --out hall.video.layer.json
presight features scenes/room.glb --class video --out edges.json

# Sensors.
cat > camera.toml <<'TOML'
format = 1
kind = "camera"
class = "laser"
width = 80
height = 60
fx = 57.5
fy = 57.5
cx = 39.5
cy = 29.5
range_max = 8.0
[noise]
range_sigma = 0.005
TOML
sed 's/^class = .*/class = "video"/; s/^range_max.*//; s/^range_sigma.*/pixel_sigma = 0.3/' camera.toml > video.toml
sed 's/^\[noise/[mount]\nxyz = [0, 0, 1.2]\n&/' video.toml > eye.toml
presight sensors laser-scanner > scanner.toml
cat > kurt.toml <<'TOML'
format = 1
[[sensors]]
name = "front"
sensor = "camera.toml"
[[sensors]]
name = "rear"
sensor = "camera.toml"
mount = { xyz = [0, 0, 0], rpy_deg = [0, 0, 180] }
TOML
cat > camera_info.yaml <<'YAML'
image_width: 640
image_height: 480
camera_name: head
camera_matrix: {rows: 3, cols: 3, data: [525, 0, 319.5, 0, 525, 239.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.01, -0.02, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [525, 0, 319.5, 0, 0, 525, 239.5, 0, 0, 0, 1, 0]}
YAML
echo '{"polyline_in_robot": [[0.4, 0], [3, 0]], "half_width": 0.4, "z_min": -0.9, "z_max": 0.6}' > way.json

# Drives: time, position and orientation of the sensor or the robot.
line() { awk -v n="$1" -v x="$2" -v y="$3" -v z="$4" 'BEGIN { for (k = 0; k < n; k++) print k / 10, x + k / 20, y, z, 0, 0, 0, 1 }'; }
line 8 12 18 1 > drive.tum
line 8 4 0 0.8 > corridor.tum
head -n 3 corridor.tum > places.tum
printf '%s 0 -0.5 1.2 0 0 0 1\n' 0 1 2 3 4 > bay.tum
awk '!/^#/ && n++ % 5 == 0 { $4 = 0.8; print }' scenes/drive.tum > room.tum

# Logs: a room that has changed since its model was made, the hall, and the corridor.
presight env create changed.presight scenes/room.glb
presight env apply changed.presight - <<'JSON'
{"op": "delete_object", "object": "room/parcel"}
{"op": "move", "object": "room/plant", "pose": [5.2, 3.4, 0, 0, 0, 0]}
JSON
presight simulate changed.presight --sensor camera.toml --poses room.tum --seed 1 --out livingroom
for day in monday tuesday wednesday thursday; do
    presight simulate changed.presight --sensor laser-range-camera --poses room.tum --seed ${#day} --out $day
    cp $day/scans.jsonl $day.jsonl
done
sed 's/^\[noise/[mount]\nxyz = [0, 0, 0]\nrpy_deg = [0, 0, 180]\n&/' camera.toml > rear.toml
presight simulate changed.presight --sensor camera.toml --poses room.tum --seed 2 --out front
presight simulate changed.presight --sensor rear.toml --poses room.tum --seed 3 --out rear
presight simulate scenes/room.glb --sensor camera.toml --grey video.toml --poses room.tum --out both
presight simulate scenes/docking.rhai --sensor scanner.toml --intensities --poses bay.tum --out bay
presight simulate hall.glb --sensor camera.toml --poses drive.tum --out run --mcap drive.mcap
presight simulate corridor.glb --sensor laser-scanner --poses corridor.tum --out scans
cp scans/scans.jsonl scans.json
presight predict hall.glb --sensor camera.toml --pose 12,18,1,0,0,0 --points hall.ply

# Two predictions to compare, shapes of things, and a program that names what it is shown.
presight predict scenes/room.glb --sensor camera.toml --pose 0.7,2.2,1,0,0,0 --out reference.exr
cp reference.exr other.exr
echo 'place("pallet", box(1.2, 0.8, 0.14).made_of(material("wood", #{})), pose(0, 0, 0));' > pallet.rhai
presight env create pallet.presight pallet.rhai
presight env export pallet.presight pallets
mv pallets/scene.glb pallets/pallet.glb
rm pallet.presight pallet.rhai
echo 'print("{\"object\": \"pallet\", \"pose\": [4.6, 0.9, 0, 0, 0, 115]}")' > name.py
