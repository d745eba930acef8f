"""Joint errors of robot arms, and their compensation, for any simulator.

    errors = robostress.JointErrors("aged_transmission")    # what a worn arm does to torques
    following = robostress.ModelFollowing()                 # what takes it off a policy's commands

Units: rad, rad/s, Nm, kg m^2, s, m. The kernels are those of RoboStress' own simulator, bit by bit.
"""
from robostress._library import (InternalError, InvalidArgument, NotFound, RobostressError, Scenario, StorageError, WrongOrder,
                                 __version__, scenarios)
from robostress.calibration import calibrate
from robostress.client import PolicyClient
from robostress.compensation import (Compensator, DirectSubtraction, GainControl, IntegralAction, ModelFollowing)
from robostress.dataset import EpisodeDataset, measured
from robostress.joint_errors import JointErrors
from robostress.streams import Stream
from robostress.wrapping import WrappedEnvironment, wrap

__all__ = ["Compensator", "DirectSubtraction", "EpisodeDataset", "GainControl", "IntegralAction", "InternalError", "InvalidArgument",
           "JointErrors", "ModelFollowing", "NotFound", "PolicyClient", "RobostressError", "Scenario", "StorageError", "Stream",
           "WrappedEnvironment", "WrongOrder", "__version__", "calibrate", "measured", "scenarios", "wrap"]
