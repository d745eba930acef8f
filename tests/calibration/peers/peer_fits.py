"""What a lab would fit: inverse dynamics by least squares with the right terms, and MuJoCo's sysid.

Every fit gives {joint: (parameters, effects)} as a rig file holds them.
"""
import json
import logging
import xml.etree.ElementTree as xml

import mujoco
import numpy as np
import scipy.signal
from mujoco import sysid

SMOOTH_HZ = 20  # of the zero-phase filter before differences
WINDOW_S = 0.5  # of free runs
KR300_TERMS = ("delay", "torque", "direction")
logging.getLogger("absl").setLevel(logging.ERROR)


def read_log(path):
    """{column: values}"""
    table = np.genfromtxt(path, delimiter=",", names=True, deletechars="")
    return {name: table[name] for name in table.dtype.names}


def smoothed(values, rate, order=4):
    cut = min(SMOOTH_HZ, 0.2 * rate)
    return scipy.signal.filtfilt(*scipy.signal.butter(order, cut / (rate / 2)), values)


def motion(log, names, rate, prefix="q_"):
    """Positions, velocities and accelerations of joints [rows, joints]."""
    q = np.stack([smoothed(log[prefix + name], rate) for name in names], axis=1)
    dq = np.gradient(q, 1 / rate, axis=0)
    return q, dq, np.gradient(dq, 1 / rate, axis=0)


class Body:
    """The rigid body of a rig's MJCF: no armature, no friction."""

    def __init__(self, path):
        spec = mujoco.MjSpec.from_file(path)
        for joint in spec.joints:
            joint.armature = joint.frictionloss = 0
            joint.damping = 0
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.names = [self.model.joint(i).name for i in range(self.model.njnt)]

    def torque(self, q, dq, ddq):
        """[rows, joints]"""
        result = np.empty_like(q)
        for i in range(len(q)):
            self.data.qpos[:], self.data.qvel[:], self.data.qacc[:] = q[i], dq[i], ddq[i]
            mujoco.mj_inverse(self.model, self.data)
            result[i] = self.data.qfrc_inverse
        return result

    def with_tip_mass(self, path):
        """The same with 1 kg at the site `tip`."""
        root = xml.parse(path).getroot()
        for body in root.iter("body"):
            site = body.find("site[@name='tip']")
            if site is not None:
                extra = xml.SubElement(body, "body", pos=site.get("pos", "0 0 0"))
                xml.SubElement(extra, "inertial", pos="0 0 0", mass="1", diaginertia="1e-9 1e-9 1e-9")
        other = Body.__new__(Body)
        spec = mujoco.MjSpec.from_string(xml.tostring(root, encoding="unicode"))
        for joint in spec.joints:
            joint.armature = joint.frictionloss = 0
            joint.damping = 0
        other.model = spec.compile()
        other.data = mujoco.MjData(other.model)
        return other


def declared_friction(rig, name):
    """The Stribeck friction that a rig declares of a joint, or nothing."""
    joint = next(joint for joint in rig.yaml["joints"] if joint["name"] == name)
    return next((e for e in joint.get("effects", []) if e["type"] == "stribeck_friction"), None)


def fit_lsq(rig, name, terms):
    """Joint `name`, of the logs to fit: torque less the rigid body's against what the rig leaves free, and `terms`. What
    holds over a row acts on average half a row beside where it is logged; which side a rig does is tried."""
    fits = [lsq_aligned(rig, name, terms, shift) for shift in (-0.5, 0, 0.5)]
    return min(fits, key=lambda fit: fit[0])[1]


def held_torque(log, joint, rate, shift):
    """The torque of a row as it acts on average, `shift` rows later; of a servo the command alone holds."""
    tau = log["tau_" + joint["name"]]
    if joint["input"] == "position_target":
        command = log["q_cmd_" + joint["name"]]
        return tau - shift * joint["servo"]["kp"] * np.diff(command, prepend=command[0])
    return (1 - shift) * tau + shift * np.roll(tau, 1)


def lsq_aligned(rig, name, terms, shift):
    body, rate = Body(rig.model()), rig.yaml["rate_hz"]
    tip = body.with_tip_mass(rig.model()) if "payload" in terms else None
    own = body.names.index(name)
    other = 1 - own if len(body.names) == 2 else own
    joint = next(joint for joint in rig.yaml["joints"] if joint["name"] == name)
    friction, passive = declared_friction(rig, name), declared_passive(rig, name)
    free = set(joint.get("fit", []))
    if friction:
        passive.update(damping=friction["sigma_v"], frictionloss=friction["Fc"])
        free |= {"damping", "frictionloss"}
    if "stribeck_friction" in terms:
        free |= {"damping", "frictionloss"}
    parts = {}
    for path in rig.files("fit"):
        log = read_log(path)
        q, dq, ddq = motion(log, body.names, rate)
        rigid = body.torque(q, dq, ddq)[:, own]
        tau = smoothed(held_torque(log, joint, rate, 0 if joint["input"] == "inverse" else shift), rate)
        sign = np.sign(dq[:, own])
        column = {"armature": ddq[:, own], "damping": dq[:, own], "frictionloss": sign, "torque_offset": np.ones(len(q))}
        if "mass_scale" in free:
            column["mass"], rigid = rigid, 0 * rigid
            del column["armature"]
        known = 0
        for key in set(column) & {"armature", "damping", "frictionloss", "torque_offset"} - free:
            known = known + passive[key] * column.pop(key)
        if "asymmetric_viscous" in terms:
            column["d_sigma"] = np.abs(dq[:, own])
        if "payload" in terms:
            column["payload"] = tip.torque(q, dq, ddq)[:, own] - rigid
        if "motor_gain" in terms:
            column["gain"] = -tau
        if set(terms) & {"cross_joint_friction", "cross_joint_rubbing", "cross_joint_inertia"}:
            column["F"], column["d"] = np.sign(dq[:, other]), dq[:, other]
            column["c"], column["J"] = np.abs(dq[:, other]) * sign, ddq[:, other]
        if "stribeck_friction" in terms or (friction and friction["Fs"] > friction["Fc"]):
            column["speed"], column["sign"] = np.abs(dq[:, own]), sign
        column["left"] = tau - rigid - known
        # Rows in which the direction is known, thinned to what the filter leaves of independence.
        rows = np.abs(dq[:, own]) > 0.02 * np.abs(dq[:, own]).max()
        rows[:10] = rows[-10:] = False
        for key, values in column.items():
            parts.setdefault(key, []).append(values[rows][:: max(1, int(rate / 100))])
    data = {key: np.concatenate(values) for key, values in parts.items()}
    left, speed, sign = data.pop("left"), data.pop("speed", None), data.pop("sign", None)
    error, found, vs = solve(data, left, speed, sign)
    return error, as_rig({**passive, **found}, vs, rig, name, body.names[other])


def declared_passive(rig, name):
    joint = mujoco.MjSpec.from_file(rig.model()).joint(name)
    return {"armature": scalar(joint.armature), "damping": scalar(joint.damping), "frictionloss": scalar(joint.frictionloss),
            "torque_offset": 0.0}


def solve(data, left, speed, sign):
    """Least squares; of Stribeck friction by the best of a grid of speeds."""
    best = None
    for vs in [None] if speed is None else np.quantile(speed, np.linspace(0.02, 0.5, 25)):
        columns = dict(data)
        if vs is not None:
            columns["stribeck"] = sign * np.exp(-((speed / vs) ** 2))
        names = list(columns)
        x, *_ = np.linalg.lstsq(np.stack([columns[name] for name in names], axis=1), left, rcond=None)
        error = np.linalg.norm(sum(columns[name] * value for name, value in zip(names, x)) - left)
        if best is None or error < best[0]:
            best = error, dict(zip(names, x)), vs
    return best


def as_rig(found, vs, rig, name, other):
    gain = 1 + found.get("gain", 0)
    parameters = {"damping": found["damping"], "frictionloss": max(0.0, found["frictionloss"]),
                  "torque_offset": -found["torque_offset"], "armature": max(0.0, found["armature"])}
    if "mass" in found:
        parameters["mass_scale"] = found["mass"]
    effects = []
    if vs is not None:
        Fc = max(0.0, found["frictionloss"])
        parameters["frictionloss"] = parameters["damping"] = 0.0
        effects.append({"type": "stribeck_friction", "Fc": Fc, "Fs": max(Fc, Fc + found["stribeck"]), "vs": float(vs),
                        "sigma_v": max(0.0, found["damping"])})
    if "d_sigma" in found:
        effects.append({"type": "asymmetric_viscous", "d_sigma": found["d_sigma"]})
    if "payload" in found:
        effects.append({"type": "payload", "mass": max(0.0, found["payload"])})
    if "gain" in found:
        effects.append({"type": "motor_gain", "gain_error": gain - 1})
    if "F" in found:
        effects.append({"type": "cross_joint_friction", "F": found["F"], "d": found["d"], "c": found["c"], "partner": other})
        effects.append({"type": "cross_joint_inertia", "J": found["J"], "partner": other})
    plain = [{key: value if isinstance(value, str) else float(value) for key, value in effect.items()} for effect in effects]
    return {key: float(value) for key, value in parameters.items()}, plain


def fit_bam_lsq(rig):
    """The pendulum's known gravity against the motor's torque and all that takes from it; load-dependent friction."""
    joint = rig.yaml["joints"][0]
    servo, rate, name = joint["servo"], rig.yaml["rate_hz"], joint["name"]
    body, columns, gravity = Body(rig.model()), [], []
    for log_entry, path in zip([log for log in rig.yaml["logs"] if log["role"] == "fit"], rig.files("fit")):
        log = read_log(path)
        kp = log_entry.get("overrides", {}).get(f"{name}.servo.kp", servo["kp"])
        q, dq, ddq = motion(log, [name], rate)
        volts = np.clip(kp * (log["q_cmd_" + name] - log["q_" + name]), -servo["vin"], servo["vin"])
        motor = smoothed(servo["kt"] / servo["R"] * volts, rate) - servo["kt"] ** 2 / servo["R"] * dq[:, 0]
        sign, rigid = np.sign(dq[:, 0]), body.torque(q, dq, ddq)[:, 0]
        rows = np.abs(dq[:, 0]) > 0.1
        columns.append(np.stack([motor, -ddq[:, 0], -dq[:, 0], -sign, -np.abs(motor) * sign], axis=1)[rows])
        gravity.append(rigid[rows])
    gain, armature, damping, dry, load = np.linalg.lstsq(np.concatenate(columns), np.concatenate(gravity), rcond=None)[0]
    effects = [{"type": "load_dependent_friction", "mu": float(np.clip(load / gain, 0, 0.9))}]
    return {name: ({"torque_gain": float(gain), "armature": float(max(1e-6, armature)), "damping": float(max(0, damping)),
                    "frictionloss": float(max(0, dry))}, effects)}


def fit_delay_lsq(rig, name, terms):
    """Link less motor against velocity, torque and direction; error of each motion from the others [mdeg]."""
    rate, tables = rig.yaml["rate_hz"], []
    for path in rig.files("fit"):
        log = read_log(path)
        _, dq, _ = motion(log, [name], rate, "q_motor_")
        column = {"delay": dq[:, 0], "torque": log["tau_" + name], "direction": np.tanh(dq[:, 0] / 0.01)}
        table = np.stack([column[term] for term in terms], axis=1)
        difference = log["q_link_" + name] - log["q_motor_" + name]
        tables.append((table - table.mean(0), difference - difference.mean()))
    squares = rows = 0
    for k, (table, difference) in enumerate(tables):
        others = [t for i, t in enumerate(tables) if i != k]
        x, *_ = np.linalg.lstsq(np.concatenate([t[0] for t in others]), np.concatenate([t[1] for t in others]), rcond=None)
        squares += np.sum((table @ x - difference) ** 2)
        rows += len(difference)
    return float(np.degrees(np.sqrt(squares / rows)) * 1e3)


def driven_spec(rig):
    """The rig's MJCF with motors or position servos, and sensors of its joints."""
    spec = mujoco.MjSpec.from_file(rig.model())
    spec.option.timestep = 1 / rig.yaml["rate_hz"] / max(1, round(1000 / rig.yaml["rate_hz"]))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.tolerance = 1e-14  # differences of rollouts are to be exact
    for body in spec.bodies:
        if any(site.name == "tip" for site in body.sites):
            site = next(site for site in body.sites if site.name == "tip")
            tip = body.add_body(name="tip_mass", pos=site.pos)
            tip.explicitinertial, tip.mass, tip.inertia = True, 1e-9, [1e-12] * 3
    for joint in rig.yaml["joints"]:
        name = joint["name"]
        friction = declared_friction(rig, name)
        if friction:
            spec.joint(name).frictionloss, spec.joint(name).damping = friction["Fc"], friction["sigma_v"]
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        spec.add_sensor(name="q_" + name, objname=name, type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                        objtype=mujoco.mjtObj.mjOBJ_JOINT)
        if joint["input"] == "position_target":
            set_servo(actuator, joint["servo"])
        else:
            actuator.gainprm[0] = 1
            remember(actuator)
    return spec


def set_servo(actuator, servo):
    kp, kd, limit = servo["kp"], servo.get("kd", 0), servo.get("torque_limit")
    if servo.get("type") == "dc_motor":
        per_volt = servo["kt"] / servo["R"]
        kp, kd, limit = per_volt * servo["kp"], servo["kt"] * per_volt, servo["vin"] * per_volt
    actuator.gainprm[0], actuator.biastype = kp, mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[:3] = 0, -kp, -kd
    if limit:
        actuator.forcerange, actuator.forcelimited = [-limit, limit], True
    remember(actuator)


def remember(actuator):
    limit = [float(value) for value in actuator.forcerange] if actuator.forcelimited else None
    actuator.info = json.dumps({"gain": float(actuator.gainprm[0]), "bias": [float(v) for v in actuator.biasprm[1:3]],
                                "limit": limit})


def sequences_of(rig, spec, entry, path, window_s):
    """Free runs of a log from measured positions and smoothed velocities."""
    log, rate = read_log(path), rig.yaml["rate_hz"]
    names = [joint["name"] for joint in rig.yaml["joints"]]
    q, dq, _ = motion(log, names, rate)
    position = rig.yaml["joints"][0]["input"] == "position_target"
    control = np.stack([log[("q_cmd_" if position else "tau_") + name] for name in names], axis=1)
    reading = np.stack([log["q_" + name] for name in names], axis=1)
    rows = int(window_s * rate) if window_s else len(reading)
    model = spec.compile()
    runs = []
    for first in range(0, len(reading) - rows + 1, rows):
        part = slice(first, first + rows)
        times = np.arange(rows) / rate
        runs.append((sysid.create_initial_state(model, q[first], dq[first]), sysid.TimeSeries(times, control[part]),
                     sysid.TimeSeries.from_names(times, reading[part], model)))
    starts, controls, readings = zip(*runs)
    return sysid.ModelSequences(entry, spec, [f"{entry}.{i}" for i in range(len(runs))], list(starts), list(controls),
                                list(readings))


def fit_sysid(rig):
    """Armature, damping, dry friction and motor gain of every joint; the mass where the rig leaves it free."""
    params, groups = sysid.ParameterDict(), []
    base = driven_spec(rig).compile()
    for joint in rig.yaml["joints"]:
        name = joint["name"]
        spec = driven_spec(rig)
        j = spec.joint(name)
        inertia = float(mujoco_inertia(base, name))
        for field, nominal, high in (("armature", max(j.armature, 1e-4 * inertia), 20 * inertia),
                                     ("damping", scalar(j.damping) or 1e-3 * inertia, 1e3 * inertia),
                                     ("frictionloss", scalar(j.frictionloss) or 1e-3 * inertia, 1e3 * inertia)):
            params.add(sysid.Parameter(f"{name}.{field}", nominal=nominal, min_value=0, max_value=max(high, 3 * nominal),
                                       modifier=lambda s, p, n=name, f=field: set_field(s.joint(n), f, p.value[0])))
        params.add(sysid.Parameter(f"{name}.gain", nominal=1, min_value=0.2, max_value=5,
                                   modifier=lambda s, p, n=name: set_gain(s.actuator(n), p.value[0])))
        if "torque_offset" in joint.get("fit", []):
            params.add(sysid.Parameter(f"{name}.torque_offset", nominal=0.1, min_value=-1e3, max_value=1e3,
                                       modifier=lambda s, p, n=name: set_offset(s.actuator(n), p.value[0])))
    with_tip = any(body.name == "tip_mass" for body in driven_spec(rig).bodies)
    if with_tip:
        mass = float(np.sum(base.body_mass))
        params.add(sysid.Parameter("tip", nominal=0.01 * mass, min_value=0, max_value=2 * mass,
                                   modifier=lambda s, p: setattr(s.body("tip_mass"), "mass", max(1e-9, p.value[0]))))
    fits = [(log, path) for log, path in zip(rig.yaml["logs"], rig.files("fit", "held_out", "transfer"))
            if log.get("role", "fit") == "fit"]
    for i, (log, path) in enumerate(fits):
        spec = driven_spec(rig)
        for key, value in log.get("overrides", {}).items():
            name, _, field = key.partition(".servo.")
            servo = dict(next(joint for joint in rig.yaml["joints"] if joint["name"] == name)["servo"])
            servo[field] = value
            set_servo(spec.actuator(name), servo)
        groups.append(sequences_of(rig, spec, f"log_{i}", path, rig.yaml["metric"].get("window_s", WINDOW_S)))
    residual = sysid.build_residual_fn(models_sequences=groups, n_threads=1)
    best, _ = sysid.optimize(initial_params=params, residual_fn=residual, optimizer="mujoco", verbose=False)
    result = {}
    for joint in rig.yaml["joints"]:
        value = {field: float(best[f"{joint['name']}.{field}"].value[0])
                 for field in ("armature", "damping", "frictionloss", "gain")}
        value["torque_gain"] = value.pop("gain")
        if f"{joint['name']}.torque_offset" in best:
            value["torque_offset"] = float(best[f"{joint['name']}.torque_offset"].value[0])
        effects = [{"type": "payload", "mass": float(best["tip"].value[0])}] if with_tip else []
        result[joint["name"]] = value, effects
    return result


def scalar(value):
    return float(np.ravel(value)[0])


def set_field(joint, field, value):
    setattr(joint, field, value if np.ndim(getattr(joint, field)) == 0 else [value] + [0] * (np.size(getattr(joint, field)) - 1))


def set_gain(actuator, gain):
    """Of the motor: of all that it gives. Specs are changed in place, so from what `info` keeps."""
    kept = json.loads(actuator.info)
    actuator.gainprm[0] = kept["gain"] * gain
    actuator.biasprm[1:3] = np.asarray(kept["bias"]) * gain
    if kept["limit"]:
        actuator.forcerange = np.asarray(kept["limit"]) * gain


def set_offset(actuator, offset):
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[0] = offset


def mujoco_inertia(model, name):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, full, data.qM)
    dof = model.joint(name).dofadr[0]
    return full[dof, dof]
