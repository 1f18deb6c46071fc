"""Makes the pictures and the film of README and site: `make pictures`.

    python docs/tools/pictures.py [NAME...]

Colours are those of Okabe and Ito, which colour-blind people tell apart; every axis has its unit.
"""

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import gymnasium as gym
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import crazyflie_gym  # noqa: F401, registers the ids
from crazyflie_gym.training import LAB
from frames import draw_frames

ROOT = Path(__file__).resolve().parents[2]
OUT = Path(__file__).resolve().parents[1] / "pictures"
COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"]
TICK_S = 0.02


def film():
    """Eight drones swap places: swap.webp."""
    env = gym.make("CrazyflieSwap-v0", render_mode="rgb_array").unwrapped
    pilot = env.controller("lqr", avoid=True)
    env.reset(seed=3)
    frames = []
    for tick in range(480):
        env.step(env.act(pilot))
        if tick >= 35 and tick % 8 == 0:
            frames.append(Image.fromarray(env._screen.picture(0, 640, 400)))
    frames[0].save(
        OUT / "swap.webp", save_all=True, append_images=frames[1:], duration=160, loop=0, quality=30, method=4
    )


def first_flight():
    """The flight of the first tutorial: first_flight.svg."""
    figure, panels = plt.subplots(1, 2, figsize=(8.5, 3.2), layout="constrained")
    for name, effects in {"ideal": {}, "camera rig": LAB}.items():
        env = gym.make(
            "Crazyflie-v0",
            vertical="pwm",
            effects=effects,
            true_state=True,
            task_options={"start_m": [0.8, 0.0, 0.7]},
        )
        pid = env.unwrapped.pid()
        _, info = env.reset(seed=1)
        states = []
        for _ in range(500):
            states.append(info["true_state"][:3])
            _, _, _, _, info = env.step(env.unwrapped.act(pid))
        states = 100 * np.array(states)
        time_s = TICK_S * np.arange(len(states))
        panels[0].plot(time_s, states[:, 0], label=name)
        panels[1].plot(time_s, states[:, 2], label=name)
    panels[0].axhline(0, color="0.5", lw=0.8, ls="--")
    panels[1].axhline(70, color="0.5", lw=0.8, ls="--", label="set-point")
    panels[0].set(xlabel="time, s", ylabel="x, cm", title="way to the marker")
    panels[1].set(xlabel="time, s", ylabel="z, cm", title="height")
    panels[1].legend()
    _save(figure, "first_flight.svg")


def steps():
    """Step responses of the identified model: model_steps.svg."""
    figure, panels = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained")
    told = {"observation": "state", "form": "dict", "task_options": {"start_m": [0.0, 0.0, 0.7]}}
    env = gym.make("Crazyflie-v0", **told)
    state, _ = env.reset(seed=0)
    limit_deg = np.degrees(env.unwrapped.interface.tilt_max_rad)
    height = 2 * 0.7 / env.unwrapped.interface.lift_max - 1
    pitch, speed = [], []
    for _ in range(60):
        _, pitch_rad, _ = state["att_rad"]
        vx_mps, _, _ = state["vel_mps"]
        pitch.append(np.degrees(pitch_rad))
        speed.append(vx_mps)
        state = env.step(np.array([0, 5.0 / limit_deg, 0, height], np.float32))[0]
    time_s = TICK_S * np.arange(60)
    panels[0].plot(time_s, pitch, label="pitch")
    panels[0].axhline(5, color="0.5", lw=0.8, ls="--", label="command")
    panels[0].set(xlabel="time, s", ylabel="pitch, degrees", title="5.1: 5 degrees commanded")
    panels[0].legend()
    panels[1].plot(time_s, speed, color=COLOURS[1])
    panels[1].set(xlabel="time, s", ylabel="velocity, m/s", title="5.5: the same step")
    for vertical, equation, colour in (("height", "5.3", 0), ("pwm", "5.4", 1)):
        env = gym.make("Crazyflie-v0", vertical=vertical, **told)
        state, _ = env.reset(seed=0)
        interface = env.unwrapped.interface
        # 80 cm by 5.3, and the PWM that rests at 80 cm by 5.4
        lift = 0.8 * 1.592 / 1.615 if vertical == "height" else 35000 + 0.6123 * 0.8 / 9.87e-5
        heights = []
        for _ in range(400):
            _, _, z_m = state["pos_m"]
            heights.append(100 * z_m)
            state = env.step(np.array([0, 0, 0, 2 * lift / interface.lift_max - 1], np.float32))[0]
        panels[2].plot(TICK_S * np.arange(400), heights, color=COLOURS[colour], label=equation)
    panels[2].axhline(80, color="0.5", lw=0.8, ls="--")
    panels[2].set(xlabel="time, s", ylabel="height, cm", title="5.3 and 5.4: 70 to 80 cm")
    panels[2].legend()
    _save(figure, "model_steps.svg")


def scores():
    """The score of an episode over its RMS error: scores.svg."""
    figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
    rmse_m = np.linspace(0, 0.4, 200)
    for scenario, scale_m in (("hover-aruco", 0.15), ("fly-80cm", 0.4)):
        axes.plot(100 * rmse_m, 100 * np.exp(-rmse_m / scale_m), label=f"{scenario}: scale {scale_m} m")
    axes.set(xlabel="RMS distance to the set-point, cm", ylabel="score of an episode", ylim=(0, 100))
    axes.legend()
    _save(figure, "scores.svg")


def frames():
    """Axes, angles and motors: frames.svg."""
    (OUT / "frames.svg").write_text(draw_frames())


def simulators():
    """Errors of simulators on real flights, from the figures of the last comparison: simulators.svg."""
    sys.path.insert(0, str(ROOT / "examples/simulators"))
    import report

    figures = (ROOT / "docs/measured/simulators.json").read_text()
    report.draw(report.read_json(figures), OUT / "simulators.svg")


def examples():
    """The pictures that examples draw, smaller: examples/*.webp."""
    from generate import picture_of

    (OUT / "examples").mkdir(exist_ok=True)
    for program in sorted((ROOT / "examples").glob("*.py")):
        name = picture_of(program)
        if name is None:
            continue
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, program], cwd=folder, check=True)
            drawn = Path(folder) / name
            if drawn.suffix == ".svg":
                shutil.copy(drawn, OUT / "examples")
                continue
            picture = Image.open(drawn).convert("RGB")
            picture.thumbnail((720, 720))
            picture.save(OUT / "examples" / f"{program.stem}.webp", quality=60, method=6)


def _save(figure, name):
    # neither dates nor random ids: the same picture is the same file
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
    (OUT / name).write_text("".join(line.rstrip() + "\n" for line in text.getvalue().splitlines()))


PICTURES = {
    "swap": film,
    "first_flight": first_flight,
    "model_steps": steps,
    "scores": scores,
    "frames": frames,
    "simulators": simulators,
    "examples": examples,
}


def main():
    """Make all pictures, or those that are named."""
    mpl.rcParams["svg.hashsalt"] = "crazyflie"
    mpl.rcParams["axes.prop_cycle"] = mpl.cycler(color=COLOURS)
    mpl.rcParams["axes.grid"] = True
    mpl.rcParams["grid.alpha"] = 0.3
    mpl.rcParams["font.size"] = 11
    OUT.mkdir(exist_ok=True)
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]()
        print(f"{name} is in {OUT}")


if __name__ == "__main__":
    main()
