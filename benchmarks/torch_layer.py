"""The layer of torch: seconds and memory of forward and backward, and of forward alone.

    python benchmarks/torch_layer.py [--size 512] [--batch 1] [--repeats 3]

A textured square before a slope; of 512 pixels circles are up to 12 wide. Seconds are the least of
the repeats, after one that compiles kernels. Memory is the most that the process has held during a
call beyond what it held before, read every 5 ms. Each case runs in a process of its own.
"""

import argparse
import json
import os
import subprocess
import sys
import threading
import time

CASES = {
    "no_grad": (),
    "lens": ("focus_distance", "f_number"),
    "rgb": ("rgb",),
    "depth": ("depth",),
    "all": ("rgb", "depth", "focus_distance", "f_number", "focal_length"),
}


def resident():
    """Bytes of memory that the process has."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


class Peak:
    """The most memory while a block runs, beyond what there was before."""

    def __enter__(self):
        self.before, self.most, self.over = resident(), 0, False
        self.thread = threading.Thread(target=self.watch)
        self.thread.start()
        return self

    def watch(self):
        while not self.over:
            self.most = max(self.most, resident() - self.before)
            time.sleep(0.005)

    def __exit__(self, *_):
        self.over = True
        self.thread.join()


def scene(size, batch):
    import torch

    torch.manual_seed(1)
    coarse = torch.rand(batch, 3, size // 4, size // 4)
    rgb = torch.nn.functional.interpolate(coarse, size, mode="bilinear")
    depth = (4 + 4 * torch.arange(size) / size) * torch.ones(batch, 1, size, 1)
    depth[..., size // 4 : size // 2, size // 4 : size // 2] = 2.0
    return {
        "rgb": rgb,
        "depth": depth,
        "focus_distance": torch.tensor(3.0),
        "f_number": torch.tensor(1.0),
        "focal_length": torch.tensor(50.0),
    }


def measure(case, size, batch, repeats):
    import drjit as dr
    import torch

    from potmesil_mi.torch import focus

    given = scene(size, batch)
    for name in CASES[case]:
        given[name].requires_grad_()

    def call():
        begun = time.perf_counter()
        with torch.set_grad_enabled(bool(CASES[case])):
            picture = focus(**given, frame_width=18.0, millimeters_per_unit=1000.0)
        formed = time.perf_counter()
        if CASES[case]:
            picture.square().mean().backward()
        return formed - begun, time.perf_counter() - formed

    call()
    seconds = [call() for _ in range(repeats)]
    dr.flush_malloc_cache()
    with Peak() as peak:
        call()
    best = min(seconds, key=sum)
    print(json.dumps([*best, peak.most]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--case", choices=CASES, help="this one alone, in this process")
    given = parser.parse_args()
    if given.case:
        measure(given.case, given.size, given.batch, given.repeats)
        return
    options = [f"--{name}={getattr(given, name)}" for name in ("size", "batch", "repeats")]
    plain = None
    print("gradients of   forward s  backward s  both/no_grad   memory MB  of no_grad")
    for case in CASES:
        command = [sys.executable, __file__, *options, f"--case={case}"]
        result = subprocess.run(command, capture_output=True, text=True, check=True)
        forward, backward, memory = json.loads(result.stdout.splitlines()[-1])
        plain = plain or (forward, memory)
        ratios = (forward + backward) / plain[0], memory / plain[1]
        print(
            f"{case:14} {forward:9.2f} {backward:11.2f} {ratios[0]:13.2f} "
            f"{memory / 1e6:11.0f} {ratios[1]:11.2f}"
        )


if __name__ == "__main__":
    main()
