//! `crazyflie serve`: the network server.

use std::io::Write;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

use tokio::net::TcpListener;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use super::{Failure, Outcome};
use crazyflie_server::serve::{self, Service, Settings, Shares};

/// Serve environments over WebSocket.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Address to listen at; port 0 for any. Off this machine only with TLS
    #[arg(long, default_value = "127.0.0.1:8765", value_name = "HOST:PORT")]
    listen: String,
    #[cfg(feature = "crazyflies")]
    #[command(flatten)]
    beside: super::cf2::Beside,
    /// Certificate chain, PEM
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Its private key, PEM
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// A web origin whose pages may connect, besides the server's own; may be repeated
    #[arg(long, value_name = "ORIGIN")]
    allow_origin: Vec<String>,
    /// A proxy in front of the server, whose X-Forwarded-For or PROXY header is believed; may be repeated
    #[arg(long, value_name = "ADDRESS")]
    trusted_proxy: Vec<IpAddr>,
    #[cfg(feature = "bench")]
    #[command(flatten)]
    database: super::bench::Database,
    /// Limit of connections
    #[arg(long, default_value_t = Settings::default().limits.connections.server, value_name = "N")]
    connections: usize,
    /// Limit of connections of one address
    #[arg(long, default_value_t = Settings::default().limits.connections.address, value_name = "N")]
    connections_per_address: usize,
    /// Limit of environments
    #[arg(long, default_value_t = Settings::default().limits.envs.server, value_name = "N")]
    envs: usize,
    /// Limit of environments of one address
    #[arg(long, default_value_t = Settings::default().limits.envs.address, value_name = "N")]
    envs_per_address: usize,
    /// Write the log as JSON, one object a line
    #[arg(long)]
    log_json: bool,
    /// Level of the log: error, warn, info, debug or trace, or a filter such as crazyflie_server=debug
    #[arg(long, default_value = "info", value_name = "LEVEL")]
    log: String,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let (settings, address) = (settings(args)?, address(&args.listen)?);
    settings.check(address).map_err(|e| Failure::Usage(e.to_string()))?;
    start_log(&args.log, args.log_json)?;
    more_descriptors();
    // looks for clients that wait after a few turns of others: what each of them does is short
    let runtime = tokio::runtime::Builder::new_multi_thread().event_interval(8).enable_all().build()?;
    let report = runtime.block_on(async {
        let failed = |e: serve::ServeError| Failure::Failed(e.to_string());
        let listener = TcpListener::bind(address).await.map_err(|e| Failure::about(address, e))?;
        #[cfg(feature = "bench")]
        let settings = Settings { extension: Some(args.database.extension()?), ..settings };
        let service = Service::open(listener, settings).map_err(failed)?;
        // for programs that start a server on port 0 and must know where it is
        writeln!(out, "listening on {}", service.address())?;
        #[cfg(feature = "bench")]
        writeln!(out, "teams take part with a token: {}", args.database.token_command())?;
        out.flush()?;
        #[cfg(feature = "crazyflies")]
        let report = args.beside.serve(service, out).await?;
        #[cfg(not(feature = "crazyflies"))]
        let report = service.run(stop_signal()?).await;
        Ok::<_, Failure>(report)
    })?;
    // tasks that have not ended by now never end
    runtime.shutdown_background();
    writeln!(out, "{}", serde_json::to_string(&report)?)?;
    Ok(())
}

/// The first address of a host and port.
fn address(listen: &str) -> Outcome<SocketAddr> {
    let about = |problem: String| Failure::Usage(format!("--listen {listen}: {problem}"));
    let mut addresses = listen.to_socket_addrs().map_err(|e| {
        about(format!("expected a host and a port, such as 127.0.0.1:8765 or localhost:8765: {e}"))
    })?;
    addresses.next().ok_or_else(|| about("this name has no address".into()))
}

fn settings(args: &Args) -> Outcome<Settings> {
    let mut settings = Settings {
        origins: args.allow_origin.clone(),
        trusted_proxies: args.trusted_proxy.clone(),
        ..Settings::default()
    };
    if let (Some(cert), Some(key)) = (&args.tls_cert, &args.tls_key) {
        settings.tls = Some(serve::tls(cert, key).map_err(|e| Failure::Failed(e.to_string()))?);
    }
    settings.limits.connections.server = args.connections;
    settings.limits.connections.address = args.connections_per_address;
    settings.limits.envs.server = args.envs;
    settings.limits.envs.address = args.envs_per_address;
    // the same share of all environments as by default
    settings.limits.reserved_envs = Shares {
        server: args.envs / 16,
        address: args.envs_per_address / 16,
        token: args.envs_per_address / 16,
    };
    Ok(settings)
}

/// Logs to standard error from now on: what `--log` names, as text or as JSON.
pub(super) fn start_log(filter: &str, as_json: bool) -> Outcome {
    let filter: Targets = filter.parse().map_err(|e| Failure::Usage(format!("--log {filter}: {e}")))?;
    let layer = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    let layer = if as_json { layer.json().boxed() } else { layer.boxed() };
    // a second server in one process logs through the first one's subscriber
    let _ = tracing_subscriber::registry().with(layer.with_filter(filter)).try_init();
    Ok(())
}

/// Waits until the program is stopped.
///
/// # Errors
/// The error of the system, if the program cannot wait for signals.
#[cfg(unix)]
pub(super) fn stop_signal() -> std::io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
    Ok(async move {
        tokio::select! { _ = terminate.recv() => {} _ = interrupt.recv() => {} }
    })
}

#[cfg(not(unix))]
pub(super) fn stop_signal() -> std::io::Result<impl Future<Output = ()>> {
    Ok(async {
        if let Err(error) = tokio::signal::ctrl_c().await {
            tracing::error!(%error, "the program cannot be told to stop");
            std::future::pending().await
        }
    })
}

/// A connection is a descriptor: as many as the system allows.
#[cfg(unix)]
fn more_descriptors() {
    use rustix::process::{Resource, getrlimit, setrlimit};
    let mut limit = getrlimit(Resource::Nofile);
    limit.current = limit.maximum;
    if let Err(error) = setrlimit(Resource::Nofile, limit) {
        tracing::warn!(%error, "the number of open files stays limited");
    }
}

/// Other systems do not count sockets against a limit of the process.
#[cfg(not(unix))]
fn more_descriptors() {}
