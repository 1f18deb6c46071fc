"""Fly the thesis's PID from 80 cm away to the marker, and leave a picture of the flight: 1_fly.png."""

import gymnasium as gym
import numpy as np

import crazyflie_gym

EFFECTS = {"camera": 1, "camera_latency": 0.03, "camera_noise": {"xy_m": 0.003}, "drag_linear": 0.3}


def main():
    env = gym.make(
        "Crazyflie-v0",
        vertical="pwm",
        effects=EFFECTS,
        task_options={"start_m": [0.8, 0.0, 0.7]},
        true_state=True,
        render_mode="rgb_array",
    )
    pid = env.unwrapped.pid(gains="thesis")
    env.reset(seed=1)
    print("   t      x      y      z   distance")
    for step in range(1, 501):
        _, _, terminated, truncated, info = env.step(env.unwrapped.act(pid))
        x, y, z = info["true_state"][:3]
        if step == 60:
            crazyflie_gym.save_png("1_fly.png", env.render())
        if step % 50 == 0:
            print(f"{step / 50:4.1f} {x:6.2f} {y:6.2f} {z:6.2f} {np.linalg.norm([x, y, z - 0.7]):8.3f} m")
        if terminated or truncated:
            break
    print("the picture is 1_fly.png")


if __name__ == "__main__":
    main()
