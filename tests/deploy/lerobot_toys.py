"""Policies of LeRobot's own classes at toy size, with random weights, and what LeRobot says they do.

    lerobot_toys.py make KIND FOLDER              KIND: act, smolvla, diffusion; saved as LeRobot saves them
    lerobot_toys.py ask FOLDER SEED [SEED ...]    prints one line a seed: the rows of a chunk, by LeRobot alone

`ask` shows the policy the observation that the tests send: view k is [224 or as declared, ..., 3]
uint8 with pixel i of the flattened view 200 + k + i % 50, the state 0.5 to 8.5, evenly, float32. A
row is what LeRobot's own loop does: select_action, then the post-processor.
"""

import os
import sys

os.environ.setdefault("HF_HUB_OFFLINE", "1")

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies import factory

ROWS, INSTRUCTION = 6, "do something"


def features(side, state=8, actions=7):
    visual = PolicyFeature(type=FeatureType.VISUAL, shape=(3, side, side))
    inputs = {"observation.images.image": visual, "observation.images.image2": visual,
              "observation.state": PolicyFeature(type=FeatureType.STATE, shape=(state,))}
    return inputs, {"action": PolicyFeature(type=FeatureType.ACTION, shape=(actions,))}


def statistics(inputs, outputs):
    """Of no data set: every number has a mean and a deviation of its own."""
    stats = {}
    for name, feature in {**inputs, **outputs}.items():
        n, shape = feature.shape[0], (-1, 1, 1) if len(feature.shape) == 3 else (-1,)
        mean, std = torch.linspace(0.1, 0.9, n).reshape(shape), torch.linspace(0.5, 2.5, n).reshape(shape)
        stats[name] = {"mean": mean, "std": std, "min": mean - std, "max": mean + std}
    return stats


def act_config(inputs, outputs):
    from lerobot.policies.act.configuration_act import ACTConfig

    return ACTConfig(
        input_features=inputs, output_features=outputs, device="cpu", chunk_size=ROWS, n_action_steps=ROWS,
        pretrained_backbone_weights=None, dim_model=32, n_heads=2, dim_feedforward=32, n_encoder_layers=1,
        n_vae_encoder_layers=1, latent_dim=4,
    )


def diffusion_config(inputs, outputs):
    from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig

    return DiffusionConfig(
        input_features=inputs, output_features=outputs, device="cpu", n_obs_steps=2, horizon=8, n_action_steps=ROWS,
        down_dims=(32, 64), n_groups=4, kernel_size=3, diffusion_step_embed_dim=16, spatial_softmax_num_keypoints=4,
        num_train_timesteps=4, crop_shape=(56, 56), pretrained_backbone_weights=None,
    )


def smolvla_config(inputs, outputs, folder):
    from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig

    return SmolVLAConfig(
        input_features=inputs, output_features=outputs, device="cpu", chunk_size=ROWS, n_action_steps=ROWS,
        vlm_model_name=tiny_smolvlm(os.path.join(folder, "vlm")), load_vlm_weights=False,
        resize_imgs_with_padding=(64, 64), num_vlm_layers=2, num_steps=3, max_state_dim=32, max_action_dim=32,
    )


def tiny_smolvlm(folder):
    """A folder with SmolVLM's configuration at toy size and a tokenizer of 26 letters' words."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast, SmolVLMConfig, SmolVLMImageProcessor, SmolVLMProcessor, SmolVLMVideoProcessor

    special = ["<unk>", "<pad>", "<s>", "</s>", "<image>", "<fake_token_around_image>", "<global-img>", "<end_of_utterance>"]
    words = special + ["do", "something", "else", "warm", "up", "\n"]
    tokenizer = Tokenizer(models.WordLevel({word: i for i, word in enumerate(words)}, unk_token="<unk>"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    fast = PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, unk_token="<unk>", pad_token="<pad>", bos_token="<s>", eos_token="</s>",
        extra_special_tokens={"image_token": "<image>", "fake_image_token": "<fake_token_around_image>",
                              "global_image_token": "<global-img>", "end_of_utterance_token": "<end_of_utterance>"},
    )
    config = SmolVLMConfig(
        vision_config={"hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2,
                       "image_size": 64, "patch_size": 16},
        text_config={"model_type": "llama", "hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 2,
                     "num_attention_heads": 2, "num_key_value_heads": 1, "head_dim": 16, "vocab_size": len(words)},
        image_token_id=words.index("<image>"), scale_factor=2,
    )
    config.save_pretrained(folder)
    SmolVLMProcessor(SmolVLMImageProcessor(), fast, SmolVLMVideoProcessor(), image_seq_len=4).save_pretrained(folder)
    fast.save_pretrained(folder)
    return folder


def make(kind, folder):
    torch.manual_seed(7)
    inputs, outputs = features(64 if kind != "act" else 224)
    config = {"act": act_config, "diffusion": diffusion_config}.get(kind)
    config = config(inputs, outputs) if config else smolvla_config(inputs, outputs, folder)
    stats = statistics(inputs, outputs)
    inside = not hasattr(factory, "make_pre_post_processors")  # before LeRobot 0.4
    policy_class = factory.get_policy_class(kind)
    policy = policy_class(config, dataset_stats=stats) if inside else policy_class(config)
    for parameter in policy.parameters():  # a fresh head answers nearly nothing
        if parameter.dim() > 1:
            torch.nn.init.normal_(parameter, std=0.2)
    policy.save_pretrained(folder)
    if not inside:
        for processor in factory.make_pre_post_processors(config, dataset_stats=stats):
            processor.save_pretrained(folder)


def view(k, side):
    return (200 + k + np.arange(3 * side * side) % 50).astype(np.uint8).reshape(side, side, 3)


def ask(folder, seeds):
    config = PreTrainedConfig.from_pretrained(folder)
    policy = factory.get_policy_class(config.type).from_pretrained(folder)
    before = after = lambda value: value
    if hasattr(factory, "make_pre_post_processors"):
        before, after = factory.make_pre_post_processors(policy.config, pretrained_path=folder)
    for seed in seeds:
        policy.reset()
        torch.manual_seed(seed)
        rows = []
        for _ in range(ROWS):
            batch = {"observation.state": torch.from_numpy(np.linspace(0.5, 8.5, 8, dtype=np.float32))[None]}
            for k, name in enumerate(("observation.images.image", "observation.images.image2")):
                side = config.input_features[name].shape[1]
                batch[name] = (torch.from_numpy(view(k, side)).float() / 255).permute(2, 0, 1)[None].contiguous()
            batch["task"] = INSTRUCTION if before is not after else [INSTRUCTION]
            with torch.inference_mode():
                rows.append(after(policy.select_action(before(batch)))[0].tolist())
        print(" ".join(f"{number:.9g}" for row in rows for number in row), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "make":
        make(sys.argv[2], sys.argv[3])
    else:
        ask(sys.argv[2], [int(seed) for seed in sys.argv[3:]])
