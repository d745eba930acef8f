#!/usr/bin/env python3
"""Makes the wheel, installs it into an environment of its own, and runs package_test.py there, away from the source.

Exit code: 77, with the reason, where there is no NumPy to be had: it comes from PyPI, or from the system.
"""
import argparse
import os
import pathlib
import shutil
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[2]
NEEDS = "import sys; assert sys.version_info >= (3, 8)"


def run(*command, **more):
    return subprocess.run([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          **more)


def skip(reason):
    print(f"SKIPPED: {reason}")
    sys.exit(77)


def must(done):
    if done.returncode != 0:
        sys.exit(f"{' '.join(done.args)}:\n{done.stdout}")
    return done.stdout


def interpreter(name):
    """`name`, on PATH or pyenv's of that version."""
    kept = sorted(pathlib.Path.home().glob(f".pyenv/versions/{name[len('python'):]}.*/bin/python"))
    for python in (shutil.which(name), *kept):
        if python and run(python, "-c", NEEDS).returncode == 0:
            return python
    skip(f"{name} is not there, or older than 3.8")


def environment(python, folder, requirements):
    """A Python with NumPy and what else is asked for, kept from one run to the next."""
    venv_python, done = folder / "bin/python", folder / "DONE"
    if done.exists():
        return venv_python
    system = [] if requirements else ["--system-site-packages"]
    made = run(python, "-m", "venv", "--clear", *system, folder)
    if made.returncode != 0:
        skip(f"needs python3-venv: {made.stdout[-500:]}")
    pip = run(venv_python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary=:all:",
              "--timeout", "15", "--retries", "1", "--no-deps", "-r", requirements or HERE / "requirements.txt")
    if pip.returncode != 0 and requirements:
        skip(f"needs PyPI for what {requirements.name} lists: {pip.stdout[-500:]}")
    if pip.returncode != 0 and run(venv_python, "-c", "import numpy").returncode != 0:
        skip(f"needs NumPy, from PyPI or python3-numpy: {pip.stdout[-500:]}")
    done.write_text("installed\n")
    return venv_python


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", help="the interpreter, 3.8 or later")
    parser.add_argument("--python-named-by", metavar="VARIABLE",
                        help="of the environment: an interpreter with packages of its own, beside which the wheels are put")
    parser.add_argument("--plug-in", type=pathlib.Path, help="source of one more package")
    parser.add_argument("--library", required=True, help="librobostress.so.1")
    parser.add_argument("--scratch", required=True, type=pathlib.Path)
    parser.add_argument("--requirements", type=pathlib.Path, help="more packages; skipped where they cannot be had")
    parser.add_argument("script", nargs="+", help="what is run, with its arguments")
    line = parser.parse_args()
    if line.python_named_by:
        python = os.environ.get(line.python_named_by)
        if not python or not pathlib.Path(python).exists():
            skip(f"{line.python_named_by} names no Python: '{python or ''}'")
    else:
        python = environment(interpreter(line.python), line.scratch / "venv", line.requirements)
    wheels = line.scratch / "wheels"
    shutil.rmtree(wheels, ignore_errors=True)
    must(run(python, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps",
             f"--config-settings=library={line.library}", "-w", wheels, SOURCE / "python"))
    wheel, = wheels.iterdir()
    install = (python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps")
    os.environ.pop("PYTHONPATH", None)
    if line.python_named_by:
        site = line.scratch / "site"
        shutil.rmtree(site, ignore_errors=True)
        must(run(*install, "--target", site, wheel))
        if line.plug_in:
            copy = line.scratch / "plug_in"  # pip builds where the source is
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(line.plug_in, copy)
            must(run(*install, "--no-build-isolation", "--target", site, copy))
        os.environ["PYTHONPATH"] = str(site)
    else:
        must(run(*install, "--force-reinstall", wheel))
    print(f"{wheel.name} in {must(run(python, '--version')).strip()}")
    sys.stdout.flush()
    sys.exit(subprocess.run([str(python), *line.script], cwd=str(line.scratch)).returncode)


main()
