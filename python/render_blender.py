"""Renders the folder of `relight export-conditions` with Blender's Cycles: the indirect light of every condition.

    render_blender.py DIR [--samples 256]                       with `bpy` (PyPI) in a Python of the version it is made for
    blender -b -P render_blender.py -- DIR [--samples 256]      inside Blender

Conditions that have a lightmap are left out, so that a run that was stopped goes on. What is baked is a white copy of the
asset, just off its surface and met by no path: so the light that arrives is had whatever the material below. Cycles bakes
texels at their centres; those whose centre is not on the surface take the nearest one's value.
"""

import argparse
import math
import pathlib
import sys
import tempfile
import time

import bpy
import numpy as np
from mathutils import Vector

sys.path.insert(0, str(pathlib.Path(__file__).parent))
import relight_folder  # noqa: E402: it lies beside this script

# Off the surface, relative to the asset's extent.
OFFSET = 1e-4
# Texels that the lightmap is continued by beyond its charts.
MARGIN = 4


class Nodes:
    """A node tree being built."""

    def __init__(self, tree):
        self.tree = tree
        tree.nodes.clear()

    def add(self, kind, inputs=(), **settings):
        """A node; an input is a value or another node's output."""
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        for name, value in dict(inputs).items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[name])
            else:
                node.inputs[name].default_value = value
        return node

    def math(self, operation, a, b=0.0, clamp=False):
        return self.add("ShaderNodeMath", {0: a, 1: b}, operation=operation, use_clamp=clamp).outputs[0]


def image_of(texture, space, folder):
    path = pathlib.Path(folder) / f"texture{texture['number']}.png"
    path.write_bytes(texture["png"])
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = space
    image.alpha_mode = "CHANNEL_PACKED"
    return image


def build_material(material, coloured, folder):
    """The material, and the node that holds what its emission is multiplied with."""
    built = bpy.data.materials.new(material["name"] or "material")
    built.use_nodes = True
    nodes = Nodes(built.node_tree)

    def texture(name, space):
        texture = material[f"{name}_texture"]
        if not texture:
            return None
        uv = nodes.add("ShaderNodeUVMap", uv_map=name)
        extension = {"repeat": "REPEAT", "mirror": "MIRROR", "clamp": "EXTEND"}[texture["wrap"]]
        image = image_of(texture, space, folder)
        return nodes.add("ShaderNodeTexImage", {"Vector": uv.outputs[0]}, image=image, extension=extension)

    def product(a, b):
        node = nodes.add("ShaderNodeVectorMath", {0: a, 1: b}, operation="MULTIPLY")
        return node.outputs[0]

    colour, alpha = material["base_colour"][:3], material["base_colour"][3]
    image = texture("base_colour", "sRGB")
    if image:
        colour = product(image.outputs["Color"], colour)
        alpha = nodes.math("MULTIPLY", image.outputs["Alpha"], alpha)
    if coloured:
        colour = product(nodes.add("ShaderNodeVertexColor", layer_name="colour").outputs["Color"], colour)
    colour = colour if isinstance(colour, bpy.types.NodeSocket) else (*colour, 1.0)
    if material["lambert"]:
        shader = nodes.add("ShaderNodeBsdfDiffuse", {"Color": colour}).outputs[0]
    else:
        inputs = {"Base Color": colour, "Metallic": material["metallic"], "Roughness": material["roughness"], "IOR": 1.5}
        image = texture("metallic_roughness", "Non-Color")
        if image:
            parts = nodes.add("ShaderNodeSeparateColor", {0: image.outputs["Color"]})
            inputs["Roughness"] = nodes.math("MULTIPLY", parts.outputs[1], material["roughness"])
            inputs["Metallic"] = nodes.math("MULTIPLY", parts.outputs[2], material["metallic"])
        shader = nodes.add("ShaderNodeBsdfPrincipled", inputs).outputs[0]
    scale = None
    if any(material["emissive"]):
        scale = nodes.add("ShaderNodeValue")
        scale.outputs[0].default_value = 0.0
        strength = scale.outputs[0]
        if not material["double_sided"]:
            back = nodes.add("ShaderNodeNewGeometry").outputs["Backfacing"]
            strength = nodes.math("MULTIPLY", strength, nodes.math("SUBTRACT", 1.0, back))
        emissive = material["emissive"]
        image = texture("emissive", "sRGB")
        emissive = product(image.outputs["Color"], emissive) if image else (*emissive, 1.0)
        glow = nodes.add("ShaderNodeEmission", {"Color": emissive, "Strength": strength}).outputs[0]
        shader = nodes.add("ShaderNodeAddShader", {0: shader, 1: glow}).outputs[0]
    if material["alpha_cutoff"] is not None and isinstance(alpha, bpy.types.NodeSocket):
        absent = nodes.math("LESS_THAN", alpha, material["alpha_cutoff"])
        clear = nodes.add("ShaderNodeBsdfTransparent").outputs[0]
        shader = nodes.add("ShaderNodeMixShader", {0: absent, 1: shader, 2: clear}).outputs[0]
    nodes.add("ShaderNodeOutputMaterial", {"Surface": shader})
    return built, scale


def add_object(name, primitives, materials, offset):
    """One object of all primitives, in the asset's own axes, moved out along the normals."""
    positions = np.concatenate([p["positions"] + offset * p["normals"] for p in primitives])
    normals = np.concatenate([p["normals"] for p in primitives])
    first = np.cumsum([0, *(len(p["positions"]) for p in primitives)])
    triangles = np.concatenate([p["triangles"] + start for p, start in zip(primitives, first)])
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(positions.tolist(), [], triangles.tolist())
    numbers = np.concatenate([np.full(len(p["triangles"]), i) for i, p in enumerate(primitives)])
    mesh.polygons.foreach_set("material_index", numbers.astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(triangles), bool))
    for material in materials:
        mesh.materials.append(material)
    corners = triangles.ravel()

    def layer(name, uvs, flip):
        uvs = np.concatenate(uvs)[corners].astype(np.float32)
        # Blender's images have v upwards.
        uvs = np.stack([uvs[:, 0], 1 - uvs[:, 1]], -1) if flip else uvs
        mesh.uv_layers.new(name=name).uv.foreach_set("vector", np.ascontiguousarray(uvs).ravel())

    layer("lightmap", [p["lightmap_uvs"] for p in primitives], False)
    for kind in ("base_colour", "metallic_roughness", "emissive"):
        textures = [p["material"][f"{kind}_texture"] for p in primitives]
        if any(textures):
            layer(kind, [t["uvs"] if t else p["lightmap_uvs"] for t, p in zip(textures, primitives)], True)
    if any(p["colours"] is not None for p in primitives):
        colours = [np.ones_like(p["positions"]) if p["colours"] is None else p["colours"] for p in primitives]
        rgba = np.pad(np.concatenate(colours), ((0, 0), (0, 1)), constant_values=1).astype(np.float32)
        mesh.color_attributes.new("colour", "FLOAT_COLOR", "POINT").data.foreach_set("color", rgba.ravel())
    mesh.update()
    mesh.normals_split_custom_set_from_vertices(normals.tolist())
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def add_light(light):
    """A light in Blender's units. Point and spot lights have glTF's falloff as nodes."""
    kind, intensity = light["type"], light.get("intensity", light.get("radiance"))
    blender_kind = {"point": "POINT", "spot": "POINT", "sphere": "POINT", "directional": "SUN", "rect": "AREA", "disk": "AREA"}
    lamp = bpy.data.lights.new("light", blender_kind[kind])
    lamp.color = light["color"]
    thing = bpy.data.objects.new("light", lamp)
    thing.location = light.get("position", (0, 0, 0))
    thing.rotation_mode = "QUATERNION"
    if kind in ("point", "spot"):
        # Watts of a light that shines alike in all directions.
        lamp.energy, lamp.shadow_soft_size = 4 * math.pi * intensity, 0.0
        lamp.use_nodes = True
        nodes = Nodes(lamp.node_tree)
        strength = 1.0
        if kind == "spot":
            scale, offset = relight_folder.cone(light)
            away = nodes.add("ShaderNodeNewGeometry").outputs["Incoming"]
            dot = nodes.add("ShaderNodeVectorMath", {0: away, 1: light["direction"]}, operation="DOT_PRODUCT")
            ramp = nodes.math("ADD", nodes.math("MULTIPLY", dot.outputs["Value"], scale), offset, clamp=True)
            strength = nodes.math("MULTIPLY", ramp, ramp)
        if light.get("range"):
            share = nodes.math("DIVIDE", nodes.add("ShaderNodeLightPath").outputs["Ray Length"], light["range"])
            window = nodes.math("SUBTRACT", 1.0, nodes.math("POWER", share, 4.0), clamp=True)
            strength = nodes.math("MULTIPLY", window, strength)
        glow = nodes.add("ShaderNodeEmission", {"Strength": strength}).outputs[0]
        nodes.add("ShaderNodeOutputLight", {"Surface": glow})
    elif kind == "directional":
        lamp.energy, lamp.angle = intensity, 0.0
    elif kind == "sphere":
        radius = light["radius"]
        lamp.energy, lamp.shadow_soft_size = 4 * (math.pi * radius) ** 2 * intensity, radius
        lamp.use_soft_falloff = False
    else:
        u, v = relight_folder.half_axes(light)
        lamp.shape = {"rect": "RECTANGLE", "disk": "DISK"}[kind]
        lamp.size, lamp.size_y = 2 * np.linalg.norm(u), 2 * np.linalg.norm(v)
        area = lamp.size * lamp.size_y * (1 if kind == "rect" else math.pi / 4)
        lamp.energy = math.pi * area * intensity
        # It shines along −z: u, v and the direction are right-handed.
        columns = np.stack([u / np.linalg.norm(u), -v / np.linalg.norm(v), -np.array(light["direction"])], 1)
        from mathutils import Matrix

        thing.rotation_quaternion = Matrix(columns.tolist()).to_quaternion()
    if kind == "directional":
        thing.rotation_quaternion = Vector(light["direction"]).to_track_quat("-Z", "Y")
    bpy.context.scene.collection.objects.link(thing)
    return thing


def set_world(folder, lights):
    """The sum of the environments."""
    nodes = Nodes(bpy.context.scene.world.node_tree)
    background = nodes.add("ShaderNodeBackground", {"Color": (0, 0, 0, 1)})
    nodes.add("ShaderNodeOutputWorld", {"Surface": background.outputs[0]})
    if not lights:
        return None
    width, height = 1024, 512
    # Blender's columns run from −x over −y: it sees (z, x, y), in which up is z.
    theta = np.pi * (np.arange(height) + 0.5)[:, None] / height
    phi = np.pi * (1 - 2 * (np.arange(width) + 0.5) / width)
    b = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1)
    directions = b[..., [1, 2, 0]]
    pixels = sum(folder.environment(light)(directions) for light in lights)
    image = bpy.data.images.new("environment", width, height, float_buffer=True, is_data=True)
    rgba = np.pad(pixels[::-1], ((0, 0), (0, 0), (0, 1)), constant_values=1).astype(np.float32)
    image.pixels.foreach_set(np.ascontiguousarray(rgba).ravel())
    image.update()
    position = nodes.add("ShaderNodeSeparateXYZ", {0: nodes.add("ShaderNodeTexCoord").outputs["Generated"]}).outputs
    turned = nodes.add("ShaderNodeCombineXYZ", {0: position[2], 1: position[0], 2: position[1]})
    texture = nodes.add("ShaderNodeTexEnvironment", {0: turned.outputs[0]}, image=image, interpolation="Closest")
    nodes.tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    return image


def configure(samples, bounces):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.use_persistent_data = True
    scene.render.bake.margin, scene.render.bake.margin_type = MARGIN, "EXTEND"
    cycles = scene.cycles
    cycles.samples = samples
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    # Both would darken.
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0


def arguments_of(words):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--samples", type=int, default=256, help="paths a texel")
    return parser.parse_args(words)


def main():
    # Inside Blender, what follows -- is for the script.
    arguments = arguments_of(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
    folder = relight_folder.Folder(arguments.folder)
    missing = folder.missing()
    print(f"{len(missing)} of {len(folder.conditions)} conditions to render", flush=True)
    if not missing:
        return
    size, primitives = folder.size, folder.asset()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.world = bpy.data.worlds.new("world")
    bpy.context.scene.world.use_nodes = True
    configure(arguments.samples, folder.max_bounces)
    with tempfile.TemporaryDirectory() as textures:
        built = [build_material(p["material"], p["colours"] is not None, textures) for p in primitives]
        add_object("asset", primitives, [material for material, _ in built], 0.0)
        image = bpy.data.images.new("baked", size, size, alpha=True, float_buffer=True, is_data=True)
        white = bpy.data.materials.new("white")
        white.use_nodes = True
        nodes = Nodes(white.node_tree)
        diffuse = nodes.add("ShaderNodeBsdfDiffuse", {"Color": (1, 1, 1, 1)})
        nodes.add("ShaderNodeOutputMaterial", {"Surface": diffuse.outputs[0]})
        nodes.tree.nodes.active = nodes.add("ShaderNodeTexImage", image=image)
        positions = np.concatenate([p["positions"] for p in primitives])
        extent = float(np.linalg.norm(positions.max(0) - positions.min(0)))
        copy = add_object("copy", primitives, [white] * len(primitives), OFFSET * extent)
        for ray in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
            setattr(copy, f"visible_{ray}", False)
        bpy.context.view_layer.objects.active = copy
        copy.select_set(True)

        start = time.perf_counter()
        for done, condition in enumerate(missing, 1):
            lights = folder.conditions[condition]["lights"]
            emission = sum(light["scale"] for light in lights if light["type"] == "emissive")
            for _, scale in built:
                if scale:
                    scale.outputs[0].default_value = emission
            world = set_world(folder, [light for light in lights if light["type"] == "environment"])
            lamps = [add_light(light) for light in lights if light["type"] not in ("environment", "emissive")]
            bpy.context.scene.cycles.seed = condition
            bpy.ops.object.bake(type="DIFFUSE", pass_filter={"INDIRECT"}, use_clear=True)
            pixels = np.empty(size * size * 4, np.float32)
            image.pixels.foreach_get(pixels)
            # The row at v = 0 comes first, as it is.
            lightmap = math.pi * pixels.reshape(size, size, 4)[..., :3]
            folder.write(condition, np.maximum(lightmap, 0), f"Cycles {bpy.app.version_string}", arguments.samples)
            for lamp in lamps:
                data = lamp.data
                bpy.data.objects.remove(lamp)
                bpy.data.lights.remove(data)
            if world:
                bpy.data.images.remove(world)
            seconds = time.perf_counter() - start
            left = seconds / done * (len(missing) - done)
            print(f"{done}/{len(missing)}  {seconds:.0f} s elapsed, {left:.0f} s left", flush=True)


if __name__ == "__main__":
    main()
