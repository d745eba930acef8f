"""Benchmarks of vla-eval: the suites of RoboStress, and LIBERO with joint errors in its arm.

    benchmarks:                       # of its configuration; `vla-eval run --no-docker --config FILE`
      - benchmark: "robostress.vla_eval_benchmarks:SuiteBenchmark"
        episodes_per_task: 20
        params: {suite: tabletop_goal, scenario: heavy_payload, compensation: ours_following}
      - benchmark: "robostress.vla_eval_benchmarks:LiberoBenchmark"
        episodes_per_task: 50
        params: {suite: libero_goal, seed: 7, scenario: aged_transmission}

The model server is whichever it was. `compensation` corrects its actions here, so that it need not know: a method of
robostress.Compensator, or none.
"""
import contextlib
import inspect

import numpy
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.benchmarks.libero.benchmark import LIBEROBenchmark
from vla_eval.specs import GRIPPER_CLOSE_POS, IMAGE_RGB, LANGUAGE, POSITION_DELTA, ROTATION_AA, DimSpec

from robostress._library import InvalidArgument
from robostress.compensation import Compensator
from robostress.gymnasium_suites import INITIAL_STATES, TASKS, SuiteEnv
from robostress.wrapping import wrap


class _Corrected:
    """Actions one at a time, corrected."""

    def __init__(self, method, rows):
        self._compensator, self._state = Compensator(method or "base", rows=rows), None

    def begin(self, position, quaternion):
        """An episode. Where the end effector is: [3], [4] w x y z."""
        if self._state is not None:
            self._compensator.end_episode(*self._state)
        self._compensator.start_episode()
        self.moved(position, quaternion)

    def action(self, action):
        """[7] what to send."""
        action = numpy.asarray(action, numpy.float32).ravel()
        if action.shape != (7,) or not numpy.isfinite(action).all():
            raise InvalidArgument(f"the model server's action is {action!r}, must be 7 finite numbers")
        action = numpy.append(action[:6], -1 if action[6] < 0 else 1).astype(numpy.float32)  # a gripper opens or closes
        return self._compensator.step(action, *self._state)

    def moved(self, position, quaternion):
        """Where that action brought the end effector."""
        self._state = position, quaternion


class SuiteBenchmark(StepBenchmark):
    """An embedded suite. Arguments beside SuiteEnv's: `compensation`, a method's name; `compensation_rows`, actions after which
    one learns that does not at every step (8); send_wrist_image; send_state, `states` [8] as SuiteEnv's agent_pos. Episode k
    of a task begins in its initial state k, of 50."""

    render_backends = frozenset({"gpu", "cpu"})  # the program renders by EGL, by a GPU or Mesa

    def __init__(self, suite="tabletop_goal", scenario="clean", severity=5, image_size=256, send_wrist_image=False,
                 send_state=False, compensation=None, compensation_rows=None, settings=()):
        super().__init__()
        self.suite, self.scenario, self.severity = suite, scenario, severity
        self.send_wrist_image, self.send_state = send_wrist_image, send_state
        self._made = {"suite": suite, "scenario": scenario, "severity": severity, "image_size": image_size,
                      "settings": tuple(settings)}
        self._corrected, self._env, self._index = _Corrected(compensation, compensation_rows), None, None

    @classmethod
    def configure_render(cls, mode):
        return {}

    def get_tasks(self):
        tasks = []
        for index in range(TASKS):
            with contextlib.closing(SuiteEnv(task=index, views=False, **self._made)) as env:
                tasks.append({"name": env.task_description, "suite": self.suite, "task_id": index, "task": env.task})
        return tasks

    def reset(self, task):
        if self._env is None or not self._env.alive or self._index != task["task_id"]:
            self.cleanup()
            self._env, self._index = SuiteEnv(task=task["task_id"], **self._made), task["task_id"]
        state = task.get("episode_idx", 0) % INITIAL_STATES
        observation, info = self._env.reset(options={"initial_state": state})
        self._corrected.begin(info["measured"]["position"], info["measured"]["quaternion"])
        self._recorder.record_video(next(iter(observation["pixels"].values())))
        return observation

    def step(self, action):
        sent = self._corrected.action(action.get("actions", action.get("action")))
        observation, reward, terminated, truncated, info = self._env.step(sent)
        self._corrected.moved(info["measured"]["position"], info["measured"]["quaternion"])
        self._recorder.record_video(next(iter(observation["pixels"].values())))
        self._recorder.record_step(reward=reward, done=terminated or truncated, success=terminated)
        return StepResult(observation, reward, terminated or truncated, info)

    def make_obs(self, raw_obs, task):
        cameras = list(raw_obs["pixels"])
        images = {"agentview": raw_obs["pixels"][cameras[0]]}
        if self.send_wrist_image:
            images["wrist"] = raw_obs["pixels"][cameras[1]]
        observation = {"images": images, "task_description": task["name"]}
        if self.send_state:
            observation["states"] = raw_obs["agent_pos"]
        return observation

    def get_step_result(self, step_result):
        return {"success": bool(step_result.info.get("is_success", False))}

    def get_metadata(self):
        return {"suite": self.suite, "scenario": self.scenario, "severity": self.severity,
                "max_steps": None,  # a task's own, at which SuiteEnv ends the episode
                "max_episodes_per_task": INITIAL_STATES}

    def get_hold_action(self, last_action):
        gripper = -1 if last_action is None else numpy.ravel(last_action.get("actions", last_action.get("action")))[6]
        return {"actions": numpy.array([0] * 6 + [gripper], numpy.float32)}

    def get_action_spec(self):
        return {"position": POSITION_DELTA, "rotation": ROTATION_AA, "gripper": GRIPPER_CLOSE_POS}

    def get_observation_spec(self):
        spec = {"agentview": IMAGE_RGB, "language": LANGUAGE}
        if self.send_wrist_image:
            spec["wrist"] = IMAGE_RGB
        if self.send_state:
            spec["state"] = DimSpec("state", 8, "eef_pos3_turn_from_down3_fingers2")
        return spec

    def cleanup(self):
        if self._env is not None:
            self._env.close()
        self._env = self._index = None

    def render(self):
        return None if self._env is None else next(iter(self._env._pictures.values()), None)


class LiberoBenchmark(LIBEROBenchmark):
    """vla-eval's LIBERO with the errors of a scenario. Arguments beside LIBEROBenchmark's: scenario; severity; error_seed, of what
    a scenario draws; compensation and compensation_rows as of SuiteBenchmark. The steps in which objects settle do not count for
    severities that grow."""

    def __init__(self, *given, scenario="clean", severity=5, error_seed=0, compensation=None, compensation_rows=None, **more):
        super().__init__(*given, **more)
        if compensation is not None and getattr(self, "absolute_action", False):
            raise InvalidArgument(f"compensation {compensation!r} corrects displacements, and absolute_action sends targets: leave "
                                  "one of them out")
        self.scenario, self.severity, self._error_seed = scenario, severity, error_seed
        self._corrected = _Corrected(compensation, compensation_rows)

    def reset(self, task):
        from libero.libero import envs

        plain = envs.OffScreenRenderEnv
        horizon = self.get_metadata()["max_steps"]

        def with_errors(**arguments):
            return wrap(plain(**arguments), self.scenario, severity=self.severity, seed=self._error_seed, horizon=horizon,
                        settle_steps=self.num_steps_wait)

        # LIBEROBenchmark makes its environment in the middle of reset().
        envs.OffScreenRenderEnv = with_errors
        try:
            observation = super().reset(task)
        finally:
            envs.OffScreenRenderEnv = plain
        self._corrected.begin(*self._tool(observation))
        return observation

    def step(self, action):
        sent = self._corrected.action(action.get("actions", action.get("action")))
        result = super().step({"actions": sent})
        self._corrected.moved(*self._tool(result.obs))
        return result

    def get_metadata(self):
        return {**super().get_metadata(), "scenario": self.scenario, "severity": self.severity}

    @staticmethod
    def _tool(observation):
        x, y, z, w = observation["robot0_eef_quat"]
        return numpy.array(observation["robot0_eef_pos"]), numpy.array([w, x, y, z])


def _all_parameters(parent, child):
    """A signature with the parameters of both: vla-eval asks it which of them a model server may set."""
    own = {name: parameter for name, parameter in inspect.signature(child).parameters.items()
           if parameter.kind is parameter.KEYWORD_ONLY}
    return inspect.Signature([*inspect.signature(parent).parameters.values(), *own.values()])


setattr(LiberoBenchmark.__init__, "__signature__", _all_parameters(LIBEROBenchmark.__init__, LiberoBenchmark.__init__))
