#!/usr/bin/env python3
"""What the nominal arm is wrong by in Clean, each axis by itself and with the Panda's dynamics: eval/docs/nominal_panda.py RUN

RUN: of `robostress sweep --scenarios clean --methods base --record-episodes PX` on LIBERO. Under OSC_POSE with uncouple_pos_ori
the tool accelerates by C f + d: C = A Lambda, A = J M^-1 J^T, Lambda = diag(A_pp^-1, A_rr^-1), d = J' q' (adapter/panda_dynamics.h),
here from the recorded model. Sent commands go through the nominal arm (adapter/nominal_arm.h) in four ways: each axis by itself
(none), C of LIBERO's home posture (home: what a client without joint positions gets), C of each step's own posture (own), and that
with d (all). Prints C of the home posture, its mean and standard deviation over all steps [normalised commands], and of each task:
the root mean square and the largest mean of x, y, z of what the nominal arm moves the tool more than the arm did in a step, and the
90th percentile of the shortfall that following sees (x and y, memory of 10 steps). Needs NumPy and MuJoCo's Python (3.2).
"""

import json
import pathlib
import struct
import sys

import mujoco
import numpy as np

KP, SUB_STEPS, STEP_S, MEMORY = 150, 25, 0.002, 10
SCALE = np.array([0.05] * 3 + [0.5] * 3)
HOME = np.array([0, -0.161037389, 0, -2.44459747, 0, 2.2267522, np.pi / 4])


def tensors(path):
    data = path.read_bytes()
    end = 8 + struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8:end])
    about = header.pop("__metadata__")
    kinds = {"F32": np.float32, "F64": np.float64}
    return about, {k: np.frombuffer(data[end:][slice(*v["data_offsets"])], kinds[v["dtype"]]).reshape(v["shape"])
                   for k, v in header.items() if v["dtype"] in kinds}


def dynamics(model, postures, velocities):
    """C [n, 6, 6] and d [n, 6] of joint positions and velocities [n, 7]."""
    data = mujoco.MjData(model)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"robot0_joint{i}") for i in range(1, 8)]
    dofs = model.jnt_dofadr[joints]
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "gripper0_grip_site")
    unit, column, found, drifts, step = np.eye(model.nv), np.zeros(model.nv), [], [], 1e-6

    def jacobian_at(q):
        data.qpos[model.jnt_qposadr[joints]] = q
        mujoco.mj_fwdPosition(model, data)
        move, turn = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, move, turn, site)
        return np.vstack([move[:, dofs], turn[:, dofs]])

    for q, dq in zip(postures, velocities):
        drifts.append((jacobian_at(q + step * dq) - jacobian_at(q - step * dq)) @ dq / (2 * step) / SCALE)
        jacobian = jacobian_at(q)
        mass = np.zeros((7, 7))
        for i, dof in enumerate(dofs):
            mujoco.mj_mulM(model, data, column, unit[dof])
            mass[:, i] = column[dofs]
        inverse = jacobian @ np.linalg.solve(mass, jacobian.T)
        inertia = np.zeros((6, 6))
        inertia[:3, :3] = np.linalg.inv(inverse[:3, :3])
        inertia[3:, 3:] = np.linalg.inv(inverse[3:, 3:])
        found.append((inverse @ inertia) * SCALE / SCALE[:, None])
    return np.array(found), np.array(drifts)


def nominal(commands, coupling, drift):
    """Displacements [n, 6] of the nominal arm, goal achieved; coupling [n, 6, 6] or [6, 6], drift [n, 6] or [6]."""
    n, velocity, goal, moved = len(commands), np.zeros(6), np.zeros(6), []
    for command, c, d in zip(np.clip(commands[:, :6], -1, 1), np.broadcast_to(coupling, (n, 6, 6)), np.broadcast_to(drift, (n, 6))):
        goal = np.r_[command[:3], command[3:] if command[3:].any() else goal[3:]]
        x = np.zeros(6)
        for _ in range(SUB_STEPS):
            velocity = velocity + STEP_S * (c @ (KP * (goal - x) - 2 * KP ** 0.5 * velocity) + d)
            x = x + STEP_S * velocity
        goal = goal - x
        moved.append(x)
    return np.array(moved)


def shortfall(errors):
    """90th percentile of |e|, x and y: e <- (1 - 1 / MEMORY) e + error."""
    behind, sizes = np.zeros(2), []
    for error in errors[:, :2]:
        behind = (1 - 1 / MEMORY) * behind + error
        sizes.append(np.hypot(*behind))
    return np.percentile(sizes, 90)


def main():
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    files = sorted(pathlib.Path(sys.argv[1]).glob("units/*/episodes/*.safetensors"))
    if not files:
        raise SystemExit(f"{sys.argv[1]}/units/*/episodes has no recorded episode: sweep it with --record-episodes")
    rows, all_couplings, home = [], [], None
    for path in files:
        about, tensor = tensors(path)
        model = mujoco.MjModel.from_xml_string(about["model_file"])
        if home is None:
            home = dynamics(model, [HOME], np.zeros((1, 7)))[0][0]
        own, drift = dynamics(model, tensor["q"], tensor["dq"])
        all_couplings.append(own)
        moved = np.diff(tensor["tool"][:, :3], axis=0) / SCALE[0]
        still = np.zeros(6)
        errors = [nominal(tensor["sent"], c, d)[:-1, :3] - moved
                  for c, d in ((np.eye(6), still), (home, still), (own, still), (own, drift))]
        rows.append((about["suite"], int(about["task"]), [np.sqrt(np.mean(np.sum(e ** 2, axis=1))) for e in errors],
                     [np.abs(e.mean(0)).max() for e in errors], [shortfall(e) for e in errors]))
    np.set_printoptions(precision=3, suppress=True)
    steps = np.concatenate(all_couplings)
    print(f"C of the home posture\n{home}\nmean over {len(steps)} steps\n{steps.mean(0)}\nstandard deviation\n{steps.std(0)}")
    print("suite, task | none, home, own, all: root mean square | largest mean | shortfall")
    text = lambda values: " ".join(f"{v:.3f}" for v in values)
    for suite, task, *numbers in sorted(rows):
        print(f"{suite} {task} | " + " | ".join(map(text, numbers)))
    print(f"median of {len(rows)} | " + " | ".join(text(np.median([r[k] for r in rows], 0)) for k in (2, 3, 4)))


if __name__ == "__main__":
    main()
