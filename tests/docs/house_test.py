#!/usr/bin/env python3
"""Whether the picture of the house is the house: house_test.py ROOT BUILD FOLDER.

Every arrow is an include of the sources, every include between rooms goes along arrows, the programs that
link LibTorch are those that the picture names, and the pictures are what house.py draws.
"""

import os
import re
import subprocess
import sys

sys.dont_write_bytecode = True
ROOT, BUILD, FOLDER = map(os.path.abspath, sys.argv[1:4])
sys.path.insert(0, os.path.join(ROOT, "docs", "pictures"))
import house  # noqa: E402, beside the pictures that it draws

ROOMS = ("common/wire", "common/rpc", "common/unit", "common", "proto", "server", "calibration", "sim_worker",
         "robot_client", "eval", "python")


def lora_files():
    with open(os.path.join(ROOT, "adapter", "CMakeLists.txt"), encoding="utf-8") as file:
        library = re.search(r"rs_adapter_torch\b(.*?)DEPS", file.read(), re.S).group(1)
    return {name.removesuffix(".cc") for name in library.split()}


def room_of(path, lora):
    if path.startswith("adapter/"):
        return "LORA" if os.path.splitext(path[len("adapter/"):])[0] in lora else "CORE"
    return next((room for room in ROOMS if path.startswith(room + "/")), None)


def includes():
    """{(room, room that it includes): one file that does}"""
    lora, edges = lora_files(), {}
    for top in {room.split("/")[0] for room in ROOMS} | {"adapter"}:
        for folder, _, names in os.walk(os.path.join(ROOT, top)):
            for name in names:
                if not name.endswith((".h", ".cc")):
                    continue
                path = os.path.relpath(os.path.join(folder, name), ROOT)
                with open(os.path.join(ROOT, path), encoding="utf-8") as file:
                    for included in re.findall(r'^#include "([^"]+)"', file.read(), re.M):
                        edge = (room_of(path, lora), room_of(included, lora))
                        if None not in edge and edge[0] != edge[1]:
                            edges.setdefault(edge, path)
    return edges


def below(room, arrows):
    found, left = set(), [room]
    while left:
        for under in arrows.get(left.pop(), ()):
            if under not in found:
                found.add(under)
                left.append(under)
    return found


def programs_with_torch():
    with open(os.path.join(BUILD, "build.ninja"), encoding="utf-8") as file:
        rules = re.findall(r"^build bin/robostress-([\w-]+): .*?LINK_LIBRARIES = (.*?)\n", file.read(),
                           re.M | re.S)
    return sorted(name for name, libraries in rules if re.search(r"libtorch(_cpu)?\.so", libraries))


def faults():
    arrows, edges = {}, includes()
    for upper, lower, _ in house.STANDS_ON:
        arrows.setdefault(upper, set()).add(lower)
        if (upper, lower) not in edges:
            yield f"the picture's arrow from {upper} to {lower}: no file of {upper} includes one of {lower}"
    for (upper, lower), file in sorted(edges.items()):
        if lower not in below(upper, arrows):
            yield f"{file} includes {lower}: no way of arrows leads there from {upper}"
    if os.path.exists(os.path.join(BUILD, "build.ninja")) and programs_with_torch() != sorted(house.LIBTORCH):
        yield f"LibTorch is linked by {programs_with_torch()}; the picture says {sorted(house.LIBTORCH)}"
    os.makedirs(FOLDER, exist_ok=True)
    subprocess.run([sys.executable, house.__file__, FOLDER], check=True)
    for name in ("house.svg", "processes.svg"):
        with open(os.path.join(FOLDER, name), encoding="utf-8") as drawn, \
                open(os.path.join(house.HERE, name), encoding="utf-8") as kept:
            if drawn.read() != kept.read():
                yield f"docs/pictures/{name} is not what docs/pictures/house.py draws: run it"


if __name__ == "__main__":
    found = list(faults())
    print("\n".join(found))
    sys.exit(1 if found else 0)
