"""The scenes that both renderers are given: meshes as PLY, environments as OpenEXR, the rest as TOML or as a dictionary."""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi
import numpy as np


def material(rho_d, lobes=(), beta=0.0):
    return {"rho_d": list(rho_d), "beta": beta, "lobes": [{"rho_s": s, "c": c, "n": n} for s, c, n in lobes]}


def diffuse(*albedo):
    return material([a / math.pi for a in albedo])


def phong(albedo, strength, n):
    return material([a / math.pi for a in albedo], [([strength] * 3, [-1, -1, 1], n)])


@dataclass
class Scene:
    name: str
    camera: dict
    objects: list = field(default_factory=list)  # (mesh, material)
    lights: list = field(default_factory=list)
    environment: object = None  # radiance of a direction, arrays of shape (..., 3)


def grid(columns, rows, position, normal):
    """A mesh over u, v in 0..1, v up."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    u, v = u.ravel(), v.ravel()
    index = np.arange((columns + 1) * (rows + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return np.column_stack([position(u, v), normal(u, v), u, v]).astype("<f4"), faces.astype("<i4")


def sphere(centre, radius):
    def normal(u, v):
        polar, azimuth = math.pi * (1 - v), 2 * math.pi * u
        return np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1)

    return grid(384, 192, lambda u, v: np.asarray(centre) + radius * normal(u, v), normal)


def parallelogram(centre, u_edge, v_edge):
    """A flat mesh that faces u × v."""
    centre, u_edge, v_edge = (np.asarray(x, float) for x in (centre, u_edge, v_edge))
    normal = np.cross(u_edge, v_edge)
    normal /= np.linalg.norm(normal)
    place = lambda u, v: centre + np.outer(u - 0.5, u_edge) + np.outer(v - 0.5, v_edge)
    return grid(1, 1, place, lambda u, v: np.tile(normal, (len(u), 1)))


def write_ply(path, mesh):
    vertices, faces = mesh
    names = ["x", "y", "z", "nx", "ny", "nz", "u", "v"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    records = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    records["count"], records["corners"] = 3, faces
    path.write_bytes("\n".join(header).encode() + vertices.tobytes() + records.tobytes())


def directions(width, height, centre_u, rows):
    """Directions of an equirectangular image's pixels; `centre_u` is the u of -z, `rows` the polar angles."""
    azimuth = ((np.arange(width) + 0.5) / width - centre_u) * 2 * math.pi
    polar, azimuth = np.meshgrid(rows, azimuth, indexing="ij")
    return np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], -1)


def write_environments(scene, folder):
    """The same radiance sampled where each renderer has its pixels: Mitsuba's first and last rows are the poles."""
    width, height = 1024, 512
    ours = directions(width, height, 0.5, (np.arange(height) + 0.5) / height * math.pi)
    theirs = directions(width, height, 0.0, np.arange(height) / (height - 1) * math.pi)
    for name, d in (("lobelia", ours), ("mitsuba", theirs)):
        pixels = scene.environment(d).astype(np.float32)
        mi.util.write_bitmap(str(folder / f"{scene.name}-{name}.exr"), mi.Bitmap(pixels), write_async=False)


def to_toml(scene, folder, width, height):
    """Writes the scene's files for Lobelia and returns the scene file's path."""
    lines = ['background = "environment"'] if scene.environment else []
    lines += ["[camera]", *(f"{key} = {value}" for key, value in scene.camera.items())]
    lines += [f"width = {width}", f"height = {height}"]
    if scene.environment:
        lines += ["[environment]", f'file = "{scene.name}-lobelia.exr"']
    for index, (mesh, spec) in enumerate(scene.objects):
        write_ply(folder / f"{scene.name}-{index}.ply", mesh)
        lobes = ", ".join(f"{{ rho_s = {l['rho_s']}, c = {l['c']}, n = {l['n']} }}" for l in spec["lobes"])
        lines += ["[[object]]", f'mesh = "{scene.name}-{index}.ply"', "[object.material]"]
        lines += [f"rho_d = {spec['rho_d']}", f"beta_deg = {math.degrees(spec['beta'])}", f"lobes = [{lobes}]"]
    for light in scene.lights:
        lines += ["[[light]]", *(f"{k} = {json.dumps(v)}" for k, v in light.items())]
    path = folder / f"{scene.name}.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def emitter(light):
    rgb = lambda values: {"type": "rgb", "value": values}
    if light["kind"] == "directional":
        direction = [-x for x in light["toward"]]
        return {"type": "directional", "direction": direction, "irradiance": rgb(light["irradiance"])}
    if light["kind"] == "point":
        return {"type": "point", "position": light["position"], "intensity": rgb(light["intensity"])}
    u, v = (np.asarray(edge, float) / 2 for edge in light["edges"])
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([u, v, normal, light["centre"]])
    shape = {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix)}
    return shape | {"bsdf": {"type": "diffuse", "reflectance": 0.0}, "emitter": {"type": "area", "radiance": rgb(light["radiance"])}}


def to_mitsuba(scene, folder, width, height):
    """The scene as Mitsuba's; `to_toml` has written its meshes."""
    camera = scene.camera
    view = mi.ScalarTransform4f().look_at(origin=camera["position"], target=camera["target"], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": camera["fov_deg"], "fov_axis": "y", "to_world": view, "film": film}
    sensor |= {"near_clip": 1e-3, "far_clip": 1e4, "sampler": {"type": "independent"}}
    parts = {"type": "scene", "integrator": {"type": "path", "max_depth": 65}, "sensor": sensor}
    for index, (_, spec) in enumerate(scene.objects):
        bsdf = {"type": "lafortune", "spec": json.dumps(spec)}
        if not spec["lobes"]:
            reflectance = {"type": "rgb", "value": [math.pi * x for x in spec["rho_d"]]}
            bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
        mesh = str(folder / f"{scene.name}-{index}.ply")
        parts[f"object{index}"] = {"type": "ply", "filename": mesh, "bsdf": bsdf}
    for index, light in enumerate(scene.lights):
        parts[f"light{index}"] = emitter(light)
    if scene.environment:
        parts["environment"] = {"type": "envmap", "filename": str(folder / f"{scene.name}-mitsuba.exr")}
    return mi.load_dict(parts)


def sky(d):
    """A smooth sky with a bright spot."""
    sun = np.asarray([0.48, 0.6, 0.64])
    spot = 25 * np.exp(30 * (d @ sun / np.linalg.norm(sun) - 1))
    blue = np.stack([0.4 + 0.2 * d[..., 0], 0.5 + 0.2 * d[..., 1], 0.8 + 0.3 * d[..., 1]], -1)
    return blue + spot[..., None] * np.asarray([1.0, 0.9, 0.7])


def all_scenes():
    camera = {"position": [0.6, 1.5, 4.5], "target": [0.0, 0.6, 0.0], "fov_deg": 32.0}
    floor = parallelogram([0, 0, 0], [8, 0, 0], [0, 0, -8])
    balls = [
        (sphere([-0.75, 0.6, 0], 0.6), phong([0.1, 0.2, 0.5], 0.6, 40)),
        (sphere([0.75, 0.6, 0.1], 0.6), material([0.05] * 3, [([0.25, 0.2, 0.1], [-1.05, -1.05, 0.7], 12), ([0.2] * 3, [0.8, 0.8, 0.6], 5)])),
    ]
    brushed = material([0.1, 0.09, 0.08], [([0.5, 0.45, 0.4], [-1.0, -0.85, 0.9], 30)], beta=0.5)
    window = {"kind": "rectangle", "centre": [0.5, 3.0, 1.0], "edges": [[1.2, 0, 0], [0, 0, 0.8]], "radiance": [12.0, 11.0, 9.0]}
    lamps = [
        {"kind": "directional", "toward": [0.48, 0.64, 0.6], "irradiance": [2.0, 1.9, 1.7]},
        {"kind": "point", "position": [-2.0, 2.5, 1.5], "intensity": [4.0, 5.0, 6.0]},
    ]
    walls = [
        (parallelogram([0, 0, 0], [2, 0, 0], [0, 0, -2]), diffuse(0.7, 0.7, 0.7)),
        (parallelogram([0, 2, 0], [2, 0, 0], [0, 0, 2]), diffuse(0.7, 0.7, 0.7)),
        (parallelogram([0, 1, -1], [2, 0, 0], [0, 2, 0]), phong([0.3, 0.3, 0.3], 0.3, 15)),
        (parallelogram([-1, 1, 0], [0, 0, -2], [0, 2, 0]), diffuse(0.65, 0.05, 0.05)),
        (parallelogram([1, 1, 0], [0, 0, 2], [0, 2, 0]), diffuse(0.12, 0.5, 0.15)),
        (sphere([0.3, 0.4, 0.1], 0.4), phong([0.2, 0.2, 0.2], 3.0, 60)),
    ]
    ceiling = {"kind": "rectangle", "centre": [0, 1.98, 0], "edges": [[0.6, 0, 0], [0, 0, 0.6]], "radiance": [15.0, 14.0, 12.0]}
    inside = {"position": [0, 1, 4.2], "target": [0, 1, 0], "fov_deg": 38.0}
    return [
        Scene("lamps", camera, [(floor, brushed), *balls], lamps),
        Scene("window", camera, [(floor, brushed), *balls], [window]),
        Scene("sky", camera, [(floor, diffuse(0.5, 0.5, 0.5)), *balls], [], sky),
        Scene("box", inside, walls, [ceiling]),
    ]
