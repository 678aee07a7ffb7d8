//! Lobelia.
use clap::Parser;
#[derive(Parser)]
enum Command {
    /// Fit.
    Fit(lobelia::cli::fit::FitArgs),
}
fn main() {
    let Command::Fit(args) = Command::parse();
    if let Err(error) = lobelia::cli::fit::run(&args, 1) {
        eprintln!("{error}");
        std::process::exit(error.exit_code().into());
    }
}
