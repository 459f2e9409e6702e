"""Draws predictions side by side, with Python's standard library alone.

motion.py above OUT.png CLOUD.ply..       clouds from above, one below the other
motion.py errors OUT.png A.png B.png      how far the depths of two images are apart
motion.py beside OUT.png A.png..          depth images side by side
"""

import math
import struct
import sys
import zlib

NOTHING, PAPER, INK = (38, 42, 50), (20, 22, 27), (240, 228, 66)


def write(path, rows):
    """Writes rows of (red, green, blue) as PNG."""
    lines = b"".join(b"\0" + bytes(value for pixel in row for value in pixel) for row in rows)
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", len(rows[0]), len(rows), 8, 2, 0, 0, 0)),
              (b"IDAT", zlib.compress(lines, 9)), (b"IEND", b"")]
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for name, data in chunks:
            file.write(struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)))


def depths(path):
    """Rows of metres of a depth image: 16-bit PNG, millimetres; 0 is no depth."""
    data, at, packed = open(path, "rb").read(), 8, b""
    while at < len(data):
        (size,), name = struct.unpack(">I", data[at:at + 4]), data[at + 4:at + 8]
        if name == b"IHDR":
            width, height = struct.unpack(">II", data[at + 8:at + 16])
        if name == b"IDAT":
            packed += data[at + 8:at + 8 + size]
        at += 12 + size
    raw, stride, rows, last = zlib.decompress(packed), 2 * width, [], bytes(2 * width)
    for y in range(height):
        kind, line = raw[y * (stride + 1)], bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)])
        for i in range(stride):
            left, up, corner = line[i - 2] if i > 1 else 0, last[i], last[i - 2] if i > 1 else 0
            nearest = min((left, up, corner), key=lambda v: abs(left + up - corner - v))
            line[i] = (line[i] + (0, left, up, (left + up) // 2, nearest)[kind]) % 256
        rows.append([v / 1000 for v in struct.unpack(f">{width}H", line)])
        last = bytes(line)
    return rows


def points(path):
    """Points of a binary PLY file whose first properties are x, y, z as float."""
    data = open(path, "rb").read()
    end = data.index(b"end_header\n") + 11
    header = data[:end].decode().split("\n")
    sizes = {"float": 4, "uint": 4, "uchar": 1, "ushort": 2, "double": 8, "int": 4}
    size = sum(sizes[line.split()[1]] for line in header if line.startswith("property"))
    return [struct.unpack_from("<3f", data, at) for at in range(end, len(data) - size + 1, size)]


def ramp(share, colors=((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))):
    """The colour at a share from 0 to 1."""
    place = min(max(share, 0), 1) * (len(colors) - 1)
    low = min(int(place), len(colors) - 2)
    return tuple(round(a + (b - a) * (place - low)) for a, b in zip(colors[low], colors[low + 1]))


def above(out, clouds, scale=40, half=(11.0, 2.2)):
    """Points 0.6 m below to 1 m above the sensor, x to the right."""
    width, height = (round(2 * side * scale) for side in half)
    picture = []
    for cloud in clouds:
        panel = [[PAPER] * width for _ in range(height)]
        for x, y, z in points(cloud):
            column, row = round((x + half[0]) * scale), round((half[1] - y) * scale)
            if -0.6 < z < 1 and 0 <= column < width and 0 <= row < height:
                panel[row][column] = INK
        picture += panel + [[NOTHING] * width] * 4
    write(out, picture[:-4])


def errors(out, images):
    """Dark up to 1 mm, yellow from 1 m on in 12 steps, one colour for what only one image sees."""
    a, b = map(depths, images)
    step = lambda off: round(12 * (math.log10(max(off, 1e-3)) / 3 + 1)) / 12
    pixel = lambda p, q: ramp(step(abs(p - q))) if p and q else (NOTHING if p == q else (213, 94, 0))
    write(out, [[pixel(p, q) for p, q in zip(*rows)] for rows in zip(a, b)])


def beside(out, images):
    """One scale for all, near is yellow."""
    images = [depths(path) for path in images]
    seen = sorted(d for image in images for row in image for d in row if d)
    near, far = (math.log(seen[round(share * (len(seen) - 1))]) for share in (0.01, 0.99))
    pixel = lambda d: ramp(1 - (math.log(d) - near) / (far - near)) if d else NOTHING
    gap = [PAPER] * 4
    write(out, [sum(([pixel(d) for d in row] + gap for row in rows), [])[:-4] for rows in zip(*images)])


if __name__ == "__main__":
    {"above": above, "errors": errors, "beside": beside}[sys.argv[1]](sys.argv[2], sys.argv[3:])
