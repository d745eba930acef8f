#!/usr/bin/env python3
"""How many workers keep a policy server busy: `robostress sweep --policy-url` against a stand-in.

  VENV/bin/python tests/eval/launch/policy_throughput.py BUILD/bin [--compute-ms 50] [--batch 1,4,8]
      [--workers 1,2,4,8,12,16] [--window 15]

The stand-in speaks openpi's wire and computes nothing: it takes what waits, up to `batch` questions,
and answers all of them after --compute-ms, as a device does beside a thread that reads and writes:
a batch begins when the one before it ends. Its capacity is batch / compute-ms. A row: answers per
second in a window in which all workers are connected, beside that; the processor time of workers.
VENV: the environment of tests/common/wire (websockets). Writes a Markdown table.
"""

import argparse
import asyncio
import os
import resource
import shutil
import struct
import subprocess
import sys
import tempfile
import time

import websockets

HORIZON, WIDTH = 10, 7


def answer():
    """{actions: [10, 7] of zeros} in msgpack, as openpi's server packs it."""
    data = bytes(4 * HORIZON * WIDTH)
    array = (b"\x84\xc4\x0b__ndarray__\xc3\xc4\x04data\xc5" + struct.pack(">H", len(data)) + data +
             b"\xc4\x05dtype\xa3<f4\xc4\x05shape\x92" + bytes([HORIZON, WIDTH]))
    return b"\x81\xa7actions" + array


class StandIn:
    def __init__(self, compute_s, batch):
        self.compute_s, self.batch = compute_s, batch
        self.waiting = asyncio.Queue()
        self.connected = 0
        self.served = []  # when
        self.batches = []

    async def compute(self):
        free = 0.0  # when the device is done; a question that was there by then need not wait for us
        while True:
            due = [await self.waiting.get()]
            while len(due) < self.batch and not self.waiting.empty():
                due.append(self.waiting.get_nowait())
            free = max(free, due[0][0]) + self.compute_s
            await asyncio.sleep(free - time.monotonic())
            self.batches.append(len(due))
            for _, future in due:
                self.served.append(time.monotonic())
                if not future.done():
                    future.set_result(None)

    async def serve(self, socket):
        await socket.send(b"\x80")
        self.connected += 1
        try:
            async for _ in socket:
                future = asyncio.get_running_loop().create_future()
                self.waiting.put_nowait((time.monotonic(), future))
                await future
                await socket.send(answer())
        except websockets.ConnectionClosed:
            pass
        finally:
            self.connected -= 1


def processor_s(root):
    """Of a process and of its descendants that live: workers have process groups of their own."""
    parents, used, ticks = {}, {}, os.sysconf("SC_CLK_TCK")
    for entry in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{entry}/stat", encoding="utf-8") as file:
                fields = file.read().rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(entry)], used[int(entry)] = int(fields[1]), (int(fields[11]) + int(fields[12])) / ticks
    family = {root}
    while grown := {pid for pid, parent in parents.items() if parent in family} - family:
        family |= grown
    return sum(used.get(pid, 0.0) for pid in family)


async def ended(sweep):
    """Whoever answers lives on meanwhile: a worker ends with its question answered."""
    sweep.terminate()
    while sweep.poll() is None:
        await asyncio.sleep(0.05)


async def row(options, batch, workers):
    stand_in = StandIn(options.compute_ms / 1000, batch)
    computing = asyncio.create_task(stand_in.compute())
    out = tempfile.mkdtemp()
    async with websockets.serve(stand_in.serve, "127.0.0.1", 0, max_size=None, compression=None) as server:
        port = server.sockets[0].getsockname()[1]
        command = [
            os.path.join(options.bin, "robostress-sweep"), "--policy-url", f"ws://127.0.0.1:{port}",
            "--suites", "tabletop_goal", "--tasks", "all", "--episodes", "20", "--scenarios", "clean",
            "--methods", options.method, "--workers", str(workers), "--split-episodes", "4", "--no-report",
            "--quiet", "--out", os.path.join(out, "run")]
        messages = tempfile.TemporaryFile()
        sweep = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=messages)
        try:
            deadline = time.monotonic() + 120
            while stand_in.connected < workers or not stand_in.served:
                await asyncio.sleep(0.05)
                if sweep.poll() is not None or time.monotonic() > deadline:
                    sweep.terminate()
                    messages.seek(0)
                    print(f"the sweep did not connect {workers} workers: {messages.read().decode()}",
                          file=sys.stderr, flush=True)
                    os._exit(1)  # nobody waits for the connections
            await asyncio.sleep(2)
            begin, used, first = time.monotonic(), processor_s(sweep.pid), len(stand_in.batches)
            await asyncio.sleep(options.window)
            took, used = time.monotonic() - begin, processor_s(sweep.pid) - used
            served = sum(1 for when in stand_in.served if begin <= when < begin + took)
            batches = stand_in.batches[first:]
        finally:
            await ended(sweep)
    computing.cancel()  # only now: a connection is left when its question has its answer
    shutil.rmtree(out, ignore_errors=True)
    capacity = batch * 1000 / options.compute_ms
    rate = served / took
    print(f"| {batch} | {capacity:.0f} | {workers} | {rate:.1f} | {rate / capacity:.2f} | "
          f"{sum(batches) / max(1, len(batches)):.1f} | {used / took:.2f} |", flush=True)


async def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin")
    parser.add_argument("--compute-ms", type=float, default=50)
    parser.add_argument("--batch", default="1,4,8")
    parser.add_argument("--workers", default="1,2,4,8,12,16")
    parser.add_argument("--window", type=float, default=15)
    parser.add_argument("--method", default="base")
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print("| batch | capacity [1/s] | workers | answers [1/s] | of capacity | mean batch | cores used |")
    print("|---:|---:|---:|---:|---:|---:|---:|", flush=True)
    for batch in map(int, options.batch.split(",")):
        for workers in map(int, options.workers.split(",")):
            await row(options, batch, workers)


if __name__ == "__main__":
    asyncio.run(main())
