"""What mcap's readers find in an arm's run: read_arm_mcap.py FILE PICTURE. A line per topic, the last message of
three, and whether the last picture is PICTURE's bytes."""

import sys

from mcap_ros2.reader import read_ros2_messages


def main():
    counts, last = {}, {}
    for message in read_ros2_messages(sys.argv[1]):
        topic = message.channel.topic
        counts[topic] = counts.get(topic, 0) + 1
        last[topic] = message
    for topic in sorted(counts):
        print(topic, counts[topic])
    sent, client, joints, picture = (last[topic].ros_msg for topic in
                                     ("/joints/sent", "/client", "/joint_states", "/camera/wrist"))
    print("sent", sent.j1, sent.j6, sent.gripper)
    print("client", client.state, client.cause, client.episode, client.delay_s)
    print("joints", *joints.name, *joints.position, joints.effort[0], joints.header.stamp.sec)
    with open(sys.argv[2], "rb") as file:
        same = bytes(picture.data) == file.read()
    stamp = picture.header.stamp
    print(f"picture {picture.format} {stamp.sec + stamp.nanosec * 1e-9:.3f} shown at",
          f"{last['/camera/wrist'].log_time_ns * 1e-9:.3f}", "as on disk" if same else "changed")


main()
