"""What mcap's readers find in an arm's run: read_arm_mcap.py FILE. A line per topic, and the last message of two."""

import sys

from mcap_ros2.reader import read_ros2_messages


def main():
    counts, last = {}, {}
    for message in read_ros2_messages(sys.argv[1]):
        topic = message.channel.topic
        counts[topic] = counts.get(topic, 0) + 1
        last[topic] = message.ros_msg
    for topic in sorted(counts):
        print(topic, counts[topic])
    sent, client, joints = last["/joints/sent"], last["/client"], last["/joint_states"]
    print("sent", sent.j1, sent.j6, sent.gripper)
    print("client", client.state, client.cause, client.episode, client.delay_s)
    print("joints", *joints.name, *joints.position, joints.effort[0], joints.header.stamp.sec)


main()
