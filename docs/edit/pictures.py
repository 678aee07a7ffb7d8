"""Makes the pictures of docs/edit.md: python3 docs/edit/pictures.py LOBELIA WORK_FOLDER

LOBELIA is the command; WORK_FOLDER takes the maps and keeps them. Draws a piece of wood, threads and masks, since no
photograph is part of Lobelia. Needs nothing but Python.
"""

import math
import random
import struct
import subprocess
import sys
import zlib
from pathlib import Path

LOBELIA = Path(sys.argv[1]).resolve()
WORK = Path(sys.argv[2])
DOCS = Path(__file__).parent.resolve()
WORK.mkdir(parents=True, exist_ok=True)


def lobelia(*words):
    print("lobelia", *words, flush=True)
    subprocess.run([LOBELIA, *map(str, words), "--quiet"], cwd=WORK, check=True)


def write_png(path, width, height, pixel):
    """An RGB PNG of pixel(x, y) -> three values 0..255."""
    clamp = lambda v: max(0, min(255, round(v)))
    rows = b"".join(
        b"\0" + bytes(clamp(v) for x in range(width) for v in pixel(x, y)) for y in range(height)
    )
    chunk = lambda name, data: (
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    )
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")
    )


def wood(x, y):
    """Growth rings cut lengthwise, with short dark pores."""
    bend = 6 * math.sin(y / 47) + 3 * math.sin(y / 19 + x / 60)
    ring = (x + bend) / 17
    late = (ring % 1) ** 3
    pore = random.Random(int(x + bend) * 7919 + int(y / 14)).random() < 0.05
    light = (1 - 0.42 * late) * (0.42 if pore else 1)
    return 150 * light, 84 * light, 46 * light


def threads(x, y, base):
    """A colour as a weave of threads four pixels wide."""
    over = (x // 4 + y // 4) % 2
    across = ((x if over else y) % 4 - 1.5) / 2
    light = 1.15 - 0.5 * across * across - (0.0 if over else 0.12)
    return tuple(v * light for v in base)


def scene(name, objects):
    (WORK / f"{name}.toml").write_text(
        """exposure = 1.0
background = "#202428"
[camera]
position = [0.0, 1.6, 4.6]
target = [0.0, 0.5, 0.0]
fov_deg = 24.0
width = 300
height = 225
[environment]
builtin = "studio"
[[light]]
kind = "directional"
toward = [0.5, 0.8, 0.5]
irradiance = [1.6, 1.5, 1.4]
[[light]]
kind = "point"
position = [-2.6, 2.2, 1.4]
intensity = [3.5, 4.0, 4.5]
"""
        + objects
    )
    lobelia("render", f"{name}.toml", "-o", DOCS / f"{name}.png", "--method", "reference", "--samples", 48)


def drape(name, material, tiling=2.0):
    """A draped cloth of a map."""
    scene(
        name,
        f'[[object]]\nmesh = "drape"\n[object.material]\nmap = "{material}"\ntiling = [{tiling}, {tiling}]\n',
    )


if not (WORK / "demo").exists():
    lobelia("demo", "--out", "demo")
BROCADE = "demo/material.exr"
drape("brocade", BROCADE)


def board(name, material, tiling):
    """A flat board of a map, turned toward the viewer."""
    scene(
        name,
        '[[object]]\nmesh = "plane"\ntranslate = [0.0, 0.6, 0.0]\nrotate_deg = [62.0, 0.0, 0.0]\nscale = [0.8, 0.8, 0.8]\n'
        f'[object.material]\nmap = "{material}"\ntiling = [{tiling}, {tiling}]\n',
    )


# A palette of four, the blue ground of which becomes black.
lobelia("edit", "cluster", BROCADE, "-k", 4, "-o", "palette.toml", "--index", DOCS / "index.png")
palette = (WORK / "palette.toml").read_text()
first, ground, rest = palette.partition("rho_d = ")
(WORK / "black.toml").write_text(first + "rho_d = [0.004, 0.004, 0.005]" + rest[rest.index("\n") :])
lobelia("edit", "palette", "black.toml", "--index", DOCS / "index.png", "-o", "black.exr")
drape("black", "black.exr")

# The mean of the whole brocade.
lobelia("edit", "mean", BROCADE, "-o", "mean.exr")
drape("mean", "mean.exr")

# Wood from a picture, repeated, and the same made tileable.
write_png(DOCS / "wood-photo.png", 128, 128, wood)
lobelia("edit", "from-photo", DOCS / "wood-photo.png", "-o", "wood.exr")
drape("wood", "wood.exr")
board("repeated", "wood.exr", 2.0)
lobelia("edit", "tile", "wood.exr", "--overlap", 24, "-o", "tile.exr")
board("tile", "tile.exr", 2.0 * 128 / 104)

# Brocade over wood, by a mask with a soft edge.
middle = lambda x, y: 255 * (1 / (1 + math.exp((math.hypot(x - 63.5, y - 63.5) - 44) / 2.5)))
write_png(DOCS / "mask.png", 128, 128, lambda x, y: (middle(x, y),) * 3)
lobelia("edit", "composite", "wood.exr", BROCADE, "--mask", DOCS / "mask.png", "-o", "composite.exr")
drape("composite", "composite.exr")

# Threads that 128 texels did not show, from a picture of twice the size.
COLOURS = {"blue": (52, 84, 142), "gold": (118, 98, 54), "green": (70, 128, 84), "red": (150, 48, 42)}


def brocade(x, y):
    u, v = x / 256 * 4.0, y / 256 * 2.0
    column = math.floor(u)
    across, down = (u - column - 0.5) * 0.5, (v + 0.5 * column) % 1 - 0.5
    radius, angle = math.hypot(across, down), math.atan2(down, across)
    along = (abs(down) - 0.36) / 0.13
    if radius < 0.075:
        return COLOURS["red"]
    if radius < 0.16 + 0.05 * math.cos(6 * angle):
        return COLOURS["gold"]
    return COLOURS["green"] if abs(across) < 0.085 * max(0, 1 - along * along) else COLOURS["blue"]


write_png(DOCS / "threads-photo.png", 256, 256, lambda x, y: threads(x, y, brocade(x, y)))
lobelia("edit", "replace-diffuse", BROCADE, "--photo", DOCS / "threads-photo.png", "-o", "threads.exr")
drape("threads", "threads.exr")
