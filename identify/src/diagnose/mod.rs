//! Planted faults by hover trim: suspect flights against normal ones, compared by the motors' demand in hover.
//!
//! First [`trim`]: each flight's mean demand of thrust, roll, pitch and yaw. Then [`spread`]: how far normal set-ups
//! differ. Two tests follow: the change of the four numbers together against every fault of [`fault`], whose demand
//! on the motors is simulated ([`demand`]), and the strongest swing ([`swing`]).

pub mod demand;
pub mod fault;
pub mod spread;
pub mod swing;
pub mod trim;

use demand::EffectDemand;
use fault::{Fault, FaultFit, Faults, SmallestFound, TrimChange};
use spread::{NormalSpread, RelativeTrim, SampleSize, mean_of_set_ups, mean_trim, relative_trim};
use swing::{SwingLine, strongest_line};
use trim::{DemandSource, FlightTrim};

use crate::{Error, Result};

/// A change is an alarm if a fault makes it so many times likelier. Set on the even seeds of
/// `tests/diagnosis_rates.rs`, so that 5 % of normal set-ups raise one.
pub const ALARM_ODDS: f64 = 1.5;
/// Chance that flights without a swing raise an alarm. It was 0.02 until the weight of CrazyPAD, in logs cut to every
/// fifth record, passed for a swing at 0.0035.
pub const SWING_RATE: f64 = 0.002;
/// The same where the strongest swing is no peak inside the band: slow changes of a flight have their flank
/// there.
const FLANK_RATE: f64 = 1e-3;
/// A name is listed beside the likeliest one if its chance is at least this share of that one's.
const ALIKE: f64 = 0.1;
/// Fewest normal flights of a diagnosis.
const LEAST_FLIGHTS: usize = 3;
/// Sizes that matter: a share of one motor's thrust, and a payload beside the centre as a share of the weight.
/// Nothing is declared normal if a test could have missed them.
const MATTERS: [f64; 2] = [0.15, 0.15];

/// Flights of one set-up, as compared.
#[derive(Debug, Clone, PartialEq)]
pub struct SetUp {
    /// Folder, with the vehicle if file names identify it; the name of the flight if both are empty.
    pub name: String,
    /// Number of flights, each counted once.
    pub flights: usize,
    /// For a suspect set-up, its change from the normal mean of its vehicle; for a normal one, its difference from
    /// that mean.
    pub change: RelativeTrim,
}

/// Answer for a group of suspect flights.
#[derive(Debug, Clone, PartialEq)]
pub enum DiagnosisVerdict {
    /// Nothing is found, and a fault of a size that matters could have been missed.
    TooFew,
    /// Nothing beyond what set-ups differ by.
    Nothing,
    /// The likeliest fault.
    Fault(FaultFit),
    /// A load that swings on a thread, and no motor is weak.
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
    /// Mean change of the suspects.
    pub change: RelativeTrim,
    /// Standard deviations of that change without a fault.
    pub standard_deviations: [f64; 4],
    /// Their degrees of freedom, with what was known before.
    pub freedom: [f64; 4],
    /// Likelihood of the change with a fault over that without; see [`ALARM_ODDS`].
    pub odds: f64,
    /// Strongest swing of the suspects against the normal flights; `None` for too few flights.
    pub line: Option<SwingLine>,
    /// Answer for all suspect set-ups together.
    pub verdict: DiagnosisVerdict,
    /// Faults that fit about as well as the named one, or that go with a swing.
    pub alternatives: Vec<FaultFit>,
    /// The smallest faults that would have been found.
    pub smallest: SmallestFound,
    /// Alarms among the normal set-ups, each taken as suspect against the others, and how many could be
    /// tried. `None` with one set-up.
    pub normal_alarms: Option<[usize; 2]>,
    /// Flights that are not used, and why.
    pub left_out: Vec<String>,
}

/// Compares suspect flights, all of one condition, with normal ones.
///
/// # Errors
/// [`Error`]: no flights, nothing common to all logs, or one flight on both sides.
pub fn diagnose(
    normal: &[FlightTrim],
    suspect: &[FlightTrim],
    demands: &[EffectDemand],
) -> Result<Diagnosis> {
    for a in normal {
        if let Some(b) = suspect.iter().find(|b| a.is_same_flight(b)) {
            let both = format!("{} and {} are the same flight", a.name, b.name);
            return Error::logs(format!("{both}: normal and suspect flights must differ"));
        }
    }
    let mut left_out = Vec::new();
    let normal = without_copies(normal, &mut left_out);
    let suspect = without_copies(suspect, &mut left_out);
    let by_name = names_tell_vehicles(&normal, &suspect);
    let suspect = if by_name { of_normal_vehicles(&normal, suspect, &mut left_out) } else { suspect };
    for (flights, side) in [(&normal, "normal"), (&suspect, "suspect")] {
        if flights.is_empty() {
            return Error::logs(format!("no flight of the {side} ones has a hover trim"));
        }
    }
    let mut sources = [DemandSource::Request, DemandSource::SquaredVoltage].into_iter();
    let source = sources.find(|s| normal.iter().chain(&suspect).all(|f| f.trim(*s).is_some()));
    let source = source.ok_or_else(|| Error::Logs("no quantity that says what the motors are asked for is in all logs: mixer requests, or motor PWM with battery voltage".to_owned()))?;
    let comparison = TrimComparison { source, by_name, faults: Faults::new(demands) };
    let (mut diagnosis, change) = comparison.compare(&normal, &suspect);
    diagnosis.smallest = comparison.faults.smallest(change.noise, ALARM_ODDS);
    if normal.len() >= LEAST_FLIGHTS {
        diagnosis.judge(comparison.faults.fits(&change));
    }
    diagnosis.normal_alarms = comparison.normal_alarms(&normal);
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

/// Returns whether the beginnings of file names identify vehicles: each flew normally more than once, and at least
/// one is also suspect.
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
    let (kept, foreign): (Vec<_>, Vec<_>) = suspect.into_iter().partition(flew);
    left_out.extend(foreign.iter().map(|f| format!("{} (no normal flight of {})", f.name, f.vehicle)));
    kept
}

/// The settings that all comparisons of a diagnosis share.
struct TrimComparison {
    source: DemandSource,
    /// File names distinguish vehicles.
    by_name: bool,
    faults: Faults,
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

    /// Changes and odds, without a verdict.
    fn compare(&self, normal: &[&FlightTrim], suspect: &[&FlightTrim]) -> (Diagnosis, TrimChange) {
        let (normal_groups, groups) = (self.set_ups(normal), self.set_ups(suspect));
        let trims = |g: &Vec<&FlightTrim>| g.iter().map(|f| self.relative(f)).collect::<Vec<_>>();
        let mut vehicles: Vec<&str> = normal.iter().map(|f| self.vehicle(f)).collect();
        vehicles.sort_unstable();
        vehicles.dedup();
        let of_vehicle =
            |v: &&str| normal_groups.iter().filter(|g| self.vehicle(g[0]) == *v).map(trims).collect();
        let by_vehicle: Vec<Vec<Vec<RelativeTrim>>> = vehicles.iter().map(of_vehicle).collect();
        let middles: Vec<RelativeTrim> = by_vehicle.iter().map(|v| mean_of_set_ups(v)).collect();
        let set_up = |group: &Vec<&FlightTrim>| {
            let at = vehicles.iter().position(|v| *v == self.vehicle(group[0]));
            let (middle, own) = (at.map_or([f64::NAN; 4], |at| middles[at]), mean_trim(&trims(group)));
            let change = std::array::from_fn(|i| own[i] - middle[i]);
            SetUp { name: self.name(group), flights: group.len(), change }
        };
        let suspect_set_ups: Vec<SetUp> = groups.iter().map(set_up).collect();
        // the vehicle with the fewest flights limits the knowledge of a mean
        let sizes = by_vehicle.iter().map(|v| SampleSize::from_groups(v));
        let least = sizes
            .min_by(|a, b| a.set_ups.total_cmp(&b.set_ups).then(b.within_share.total_cmp(&a.within_share)));
        let size = SampleSize::from_groups(&groups);
        let noise = NormalSpread::from_set_ups(&by_vehicle).difference(least.unwrap_or(size), size);
        let by = mean_trim(&suspect_set_ups.iter().map(|s| s.change).collect::<Vec<_>>());
        let spectra = |flights: &[&FlightTrim]| flights.iter().map(|f| f.swing.clone()).collect::<Vec<_>>();
        let change = TrimChange { by, noise };
        let diagnosis = Diagnosis {
            source: self.source,
            normal: normal_groups.iter().map(set_up).collect(),
            suspect: suspect_set_ups,
            change: by,
            standard_deviations: noise.map(|n| n.sd),
            freedom: noise.map(|n| n.freedom),
            odds: self.faults.odds(&change),
            line: strongest_line(&spectra(normal), &spectra(suspect)),
            verdict: DiagnosisVerdict::TooFew,
            alternatives: Vec::new(),
            smallest: SmallestFound { motor_loss: 1.0, beside: 1.0, middle: 1.0 },
            normal_alarms: None,
            left_out: Vec::new(),
        };
        (diagnosis, change)
    }

    /// Each normal set-up as suspect against the others.
    fn normal_alarms(&self, normal: &[&FlightTrim]) -> Option<[usize; 2]> {
        let groups = self.set_ups(normal);
        let mut counts = [0, 0];
        for held in &groups {
            let rest: Vec<&FlightTrim> =
                normal.iter().filter(|f| !held.iter().any(|h| std::ptr::eq(*h, **f))).copied().collect();
            let is_known = rest.iter().any(|f| self.vehicle(f) == self.vehicle(held[0]));
            if is_known && rest.len() >= LEAST_FLIGHTS {
                let is_alarm = self.compare(&rest, held).0.is_alarm();
                counts = [counts[0] + usize::from(is_alarm), counts[1] + 1];
            }
        }
        (counts[1] > 0).then_some(counts)
    }
}

impl Diagnosis {
    /// The change in standard deviations.
    #[must_use]
    pub fn z(&self) -> [f64; 4] {
        std::array::from_fn(|i| self.change[i] / self.standard_deviations[i])
    }

    /// A swing that is no chance.
    fn swing(&self) -> Option<SwingLine> {
        self.line.filter(|l| l.p_value <= if l.is_inside { SWING_RATE } else { FLANK_RATE })
    }

    fn is_alarm(&self) -> bool {
        self.odds >= ALARM_ODDS || self.swing().is_some()
    }

    fn judge(&mut self, mut fits: Vec<FaultFit>) {
        let is_trim = self.odds >= ALARM_ODDS;
        let least = if is_trim { ALIKE * fits[0].chance } else { f64::INFINITY };
        fits.retain(|f| f.chance >= least);
        let first = fits.first().map(|f| &f.fault);
        let could_miss = self.smallest.motor_loss > MATTERS[0] || self.smallest.beside > MATTERS[1];
        self.verdict = match (self.swing(), first) {
            (Some(line), first) if line.is_inside && !matches!(first, Some(Fault::WeakMotors(_))) => {
                let load = self.change[0].exp_m1().max(0.0);
                DiagnosisVerdict::SlungLoad { line, length_m: line.length_m(load) }
            }
            (_, Some(Fault::AddedWeight { .. } | Fault::WeakMotors(_))) => {
                DiagnosisVerdict::Fault(fits.remove(0))
            }
            (Some(_), _) | (_, Some(Fault::Unnamed)) => DiagnosisVerdict::Unnamed,
            (None, None) if could_miss => DiagnosisVerdict::TooFew,
            (None, None) => DiagnosisVerdict::Nothing,
        };
        if self.verdict == DiagnosisVerdict::Unnamed {
            fits.retain(|f| f.fault != Fault::Unnamed);
        }
        self.alternatives = fits;
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
    use super::swing::SwingSpectrum;
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
        let DiagnosisVerdict::Fault(FaultFit { fault: Fault::WeakMotors(weak), stderr, .. }) = found else {
            panic!("{found:?}")
        };
        assert_eq!((weak.len(), weak[0].motor), (1, 2), "{weak:?}");
        assert!((weak[0].loss - 0.16).abs() < 3.0 * stderr && stderr < 0.08, "{weak:?} +- {stderr}");
    }

    #[test]
    fn a_weight_beside_the_centre_is_found_by_roll_alone() {
        let demands = effect_demands(&Model::thesis()).unwrap();
        let mut random = Pcg64::seed_from_u64(11);
        for set_ups_flown in [1, 2, 6] {
            let normal = set_ups(&mut random, "normal", set_ups_flown, [0.0; 4]);
            let heavy = set_up(&mut random, "heavy", 4, [0.05, 0.1, 0.0, 0.0]);
            let found = diagnose(&normal, &heavy, &demands).unwrap();
            assert!(
                matches!(&found.verdict, DiagnosisVerdict::Fault(f) if matches!(f.fault, Fault::AddedWeight { .. })),
                "{set_ups_flown}: {found:?}"
            );
        }
    }

    #[test]
    fn many_standard_deviations_in_one_number_are_never_nothing() {
        let demands = effect_demands(&Model::thesis()).unwrap();
        let mut random = Pcg64::seed_from_u64(12);
        let normal = set_ups(&mut random, "normal", 2, [0.0; 4]);
        for axis in 0..4 {
            let by = std::array::from_fn(|i| if i == axis { 0.2 } else { 0.0 });
            let found = diagnose(&normal, &set_up(&mut random, "odd", 4, by), &demands).unwrap();
            assert!(found.is_alarm(), "{axis}: {found:?}");
        }
    }

    #[test]
    fn nothing_is_said_to_be_normal_where_a_fault_could_be_missed() {
        let demands = effect_demands(&Model::thesis()).unwrap();
        let mut random = Pcg64::seed_from_u64(13);
        let suspect = set_up(&mut random, "suspect", 1, [0.0; 4]);
        let smallest = [1, 2, 6].map(|count| {
            let normal = set_ups(&mut random, "normal", count, [0.0; 4]);
            let found = diagnose(&normal, &suspect, &demands).unwrap();
            let could_miss = found.smallest.motor_loss > MATTERS[0] || found.smallest.beside > MATTERS[1];
            assert_eq!(found.verdict == DiagnosisVerdict::TooFew, could_miss, "{found:?}");
            found.smallest.beside
        });
        // more normal flights find less
        assert!(smallest[2] < smallest[1] && smallest[1] < smallest[0], "{smallest:?}");
        let two = set_up(&mut random, "two", 2, [0.0; 4]);
        assert_eq!(diagnose(&two, &suspect, &demands).unwrap().verdict, DiagnosisVerdict::TooFew);
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
