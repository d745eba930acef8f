"""`robostress calibrate` on arrays: the program of an installed RoboStress does the work."""
from __future__ import annotations

import json
import os
import pathlib
import shutil
import subprocess
import tempfile
from typing import Any, Dict, Mapping, Optional, Sequence

import numpy as np

from robostress._library import InvalidArgument, NotFound, array


def _program(given: Optional[str]) -> str:
    found = shutil.which(given or os.environ.get("ROBOSTRESS_CALIBRATE") or "robostress-calibrate")
    if found is None:
        raise NotFound(f"no program {given or 'robostress-calibrate'} on PATH: install the package "
                       "robostress-calibration, or say program=\"/path/to/robostress-calibrate\"")
    return found


def _write_log(file: pathlib.Path, columns: Mapping[str, Any]) -> None:
    if "t" not in columns:
        raise InvalidArgument(f"{file.stem} has no column t [s]; it has {', '.join(columns) or 'none'}")
    rows = len(np.atleast_1d(columns["t"]))
    table = np.column_stack([array(f"{file.stem}.{name}", values, float, rows) for name, values in columns.items()])
    np.savetxt(file, table, fmt="%.17g", delimiter=",", header=",".join(columns), comments="")


def calibrate(rig: Mapping[str, Any], logs: Sequence[Mapping[str, Any]], *, out: Optional[str] = None,
              program: Optional[str] = None, arguments: Sequence[str] = ()) -> Dict[str, Any]:
    """What the declared model of a measured robot lacks: report.json as data.

    rig: what a rig file holds but its logs; model: MJCF, a path or the text itself. logs: a map each, `columns` (arrays by
    the rig file's names, "t", "q_cmd_hinge", "q_hinge"), `role` ("fit", "held_out", "transfer"), and if they differ
    `condition`, `overrides`. out: folder that keeps rig, logs, report.html and scenario.yaml; else they are removed.
    arguments: more of the program's, as "--map", "hinge=J4". What it refuses is an InvalidArgument with its words.
    """
    runs = _program(program)
    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(out or scratch).absolute()
        folder.mkdir(parents=True, exist_ok=True)
        declared = dict(rig)
        model = str(declared.get("model", ""))
        if model.lstrip().startswith("<"):
            (folder / "model.xml").write_text(model)
            declared["model"] = "model.xml"
        elif model:
            declared["model"] = str(pathlib.Path(model).absolute())
        declared["logs"] = []
        for i, log in enumerate(logs):
            _write_log(folder / f"log_{i}.csv", log["columns"])
            kept = {key: value for key, value in log.items() if key != "columns"}
            declared["logs"].append({"file": f"log_{i}.csv", "role": "fit", **kept})
        (folder / "rig.yaml").write_text(json.dumps(declared, indent=1, default=float))  # JSON is YAML
        done = subprocess.run([runs, "--rig", str(folder / "rig.yaml"), "--out", str(folder), *arguments],
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True)
        report = folder / "report.json"
        if done.returncode != 0 or not report.exists():
            raise InvalidArgument(f"{runs} ended with {done.returncode}:\n{done.stdout[-4000:]}")
        return json.loads(report.read_text())
