"""A stand-in for rclpy, which is on no package index: the calls that robostress_bridge_ros2 makes,
with the names and the behaviour of ROS 2's own, around an arm in software.

A node that subscribes to JointState gets one every 10 ms, joints in the order of their names and not
in the controller's. An arm goes to its target at 1 rad/s.
"""

import json
import os
import time

_STARTED = time.monotonic()
_NODES = []


class _Stamp:
    def __init__(self, nanoseconds):
        self.sec, self.nanosec = divmod(nanoseconds, 10**9)
        self.nanoseconds = nanoseconds


class _Clock:
    def now(self):
        return _Stamp(time.time_ns())


class _Publisher:
    def __init__(self, node, message_class, topic):
        self.node, self.message_class, self.topic = node, message_class, topic

    def get_subscription_count(self):
        return 0 if os.path.exists(os.environ.get("STAND_IN_NOBODY_LISTENS", "")) else 1

    def publish(self, message):
        assert isinstance(message, self.message_class), message
        self.node.commanded(self.topic, message)


class Node:
    def __init__(self, name):
        self.name, self.subscriptions, self.due, self.moved = name, [], 0.0, time.monotonic()
        joints = json.loads(os.environ.get("STAND_IN_JOINTS", '{"a": 0.1, "b": 0.2, "jaw": 0.03}'))
        self.at, self.target = dict(joints), dict(joints)
        self.forward_order = os.environ.get("STAND_IN_ORDER", ",".join(joints)).split(",")

    def create_subscription(self, message_class, topic, call, depth):
        self.subscriptions.append((message_class, topic, call))

    def create_publisher(self, message_class, topic, depth):
        return _Publisher(self, message_class, topic)

    def get_clock(self):
        return _Clock()

    def destroy_node(self):
        _NODES.remove(self)

    def commanded(self, topic, message):
        if hasattr(message, "points"):
            (point,) = message.points
            assert point.time_from_start.sec == 0 and point.time_from_start.nanosec > 0
            self.target.update(zip(message.joint_names, point.positions, strict=True))
        else:
            self.target.update(zip(self.forward_order, message.data, strict=True))

    def deliver(self):
        now = time.monotonic()
        step, self.moved = now - self.moved, now
        for name, target in self.target.items():
            self.at[name] += max(-step, min(step, target - self.at[name]))
        if now < self.due:
            return
        self.due = now + 0.01
        for message_class, _, call in self.subscriptions:
            message = message_class()
            stamp = _Clock().now()
            message.header.stamp.sec, message.header.stamp.nanosec = stamp.sec, stamp.nanosec
            message.name = sorted(self.at, reverse=True)
            message.position = [self.at[name] for name in message.name]
            message.velocity = [0.0 for _ in message.name]
            call(message)


def init():
    pass


def shutdown():
    assert not _NODES


def create_node(name):
    _NODES.append(Node(name))
    return _NODES[-1]


def spin_once(node, timeout_sec=None):
    assert timeout_sec == 0
    node.deliver()
