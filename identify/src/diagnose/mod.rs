//! Planted faults by hover trim: suspect flights against normal ones, compared by what hovering asks of the
//! motors.
//!
//! First [`trim`]: each flight's mean demand of thrust, roll, pitch and yaw. Then [`spread`]: how far normal
//! set-ups differ. One test follows whether the suspects differ by more: of the thrust, the yaw and the
//! strongest swing ([`swing`]), times three for the three looks. Roll and pitch are not tested: a battery put
//! in askew moves them. Only after an alarm, [`fault`]: which fault asks the same of the motors ([`demand`]).

pub mod demand;
pub mod fault;
pub mod spread;
pub mod swing;
pub mod trim;

use statrs::distribution::{ChiSquared, ContinuousCDF};
use thiserror::Error;

use demand::EffectDemand;
use fault::{FaultFit, TrimChange, fit_faults};
use spread::{NormalSpread, RelativeTrim, SampleSize, mean_trim, relative_trim};
use swing::{SwingLine, SwingSpectrum, strongest_line};
use trim::{DemandSource, FlightTrim};

/// Chance that flights without a fault raise an alarm.
pub const ALARM_RATE: f64 = 0.05;
/// Thrust, yaw and swing are looked at.
const LOOKS: f64 = 3.0;
/// A fault that leaves a misfit of less than this chance does not describe the change.
const UNFIT: f64 = 0.01;
/// Faults whose criteria differ by less cannot be told apart (Burnham and Anderson 2002: substantial support
/// within 2).
const ALIKE: f64 = 2.0;
/// Degrees of freedom below which a spread is hardly known: the 5 % bound of Student's t is above 4.
const LEAST_FREEDOM: f64 = 2.0;

/// Reason why nothing can be compared.
#[derive(Debug, Error, PartialEq)]
#[allow(missing_docs, reason = "each variant's message says what went wrong")]
pub enum DiagnoseError {
    #[error("no flight of the {0} ones has a hover trim")]
    NoFlights(&'static str),
    #[error(
        "no quantity that says what the motors are asked for is in all logs: mixer requests, or motor PWM with battery voltage"
    )]
    NoCommonSource,
    #[error("{normal} and {suspect} are the same flight: normal and suspect flights must differ")]
    SameFlight { normal: String, suspect: String },
}

/// Flights of one set-up, as compared.
#[derive(Debug, Clone, PartialEq)]
pub struct SetUp {
    /// Folder, with the vehicle where file names tell it; the name of the flight where both are empty.
    pub name: String,
    /// Number of flights, each counted once.
    pub flights: usize,
    /// Of a suspect set-up its change against the normal mean of its vehicle; of a normal one the same.
    pub change: RelativeTrim,
    /// The named fault fitted to this set-up alone.
    pub fault: Option<FaultFit>,
}

/// Answer for a group of suspect flights.
#[derive(Debug, Clone, PartialEq)]
pub enum DiagnosisVerdict {
    /// The normal flights are too few to say how far set-ups differ.
    TooFew {
        /// Degrees of freedom of the spread: the fewer of those of thrust and of yaw.
        freedom: f64,
    },
    /// Nothing beyond what set-ups differ by.
    Nothing,
    /// A fault that asks the motors for such a change.
    Fault(FaultFit),
    /// A load that swings on a thread: the swing raises an alarm and yaw does not.
    SlungLoad {
        /// Line of the swing in the spectrum of the roll and pitch demands.
        line: SwingLine,
        /// Length of the thread, see [`SwingLine::length_m`].
        length_m: f64,
    },
    /// Something that cannot be named.
    Unnamed,
}

/// The result of a diagnosis.
#[derive(Debug, Clone)]
pub struct Diagnosis {
    /// Quantity by which all flights were compared.
    pub source: DemandSource,
    /// Normal set-ups, in order of appearance.
    pub normal: Vec<SetUp>,
    /// Suspect set-ups, in order of appearance.
    pub suspect: Vec<SetUp>,
    /// Standard deviations of a flight of a new normal set-up, and their degrees of freedom.
    pub standard_deviations: [f64; 4],
    /// Degrees of freedom of thrust, roll, pitch and yaw; 0 where the spread is unknown.
    pub freedom: [f64; 4],
    /// Mean change of the suspects, and in its standard deviations.
    pub change: RelativeTrim,
    /// [`Diagnosis::change`] over its standard deviations; NaN where the spread is unknown.
    pub z: [f64; 4],
    /// Chances of the change of thrust, of that of yaw and of the swing, each times the number of looks.
    pub p_values: [f64; 3],
    /// Strongest swing of the suspects against the normal flights; `None` for too few flights.
    pub line: Option<SwingLine>,
    /// Answer for all suspect set-ups together.
    pub verdict: DiagnosisVerdict,
    /// Faults that do as well as the named one.
    pub alternatives: Vec<FaultFit>,
    /// Alarms among the normal set-ups, each taken as suspect against the others, and how many could be
    /// tried. `None` with one set-up.
    pub normal_alarms: Option<[usize; 2]>,
    /// Flights that are not used, and why.
    pub left_out: Vec<String>,
}

/// Compares suspect flights, all of one condition, with normal ones.
///
/// # Errors
/// [`DiagnoseError`]: no flights, nothing common to all logs, or one flight on both sides.
pub fn diagnose(
    normal: &[FlightTrim],
    suspect: &[FlightTrim],
    demands: &[EffectDemand],
) -> Result<Diagnosis, DiagnoseError> {
    for a in normal {
        if let Some(b) = suspect.iter().find(|b| a.is_same_flight(b)) {
            return Err(DiagnoseError::SameFlight { normal: a.name.clone(), suspect: b.name.clone() });
        }
    }
    let mut left_out = Vec::new();
    let normal = without_copies(normal, &mut left_out);
    let suspect = without_copies(suspect, &mut left_out);
    let by_name = names_tell_vehicles(&normal, &suspect);
    let suspect = if by_name { of_normal_vehicles(&normal, suspect, &mut left_out) } else { suspect };
    for (flights, side) in [(&normal, "normal"), (&suspect, "suspect")] {
        if flights.is_empty() {
            return Err(DiagnoseError::NoFlights(side));
        }
    }
    let mut sources = [DemandSource::Request, DemandSource::SquaredVoltage].into_iter();
    let source = sources.find(|s| normal.iter().chain(&suspect).all(|f| f.trim(*s).is_some()));
    let comparison = TrimComparison { source: source.ok_or(DiagnoseError::NoCommonSource)?, by_name };
    let mut diagnosis = comparison.diagnose(&normal, &suspect, demands);
    diagnosis.normal_alarms = comparison.normal_alarms(&normal, demands);
    diagnosis.left_out = left_out;
    Ok(diagnosis)
}

fn without_copies<'a>(flights: &'a [FlightTrim], left_out: &mut Vec<String>) -> Vec<&'a FlightTrim> {
    let mut kept: Vec<&FlightTrim> = Vec::new();
    for flight in flights {
        match kept.iter().find(|k| k.is_same_flight(flight)) {
            Some(first) => left_out.push(format!("{} (the same flight as {})", flight.name, first.name)),
            None => kept.push(flight),
        }
    }
    kept
}

/// Whether the beginnings of file names are those of vehicles: each flew normally more than once, and one at
/// least is suspect too.
fn names_tell_vehicles(normal: &[&FlightTrim], suspect: &[&FlightTrim]) -> bool {
    let flights = |vehicle: &str| normal.iter().filter(|n| n.vehicle == vehicle).count();
    let is_known = normal.iter().all(|n| !n.vehicle.is_empty() && flights(&n.vehicle) > 1);
    is_known && suspect.iter().any(|s| flights(&s.vehicle) > 0)
}

/// Suspects whose vehicle, by its name, flew normally too.
fn of_normal_vehicles<'a>(
    normal: &[&FlightTrim],
    suspect: Vec<&'a FlightTrim>,
    left_out: &mut Vec<String>,
) -> Vec<&'a FlightTrim> {
    let flew = |s: &&FlightTrim| normal.iter().any(|n| n.vehicle == s.vehicle);
    let (kept, foreign): (Vec<&FlightTrim>, Vec<&FlightTrim>) = suspect.into_iter().partition(flew);
    left_out.extend(foreign.iter().map(|f| format!("{} (no normal flight of {})", f.name, f.vehicle)));
    kept
}

/// The settings that all comparisons of a diagnosis share.
#[derive(Clone, Copy)]
struct TrimComparison {
    source: DemandSource,
    /// Whether file names tell vehicles apart.
    by_name: bool,
}

impl TrimComparison {
    fn vehicle<'a>(&self, flight: &'a FlightTrim) -> &'a str {
        if self.by_name { &flight.vehicle } else { "" }
    }

    fn relative(&self, flight: &FlightTrim) -> RelativeTrim {
        flight.trim(self.source).map_or([f64::NAN; 4], |t| relative_trim(&t))
    }

    /// Flights grouped by folder and vehicle, in order of appearance.
    fn set_ups<'a>(&self, flights: &[&'a FlightTrim]) -> Vec<Vec<&'a FlightTrim>> {
        let mut groups: Vec<Vec<&FlightTrim>> = Vec::new();
        for flight in flights {
            let same = |g: &&mut Vec<&FlightTrim>| {
                g[0].folder == flight.folder && self.vehicle(g[0]) == self.vehicle(flight)
            };
            match groups.iter_mut().find(same) {
                Some(group) => group.push(flight),
                None => groups.push(vec![flight]),
            }
        }
        groups
    }

    fn name(&self, set_up: &[&FlightTrim]) -> String {
        let first = set_up[0];
        let name =
            if self.by_name { format!("{} {}", first.folder, first.vehicle) } else { first.folder.clone() };
        if name.is_empty() { first.name.clone() } else { name }
    }

    fn diagnose(
        &self,
        normal: &[&FlightTrim],
        suspect: &[&FlightTrim],
        demands: &[EffectDemand],
    ) -> Diagnosis {
        let (normal_groups, groups) = (self.set_ups(normal), self.set_ups(suspect));
        let trims = |g: &[&FlightTrim]| g.iter().map(|f| self.relative(f)).collect::<Vec<_>>();
        let mut vehicles: Vec<&str> = normal.iter().map(|f| self.vehicle(f)).collect();
        vehicles.sort_unstable();
        vehicles.dedup();
        let by_vehicle: Vec<Vec<Vec<RelativeTrim>>> = vehicles
            .iter()
            .map(|v| normal_groups.iter().filter(|g| self.vehicle(g[0]) == *v).map(|g| trims(g)).collect())
            .collect();
        let means: Vec<RelativeTrim> = by_vehicle.iter().map(|v| mean_trim(&v.concat())).collect();
        let change_of = |group: &Vec<&FlightTrim>| {
            let middle = vehicles
                .iter()
                .position(|v| *v == self.vehicle(group[0]))
                .map_or([f64::NAN; 4], |at| means[at]);
            let own = mean_trim(&trims(group));
            std::array::from_fn(|i| own[i] - middle[i])
        };
        let set_up = |group: &Vec<&FlightTrim>| SetUp {
            name: self.name(group),
            flights: group.len(),
            change: change_of(group),
            fault: None,
        };
        let mut diagnosis = Diagnosis {
            source: self.source,
            normal: normal_groups.iter().map(set_up).collect(),
            suspect: groups.iter().map(set_up).collect(),
            standard_deviations: [f64::NAN; 4],
            freedom: [0.0; 4],
            change: mean_trim(&groups.iter().map(change_of).collect::<Vec<_>>()),
            z: [f64::NAN; 4],
            p_values: [1.0; 3],
            line: None,
            verdict: DiagnosisVerdict::TooFew { freedom: 0.0 },
            alternatives: Vec::new(),
            normal_alarms: None,
            left_out: Vec::new(),
        };
        if let Some(spread) = NormalSpread::from_set_ups(&by_vehicle) {
            let spectra = |flights: &[&FlightTrim]| {
                flights.iter().map(|f| f.swing.clone()).collect::<Vec<SwingSpectrum>>()
            };
            let (a, b) = (spectra(normal), spectra(suspect));
            diagnosis.line = strongest_line(&a.iter().collect::<Vec<_>>(), &b.iter().collect::<Vec<_>>());
            // as well known as the mean of the vehicle that flew least
            let size = by_vehicle.iter().map(|v| SampleSize::from_groups(v)).min_by_key(|s| s.flights);
            if let Some(size) = size {
                diagnosis.judge(&spread, size, demands);
            }
        }
        diagnosis
    }

    /// Each normal set-up as suspect against the others.
    fn normal_alarms(&self, normal: &[&FlightTrim], demands: &[EffectDemand]) -> Option<[usize; 2]> {
        let groups = self.set_ups(normal);
        let mut counts = [0, 0];
        for held in &groups {
            let rest: Vec<&FlightTrim> =
                normal.iter().filter(|f| !held.iter().any(|h| std::ptr::eq(*h, **f))).copied().collect();
            if !rest.iter().any(|f| self.vehicle(f) == self.vehicle(held[0])) {
                continue;
            }
            match self.diagnose(&rest, held, demands).verdict {
                DiagnosisVerdict::TooFew { .. } => {}
                DiagnosisVerdict::Nothing => counts[1] += 1,
                _ => counts = [counts[0] + 1, counts[1] + 1],
            }
        }
        (counts[1] > 0).then_some(counts)
    }
}

impl Diagnosis {
    fn judge(&mut self, spread: &NormalSpread, normal: SampleSize, demands: &[EffectDemand]) {
        self.standard_deviations = spread.standard_deviations();
        self.freedom = spread.freedom();
        let variances = spread.difference_variances(normal, self.suspect.len());
        self.z = std::array::from_fn(|i| self.change[i] / variances[i].sqrt());
        let least = self.freedom[0].min(self.freedom[3]);
        if least < LEAST_FREEDOM {
            self.verdict = DiagnosisVerdict::TooFew { freedom: least };
            return;
        }
        let swing = self.line.map_or(1.0, |l| l.p_value);
        self.p_values =
            [spread.chance(0, self.z[0]), spread.chance(3, self.z[3]), swing].map(|p| (LOOKS * p).min(1.0));
        if self.p_values.iter().all(|p| *p > ALARM_RATE) {
            self.verdict = DiagnosisVerdict::Nothing;
            return;
        }
        let fits = fit_faults(&TrimChange { by: self.change, variances }, demands);
        let is_fit = |f: &&FaultFit| ChiSquared::new(1.0).is_ok_and(|chi| 1.0 - chi.cdf(f.misfit) > UNFIT);
        let steady_is_normal = self.p_values[..2].iter().all(|p| *p > ALARM_RATE);
        self.verdict = match (self.line, fits.iter().find(is_fit)) {
            (Some(line), _) if self.p_values[2] <= ALARM_RATE && self.p_values[1] > ALARM_RATE => {
                let load = self.change[0].exp_m1().max(0.0);
                DiagnosisVerdict::SlungLoad { line, length_m: line.length_m(load) }
            }
            (_, Some(best)) if !steady_is_normal => DiagnosisVerdict::Fault(best.clone()),
            _ => DiagnosisVerdict::Unnamed,
        };
        let DiagnosisVerdict::Fault(named) = &self.verdict else { return };
        let named = named.clone();
        self.alternatives =
            fits.into_iter().filter(|f| *f != named && f.criterion < named.criterion + ALIKE).collect();
        let alone = spread.difference_variances(normal, 1);
        for set_up in &mut self.suspect {
            let fits = fit_faults(&TrimChange { by: set_up.change, variances: alone }, demands);
            set_up.fault = fits.into_iter().find(|f| is_same_kind(&f.fault, &named.fault));
        }
    }
}

fn is_same_kind(a: &fault::Fault, b: &fault::Fault) -> bool {
    use fault::Fault::{AddedWeight, WeakMotor};
    match (a, b) {
        (AddedWeight { .. }, AddedWeight { .. }) => true,
        (WeakMotor { motor: a, .. }, WeakMotor { motor: b, .. }) => a == b,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use crazyflie_env::model::Model;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;

    use super::demand::effect_demands;
    use super::fault::{Fault, side_of};
    use super::trim::Trim;
    use super::*;

    /// Flights of one set-up: what it has of its own and what each flight has, in shares of the thrust.
    fn set_up(random: &mut Pcg64, folder: &str, flights: usize, by: [f64; 4]) -> Vec<FlightTrim> {
        let mut draw = |sd: f64| Normal::new(0.0, sd).unwrap().sample(random);
        let own: [f64; 4] = [0.01, 0.015, 0.015, 0.01].map(&mut draw);
        let flight = |number: usize| {
            let [thrust, roll, pitch, yaw]: [f64; 4] = std::array::from_fn(|i| by[i] + own[i] + draw(0.003));
            FlightTrim {
                name: format!("{folder}/{number}"),
                folder: folder.to_owned(),
                vehicle: String::new(),
                steady_s: 10.0,
                request: Some(Trim { thrust: 40_000.0 * thrust.exp(), shares: [roll, pitch, 0.1 + yaw] }),
                squared_voltage: None,
                swing: SwingSpectrum::default(),
            }
        };
        (0..flights).map(flight).collect()
    }

    fn set_ups(random: &mut Pcg64, kind: &str, count: usize, by: [f64; 4]) -> Vec<FlightTrim> {
        (0..count).flat_map(|i| set_up(random, &format!("{kind} {i}"), 3, by)).collect()
    }

    #[test]
    fn a_vehicle_without_a_fault_seldom_raises_an_alarm() {
        let demands = effect_demands(&Model::thesis()).unwrap();
        let mut alarms = 0;
        for seed in 0..400 {
            let mut random = Pcg64::seed_from_u64(seed);
            let normal = set_ups(&mut random, "normal", 5, [0.0; 4]);
            let suspect = set_ups(&mut random, "suspect", 1, [0.0; 4]);
            alarms += usize::from(
                diagnose(&normal, &suspect, &demands).unwrap().verdict != DiagnosisVerdict::Nothing,
            );
        }
        // 5 % of 400 are 20, with a standard deviation of 4.4; thrust and yaw are two of the three looks
        assert!((2..=29).contains(&alarms), "{alarms} of 400");
    }

    #[test]
    fn faults_are_named_with_their_size() {
        let demands = effect_demands(&Model::thesis()).unwrap();
        let mut random = Pcg64::seed_from_u64(3);
        let normal = set_ups(&mut random, "normal", 6, [0.0; 4]);
        // 8 % more thrust, to the back left
        let heavy = set_ups(&mut random, "heavy", 2, [0.077, 0.07, -0.07, 0.0]);
        let DiagnosisVerdict::Fault(FaultFit {
            fault: Fault::AddedWeight { mass_kg, left, front },
            stderr,
            ..
        }) = diagnose(&normal, &heavy, &demands).unwrap().verdict
        else {
            panic!("no weight")
        };
        let truth_kg = 0.08 * Model::thesis().parameter("vehicle.mass").unwrap();
        assert!(
            (mass_kg - truth_kg).abs() < 3.0 * stderr && stderr < 0.3 * truth_kg,
            "{mass_kg} +- {stderr} for {truth_kg}"
        );
        assert_eq!(side_of(left, front), Some("towards M3 (back left)"));
        // motor 2 lost 16 %: a quarter of it in thrust, and more in yaw
        let weak = set_ups(&mut random, "weak", 2, [0.04, -0.04, -0.04, -0.065]);
        let found = diagnose(&normal, &weak, &demands).unwrap().verdict;
        let DiagnosisVerdict::Fault(FaultFit { fault: Fault::WeakMotor { motor: 2, loss }, stderr, .. }) =
            found
        else {
            panic!("{found:?}")
        };
        assert!((loss - 0.16).abs() < 3.0 * stderr && stderr < 0.08, "{loss} +- {stderr}");
    }

    #[test]
    fn what_no_effect_asks_for_has_no_name() {
        let demands = effect_demands(&Model::thesis()).unwrap();
        let mut random = Pcg64::seed_from_u64(5);
        let normal = set_ups(&mut random, "normal", 6, [0.0; 4]);
        // less thrust than normal, and much yaw
        let odd = set_ups(&mut random, "odd", 2, [-0.15, 0.0, 0.0, 0.2]);
        assert_eq!(diagnose(&normal, &odd, &demands).unwrap().verdict, DiagnosisVerdict::Unnamed);
    }

    #[test]
    fn names_tell_vehicles_only_where_they_can() {
        let demands = effect_demands(&Model::thesis()).unwrap();
        let mut random = Pcg64::seed_from_u64(7);
        let named = |mut flights: Vec<FlightTrim>, vehicle: &str| {
            flights.iter_mut().for_each(|f| f.vehicle = vehicle.to_owned());
            flights
        };
        let normal = named(set_ups(&mut random, "normal", 4, [0.0; 4]), "E8");
        let mut suspect = named(set_ups(&mut random, "suspect", 2, [0.0; 4]), "E8");
        suspect.extend(named(set_up(&mut random, "suspect", 1, [0.5, 0.0, 0.0, 0.0]), "E9"));
        let found = diagnose(&normal, &suspect, &demands).unwrap();
        assert_eq!((found.verdict, found.left_out.len()), (DiagnosisVerdict::Nothing, 1));
        // nobody of that name flew normally: names say nothing, and all are compared
        let other = named(set_ups(&mut random, "other", 1, [0.0; 4]), "test");
        assert_eq!(diagnose(&normal, &other, &demands).unwrap().left_out.len(), 0);
    }
}
