"""Lobelia's reference renderer against Mitsuba 3 on the same scenes: Z-tests of tiles, and time to equal error in one run.

python peer.py LOBELIA FOLDER: LOBELIA is the built command, FOLDER takes scenes, pictures and report.json.
"""

import json
import math
import resource
import subprocess
import sys
import time
from pathlib import Path
from statistics import NormalDist

import mitsuba as mi

mi.set_variant("llvm_ad_rgb")

import drjit as dr
import numpy as np

import lafortune
import scenes

ALPHA = 0.01
TILE = 8


def read(path):
    return np.array(mi.Bitmap(str(path)).convert(component_format=mi.Struct.Type.Float32))[..., :3].astype(float)


def tiles(image):
    height, width, channels = image.shape
    return image.reshape(height // TILE, TILE, width // TILE, TILE, channels).mean((1, 3))


def ours(lobelia, scene, picture, samples, seed, *more):
    """Renders a scene file with Lobelia; returns the picture and CPU seconds, start-up and loading included."""
    command = [lobelia, "render", scene, "-o", picture, "--method", "reference", "--samples", samples, "--seed", seed, "--quiet", *more]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return read(picture), after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def theirs(scene, samples, seed):
    """Renders with Mitsuba; returns the picture and CPU seconds of the rendering alone."""
    before = time.process_time()
    image = np.array(mi.render(scene, spp=samples, seed=seed)).astype(float)
    return image, time.process_time() - before


def agree(lobelia, scene, folder, width=64, height=48, samples=64, runs=16):
    """The largest deviate of all tiles and channels against what chance allows (Šidák)."""
    path = scenes.to_toml(scene, folder, width, height)
    peer = scenes.to_mitsuba(scene, folder, width, height)
    a = np.stack([tiles(ours(lobelia, path, folder / f"{scene.name}.exr", samples, seed)[0]) for seed in range(runs)])
    b = np.stack([tiles(theirs(peer, samples, seed)[0]) for seed in range(runs)])
    va, vb = a.var(0, ddof=1) / runs, b.var(0, ddof=1) / runs
    a, b = a.mean(0), b.mean(0)
    lit = b > 0
    cells = int(lit.sum())
    limit = NormalDist().inv_cdf(0.5 + 0.5 * (1 - ALPHA) ** (1 / cells))
    # Welch's t with its degrees of freedom, as a normal deviate (Wallace 1959).
    spread = np.maximum(va + vb, 1e-20)[lit]
    degrees = spread**2 * (runs - 1) / np.maximum(va**2 + vb**2, 1e-40)[lit]
    t = np.abs(a - b)[lit] / np.sqrt(spread)
    z = (8 * degrees + 1) / (8 * degrees + 3) * np.sqrt(degrees * np.log1p(t**2 / degrees))
    return {
        "scene": scene.name,
        "cells": cells,
        "largest_deviate": float(z.max()),
        "limit": limit,
        "rms_deviate": float(np.sqrt((z**2).mean())),
        "relative_standard_error": float(np.sqrt(spread.mean()) / b.mean()),
        "relative_difference": float(a.mean() / b.mean() - 1),
        "agrees": bool(z.max() <= limit),
    }


def speed(lobelia, scene, folder, width=320, height=240, samples=64, runs=6):
    """CPU seconds times relative variance, Lobelia's over Mitsuba's: the ratio of times to equal error.

    Start-up, loading and compiling are left out on both sides.
    """
    path = scenes.to_toml(scene, folder, width, height)
    start_up = ours(lobelia, path, folder / "speed.exr", 1, 0, "--width", 8, "--height", 8)[1]
    peer = scenes.to_mitsuba(scene, folder, width, height)
    theirs(peer, samples, 1000)  # compiles the kernels
    a, b, times = [], [], [0.0, 0.0]
    for seed in range(runs):
        image, seconds = ours(lobelia, path, folder / "speed.exr", samples, seed)
        a.append(image)
        times[0] += (seconds - start_up) / runs
        image, seconds = theirs(peer, samples, seed)
        b.append(image)
        times[1] += seconds / runs
    mean = (np.mean(a, 0) + np.mean(b, 0)) / 2
    weight = 1 / (mean**2 + (0.1 * mean.mean()) ** 2)
    errors = [float((np.var(images, 0, ddof=1) * weight).mean()) for images in (a, b)]
    return {
        "scene": scene.name,
        "lobelia_cpu_seconds": times[0],
        "mitsuba_cpu_seconds": times[1],
        "lobelia_relative_rmse": math.sqrt(errors[0]),
        "mitsuba_relative_rmse": math.sqrt(errors[1]),
        "time_to_equal_error": times[0] * errors[0] / (times[1] * errors[1]),
    }


def main():
    lobelia, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    lafortune.register()
    every = scenes.all_scenes()
    agreement, speeds = [], []
    print("scene    cells  largest deviate (limit)  rms deviate  noise      difference of means")
    for scene in every:
        if scene.environment:
            scenes.write_environments(scene, folder)
        row = agree(lobelia, scene, folder)
        agreement.append(row)
        print(
            f"{row['scene']:8} {row['cells']:5}  {row['largest_deviate']:8.2f} ({row['limit']:.2f})"
            f"  {row['rms_deviate']:18.2f}  {row['relative_standard_error']:9.2%}  {row['relative_difference']:9.3%}"
            f"  {'agrees' if row['agrees'] else 'DIFFERS'}",
            flush=True,
        )
    print("\nscene    CPU s: Lobelia  Mitsuba   relative RMSE: Lobelia  Mitsuba   time to equal error")
    for scene in every:
        row = speed(lobelia, scene, folder)
        speeds.append(row)
        print(
            f"{row['scene']:8} {row['lobelia_cpu_seconds']:14.2f} {row['mitsuba_cpu_seconds']:8.2f}"
            f" {row['lobelia_relative_rmse']:24.3%} {row['mitsuba_relative_rmse']:8.3%}   {row['time_to_equal_error']:.2f}",
            flush=True,
        )
    report = {"mitsuba": mi.__version__, "variant": mi.variant(), "agreement": agreement, "speed": speeds}
    (folder / "report.json").write_text(json.dumps(report, indent=2))
    return 0 if all(row["agrees"] for row in agreement) else 1


if __name__ == "__main__":
    sys.exit(main())
