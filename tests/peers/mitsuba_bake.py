"""Bakes conditions that `examples/peer_bake.rs` wrote with Mitsuba 3, one at a time.

    mitsuba_bake.py FOLDER OUT.npz SAMPLES [CONDITION ...]

Paths leave the texels' points in cosine-distributed directions; the `path` integrator adds up what arrives along them: no
light is seen directly, since points have no area. Writes `irradiance`, float32 [condition][texel][channel], `seconds` and
`cpu_seconds` per condition: sampling and summation alone, without scene loading and the compilation of kernels.

Runs in the variant llvm_ad_rgb, Mitsuba's fastest on a processor. Dr.Jit takes LLVM from $DRJIT_LIBLLVM_PATH, else here from
Debian's libllvm22 where that is installed: LLVM 15 crashes where there is AVX-512.
"""

import glob
import json
import os
import pathlib
import sys
import tempfile
import time

import numpy as np

for llvm in glob.glob("/usr/lib/*/libLLVM.so.22*"):
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", llvm)

import mitsuba_render  # noqa: E402: the environment comes first
from mitsuba_render import mi  # noqa: E402

mi.set_variant("llvm_ad_rgb")
import drjit as dr  # noqa: E402: it needs the variant

# Away from the surface that a path leaves, metres.
OFFSET = 1e-4
# Paths in flight at a time: what fits in memory many times over.
MOST_PATHS = 4_000_000
# Bakes before the first that counts: they compile.
WARM_UP = 2


def bake(scene, points, point_count, depth, samples, seed):
    """Irradiance, [texel][channel], from `samples` paths a texel."""
    texels = len(points[0]) // point_count
    total = np.zeros((3, texels))
    integrator = mi.load_dict({"type": "path", "max_depth": depth})
    most = max(1, MOST_PATHS // texels)
    for start in range(0, samples, most):
        count = min(most, samples - start)
        path = dr.arange(mi.UInt32, texels * count)
        point = path // count * point_count + (start + path % count) % point_count
        position, normal = (mi.Vector3f(*(dr.gather(mi.Float, x, point) for x in v)) for v in (points[:3], points[3:]))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed + start, texels * count)
        direction = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
        ray = mi.RayDifferential3f(mi.Point3f(position + OFFSET * normal), direction)
        radiance, *_ = integrator.sample(scene, sampler, ray)
        # Once for the three channels: what is not evaluated would be traced anew for each.
        dr.eval(radiance)
        total += np.array([dr.block_sum(channel, count) for channel in radiance])
    return (np.pi / samples * total.T).astype(np.float32)


def main():
    folder, output, samples = pathlib.Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    description = json.loads((folder / "scene.json").read_text())
    conditions = [int(c) for c in sys.argv[4:]] or list(range(len(description["conditions"])))
    points = np.fromfile(folder / "points.f32", "<f4").reshape(-1, 6).T
    points = [mi.Float(np.ascontiguousarray(x)) for x in points]
    # A path's depth counts its edges: the reflections, and one to the light.
    depth = description["max_bounces"] + 1
    irradiance, seconds, cpu_seconds = [], [], []
    with tempfile.TemporaryDirectory() as temporary:
        shapes = {n: mi.load_dict(s) for n, s in mitsuba_render.shapes(description, temporary).items()}
        for i, condition in enumerate([*[conditions[0]] * WARM_UP, *conditions]):
            lights = description["conditions"][condition]
            lights = {f"light{k}": mitsuba_render.emitter(light) for k, light in enumerate(lights)}
            scene = mi.load_dict({"type": "scene", **shapes, **lights})
            start, cpu_start = time.perf_counter(), time.process_time()
            baked = bake(scene, points, description["points_per_texel"], depth, samples, condition)
            if i >= WARM_UP:
                seconds.append(time.perf_counter() - start)
                cpu_seconds.append(time.process_time() - cpu_start)
                irradiance.append(baked)
    np.savez(output, irradiance=np.array(irradiance), seconds=seconds, cpu_seconds=cpu_seconds)


if __name__ == "__main__":
    main()
