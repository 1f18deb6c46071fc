//! Properties of an effect for fits and searches.

/// Signals that can drift.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GaussMarkovSignal {
    /// A horizontal force.
    Force,
    /// The marker's position.
    Marker,
}

/// Visibility of an effect in the log of a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Observability {
    /// It changes what is expected.
    Deterministic,
    /// It changes the expectation, and oscillates at a frequency of its own: a periodic force may pass for it.
    Resonant,
    /// It repeats the command before with a probability, its first parameter, and in bursts by its second: it changes
    /// the expectation, and the deviation of commands from it.
    HeldCommand,
    /// It is random: it changes how far off the expectation is.
    Variance,
    /// It is random and slow, a first-order Gauss-Markov process on this; its parameters are standard
    /// deviation and correlation time.
    GaussMarkov(GaussMarkovSignal),
    /// It decides what is seen at all.
    Visibility,
    /// It changes what is expected from a time on, at a frequency or beyond a limit of its own. Off, it has
    /// no slope: a search cannot find it from there, but has to read from the residuals where to begin.
    Located,
    /// It is of one session of measurements, not of a vehicle: fits estimate it beside, and a search does not
    /// name it.
    Session,
    /// It is what the declared form leaves out of dynamics of a higher order. A search does not name it, and uses it
    /// in place of declared numbers that represent a delay.
    HigherOrder,
    /// It describes what no other effect explains, and names no cause.
    Surrogate,
    /// It needs other drones: the log of one flight does not show it.
    Neighbours,
}

impl Observability {
    /// Returns whether the expectation of a flight depends on the effect, and a search can begin with it off.
    pub fn is_expected(self) -> bool {
        matches!(self, Observability::Deterministic | Observability::Resonant | Observability::HeldCommand)
    }

    /// Returns whether the expectation of a flight depends on the effect.
    pub fn shapes_mean(self) -> bool {
        self.is_expected()
            || matches!(self, Observability::Located | Observability::Session | Observability::HigherOrder)
    }
}

/// Occurrence of an effect on real vehicles under a thrust command, for which `identify` fits it beside the numbers
/// of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ubiquity {
    /// Some do.
    Some,
    /// All do.
    All,
    /// All do, and a log with the battery's voltage determines its size.
    AllWithVoltage,
    /// All do, slowly: its size takes several such logs.
    AllSlowly,
}

/// The part of an effect that differs between flights of one vehicle, with its standard deviation over flights before
/// any was seen, in the unit of the parameters. `identify` estimates it beside the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FlightSpread {
    /// Nothing: it belongs to the vehicle.
    None,
    /// Roll and pitch at which the vehicle flies under a level command.
    Lean(f64),
    /// Roll and pitch of the frame in which the attitude is measured.
    Frame(f64),
    /// The thrust, its first parameter: batteries and repairs.
    Thrust(f64),
}

impl FlightSpread {
    /// The standard deviation, where flights differ.
    pub fn sd(self) -> Option<f64> {
        match self {
            FlightSpread::None => None,
            FlightSpread::Lean(sd) | FlightSpread::Frame(sd) | FlightSpread::Thrust(sd) => Some(sd),
        }
    }

    /// Causes of a value that all flights of a vehicle share, in words. Such flights do not separate them.
    pub fn shared_causes(self) -> &'static str {
        match self {
            FlightSpread::None => "",
            FlightSpread::Lean(_) => "a shifted centre of mass, a tilted IMU or a steady wind",
            FlightSpread::Frame(_) => "a tilted marker frame or a steady wind",
            FlightSpread::Thrust(_) => "another weight, other motors or another battery voltage",
        }
    }
}

/// The share of the exact geometry of a tilted, turning vehicle that an effect adds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Geometry {
    /// Nothing: it is a trait of one vehicle.
    None,
    /// One term of it.
    Part,
    /// All of it: a model form in which no `Part` is needed.
    Whole,
}
