"""References that a position controller follows, and what is added to its commands."""

import math

import numpy as np

from .firmware import CONTROL_S

KINDS = ["mix", "multisine", "doublets", "fig8", "steps", "stairs", "yawspin", "hover", "drain"]


class Excitation:
    """References and what is added to commands, a row a control tick.

    Reference: x, y, z in m, yaw in rad. Addition: roll and pitch in deg, yaw rate in deg/s, PWM. A free yaw is
    held by nothing.
    """

    def __init__(self, kind, seconds, rng):
        self.rng = rng
        n = round(seconds / CONTROL_S) + 1
        self.t_s = np.arange(n) * CONTROL_S
        self.reference = np.zeros((n, 4))
        self.reference[:, 2] = 0.7
        self.addition = np.zeros((n, 4))
        self.yaw_is_free = np.zeros(n, dtype=bool)
        if kind == "mix":
            parts = rng.permutation(["steps", "fig8", "doublets", "multisine", "yawspin"])
            edges = np.linspace(0, n, len(parts) + 1).astype(int)
            for part, begin, end in zip(parts, edges, edges[1:], strict=False):
                getattr(self, part)(begin, end)
        elif kind == "drain":
            self.multisine(0, n)
            self.reference[:, :2] *= 0.3
        else:
            getattr(self, kind)(0, n)

    def hover(self, begin, end):
        """Nothing but the place to hold."""

    def holds(self, begin, end, shortest_s, longest_s):
        """Stretches of random length."""
        while begin < end:
            after = begin + int(self.rng.uniform(shortest_s, longest_s) / CONTROL_S)
            yield slice(begin, min(after, end))
            begin = after

    def steps(self, begin, end):
        """Places to fly to."""
        for rows in self.holds(begin, end, 3.0, 5.0):
            self.reference[rows, :3] = self.rng.uniform([-0.6, -0.6, 0.45], [0.6, 0.6, 1.1])

    def stairs(self, begin, end):
        """Heights, the lowest of them in ground effect, with a little motion sideways."""
        for rows in self.holds(begin, end, 2.0, 3.5):
            self.reference[rows, 2] = self.rng.choice([0.10, 0.11, 0.13, 0.16, 0.2, 0.3, 0.5])
        self.reference[begin:end, 0] = 0.15 * np.sin(2 * np.pi * self.t_s[begin:end] / 7)

    def fig8(self, begin, end):
        """A lying eight."""
        size_m, period_s, phase = self.rng.uniform([0.8, 7.0, 0.0], [1.1, 10.0, 2 * math.pi])
        angle = 2 * np.pi * self.t_s[begin:end] / period_s + phase
        self.reference[begin:end, 0] = size_m * np.sin(angle)
        self.reference[begin:end, 1] = 0.4 * size_m * np.sin(2 * angle)
        self.reference[begin:end, 2] = 0.7 + 0.12 * np.sin(0.45 * angle)

    def multisine(self, begin, end):
        """Seven tones an axis."""
        for axis, (size_m, low_hz, high_hz) in enumerate([(0.7, 0.04, 0.35), (0.7, 0.04, 0.35), (0.25, 0.05, 0.6)]):
            tones_hz = np.linspace(low_hz, high_hz, 7) + self.rng.uniform(-0.02, 0.02, 7)
            phases = self.rng.uniform(0, 2 * math.pi, 7)
            sum_ = np.sin(2 * np.pi * np.outer(self.t_s[begin:end], tones_hz) + phases).sum(axis=1)
            self.reference[begin:end, axis] = size_m * sum_ / max(np.abs(sum_).max(), 1e-9)
        self.reference[begin:end, 2] += 0.75

    def doublets(self, begin, end):
        """Pushes to and fro on roll, pitch or thrust, which the position loop then undoes."""
        tick = begin + 50
        while tick < end - 150:
            half = int(self.rng.uniform(0.2, 0.5) / CONTROL_S)
            channel = self.rng.choice([0, 1, 3])
            size = self.rng.choice([-1, 1]) * (
                self.rng.uniform(2500, 4500) if channel == 3 else self.rng.uniform(5.0, 7.5)
            )
            self.addition[tick : tick + half, channel] = size
            self.addition[tick + half : tick + 2 * half, channel] = -size
            tick += 2 * half + int(self.rng.uniform(0.8, 1.8) / CONTROL_S)

    def yawspin(self, begin, end):
        """A turn at a constant rate."""
        self.yaw_is_free[begin:end] = True
        self.addition[begin:end, 2] = self.rng.choice([-1, 1]) * self.rng.uniform(25, 40)
