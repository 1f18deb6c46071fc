use crazyflie_env::effects::{self, Trace};
use crazyflie_identify::FlightLog;
use crazyflie_identify::case::Case;
use crazyflie_identify::fit::filter::{Belief, Disturbances, Wander, filter};
use crazyflie_identify::fit::flight::{Flight, WINDOW_S};
use crazyflie_identify::fit::hypothesis::{Hypothesis, Term};
use crazyflie_identify::fit::predict::Prediction;
use crazyflie_identify::fit::solve::solve;
use std::path::Path;
use std::time::Instant;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let dir = Path::new("../shared/data/hidden_effects");
    for id in args[1..].iter().filter(|a| !a.contains("=")) {
        let case = Case::read(&dir.join(format!("{id}.json"))).unwrap();
        let model = case.model().unwrap();
        let flights: Vec<Flight> =
            [&case.identify_on, &case.held_out].iter().map(|p| Flight::of("f", &FlightLog::read(p).unwrap(), &model).unwrap()).collect();
        let truth = std::fs::read_to_string(dir.join(format!("{id}.answer.json"))).unwrap();
        println!("{id} {}", &truth.replace('\n', " ").replace("  ", " ")[..truth.len().min(200)]);
        let base = Hypothesis::of(&model);
        let named: Vec<&str> = args.iter().filter_map(|a| a.strip_prefix("with=")).collect();
        let none = Belief::independent(vec![], &[]);
        let mut chosen = base.clone();
        for n in &named {
            let (_, e) = effects::find(n).unwrap();
            let mut t = Term::off(e);
            if *n == "cmd_delay" {
                t.values[0] = 0.02
            }
            if *n == "motor_lag" {
                t.values[0] = 0.03
            }
            chosen = chosen.with(t);
        }
        let windows = flights[0].windows(0, WINDOW_S);
        let p = Prediction { flights: &flights[..1], windows: &windows, hypothesis: &chosen, inflation: 1.0 };
        let s = solve(&p, p.starts(), chosen.shared());
        let cov = s.covariance(&(0..s.shares.len()).collect::<Vec<_>>());
        let sd: Vec<f64> = (0..s.shared.len()).map(|i| cov.as_ref().unwrap()[(i, i)].sqrt()).collect();
        println!("  OE {:?} sd {:?}", s.shared, sd);
        let full = Disturbances {
            force: Wander { sigma: 0.1, tau_s: 1.0 },
            lift: Wander { sigma: 0.03, tau_s: 1.0 },
            torque: Wander { sigma: 0.3, tau_s: 0.3 },
            turn: Wander { sigma: 0.3, tau_s: 1.0 },
            marker: Wander { sigma: 0.002, tau_s: 3.0 },
        };
        let mut d = full;
        let t = Instant::now();
        let ticks = 1500;
        let loss = |d: &Disturbances| filter(&flights[0], ticks, &chosen.at(&s.shared).fixed(), &none, d).map_or(f64::INFINITY, |f| f.loss);
        let mut best = loss(&d);
        println!("  start {best:.1} {:?}", t.elapsed());
        let mut evals = 0;
        for factor in [4.0, 2.0, 1.4] {
            for pass in 0..2 {
                let _ = pass;
                for g in 0..5 {
                    for tau in [false, true] {
                        if tau && factor < 2.0 {
                            continue;
                        }
                        for by in [factor, 1.0 / factor, 0.0] {
                            if tau && by == 0.0 {
                                continue;
                            }
                            loop {
                                let mut trial = d;
                                {
                                    let w = &mut trial.list_mut();
                                    if tau {
                                        if w[g].sigma == 0.0 {
                                            break;
                                        }
                                        w[g].tau_s *= by
                                    } else {
                                        if w[g].sigma == 0.0 && by > 0.0 {
                                            w[g].sigma = full.clone().list_mut()[g].sigma / 4.0
                                        } else {
                                            w[g].sigma *= by
                                        }
                                    }
                                }
                                if trial == d {
                                    break;
                                }
                                let l = loss(&trial);
                                evals += 1;
                                if l < best - 0.5 || (by == 0.0 && l <= best) {
                                    best = l;
                                    d = trial;
                                    if by == 0.0 {
                                        break;
                                    }
                                } else {
                                    break;
                                }
                            }
                        }
                    }
                }
            }
        }
        println!("  {d:?} best {best:.1} evals {evals} {:?}", t.elapsed());
        for (i, f) in flights.iter().enumerate() {
            let a = filter(f, 100000, &chosen.at(&s.shared).fixed(), &none, &d).unwrap();
            println!("  flight {i}: loss per row {:.4} rows {}", a.loss / a.innovations.len() as f64, a.innovations.len());
        }
        if !named.is_empty() {
            let belief = Belief::independent(s.shared.clone(), &sd.iter().map(|s| 10.0 * s).collect::<Vec<_>>());
            let t = Instant::now();
            let f = filter(&flights[0], 100000, &chosen.at(&s.shared), &belief, &d).unwrap();
            println!("   learned {:?} sd {:?} {:?}", f.belief.mean, (0..sd.len()).map(|i| f.belief.sd(i)).collect::<Vec<_>>(), t.elapsed());
        }
        let _ = Trace::Mean;
    }
}
