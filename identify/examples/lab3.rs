use crazyflie_identify::FlightLog;
use crazyflie_identify::case::Case;
use crazyflie_identify::explain::search::Search;
use crazyflie_identify::fit::flight::Flight;
use crazyflie_identify::fit::hypothesis::Hypothesis;
use std::path::Path;
use std::time::Instant;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let dir = Path::new("../shared/data/hidden_effects");
    for id in args[1..].iter() {
        let case = Case::read(&dir.join(format!("{id}.json"))).unwrap();
        let model = case.model().unwrap();
        let flights: Vec<Flight> =
            [&case.identify_on, &case.held_out].iter().map(|p| Flight::of("f", &FlightLog::read(p).unwrap(), &model).unwrap()).collect();
        let truth: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(dir.join(format!("{id}.answer.json"))).unwrap()).unwrap();
        println!("{id} {} {} {} noise {} {}", truth["group"], truth["tier"], truth["effects"], truth["noise"], truth["excitation"]);
        let t = Instant::now();
        let search = Search::new(&flights[..1]);
        let declared = search.declared(&Hypothesis::of(&model)).unwrap();
        println!("  declared {:.1} {:?} {:?}", declared.loss, declared.disturbances, t.elapsed());
        let path = search.forward(declared, &|s| println!("    {s} {:?}", t.elapsed()));
        let last = search.backward(path.last().unwrap().clone(), 8.0);
        let test = Search::new(&flights[1..]);
        println!(
            "  final {:?} sd {:?} {:?}",
            last.settled().terms,
            (0..last.belief.mean.len()).map(|i| last.belief.sd(i)).collect::<Vec<_>>(),
            t.elapsed()
        );
        println!("  {:?}", last.disturbances);
        let full = test.plug_in(&last.settled(), &last.disturbances).unwrap();
        for term in &last.hypothesis.terms {
            let r = search.reduced(&last, term.entry.name).unwrap();
            println!(
                "    {} worth fit {:.1} test {:.1} rivals {:?}",
                term.entry.name,
                r.loss - last.loss,
                test.plug_in(&r.settled(), &r.disturbances).unwrap() - full,
                search.rivals(&last, term.entry.name, 5.0)
            );
        }
        for g in 0..5 {
            let mut d = last.disturbances;
            if d.list_mut()[g].sigma == 0.0 {
                continue;
            }
            d.list_mut()[g].sigma = 0.0;
            println!(
                "    without {} fit {:.1} test {:.1}",
                ["force", "lift", "torque", "turn", "marker"][g],
                search.plug_in(&last.settled(), &d).unwrap_or(f64::NAN) - last.plug_in,
                test.plug_in(&last.settled(), &d).unwrap_or(f64::NAN) - full
            );
        }
        println!("  per row fit {:.4} test {:.4}", last.plug_in / 23289.0, full / 23289.0);
        println!("  time {:?}", t.elapsed());
    }
}
