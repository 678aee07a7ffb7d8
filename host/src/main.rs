//! The `lobelia` command; see `lobelia help`.

fn main() -> std::process::ExitCode {
    lobelia::cli::main()
}
