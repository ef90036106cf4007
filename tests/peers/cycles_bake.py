"""Bakes conditions that `examples/peer_bake.rs` wrote with Blender's Cycles, one at a time: the pass DIFFUSE, indirect light only.

    cycles_bake.py FOLDER OUT.npz SAMPLES [CONDITION ...]

Writes `irradiance`, float32 [condition][texel][channel], with NaN where Cycles baked nothing, and `seconds` and `cpu_seconds`
per condition: one call of the bake operator, which carries the scene over to Cycles each time, as for any user who bakes
light after light. Needs `bpy` (PyPI) in a Python of the version that its wheels are for.
"""

import json
import math
import pathlib
import sys
import time

import bpy
import numpy as np
from mathutils import Vector


def add_asset(description, image):
    """One object of all meshes; every material's active image is the lightmap."""
    positions, triangles, materials, uvs = [], [], [], []
    asset = bpy.data.meshes.new("asset")
    for i, mesh in enumerate(description["meshes"]):
        first = len(positions)
        positions += mesh["positions"]
        triangles += [[first + v for v in t] for t in mesh["triangles"]]
        materials += [i] * len(mesh["triangles"])
        uvs += [mesh["lightmap_uvs"][v] for t in mesh["triangles"] for v in t]
        material = bpy.data.materials.new(f"material{i}")
        material.use_nodes = True
        nodes, links = material.node_tree.nodes, material.node_tree.links
        nodes.clear()
        diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
        diffuse.inputs["Color"].default_value = (*mesh["reflectance"], 1.0)
        links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = image
        nodes.active = texture
        asset.materials.append(material)
    asset.from_pydata(positions, [], triangles)
    asset.polygons.foreach_set("material_index", materials)
    asset.uv_layers.new(name="lightmap").uv.foreach_set("vector", np.array(uvs, "f4").ravel())
    asset.update()
    thing = bpy.data.objects.new("asset", asset)
    bpy.context.scene.collection.objects.link(thing)
    bpy.context.view_layer.objects.active = thing
    thing.select_set(True)


def add_spot(light):
    if light["type"] != "spot" or light["inner_cone_angle"] != light["outer_cone_angle"]:
        raise ValueError("only spot lights with hard cones")
    spot = bpy.data.lights.new("light", "SPOT")
    # A spot's watts are those of a point light of its intensity, whatever its cone.
    spot.energy = 4 * math.pi * light["intensity"]
    spot.color = light["color"]
    spot.spot_size = 2 * light["outer_cone_angle"]
    spot.spot_blend = 0.0
    spot.shadow_soft_size = 0.0
    thing = bpy.data.objects.new("light", spot)
    thing.location = light["position"]
    thing.rotation_mode = "QUATERNION"
    thing.rotation_quaternion = Vector(light["direction"]).to_track_quat("-Z", "Y")
    bpy.context.scene.collection.objects.link(thing)
    return thing


def configure(samples, bounces):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.threads_mode = "FIXED"
    scene.render.threads = 2
    scene.render.use_persistent_data = True
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.max_bounces = cycles.diffuse_bounces = bounces
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    # Clamping would darken.
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0


def main():
    folder, output, samples = pathlib.Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    description = json.loads((folder / "scene.json").read_text())
    conditions = [int(c) for c in sys.argv[4:]] or list(range(len(description["conditions"])))
    texels = np.fromfile(folder / "texels.f32", "<f4").reshape(-1, 3)[:, 0].astype(int)
    size = description["size"]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.world = bpy.data.worlds.new("dark")
    bpy.context.scene.world.color = (0, 0, 0)
    image = bpy.data.images.new("lightmap", size, size, alpha=True, float_buffer=True, is_data=True)
    add_asset(description, image)
    configure(samples, description["max_bounces"])
    irradiance, seconds, cpu_seconds = [], [], []
    for i, condition in enumerate([conditions[0], *conditions]):
        lights = [add_spot(light) for light in description["conditions"][condition]]
        bpy.context.scene.cycles.seed = condition
        start, cpu_start = time.perf_counter(), time.process_time()
        bpy.ops.object.bake(type="DIFFUSE", pass_filter={"INDIRECT"}, margin=0, use_clear=True)
        # The first loads kernels.
        if i > 0:
            seconds.append(time.perf_counter() - start)
            cpu_seconds.append(time.process_time() - cpu_start)
            pixels = np.empty(size * size * 4, "f4")
            image.pixels.foreach_get(pixels)
            pixels = pixels.reshape(-1, 4)[texels]
            irradiance.append(np.where(pixels[:, 3:] > 0, np.pi * pixels[:, :3], np.nan))
        for light in lights:
            bpy.data.objects.remove(light)
    np.savez(output, irradiance=np.array(irradiance), seconds=seconds, cpu_seconds=cpu_seconds)


if __name__ == "__main__":
    main()
