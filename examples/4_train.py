"""Train a policy, in about a minute, and fly it against the thesis's PID on unseen seeds: 4_train.png."""

import argparse
import dataclasses
import time

import matplotlib.pyplot as plt

from crazyflie_gym.evaluation import Scenario, Work, fly, median
from crazyflie_gym.ppo import Trainer
from crazyflie_gym.training import LAB, TASKS

FLOWN = {
    "hover": Scenario(ticks=500, effects=LAB, task_options={"start_radius_m": 0.8, "start_yaw_deg": 20.0}),
    "80 cm": Scenario(ticks=750, effects=LAB, task_options={"start_m": [0.8, 0.0, 0.7]}),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=TASKS["hover"].iterations)
    parser.add_argument("--out", default="hover.safetensors")
    args = parser.parse_args()
    start = time.perf_counter()
    trained = Trainer(dataclasses.replace(TASKS["hover"], iterations=args.iterations)).train()
    print(f"trained in {time.perf_counter() - start:.1f} s:", end=" ")
    print(", ".join(f"{part} {seconds:.1f} s" for part, seconds in trained.seconds.items()))
    trained.policy.save(args.out)
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
    print("128 unseen seeds       RMS error    reward   failed")
    for name, scenario in FLOWN.items():
        for controller in ("thesis-pid", f"policy:{args.out}"):
            flights = fly(Work.of(scenario, controller, first_seed=10**9, count=128))
            failed = sum(flight["failed"] for flight in flights)
            figures = f"{100 * median(flights, 'rmse_m'):8.1f} cm {median(flights, 'reward'):9.3f} {failed:8d}"
            print(f"{name} {controller.split(':')[0]:14s} {figures}")
            errors_cm = [100 * flight["rmse_m"] for flight in flights]
            right.ecdf(errors_cm, label=f"{name}, {controller.split(':')[0]}")
    left.plot(trained.rewards)
    left.set(xlabel="rollout", ylabel="reward per tick, exploration included")
    middle.barh(list(trained.seconds), list(trained.seconds.values()))
    middle.set(xlabel="s", title="where the time went")
    right.set(xlabel="RMS error, cm", ylabel="share of the unseen flights")
    right.legend()
    figure.savefig("4_train.png", dpi=100)
    print(f"the policy is {args.out}: crazyflie fly --controller policy:{args.out}; the picture is 4_train.png")


if __name__ == "__main__":
    main()
