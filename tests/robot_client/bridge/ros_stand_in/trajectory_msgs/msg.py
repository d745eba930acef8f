"""trajectory_msgs/msg/JointTrajectory, as rosidl makes it for Python."""


class Duration:
    def __init__(self):
        self.sec = self.nanosec = 0


class JointTrajectoryPoint:
    def __init__(self):
        self.positions, self.velocities, self.accelerations, self.effort = [], [], [], []
        self.time_from_start = Duration()


class JointTrajectory:
    def __init__(self):
        self.joint_names, self.points = [], []
