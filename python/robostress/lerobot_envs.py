"""Environments of LeRobot: the suites of RoboStress, and its LIBERO with joint errors in the arm.

    lerobot-eval --env.type=robostress --env.task=tabletop_goal --env.scenario=heavy_payload --policy.path=...
    lerobot-eval --env.type=robostress_libero --env.task=libero_goal --env.scenario=aged_transmission --policy.path=...

with the package lerobot_env_robostress installed, or --env.discover_packages_path=robostress.lerobot_envs.
"""
from dataclasses import dataclass, field
from functools import partial

import gymnasium
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig, LiberoEnv
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

from robostress._library import InvalidArgument
from robostress.gymnasium_suites import INITIAL_STATES, TASKS, SuiteEnv
from robostress.wrapping import wrap


def _vectorised(makers, use_async):
    if use_async and len(makers) > 1:
        return gymnasium.vector.AsyncVectorEnv(makers, context="forkserver",
                                               autoreset_mode=gymnasium.vector.AutoresetMode.NEXT_STEP)
    return gymnasium.vector.SyncVectorEnv(makers, autoreset_mode=gymnasium.vector.AutoresetMode.NEXT_STEP)


class _Counted(SuiteEnv):
    """Begins where LeRobot's LIBERO begins: environment k of n in initial state k, then k + n, ..."""

    def __init__(self, first, stride, **more):
        super().__init__(**more)
        self._next, self._stride = first, stride

    def reset(self, *, seed=None, options=None):
        state, self._next = self._next % INITIAL_STATES, self._next + self._stride
        return super().reset(seed=seed, options={"initial_state": state})


@EnvConfig.register_subclass("robostress")
@dataclass
class RobostressEnv(EnvConfig):
    """A suite. observation.state [8]: SuiteEnv's agent_pos; observation.images.image and image2: its two cameras."""

    task: str = "tabletop_goal"
    task_ids: list[int] | None = None
    scenario: str = "clean"
    severity: int = 5
    fps: int = 20
    image_size: int = 224
    features: dict[str, PolicyFeature] = field(default_factory=lambda: {
        ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(7,)),
        "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(8,))})
    features_map: dict[str, str] = field(default_factory=lambda: {
        ACTION: ACTION, "agent_pos": OBS_STATE, "pixels/image": f"{OBS_IMAGES}.image", "pixels/image2": f"{OBS_IMAGES}.image2"})

    def __post_init__(self):
        for camera in ("pixels/image", "pixels/image2"):
            self.features[camera] = PolicyFeature(type=FeatureType.VISUAL, shape=(self.image_size, self.image_size, 3))

    @property
    def gym_kwargs(self):
        return {"suite": self.task, "scenario": self.scenario, "severity": self.severity, "image_size": self.image_size,
                "render_mode": "rgb_array", "camera_names": ("image", "image2")}

    def create_envs(self, n_envs, use_async_envs=False):
        tasks = range(TASKS) if self.task_ids is None else self.task_ids
        if not set(tasks) <= set(range(TASKS)):
            raise InvalidArgument(f"env.task_ids is {list(tasks)}, a suite has tasks 0 to {TASKS - 1}")
        return {self.task: {task: _vectorised(
            [partial(_Counted, k, n_envs, task=task, **self.gym_kwargs) for k in range(n_envs)], use_async_envs)
            for task in tasks}}


def _worn(make, scenario, severity, seed):
    env = make()
    ensure = env._ensure_env

    def with_errors():
        plain = env._env is None
        ensure()
        if plain:
            env._env = wrap(env._env, scenario, severity=severity, seed=seed, horizon=env._max_episode_steps,
                            settle_steps=env.num_steps_wait)

    env._ensure_env = with_errors
    return env


@EnvConfig.register_subclass("robostress_libero")
@dataclass
class RobostressLiberoEnv(LiberoEnv):
    """LeRobot's LIBERO with the errors of a scenario; error_seed: of what it draws."""

    scenario: str = "clean"
    severity: int = 5
    error_seed: int = 0

    def create_envs(self, n_envs, use_async_envs=False):
        from lerobot.envs.libero import create_libero_envs

        def vectorised(makers):
            return _vectorised([partial(_worn, make, self.scenario, self.severity, self.error_seed) for make in makers],
                               use_async_envs)

        return create_libero_envs(
            task=self.task, n_envs=n_envs, camera_name=self.camera_name, init_states=self.init_states,
            gym_kwargs=self.gym_kwargs, env_cls=vectorised, control_mode=self.control_mode,
            episode_length=self.episode_length, camera_name_mapping=self.camera_name_mapping,
            is_libero_plus=self.is_libero_plus)
