#!/usr/bin/env bash
# Makes motion-*.png: a corridor and the factory by lidars that turn in 0.1 s, and a door by a rolling shutter, on a robot at 1.5 m/s that
# turns by up to 1 rad/s, without and with its motion.
# docs/pictures/motion.sh [presight]
set -euo pipefail
presight=$(realpath "$(command -v "${1:-presight}")") here=$(realpath "$(dirname "$0")") work=$(mktemp -d)
scenes=$(realpath "$here/../../scenes")
draw() { python3 "$here/motion.py" "$@"; }
cd "$work"

# The corridor from above: standing, driving, and driving with its points moved to the stamp.
"$presight" sensors os1-128-real | sed '/^range_min/d' > os1.toml
corridor() { "$presight" predict "$scenes/corridor.rhai" --sensor os1.toml --pose 10,0,1,0,0,0 "$@"; }
twist=1.5,0,0,0,0,57.29578
corridor --points standing.ply
corridor --twist $twist --points sensed.ply
corridor --twist $twist --points deskewed.ply --deskew 0
draw above "$here/motion-corridor.png" standing.ply sensed.ply deskewed.ply

# Ranges of a moving scan against those of one pose in its middle, 0.05 s later on the circle.
factory() { "$presight" predict "$scenes/factory.rhai" --sensor os1.toml --destagger "$@"; }
factory --pose 7.5,28.4,0.8,0,0,0 --twist $twist --depth-png moving.png
factory --pose 7.574969,28.401875,0.8,0,0,2.864789 --depth-png middle.png
draw errors "$here/motion-errors.png" moving.png middle.png

# A door frame by a camera that turns by 90 degrees a second, all rows at once and row by row in 0.1 s.
camera() { printf '%s\n' 'format = 2' 'kind = "camera"' 'class = "laser"' "width = $1" "height = $2" "fx = $3" "fy = $3" "cx = $4" "cy = $5"; }
{ camera 320 240 200 159.5 119.5 && printf '[timing]\nreadout_s = 0.1\n'; } > rolling.toml
door() { "$presight" predict "$scenes/corridor.rhai" --sensor rolling.toml --pose=3.2,0.2,1.2,0,0,-50 "$@"; }
door --depth-png global.png
door --twist 0,0,0,0,0,90 --depth-png rolling.png
draw beside "$here/motion-door.png" global.png rolling.png

# What is explored: the model, from a robot that stands at each pose, and from one that drives, with and without its motion.
awk 'BEGIN { for (k = 0; k < 60; k++) { a = 0.35 * sin(0.15 * k); print k / 10, 3 + 0.15 * k, 28.4, 0, 0, 0, sin(a), cos(a) } }' > drive.tum
scanner() { # COLUMNS ROWS
    printf '%s\n' 'format = 1' 'kind = "scanner"' 'class = "laser"' 'range_min = 0.3' 'range_max = 30' '[azimuth]' 'start_deg = -180' \
        "step_deg = $((360000000 / $1))e-6" "count = $1" '[elevation]' 'start_deg = 20' "step_deg = -$((40000000 / ($2 - 1)))e-6" "count = $2" \
        '[noise]' 'range_sigma = 0.005' '[mount]' 'xyz = [0.0, 0.0, 0.8]'
}
scanner 512 33 > standing.toml
sed '1a turn_s = 0.1' standing.toml > turning.toml
camera 320 240 160 159.5 119.5 | sed 's/format = 2/format = 1/' > view.toml
seen() { "$presight" predict "$1" --sensor view.toml --pose=7.5,28.4,1.2,0,5,90 --depth-png "$2.png"; }
seen "$scenes/factory.rhai" model
for robot in standing turning; do "$presight" simulate "$scenes/factory.rhai" --sensor $robot.toml --poses drive.tum --out $robot; done
explored() { "$presight" explore "$2/scans.jsonl" --sensor "$3.toml" --out "$1.presight" && seen "$1.presight" "$1"; }
explored stands standing standing
explored drives turning turning
explored unmoved turning standing
draw beside "$here/motion-explored.png" model.png stands.png drives.png unmoved.png

# Verdicts on a scan of the robot while it turns.
scanner 256 17 > still.toml
sed '1a turn_s = 0.1' still.toml > moving.toml
"$presight" simulate "$scenes/factory.rhai" --sensor moving.toml --poses drive.tum --out log
for motion in still moving; do
    "$presight" replay log/scans.jsonl --map "$scenes/factory.rhai" --sensor $motion.toml --init reference --out shown-$motion
    cp shown-$motion/frames/000040.png "$here/motion-verdicts-$motion.png"
done
