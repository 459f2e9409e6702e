#!/usr/bin/env bash
# Makes the pictures of docs/tour.md by the commands of that page.   docs/pictures/tour.sh [presight]
set -euo pipefail
presight=$(realpath "$(command -v "${1:-presight}")") here=$(realpath "$(dirname "$0")") work=$(mktemp -d)
PATH=$(dirname "$presight"):$PATH
ln -s "$here/../../scenes" "$work/scenes"
cd "$work"
awk '/^```sh/ { code = 1; next } /^```/ { code = 0 } code' "$here/../tour.md" > tour.sh
bash -e tour.sh
cp tour/predicted.png "$here/tour-predict.png"
cp tour/real.png "$here/tour-real.png"
cp tour/shown/frames/000030.png "$here/tour-localize.png"
cp tour/found/001.png "$here/tour-update.png"
# The grid, four times as large, with the route in red.
presight query tour/room.presight --path 0.7,0.8,0 4.4,3.6,0 --radius 0.25 --json > route.json
python3 - "$here/tour-query.png" <<'END'
import json, re, struct, sys, zlib

points = json.load(open("route.json"))["points"]
yaml = open("tour/grid.yaml").read()
cell = float(re.search(r"resolution: *(\S+)", yaml)[1])
x0, y0 = (float(v) for v in re.search(r"origin: *\[([^]]*)\]", yaml)[1].split(",")[:2])
head, size, _, pixels = open("tour/grid.pgm", "rb").read().split(b"\n", 3)
w, h = map(int, size.split())
k = 4
rows = [bytearray(v for x in range(w) for v in pixels[y * w + x: y * w + x + 1] * 3 * k) for y in range(h) for _ in range(k)]
for (ax, ay, *_), (bx, by, *_) in zip(points, points[1:]):
    for t in range(400):
        x, y = ax + (bx - ax) * t / 400, ay + (by - ay) * t / 400
        c, r = int((x - x0) / cell * k), int((h - (y - y0) / cell) * k)
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                rows[r + dr][3 * (c + dc): 3 * (c + dc) + 3] = bytes((200, 0, 0))
chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
raw = b"".join(b"\0" + bytes(row) for row in rows)
png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", w * k, h * k, 8, 2, 0, 0, 0))
open(sys.argv[1], "wb").write(png + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b""))
END
