"""pi0 and pi0.5 in plain PyTorch: the network as one writes it in eager mode, with openpi's way of predicting (every
camera slot and every prompt slot is computed and masked; the prefix's keys and values are kept; time, masks and
adaptive norms are computed in each step). Names of tensors are openpi's."""
import json
import math

import torch
import torch.nn.functional as F

import euler

MASKED = -2.3819763e38
VISION = "paligemma_with_expert.paligemma.model.vision_tower.vision_model."
PROJECTOR = "paligemma_with_expert.paligemma.model.multi_modal_projector.linear"
PREFIX = "paligemma_with_expert.paligemma.model.language_model."
EXPERT = "paligemma_with_expert.gemma_expert.model."


class Policy:
    def __init__(self, tensors, metadata):
        self.w = tensors
        self.c = json.loads(metadata["config"])

    def linear(self, name, x):
        return F.linear(x, self.w[name + ".weight"], self.w.get(name + ".bias"))

    def layer_norm(self, name, x):
        return F.layer_norm(x, (x.shape[-1],), self.w[name + ".weight"], self.w[name + ".bias"], 1e-6)

    def image_tokens(self, image):
        heads = self.c["vh"]
        x = F.conv2d(image, self.w[VISION + "embeddings.patch_embedding.weight"],
                     self.w[VISION + "embeddings.patch_embedding.bias"], stride=self.c["patch"])
        x = x.flatten(2).transpose(1, 2) + self.w[VISION + "embeddings.position_embedding.weight"]
        batch, patches, width = x.shape
        for i in range(self.c["vd"]):
            p = f"{VISION}encoder.layers.{i}."
            y = self.layer_norm(p + "layer_norm1", x)
            q, k, v = (self.linear(p + f"self_attn.{n}_proj", y).view(batch, patches, heads, -1).transpose(1, 2)
                       for n in "qkv")
            weights = torch.softmax(q @ k.transpose(2, 3) * q.shape[-1]**-0.5, -1)
            y = (weights @ v).transpose(1, 2).reshape(batch, patches, width)
            x = x + self.linear(p + "self_attn.out_proj", y)
            y = self.layer_norm(p + "layer_norm2", x)
            x = x + self.linear(p + "mlp.fc2", F.gelu(self.linear(p + "mlp.fc1", y), approximate="tanh"))
        return self.linear(PROJECTOR, self.layer_norm(VISION + "post_layernorm", x))

    def norm(self, name, x, cond):
        """-> normalised x, gate of the residual or None"""
        y = x * torch.rsqrt(x.square().mean(-1, keepdim=True) + 1e-6)
        if cond is None:
            return y * (1 + self.w[name + ".weight"]), None
        scale, shift, gate = self.linear(name + ".dense", cond).unsqueeze(1).chunk(3, -1)
        return y * (1 + scale) + shift, gate

    def rotate(self, x, positions):
        half = self.c["hd"] // 2
        frequency = 1.0 / 10000**(torch.arange(0, 2 * half, 2, dtype=torch.float32) / (2 * half))
        angle = (positions.float().unsqueeze(-1) * frequency).unsqueeze(1)
        cos, sin = angle.cos(), angle.sin()
        a, b = x.chunk(2, -1)
        return torch.cat([a * cos - b * sin, b * cos + a * sin], -1)

    def layers(self, root, x, mask, positions, cond=None, cache=None):
        """-> x after the final norm, keys and values per layer"""
        heads, kv_heads, dim = self.c["heads"], self.c["kv_heads"], self.c["hd"]
        batch, tokens, _ = x.shape
        kept = []
        residual = lambda x, y, gate: x + y if gate is None else x + gate * y
        for i in range(self.c["depth"]):
            p = f"{root}layers.{i}."
            y, gate = self.norm(p + "input_layernorm", x, cond)
            q, k, v = (self.linear(p + f"self_attn.{n}_proj", y).view(batch, tokens, h, dim).transpose(1, 2)
                       for n, h in (("q", heads), ("k", kv_heads), ("v", kv_heads)))
            q, k = self.rotate(q, positions), self.rotate(k, positions)
            kept.append((k, v))
            if cache is not None:
                k, v = torch.cat([cache[i][0], k], 2), torch.cat([cache[i][1], v], 2)
            k, v = (t.repeat_interleave(heads // kv_heads, 1) for t in (k, v))
            weights = torch.softmax(q @ k.transpose(2, 3) * dim**-0.5 + mask, -1)
            y = (weights @ v).transpose(1, 2).reshape(batch, tokens, heads * dim)
            x = residual(x, self.linear(p + "self_attn.o_proj", y), gate)
            y, gate = self.norm(p + "post_attention_layernorm", x, cond)
            y = F.gelu(self.linear(p + "mlp.gate_proj", y), approximate="tanh") * self.linear(p + "mlp.up_proj", y)
            x = residual(x, self.linear(p + "mlp.down_proj", y), gate)
        return self.norm(root + "norm", x, cond)[0], kept

    def encode(self, images, image_masks, tokens, token_mask):
        parts = [self.image_tokens(image) for image in images]
        table = self.w[PREFIX + "embed_tokens.weight"]
        parts.append(F.embedding(tokens, table) * math.sqrt(self.c["pw"]))
        patches = parts[0].shape[1]
        valid = torch.cat([m.unsqueeze(1).expand(-1, patches) for m in image_masks] + [token_mask], 1)
        mask = torch.where(valid.unsqueeze(1) & valid.unsqueeze(2), 0.0, MASKED).unsqueeze(1)
        _, cache = self.layers(PREFIX, torch.cat(parts, 1), mask, valid.long().cumsum(1) - 1)
        return valid, cache

    def embed_time(self, t):
        fraction = torch.linspace(0, 1, self.c["ew"] // 2, dtype=torch.float64)
        period = 4e-3 * (4.0 / 4e-3)**fraction
        angle = 2 * math.pi * t.double().unsqueeze(1) / period
        return torch.cat([angle.sin(), angle.cos()], 1).float()

    def velocity(self, context, state, x, t):
        valid, cache = context
        batch, horizon, _ = x.shape
        tokens, cond, time = self.linear("action_in_proj", x), None, self.embed_time(t)
        starts = [1] + [0] * (horizon - 1)
        if self.c["pi05"]:
            cond = F.silu(self.linear("time_mlp_out", F.silu(self.linear("time_mlp_in", time))))
        else:
            mixed = torch.cat([tokens, time.unsqueeze(1).expand(-1, horizon, -1)], 2)
            tokens = self.linear("action_time_mlp_out", F.silu(self.linear("action_time_mlp_in", mixed)))
            tokens = torch.cat([self.linear("state_proj", state).unsqueeze(1), tokens], 1)
            starts = [1] + starts
        block = torch.tensor(starts).cumsum(0)
        own = (block.unsqueeze(0) <= block.unsqueeze(1)).expand(batch, -1, -1)
        mask = torch.cat([valid.unsqueeze(1).expand(-1, len(starts), -1), own], 2)
        mask = torch.where(mask, 0.0, MASKED).unsqueeze(1)
        positions = valid.long().sum(1, keepdim=True) + torch.arange(len(starts))
        out, _ = self.layers(EXPERT, tokens, mask, positions, cond, cache)
        return self.linear("action_out_proj", out[:, -horizon:])

    def sample(self, context, state, noise):
        return euler.integrate(lambda x, t: self.velocity(context, state, x, t), noise)


def make(tensors, metadata, io):
    """-> encode(), sample(context)"""
    policy = Policy(tensors, metadata)
    cameras = sorted(name[len("inputs/image."):] for name in io if name.startswith("inputs/image."))
    images = [io["inputs/image." + c] for c in cameras]
    masks = [io["inputs/image_mask." + c] for c in cameras]
    return (lambda: policy.encode(images, masks, io["inputs/tokens"], io["inputs/token_mask"]),
            lambda context: policy.sample(context, io["inputs/state"], io["inputs/noise"]))
