//! The program as a server in a process of its own.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::common::BINARY;
use crate::net::Client;

/// The real program, for what is counted per process.
pub struct Process {
    child: std::process::Child,
    pub address: SocketAddr,
    out: std::io::BufReader<std::process::ChildStdout>,
}

impl Process {
    pub fn start(args: &[&str]) -> Process {
        Process::start_logging(args, std::process::Stdio::inherit())
    }

    pub fn start_logging(args: &[&str], log: std::process::Stdio) -> Process {
        use std::io::BufRead;
        use std::process::{Command, Stdio};
        let mut command = Command::new(BINARY);
        command.args(["serve", "--listen", "127.0.0.1:0"]).args(args).stdout(Stdio::piped()).stderr(log);
        if !args.contains(&"--log") {
            command.args(["--log", "warn"]);
        }
        let mut child = command.spawn().unwrap();
        let mut out = std::io::BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on ").expect(&line).parse().unwrap();
        Process { child, address, out }
    }

    pub fn client(&self) -> Client {
        Client::connect(self.address, Some("crazyflie.v1"))
    }

    pub fn rss_kib(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }

    pub fn descriptors(&self) -> usize {
        std::fs::read_dir(format!("/proc/{}/fd", self.child.id())).unwrap().count()
    }

    /// Stops it; returns its report, its exit code and the time it took.
    pub fn terminate(mut self) -> (Value, Option<i32>, Duration) {
        use std::io::Read;
        let began = Instant::now();
        let pid = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
        let mut text = String::new();
        self.out.read_to_string(&mut text).unwrap();
        let code = self.child.wait().unwrap().code();
        let report = text.lines().last().and_then(|line| serde_json::from_str(line).ok());
        (report.unwrap_or(Value::Null), code, began.elapsed())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
