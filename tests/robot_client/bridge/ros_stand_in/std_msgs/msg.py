"""std_msgs/msg/Float64MultiArray, as rosidl makes it for Python."""


class Float64MultiArray:
    def __init__(self):
        self.data = []
