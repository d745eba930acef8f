"""sensor_msgs/msg/JointState, as rosidl makes it for Python."""


class Time:
    def __init__(self):
        self.sec = self.nanosec = 0


class Header:
    def __init__(self):
        self.stamp, self.frame_id = Time(), ""


class JointState:
    def __init__(self):
        self.header, self.name, self.position, self.velocity, self.effort = Header(), [], [], [], []
