"""nano in plain PyTorch: the network as one writes it in eager mode. The prefix's keys and values are kept; each step
embeds time and state and joins keys and values, as openpi's sampling does. Names of tensors are those of
server/models/weights."""
import math

import torch
import torch.nn.functional as F
import yaml

import euler

MASKED = -2.3819763e38


class Policy:
    def __init__(self, tensors, metadata):
        self.w = tensors
        self.c = yaml.safe_load(metadata["config"])
        self.dim = self.c["head_dim"]

    def linear(self, name, x):
        return F.linear(x, self.w[name + ".weight"], self.w.get(name + ".bias"))

    def image_tokens(self, camera, image):
        x = image
        for i in range(len(self.c["conv_channels"])):
            name = f"cameras.{camera}.conv.{i}."
            weight = self.w[name + "weight"]
            x = F.relu(F.conv2d(x, weight, self.w[name + "bias"], stride=2, padding=(weight.shape[-1] - 1) // 2))
        x = x.flatten(2).transpose(1, 2)
        return self.linear(f"cameras.{camera}.token", x) + self.w[f"cameras.{camera}.position"]

    def norm(self, name, x):
        return x * torch.rsqrt(x.square().mean(-1, keepdim=True) + 1e-6) * (1 + self.w[name + ".weight"])

    def rotate(self, x, positions):
        frequency = 10000.0**(torch.arange(self.dim // 2, dtype=torch.float32) * (-2.0 / self.dim))
        angle = (positions.float().unsqueeze(-1) * frequency).unsqueeze(1)
        cos, sin = angle.cos(), angle.sin()
        a, b = x.chunk(2, -1)
        return torch.cat([a * cos - b * sin, b * cos + a * sin], -1)

    def split(self, x, heads):
        return x.view(x.shape[0], x.shape[1], heads, self.dim).transpose(1, 2)

    def finish(self, p, x, q, k, v, mask):
        y = torch.softmax(q @ k.transpose(2, 3) * self.dim**-0.5 + mask, -1) @ v
        x = x + self.linear(p + "o_proj", y.transpose(1, 2).flatten(2))
        gate, up = self.linear(p + "gate_up_proj", self.norm(p + "post_norm", x)).chunk(2, -1)
        return x + self.linear(p + "down_proj", F.gelu(gate, approximate="tanh") * up)

    def encode(self, images, words):
        """-> valid, keys and values per layer"""
        heads, layers = self.c["heads"], self.c["layers"]
        batch = words.shape[0]
        parts = [self.w["prefix.readout"].unsqueeze(0).expand(batch, -1, -1)]
        parts += [self.image_tokens(i, image) for i, image in enumerate(images)]
        parts.append(F.embedding(words, self.w["prefix.words"]) * math.sqrt(self.c["prefix_width"]))
        x = torch.cat(parts, 1)
        valid = torch.cat([torch.ones(batch, x.shape[1] - words.shape[1], dtype=torch.bool), words != 0], 1)
        mask = torch.where(valid, 0.0, MASKED).view(batch, 1, 1, -1)
        positions = torch.arange(x.shape[1]).expand(batch, -1)
        cache = []
        for i in range(layers):
            p = f"prefix.layers.{i}."
            y = self.norm(p + "input_norm", x)
            if i + 1 == layers:
                k, v = (self.split(t, 1) for t in self.linear(p + "kv_proj", y).chunk(2, -1))
                cache.append((self.rotate(k, positions), v))
                return valid, cache
            q, k, v = self.linear(p + "qkv_proj", y).split([heads * self.dim, self.dim, self.dim], -1)
            q, k, v = self.split(q, heads), self.split(k, 1), self.split(v, 1)
            q, k = self.rotate(q, positions), self.rotate(k, positions)
            cache.append((k, v))
            x = self.finish(p, x, q, k, v, mask)

    def embed_time(self, t):
        fraction = torch.linspace(0, 1, self.c["expert_width"] // 2, dtype=torch.float64)
        angle = 2 * math.pi * t.double().unsqueeze(1) / (4e-3 * (4.0 / 4e-3)**fraction)
        return torch.cat([angle.sin(), angle.cos()], 1).float()

    def velocity(self, context, state, x, t):
        valid, cache = context
        heads, batch = self.c["heads"], x.shape[0]
        tokens = self.linear("action_in_proj", x.reshape(batch, self.c["horizon"] // self.c["steps_per_token"], -1))
        time = self.embed_time(t).unsqueeze(1).expand(-1, tokens.shape[1], -1)
        mixed = F.silu(self.linear("action_time_mlp_in", torch.cat([tokens, time], 2)))
        x_shape = x.shape
        x = torch.cat([self.linear("state_proj", state).unsqueeze(1), self.linear("action_time_mlp_out", mixed)], 1)
        length = x.shape[1]
        own = torch.ones(length, length, dtype=torch.bool)
        own[0, 1:] = False
        mask = torch.cat([valid.unsqueeze(1).expand(-1, length, -1), own.expand(batch, -1, -1)], 2)
        mask = torch.where(mask, 0.0, MASKED).unsqueeze(1)
        positions = valid.long().sum(1, keepdim=True) + torch.arange(length)
        for i in range(self.c["layers"]):
            p = f"expert.layers.{i}."
            y = self.linear(p + "qkv_proj", self.norm(p + "input_norm", x))
            q, k, v = y.split([heads * self.dim, self.dim, self.dim], -1)
            q, k, v = self.split(q, heads), self.split(k, 1), self.split(v, 1)
            q, k = self.rotate(q, positions), self.rotate(k, positions)
            k, v = torch.cat([cache[i][0], k], 2), torch.cat([cache[i][1], v], 2)
            x = self.finish(p, x, q, k, v, mask)
        return self.linear("action_out_proj", self.norm("expert.norm", x)[:, 1:]).reshape(x_shape)

    def sample(self, context, state, noise):
        return euler.integrate(lambda x, t: self.velocity(context, state, x, t), noise)


def make(tensors, metadata, io):
    """-> encode(), sample(context)"""
    policy = Policy(tensors, metadata)
    pixels = [io[name] for name in sorted(io) if name.startswith("inputs/image.")]  # [s, s, 3] bytes

    def encode():
        images = [p.float().div(127.5).sub(1.0).permute(2, 0, 1).unsqueeze(0) for p in pixels]
        return policy.encode(images, io["inputs/tokens"])

    return encode, lambda context: policy.sample(context, io["inputs/state"], io["inputs/noise"])
