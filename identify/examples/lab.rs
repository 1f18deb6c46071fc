use crazyflie_env::effects::{self, Trace};
use crazyflie_identify::FlightLog;
use crazyflie_identify::case::Case;
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
        println!("{id} {}", &truth.replace('\n', " ")[..truth.len().min(260)]);
        println!("  tick {} ticks {} noise {:?}", flights[0].tick_s, flights[0].ticks, flights[0].noise);
        let base = Hypothesis::of(&model);
        let run = |h: &Hypothesis, f: usize, shared: Vec<f64>| {
            let windows = flights[f].windows(0, WINDOW_S);
            let p = Prediction { flights: &flights[f..=f], windows: &windows, hypothesis: h, inflation: 1.0 };
            let starts = p.starts();
            solve(&p, starts, shared)
        };
        let t = Instant::now();
        let s0 = run(&base, 0, vec![]);
        let rows: usize = s0.shares.iter().map(|s| s.rows).sum();
        println!("  base loss {:.1} per row {:.4} steps {} {:?}", s0.loss, 2.0 * s0.loss / rows as f64, s0.steps, t.elapsed());
        let b0 = run(&base, 1, vec![]);
        let mut found = Vec::new();
        for entry in effects::registry().iter().filter(|e| e.trace == Trace::Mean) {
            let t = Instant::now();
            let mut term = Term::off(entry);
            if let Some(extra) = args.iter().find_map(|a| a.strip_prefix(&format!("{}=", entry.name))) {
                for (i, v) in extra.split(',').enumerate() {
                    if v != "free" {
                        term.values[i] = v.parse().unwrap();
                    }
                }
            }
            if args.iter().any(|a| a == &format!("{}=free", entry.name)) {
                term.free = (0..term.values.len()).collect();
            }
            let h = base.with(term);
            let s = run(&h, 0, h.shared());
            let fixed = {
                let mut f = h.at(&s.shared);
                for t in &mut f.terms {
                    t.free.clear();
                }
                f
            };
            let b = run(&fixed, 1, vec![]);
            let sd: Vec<f64> = s
                .covariance(&(0..s.shares.len()).collect::<Vec<_>>())
                .map(|c| (0..s.shared.len()).map(|i| c[(i, i)].sqrt()).collect())
                .unwrap_or_default();
            found.push((
                b0.loss - b.loss,
                format!(
                    "{:18} gain fit {:9.1} test {:9.1} {:?} sd {:?} steps {} {} {:?}",
                    entry.name,
                    s0.loss - s.loss,
                    b0.loss - b.loss,
                    s.shared,
                    sd,
                    s.steps,
                    s.converged,
                    t.elapsed()
                ),
            ));
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, line) in found.iter().take(9) {
            println!("  {line}");
        }
    }
}
