#!/usr/bin/env bash
# Makes motion-explored-*.png and motion-verdicts-*.png: the factory, by a lidar that turns in 0.1 s on a robot at 1.5 m/s and up to 1 rad/s,
# without and with its motion.
# docs/pictures/motion.sh [presight]
set -euo pipefail
presight=$(realpath "$(command -v "${1:-presight}")") here=$(realpath "$(dirname "$0")") work=$(mktemp -d)
factory=$(realpath "$here/../../scenes/factory.rhai")
cd "$work"
awk 'BEGIN { for (k = 0; k < 60; k++) { a = 0.35 * sin(0.15 * k); print k / 10, 3 + 0.15 * k, 28.4, 0, 0, 0, sin(a), cos(a) } }' > drive.tum
printf '%s\n' 'format = 1' 'kind = "scanner"' 'class = "laser"' 'range_min = 0.3' 'range_max = 30' '[azimuth]' 'start_deg = -180' \
    'step_deg = 0.703125' 'count = 512' '[elevation]' 'start_deg = 20' 'step_deg = -1.25' 'count = 33' '[noise]' 'range_sigma = 0.005' '[mount]' \
    'xyz = [0.0, 0.0, 0.8]' > standing.toml
sed '1a turn_s = 0.1' standing.toml > turning.toml
printf 'format = 1\nkind = "camera"\nclass = "laser"\nwidth = 320\nheight = 240\nfx = 160\nfy = 160\ncx = 159.5\ncy = 119.5\n' > view.toml
"$presight" simulate "$factory" --sensor turning.toml --poses drive.tum --out run
for sensor in standing turning; do
    "$presight" explore run/scans.jsonl --sensor $sensor.toml --out $sensor.presight
    "$presight" predict $sensor.presight --sensor view.toml --pose=7.5,28.4,0.8,0,0,90 --outputs range,polygon_id --png-of range --png $sensor.png
    cp $sensor.png "$here/motion-explored-$sensor.png"
    "$presight" replay run/scans.jsonl --map "$factory" --sensor $sensor.toml --init reference --out shown-$sensor
    cp shown-$sensor/frames/000040.png "$here/motion-verdicts-$sensor.png"
done
