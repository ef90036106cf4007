#!/usr/bin/env python3
"""Times ray tracing against Embree 3: the same triangles, the same rays, one ray at a time, one thread.

    embree_trace.py [--repeats 7] [--rays 400000] [MESH ...]

Needs g++ and libembree-dev. Both programs read FILE (little-endian: u32 triangles, u32 rays, f32 corners[triangles][3][3],
f32 rays[rays][3][3], a ray being its origin, its direction and the segment for occlusion), print "ready", and then, for each
line "closest" or "occluded" that they read, "SECONDS HITS SUM": SUM is the sum of the hits' distances. The programs take
turns; the best of each counts. Exit status 1 where they differ by more than 1e-3 of the rays.
"""

import argparse
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).parents[2]
OUT = ROOT / "target" / "peers"
OURS = ROOT / "target" / "release" / "examples" / "trace_peer"


class Program:
    def __init__(self, *command):
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ready(self):
        assert self.process.stdout.readline() == "ready\n", f"{self.process.args[0]} did not start"

    def time(self, what):
        self.process.stdin.write(what + "\n")
        self.process.stdin.flush()
        seconds, hits, total = self.process.stdout.readline().split()
        return float(seconds), int(hits), float(total)

    def end(self):
        self.process.stdin.close()
        self.process.wait()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--rays", type=int, default=400_000)
    parser.add_argument("mesh", nargs="*", default=["room", "cornell", "statue", "hairball"])
    arguments = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    embree = OUT / "embree_trace"
    source = ROOT / "tests" / "peers" / "embree_trace.cpp"
    subprocess.run(["g++", "-O3", "-march=native", "-o", embree, source, "-lembree3"], check=True)
    if not OURS.exists():
        subprocess.run(["cargo", "build", "--release", "--example", "trace_peer"], check=True, cwd=ROOT)
    agree = True
    print("Mrays/s                 ours   Embree, and with spatial splits   ours / Embree")
    for mesh in arguments.mesh:
        file = OUT / f"{mesh}.trace"
        subprocess.run([OURS, "write", mesh, file, str(arguments.rays)], check=True)
        programs = [Program(OURS, "time", mesh, file), Program(embree, file, "medium"), Program(embree, file, "high")]
        for program in programs:
            program.ready()
        for what in ["closest", "occluded"]:
            runs = [[program.time(what) for program in programs] for _ in range(arguments.repeats)]
            ours, medium, high = (arguments.rays / 1e6 / min(run[i][0] for run in runs) for i in range(3))
            ratios = f"{ours / medium:.2f} {ours / high:.2f}"
            print(f"{mesh:10} {what:10} {ours:7.2f} {medium:8.2f} {high:8.2f}   {ratios}", flush=True)
            (_, our_hits, our_sum), (_, their_hits, their_sum) = runs[0][:2]
            same = abs(our_hits - their_hits) <= 1e-3 * arguments.rays and abs(our_sum - their_sum) <= 1e-3 * their_sum
            if not same:
                print(f"  they differ: {our_hits} and {their_hits} hits, distances {our_sum} and {their_sum}")
            agree &= same
        for program in programs:
            program.end()
    sys.exit(0 if agree else 1)


if __name__ == "__main__":
    main()
