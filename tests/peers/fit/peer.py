"""Fits the same samples with Lobelia, SciPy and Ceres, each on one core, and compares texels a second of CPU time and cost.

peer.py LOBELIA FOLDER. All three minimise the sum over samples and channels of (model - sample)^2 for a diffuse term and
isotropic lobes with RGB albedos. The cost of all three is computed here, from their coefficients.
"""

import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenEXR
import zarr
from scipy.optimize import least_squares

SIZE = 128
POSES = 456
# Texels that the others fit, spread over the sample.
TEXELS = {"Ceres": 512, "SciPy, tuned": 48, "SciPy": 24}
# Base = ACROSS sin(angle) plane + ALONG cos(angle) zz: of C = (-1, -1, 1) the base is 1 in the mirror direction.
ACROSS, ALONG = np.sqrt(1.5), np.sqrt(3)


def products(store):
    """[texel, sample] of wi.x wo.x + wi.y wo.y and wi.z wo.z, and [texel, sample, 3] of the reflectance."""
    group = zarr.open_group(store, mode="r")
    rgb = group["reflectance"][:].astype(float)
    height, width, _, _ = rgb.shape
    mm = group.attrs["texel_mm"]
    x = (np.arange(width) + 0.5 - width / 2) * mm
    y = (height / 2 - np.arange(height) - 0.5) * mm
    place = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 0.0), -1).reshape(-1, 1, 3)

    def towards(points):
        rays = points[None, :, :] - place
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    wi, wo = towards(group["light_position_mm"][:]), towards(group["camera_position_mm"][:])
    both = wi * wo
    return both[..., 0] + both[..., 1], both[..., 2], rgb.reshape(height * width, -1, 3)


def model(x, plane, zz):
    """The model's values [sample, 3] for rho_d, then albedo, angle and ln n a lobe."""
    values = np.broadcast_to(x[:3], (len(plane), 3)).copy()
    for lobe in x[3:].reshape(-1, 5):
        base = np.sin(lobe[3]) * ACROSS * plane + np.cos(lobe[3]) * ALONG * zz
        shape = np.where(base > 1e-12, np.maximum(base, 1e-12) ** np.exp(lobe[4]), 0.0)
        values += shape[:, None] * lobe[:3]
    return values


def jacobian(x, plane, zz):
    rows = np.zeros((len(plane), 3, len(x)))
    rows[:, [0, 1, 2], [0, 1, 2]] = 1.0
    for j, lobe in enumerate(x[3:].reshape(-1, 5)):
        at, n = 3 + 5 * j, np.exp(lobe[4])
        base = np.sin(lobe[3]) * ACROSS * plane + np.cos(lobe[3]) * ALONG * zz
        safe = np.maximum(base, 1e-12)
        log = np.log(safe)
        shape = np.where(base > 1e-12, np.exp(n * log), 0.0)
        slope = shape * n / safe * (np.cos(lobe[3]) * ACROSS * plane - np.sin(lobe[3]) * ALONG * zz)
        for c in range(3):
            rows[:, c, at + c] = shape
            rows[:, c, at + 3] = lobe[c] * slope
            rows[:, c, at + 4] = lobe[c] * shape * n * log
    return rows.reshape(-1, len(x))


def start(lobes):
    """The source's start: Phong's lobe with n = 10, then a retro-reflective one with n = 5."""
    one = [0.1, 0.1, 0.1, np.arctan2(-np.sqrt(2), 1), np.log(10)]
    two = [0.1, 0.1, 0.1, np.arctan2(np.sqrt(2), 1), np.log(5)]
    return np.array([0.05] * 3 + (one + two)[: 5 * lobes])


def by_scipy(plane, zz, rgb, lobes, tuned):
    """Coefficients and seconds of least_squares: as it comes (trust regions, Jacobian by differences), or `tuned`: with MINPACK's
    Levenberg-Marquardt and the analytic Jacobian, its fastest way."""
    begin, found = time.process_time(), []
    for p, z, f in zip(plane, zz, rgb):
        residual = lambda x: (model(x, p, z) - f).ravel()
        more = {"jac": lambda x: jacobian(x, p, z), "method": "lm"} if tuned else {}
        found.append(least_squares(residual, start(lobes), **more).x)
    return np.array(found), time.process_time() - begin


def by_ceres(folder, plane, zz, rgb, lobes):
    texels, samples = plane.shape
    with open(folder / "samples.bin", "wb") as file:
        file.write(np.array([texels, samples], np.int32).tobytes())
        for p, z, f in zip(plane, zz, rgb):
            file.write(p.tobytes() + z.tobytes() + f.tobytes())
    subprocess.run([folder / "ceres", folder / "samples.bin", folder / "found.bin", str(lobes)], check=True)
    values = np.fromfile(folder / "found.bin")
    return values[1:].reshape(texels, -1), values[0]


def by_lobelia(program, folder, lobes):
    """Coefficients in this script's form and seconds of the whole command, files included."""
    output = folder / "lobelia.exr"
    options = ["--lobes", str(lobes), "--isotropic", "--residual", "linear", "--threads", "1", "--quiet"]
    # The others have no bound on albedos; theirs is the problem without it.
    options.append("--no-bound")
    command = [program, "fit", folder / "samples.zarr", "-o", output] + options
    seconds = lambda: resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime + resource.getrusage(resource.RUSAGE_CHILDREN).ru_stime
    before = seconds()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    taken = seconds() - before
    channels = OpenEXR.File(str(output), separate_channels=True).channels()
    plane = lambda name: channels[name].pixels.astype(float).ravel()
    columns = [plane(f"rho_d.{c}") for c in "RGB"]
    for j in range(lobes):
        cx, cz, n = plane(f"lobe{j}.C.x"), plane(f"lobe{j}.C.z"), plane(f"lobe{j}.n")
        length = np.hypot(np.sqrt(2) * cx, cz) / np.sqrt(3)
        columns += [plane(f"lobe{j}.rho_s.{c}") * length**n for c in "RGB"]
        columns += [np.arctan2(np.sqrt(2) * cx, cz), np.log(n)]
    return np.stack(columns, -1), taken


def costs(found, plane, zz, rgb):
    return np.array([np.sum((model(x, p, z) - f) ** 2) for x, p, z, f in zip(found, plane, zz, rgb)])


def main(program, folder):
    folder = Path(folder)
    recipe = Path(__file__).with_name("material.toml")
    synth = [program, "synth", recipe, "-o", folder / "samples.zarr", "--size", f"{SIZE}x{SIZE}", "--poses", str(POSES)]
    subprocess.run(synth + ["--noise", "1e-3", "--quiet"], check=True, stdout=subprocess.DEVNULL)
    plane, zz, rgb = products(folder / "samples.zarr")
    print(f"{SIZE * SIZE} texels x {POSES} RGB samples, noise 1e-3 1/sr, texels a second of CPU time; {TEXELS} texels for the others")
    print("lobes  by             texels/s   Lobelia's rate   cost / Lobelia's: median  best  worst   cost above 1.001 x the other's")
    for lobes in (1, 2):
        found, seconds = by_lobelia(program, folder, lobes)
        own, rate = costs(found, plane, zz, rgb), SIZE * SIZE / seconds
        print(f"{lobes:5}  Lobelia       {rate:9.0f}")
        for name in TEXELS:
            at = np.linspace(0, SIZE * SIZE - 1, TEXELS[name]).astype(int)
            if name == "Ceres":
                found, seconds = by_ceres(folder, plane[at], zz[at], rgb[at], lobes)
            else:
                found, seconds = by_scipy(plane[at], zz[at], rgb[at], lobes, name == "SciPy, tuned")
            ratio = costs(found, plane[at], zz[at], rgb[at]) / own[at]
            other = len(at) / seconds
            print(
                f"{lobes:5}  {name:12}  {other:9.1f}   {rate / other:10.1f} x      {np.median(ratio):21.6f}"
                f"  {ratio.min():.6f}  {ratio.max():.3f}   Lobelia {np.mean(ratio < 1 / 1.001):.1%}, {name} {np.mean(ratio > 1.001):.1%}"
            )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
