"""The bake's speed beside Mitsuba 3, Cycles and this program's own path tracer, at equal error.

    bake_speed.py [--sample 16] [--wrap COMMAND]

128 hard-coned spot lights in the open Cornell box, lightmap of 128² texels, indirect irradiance, 8 bounces, 2 threads.
`examples/peer_bake.rs` writes scene, lights and a converged reference into target/peers/bake (the first time takes a quarter
of an hour) and bakes all conditions at once. The others bake one condition at a time (`mitsuba_bake.py`, `cycles_bake.py`).

- Error: per condition the relative RMSE against the reference, area weighted over texels and channels, less the reference's
  own noise (in squares); the mean over conditions.
- The others bake a sample of the conditions, evenly spread, with as many samples as bring them to the error that relight
  has on these very conditions; their time is reckoned from there to all conditions, and by 1/error² to exactly equal error.
- relight's path tracer with one condition at a time: four conditions with a quarter of the paths, times in proportion.
- Times are of baking alone: without loading, compilation of kernels, and files. "CPU" is processor time of all threads, which
  other work on the machine disturbs less. relight's are the least of several runs.
- Cycles takes a texel's middle for the whole of it: it is held against the texels that are wholly covered.

Exit status 1: a renderer's mean level is more than a hundredth off the reference's, so that the comparison means nothing.

Not part of tests/run. Needs target/venv with tests/peers/requirements.txt and Debian's libllvm22 for Mitsuba, and for Cycles
target/venv-cycles, a Python 3.11 with tests/peers/requirements-cycles.txt; what is missing is left out.
"""

import argparse
import json
import math
import pathlib
import shlex
import subprocess
import sys

import numpy as np

ROOT = pathlib.Path(__file__).parents[2]
PEERS = ROOT / "tests" / "peers"
OUT = ROOT / "target" / "peers" / "bake"
EXAMPLE = ROOT / "target" / "release" / "examples" / "peer_bake"
CONDITIONS = 128
# Mean relative RMSE at which everybody is compared; the second with this program's own path tracer alone.
ERRORS = (0.15, 0.05)
MOST_LEVEL = 0.01
# A texel counts as wholly covered from here on.
COVERED = 0.999
# relight's own path tracer bakes so many conditions one by one, with this fraction of the paths.
ALONE, PART = 4, 4


class Run:
    """A bake: samples a texel, errors and levels per condition baked, seconds and processor seconds for all conditions."""

    def __init__(self, samples, errors, levels, seconds, cpu_seconds):
        self.samples, self.errors, self.levels = samples, np.array(errors), np.array(levels)
        self.seconds, self.cpu_seconds = seconds, cpu_seconds

    def error(self, conditions=slice(None)):
        return self.errors[conditions].mean()


class Comparison:
    def __init__(self, wrap, sample):
        self.wrap = wrap
        self.sample = [i * CONDITIONS // sample for i in range(sample)]
        self.reference = self.texels = self.noise = None

    def call(self, *command):
        done = subprocess.run([*self.wrap, *map(str, command)], stdout=subprocess.PIPE, text=True)
        if done.returncode != 0:
            sys.exit(f"{shlex.join(map(str, command))}: failed\n{done.stdout[-2000:]}")
        return done.stdout

    def relight(self, integrator, paths, *options):
        figures = json.loads(self.call(EXAMPLE, "bake", OUT, integrator, paths, *options))
        keys = ("errors", "levels", "seconds", "cpu_seconds")
        return Run(paths, *(figures.get(key, []) for key in keys))

    def load(self):
        self.texels = np.fromfile(OUT / "texels.f32", "<f4").reshape(-1, 3)
        shape = (len(self.texels), 3, CONDITIONS)
        self.reference = np.fromfile(OUT / "reference.f32", "<f4").reshape(shape)
        self.noise = np.array(json.loads((OUT / "reference.json").read_text())["noise"])

    def peer(self, name, python, samples):
        output = OUT / f"{name}.npz"
        self.call(python, PEERS / f"{name}_bake.py", OUT, output, samples, *self.sample)
        baked = np.load(output)
        errors, levels = [], []
        for condition, irradiance in zip(self.sample, baked["irradiance"].astype(np.float64)):
            reference = self.reference[:, :, condition].astype(np.float64)
            counts = np.isfinite(irradiance).all(axis=1)
            if not counts.all():
                counts &= self.texels[:, 2] > COVERED
            area, a, b = self.texels[counts, 1:2], irradiance[counts], reference[counts]
            square = (area * (a - b) ** 2).sum() / (area * b * b).sum() - self.noise[condition] ** 2
            errors.append(math.sqrt(max(square, 0)))
            levels.append((area * a).sum() / (area * b).sum())
        seconds, cpu_seconds = (CONDITIONS * np.mean(baked[key]) for key in ("seconds", "cpu_seconds"))
        return Run(samples, errors, levels, seconds, cpu_seconds)


def samples_for(target, pilot, error):
    """A Monte Carlo error falls as the root of the samples."""
    return max(1, math.ceil(pilot * (error / target) ** 2))


def reach(target, bake, samples):
    """The bake with about the fewest samples that stays under `target`."""
    best = None
    for _ in range(5):
        run = bake(samples)
        if run.error() <= target and (best is None or samples < best.samples):
            best = run
        proposed = samples_for(target, samples, run.error())
        if best is not None and proposed >= 0.95 * best.samples:
            break
        # Just above the target is still above it.
        samples = proposed if best is not None else max(proposed, math.ceil(samples * 1.03))
    if best is None:
        sys.exit(f"no number of paths reaches the error {target}: {run.error():.3f} with {run.samples}")
    return best


def row(name, run, ours, scale=1):
    """Prints a line of the table, times multiplied by `scale`; returns whether the level is off."""
    seconds, cpu_seconds, level = run.seconds * scale, run.cpu_seconds * scale, run.levels.mean() - 1
    ratios = f"{seconds / ours.seconds:8,.0f} x {cpu_seconds / ours.cpu_seconds:8,.0f} x"
    times = f"{seconds:10.3f} {cpu_seconds:10.3f}"
    print(f"{name:34} {run.samples:6} {run.error():7.4f} {level:>+7.2%} {times} {ratios}", flush=True)
    return abs(level) > MOST_LEVEL


def at_equal_error(name, run, ours, target):
    return row(name, run, ours, (run.error() / target) ** 2)


def compare(comparison, peers):
    """Prints the table; returns the bake that reaches the first error, and how many levels are off."""
    failures, first, shared = 0, None, None
    print(f"{'':34} {'rays':>6} {'error':>7} {'level':>7} {'seconds':>10} {'CPU':>10} {'ratio':>10} {'CPU':>10}")
    for error in ERRORS:
        start = samples_for(error, first.samples, first.error()) if first else 64
        found = reach(error, lambda paths: comparison.relight("gather", paths, "--repeats", 1), start)
        ours = comparison.relight("gather", found.samples, "--repeats", 5)
        print(f"-- relative RMSE {error}; on the sample, {ours.error(comparison.sample):.4f}")
        failures += row("relight gather, all at once", ours, ours)
        start = samples_for(error, shared.samples, shared.error()) if shared else 256
        shared = comparison.relight("path", start, "--repeats", 1)
        failures += at_equal_error("relight path, all at once", shared, ours, error)
        # Time is linear in the paths, and a condition's error does not depend on the others.
        part = max(1, start // PART)
        alone = comparison.relight("path", part, "--alone", ALONE, "--repeats", 1)
        seconds, cpu_seconds = (t * start / part for t in (alone.seconds, alone.cpu_seconds))
        alone = Run(start, shared.errors, alone.levels, seconds, cpu_seconds)
        failures += at_equal_error(f"relight path, one by one (of {ALONE})", alone, ours, error)
        if first is None:
            first = ours
            failures += sum(against(comparison, name, python, ours) for name, python in peers.items())
    return first, failures


def against(comparison, name, python, ours):
    """The line of a peer; returns whether its level is off."""
    target = ours.error(comparison.sample)
    pilot = comparison.peer(name, python, 32)
    run = comparison.peer(name, python, samples_for(target, pilot.samples, pilot.error()))
    return at_equal_error(f"{name}, one by one (of {len(comparison.sample)})", run, ours, target)


def scaling(comparison, paths):
    """The cost of conditions, threads and texels."""
    print(f"-- relight gather, {paths} rays a texel")
    first = None
    for size, conditions, threads in (
        (128, 128, 2), (128, 1024, 2), (128, 128, 1), (128, 1024, 1), (64, 128, 2), (256, 128, 2),
    ):
        options = ("--size", size, "--conditions", conditions, "--threads", threads, "--repeats", 3)
        run = comparison.relight("gather", paths, *options)
        first = first or run
        ratios = f"{run.seconds / first.seconds:8.2f} x {run.cpu_seconds / first.cpu_seconds:8.2f} x"
        name = f"{size}² texels, {conditions} conditions, {threads} threads"
        print(f"{name:57} {run.seconds:10.3f} {run.cpu_seconds:10.3f} {ratios}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, default=16, help="conditions that Mitsuba and Cycles bake")
    parser.add_argument("--wrap", type=shlex.split, default=[], help="a command to run every bake with, such as taskset")
    arguments = parser.parse_args()
    subprocess.run(["cargo", "build", "--quiet", "--release", "--example", "peer_bake"], cwd=ROOT, check=True)
    subprocess.run([EXAMPLE, "scene", OUT, "--reference-paths", "16384"], check=True)
    comparison = Comparison(arguments.wrap, arguments.sample)
    comparison.load()
    print(f"reference: mean relative noise {comparison.noise.mean():.4f}")
    peers = {"mitsuba": ROOT / "target/venv/bin/python", "cycles": ROOT / "target/venv-cycles/bin/python"}
    for name in [name for name, python in peers.items() if not python.exists()]:
        print(f"{name} is left out: no {peers.pop(name)}")
    ours, failures = compare(comparison, peers)
    scaling(comparison, ours.samples)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
