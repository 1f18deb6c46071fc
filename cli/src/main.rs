//! The program `crazyflie`.

fn main() {
    std::process::exit(crazyflie_cli::main_from(
        std::env::args_os().map(|arg| arg.to_string_lossy().into_owned()),
    ));
}
