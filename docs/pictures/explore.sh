#!/usr/bin/env bash
# Makes explore-objects.png and explore-range.png: the living room of shared/data, explored from its even frames and predicted at an odd one.
# docs/pictures/explore.sh [presight [folder of the data]]
set -euo pipefail
presight=$(realpath "$(command -v "${1:-presight}")") here=$(realpath "$(dirname "$0")") work=$(mktemp -d)
room=$(realpath "${2:-$here/../../../shared/data}")/rgbd/livingroom
cd "$work"
mkdir even
ln -s "$room"/* even/
rm even/poses.txt
awk '/^#/ || $1 % 2 == 0' "$room/poses.txt" > even/poses.txt
printf 'format = 1\nkind = "camera"\nclass = "laser"\nwidth = 320\nheight = 240\nfx = 262.5\nfy = 262.5\ncx = 159.5\ncy = 119.5\n' > odd.toml
"$presight" explore even --stride 4 --out room.presight
pose=$(awk '$1 == "00121" { print $2 "," $3 "," $4 "," $5 "," $6 "," $7 "," $8 }' "$room/poses.txt")
for output in object_id range; do
    "$presight" predict room.presight --sensor odd.toml --pose="$pose" --pose-frame optical --world-frame gltf --outputs "$output,polygon_id" \
        --png-of "$output" --png "$output.png"
done
cp object_id.png "$here/explore-objects.png"
cp range.png "$here/explore-range.png"
