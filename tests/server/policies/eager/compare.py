"""Ours against the same network in PyTorch's eager mode and against its matrix products alone, in one run: the program
and this process predict in turn, so that both meet the same load. Started by compare.sh."""
import argparse
import subprocess
import sys
import tempfile
import time

import torch

import nano_eager
import openpi_eager
import tensor_file

TOLERANCE = 1e-4


def measure(f):
    """-> result, processor time [ms], wall time [ms]"""
    cpu, wall = time.process_time(), time.perf_counter()
    result = f()
    return result, 1e3 * (time.process_time() - cpu), 1e3 * (time.perf_counter() - wall)


def quantile(values, q):
    return sorted(values)[int(q * (len(values) - 1) + 0.5)]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", required=True)
    parser.add_argument("--policy", default="nano")
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--threads", type=int, default=1)
    arguments, others = parser.parse_known_args()
    torch.set_num_threads(arguments.threads)
    times = {}

    def note(name, cpu, wall):
        times.setdefault(name, []).append((cpu, wall))

    with tempfile.TemporaryDirectory() as folder, torch.no_grad():
        program = subprocess.Popen([arguments.program, "--policy", arguments.policy, "--threads", str(arguments.threads),
                                    "--files", folder, "--lockstep"] + others, stdin=subprocess.PIPE,
                                   stdout=subprocess.PIPE, text=True)
        if program.stdout.readline().strip() != "ready":
            sys.exit("the program did not start")
        io, _ = tensor_file.read(folder + "/io.safetensors")
        network = nano_eager if arguments.policy == "nano" else openpi_eager
        encode, sample = network.make(*tensor_file.read(folder + "/weights.safetensors"), io)
        error = (sample(encode()) - io["expected/actions"]).abs().max().item()
        print(f"largest difference of actions: {error:.1e} (tolerance {TOLERANCE:.0e})")
        if not error <= TOLERANCE:
            sys.exit("the networks differ")
        for _ in range(arguments.rounds):
            program.stdin.write("round\n")
            program.stdin.flush()
            for entry in program.stdout.readline().split():
                name, value = entry.split("=")
                note(name, *map(float, value.split(",")))
            context, cpu, wall = measure(encode)
            note("encode_eager", cpu, wall)
            _, cpu, wall = measure(lambda: sample(context))
            note("sample_eager", cpu, wall)
        program.stdin.close()
        program.wait()

    for kind in ("", "_eager", "_products", "_packed"):
        pairs = zip(times["encode" + kind], times["sample" + kind])
        times["both" + kind] = [(a + c, b + d) for (a, b), (c, d) in pairs]
    print(f"{arguments.policy} {' '.join(others)}: {arguments.rounds} rounds, {arguments.threads} thread(s), ms")
    print(f"{'':16}{'cpu min':>10}{'cpu p50':>10}{'cpu p99':>10}{'wall p50':>10}{'wall p99':>10}")
    for stage in ("encode", "sample", "both"):
        for kind in ("", "_eager", "_products", "_packed"):
            cpu, wall = zip(*times[stage + kind])
            print(f"{stage + kind:16}{min(cpu):10.3f}{quantile(cpu, .5):10.3f}{quantile(cpu, .99):10.3f}"
                  f"{quantile(wall, .5):10.3f}{quantile(wall, .99):10.3f}")
    for stage in ("encode", "sample", "both"):
        ours = [cpu for cpu, _ in times[stage]]
        ratios = []
        for kind in ("_eager", "_products", "_packed"):
            other = [cpu for cpu, _ in times[stage + kind]]
            by_min, by_median = min(other) / min(ours), quantile(other, .5) / quantile(ours, .5)
            if kind != "_eager":
                by_min, by_median = 1 / by_min, 1 / by_median
            ratios += [f"{by_min:.2f} ({by_median:.2f})"]
        print(f"{stage}: {ratios[0]} times faster than eager, {ratios[1]} times its products through LibTorch, "
              f"{ratios[2]} times them through packed weights; by least processor time (by its median)")


if __name__ == "__main__":
    main()
