"""Controllers: a position PID on the ground at 50 Hz, attitude PID at 100 Hz and rate PID at 500 Hz on board."""

import math

import numpy as np

from .vehicle import HOVER_PWM, INERTIA_KGM2, STEP_S, THRUST_PER_PWM_N

CONTROL_S = 0.02
ATTITUDE_S = 0.01
TILT_LIMIT_DEG = 10.0


class Position:
    """Roll, pitch, yaw rate and PWM from camera positions: the thesis's interface, with gains for this vehicle."""

    TILT = (6.0, 0.4, 8.0)  # deg per m, m s, m/s
    LIFT = (9000.0, 2500.0, 7500.0)  # counts per m, m s, m/s
    YAW_PER_DEG_PS = 2.0
    SMOOTHING_S = 0.08

    def __init__(self):
        self.sum = np.zeros(3)
        self.velocity = np.zeros(3)
        self.last = None

    def frame(self, position, t_cam_s):
        """A camera frame: the speed is the smoothed difference of frames."""
        if self.last is not None and t_cam_s > self.last[1]:
            gap_s = t_cam_s - self.last[1]
            share = 1 - math.exp(-gap_s / self.SMOOTHING_S)
            self.velocity += share * ((position - self.last[0]) / gap_s - self.velocity)
        self.last = (position.copy(), t_cam_s)

    def command(self, ref, yaw_rad):
        """Roll and pitch in deg, yaw rate in deg/s with the thesis's sign, PWM."""
        error = ref[:3] - (self.last[0] if self.last else ref[:3])
        self.sum = np.clip(self.sum + error * CONTROL_S, -1.0, 1.0)
        kp, ki, kd = self.TILT
        ahead = kp * error[:2] + ki * self.sum[:2] - kd * self.velocity[:2]
        sin, cos = math.sin(yaw_rad), math.cos(yaw_rad)
        pitch, roll = cos * ahead[0] + sin * ahead[1], sin * ahead[0] - cos * ahead[1]
        kp, ki, kd = self.LIFT
        pwm = HOVER_PWM + kp * error[2] + ki * self.sum[2] - kd * self.velocity[2]
        turn = math.degrees(math.atan2(math.sin(ref[3] - yaw_rad), math.cos(ref[3] - yaw_rad)))
        return np.array([roll, pitch, -max(-100.0, min(100.0, self.YAW_PER_DEG_PS * turn)), pwm])


class Inner:
    """Attitude and rate loops: `firmware` integrates in both, as the Crazyflie does; `plain` lets trims be seen."""

    # attitude: 1/s, 1/s^2; rate: 1/s, 1/s^2, 1, of angular accelerations, whose torque the firmware knows
    GAINS = {"firmware": ((6.0, 1.5), (60.0, 30.0, 3.0)), "plain": ((6.0, 0.0), (60.0, 0.0, 3.0))}
    YAW = (12.0, 6.0)
    SMOOTHING_S = 1 / (2 * math.pi * 40)

    @classmethod
    def stiffness_ps2(cls, kind):
        """Angular acceleration per angle that holds against a torque."""
        attitude, rate = cls.GAINS[kind]
        return attitude[0] * rate[0]

    def __init__(self, kind):
        self.attitude, self.rate = self.GAINS[kind]
        self.angle_sum, self.rate_sum, self.yaw_sum = [0.0, 0.0], [0.0, 0.0], 0.0
        self.target = [0.0, 0.0]
        self.last, self.slope = [0.0, 0.0], [0.0, 0.0]

    def aim(self, command_rad, angle_rad):
        """The attitude loop: body rates to ask for."""
        kp, ki = self.attitude
        for i in range(2):
            error = command_rad[i] - angle_rad[i]
            self.angle_sum[i] = max(-0.3, min(0.3, self.angle_sum[i] + error * ATTITUDE_S))
            self.target[i] = kp * error + ki * self.angle_sum[i]

    def moment(self, rate_radps, yaw_rate_radps, turn_deg):
        """The rate loop: moments for the mixer, about axes that may be turned against the body's."""
        kp, ki, kd = self.rate
        asked = [0.0, 0.0]
        for i in range(2):
            error = self.target[i] - rate_radps[i]
            self.rate_sum[i] = max(-5.0, min(5.0, self.rate_sum[i] + error * STEP_S))
            share = STEP_S / (STEP_S + self.SMOOTHING_S)
            self.slope[i] += share * ((rate_radps[i] - self.last[i]) / STEP_S - self.slope[i])
            self.last[i] = rate_radps[i]
            asked[i] = kp * error + ki * self.rate_sum[i] - kd * self.slope[i]
        turn_rad = math.radians(turn_deg)
        sin, cos = math.sin(turn_rad), math.cos(turn_rad)
        roll, pitch = cos * asked[0] - sin * asked[1], sin * asked[0] + cos * asked[1]
        error = yaw_rate_radps - rate_radps[2]
        self.yaw_sum = max(-3.0, min(3.0, self.yaw_sum + error * STEP_S))
        yaw = self.YAW[0] * error + self.YAW[1] * self.yaw_sum
        return np.array((INERTIA_KGM2[0] * roll, INERTIA_KGM2[1] * pitch, INERTIA_KGM2[2] * yaw))


def thrust_n(pwm, slope):
    """The firmware's map from PWM to thrust; a hidden slope turns it about hover."""
    return max(0.0, THRUST_PER_PWM_N * (HOVER_PWM + slope * (pwm - HOVER_PWM)))


class Link:
    """What happens to a command on its way: lost, late, dead about zero, limited, slow, with play."""

    def __init__(self, hidden, rng):
        self.hidden, self.rng = hidden, rng
        self.held = np.array([0.0, 0.0, 0.0, HOVER_PWM])
        self.queue = [self.held] * round(hidden.get("cmd_delay", 0.0) / STEP_S)
        self.bad = False
        self.tilt = np.zeros(2)
        self.slow = np.zeros(2)

    def receive(self, command):
        """One packet a control tick; losses come in bursts (Gilbert and Elliott)."""
        loss = self.hidden.get("loss_prob", 0.0)
        if loss > 0:
            self.bad = self.rng.random() < (0.75 if self.bad else loss / 2)
        if not self.bad:
            self.held = command

    def deliver(self):
        """The command that arrives in this step of 2 ms."""
        self.queue.append(self.held)
        return self.queue.pop(0)

    def tilt_deg(self, command):
        """Roll and pitch as the attitude loop, at 100 Hz, makes them of a command."""
        hidden = self.hidden
        tilt = command[:2] * hidden.get("attitude_gain", 1.0)
        if "cmd_deadband" in hidden:
            tilt = np.sign(tilt) * np.maximum(np.abs(tilt) - hidden["cmd_deadband"], 0.0)
        if "cmd_limit" in hidden:
            tilt = np.clip(tilt, -hidden["cmd_limit"], hidden["cmd_limit"])
        if "backlash" in hidden:
            half = hidden["backlash"] / 2
            tilt = self.tilt = np.clip(self.tilt, tilt - half, tilt + half)
        if "rate_limit" in hidden:
            reach = hidden["rate_limit"] * ATTITUDE_S
            tilt = self.slow = self.slow + np.clip(tilt - self.slow, -reach, reach)
        return tilt
