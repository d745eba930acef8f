"""Side by side with what a lab would use: calibrate, least squares by hand with the right terms, MuJoCo's sysid.

The same logs, the same held-out error: what a peer fitted is written as a rig without anything free, of which
calibration_held_out says the error by the rig's own metric. Times are seconds of one processor.

  pip install -r tests/calibration/peers/requirements.txt
  ROBOSTRESS_MEASURED_DATA=/data/measured python3 tests/calibration/peers/peers.py --build build/release --out runs/peers
"""
import argparse
import copy
import json
import os
import resource
import subprocess
import sys
import time

import numpy as np
import yaml

from peer_fits import KR300_TERMS, fit_bam_lsq, fit_delay_lsq, fit_lsq, fit_sysid

RIGS = "calibration/rigs"
# Drawn before anything was run.
GENERATED = [("stribeck_friction", "servo", 62000), ("asymmetric_viscous", "torque", 62001), ("payload", "servo", 62002),
             ("motor_gain", "servo", 62003), ("cross_joint_friction", "arm", 62004)]
COUPLED = [(effect, "arm", seed) for effect in ("cross_joint_friction", "cross_joint_rubbing", "cross_joint_inertia")
           for seed in (62010, 62011)]


def run(command):
    """Output and processor seconds of a program."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        sys.exit(f"peers.py: {' '.join(command)}: exit {done.returncode}\n{done.stderr}{done.stdout}")
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


class Rig:
    """A rig file with its folder; variants are written beside `out`."""

    def __init__(self, path):
        self.folder = os.path.dirname(os.path.abspath(path))
        with open(path) as file:
            self.yaml = yaml.safe_load(file)

    def model(self):
        return os.path.join(self.folder, self.yaml["model"])

    def files(self, *roles):
        return [os.path.join(self.folder, os.path.expandvars(log["file"])) for log in self.yaml["logs"]
                if log.get("role", "fit") in roles]

    def variant(self, out, joints, roles=None):
        """joints: {name: (parameters, effects)} in place of what is declared; roles: of the logs, in their order."""
        rig = copy.deepcopy(self.yaml)
        rig["model"] = self.model()
        for joint in rig["joints"]:
            joint.pop("fit", None)
            for effect in joint.get("effects", []):
                effect.pop("fit", None)
            if joint["name"] in joints:
                joint["parameters"], joint["effects"] = joints[joint["name"]]
        for log, role in zip(rig["logs"], roles or [log.get("role", "fit") for log in rig["logs"]]):
            log["file"] = os.path.join(self.folder, os.path.expandvars(log["file"]))
            log["role"] = role
        os.makedirs(out, exist_ok=True)
        with open(os.path.join(out, "rig.yaml"), "w") as file:
            yaml.safe_dump(rig, file)
        return os.path.join(out, "rig.yaml")


def held_out(build, path):
    """{joint: held-out error} of a rig as it stands."""
    text, _ = run([f"{build}/bin/calibration_held_out", "--rig", path])
    return {line.split()[0]: float(line.split()[1]) for line in text.splitlines()}


def calibrate(args, path, out, joint, error):
    """Columns of calibrate's own row: `error` names which of a report's errors. Nothing with --peers-only."""
    if args.peers_only:
        return {}
    _, seconds = run([f"{args.build}/bin/robostress-calibrate", "--rig", path, "--out", out, "--quiet", "--joints", joint])
    with open(os.path.join(out, "report.json")) as file:
        report = json.load(file)["joints"][0]
    errors = report["errors"][error]
    return {"declared": errors["declared"], "calibrate": errors["after"], "calibrate_s": round(seconds, 1),
            "verdict": report["verdict"], "effects": [effect["type"] for effect in report["effects_added"]]}


def row(case, joint, **columns):
    print(json.dumps({"case": case, "joint": joint, **columns}), flush=True)


def fitted(work):
    """Result and processor seconds of a fit in this process."""
    begin = time.process_time()
    result = work()
    return result, time.process_time() - begin


def one_rig(args, case, path, terms, joint, sysid=True):
    """A rig with logs that are held out."""
    rig, out = Rig(path), os.path.join(args.out, case)
    unit = {"mm": 1e3, "mdeg": np.degrees(1) * 1e3}.get(rig.yaml["metric"].get("unit"), 1)
    columns = calibrate(args, path, out + "/calibrate", joint, "held_out")
    found, columns["lsq_s"] = fitted(lambda: fit_lsq(rig, joint, terms))
    columns["lsq"] = unit * held_out(args.build, rig.variant(out + "/lsq", {joint: found}))[joint]
    if sysid:
        found, columns["sysid_s"] = fitted(lambda: fit_sysid(rig))
        columns["sysid"] = unit * held_out(args.build, rig.variant(out + "/sysid", found))[joint]
    row(case, joint, **columns)


def generated(args, cases, sysid):
    for effect, family, seed in cases:
        folder = os.path.join(args.out, f"{effect}.{seed}", "rig")
        run([f"{args.build}/bin/calibration_generate", "--effect", effect, "--family", family, "--seed", str(seed),
             "--out", folder])
        with open(folder + "/truth.json") as file:
            joint = json.load(file)["effects"][0]["joint"]
        one_rig(args, f"{effect}.{seed}", folder + "/rig.yaml", [effect], joint, sysid)


def bam(args):
    """A gain at a time is left out; whole runs, mean absolute error."""
    path = RIGS + "/bam/rig.yaml"
    rig, out = Rig(path), os.path.join(args.out, "bam")
    columns = calibrate(args, path, out + "/calibrate", "pivot", "left_out")
    for peer, fit in (("lsq", fit_bam_lsq), ("sysid", fit_sysid)):
        errors, columns[peer + "_s"] = [], 0
        for gain in sorted({log["condition"] for log in rig.yaml["logs"]}):
            roles = ["transfer" if log["role"] == "transfer" else "held_out" if log["condition"] == gain else "fit"
                     for log in rig.yaml["logs"]]
            fold = Rig(rig.variant(f"{out}/{peer}.{gain}", {}, roles))
            found, taken = fitted(lambda: fit(fold))
            columns[peer + "_s"] += taken
            errors.append(held_out(args.build, fold.variant(f"{out}/{peer}.{gain}.fitted", found))["pivot"])
        columns[peer] = float(np.mean(errors))
    row("bam", "pivot", **columns)


def kr300(args):
    """A motion at a time is left out; link from motor, without the mean."""
    path = RIGS + "/kr300/rig.yaml"
    rig = Rig(path)
    for joint in ("a1", "a2", "a3"):
        columns = calibrate(args, path, os.path.join(args.out, "kr300", joint), joint, "cross_validated")
        columns["lsq"], columns["lsq_s"] = fitted(lambda name=joint: fit_delay_lsq(rig, name, KR300_TERMS))
        row("kr300", joint, **columns)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--build", required=True, help="build tree with robostress-calibrate and calibration_held_out")
    parser.add_argument("--out", required=True)
    parser.add_argument("--cases", default="emps,kr300,bam,generated,coupled")
    parser.add_argument("--peers-only", action="store_true", help="leave calibrate out")
    args = parser.parse_args()
    for case in args.cases.split(","):
        if case == "emps":
            one_rig(args, "emps", RIGS + "/emps/rig.yaml", ["asymmetric_viscous"], "slide")
        elif case == "kr300":
            kr300(args)
        elif case == "bam":
            bam(args)
        elif case == "generated":
            generated(args, GENERATED, sysid=True)
        elif case == "coupled":
            generated(args, COUPLED, sysid=False)
        else:
            sys.exit(f"peers.py: --cases: '{case}' is unknown; known: emps, kr300, bam, generated, coupled")


if __name__ == "__main__":
    main()
