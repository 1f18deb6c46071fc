//! `crazyflie demo`: the page with a running flight, and what to do next.

use std::io::Write;

use serde_json::json;
use tokio::net::TcpListener;

use super::serve::stop_signal;
use super::{Failure, Outcome};
use crazyflie_server::serve::{Service, Settings};

/// Commands to try after the page, and the purpose of each.
const NEXT_STEPS: &[(&str, &str)] = &[
    (
        "crazyflie fly --task fly-80cm --sensors lab --picture flight.svg",
        "fly the thesis's 80 cm flight and draw it",
    ),
    (
        "python -c \"import gymnasium, crazyflie_gym; print(gymnasium.make('Crazyflie-v0').reset(seed=1))\"",
        "the same vehicle in Python",
    ),
    #[cfg(feature = "bench")]
    ("crazyflie bench submit --controller lqr --scenario hover-aruco", "enter a controller in the benchmark"),
];

/// Open the page with a running flight, and print what to try next.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Port on this machine; 0 for any
    #[arg(long, default_value_t = 0, value_name = "PORT")]
    port: u16,
    /// Do not open a browser: print the address alone
    #[arg(long)]
    no_browser: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let settings = Settings::default();
    #[cfg(feature = "bench")]
    let settings = Settings {
        extension: Some(crazyflie_bench::serve::Benchmark::extension(crazyflie_bench::Bench::in_memory()?)),
        ..settings
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        let address = ("127.0.0.1", args.port);
        let listener = TcpListener::bind(address)
            .await
            .map_err(|e| Failure::about(format!("127.0.0.1:{}", args.port), e))?;
        let service = Service::open(listener, settings).map_err(|e| Failure::Failed(e.to_string()))?;
        let url = format!("http://{}", service.address());
        tell(&url, args, out)?;
        if !args.no_browser && open::that_detached(&url).is_err() && !args.json {
            writeln!(out, "no browser could be opened here: open the address by hand")?;
            out.flush()?;
        }
        service.run(stop_signal()?).await;
        Ok::<_, Failure>(())
    })?;
    runtime.shutdown_background();
    Ok(())
}

fn tell(url: &str, args: &Args, out: &mut dyn Write) -> Outcome {
    if args.json {
        let step = |(command, about): &(&str, &str)| json!({"command": command, "about": about});
        let steps: Vec<_> = NEXT_STEPS.iter().map(step).collect();
        writeln!(out, "{}", json!({"url": url, "next_steps": steps}))?;
    } else {
        writeln!(
            out,
            "the page with a running flight: {url} (Ctrl-C ends it)\n\nnext, in another terminal:"
        )?;
        NEXT_STEPS.iter().try_for_each(|(command, about)| writeln!(out, "  {command}\n      {about}"))?;
    }
    Ok(out.flush()?)
}
