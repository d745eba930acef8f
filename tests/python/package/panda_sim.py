"""PandaSim in parity mode, in a model that robosuite compiled. Needs WRAPPED_REFERENCE."""
import os
import pathlib
import subprocess
import tempfile

import mujoco
import numpy as np


def played(env, qpos, home, rows, scenario):
    """Joints [steps, 7] after each of the commands `rows`, from qpos; the arm was reset at `home`."""
    with tempfile.TemporaryDirectory() as folder:
        model, given = pathlib.Path(folder) / "model.mjb", pathlib.Path(folder) / "input"
        mujoco.mj_saveModel(env.sim.model._model, str(model), None)
        given.write_bytes(np.concatenate([qpos, home, np.ravel(rows)]).tobytes())
        done = subprocess.run([os.environ["WRAPPED_REFERENCE"], model, given, scenario], stdout=subprocess.PIPE, check=True)
    return np.frombuffer(done.stdout).reshape(-1, 7)
