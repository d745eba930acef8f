"""A wrapped arm of Gymnasium's MuJoCo environments: actuators that are named make it one."""
from __future__ import annotations

import sys
from typing import Any, List, Optional, Sequence

from robostress._library import InvalidArgument, NotFound
from robostress.joint_errors import JointErrors
from robostress.mujoco_arm import ArmEpisode, Hooked, MujocoArm, put_back

HOOKED = ("step", "reset", "set_state", "_step_mujoco_simulation")


def base_of(env: Any) -> Optional[Any]:
    """Gymnasium's MuJoCo environment in `env`, or None."""
    gymnasium = sys.modules.get("gymnasium")
    if gymnasium is None or not isinstance(env, gymnasium.Env):
        return None
    base = env.unwrapped
    return base if all(hasattr(base, name) for name in (*HOOKED, "model", "data")) else None


def _known(mujoco: Any, model: Any, kind: str, count: int) -> List[str]:
    return [mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), i) or "" for i in range(count)]


def _ids(what: str, known: Sequence[str], names: Sequence[str]) -> List[int]:
    for name in names:
        if not name or name not in known:
            raise NotFound(f"{what} '{name}' is not in the model; known: {', '.join(k for k in known if k)}")
    return [list(known).index(name) for name in names]


def named_arm(model: Any, data: Any, errors: JointErrors, actuators: Sequence[str], tool: Optional[str],
              pads: Sequence[Sequence[str]], rows: int) -> MujocoArm:
    """actuators: their names, or those of their joints where they have none."""
    import mujoco  # type: ignore[import-not-found]
    twice = [name for i, name in enumerate(actuators) if name in actuators[:i]]
    if twice:
        raise InvalidArgument(f"actuators names '{twice[0]}' twice; remove one")
    joints = _known(mujoco, model, "JOINT", model.njnt)
    driven = [joints[joint] if kind == 0 else "" for kind, (joint, _) in zip(model.actuator_trntype, model.actuator_trnid)]
    motors = _ids("actuator", [name or joint for name, joint in
                               zip(_known(mujoco, model, "ACTUATOR", model.nu), driven)], actuators)
    geoms = _known(mujoco, model, "GEOM", model.ngeom)
    return MujocoArm(model, data, [int(model.actuator_trnid[motor, 0]) for motor in motors], motors, errors, rows=rows,
                     tool=None if tool is None else _ids("site", _known(mujoco, model, "SITE", model.nsite), [tool])[0],
                     pads=[_ids("geom", geoms, side) for side in pads])


class GymnasiumArm(Hooked):
    """The wrapped arm of one environment, in its own methods' places."""

    def __init__(self, base: Any, errors: JointErrors, settle_steps: int, actuators: Sequence[str], tool: Optional[str],
                 pads: Sequence[Sequence[str]]) -> None:
        if "_robostress" in vars(base):
            raise InvalidArgument("the environment is wrapped already: unwrap() it first")
        self.base = base
        make = lambda: named_arm(base.model, base.data, errors, actuators, tool, pads, base.frame_skip)  # noqa: E731
        self.episode = ArmEpisode("robostress", errors, settle_steps, make)
        make()  # what cannot be is said now
        self._original = {name: getattr(base, name) for name in HOOKED}
        self._replaced = {name: vars(base).get(name) for name in HOOKED}
        base.step, base.reset, base.set_state = self.step, self.reset, self.set_state
        base._step_mujoco_simulation, base._robostress = self.simulate, self

    def remove(self) -> None:
        if vars(self.base).get("_robostress") is self:
            for name, replaced in self._replaced.items():
                put_back(self.base, name, replaced)
            del self.base._robostress

    def step(self, action: Any) -> Any:
        self.episode.act = None
        result = self._original["step"](action)
        if self.episode.act is None:
            raise InvalidArgument(f"{type(self.base).__name__}.step() did not step through _step_mujoco_simulation, so no errors "
                                  "acted: ask JointErrors in your own sub-steps")
        result[-1]["robostress"] = self.episode.executed(action)
        return result

    def reset(self, **given: Any) -> Any:
        self.episode.begun = False
        return self._original["reset"](**given)

    def set_state(self, qpos: Any, qvel: Any) -> None:
        self.episode.begun = False
        self._original["set_state"](qpos, qvel)

    def simulate(self, ctrl: Any, frame_skip: int) -> None:
        model, data, simulate = self.base.model, self.base.data, self._original["_step_mujoco_simulation"]
        for _ in range(frame_skip):
            self.episode.sub_step(model, data, ctrl)
            simulate(data.ctrl, 1)
