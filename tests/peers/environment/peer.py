"""Lobelia's prefiltering beside Filament's cmgen: CPU time, memory and error of maps of equal size under lobes of equal width.

python peer.py LOBELIA CMGEN FOLDER: two built commands; FOLDER takes environments, maps and report.json.

Each is judged by quadrature of its own lobe over the same analytic light: cmgen filters by GGX about the normal, Lobelia by the power
of a cosine. Lobes are as wide as each other when the mean cosine under them is the same. For diffuse light both have the cosine.
"""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR

ROWS = 1024  # of the environment that both are given
SAMPLES = [1024, 4096, 16384]
DIRECTIONS = 128
FACES = {
    "px": lambda x, y: (np.ones_like(x), y, -x),
    "nx": lambda x, y: (-np.ones_like(x), y, x),
    "py": lambda x, y: (x, np.ones_like(x), -y),
    "ny": lambda x, y: (x, -np.ones_like(x), y),
    "pz": lambda x, y: (x, y, np.ones_like(x)),
    "nz": lambda x, y: (-x, y, -np.ones_like(x)),
}

def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v, axis=-1, keepdims=True)


SUN = unit([0.4, 0.6, 0.7])
LAMPS = [(SUN, 2000.0, 3000.0), (unit([-0.8, 0.3, 0.1]), 60.0, 8.0), (unit([0.3, -0.2, -0.9]), 20.0, 3.0)]


def radiance(d):
    """A sky with a sun of 2.6°, two lamps and a darker ground; smooth, so that how an image is sampled does not matter."""
    sky = 0.3 + 0.2 * np.tanh(4 * d[..., 1])
    return sky + sum(power * np.exp(k * (d @ axis - 1)) for axis, k, power in LAMPS)


def face_directions(name, size):
    at = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(at, -at)
    return unit(np.stack(FACES[name](x, y), -1))


def equirect_directions(rows):
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows * np.pi, ((np.arange(2 * rows) + 0.5) / rows - 1) * np.pi, indexing="ij")
    return np.stack([np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)], -1)


def write(path, image):
    pixels = np.repeat(image[..., None], 3, -1).astype("f4")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": pixels}).write(str(path))


def read(path):
    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        pixels = channels["RGB"].pixels if "RGB" in channels else next(c.pixels for k, c in channels.items() if k.startswith(("RGBA", "G")))
    return np.asarray(pixels, float)[..., 1] if pixels.ndim == 3 else np.asarray(pixels, float)


# A process of its own waits for the command: Linux counts the memory of whoever starts a program as the program's.
WAITER = """
import os, sys
pid = os.posix_spawnp(sys.argv[1], sys.argv[1:], os.environ, file_actions=[(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)])
_, status, usage = os.wait4(pid, 0)
print(status, usage.ru_utime + usage.ru_stime, usage.ru_maxrss)
"""


def run(command):
    """Runs a command; returns CPU seconds and peak memory in MB."""
    command = [str(part) for part in command]
    waiter = subprocess.run([sys.executable, "-I", "-S", "-c", WAITER, *command], capture_output=True, text=True, check=True)
    status, seconds, kilobytes = waiter.stdout.split()
    if int(status) != 0:
        raise RuntimeError(f"{command} failed")
    return float(seconds), int(kilobytes) / 1024


def power(n):
    return lambda cosine: np.maximum(cosine, 0.0) ** n


def ggx(alpha):
    """D(h) (N·L) with the view along the normal: h is half-way between it and the light."""

    def kernel(cosine):
        square = (1 + cosine) / 2
        return np.where(cosine > 0, cosine / (square * (alpha**2 - 1) + 1) ** 2, 0.0)

    return kernel


def mean_cosine(kernel):
    cosine = (np.arange(400_000) + 0.5) / 400_000
    weight = kernel(cosine)
    return (weight * cosine).sum() / weight.sum()


def exponent_as_wide(kernel):
    mean = mean_cosine(kernel)
    return (2 * mean - 1) / (1 - mean)


class Truth:
    """Filtered light by midpoint quadrature over the whole sphere."""

    def __init__(self, rows=600):
        self.directions = equirect_directions(rows).reshape(-1, 3)
        solid_angle = np.abs(np.sin((np.arange(rows) + 0.5) / rows * np.pi)).repeat(2 * rows)
        self.flux = radiance(self.directions) * solid_angle
        self.solid_angle = solid_angle
        self.known = {}

    def at(self, toward, kernel):
        weights = kernel(self.directions @ toward)
        return (weights @ self.flux) / (weights @ self.solid_angle)

    def error(self, name, maps, kernel):
        """Relative RMS error over directions, half anywhere, half about the sun; ε is a tenth of the mean.

        Truths are kept by name, since maps of the same lobe and size are compared in the same directions.
        """
        toward, values = maps
        rng = np.random.default_rng(1)
        anywhere = unit(rng.normal(size=(DIRECTIONS // 2, 3)))
        spread = math.sqrt(32 / (exponent_as_wide(kernel) + 1)) * np.sqrt(rng.uniform(size=(DIRECTIONS // 2, 1)))
        about = unit(SUN + np.tan(np.minimum(spread, 1.4)) * unit(np.cross(SUN, rng.normal(size=(DIRECTIONS // 2, 3)))))
        picked = [int(np.argmax(toward @ d)) for d in np.concatenate([anywhere, about])]
        if name not in self.known:
            self.known[name] = np.array([self.at(toward[i], kernel) for i in picked])
        truth = self.known[name]
        floor = 0.1 * self.flux.sum() / self.solid_angle.sum()
        return float(np.sqrt((((values[picked] - truth) ** 2) / (truth**2 + floor**2)).mean()))


def cubemap(folder, stem, size):
    toward = np.concatenate([face_directions(name, size).reshape(-1, 3) for name in FACES])
    values = np.concatenate([read(folder / f"{stem}{name}.exr").reshape(-1) for name in FACES])
    return toward, values


def equirect(path):
    image = read(path)
    return equirect_directions(image.shape[0]).reshape(-1, 3), image.reshape(-1)


def levels(size, smallest=16):
    """cmgen's levels: pixels of a face and roughness α."""
    count = int(math.log2(size // smallest)) + 1
    return [(size >> k, (1 - math.sqrt(1 - k / (count - 1))) ** 2) for k in range(1, count)]


def rows_as_large(size):
    return round(math.sqrt(3 * size * size))


def main():
    lobelia, cmgen, folder = Path(sys.argv[1]).resolve(), sys.argv[2], Path(sys.argv[3]).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    directions = equirect_directions(ROWS)
    write(folder / "sky.exr", radiance(directions))
    # The middle of cmgen's images is +z.
    write(folder / "flipped.exr", radiance(directions * [1, 1, -1]))
    truth = Truth()
    report = []

    def ours(task, lobes):
        """`lobes`: (exponent, pixels of a face as large)."""
        seconds, memory, errors = 0.0, 0.0, []
        for n, size in lobes:
            output = folder / "lobelia"
            used = run([lobelia, "prefilter", folder / "sky.exr", "-n", f"{n:.6g}", "--height", rows_as_large(size), "-o", output, "--quiet"])
            seconds, memory = seconds + used[0], max(memory, used[1])
            errors.append(truth.error(("lobelia", n), equirect(output / f"n-{float(f'{n:.6g}'):.9g}.exr"), power(n)))
        tell(task, "lobelia", "", seconds, memory, errors)
        return seconds

    def theirs(task, option, size, lobes, stem):
        """`lobes`: (kernel, pixels of a face). Time for loading, building its levels and writing is taken off."""
        for samples in SAMPLES:
            output = folder / "cmgen"
            command = [cmgen, "-q", "-f", "exr", "--no-mirror", f"--size={size}", f"--{option}={output}", folder / "flipped.exr"]
            idle = run([*command[:-1], "--ibl-samples=1", command[-1]])[0]
            seconds, memory = run([*command[:-1], f"--ibl-samples={samples}", command[-1]])
            errors = [truth.error((task, k), cubemap(output / "flipped", stem(k), s), kernel) for k, (kernel, s) in enumerate(lobes)]
            tell(task, "cmgen", samples, seconds - idle, memory, errors)

    def tell(task, tool, samples, seconds, memory, errors):
        report.append({"task": task, "tool": tool, "samples": samples, "cpu_seconds": seconds, "peak_memory_mb": memory, "errors": errors})
        listed = "  ".join(f"{100 * error:8.2g} %" for error in errors)
        print(f"{task:9} {tool:8} {samples!s:>7} {seconds:8.2f} {memory:8.0f}   {listed}", flush=True)

    print("task      tool     samples    CPU s       MB   relative RMS error of every map")
    ours("diffuse", [(1.0, 64)])
    theirs("diffuse", "ibl-irradiance", 64, [(power(1.0), 64)], lambda _: "i_")
    glossy = [(ggx(alpha), size) for size, alpha in levels(256)]
    print("exponents as wide:", "  ".join(f"{exponent_as_wide(kernel):.4g}" for kernel, _ in glossy))
    ours("glossy", [(exponent_as_wide(kernel), size) for kernel, size in glossy])
    theirs("glossy", "ibl-ld", 256, glossy, lambda k: f"m{k + 1}_")
    (folder / "report.json").write_text(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
