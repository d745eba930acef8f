"""Reads a demonstration data set with LeRobot itself, by hand, because its requirements take 5 GB:

    python3.13 -m venv VENV                       # LeRobot 0.6 needs Python 3.12 or newer
    VENV/bin/pip install "lerobot[dataset]==0.6.1"
    HF_HUB_OFFLINE=1 VENV/bin/python tests/common/lerobot/read_with_lerobot.py data/drawer/lerobot

Prints what LeRobot sees, and fails where that is not what was recorded."""

import sys

import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

HORIZON = 50
root = sys.argv[1]
data = LeRobotDataset("lab/recorded", root=root)
print(f"{data.num_episodes} episodes, {data.num_frames} frames at {data.fps} Hz")
frame = data[0]
for name, value in frame.items():
    print(f"  {name}: {tuple(value.shape) if torch.is_tensor(value) else value!r}")
cameras = [name for name in frame if name.startswith("observation.images.")]
for name, feature in data.meta.features.items():
    if feature["dtype"] == "float32" and name not in ("timestamp", "next.reward"):
        assert tuple(frame[name].shape) in (tuple(feature["shape"]), ()), name
for name in cameras:
    assert frame[name].shape[0] == 3 and 0 <= frame[name].min() <= frame[name].max() <= 1
numbers = data.hf_dataset.with_format("numpy")
assert list(numbers["index"]) == list(range(data.num_frames))
assert set(numbers["episode_index"]) == set(range(data.num_episodes))

# As a policy of action chunks is trained: this and the next 49 actions of each frame.
chunks = LeRobotDataset(
    "lab/recorded", root=root, delta_timestamps={"action": [i / data.fps for i in range(HORIZON)]}
)
batch = next(iter(torch.utils.data.DataLoader(chunks, batch_size=4)))
assert batch["action"].shape == (4, HORIZON, *data.meta.shapes["action"])
rows = torch.stack([data[i]["action"] for i in range(HORIZON)])
assert torch.equal(batch["action"][0], rows)
last = chunks[data.num_frames - 1]
assert last["action_is_pad"][1:].all() and torch.equal(last["action"][0], last["action"][-1])
print(f"  chunks of {HORIZON} actions: right, the last one is held behind the end")
