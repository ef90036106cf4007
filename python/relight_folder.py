"""The folder of `relight export-conditions`, for scripts that render it: docs/DATASET.md describes its files.

Needs numpy alone, so that it runs inside Blender, too.
"""

import json
import os
import pathlib
import struct
import zlib

import numpy as np

FORMAT, VERSION = "relight-conditions", 1


class Folder:
    """The conditions, and where their lightmaps go."""

    def __init__(self, path):
        self.path = pathlib.Path(path)
        file = self.path / "conditions.json"
        if not file.exists():
            raise SystemExit(f"{file}: not there; write it with `relight export-conditions SCENE -o {self.path}`")
        self.manifest = json.loads(file.read_text())
        found = (self.manifest.get("format"), self.manifest.get("version"))
        if found != (FORMAT, VERSION):
            raise SystemExit(f"{file}: {found[0]} of version {found[1]}, this script reads {FORMAT} {VERSION}")
        self.size = self.manifest["size"]
        self.max_bounces = self.manifest["max_bounces"]
        self.conditions = self.manifest["conditions"]

    def missing(self):
        """The conditions that have no lightmap yet, by number."""
        return [i for i, c in enumerate(self.conditions) if not (self.path / c["indirect"]).exists()]

    def texels(self):
        """`index` (y · size + x), `area` [texel], `position` and `normal` [texel][point][axis]: points uniform by area."""
        return read_safetensors(self.path / "texels.safetensors")

    def write(self, condition, lightmap, renderer, samples, noise=None):
        """Writes a lightmap, [y][x][channel], and what is known of it; row 0 is at v = 0."""
        entry = self.conditions[condition]
        write_exr(self.path / entry["indirect"], lightmap)
        if noise is not None:
            entry["noise"] = float(noise)
        self.manifest["renderer"], self.manifest["samples"] = renderer, samples
        replace(self.path / "conditions.json", json.dumps(self.manifest, indent=1).encode())

    def environment(self, light):
        """Radiance of an environment light, as `look(directions)`: unit vectors [...][axis] to [...][channel]."""
        pixels = read_exr(self.path / light["image"])
        pixels = pixels * (np.array(light["color"]) * light["intensity"]).astype(np.float32)
        height, width = pixels.shape[:2]
        sin, cos = np.sin(light["rotation"]), np.cos(light["rotation"])

        def look(directions):
            x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
            # Turned back, so that the map stands still.
            x, z = x * cos - z * sin, z * cos + x * sin
            column = (0.5 + np.arctan2(x, -z) / (2 * np.pi)) * width
            row = np.arccos(np.clip(y, -1, 1)) / np.pi * height
            clip = lambda v, most: np.clip(v.astype(int), 0, most - 1)
            return pixels[clip(row, height), clip(column, width)]

        return look

    def asset(self):
        """The primitives of asset.glb, one a material, as dictionaries: `positions`, `normals`, `lightmap_uvs`, `triangles`,
        `colours` or None, and `material`."""
        data = (self.path / "asset.glb").read_bytes()
        (length,) = struct.unpack_from("<I", data, 12)
        document, binary = json.loads(data[20 : 20 + length]), data[28 + length :]

        def view(number):
            view = document["bufferViews"][number]
            start = view["byteOffset"]
            return binary[start : start + view["byteLength"]]

        def accessor(number):
            accessor = document["accessors"][number]
            kind = {5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
            width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
            return np.frombuffer(view(accessor["bufferView"]), kind).reshape(-1, width)

        primitives = []
        for primitive in document["meshes"][0]["primitives"]:
            sets = {name: accessor(number) for name, number in primitive["attributes"].items()}
            triangles = accessor(primitive["indices"]).reshape(-1, 3)
            # Vertices are shared by all primitives: each takes its own.
            used, triangles = np.unique(triangles, return_inverse=True)
            sets = {name: values[used] for name, values in sets.items()}
            primitives.append(
                {
                    "positions": sets["POSITION"],
                    "normals": sets["NORMAL"],
                    "lightmap_uvs": sets["TEXCOORD_1"],
                    "colours": sets.get("COLOR_0"),
                    "triangles": triangles.reshape(-1, 3),
                    "material": material(document, document["materials"][primitive["material"]], sets, view),
                }
            )
        return primitives


def material(document, json_material, sets, view):
    """A material: factors, and textures as `png` bytes, `wrap` and the `uvs` that they are read at, or None."""
    pbr = json_material["pbrMetallicRoughness"]
    extensions = json_material.get("extensions", {})
    strength = extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1)

    def texture(info):
        if info is None:
            return None
        texture = document["textures"][info["index"]]
        sampler = document["samplers"][texture["sampler"]]
        uvs = sets[f"TEXCOORD_{info['texCoord']}"]
        transform = info.get("extensions", {}).get("KHR_texture_transform")
        if transform:
            sin, cos = np.sin(transform["rotation"]), np.cos(transform["rotation"])
            scaled = uvs * transform["scale"]
            uvs = scaled @ np.array([[cos, -sin], [sin, cos]]) + transform["offset"]
        wrap = {10497: "repeat", 33648: "mirror", 33071: "clamp"}[sampler["wrapS"]]
        if sampler["wrapS"] != sampler["wrapT"]:
            raise SystemExit(f"material {json_material['name']}: a texture that wraps differently along u and v is not rendered")
        image = document["images"][texture["source"]]
        return {"png": view(image["bufferView"]), "wrap": wrap, "uvs": uvs, "number": info["index"]}

    return {
        "name": json_material["name"],
        "lambert": json_material.get("extras", {}).get("relight", {}).get("reflectance") == "lambert",
        "base_colour": pbr["baseColorFactor"],
        "base_colour_texture": texture(pbr.get("baseColorTexture")),
        "metallic": pbr["metallicFactor"],
        "roughness": pbr["roughnessFactor"],
        "metallic_roughness_texture": texture(pbr.get("metallicRoughnessTexture")),
        "emissive": [strength * v for v in json_material.get("emissiveFactor", [0, 0, 0])],
        "emissive_texture": texture(json_material.get("emissiveTexture")),
        "alpha_cutoff": json_material.get("alphaCutoff"),
        "double_sided": json_material.get("doubleSided", False),
    }


def cone(light):
    """Scale and offset of a spot's ramp: intensity · clip(cos · scale + offset, 0, 1)² (KHR_lights_punctual)."""
    inner, outer = np.cos(light["inner_cone_angle"]), np.cos(light["outer_cone_angle"])
    # A hard cone has a ramp of this width in the cosine, as relight's own has.
    scale = 1 / max(inner - outer, 1e-4)
    return scale, -outer * scale


def half_axes(light):
    """The half axes u and v of a rect or disk; u × v is where it shines to."""
    direction = np.array(light["direction"])
    if light["type"] == "disk":
        up = np.eye(3)[np.argmin(np.abs(direction))]
        u = np.cross(up, direction)
        u *= light["radius"] / np.linalg.norm(u)
        return u, np.cross(direction, u)
    for up in (light["up"], [0, 0, 1], [1, 0, 0]):
        u = np.cross(up, direction)
        if u @ u > 1e-6:
            break
    u /= np.linalg.norm(u)
    width, height = light["size"]
    return u * width / 2, np.cross(direction, u) * height / 2


def read_safetensors(path):
    data = pathlib.Path(path).read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    header = json.loads(data[8 : 8 + length])
    header.pop("__metadata__", None)
    kinds = {"F32": "<f4", "U32": "<u4"}

    def tensor(entry):
        start, end = (8 + length + offset for offset in entry["data_offsets"])
        return np.frombuffer(data[start:end], kinds[entry["dtype"]]).reshape(entry["shape"])

    return {name: tensor(entry) for name, entry in header.items()}


def replace(path, data):
    """Writes a file whole or not at all."""
    path = pathlib.Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".tmp-{path.name}")
    beside.write_bytes(data)
    os.replace(beside, path)


# OpenEXR, as far as lightmaps need it: one part of scan lines, 32-bit floats, blocks of 16 lines under zlib
# (openexr.com/en/latest/OpenEXRFileLayout.html).
LINES = 16


def write_exr(path, pixels):
    """Writes [y][x][channel], RGB, as 32-bit floats."""
    pixels = np.asarray(pixels, "<f4")
    height, width, _ = pixels.shape
    attribute = lambda name, kind, value: f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value
    # Channels in the order of their names; 2: 32-bit floats.
    channels = b"".join(name + struct.pack("<iiii", 2, 0, 1, 1) for name in (b"B\0", b"G\0", b"R\0")) + b"\0"
    window = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    header = struct.pack("<ii", 20000630, 2)
    header += attribute("channels", "chlist", channels) + attribute("compression", "compression", b"\x03")
    header += attribute("dataWindow", "box2i", window) + attribute("displayWindow", "box2i", window)
    header += attribute("lineOrder", "lineOrder", b"\0") + attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    header += attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0))
    header += attribute("screenWindowWidth", "float", struct.pack("<f", 1)) + b"\0"
    blocks = []
    for y in range(0, height, LINES):
        lines = pixels[y : y + LINES, :, ::-1].transpose(0, 2, 1).tobytes()
        packed = zlib.compress(forecast(lines), 4)
        block = packed if len(packed) < len(lines) else lines
        blocks.append(struct.pack("<ii", y, len(block)) + block)
    start = len(header) + 8 * len(blocks)
    offsets = start + np.cumsum([0, *(len(block) for block in blocks[:-1])])
    replace(path, header + offsets.astype("<u8").tobytes() + b"".join(blocks))


def forecast(data):
    """Even bytes, then odd ones, as differences from one to the next."""
    data = np.frombuffer(data, np.uint8)
    data = np.concatenate([data[0::2], data[1::2]]).astype(np.int16)
    data[1:] = data[1:] - data[:-1] + 128
    return data.astype(np.uint8).tobytes()


def read_exr(path):
    """RGB of a file that relight or `write_exr` wrote, [y][x][channel]; other files need a library."""
    data = pathlib.Path(path).read_bytes()
    magic, version = struct.unpack_from("<ii", data)
    # Flags for tiles, deep data and several parts.
    if magic != 20000630 or version & 0x1A00:
        raise SystemExit(f"{path}: not an OpenEXR file of scan lines in one part")
    at, header = 8, {}
    while data[at]:
        name, kind, rest = data[at:].split(b"\0", 2)
        at += len(name) + len(kind) + 2
        (length,) = struct.unpack_from("<i", data, at)
        header[name.decode()] = data[at + 4 : at + 4 + length]
        at += 4 + length
    names, entries = [], header["channels"]
    while entries[0]:
        name, rest = entries.split(b"\0", 1)
        names.append((name.decode(), struct.unpack_from("<i", rest)[0]))
        entries = rest[16:]
    left, top, right, bottom = struct.unpack("<iiii", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    packing = header["compression"][0]
    lines = {0: 1, 1: 1, 2: 1, 3: 16}.get(packing)
    if lines is None or any(kind != 2 for _, kind in names):
        raise SystemExit(f"{path}: only 32-bit floats without compression, under RLE or under ZIP are read")
    planes = np.empty((height, len(names), width), "<f4")
    for block in np.frombuffer(data, "<u8", -(-height // lines), at + 1):
        y, length = struct.unpack_from("<ii", data, int(block))
        rows = planes[y - top : y - top + lines]
        packed = data[int(block) + 8 : int(block) + 8 + length]
        raw = packed if length == rows.nbytes else recast(unpack(packed, packing))
        rows[:] = np.frombuffer(raw, "<f4").reshape(rows.shape)
    order = [[name for name, _ in names].index(channel) for channel in "RGB"]
    return planes[:, order].transpose(0, 2, 1)


def unpack(packed, packing):
    if packing != 1:
        return zlib.decompress(packed)
    out, at = bytearray(), 0
    while at < len(packed):
        (count,) = struct.unpack_from("b", packed, at)
        if count < 0:
            out += packed[at + 1 : at + 1 - count]
            at += 1 - count
        else:
            out += packed[at + 1 : at + 2] * (count + 1)
            at += 2
    return bytes(out)


def recast(data):
    """The inverse of `forecast`."""
    data = np.frombuffer(data, np.uint8).astype(np.int64)
    data[1:] -= 128
    data = np.cumsum(data).astype(np.uint8)
    out, half = np.empty_like(data), (len(data) + 1) // 2
    out[0::2], out[1::2] = data[:half], data[half:]
    return out.tobytes()
