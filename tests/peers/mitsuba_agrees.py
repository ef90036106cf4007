"""Holds relight's path tracer against Mitsuba 3, tile by tile: a t-test on the seeds' means, Šidák-corrected; and the mean of
the whole picture, to half a percent.

    mitsuba_agrees.py [--spp 64] [--seeds 24] [--gltf FILE] [--only NAME]

`--gltf` adds a scene with textures; by itself Fox.glb of the glTF sample assets, where the folder of real assets (RELIGHT_ASSETS, or
shared/assets beside the repository) has it. `cargo run --example peer_scenes` writes the scenes and relight's pictures. What disagrees is left under target/peers as
.exr beside Mitsuba's picture and the t values. Exit status 0: all agree, and the controls do not.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys

import numpy as np

import mitsuba_render
from mitsuba_render import mi

ROOT = pathlib.Path(__file__).parents[2]
OUT = ROOT / "target" / "peers"
TILE = 8
# Probability that a comparison of equal renderers fails at all.
FALSE_ALARM = 1e-3
# Most by which the means of the pictures may differ.
MEAN_DIFFERENCE = 5e-3
# Held to the mean alone: its shading normals are turned away from the eye along creases, where Mitsuba's surfaces are black and
# ours are not.
MEAN_ALONE = {"statue_smooth"}


def tiles(pictures):
    """Means over TILE × TILE pixels: [seed][tile y][tile x][channel]."""
    n, height, width, channels = pictures.shape
    blocks = pictures.reshape(n, height // TILE, TILE, width // TILE, TILE, channels)
    return blocks.astype(np.float64).mean(axis=(2, 4))


def t_values(a, b):
    """Welch's t of each tile and channel."""
    variance = a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b)
    difference = a.mean(axis=0) - b.mean(axis=0)
    # Where neither varies, direct light without edges, f32 rounding and the two shadow offsets are what is left.
    floor = (1e-4 * np.maximum(a.mean(axis=0), b.mean(axis=0))) ** 2 + 1e-14
    return difference / np.sqrt(variance + floor)


def critical_t(freedom, comparisons):
    """|t| that `comparisons` draws of Student's distribution all stay below with probability 1 − FALSE_ALARM."""
    single = 1 - (1 - FALSE_ALARM) ** (1 / comparisons)
    t = np.linspace(0, 60, 600_001)
    density = (1 + t * t / freedom) ** (-(freedom + 1) / 2)
    tail = 1 - np.cumsum(density) / density.sum()
    return t[np.searchsorted(-tail, -single)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel and seed, in both renderers")
    parser.add_argument("--seeds", type=int, default=24)
    fox = pathlib.Path(os.environ.get("RELIGHT_ASSETS", ROOT.parent / "shared" / "assets")) / "Fox" / "Fox.glb"
    textured = str(fox) if fox.exists() else None
    parser.add_argument("--gltf", default=textured, help="an asset with textures, lit by a disk")
    parser.add_argument("--only", default="", help="compare the scenes whose names contain this")
    arguments = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    example = ["cargo", "run", "--quiet", "--release", "--example", "peer_scenes", "--"]
    gltf = [arguments.gltf] if arguments.gltf else []
    if not gltf:
        print("textured: skipped, no --gltf is given")
    for old in OUT.glob("*.json"):
        old.unlink()
    subprocess.run([*example, str(OUT), str(arguments.spp), str(arguments.seeds), *gltf], cwd=ROOT, check=True)

    failures = 0
    for path in sorted(p for p in OUT.glob("*.json") if arguments.only in p.stem):
        description = json.loads(path.read_text())
        shape = (arguments.seeds, description["height"], description["width"], 3)
        ours = np.fromfile(path.with_suffix(".f32"), "<f4").reshape(shape)
        theirs = mitsuba_render.render(description, arguments.spp, arguments.seeds)
        a, b = tiles(ours), tiles(theirs)
        t = t_values(a, b)
        # The smaller of the two samples bounds Welch's degrees of freedom from below.
        limit = critical_t(arguments.seeds - 1, t.size)
        relative = np.sqrt(((a.mean(0) - b.mean(0)) ** 2).sum() / (b.mean(0) ** 2).sum())
        noise = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)).sum() / len(a) / (b.mean(0) ** 2).sum())
        means = a.mean(axis=(1, 2, 3)), b.mean(axis=(1, 2, 3))
        difference = means[0].mean() / means[1].mean() - 1
        error = np.sqrt((means[0].var(ddof=1) + means[1].var(ddof=1)) / len(a)) / means[1].mean()
        tiles_agree = np.abs(t).max() < limit or path.stem in MEAN_ALONE
        agrees = tiles_agree and abs(difference) < MEAN_DIFFERENCE
        # Control: two percent more light must be told.
        control = np.abs(t_values(a * 1.02, b)).max() > limit
        verdict = "agrees" if agrees and control else "DISAGREES" if control else "CANNOT TELL 2 %"
        print(
            f"{path.stem}: {verdict}; mean {100 * difference:+.3f} % ± {100 * error:.3f}; largest |t| {np.abs(t).max():.2f} of {limit:.2f} allowed, mean t {t.mean():+.3f}, "
            f"relative difference of tiles {relative:.2e}, expected from noise {noise:.2e}"
        )
        for name, picture in (("relight", ours.mean(0)), ("mitsuba", theirs.mean(0)), ("t", t)):
            mi.Bitmap(picture.astype(np.float32)).write(str(OUT / f"{path.stem}_{name}.exr"))
        failures += not (agrees and control)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
