"""`robostress calibrate` on arrays: the program of an installed RoboStress does the work."""
from __future__ import annotations

import io
import json
import os
import pathlib
import shutil
import subprocess
import tempfile
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from robostress._library import InvalidArgument, NotFound, array


def _program(given: Optional[str]) -> str:
    found = shutil.which(given or os.environ.get("ROBOSTRESS_CALIBRATE") or "robostress-calibrate")
    if found is None:
        raise NotFound(f"no program {given or 'robostress-calibrate'} on PATH: install the package "
                       "robostress-calibration, or say program=\"/path/to/robostress-calibrate\"")
    return found


OURS = "# written by robostress.calibrate\n"  # first line of its rig.yaml


def _columns(name: str, log: Any) -> Tuple[List[str], np.ndarray]:
    """Names and table [rows, columns] of a log."""
    columns = log.get("columns") if isinstance(log, Mapping) else None
    if not isinstance(columns, Mapping):
        keys = list(log) if isinstance(log, Mapping) else repr(log)[:80]
        raise InvalidArgument(f"{name} is {keys}, must be a map with the arrays under 'columns': {{'columns': {{'t': ...}}}}")
    if "t" not in columns:
        raise InvalidArgument(f"{name} has no column t [s]; it has {', '.join(map(str, columns)) or 'none'}")
    rows = len(np.atleast_1d(columns["t"]))
    table = np.column_stack([array(f"{name}.{column}", values, float, rows) for column, values in columns.items()])
    return list(map(str, columns)), table


def _plain(value: Any) -> Any:
    """NumPy's numbers and arrays in a rig."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return str(value)
    raise InvalidArgument(f"rig or log has a {type(value).__name__} {value!r}, must be numbers, text, lists and maps")


def _ours(rig: pathlib.Path) -> bool:
    if not rig.is_file():
        return False
    text = rig.read_text(errors="replace")
    if text.startswith(OURS):
        return True
    try:  # as 0.2.0 wrote it
        return [log["file"] for log in json.loads(text)["logs"]][:1] == ["log_0.csv"]
    except (ValueError, TypeError, KeyError):
        return False


def _write(folder: pathlib.Path, files: Mapping[str, str]) -> None:
    """Not over somebody else's files."""
    taken = [name for name in files if (folder / name).exists()]
    if taken and not _ours(folder / "rig.yaml"):
        raise InvalidArgument(f"{folder / taken[0]} is there already and was not written by robostress.calibrate: give another "
                              "folder as out")
    folder.mkdir(parents=True, exist_ok=True)
    for name, words in files.items():  # the rig first: it says whose the others are
        (folder / name).write_text(words)


def calibrate(rig: Mapping[str, Any], logs: Sequence[Mapping[str, Any]], *, out: Optional[str] = None,
              program: Optional[str] = None, arguments: Sequence[str] = ()) -> Dict[str, Any]:
    """What the declared model of a measured robot lacks: report.json as data.

    rig: what a rig file holds but its logs; model: MJCF, a path or the text itself. logs: a map each, `columns` (arrays by
    the rig file's names, "t", "q_cmd_hinge", "q_hinge"), `role` ("fit", "held_out", "transfer"), and if they differ
    `condition`, `overrides`. out: folder that keeps rig, logs, report.html and scenario.yaml, else they are removed; a rig of
    somebody else's there is refused.
    arguments: more of the program's, as "--map", "hinge=J4". What it refuses is an InvalidArgument with its words.
    """
    runs = _program(program)
    if not isinstance(rig, Mapping):
        raise InvalidArgument(f"rig is {rig!r}, must be a map of what a rig file holds: {{'name': ..., 'model': ..., 'joints': ...}}")
    declared, files = dict(rig), {"rig.yaml": ""}
    model = str(declared.get("model", ""))
    if model.lstrip().startswith("<"):
        declared["model"], files["model.xml"] = "model.xml", model
    elif model:
        declared["model"] = str(pathlib.Path(model).absolute())
    declared["logs"] = []
    for i, log in enumerate(logs):
        names, table = _columns(f"logs[{i}]", log)
        text = io.StringIO()
        np.savetxt(text, table, fmt="%.17g", delimiter=",", header=",".join(names), comments="")
        files[f"log_{i}.csv"] = text.getvalue()
        kept = {key: value for key, value in log.items() if key != "columns"}
        declared["logs"].append({"file": f"log_{i}.csv", "role": "fit", **kept})
    files["rig.yaml"] = OURS + json.dumps(declared, indent=1, default=_plain)  # JSON is YAML
    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(out or scratch).absolute()
        _write(folder, files)
        done = subprocess.run([runs, "--rig", str(folder / "rig.yaml"), "--out", str(folder), *arguments],
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True)
        report = folder / "report.json"
        if done.returncode != 0 or not report.exists():
            raise InvalidArgument(f"{runs} ended with {done.returncode}:\n{done.stdout[-4000:]}")
        return json.loads(report.read_text())
