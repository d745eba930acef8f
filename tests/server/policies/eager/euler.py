"""Euler's steps of flow matching as openpi takes them: times summed in single precision."""
import torch


def integrate(velocity, noise, steps=10):
    """velocity(x [B, K, d], t [B]) -> [B, K, d]; noise at t = 1 -> actions at t = 0."""
    x, dt = noise, torch.tensor(-1.0 / steps)
    t = torch.tensor(1.0)
    while t >= -dt / 2:
        x = x + dt * velocity(x, t.expand(x.shape[0]))
        t = t + dt
    return x
