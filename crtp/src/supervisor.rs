//! Conditions of flight: arming, tumbles, crashes, emergency stops, the ageing of set-points, the battery.

/// The firmware's limits of the commander: level after the first, motors off after the second.
pub(crate) const LEVEL_AFTER_S: f64 = 0.5;
pub(crate) const STOP_AFTER_S: f64 = 2.0;
/// The emergency-stop watchdog fires after this, once it was sent.
const EMERGENCY_WATCHDOG_S: f64 = 1.0;
/// Motors that turned within this time mean a flight.
const FLYING_S: f64 = 2.0;
/// Tilts beyond which a vehicle does not come back, and for how long they must last: the firmware's specific force
/// along the body of less than 0.5 and of less than -0.2 times that of a hover (supervisor.c). A hard landing is none,
/// and a free fall is a valid flight.
const TUMBLES: [(f64, f64); 2] = [(std::f64::consts::FRAC_PI_3, 1.0), (1.772, 0.1)];
/// Times for which the voltage must be low, and empty.
const LOW_S: f64 = 1.0;
const EMPTY_S: f64 = 5.0;

/// Bits as clients read them.
pub(crate) mod bit {
    pub(crate) const CAN_BE_ARMED: u16 = 1;
    pub(crate) const IS_ARMED: u16 = 1 << 1;
    pub(crate) const IS_AUTO_ARMED: u16 = 1 << 2;
    pub(crate) const CAN_FLY: u16 = 1 << 3;
    pub(crate) const IS_FLYING: u16 = 1 << 4;
    pub(crate) const IS_TUMBLED: u16 = 1 << 5;
    pub(crate) const IS_LOCKED: u16 = 1 << 6;
    pub(crate) const IS_CRASHED: u16 = 1 << 7;
    pub(crate) const HL_ACTIVE: u16 = 1 << 8;
    pub(crate) const HL_FINISHED: u16 = 1 << 9;
    pub(crate) const HL_DISABLED: u16 = 1 << 10;
}

/// Inputs of the supervisor in a tick.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct VehicleCondition {
    pub tilt_rad: f64,
    pub collided: bool,
    pub thrust: bool,
    pub vbat_v: f64,
}

/// Voltages below which the battery counts as low and as empty, and whether tumbles count.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SupervisorLimits {
    pub low_v: f64,
    pub empty_v: f64,
    pub tumble: bool,
}

/// State of the supervisor of one drone.
#[derive(Debug, Clone)]
pub(crate) struct Supervisor {
    auto_arms: bool,
    armed: bool,
    /// Lies or hangs wrongly, which is what the firmware calls a crash.
    tumbled: bool,
    /// For how long the tilt has been beyond each of [`TUMBLES`].
    tilted_s: [f64; 2],
    locked: bool,
    since_thrust_s: f64,
    low_s: f64,
    empty_s: f64,
    /// It was empty once: without load the voltage comes back, the charge does not.
    empty: bool,
    watchdog_s: Option<f64>,
}

impl Supervisor {
    pub(crate) fn new(auto_arms: bool) -> Self {
        Supervisor {
            auto_arms,
            armed: auto_arms,
            tumbled: false,
            tilted_s: [0.0; 2],
            locked: false,
            since_thrust_s: f64::INFINITY,
            low_s: 0.0,
            empty_s: 0.0,
            empty: false,
            watchdog_s: None,
        }
    }

    pub(crate) fn arm(&mut self, arm: bool) {
        self.armed = arm && (self.armed || self.can_be_armed());
    }

    /// A vehicle that tumbled is set upright again; what is locked stays so until a restart.
    pub(crate) fn recover(&mut self) {
        (self.tumbled, self.tilted_s) = (false, [0.0; 2]);
        self.armed = self.auto_arms && !self.locked;
    }

    pub(crate) fn stop_for_good(&mut self) {
        self.locked = true;
    }

    /// From now on the motors stop for good unless this is called again in time.
    pub(crate) fn feed_watchdog(&mut self) {
        self.watchdog_s = Some(0.0);
    }

    pub(crate) fn can_fly(&self) -> bool {
        self.armed && self.can_be_armed()
    }

    fn can_be_armed(&self) -> bool {
        !self.locked && !self.tumbled
    }

    fn is_flying(&self) -> bool {
        self.since_thrust_s < FLYING_S
    }

    /// 0 fine, 3 low, 4 empty, as the firmware numbers the states of its battery.
    pub(crate) fn power_state(&self) -> f64 {
        if self.empty {
            4.0
        } else if self.low_s >= LOW_S {
            3.0
        } else {
            0.0
        }
    }

    pub(crate) fn tick(&mut self, now: &VehicleCondition, limits: &SupervisorLimits, tick_s: f64) {
        self.since_thrust_s = if now.thrust { 0.0 } else { self.since_thrust_s + tick_s };
        let count = |below: bool, sum_s: f64| if below { sum_s + tick_s } else { 0.0 };
        for (tilted_s, (tilt_rad, longest_s)) in self.tilted_s.iter_mut().zip(TUMBLES) {
            *tilted_s = count(now.tilt_rad > tilt_rad, *tilted_s);
            self.tumbled |= limits.tumble && *tilted_s >= longest_s;
        }
        self.tumbled |= limits.tumble && now.collided;
        self.armed &= self.can_be_armed();
        self.low_s = count(now.vbat_v < limits.low_v, self.low_s);
        self.empty_s = count(now.vbat_v < limits.empty_v, self.empty_s);
        self.empty |= self.empty_s >= EMPTY_S;
        self.locked |= self.empty;
        if let Some(since_s) = &mut self.watchdog_s {
            *since_s += tick_s;
            self.locked |= *since_s > EMERGENCY_WATCHDOG_S;
        }
    }

    /// All but the bits of the high-level commander.
    pub(crate) fn info(&self) -> u16 {
        let on = |condition: bool, bit: u16| if condition { bit } else { 0 };
        on(self.can_be_armed(), bit::CAN_BE_ARMED)
            | on(self.armed, bit::IS_ARMED)
            | on(self.auto_arms, bit::IS_AUTO_ARMED)
            | on(self.can_fly(), bit::CAN_FLY)
            | on(self.is_flying(), bit::IS_FLYING)
            | on(self.tumbled, bit::IS_TUMBLED)
            | on(self.locked, bit::IS_LOCKED)
            | on(self.tumbled, bit::IS_CRASHED)
    }
}

const DISARMED: &str = "Disarmed: arm it before it flies";

/// A change of [`Supervisor::info`] in words for people, with the remedy.
pub(crate) fn words(before: u16, after: u16) -> Option<&'static str> {
    let (came, went) = (after & !before, before & !after);
    let told = [
        (
            came & bit::IS_LOCKED,
            "Locked by an emergency stop or an empty battery: restart it, or set sim.reset to 1",
        ),
        (
            came & bit::IS_TUMBLED,
            "Tumbled, motors off: ask for crash recovery; where it touches another vehicle, set sim.reset to 1",
        ),
        (went & bit::IS_LOCKED, "Unlocked"),
        (went & bit::IS_TUMBLED, "Upright again"),
        (came & bit::IS_ARMED, "Armed"),
        (went & bit::IS_ARMED, DISARMED),
        (came & bit::IS_FLYING, "Flying"),
        (went & bit::IS_FLYING, "Not flying"),
    ];
    told.into_iter().find(|(bits, _)| *bits != 0).map(|(_, words)| words)
}

/// A request that the vehicle may refuse: it is told once, with the remedy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Request {
    Flight,
    /// A flight by the high-level commander where `commander.enHighLevel` is 0.
    DisabledFlight,
    /// A thrust before the first one of 0.
    LockedThrust,
    Arming,
    Recovery,
}

impl Request {
    /// Returns why a supervisor with this [`Supervisor::info`] refuses it; nothing if it obeys.
    pub(crate) fn refusal(self, info: u16) -> Option<String> {
        let stopped = info & (bit::IS_LOCKED | bit::IS_TUMBLED);
        let why = words(0, stopped);
        match self {
            Request::DisabledFlight => Some("Flight refused. Set commander.enHighLevel to 1".into()),
            Request::LockedThrust => Some("Thrust refused. Send a thrust of 0 first".into()),
            Request::Flight if info & bit::CAN_FLY != 0 => None,
            Request::Flight => Some(format!("Flight refused. {}", why.unwrap_or(DISARMED))),
            Request::Recovery if stopped == bit::IS_TUMBLED => {
                Some("Crash recovery refused. It touches another vehicle: set sim.reset to 1".into())
            }
            Request::Recovery => why.map(|why| format!("Crash recovery refused. {why}")),
            Request::Arming => why.map(|why| format!("Arming refused. {why}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: SupervisorLimits = SupervisorLimits { low_v: 3.2, empty_v: 3.0, tumble: true };
    const FINE: VehicleCondition =
        VehicleCondition { tilt_rad: 0.0, collided: false, thrust: true, vbat_v: 4.0 };

    #[test]
    fn a_crash_locks_until_recovery_and_an_emergency_for_good() {
        let mut supervisor = Supervisor::new(true);
        supervisor.tick(&FINE, &LIMITS, 0.01);
        assert!(supervisor.can_fly() && supervisor.info() & bit::IS_FLYING != 0);
        supervisor.tick(&VehicleCondition { tilt_rad: 1.2, ..FINE }, &LIMITS, 0.9);
        assert!(supervisor.can_fly(), "a wide turn is no tumble");
        supervisor.tick(&VehicleCondition { tilt_rad: 1.2, ..FINE }, &LIMITS, 0.1);
        assert!(!supervisor.can_fly());
        supervisor.arm(true);
        assert!(!supervisor.can_fly(), "arming does not cure a crash");
        supervisor.recover();
        assert!(supervisor.can_fly());
        supervisor.stop_for_good();
        supervisor.recover();
        assert!(!supervisor.can_fly() && supervisor.info() & bit::CAN_BE_ARMED == 0);
    }

    #[test]
    fn an_empty_battery_and_a_silent_watchdog_lock() {
        let mut supervisor = Supervisor::new(false);
        assert!(!supervisor.can_fly());
        supervisor.arm(true);
        for _ in 0..499 {
            supervisor.tick(&VehicleCondition { vbat_v: 2.9, ..FINE }, &LIMITS, 0.01);
        }
        assert!(supervisor.can_fly() && supervisor.power_state() == 3.0);
        for _ in 0..3 {
            supervisor.tick(&VehicleCondition { vbat_v: 2.9, ..FINE }, &LIMITS, 0.01);
        }
        assert!(!supervisor.can_fly() && supervisor.power_state() == 4.0);
        let mut watched = Supervisor::new(true);
        watched.feed_watchdog();
        (0..110).for_each(|_| watched.tick(&FINE, &LIMITS, 0.01));
        assert!(!watched.can_fly());
    }
}
