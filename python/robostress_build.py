"""PEP 517: librobostress.so from the CMake build and the Python files, in a wheel for every Python.

It needs CMake, a C++20 compiler, Eigen, yaml-cpp and absl, and no Python package: so it builds without a network, and names
the one platform tag that the library asks for, which scikit-build-core leaves to auditwheel.

    pip wheel ./python                                                        compiles the library
    pip wheel ./python --config-settings=library=build/release/lib/librobostress.so.1    takes one; relative to the checkout
"""
import base64
import hashlib
import os
import pathlib
import re
import shutil
import subprocess
import tempfile
import zipfile

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent
LIBRARY = "librobostress.so.1"


def version():
    found = re.search(r"project\(RoboStress VERSION ([0-9.]+)", (ROOT / "CMakeLists.txt").read_text())
    return found.group(1)


def setting(settings, key):
    value = (settings or {}).get(key)
    return value[-1] if isinstance(value, list) else value


def compiled(folder):
    ninja = ["-G", "Ninja"] if shutil.which("ninja") else []
    for command in (["cmake", "-S", str(HERE), "-B", str(folder), "-DCMAKE_BUILD_TYPE=Release", *ninja],
                    ["cmake", "--build", str(folder), "--parallel", str(os.cpu_count() or 1)]):
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode != 0:
            raise SystemExit(f"{' '.join(command)}:\n{done.stdout[-4000:]}\nThe library needs g++ 12, cmake 3.22, "
                             "libeigen3-dev, libyaml-cpp-dev and libabsl-dev.")
    return folder / "lib" / LIBRARY


def platform_tag(library):
    """manylinux of the newest glibc that the library asks for."""
    asked = [int(minor) for minor in re.findall(rb"GLIBC_2\.(\d+)", library)]
    return f"manylinux_2_{max(asked)}_{os.uname().machine}"


def metadata():
    return (f"Metadata-Version: 2.1\nName: robostress\nVersion: {version()}\n"
            "Summary: Joint errors of robot arms, and their compensation, for any Python simulator\n"
            "License: Apache-2.0\nRequires-Python: >=3.8\nRequires-Dist: numpy\nProvides-Extra: client\n"
            "Requires-Dist: msgpack>=1.0.5; extra == 'client'\nRequires-Dist: websockets>=11; extra == 'client'\n")


def prepare_metadata_for_build_wheel(metadata_directory, config_settings=None):
    """Without it pip makes the whole wheel twice."""
    info = pathlib.Path(metadata_directory) / f"robostress-{version()}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(metadata())
    return info.name


def write_wheel(library, folder):
    tag = f"py3-none-{platform_tag(library)}"
    info = f"robostress-{version()}.dist-info"
    files = {f"robostress/{path.relative_to(HERE / 'robostress')}": path.read_bytes()
             for path in sorted((HERE / "robostress").rglob("*")) if path.suffix in (".py", ".typed")}
    files[f"robostress/{LIBRARY}"] = library
    files[f"{info}/METADATA"] = metadata().encode()
    files[f"{info}/WHEEL"] = (f"Wheel-Version: 1.0\nGenerator: robostress_build\nRoot-Is-Purelib: false\n"
                              f"Tag: {tag}\n").encode()
    files[f"{info}/LICENSE"] = (ROOT / "LICENSE").read_bytes()
    record = ""
    for name, data in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        record += f"{name},sha256={digest},{len(data)}\n"
    files[f"{info}/RECORD"] = f"{record}{info}/RECORD,,\n".encode()
    wheel = f"robostress-{version()}-{tag}.whl"
    with zipfile.ZipFile(pathlib.Path(folder) / wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name)  # of 1980: equal sources make equal wheels
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    return wheel


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    given = setting(config_settings, "library")
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        library = ROOT / given if given else compiled(scratch)
        if not library.is_file():
            raise SystemExit(f"library={library}: no such file; leave it out, and the library is compiled")
        stripped = scratch / "stripped"
        subprocess.run(["strip", "--strip-unneeded", "-o", stripped, library], check=True)
        return write_wheel(stripped.read_bytes(), wheel_directory)


def build_sdist(sdist_directory, config_settings=None):
    raise NotImplementedError("the library is compiled from the whole source tree: make a wheel of a checkout")
