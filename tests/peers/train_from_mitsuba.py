"""Trains from lightmaps that Mitsuba 3 rendered, and from our own of the same lights: the errors must agree.

    train_from_mitsuba.py [--samples 4096] [--conditions 96] [--held-out 64]

`relight export-conditions` writes the Cornell box under spot lights (lightmap of 32² texels), `python/render_mitsuba.py` renders
it, `relight train --dataset` trains; beside it `relight train` bakes and trains the same conditions. Compared is the relative
RMSE of each held-out condition, pairwise: the mean difference must be within three of its standard errors over conditions, plus
what the difference of the two renderers' noise does to it. Then the models are crossed: what Mitsuba's lightmaps trained is
tested on ours. Controls must be beyond the margin of the crossed models: training lightmaps a tenth too bright, and training
lightmaps of other conditions.

Exit status 0: all agree, and the controls do not. Folders stay under target/peers/rendered.
"""

import argparse
import glob
import json
import pathlib
import shutil
import subprocess
import sys

import numpy as np
from safetensors.numpy import load_file

ROOT = pathlib.Path(__file__).parents[2]
OUT = ROOT / "target" / "peers" / "rendered"
RELIGHT = ROOT / "target" / "release" / "relight"
SCENE = ROOT / "scenes" / "cornell" / "scene.toml"
SETTINGS = "--size 32 --points 64 --basis 16 --max-bounces 8".split()
SIGMAS = 3

sys.path.insert(0, str(ROOT / "python"))
import relight_folder  # noqa: E402: it lies in that folder


def relight(*arguments):
    subprocess.run([RELIGHT, *map(str, arguments)], cwd=OUT, check=True, capture_output=True)


def train(name, *more):
    relight("train", SCENE, *SETTINGS, "-o", f"{name}.relight", "--json", f"{name}.json", *more)
    return json.loads((OUT / f"{name}.json").read_text())["error"]


def own_lightmaps(dataset):
    """I of a dataset of ours, [condition][texel][channel], and the texels' indices."""
    batches = json.loads((dataset / "manifest.json").read_text())["batches"]

    def shard(path):
        tensors = load_file(path)
        return tensors["indirect"].astype(np.float32) * tensors["scale"]

    batches = [[shard(p) for p in sorted(glob.glob(f"{dataset}/batch-{b:03}/tile-*"))] for b in range(len(batches))]
    indirect = np.concatenate([np.concatenate(tiles) for tiles in batches], axis=2)
    return indirect.transpose(2, 0, 1), load_file(dataset / "texels.safetensors")["index"]


def variant(name, change):
    """A copy of Mitsuba's folder with lightmaps as `change(number, entry, lightmap)` has them."""
    shutil.rmtree(OUT / name, ignore_errors=True)
    shutil.copytree(OUT / "mitsuba", OUT / name, ignore=shutil.ignore_patterns("shards"))
    folder = relight_folder.Folder(OUT / name)
    lightmaps = [relight_folder.read_exr(OUT / "mitsuba" / c["indirect"]) for c in folder.conditions]
    for i, entry in enumerate(folder.conditions):
        relight_folder.write_exr(folder.path / entry["indirect"], change(i, entry, lightmaps))
    return train(name, "--dataset", name)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=4096, help="paths a texel, in both renderers")
    parser.add_argument("--conditions", type=int, default=96)
    parser.add_argument("--held-out", type=int, default=64)
    arguments = parser.parse_args()
    subprocess.run(["cargo", "build", "--quiet", "--release"], cwd=ROOT, check=True)
    OUT.mkdir(parents=True, exist_ok=True)
    counts = ["--conditions", arguments.conditions, "--held-out", arguments.held_out]
    shutil.rmtree(OUT / "mitsuba", ignore_errors=True)
    relight("export-conditions", SCENE, *SETTINGS, *counts, "-o", "mitsuba")
    script = [sys.executable, ROOT / "python" / "render_mitsuba.py", "mitsuba", "--samples", str(arguments.samples)]
    subprocess.run(script, cwd=OUT, check=True, stdout=subprocess.DEVNULL)
    theirs = train("mitsuba", "--dataset", "mitsuba")
    shutil.rmtree(OUT / "own.dataset", ignore_errors=True)
    ours = train("own", *counts, "--paths", arguments.samples, "--integrator", "path")

    # The held-out lightmaps of ours, in a page as Mitsuba's are.
    lightmaps, index = own_lightmaps(OUT / "own.dataset")
    size = 32

    def page(i):
        page = np.zeros((size * size, 3), np.float32)
        page[index] = lightmaps[i]
        return page.reshape(size, size, 3)

    held_out_ours = lambda train: lambda i, entry, all: page(i) if entry["held_out"] else train(i, all)
    crossed = variant("crossed", held_out_ours(lambda i, all: all[i]))
    bright = variant("bright", held_out_ours(lambda i, all: 1.1 * all[i]))
    permuted = variant("permuted", held_out_ours(lambda i, all: all[(i + 1) % arguments.conditions]))

    own, failures = np.array(ours["each"]), 0
    # Independent noise adds to an error by its square.
    noise = abs(theirs["noise"] ** 2 - ours["noise"] ** 2) / (2 * own.mean())
    print(
        f"our own: {100 * own.mean():.2f} % ± {100 * own.std(ddof=1) / len(own) ** 0.5:.2f} over {len(own)} conditions; "
        f"noise {100 * ours['noise']:.2f} %, Mitsuba's {100 * theirs['noise']:.2f} %"
    )
    for name, error in (("mitsuba", theirs), ("crossed", crossed), ("bright", bright), ("permuted", permuted)):
        difference = np.array(error["each"]) - own
        sigma = difference.std(ddof=1) / len(own) ** 0.5
        control = name in ("bright", "permuted")
        # A control's own spread is no excuse: it has the margin of the pair before it.
        margin = margin if control else SIGMAS * sigma + noise
        within = abs(difference.mean()) <= margin
        verdict = "CONTROL NOT TOLD" if control and within else "told" if control else "agrees" if within else "DISAGREES"
        failures += within == control
        print(
            f"{name}: {verdict}; {100 * error['mean']:.2f} %, difference {100 * difference.mean():+.2f} % ± {100 * sigma:.2f}, "
            f"margin {100 * margin:.2f}"
        )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
