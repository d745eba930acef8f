"""Reads a demonstration data set as LeRobot 0.6 does (lerobot/datasets/io_utils.py), with the same
libraries, and prints what the C++ test compares: read_dataset.py DIR [HDF5]."""

import json
import pathlib
import sys

import datasets
import h5py
import numpy as np
import pandas as pd

root = pathlib.Path(sys.argv[1])
info = json.loads((root / "meta/info.json").read_text())
assert info["codebase_version"] == "v3.0" and info["video_path"] is None


def feature_of(feature):
    if feature["dtype"] == "image":
        return datasets.Image()
    if feature["shape"] == [1]:
        return datasets.Value(feature["dtype"])
    return datasets.Sequence(length=feature["shape"][0], feature=datasets.Value(feature["dtype"]))


features = datasets.Features({name: feature_of(f) for name, f in info["features"].items()})


def load(folder, features=None):
    paths = sorted(str(p) for p in (root / folder).glob("*/*.parquet"))
    cache = str(root.parent / "hf_cache")
    return datasets.Dataset.from_parquet(paths, features=features, cache_dir=cache)


data, episodes = load("data", features), load("meta/episodes")
tasks = pd.read_parquet(root / "meta/tasks.parquet")
stats = json.loads((root / "meta/stats.json").read_text())
assert len(episodes) == info["total_episodes"], (len(episodes), info["total_episodes"])
assert len(data) == info["total_frames"], (len(data), info["total_frames"])
first = 0
for i, episode in enumerate(episodes):
    assert episode["episode_index"] == i and episode["dataset_from_index"] == first
    length = episode["length"]
    rows = data[first : first + length]
    assert rows["frame_index"] == list(range(length))
    assert rows["episode_index"] == [i] * length
    assert rows["index"] == list(range(first, first + length))
    assert np.allclose(rows["timestamp"], np.arange(length) / info["fps"], atol=1e-5)
    assert rows["next.done"] == [False] * (length - 1) + [True]
    task = tasks.iloc[rows["task_index"][0]].name
    assert episode["tasks"] == [task]
    for name, feature in info["features"].items():
        if feature["dtype"] == "image":
            for picture in rows[name]:
                assert [picture.height, picture.width, 3] == feature["shape"]
    print(f"episode {i}: {task!r} length {length} success {rows['next.success'][-1]}"
          f" state {rows['observation.state'][-1][0]:.3f} action {rows['action'][-1][6]:.3f}")
    first += length
for name in ("observation.state", "action"):
    values = np.array(data[name])
    s = stats[name]
    assert [values.shape[1]] == info["features"][name]["shape"] and s["count"] == [len(values)]
    assert np.allclose(values.mean(0), s["mean"], atol=1e-6)
    assert np.allclose(values.std(0), s["std"], atol=1e-6)
    assert np.allclose(values.min(0), s["min"]) and np.allclose(values.max(0), s["max"])
    if len(episodes) == 1:
        assert np.allclose(np.quantile(values, 0.1, axis=0), s["q10"], atol=1e-6)
for name, feature in info["features"].items():
    if feature["dtype"] == "image":
        assert np.array(stats[name]["mean"]).shape == (3, 1, 1)
        pixels = np.concatenate([np.asarray(p).reshape(-1, 3) for p in data[name]]) / 255
        assert np.allclose(pixels.mean(0), np.ravel(stats[name]["mean"]), atol=0.02)
if len(sys.argv) > 2:
    with h5py.File(sys.argv[2]) as f:
        demo = f["data/demo_0"]
        n = demo.attrs["num_samples"]
        assert demo["actions"].shape == (n, 7) and demo["obs/joint_states"].shape == (n, 7)
        assert demo["obs/agentview_rgb"].shape == (n, 128, 128, 3)
        assert json.loads(f["data"].attrs["env_args"])["env_kwargs"]["control_freq"] == 30
        assert np.allclose(np.linalg.norm(demo["robot_states"][:, 5:], axis=1), 1)
        print(f"hdf5: {json.loads(f['data'].attrs['problem_info'])['language_instruction']!r}"
              f" length {n} state {demo['obs/joint_states'][-1][0]:.3f}")
print("read")
