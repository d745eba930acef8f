"""A wrapped arm of dm_control's environments: actuators that are named make it one."""
from __future__ import annotations

import sys
from typing import Any, Optional, Sequence

from robostress._library import InvalidArgument
from robostress.gymnasium_arms import named_arm
from robostress.joint_errors import JointErrors
from robostress.mujoco_arm import ArmEpisode, MujocoArm


def base_of(env: Any) -> Optional[Any]:
    """dm_control's environment on MuJoCo in `env`, or None: of its suite or of its composer."""
    dm_env = sys.modules.get("dm_env")
    while dm_env is not None and isinstance(env, dm_env.Environment):
        if hasattr(getattr(env, "physics", None), "check_invalid_state"):
            return env
        env = getattr(env, "_env", getattr(env, "_environment", None))
    return None


class DmControlArm:
    """The wrapped arm of one environment, in its own methods' places."""

    def __init__(self, base: Any, errors: JointErrors, settle_steps: int, actuators: Sequence[str], tool: Optional[str],
                 pads: Sequence[Sequence[str]]) -> None:
        if "_robostress" in vars(base):
            raise InvalidArgument("the environment is wrapped already: unwrap() it first")
        self.base, self.acting = base, False

        def make() -> MujocoArm:
            model, data = base.physics.model.ptr, base.physics.data.ptr
            rows = max(1, round(base.control_timestep() / model.opt.timestep))
            return named_arm(model, data, errors, actuators, tool, pads, rows)
        self.episode = ArmEpisode("robostress", errors, settle_steps, make)
        make()  # what cannot be is said now
        self._original = {name: getattr(base, name) for name in ("step", "reset")}
        base.step, base.reset, base._robostress = self.step, self.reset, self

    def remove(self) -> None:
        if vars(self.base).get("_robostress") is self:
            for name in ("step", "reset", "_robostress"):
                delattr(self.base, name)

    def reset(self) -> Any:
        self.episode.begun = False
        return self._original["reset"]()

    def step(self, action: Any) -> Any:
        physics, self.acting = self.base.physics, False
        physics.step = lambda nstep=1: self.simulate(physics, nstep)
        try:
            result = self._original["step"](action)
        finally:
            del physics.step
        if self.acting:  # not where it began an episode
            self.episode.executed(action)
        return result

    def simulate(self, physics: Any, nstep: int) -> None:
        import mujoco  # type: ignore[import-not-found]
        model, data = physics.model.ptr, physics.data.ptr
        commanded = data.ctrl.copy()
        with physics.check_invalid_state():
            for _ in range(nstep):
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                if not self.acting:
                    self.acting, self.arm = True, self.episode.begin_control_step()
                    self.act = self.arm.actor(self.arm)
                if self.arm.fields:
                    mujoco.mj_crb(model, data)
                    mujoco.mj_comVel(model, data)
                    mujoco.mj_rne(model, data, 0, data.qfrc_bias)
                data.ctrl[:] = commanded
                self.act()
                mujoco.mj_step(model, data)
            data.ctrl[:] = commanded
            if physics.legacy_step:
                mujoco.mj_step1(model, data)
