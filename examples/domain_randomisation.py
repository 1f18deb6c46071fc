"""Every episode flies another vehicle on another day: any parameter of an effect can be a distribution."""

import gymnasium as gym
import numpy as np

import crazyflie_gym  # noqa: F401  registers the environments

EFFECTS = {
    "wind": {"x_mps2": {"normal": [0.0, 0.3]}, "y_mps2": {"normal": [0.0, 0.3]}},
    "thrust_scale": {"scale": {"uniform": [0.9, 1.1]}},
    "cmd_delay": {"log_uniform": [0.005, 0.05]},
    "camera_noise": {"xy_m": {"choice": [0.0, 0.005, 0.01]}},
}
ENVS, STEPS = 512, 500


def hover_error(effects):
    """The distance to the set-point over the last two seconds, one number per environment."""
    envs = gym.make_vec(
        "Crazyflie-v0", num_envs=ENVS, vertical="pwm", effects=effects, true_state=True, max_episode_steps=-1
    )
    pid = envs.unwrapped.pid()
    observations, _ = envs.reset(seed=0)
    distances = []
    for _ in range(STEPS):
        observations, _, _, _, info = envs.step(pid.act(observations))
        distances.append(np.linalg.norm(info["true_state"][:, :3] - [0, 0, 0.7], axis=1))
    return np.mean(distances[-100:], axis=0)


def main():
    print(f"hover error of the thesis's PID over {ENVS} episodes, in cm: median, 90 %, worst")
    rows = {"nothing": {}, **{name: {name: given} for name, given in EFFECTS.items()}, "everything": EFFECTS}
    for name, effects in rows.items():
        error = 100 * hover_error(effects)
        print(f"{name:14s} {np.median(error):7.2f} {np.quantile(error, 0.9):7.2f} {error.max():7.2f}")


if __name__ == "__main__":
    main()
