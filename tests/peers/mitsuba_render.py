"""Renders a scene that `examples/peer_scenes.rs` wrote with Mitsuba 3.

    mitsuba_render.py SCENE.json OUT.npz [--spp 64] [--seeds 16]

Writes `seeds`, the pictures of all seeds, float32 [seed][y][x][channel], and beside the .npz their mean as .exr.

SCENE.json:
    width, height   pixels
    max_bounces     reflections after which a path ends
    camera          eye, target, up, vertical_fov (degrees)
    lights          as relight writes them: type point, spot or directional; candela, lux, radians; or
                    rect or disk: position, half axes u and v, normal; sphere: position, radius; each with radiance [r, g, b];
                    environment: file (float32 [y][x][channel], columns centred on theirs, rows from pole to pole), width, height
    meshes          positions [[x, y, z]], normals (one per position), triangles [[a, b, c]], reflectance [r, g, b],
                    emission [r, g, b]; where there is a texture (file: sRGB bytes [y][x][rgba], width, height), uvs
"""

import argparse
import json
import math
import pathlib
import tempfile

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)

# A hard cone still has a ramp of this width in cos θ (`cone_ramp` in src/light/table.rs).
LEAST_RAMP = 1e-4


def rgb(value):
    return {"type": "rgb", "value": [float(v) for v in value]}


def emitter(light):
    area = lambda: {"type": "area", "radiance": rgb(light["radiance"])}
    if light["type"] in ("rect", "disk"):
        columns = np.eye(4)
        columns[:3, 0], columns[:3, 1], columns[:3, 2] = light["u"], light["v"], light["normal"]
        columns[:3, 3] = light["position"]
        shape = {"rect": "rectangle", "disk": "disk"}[light["type"]]
        return {"type": shape, "to_world": mi.ScalarTransform4f(columns.tolist()), "emitter": area()}
    if light["type"] == "sphere":
        return {"type": "sphere", "center": light["position"], "radius": light["radius"], "emitter": area()}
    if light["type"] == "environment":
        shape = (light["height"], light["width"], 3)
        pixels = np.fromfile(light["file"], "<f4").reshape(shape)
        return {"type": "envmap", "bitmap": mi.Bitmap(pixels)}
    colour = np.array(light.get("color", [1, 1, 1])) * light["intensity"]
    if light.get("range") is not None:
        raise ValueError("Mitsuba's lights have no range")
    if light["type"] == "point":
        return {"type": "point", "position": light["position"], "intensity": rgb(colour)}
    if light["type"] == "directional":
        return {"type": "directional", "direction": light["direction"], "irradiance": rgb(colour)}
    if light["type"] == "spot":
        if light["inner_cone_angle"] != light["outer_cone_angle"]:
            raise ValueError("Mitsuba's cone falls off otherwise than glTF's: only hard cones are comparable")
        # The squared ramp of a hard cone keeps a third of its width: the cone of equal flux is narrower by the rest.
        cutoff = math.degrees(math.acos(math.cos(light["outer_cone_angle"]) + LEAST_RAMP * 2 / 3))
        position, direction = np.array(light["position"]), np.array(light["direction"])
        up = np.eye(3)[np.argmin(np.abs(direction))]
        return {
            "type": "spot",
            "to_world": mi.ScalarTransform4f().look_at(
                origin=position.tolist(), target=(position + direction).tolist(), up=up.tolist()
            ),
            "intensity": rgb(colour),
            "cutoff_angle": cutoff,
            "beam_width": cutoff * (1 - 1e-6),
        }
    raise ValueError(f"light type {light['type']}")


def write_ply(path, mesh):
    columns, names = [mesh["positions"], mesh["normals"]], ["x", "y", "z", "nx", "ny", "nz"]
    if "uvs" in mesh:
        columns, names = [*columns, mesh["uvs"]], [*names, "u", "v"]
    vertices = np.hstack(columns)
    with open(path, "w") as file:
        file.write(f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n")
        file.writelines(f"property float {name}\n" for name in names)
        file.write(f"element face {len(mesh['triangles'])}\nproperty list uchar int vertex_indices\nend_header\n")
        file.writelines(" ".join(f"{x:.9g}" for x in v) + "\n" for v in vertices)
        file.writelines("3 " + " ".join(map(str, t)) + "\n" for t in mesh["triangles"])


def texture(mesh):
    """Linear, so that texels are interpolated as relight does: after decoding; the base colour is multiplied in."""
    image = mesh["texture"]
    codes = np.fromfile(image["file"], np.uint8).reshape(image["height"], image["width"], 4)[..., :3] / 255.0
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4) * mesh["reflectance"]
    return {"type": "bitmap", "bitmap": mi.Bitmap(linear.astype(np.float32)), "raw": True}


def shapes(description, folder):
    """The meshes, as entries of a scene; their files go into `folder`."""
    entries = {}
    for i, mesh in enumerate(description["meshes"]):
        path = pathlib.Path(folder) / f"mesh{i}.ply"
        write_ply(path, mesh)
        # relight's surfaces reflect on both sides.
        diffuse = {"type": "diffuse", "reflectance": rgb(mesh["reflectance"])}
        if "texture" in mesh:
            diffuse["reflectance"] = texture(mesh)
        entries[f"mesh{i}"] = {"type": "ply", "filename": str(path), "bsdf": {"type": "twosided", "diffuse": diffuse}}
        if any(mesh["emission"]):
            entries[f"mesh{i}"]["emitter"] = {"type": "area", "radiance": rgb(mesh["emission"])}
    return entries


def load(description, folder):
    camera = description["camera"]
    scene = {
        "type": "scene",
        # A path's depth counts its edges: one to the camera and one to the light beside the reflections between.
        # relight's cameras see the asset alone, not the environment around it.
        "integrator": {
            "type": "path",
            "max_depth": description["max_bounces"] + 3,
            "hide_emitters": any(light["type"] == "environment" for light in description["lights"]),
        },
        "sensor": {
            "type": "perspective",
            "fov": camera["vertical_fov"],
            "fov_axis": "y",
            "to_world": mi.ScalarTransform4f().look_at(
                origin=camera["eye"], target=camera["target"], up=camera["up"]
            ),
            "film": {
                "type": "hdrfilm",
                "width": description["width"],
                "height": description["height"],
                "rfilter": {"type": "box"},
            },
        },
    }
    for i, light in enumerate(description["lights"]):
        scene[f"light{i}"] = emitter(light)
    scene.update(shapes(description, folder))
    return mi.load_dict(scene)


def render(description, spp, seeds):
    """Pictures, float32 [seed][y][x][channel]."""
    with tempfile.TemporaryDirectory() as folder:
        scene = load(description, folder)
        return np.stack([np.array(mi.render(scene, spp=spp, seed=seed))[..., :3] for seed in range(seeds)])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=pathlib.Path)
    parser.add_argument("output", type=pathlib.Path)
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel and seed")
    parser.add_argument("--seeds", type=int, default=16)
    arguments = parser.parse_args()
    pictures = render(json.loads(arguments.scene.read_text()), arguments.spp, arguments.seeds)
    np.savez_compressed(arguments.output, seeds=pictures)
    mi.Bitmap(pictures.mean(axis=0)).write(str(arguments.output.with_suffix(".exr")))


if __name__ == "__main__":
    main()
