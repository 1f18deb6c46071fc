"""Effects that are hidden: parameters with ranges, the flights that show them, the inner loop that leaves them seen."""

from dataclasses import dataclass, field

from .firmware import ATTITUDE_S
from .vehicle import drag_rate_ps

NEUTRAL = {
    "thrust_scale": 1.0,
    "tau_m_scale": 1.0,
    "attitude_gain": 1.0,
    "inertia_scale": 1.0,
    "cam_scale": 1.0,
    "motor_eff": 1.0,
}
NEUTRAL |= {"thrust_slope": 1.0, "drag_linear": drag_rate_ps()}
# parameters that a weaker effect keeps: choices, times and places
KEPT = {
    "motor_index",
    "gust_tau",
    "slung_length",
    "sine_freq",
    "wall_x",
    "wall_reach",
    "step_at",
    "rate_limit",
    "cmd_limit",
    "place_x",
    "place_y",
    "tilt_from_deg",
    "moved_at",
}
# The attitude loop looks for commands this often. A delay between would be longer for angles than for thrust, and
# no number would be its truth.
WHOLE = {"cmd_delay": ATTITUDE_S}


@dataclass(frozen=True)
class Effect:
    """Ranges by key, with a random sign where `signed`; `benign` is what else is true where the effect is."""

    ranges: dict
    kinds: list
    signed: bool = False
    inner: str | None = None
    benign: list = field(default_factory=list)

    def draw(self, rng):
        """Values of the parameters."""
        values = {}
        for key, (low, high) in self.ranges.items():
            value = float(rng.uniform(low, high))
            turns = self.signed and key not in KEPT
            values[key] = rounded(key, value * float(rng.choice([-1, 1])) if turns else value)
        if "motor_eff" in values:
            values["motor_index"] = int(rng.integers(1, 5))
        return values


MOVING = ["fig8", "multisine", "mix"]
SHARP = ["doublets", "multisine", "mix"]

# Ranges are those of the shared generator where rotorpy has the same meaning. The vehicle's own drag is 0.244 1/s.
EFFECTS = {
    "drag_linear": Effect({"drag_linear": (0.35, 0.75)}, MOVING),
    "drag_quadratic": Effect({"drag_quadratic": (0.2, 0.6)}, MOVING),
    "wind": Effect({"wind_x": (0.1, 0.5), "wind_y": (0.1, 0.5)}, ["yawspin", "mix"], signed=True),
    "gust": Effect({"gust_sigma": (0.15, 0.5), "gust_tau": (0.4, 2.0)}, ["fig8", "hover", "mix"]),
    "ground_effect": Effect({"ground_effect": (6.0, 20.0)}, ["stairs"]),
    # fewer newtons are also fewer newton metres
    "thrust_scale": Effect(
        {"thrust_scale": (0.85, 0.96)}, ["multisine", "steps", "mix"], benign=["inertia_scale", "attitude_gain"]
    ),
    "mass_change": Effect({"mass_add": (0.001, 0.005)}, ["multisine", "steps", "mix"]),
    "battery_sag": Effect({"battery_exponent": (0.8, 2.2)}, ["drain"], benign=["inertia_scale", "attitude_gain"]),
    "cmd_delay": Effect({"cmd_delay": (0.02, 0.08)}, SHARP),
    # the time constant as a share of rotorpy's 72 ms, which the declared attitude contains already
    "motor_lag": Effect({"tau_m_scale": (1.3, 1.8)}, SHARP),
    "com_offset": Effect(
        {"com_roll": (0.5, 2.5), "com_pitch": (0.5, 2.5)}, ["fig8", "steps", "mix"], signed=True, inner="plain"
    ),
    "imu_tilt": Effect({"imu_tilt_roll": (0.5, 2.5), "imu_tilt_pitch": (0.5, 2.5)}, ["yawspin", "mix"], signed=True),
    "attitude_gain": Effect({"attitude_gain": (0.75, 0.92)}, SHARP),
    "inertia_scale": Effect({"inertia_scale": (1.15, 1.6)}, ["doublets", "mix"]),
    "frame_yaw": Effect({"frame_yaw": (3.0, 12.0)}, ["fig8", "steps", "mix"], signed=True),
    "camera_lever": Effect({"cam_x": (0.01, 0.03), "cam_z": (0.02, 0.05)}, ["yawspin", "doublets"], signed=True),
    "camera_scale": Effect({"cam_scale": (0.88, 0.96)}, MOVING),
    "camera_latency": Effect({"cam_latency": (0.03, 0.1)}, MOVING),
    "cmd_deadband": Effect({"cmd_deadband": (0.6, 2.0)}, SHARP),
    "cmd_limit": Effect({"cmd_limit": (3.0, 6.0)}, ["doublets", "steps"]),
    "flap": Effect({"flap": (2.0, 8.0)}, ["fig8", "multisine"], inner="plain"),
    "weak_motor": Effect({"motor_eff": (0.93, 0.98)}, ["multisine", "mix"], inner="plain"),
    "heave_damping": Effect({"heave_add": (0.4, 1.5)}, ["multisine", "stairs", "mix"]),
    "yaw_drift": Effect({"yaw_drift": (0.2, 1.5)}, ["fig8", "mix"], signed=True),
    "thrust_slope": Effect({"thrust_slope": (0.7, 0.9)}, ["multisine", "steps"]),
    # a rate loop of 500 Hz makes up for it: nothing of it shows
    "alloc_cross": Effect({"alloc_cross": (4.0, 12.0)}, ["doublets", "multisine"], signed=True, inner="plain"),
    "packet_loss": Effect({"loss_prob": (0.15, 0.4)}, ["multisine", "doublets"]),
}
OUTSIDE = {
    "slung_load": Effect({"slung_ratio": (0.08, 0.15), "slung_length": (0.25, 0.6)}, ["steps", "fig8"]),
    "periodic_force": Effect({"sine_amp": (0.25, 0.6), "sine_freq": (0.5, 1.6)}, ["hover", "fig8"]),
    "backlash": Effect({"backlash": (1.0, 3.0)}, ["multisine", "doublets"]),
    # deg/s that the attitude command can follow
    "cmd_rate_limit": Effect({"rate_limit": (15.0, 40.0)}, ["multisine", "doublets"]),
    # share by which a place 1 m off the centre seems farther out
    "lens_distortion": Effect({"lens_pm2": (0.06, 0.15)}, ["fig8", "multisine"], signed=True),
    # m/s^2 at the wall, where it stands, and how far it reaches [m]
    "wall_effect": Effect(
        {"wall_pull": (0.5, 1.2), "wall_x": (0.9, 1.1), "wall_reach": (0.15, 0.3)}, ["fig8", "multisine"]
    ),
    # m/s^2 from a share of the flight on
    "wind_step": Effect(
        {"wind_step_x": (0.2, 0.6), "wind_step_y": (0.2, 0.6), "step_at": (0.35, 0.65)}, ["fig8", "mix"], signed=True
    ),
    # no effect of the library has these laws
    # deceleration per climb times its size [1/m]
    "heave_square": Effect({"heave_square": (1.0, 2.5)}, ["multisine", "mix"]),
    # acceleration down per sinking speed [1/s]
    "sink_loss": Effect({"sink_loss": (0.6, 1.2)}, ["multisine", "mix"]),
    # acceleration towards a point per distance [1/s^2], and where it is
    "place_pull": Effect(
        {"place_pull": (0.4, 0.9), "place_x": (0.3, 0.8), "place_y": (0.1, 0.5)}, ["fig8", "multisine", "mix"]
    ),
    # acceleration by a wind that grows with height [1/s^2]
    "wind_shear": Effect({"wind_shear": (0.4, 0.9)}, ["multisine", "steps", "mix"], signed=True),
    # share of the thrust per radian beyond a tilt
    "tilt_drop": Effect({"tilt_drop": (0.6, 1.2), "tilt_from_deg": (3.0, 6.0)}, ["multisine", "doublets", "mix"]),
    # the marker slips to one side in flight [m], at a share of it
    "marker_moved": Effect({"moved_x": (0.03, 0.08), "moved_at": (0.35, 0.65)}, MOVING, signed=True),
    # the yaw that the gyro adds up, too large by this share
    "gyro_scale": Effect({"gyro_scale": (0.04, 0.12)}, ["yawspin", "mix"], signed=True),
}


def rounded(key, value):
    """A value as it is hidden: five digits, a delay in whole looks of the attitude loop."""
    step = WHOLE.get(key)
    return round(step * max(round(value / step), 1) if step else value, 5)


def weakened(values):
    """Three quarters of what an effect changes."""
    return {
        k: v if k in KEPT else rounded(k, NEUTRAL.get(k, 0.0) + 0.75 * (v - NEUTRAL.get(k, 0.0)))
        for k, v in values.items()
    }
