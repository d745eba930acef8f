"""LeRobot imports this, and has the environments `robostress` and `robostress_libero`."""
from robostress.lerobot_envs import RobostressEnv, RobostressLiberoEnv

__all__ = ["RobostressEnv", "RobostressLiberoEnv"]
