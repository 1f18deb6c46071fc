"""RAPTOR, a policy that others trained for any quadrotor, flies the motors of a vehicle by name: raptor.png.

pip install foundation-policy
python examples/raptor.py [cf21-brushless]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from foundation_policy import Raptor

import crazyflie_gym


def rotation(roll, pitch, yaw):
    """Return the rows of the rotations from body to room, (num_envs, 9), of angles of shape (num_envs,) in rad."""
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(angle), np.cos(angle)) for angle in (roll, pitch, yaw))
    rows = [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, sy * cp, sy * sp * sr + cy * cr]
    return np.stack([*rows, sy * sp * cr - cy * sr, -sp, cp * sr, cp * cr], axis=1)


def fly(vehicle, num_envs=8, seconds=5.0):
    """Return the distances to the set-point, m, shape (ticks, num_envs), of flights from up to 80 cm away."""
    # RAPTOR decides every 10 ms
    model = crazyflie_gym.model_text(vehicle, control_hz=100)
    envs = crazyflie_gym.CrazyflieVectorEnv(num_envs, "hover", model=model, action="motors")
    policy, action, distances = Raptor(), np.zeros((num_envs, 4), np.float32), []
    policy.reset()
    envs.reset(seed=0)
    for _ in range(round(seconds / envs.sim.tick_s)):
        state = envs.sim.states()
        error = state[:, :3] - [0.0, 0.0, 0.7]
        seen = np.hstack([error, rotation(*state[:, 6:9].T), state[:, 3:6], state[:, 9:12], action])
        action = policy.evaluate_step(seen.astype(np.float32)).clip(-1, 1)
        envs.step(action)
        distances.append(np.linalg.norm(error, axis=1))
    return np.array(distances)


if __name__ == "__main__":
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for i, name in enumerate(sys.argv[1:] or ["cf21", "cf21-brushless"]):
        far = fly(name)
        for flight, line in enumerate(axes.plot(0.01 * np.arange(len(far)), far, f"C{i}", lw=1)):
            line.set_label("_" * (flight > 0) + name)
        print(
            f"{name}: {len(far[0])} flights, {far[0].mean():.2f} m away, {far[-100:].mean():.3f} m in the last second"
        )
    axes.set(xlabel="time (s)", ylabel="distance to the set-point (m)")
    axes.legend()
    figure.savefig("raptor.png", dpi=100)
    print("the picture is raptor.png")
