"""Joint errors in environments of others, between the controller's torques and the physics."""
from __future__ import annotations

import sys
from typing import Any, Callable, Dict, Optional, Sequence, Tuple

from robostress import dm_control_arms, gymnasium_arms, robosuite_arms
from robostress._library import InvalidArgument, WrongOrder, integer
from robostress.joint_errors import JointErrors
from robostress.mujoco_arm import ArmEpisode


class WrappedEnvironment:
    """The environment with joint errors: everything is its own but step(), which adds to `info` under "robostress"
    `commanded`, the action; `asked` and `applied` [sub-steps, joints], torques of the controller and at the joints, of no more
    sub-steps than a control step had when the episode began; `q`, `dq`,
    measured after the step; `held`. A second arm's are under "robostress_ROBOT_ARM". `executed` is the same, where a step has no
    `info`. Arguments: as of wrap().
    """

    def __init__(self, env: Any, scenario: str, **options: Any) -> None:
        self._wrapped, self._closed, self._over = env, False, ""
        self._episode, self._remove = _hook(env, scenario, **options)
        self.errors = self._episode.errors

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or "_wrapped" not in vars(self):
            raise AttributeError(name)
        return getattr(self._wrapped, name)

    def step(self, action: Any) -> Tuple:
        if self._over:
            raise WrongOrder(self._over)
        return self._wrapped.step(action)

    @property
    def executed(self) -> Dict[str, Any]:
        """Of the last step of the arm that was wrapped here."""
        return self._episode.last

    def set_init_state(self, *given: Any, **more: Any) -> Any:
        """LIBERO's; an episode begins."""
        self._episode.begun = False
        return self._wrapped.set_init_state(*given, **more)

    def unwrap(self) -> Any:
        """The environment as it was."""
        self._over = self._over or "the environment is unwrapped: step what unwrap() returned, or wrap() it again"
        self._remove()
        return self._wrapped

    def close(self) -> None:
        """Once more does nothing."""
        if not self._closed:
            self._closed, self._over = True, "the environment is closed: make another"
            self.unwrap().close()

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TypeError(f"a wrapped {type(self._wrapped).__name__} cannot be copied or pickled: it lives in the methods of the one "
                        "that it wraps; make another environment and wrap that, JointErrors.copy() keeps the errors' state")


def wrap(env: Any, scenario: str, *, severity: int = 5, seed: int = 0, horizon: int = 0, settle_steps: int = 0,
         **options: Any) -> WrappedEnvironment:
    """An environment with the errors of a scenario in an arm's joints: of robosuite 1.4 or 1.5, or one around it such as
    LIBERO's OffScreenRenderEnv, of Gymnasium on MuJoCo, or of dm_control. horizon: control steps over which severities that grow do so; 0:
    the environment's. settle_steps: of an episode that do not count for them. More options: those of JointErrors, and

    robosuite: `robot` (0) and `arm` ("right"). Gymnasium, dm_control: `actuators`, the arm's motors or servos by their names or their joints', from
    the base on; `tool`, the site where a payload sits; `pads`, geoms of both sides of the gripper, where the scenario
    depends on a grasp.
    """
    kind: Callable[..., WrappedEnvironment] = WrappedEnvironment
    gymnasium = sys.modules.get("gymnasium")
    if gymnasium is not None and isinstance(env, gymnasium.Env):
        from robostress.gymnasium_wrapper import JointErrorsWrapper as kind  # type: ignore[no-redef]
    return kind(env, scenario, severity=severity, seed=seed, horizon=horizon, settle_steps=settle_steps, **options)


def _hook(env: Any, scenario: str, *, severity: int = 5, seed: int = 0, horizon: int = 0, settle_steps: int = 0,
          **options: Any) -> Tuple[ArmEpisode, Callable[[], None]]:
    settle_steps = integer("settle_steps", settle_steps, 0)
    base = robosuite_arms.base_of(env)
    if base is not None:
        return _hook_robosuite(base, scenario, (severity, seed), horizon, settle_steps, **options)
    base = gymnasium_arms.base_of(env)
    if base is not None:
        limit = getattr(env.spec, "max_episode_steps", None) or 300
        return _hook_named(gymnasium_arms.GymnasiumArm, base, scenario, (severity, seed), horizon or limit, settle_steps, **options)
    base = dm_control_arms.base_of(env)
    if base is not None:
        return _hook_named(dm_control_arms.DmControlArm, base, scenario, (severity, seed), horizon or 300, settle_steps, **options)
    raise InvalidArgument(f"{type(env).__name__} cannot be wrapped: in it is no environment of robosuite, of Gymnasium's "
                          "MujocoEnv, nor of dm_control; ask JointErrors in your own sub-steps")


def _hook_robosuite(base: Any, scenario: str, draws: Tuple[int, int], horizon: int, settle_steps: int, *, robot: int = 0,
                    arm: str = "right", **options: Any) -> Tuple[ArmEpisode, Callable[[], None]]:
    arms, key = vars(base).get("_robostress"), (robot, arm)
    joints, panda = robosuite_arms.RobosuiteArms.joints(base, robot, arm)
    if arms is not None and key in arms.episodes:
        raise InvalidArgument(f"robot {robot}'s {arm} arm is wrapped already: unwrap() it first")
    errors = _errors(scenario, joints, panda, draws, horizon or int(base.horizon), options)
    arms = arms or robosuite_arms.RobosuiteArms(base)
    episode = arms.add(key, errors, settle_steps)
    return episode, lambda: arms.remove(key, episode)


def _hook_named(kind: Callable[..., Any], base: Any, scenario: str, draws: Tuple[int, int], horizon: int, settle_steps: int, *,
                    actuators: Sequence[str] = (), tool: Optional[str] = None, pads: Sequence[Sequence[str]] = (),
                    **options: Any) -> Tuple[ArmEpisode, Callable[[], None]]:
    actuators = [actuators] if isinstance(actuators, str) else list(actuators)
    if not actuators:
        raise InvalidArgument("actuators is empty: name the motors of the arm, from the base on")
    errors = _errors(scenario, len(actuators), False, draws, horizon, options)
    hooked = kind(base, errors, settle_steps, actuators, tool, pads)
    return hooked.episode, hooked.remove


def _errors(scenario: str, joints: int, panda: bool, draws: Tuple[int, int], horizon: int, options: Any) -> JointErrors:
    errors = JointErrors(scenario, joints, *draws, horizon=horizon, **options)
    if scenario != "clean" and not panda and options.get("nominal") is None:
        raise InvalidArgument(f"scenario '{scenario}' has values for a Panda, the arm is another: give its own, nominal="
                              f"[{joints}, 9], or begin with 'clean' and add effects")
    return errors
