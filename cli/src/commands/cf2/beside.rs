//! Simulated Crazyflies beside the environments of `crazyflie serve`.

use std::io::Write;

use clap::{Args as _, FromArgMatches as _};
use crazyflie_crtp::Server;
use crazyflie_server::serve::{Report, Service};
use tokio_util::sync::CancellationToken;

use super::{Args, announce, page, settings};
use crate::commands::serve::stop_signal;
use crate::failure::{Failure, Outcome};

/// The drones that a server has.
#[derive(Debug, clap::Args)]
pub(crate) struct Beside {
    /// Simulate so many Crazyflies for cflib scripts beside it, from UDP port 19850 of this machine on; the page
    /// shows them as the session cf2 (`crazyflie cf2 --page` has more options)
    #[arg(long, num_args = 0..=1, default_missing_value = "1", value_parser = clap::value_parser!(u16).range(1..=100), value_name = "N")]
    crtp: Option<u16>,
    /// UDP port of the first of them, the others follow; 0 for any
    #[arg(long, default_value_t = 19850, requires = "crtp", value_name = "PORT")]
    crtp_port: u16,
}

impl Beside {
    /// Serves, and flies the drones, until the program is stopped.
    pub(crate) async fn serve(&self, service: Service, out: &mut dyn Write) -> Outcome<Report> {
        let Some(drones) = self.crtp else {
            return Ok(service.run(stop_signal()?).await);
        };
        // the defaults are those of `crazyflie cf2`
        let words = ["cf2".to_owned(), format!("--drones={drones}"), format!("--port={}", self.crtp_port)];
        let matches = Args::augment_args(clap::Command::new("cf2")).try_get_matches_from(words);
        let asked = matches.and_then(|matches| Args::from_arg_matches(&matches));
        let settings = settings(&asked.map_err(|e| Failure::Usage(e.to_string()))?)?;
        let (watcher, fleet) = page::fleet_view(&settings)?;
        let bound = Server::bind(&settings, Some(watcher)).await;
        let drones = bound.map_err(|e| Failure::Failed(e.to_string()))?;
        announce(&drones, None, false, out)?;
        let stop = CancellationToken::new();
        let flying = tokio::spawn(drones.run(stop.clone()));
        let report = service.with_fleet(fleet).run(stop_signal()?).await;
        stop.cancel();
        flying.await.map_err(|e| Failure::Failed(e.to_string()))?;
        Ok(report)
    }
}
