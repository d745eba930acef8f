"""LIBERO's environments with the shared tree's assets, whose missing visual files get stand-ins without mass or contact."""
import json
import os
import pathlib
import re
import struct
import tempfile
import zlib

import numpy as np
from robostress.libero_success import stored_states

SHARED = pathlib.Path(os.environ.get("ROBOSTRESS_SHARED") or pathlib.Path(__file__).parents[4] / "shared")
TREE, RECORDED = SHARED / "data/libero_tree/libero/libero", SHARED / "oracles/libero"
CUBE = [(x, y, z) for x in (-0.01, 0.01) for y in (-0.01, 0.01) for z in (-0.01, 0.01)]
FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
         (1, 5, 7), (1, 7, 3)]


def png():
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + b"\x80" * 24 for _ in range(8))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 8, 8, 8, 2, 0, 0, 0)) + chunk(
        b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def stl():
    corners = np.array(CUBE, "<f4")
    return b"\0" * 80 + struct.pack("<I", len(FACES)) + b"".join(
        b"\0" * 12 + corners[list(face)].tobytes() + b"\0\0" for face in FACES)


STAND_INS = {".png": png(), ".stl": stl(), ".msh": struct.pack("<4i", 8, 0, 0, 12) + np.array(CUBE, "<f4").tobytes() + np.array(
    FACES, "<i4").tobytes()}


def use_assets(folder):
    """Points LIBERO at the shared tree's assets in `folder`, links and stand-ins."""
    os.environ["LIBERO_CONFIG_PATH"] = str(folder)
    folder.joinpath("config.yaml").write_text("assets: unused\n")  # it asks questions without
    assets = folder / "assets"
    for source in TREE.joinpath("assets").rglob("*"):
        target = assets / source.relative_to(TREE / "assets")
        if source.is_file() and not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            target.symlink_to(source)
    for xml in list(assets.rglob("*.xml")):
        for name in re.findall(r'file="([^"]+)"', xml.read_text()):
            missing = xml.parent / name
            if not missing.exists() and missing.suffix in STAND_INS:
                missing.parent.mkdir(parents=True, exist_ok=True)
                missing.write_bytes(STAND_INS[missing.suffix])
    import libero.libero
    for name in re.findall(r'"([^"]+\.png)"', pathlib.Path(libero.libero.__file__).parent.joinpath(
            "envs/arenas/style.py").read_text()):
        assets.joinpath("textures").mkdir(exist_ok=True)
        assets.joinpath("textures", name).write_bytes(STAND_INS[".png"])
    libero.libero._assets_path_cache = str(assets)


def initial_states(suite, name):
    return stored_states(TREE / "init_files" / suite / f"{name}.pruned_init")


def recorded(task):
    """Name of a task such as libero_goal_03, and the commands [90, 7] of its recording."""
    with open(RECORDED / f"{task}.safetensors", "rb") as file:
        header = json.loads(file.read(struct.unpack("<Q", file.read(8))[0]))
        begin, end = header["actions"]["data_offsets"]
        start = file.tell()
        file.seek(start + begin)
        rows = np.frombuffer(file.read(end - begin)).reshape(header["actions"]["shape"])
    return json.loads((RECORDED / f"{task}.json").read_text())["name"], rows


def environment(task):
    from libero.libero import envs
    suite, (name, rows) = task.rsplit("_", 1)[0], recorded(task)
    env = envs.OffScreenRenderEnv(bddl_file_name=str(TREE / "bddl_files" / suite / f"{name}.bddl"), use_camera_obs=False)
    return env, initial_states(suite, name)[0], rows


def prepare():
    """Once a process; the folder lives as long."""
    folder = tempfile.TemporaryDirectory()
    use_assets(pathlib.Path(folder.name))
    return folder
