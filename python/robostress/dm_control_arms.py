"""A wrapped arm of dm_control's environments: actuators that are named make it one."""
from __future__ import annotations

import sys
from typing import Any, Optional, Sequence

from robostress._library import InvalidArgument
from robostress.gymnasium_arms import named_arm
from robostress.joint_errors import JointErrors
from robostress.mujoco_arm import ArmEpisode, Hooked, MujocoArm, put_back


def base_of(env: Any) -> Optional[Any]:
    """dm_control's environment on MuJoCo in `env`, or None: of its suite or of its composer."""
    dm_env = sys.modules.get("dm_env")
    while dm_env is not None and isinstance(env, dm_env.Environment):
        if hasattr(getattr(env, "physics", None), "check_invalid_state"):
            return env
        env = getattr(env, "_env", getattr(env, "_environment", None))
    return None


class DmControlArm(Hooked):
    """The wrapped arm of one environment, in its own methods' places."""

    def __init__(self, base: Any, errors: JointErrors, settle_steps: int, actuators: Sequence[str], tool: Optional[str],
                 pads: Sequence[Sequence[str]]) -> None:
        if "_robostress" in vars(base):
            raise InvalidArgument("the environment is wrapped already: unwrap() it first")
        self.base = base

        def make() -> MujocoArm:
            model, data = base.physics.model.ptr, base.physics.data.ptr
            rows = max(1, round(base.control_timestep() / model.opt.timestep))
            return named_arm(model, data, errors, actuators, tool, pads, rows)
        self.episode = ArmEpisode("robostress", errors, settle_steps, make)
        make()  # what cannot be is said now
        self._original = {name: getattr(base, name) for name in ("step", "reset")}
        self._replaced = {name: vars(base).get(name) for name in ("step", "reset")}
        base.step, base.reset, base._robostress = self.step, self.reset, self

    def remove(self) -> None:
        if vars(self.base).get("_robostress") is self:
            for name, replaced in self._replaced.items():
                put_back(self.base, name, replaced)
            del self.base._robostress

    def reset(self) -> Any:
        self.episode.begun = False
        return self._original["reset"]()

    def step(self, action: Any) -> Any:
        physics, self.episode.act = self.base.physics, None
        replaced = vars(physics).get("step")
        physics.step = lambda nstep=1: self.simulate(physics, nstep)
        try:
            result = self._original["step"](action)
        finally:
            put_back(physics, "step", replaced)
        if self.episode.act is not None:
            self.episode.executed(action)
        elif not result.first():  # it did not begin an episode
            raise InvalidArgument(f"{type(self.base).__name__}.step() did not step through physics.step, so no errors acted: ask "
                                  "JointErrors in your own sub-steps")
        return result

    def simulate(self, physics: Any, nstep: int) -> None:
        import mujoco  # type: ignore[import-not-found]
        model, data = physics.model.ptr, physics.data.ptr
        commanded = data.ctrl.copy()
        with physics.check_invalid_state():
            for _ in range(nstep):
                self.episode.sub_step(model, data, commanded)
                mujoco.mj_step(model, data)
            data.ctrl[:] = commanded
            if physics.legacy_step:
                mujoco.mj_step1(model, data)
