"""Renders the folder of `relight export-conditions` with Mitsuba 3: the indirect light of every condition.

    render_mitsuba.py DIR [--samples 256] [--variant llvm_ad_rgb]

Conditions that have a lightmap are left out, so that a run that was stopped goes on. Paths leave the texels' points in
cosine-distributed directions and gather what arrives along them; what they see directly is taken off. Needs `mitsuba` and
numpy (PyPI), and LLVM for the variant llvm_ad_rgb ($DRJIT_LIBLLVM_PATH tells where it is not found), a GPU for cuda_ad_rgb.
"""

import argparse
import glob
import os
import pathlib
import tempfile
import time

import numpy as np

import relight_folder

# LLVM 15, which Debian has beside later ones, crashes where there is AVX-512.
for llvm in glob.glob("/usr/lib/*/libLLVM.so.[12]*")[-1:]:
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", llvm)

import mitsuba as mi  # noqa: E402: the environment comes first

# Paths in flight at a time.
MOST_PATHS = 1 << 22
# Off the surface that a path leaves, relative to the asset's extent.
OFFSET = 1e-5


def rgb(value):
    return {"type": "rgb", "value": [float(v) for v in value]}


def bitmap(texture, channels, factor, srgb):
    """A texture's channels times a factor, linear, so that it is decoded before it is interpolated."""
    with tempfile.NamedTemporaryFile(suffix=".png") as file:
        file.write(texture["png"])
        file.flush()
        codes = np.array(mi.Bitmap(file.name)) / 255.0
    values = codes[..., channels]
    if srgb:
        values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    values = (values * factor).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True, "wrap_mode": texture["wrap"]}


def surface(material, colours):
    """A material as a BSDF."""
    base = rgb(material["base_colour"][:3])
    if material["base_colour_texture"]:
        if colours is not None:
            raise SystemExit(f"material {material['name']}: vertex colours over a texture are not rendered")
        base = bitmap(material["base_colour_texture"], [0, 1, 2], material["base_colour"][:3], True)
    elif colours is not None:
        base = {"type": "mesh_attribute", "name": "vertex_color"}
    if material["lambert"]:
        bsdf = {"type": "diffuse", "reflectance": base}
    else:
        roughness, metallic = material["roughness"], material["metallic"]
        texture = material["metallic_roughness_texture"]
        bsdf = {
            "type": "principled",
            "base_color": base,
            "roughness": bitmap(texture, [1], roughness, False) if texture else roughness,
            "metallic": bitmap(texture, [2], metallic, False) if texture else metallic,
            "specular": 0.5,
        }
    bsdf = {"type": "twosided", "bsdf": bsdf}
    texture, cutoff = material["base_colour_texture"], material["alpha_cutoff"]
    if cutoff is not None and texture:
        alpha = bitmap(texture, [3], material["base_colour"][3], False)
        solid = (np.array(alpha["bitmap"]) >= cutoff).astype(np.float32)
        bsdf = {"type": "mask", "opacity": {**alpha, "bitmap": mi.Bitmap(solid)}, "bsdf": bsdf}
    return bsdf


def write_ply(path, primitive):
    material, columns = primitive["material"], [primitive["positions"], primitive["normals"]]
    names = ["x", "y", "z", "nx", "ny", "nz"]
    textures = [material[f"{name}_texture"] for name in ("base_colour", "metallic_roughness", "emissive")]
    textures = [texture for texture in textures if texture]
    if textures:
        uvs = textures[0]["uvs"]
        if any(not np.array_equal(texture["uvs"], uvs) for texture in textures):
            raise SystemExit(f"material {material['name']}: textures that are read at different coordinates are not rendered")
        columns, names = [*columns, uvs], [*names, "u", "v"]
    if primitive["colours"] is not None:
        columns, names = [*columns, primitive["colours"] * material["base_colour"][:3]], [*names, "r", "g", "b"]
    vertices = np.ascontiguousarray(np.hstack(columns), "<f4")
    faces = np.empty(len(primitive["triangles"]), [("count", "u1"), ("vertices", "<i4", 3)])
    faces["count"], faces["vertices"] = 3, primitive["triangles"]
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    header += "".join(f"property float {name}\n" for name in names)
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_bytes(header.encode() + vertices.tobytes() + faces.tobytes())


def shapes(primitives, folder, emission):
    """The asset, its own emission times `emission`."""
    entries = {}
    for i, primitive in enumerate(primitives):
        path, material = pathlib.Path(folder) / f"mesh{i}.ply", primitive["material"]
        if not path.exists():
            write_ply(path, primitive)
        entry = {"type": "ply", "filename": str(path), "bsdf": surface(material, primitive["colours"])}
        if emission and any(material["emissive"]):
            if material["double_sided"]:
                raise SystemExit(f"material {material['name']}: emission from both sides is not rendered")
            factor, texture = np.array(material["emissive"]) * emission, material["emissive_texture"]
            radiance = bitmap(texture, [0, 1, 2], factor, True) if texture else rgb(factor)
            entry["emitter"] = {"type": "area", "radiance": radiance}
        entries[f"mesh{i}"] = entry
    return entries


def define_punctual():
    """Point and spot lights with glTF's falloff, which Mitsuba's own do not have."""
    import drjit as dr

    class Punctual(mi.Emitter):
        def __init__(self, props):
            super().__init__(props)
            # Opaque, so that one kernel serves all lights.
            opaque = lambda name: dr.opaque(mi.Float, props[name])
            self.position = mi.Point3f(*(opaque(f"position{i}") for i in range(3)))
            self.axis = mi.Vector3f(*(opaque(f"axis{i}") for i in range(3)))
            self.intensity = mi.Color3f(*(opaque(f"intensity{i}") for i in range(3)))
            self.scale, self.offset = opaque("scale"), opaque("offset")
            self.inverse_range4 = opaque("inverse_range4")
            self.m_flags = mi.EmitterFlags.DeltaPosition

        def sample_direction(self, it, sample, active):
            ds = dr.zeros(mi.DirectionSample3f)
            to = self.position - it.p
            squared = dr.squared_norm(to)
            ds.p, ds.time, ds.pdf, ds.delta = self.position, it.time, 1.0, True
            ds.dist = dr.sqrt(squared)
            ds.d = to / ds.dist
            ds.emitter = mi.EmitterPtr(self)
            ramp = dr.clip(-dr.dot(ds.d, self.axis) * self.scale + self.offset, 0, 1)
            window = dr.clip(1 - squared * squared * self.inverse_range4, 0, 1)
            return ds, dr.select(active, self.intensity * (ramp * ramp * window / squared), 0.0)

        def pdf_direction(self, it, ds, active):
            return mi.Float(0)

        def eval(self, si, active):
            return mi.Color3f(0)

        def eval_direction(self, it, ds, active):
            return mi.Color3f(0)

        def bbox(self):
            return mi.ScalarBoundingBox3f()

        def to_string(self):
            return "Punctual[]"

    mi.register_emitter("gltf_punctual", lambda props: Punctual(props))


def emitters(folder, lights):
    """A condition's lights, but the asset's own emission. Area lights hide nothing: what meets them goes on."""
    entries = {}
    for i, light in enumerate(lights):
        kind, name = light["type"], f"light{i}"
        radiant = np.array(light.get("color", [1, 1, 1])) * light.get("intensity", light.get("radiance", 1))
        if kind in ("point", "spot"):
            scale, offset = relight_folder.cone(light) if kind == "spot" else (0, 1)
            axis, reach = light.get("direction", [0, 0, 1]), light.get("range")
            entry = {"type": "gltf_punctual", "scale": scale, "offset": offset, "inverse_range4": reach**-4 if reach else 0}
            for field, values in (("position", light["position"]), ("axis", axis), ("intensity", radiant)):
                entry |= {f"{field}{k}": float(value) for k, value in enumerate(values)}
            entries[name] = entry
        elif kind == "directional":
            entries[name] = {"type": "directional", "direction": light["direction"], "irradiance": rgb(radiant)}
        elif kind in ("rect", "disk", "sphere"):
            if kind == "sphere":
                entry = {"type": "sphere", "center": light["position"], "radius": light["radius"]}
            else:
                columns = np.eye(4)
                columns[:3, 0], columns[:3, 1] = relight_folder.half_axes(light)
                columns[:3, 2], columns[:3, 3] = light["direction"], light["position"]
                shape = {"rect": "rectangle", "disk": "disk"}[kind]
                entry = {"type": shape, "to_world": mi.ScalarTransform4f(columns.tolist())}
            entries[name] = {**entry, "bsdf": {"type": "null"}, "emitter": {"type": "area", "radiance": rgb(radiant)}}
        elif kind == "environment":
            # Mitsuba's columns are centred on their directions and start at −z, its rows go from pole to pole.
            theta, phi = np.pi * np.arange(513)[:, None] / 512, 2 * np.pi * (np.arange(1024) + 0.5) / 1024
            sin = np.sin(theta)
            directions = np.stack([sin * np.sin(phi), np.cos(theta) + 0 * phi, -sin * np.cos(phi)], -1)
            pixels = folder.environment(light)(directions).astype(np.float32)
            entries[name] = {"type": "envmap", "bitmap": mi.Bitmap(pixels)}
        elif kind != "emissive":
            raise SystemExit(f"lights of type {kind} are not rendered")
    if sum(light["type"] == "environment" for light in lights) > 1:
        raise SystemExit("Mitsuba has one environment at most; a condition here has more")
    return entries


class Renderer:
    """Renders the indirect light of one condition after another."""

    def __init__(self, folder, samples):
        self.folder, self.samples = folder, samples
        self.primitives = folder.asset()
        texels = folder.texels()
        self.index, self.area = texels["index"], texels["area"].astype(np.float64)
        self.points = texels["position"].shape[1]
        self.position, self.normal = (
            [mi.Float(np.ascontiguousarray(texels[name][..., axis].ravel())) for axis in range(3)]
            for name in ("position", "normal")
        )
        positions = np.concatenate([primitive["positions"] for primitive in self.primitives])
        self.offset = OFFSET * float(np.linalg.norm(positions.max(0) - positions.min(0)))
        self.meshes = tempfile.TemporaryDirectory()
        self.bare = self.load(shapes(self.primitives, self.meshes.name, 0))

    def load(self, entries):
        return {name: mi.load_dict(entry) for name, entry in entries.items()}

    def render(self, condition):
        """Irradiance [y][x][channel], and its relative noise."""
        lights = self.folder.conditions[condition]["lights"]
        emission = sum(light["scale"] for light in lights if light["type"] == "emissive")
        asset = self.load(shapes(self.primitives, self.meshes.name, emission)) if emission else self.bare
        scene = mi.load_dict({"type": "scene", **asset, **emitters(self.folder, lights)})
        kinds = {light["type"] for light in lights}
        # Only volpath lets light through surfaces that are not there.
        kind = "volpath" if kinds & {"rect", "disk", "sphere"} else "path"
        # A path's depth counts its edges: the reflections, and one to the light.
        integrator = mi.load_dict({"type": kind, "max_depth": self.folder.max_bounces + 1})
        passes = 2 * -(-self.samples * len(self.index) // (2 * MOST_PATHS))
        halves = np.zeros((2, 3, len(self.index)))
        for number in range(passes):
            count = self.samples * (number + 1) // passes - self.samples * number // passes
            first = self.samples * number // passes
            seed = condition * passes + number
            visible = len(lights) if kinds - {"point", "spot", "directional"} else 0
            halves[number % 2] += self.trace(scene, integrator, first, count, seed, visible)
        mean = halves.sum(0) / self.samples
        weight = self.samples / 2
        difference = (halves[0] - halves[1]) / (2 * weight)
        norm = lambda values: np.sqrt((self.area * values**2).sum())
        noise = norm(difference) / norm(mean) if mean.any() else 0.0
        page = np.zeros((self.folder.size**2, 3), np.float32)
        # Rounding can leave what is taken off larger than what it is taken from.
        page[self.index] = np.pi * np.maximum(mean.T, 0)
        return page.reshape(self.folder.size, self.folder.size, 3), noise

    def trace(self, scene, integrator, first, count, seed, visible):
        """Sums over `count` paths a texel of the radiance that arrives after a reflection, [channel][texel]."""
        import drjit as dr

        path = dr.arange(mi.UInt32, len(self.index) * count)
        point = path // count * self.points + (dr.opaque(mi.UInt32, first) + path % count) % self.points
        position, normal = (mi.Vector3f(*(dr.gather(mi.Float, x, point) for x in v)) for v in (self.position, self.normal))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, dr.width(path))
        direction = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
        ray = mi.RayDifferential3f(mi.Point3f(position + self.offset * normal), direction)
        radiance, *_ = integrator.sample(scene, sampler, ray)
        if visible:
            radiance = radiance - seen(scene, ray, visible)
        # Once for the three channels: what is not evaluated would be traced anew for each.
        dr.eval(radiance)
        return np.array([np.array(dr.block_sum(channel, count)) for channel in radiance], np.float64)


def seen(scene, ray, most):
    """The radiance of the lights that a ray meets without a reflection, `most` area lights one behind another."""
    import drjit as dr

    total, ray, going = mi.Color3f(0), mi.Ray3f(ray), mi.Bool(True)
    for _ in range(most + 1):
        hit = scene.ray_intersect(ray, going)
        emitter = hit.emitter(scene, going)
        total += dr.select(going & (emitter != None), emitter.eval(hit, going), 0)  # noqa: E711: a vector of pointers
        going &= hit.is_valid() & mi.has_flag(hit.bsdf().flags(), mi.BSDFFlags.Null)
        ray = hit.spawn_ray(ray.d)
    return total


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--samples", type=int, default=256, help="paths a texel")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="llvm_ad_rgb or cuda_ad_rgb")
    arguments = parser.parse_args()
    folder = relight_folder.Folder(arguments.folder)
    missing = folder.missing()
    print(f"{len(missing)} of {len(folder.conditions)} conditions to render", flush=True)
    if not missing:
        return
    mi.set_variant(arguments.variant)
    define_punctual()
    renderer = Renderer(folder, arguments.samples + arguments.samples % 2)
    start = time.perf_counter()
    for done, condition in enumerate(missing, 1):
        lightmap, noise = renderer.render(condition)
        folder.write(condition, lightmap, f"Mitsuba {mi.__version__}", renderer.samples, noise)
        seconds = time.perf_counter() - start
        left = seconds / done * (len(missing) - done)
        print(f"{done}/{len(missing)}  noise {100 * noise:.1f} %  {seconds:.0f} s elapsed, {left:.0f} s left", flush=True)


if __name__ == "__main__":
    main()
