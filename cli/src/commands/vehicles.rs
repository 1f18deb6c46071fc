//! `crazyflie vehicles`: the vehicles that have a name.

use std::io::Write;

use crazyflie_env::model::VehicleSummary;

use super::{Outcome, write_json};

/// List the vehicles by name: mass, source, and which numbers were identified.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let all = VehicleSummary::of_all()?;
    if args.json {
        return write_json(&all, out);
    }
    for each in &all {
        writeln!(out, "{}\n    {}", each.name, each.about)?;
        let (mass_g, arm_mm) = (1e3 * each.mass_kg, 1e3 * each.arm_m);
        let forms: Vec<&str> = each.verticals.iter().map(|form| form.name()).collect();
        let (form, forms) = (each.vertical.name(), forms.join(", "));
        writeln!(
            out,
            "    {mass_g:.1} g, {arm_mm:.0} mm to a motor; vertical forms {forms}, {form} by default"
        )?;
        let listed = |parts: &[String]| if parts.is_empty() { "nothing".into() } else { parts.join(", ") };
        writeln!(out, "    identified in flights: {}", listed(&each.identified))?;
        writeln!(out, "    partly or all from data sheets and elsewhere: {}", listed(&each.stated))?;
    }
    Ok(())
}
