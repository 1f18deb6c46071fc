"""The vehicle: rotorpy's Crazyflie with its motors, mixer and aerodynamics as they are, stepped at 500 Hz."""

import copy
import math

import numpy as np
from rotorpy.vehicles.crazyflie_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

from .derivative import Constants

STEP_S = 0.002
# steps from one comparison with rotorpy's own derivative to the next, and how near it must be to it, relatively
CHECK_STEPS, CHECK_SHARE = 1000, 1e-9
GRAVITY_MPS2 = 9.81
# battery voltage at which the firmware's thrust map holds
REFERENCE_V = 4.0
PROPELLER_RADIUS_M = 0.0231
# the firmware counts its motors from the front right, clockwise; rotorpy from the front left, clockwise
ROTOR_OF_MOTOR = {1: 1, 2: 2, 3: 3, 4: 0}

# places in rotorpy's state vector
POSITION, VELOCITY, QUATERNION, RATE, WIND, ROTORS = (
    slice(a, b) for a, b in ((0, 3), (3, 6), (6, 10), (10, 13), (13, 16), (16, 20))
)

# hidden numbers of what pushes the vehicle from outside
PUSHES = {"sine_amp", "wall_pull", "slung_ratio"}
PUSHES |= {"heave_square", "sink_loss", "place_pull", "wind_shear", "tilt_drop"}

MASS_KG = quad_params["mass"]
INERTIA_KGM2 = (quad_params["Ixx"], quad_params["Iyy"], quad_params["Izz"])
HOVER_RADPS = math.sqrt(MASS_KG * GRAVITY_MPS2 / (4 * quad_params["k_eta"]))
# 65535 counts ask for the thrust of the fastest rotors; the firmware's map from PWM to thrust is a line
THRUST_PER_PWM_N = 4 * quad_params["k_eta"] * quad_params["rotor_speed_max"] ** 2 / 65535
HOVER_PWM = MASS_KG * GRAVITY_MPS2 / THRUST_PER_PWM_N


def drag_rate_ps(k_d=quad_params["k_d"]):
    """Deceleration per speed that the rotors' drag makes in hover."""
    return 4 * k_d * HOVER_RADPS / MASS_KG


def euler_rad(state):
    """Roll, pitch and yaw (z-y-x) of a state vector."""
    x, y, z, w = state[QUATERNION].tolist()
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def rotation(roll, pitch, yaw):
    """From the body's frame to the world's."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a), math.cos(a)) for a in (roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def altered_parameters(hidden):
    """rotorpy's parameters with what is hidden in them."""
    params = copy.deepcopy(quad_params)
    params["mass"] += hidden.get("mass_add", 0.0)
    params["k_eta"] *= hidden.get("thrust_scale", 1.0)
    params["tau_m"] *= hidden.get("tau_m_scale", 1.0)
    if "drag_linear" in hidden:
        params["k_d"] *= hidden["drag_linear"] / drag_rate_ps()
    # heave_add is per mass, at the speed of the rotors in hover
    params["k_z"] += hidden.get("heave_add", 0.0) * MASS_KG / (4 * HOVER_RADPS)
    for axis in "xyz":
        params[f"c_D{axis}"] = hidden.get("drag_quadratic", 0.0) * MASS_KG
    for axis in "xyz":
        params[f"I{axis}{axis}"] *= hidden.get("inertia_scale", 1.0)
    # rotorpy's sign is that of a disc that tilts into the wind; a flapping disc tilts back
    params["k_flap"] = -hidden.get("flap", 0.0) * INERTIA_KGM2[0] / (4 * HOVER_RADPS)
    # the trims are angles that the loop's stiffness holds against the thrust's lever arm
    for key, axis, sign in (("com_roll", 1, 1.0), ("com_pitch", 0, -1.0)):
        lever_m = sign * math.radians(hidden.get(key, 0.0)) * hidden.get("stiffness_ps2", 0.0) * INERTIA_KGM2[0]
        for place in params["rotor_pos"].values():
            place[axis] += lever_m / (MASS_KG * GRAVITY_MPS2)
    return params


class Vehicle:
    """rotorpy's multirotor between the mixer's commands and its state, with what is hidden around it."""

    def __init__(self, hidden, start_m=(0.0, 0.0, 0.7)):
        self.hidden = hidden
        self.body = Multirotor(altered_parameters(hidden), control_abstraction="cmd_motor_speeds")
        # the firmware mixes for the vehicle that it was made for, whatever is hidden in the one that flies
        self.mixer = Multirotor(quad_params, control_abstraction="cmd_ctbm")
        self.constants = Constants(self.body)
        self.steps = 0
        self.thrust_n_per_radps2 = self.body.k_eta
        self.state = np.zeros(20)
        self.state[POSITION] = start_m
        self.state[9] = 1.0
        self.state[ROTORS] = HOVER_RADPS
        self.slope = None
        self.load_m, self.load_mps = np.zeros(2), np.zeros(2)
        self.is_pushed = not PUSHES.isdisjoint(hidden)
        self.speed_share = np.ones(4)
        if "motor_index" in hidden:
            self.speed_share[ROTOR_OF_MOTOR[hidden["motor_index"]]] = math.sqrt(hidden["motor_eff"])

    def step(self, t_s, thrust_n, moment_nm, vbat_v, wind_mps):
        """One step of 2 ms by Adams and Bashforth's second-order rule: one derivative."""
        asked = self.mixer.get_cmd_motor_speeds(None, {"cmd_thrust": thrust_n, "cmd_moment": moment_nm})
        # thrust goes with the square of the speed
        share = (vbat_v / REFERENCE_V) ** (self.hidden.get("battery_exponent", 0.0) / 2)
        speeds = np.minimum(
            np.maximum(asked * (self.speed_share * share), self.body.rotor_speed_min), self.body.rotor_speed_max
        )
        self.state[WIND] = wind_mps
        if "ground_effect" in self.hidden:
            near = PROPELLER_RADIUS_M / (4 * max(self.state[2], 0.03))
            self.body.k_eta = self.thrust_n_per_radps2 * (1 + self.hidden["ground_effect"] * near**2)
        slope = self.constants.slope(self.state, speeds, self.body.k_eta)
        if self.steps % CHECK_STEPS == 0:
            self.check(slope, speeds)
        self.steps += 1
        if self.is_pushed:
            slope[VELOCITY] += self.outer_acceleration(t_s, slope)
        before = slope if self.slope is None else self.slope
        self.state += (1.5 * STEP_S) * slope - (0.5 * STEP_S) * before
        quaternion = self.state[QUATERNION]
        quaternion /= math.sqrt(quaternion @ quaternion)
        self.slope = slope

    def check(self, slope, speeds):
        """Fails where the compiled derivative is not rotorpy's."""
        np.testing.assert_allclose(
            slope, self.body._s_dot_fn(0.0, self.state, speeds), rtol=CHECK_SHARE, atol=CHECK_SHARE
        )

    def outer_acceleration(self, t_s, slope):
        """Forces per mass that rotorpy does not know."""
        hidden, out = self.hidden, np.zeros(3)
        if "sine_amp" in hidden:
            phase = 2 * math.pi * hidden["sine_freq"] * t_s
            out[:2] += hidden["sine_amp"] * math.sin(phase), 0.6 * hidden["sine_amp"] * math.cos(phase)
        if "wall_pull" in hidden:
            # a wall draws the vehicle sideways the more, the nearer it is
            gap_m = max(hidden["wall_x"] - self.state[0], 0.0)
            out[0] += hidden["wall_pull"] * math.exp(-gap_m / hidden["wall_reach"])
        place_m, climb_mps = self.state[POSITION], self.state[VELOCITY][2]
        out[2] -= hidden.get("heave_square", 0.0) * abs(climb_mps) * climb_mps
        out[2] += hidden.get("sink_loss", 0.0) * min(climb_mps, 0.0)
        if "place_pull" in hidden:
            out[:2] += hidden["place_pull"] * (np.array([hidden["place_x"], hidden["place_y"]]) - place_m[:2])
        out[0] += hidden.get("wind_shear", 0.0) * place_m[2]
        if "tilt_drop" in hidden:
            roll, pitch, _ = euler_rad(self.state)
            beyond_rad = max(math.hypot(roll, pitch) - math.radians(hidden["tilt_from_deg"]), 0.0)
            out[2] -= hidden["tilt_drop"] * GRAVITY_MPS2 * beyond_rad
        if "slung_ratio" in hidden:
            # small swings of a point on a thread; the declared mass holds the load
            per_m = GRAVITY_MPS2 / hidden["slung_length"]
            out[:2] += hidden["slung_ratio"] * per_m * self.load_m
            swing = -per_m * self.load_m - 0.15 * self.load_mps - (slope[VELOCITY][:2] + out[:2])
            self.load_mps += STEP_S * swing
            self.load_m += STEP_S * self.load_mps
        return out

    def has_left(self):
        """Whether it left the room or lost its balance."""
        x, y, z = self.state[POSITION].tolist()
        return not (0.02 < z < 3.0 and abs(x) < 5 and abs(y) < 5)
